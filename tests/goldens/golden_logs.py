"""The logs of the golden results: bundled, or simulated here.

A simulated log is a folder with `log.parquet` and `meta.json`, as a user has it. Motion and readings of a
stage come from `hallsym.simulate` without noise; noise and hidden effects are added here in plain numpy, so
that no random number and no effect of the package decides what a log holds. Encoders are typed a second time.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import hallsym

ROOT = Path(__file__).resolve().parents[2]
Columns = dict[str, np.ndarray]

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


@cache
def workspace() -> tempfile.TemporaryDirectory:
    """A folder that is removed when the process ends."""
    return tempfile.TemporaryDirectory(prefix="goldens")


# -- a stage -----------------------------------------------------------------------------------------------


def stage(
    seed: int,
    model: str = "stage31",
    base: str = "stage31",
    change: Callable[[Columns], None] | None = None,
) -> tuple[Columns, dict]:
    """Return the columns and `meta.json` of the paper's campaign on a stage with Table 7's values."""
    built = hallsym.build(model)
    known = {k: v for k, v in TABLE7.items() if k in built.names}
    campaign = hallsym.paper_campaign(step_s=0.02)
    columns = hallsym.simulate(built, known, campaign, seed=0)
    if change:
        change(columns)
    add_noise(columns, STAGE_NOISE, seed)
    runs = len(campaign.runs)
    return columns, {
        "base_model": base,
        "noise_1sigma": {"hall_m": 0.5e-6} | {c: s for c, s in STAGE_NOISE.items() if c not in HALL},
        "validation_runs": list(range(2, runs, 5)),
        "gap_length_scale_m": 0.35,
    }


def add_noise(columns: Columns, sigma: Mapping[str, float], seed: int) -> None:
    """Add white noise column by column in the order of `sigma`."""
    rng = np.random.default_rng(seed)
    for name, level in sigma.items():
        if name in columns:
            columns[name] = columns[name] + level * rng.standard_normal(len(columns[name]))


# -- an encoder --------------------------------------------------------------------------------------------


def encoder(seed: int, base: str, third: float = 0.0) -> tuple[Columns, dict]:
    """Return six runs there and back at three speeds, with a third harmonic of the field in V."""
    rows = []
    for run, speed in enumerate((13.0, -13.0, 40.0, -40.0, 80.0, -80.0)):
        t = np.arange(400) * 1e-3
        a = 0.4 * run + speed * (t + 0.1 * np.sin(4 * t))
        rows.append((np.full(400, run), 1.5 * run + t, a, a - 0.6))
    names = ("run", "t_s", "angle", "angle_ref_rad")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    a = columns.pop("angle")
    columns["v_sin_v"] = -0.0305 + 0.9945 * np.sin(a + 0.01) - third * np.sin(3 * a)
    columns["v_cos_v"] = 0.0189 + 1.0286 * np.cos(a) + third * np.cos(3 * a)
    sigma = {"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5}
    add_noise(columns, sigma, seed)
    return columns, {"base_model": base, "noise_1sigma": sigma, "validation_runs": [4, 5]}


# -- the list ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recorded:
    """A log by name: how it comes about, options of `fit`, whether its fit is golden, when it is diagnosed.

    `fit`: None where no golden fit is kept. `diagnosed`: "always" or "slow" (with the slow tests).
    """

    make: Callable[[], tuple[Columns, dict]] | Path
    fit: tuple[str, ...] | None = None
    diagnosed: str = "slow"


DIRECT = ("--solver", "direct")

LOGS: dict[str, Recorded] = {
    "bundled_campaign": Recorded(ROOT / "data" / "campaign", ()),
    "bundled_encoder": Recorded(ROOT / "data" / "encoder", (), "always"),
    "stage30_table6": Recorded(lambda: stage(2, "stage30", "stage30"), DIRECT),
    # an offset, a third harmonic
    "rotary_ideal_offset": Recorded(lambda: encoder(34, "rotary_ideal")),
    "rotary_third_wave": Recorded(lambda: encoder(35, "rotary", 4e-3)),
}


def folder_of(name: str) -> Path:
    """Return the folder of a log, simulated now if it has to be."""
    made = LOGS[name].make
    if isinstance(made, Path):
        return made
    folder = Path(workspace().name) / name
    if not folder.exists():
        columns, meta = made()
        folder.mkdir()
        hallsym.write_log(columns, folder / "log.parquet")
        (folder / "meta.json").write_text(json.dumps(meta))
    return folder
