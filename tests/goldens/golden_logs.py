"""The logs of the golden results: bundled, simulated here, and cases that stand beside the project.

A simulated log is a folder with `log.parquet` and `meta.json`, as a user has it. Motion and readings of a
stage come from `hallsym.simulate` without noise; noise and hidden effects are added here in plain numpy, so
that no random number and no effect of the package decides what a log holds. Encoders are typed a second time.
"""

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

import hallsym

ROOT = Path(__file__).resolve().parents[2]
CASES = Path(os.environ.get("HALLSYM_CASES", ROOT.parent / "shared" / "cases"))
"""Cases of an independent plant; tests that need them are skipped where they are absent."""

Columns = dict[str, np.ndarray]
Change = Callable[[Columns], None]

HALL = ("hall_a_m", "hall_b_m", "hall_c_m")
STAGE_NOISE = {
    **dict.fromkeys(HALL, 0.5e-6),
    "x_ref_m": 0.3e-6, "y_ref_m": 0.3e-6, "rz_ref_rad": 0.5e-6,
    "z_m": 12e-9, "rx_rad": 80e-9, "ry_rad": 80e-9,
}  # fmt: skip
TABLE7 = {
    "H1x": 0.1944, "H1y": 0.3381, "H2x": 0.2173, "H2y": 0.3555, "H3x": 0.1979, "H3y": 0.3293,
    "eta_A": 0.8671, "eta_B": 0.7049, "eta_C": 0.8632, "theta_A": 2.5307e-4, "theta_B": 7.2309e-3,
    "theta_C": -9.7913e-4, "a_A": -188.1873, "b_A": -69.7432, "c_A": 14.8664, "a_B": -156.5783,
    "b_B": -56.7511, "c_B": -55.0764, "a_C": -178.1902, "b_C": -63.4133, "c_C": 12.7241,
}  # fmt: skip
TIED = {k: v for k, v in TABLE7.items() if k[:2] not in ("b_", "c_")} | {"x0": 0.12, "y0": -0.02}
FOUR_PROBES = [
    {"channel": "hall_a_m", "position_m": [0.1975, 0.4], "senses": [0, 1]},
    {"channel": "hall_b_m", "position_m": [-0.1975, 0.42], "senses": [0, 1]},
    {"channel": "hall_c_m", "position_m": [0.1975, 0.36], "senses": [1, 0]},
    {"channel": "hall_d_m", "position_m": [-0.2, -0.33], "senses": [0.8, 0.6]},
]
FOUR_GAINS = {
    "eta_A": 0.87, "eta_B": 0.7, "eta_C": 0.86, "eta_D": 0.95, "theta_A": 0.01, "theta_D": -0.02,
    "a_A": -150.0, "a_B": -120.0, "a_C": -90.0, "a_D": -60.0, "b_A": 40.0, "b_B": -30.0, "b_D": 20.0,
    "c_A": 25.0, "c_C": -35.0, "c_D": 15.0,
}  # fmt: skip
ELLIPSE = {"Vx": 0.0189, "Vy": -0.0305, "Ax": 1.0286, "Ay": 0.9945, "beta": 0.01}
MENG = {
    "Vx": 0.008943,
    "Vy": 0.000491,
    "Ax": 1.008607,
    "Ay": 0.994536,
    "beta": 0.000368,
    "m": 0.113,
    "zero": 0.6,
}
HOMES = (0.6, -2.4, 2.1, 0.7, -0.9, 3.0)


# -- campaigns ---------------------------------------------------------------------------------------------


def campaign_text(runs: int = 20, rotation: float = 300e-6, probes: int = 3) -> str:
    """A campaign of 1 s runs at as many vertical settings: all axes at once, and every third run one axis."""
    lines = ["step_s = 4e-3", ""]
    for k in range(runs):
        zeros = [float(v) for v in np.round(2e-6 * np.cos(np.arange(1, 1 + probes) * (k + 1)), 9)]
        z, rx, ry = (
            float(v) for v in np.round([2e-4 * np.sin(2 * k), 4e-4 * np.cos(3 * k), 4e-4 * np.sin(5 * k)], 9)
        )
        lines += ["[[run]]", "duration_s = 1.0", f"zero_deviations_m = {zeros}"]
        lines += [f"rx_rad = {rx}", f"ry_rad = {ry}"]
        lines += [f'z_m = {{ kind = "sine", amplitude = 5e-5, frequency_hz = 0.7, about = {z} }}']
        if k % 3 == 2:
            axis, size = (("x_m", 280e-6), ("y_m", 470e-6), ("rz_rad", rotation))[k // 3 % 3]
            lines += [f'{axis} = {{ kind = "triangle", amplitude = {size}, frequency_hz = {2 + k % 4} }}', ""]
            continue
        for axis, size, waves in (
            ("x_m", 300e-6, [1.0, 3.3, 7.0]),
            ("y_m", 500e-6, [1.4, 4.1, 9.0]),
            ("rz_rad", rotation, [0.8, 2.5, 6.0]),
        ):
            shifted = [round(f * (1 + 0.03 * (k % 5)), 6) for f in waves]
            lines += [
                f'{axis} = {{ kind = "multi-sine", amplitude = {2 * size}, frequencies_hz = {shifted} }}'
            ]
        lines += [""]
    return "\n".join(lines)


@cache
def workspace() -> tempfile.TemporaryDirectory:
    """A folder that is removed when the process ends."""
    return tempfile.TemporaryDirectory(prefix="goldens")


def campaign_of(text: str) -> hallsym.Campaign:
    """Read a campaign from its text."""
    path = Path(workspace().name) / "campaign.toml"
    path.write_text(text)
    return hallsym.read_campaign(path)


# -- a stage -----------------------------------------------------------------------------------------------


def stage(
    seed: int,
    *changes: Change,
    model: str = "stage31",
    truth: Mapping[str, float] = TABLE7,
    base: str | None = None,
    campaign: hallsym.Campaign | None = None,
    probes: list[dict] | None = None,
    added: tuple[str, ...] = (),
    noise: str = "white",
) -> tuple[Columns, dict]:
    """Return the columns and `meta.json` of a stage with Table 7's values and what `changes` do to it."""
    built = hallsym.build(model, meta=hallsym.Meta(probes=probes), added=added)
    known = {k: v for k, v in truth.items() if k in built.names}
    campaign = campaign or campaign_of(campaign_text(probes=len(built.channels)))
    columns = hallsym.simulate(built, known, campaign, seed=0)
    sigma = STAGE_NOISE | dict.fromkeys(built.channels, 0.5e-6)
    for change in changes:
        change(columns)
    add_noise(columns, sigma, seed, noise)
    runs = len(campaign.runs)
    meta = {
        "base_model": base or model,
        "noise_1sigma": {"hall_m": 0.5e-6} | {c: s for c, s in sigma.items() if not c.startswith("hall")},
        "validation_runs": list(range(2, runs, 5)),
        "gap_length_scale_m": 0.35,
    }
    return columns, meta | ({"probes": probes} if probes else {})


def add_noise(columns: Columns, sigma: Mapping[str, float], seed: int, kind: str = "white") -> None:
    """Add noise column by column in the order of `sigma`; "slow": correlated over four samples."""
    rng = np.random.default_rng(seed)
    for name, level in sigma.items():
        if name not in columns:
            continue
        white = rng.standard_normal(len(columns[name]))
        if kind == "slow":
            memory = np.exp(-1 / 4)
            white = lfilter([np.sqrt(1 - memory**2)], [1, -memory], white)
        columns[name] = columns[name] + level * white


def by_run(columns: Columns) -> Iterator[np.ndarray]:
    """Yield the rows of each run."""
    for run in np.unique(columns["run"]):
        yield np.flatnonzero(columns["run"] == run)


def read_late(columns: Columns, names: tuple[str, ...], delay_s: float) -> None:
    """Each reading is the one `delay_s` before."""
    for rows in by_run(columns):
        t = columns["t_s"][rows]
        for name in names:
            columns[name][rows] = CubicSpline(t, columns[name][rows])(t - delay_s)


def late(columns: Columns) -> None:
    """Readings 0.5 ms after the reference."""
    read_late(columns, HALL, 5e-4)


def low_passed(columns: Columns) -> None:
    """A low-pass of 1.5 ms in the path of the readings."""
    for rows in by_run(columns):
        t = columns["t_s"][rows]
        fine = np.linspace(t[0], t[-1], 32 * (len(t) - 1) + 1)
        pole = np.exp(-(fine[1] - fine[0]) / 1.5e-3)
        for name in HALL:
            values = CubicSpline(t, columns[name][rows])(fine)
            slow = lfilter([1 - pole], [1, -pole], values - values[0]) + values[0]
            columns[name][rows] = slow[::32]


def play(columns: Columns) -> None:
    """Readings that follow within 3 um of where they were."""
    for rows in by_run(columns):
        for name in HALL:
            held = columns[name][rows[0]]
            for row in rows:
                held = min(max(held, columns[name][row] - 3e-6), columns[name][row] + 3e-6)
                columns[name][row] = held


def at_rails(columns: Columns) -> None:
    """Readings that stop at 0.17 mm."""
    for name in HALL:
        columns[name] = np.clip(columns[name], -1.7e-4, 1.7e-4)


def cubic(columns: Columns) -> None:
    """A cubic term of 2 % at 0.3 mm."""
    for name, size in zip(HALL, (0.02, -0.015, 0.018), strict=True):
        columns[name] = columns[name] * (1 + size * (columns[name] / 3e-4) ** 2)


def crossed(columns: Columns) -> None:
    """A gain that follows the motion across the sensing axis."""
    x, y, rz = columns["x_ref_m"], columns["y_ref_m"], columns["rz_ref_rad"]
    across = (x - TABLE7["H1y"] * rz, x - TABLE7["H2y"] * rz, y + TABLE7["H3x"] * rz)
    for name, size, other in zip(HALL, (60.0, -50.0, 55.0), across, strict=True):
        columns[name] = columns[name] * (1 + size * other)


def bent(columns: Columns) -> None:
    """A gain that bends with height."""
    for name, size in zip(HALL, (2.5e5, 2.0e5, 3.0e5), strict=True):
        columns[name] = columns[name] * (1 + size * columns["z_m"] ** 2)


def warmed(columns: Columns) -> None:
    """A gain that follows the temperature, which is logged."""
    t = columns["t_s"]
    columns["temperature_degc"] = 20.0 + 3.0 * np.sin(0.25 * t) + 0.05 * t
    for name, size in zip(HALL, (2e-3, 3e-3, 2.5e-3), strict=True):
        columns[name] = columns[name] * (1 + size * (columns["temperature_degc"] - 20.0))


def humming(columns: Columns) -> None:
    """Pick-up at 50.02 Hz."""
    for name, phase in zip(HALL, (0.3, 1.9, 4.0), strict=True):
        columns[name] = columns[name] + 1.2e-6 * np.sin(2 * np.pi * 50.02 * columns["t_s"] + phase)


def slipped(columns: Columns) -> None:
    """Probe B moves by 6 um within run 9, and is 8 mm further out from then on."""
    when = columns["t_s"] > 18.5
    columns["hall_b_m"] = columns["hall_b_m"] + when * (6e-6 - 8e-3 * columns["rz_ref_rad"])


def leaning(columns: Columns) -> None:
    """A reference that reads tilt times an Abbe arm that moves with height: one of the catalogue."""
    columns["x_ref_m"] = columns["x_ref_m"] + 0.02 * columns["ry_rad"] + 0.05 * columns["z_m"]


def rippled(columns: Columns) -> None:
    """A reference scale with a ripple of 60 um period, which no effect of the catalogue describes."""
    x = columns["x_ref_m"]
    columns["x_ref_m"] = x + 1.6e-6 * np.sin(2 * np.pi * x / 60e-6)


def spiky(columns: Columns) -> None:
    """One sample in 250 is off by up to 0.3 mm."""
    rng = np.random.default_rng(99)
    for name in (*HALL, "x_ref_m"):
        hit = rng.random(len(columns[name])) < 0.004
        columns[name] = columns[name] + hit * rng.uniform(-3e-4, 3e-4, len(hit))


# -- an encoder --------------------------------------------------------------------------------------------


def encoder(
    seed: int,
    *changes: Change,
    base: str = "rotary",
    truth: Mapping[str, float] = ELLIPSE,
    angle: bool = False,
    homes: tuple[float, ...] = (0.6,) * 6,
) -> tuple[Columns, dict]:
    """Return six runs there and back at three speeds; the reference of run i begins `homes[i]` further."""
    rows = []
    for run, (home, speed) in enumerate(zip(homes, (13.0, -13.0, 40.0, -40.0, 80.0, -80.0), strict=True)):
        t = np.arange(400) * 1e-3
        a = 0.4 * run + speed * (t + 0.1 * np.sin(4 * t))
        rows.append((np.full(400, run), 1.5 * run + t, a, a - home))
    names = ("run", "t_s", "angle", "angle_ref_rad")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    a = columns["angle"]
    columns["v_sin_v"] = truth["Vy"] + truth["Ay"] * np.sin(a + truth["beta"])
    columns["v_cos_v"] = truth["Vx"] + truth["Ax"] * np.cos(a)
    return as_encoder(columns, seed, changes, base, angle)


def concentrator(seed: int, *, angle: bool = False) -> tuple[Columns, dict]:
    """Return the bundled encoder's motion with a magnetic concentrator, with other noise or as an angle."""
    campaign = hallsym.read_campaign(ROOT / "data" / "encoder" / "campaign.toml")
    columns = hallsym.simulate(hallsym.build("rotary_meng"), MENG, campaign, seed=0)
    return as_encoder(columns, seed, (), "rotary_meng", angle)


def as_encoder(
    columns: Columns, seed: int, changes: tuple[Change, ...], base: str, angle: bool
) -> tuple[Columns, dict]:
    """Return what is logged of the voltages and the true angle: `changes`, noise, and the angle alone."""
    for change in changes:
        change(columns)
    columns.pop("angle", None)
    add_noise(columns, {"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5}, seed)
    channels = ("v_sin_v", "v_cos_v")
    if angle:
        columns["angle_rad"] = np.mod(np.arctan2(*(columns.pop(c) for c in channels)), 2 * np.pi)
        channels = ("angle_rad",)
    last = int(columns["run"].max())
    return columns, {
        "base_model": base,
        "noise_1sigma": dict.fromkeys(channels, 3.5e-4) | {"angle_ref_rad": 2e-5},
        "validation_runs": [last - 1, last] if last > 3 else [last],
    }


def third_wave(columns: Columns) -> None:
    """A third harmonic of the field."""
    columns["v_cos_v"] = columns["v_cos_v"] + 4e-3 * np.cos(3 * columns["angle"])
    columns["v_sin_v"] = columns["v_sin_v"] - 4e-3 * np.sin(3 * columns["angle"])


def voltages_late(columns: Columns) -> None:
    """Voltages 40 us after the reference."""
    read_late(columns, ("v_sin_v", "v_cos_v"), 4e-5)


def voltages_warmed(columns: Columns) -> None:
    """A gain of one plate and an offset that follow the temperature, which is logged."""
    warm = 2 * np.sin(0.6 * columns["t_s"])
    columns["temperature_degc"] = 25.0 + warm
    columns["v_sin_v"] = columns["v_sin_v"] * (1 + 2e-3 * warm)


def bearing(columns: Columns) -> None:
    """A reference that swings 2.57 times per turn, which no effect of the catalogue does."""
    columns["angle_ref_rad"] = columns["angle_ref_rad"] + 8e-4 * np.sin(2.57 * columns["angle"])


def plates_at_rails(columns: Columns) -> None:
    """Voltages that stop at 0.9 V."""
    for name in ("v_sin_v", "v_cos_v"):
        columns[name] = np.clip(columns[name], -0.9, 0.9)


# -- the list ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recorded:
    """A log by name: how it comes about, options of `fit` and `diagnose`, and when it is diagnosed.

    `diagnosed`: "always", "slow" (only with the slow tests) or "never". `like`: of a case beside the project,
    the simulated log that stands for it where the cases are absent.
    """

    make: Callable[[], tuple[Columns, dict]] | str
    fit: tuple[str, ...] = ()
    diagnosed: str = "slow"
    diagnose: tuple[str, ...] = ()
    like: str | None = None
    loose: tuple[str, ...] = ()
    """Parameters at the edge of what a log determines: which side they fall on is up to the last bits."""


def table6(step_s: float = 0.02) -> hallsym.Campaign:
    """Return the paper's campaign on a coarser clock."""
    return hallsym.paper_campaign(step_s=step_s)


def turning_campaign() -> hallsym.Campaign:
    """Return the campaign with rotations of up to 8 mrad."""
    return campaign_of(campaign_text(rotation=8e-3))


RAILS = "saturation:low_m=-1.7e-4/-1.7e-4/-1.7e-4,high_m=1.7e-4/1.7e-4/1.7e-4"
DIRECT = ("--solver", "direct")
OWN_ZEROS = ("--effect", "zero_deviation")
STAGE15 = {k: v for k, v in TABLE7.items() if k[:2] not in ("a_", "b_", "c_")}

LOGS: dict[str, Recorded] = {
    "bundled_campaign": Recorded(str(ROOT / "data" / "campaign"), diagnosed="always"),
    "bundled_encoder": Recorded(str(ROOT / "data" / "encoder"), diagnosed="always"),
    # stages that are what their model says
    "stage15_no_zeros": Recorded(
        lambda: stage(1, model="stage15", truth=STAGE15), DIRECT, "never"
    ),
    "stage30_table6": Recorded(
        lambda: stage(2, model="stage30", truth=STAGE15, campaign=table6()), DIRECT
    ),
    "stage31_table6": Recorded(lambda: stage(3, campaign=table6()), ("--seed", "1")),
    "stage31_mixed": Recorded(lambda: stage(4), DIRECT, "always"),
    "stage31_tied": Recorded(lambda: stage(5, model="stage31_tied", truth=TIED), DIRECT),
    "stage31_slow_noise": Recorded(lambda: stage(6, noise="slow"), DIRECT),
    "stage31_spikes": Recorded(lambda: stage(7, spiky), DIRECT),
    "stage31_four_probes": Recorded(
        lambda: stage(8, truth=FOUR_GAINS, probes=FOUR_PROBES), DIRECT
    ),
    "stage31_turning": Recorded(
        lambda: stage(9, added=("exact_rotation",), campaign=turning_campaign()),
        (*DIRECT, "--effect", "exact_rotation"),
    ),
    # stages with a hidden effect
    "stage30_vertical": Recorded(lambda: stage(10, base="stage30"), DIRECT),
    "stage31_late": Recorded(lambda: stage(11, late), (*DIRECT, "--effect", "time_skew")),
    "stage31_lag": Recorded(lambda: stage(12, low_passed), (*DIRECT, "--effect", "first_order_lag")),
    "stage31_play": Recorded(
        lambda: stage(13, play), (*DIRECT, "--effect", "hysteresis:half_width_m=1e-05"),
        loose=("half_width",),
    ),
    "stage31_rails": Recorded(lambda: stage(14, at_rails), (*DIRECT, "--effect", RAILS)),
    "stage31_cubic": Recorded(lambda: stage(15, cubic), (*DIRECT, "--effect", "odd_nonlinearity")),
    "stage31_crossed": Recorded(lambda: stage(16, crossed), (*DIRECT, "--effect", "cross_axis_sensitivity")),
    "stage31_bent": Recorded(lambda: stage(17, bent), (*DIRECT, "--effect", "height_quadratic")),
    "stage31_warmed": Recorded(
        lambda: stage(18, warmed), (*DIRECT, "--effect", "gain_temperature_drift:mean_degc=20")
    ),
    "stage31_hum": Recorded(
        lambda: stage(19, humming), (*DIRECT, "--effect", "mains_hum:frequency_hz=50.02")
    ),
    "stage31_slip": Recorded(
        lambda: stage(20, slipped), (*DIRECT, "--effect", "mount_slip:probe=B,instant_s=18.5")
    ),
    "stage31_leaning": Recorded(
        lambda: stage(21, leaning), (*DIRECT, "--effect", "reference_abbe_error:arms=all")
    ),
    "stage31_ripple": Recorded(lambda: stage(22, rippled), DIRECT),
    "stage31_cubic_late": Recorded(lambda: stage(23, cubic, late), DIRECT),
    # encoders
    "rotary_volts": Recorded(lambda: encoder(30), ("--seed", "2"), "always"),
    "rotary_angle": Recorded(lambda: encoder(31, angle=True), DIRECT, "always"),
    "rotary_homed": Recorded(lambda: encoder(32, homes=HOMES), (*DIRECT, *OWN_ZEROS), diagnose=OWN_ZEROS),
    "rotary_homed_angle": Recorded(
        lambda: encoder(33, angle=True, homes=HOMES), (*DIRECT, *OWN_ZEROS), diagnose=OWN_ZEROS
    ),
    "rotary_ideal_offset": Recorded(lambda: encoder(34, base="rotary_ideal"), DIRECT),
    "rotary_third_wave": Recorded(
        lambda: encoder(35, third_wave), (*DIRECT, "--effect", "third_harmonic_distortion"), "always"
    ),
    "rotary_late": Recorded(lambda: encoder(36, voltages_late), (*DIRECT, "--effect", "time_skew")),
    "rotary_warmed": Recorded(
        lambda: encoder(37, voltages_warmed), (*DIRECT, "--effect", "gain_temperature_drift:mean_degc=25")
    ),
    "rotary_bearing": Recorded(lambda: encoder(38, bearing), DIRECT, "always"),
    "rotary_rails": Recorded(lambda: encoder(39, plates_at_rails), (*DIRECT, "--drop-bad")),
    "meng_volts": Recorded(lambda: concentrator(40), DIRECT),
    "meng_angle": Recorded(lambda: concentrator(41, angle=True), DIRECT),
    # an independent plant, where it stands beside the project
    "dev_001": Recorded("dev/dev_001", DIRECT, like="stage30_vertical"),
    "dev_002": Recorded("dev/dev_002", DIRECT, like="stage31_bent"),
    "dev_003": Recorded("dev/dev_003", DIRECT, like="stage31_cubic"),
    "dev_006": Recorded("dev/dev_006", DIRECT, like="stage31_late"),
    "dev_008": Recorded("dev/dev_008", DIRECT, like="stage31_play"),
    "dev_009": Recorded("dev/dev_009", DIRECT, like="stage31_warmed"),
    "dev_013": Recorded("dev/dev_013", DIRECT, like="stage31_mixed"),
    "dev_014": Recorded("dev/dev_014", DIRECT, like="stage31_ripple"),
    "dev_016": Recorded("dev/dev_016", DIRECT, like="rotary_ideal_offset"),
    "dev_017": Recorded("dev/dev_017", DIRECT, like="rotary_third_wave"),
    "dev_018": Recorded("dev/dev_018", DIRECT, like="rotary_late"),
    "dev_020": Recorded("dev/dev_020", DIRECT, like="rotary_bearing"),
}  # fmt: skip


class Absent(Exception):
    """A log that does not stand beside the project."""


def folder_of(name: str) -> Path:
    """Return the folder of a log, simulated now if it has to be. Raises `Absent`."""
    made = LOGS[name].make
    if isinstance(made, str):
        path = CASES / made if LOGS[name].like else Path(made)
        if not path.is_dir():
            raise Absent(f"{name} is not there: {path}; {LOGS[name].like} stands for it")
        return path
    folder = Path(workspace().name) / name
    if not folder.exists():
        columns, meta = made()
        folder.mkdir()
        hallsym.write_log(columns, folder / "log.parquet")
        (folder / "meta.json").write_text(json.dumps(meta))
    return folder
