"""Effects of an encoder by their texts: fitted, saved, read back, evaluated and diagnosed again."""

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import altered

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import model_on
from hallsym.errors import InputError
from hallsym.estimation.evaluate import judged
from hallsym.families import adapted, build, effects
from hallsym.families.rotary import FAMILY as ROTARY_FAMILY
from hallsym.families.rotary import effects as rotary_effects
from hallsym.families.rotary.models import VOLTAGES, angle_only, rotary
from hallsym.families.rotary.waveforms import FEW, waveform
from hallsym.families.rotary.waves import Wave
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log, Meta, Noise, Sigma, unwrapped

ROTARY = {name: e for name, e in effects(ROTARY_FAMILY).items() if e.diagnosed}
ONLY = {"voltages": ("time_skew:per=plate", "saturation:low_v=-1.1/-1.2,high_v=1.1/inf"),
        "angle": ("saturation:level=0.9,axes_deg=30",)}  # fmt: skip
SIGMA, REF, OFFSET = 2e-4, 1e-5, 0.005 - 0.003j


def bare(form: str, name: str = "rotary"):
    meta = Meta(probes=[dict(p.entry) for p in angle_only()]) if form == "angle" else None
    return build(name, meta=meta)


def make_of(text: str):
    """An effect as `--effect` takes it."""
    return lambda model: adapted(model, (text,), {})


# -- texts -------------------------------------------------------------------------------------------------


def test_a_name_of_two_families_is_that_of_the_model() -> None:
    shared = set(ROTARY) & set(effects(STAGE_FAMILY))
    assert {"time_skew", "saturation", "gain_temperature_drift", "hysteresis"} <= shared
    assert "d1_angle_ref_rad" in build("rotary", added=("time_skew",)).state
    assert "d1_x_ref_m" in build("stage31", added=("time_skew",)).state


def test_effects_of_voltages_are_none_of_an_angle() -> None:
    for text in ONLY["voltages"]:
        with pytest.raises(InputError, match="reads the angle alone"):
            make_of(text)(bare("angle"))


def test_a_drift_common_to_both_plates_is_no_parameter_of_an_angle() -> None:
    wide = make_of("gain_time_drift:duration_s=4")(bare("angle"))
    assert wide.names[-1] == "gain_time_drift0_sin"
    assert make_of("gain_time_drift:duration_s=4")(bare("voltages")).names[-1] == "gain_time_drift0_cos"


# -- machines of which the truth is known ------------------------------------------------------------------


def pattern(u, a, t):
    """50 periods per turn of a stepper's pole pairs: the reference reads a + 2 mrad sin 50 a."""
    return u, a + 2e-3 * np.sin(50 * a)


def late(u, a, t):
    """Readings 200 us old."""
    return u - 2e-4 * np.gradient(a, t), a


def magnet(u, a, t):
    """Third harmonic of the magnet: b = exp(iu) + 0.01 exp(-3iu)."""
    b = np.exp(1j * u) + 0.01 * np.exp(-3j * u)
    return b, a


def hum(u, a, t):
    """50 Hz of 3 mV in both voltages."""
    return np.exp(1j * u) + 3e-3 * (1 + 1j) * np.cos(2 * np.pi * 50 * t), a


def cubic(u, a, t):
    """Each voltage v loses 0.02 v^3."""
    x, y = np.cos(u) + OFFSET.real, np.sin(u) + OFFSET.imag
    return x - 0.02 * x**3 + 1j * (y - 0.03 * y**3) - OFFSET, a


def rails(u, a, t):
    """The sine stops at 0.97 V."""
    y = np.clip(np.sin(u) + OFFSET.imag, -0.97, 0.97)
    return np.cos(u) + 1j * (y - OFFSET.imag), a


KINDS = {
    "reference_pole_pairs": (
        pattern,
        {"reference_pole_pairs_50_sin": 2e-3, "reference_pole_pairs_50_cos": 0},
    ),
    "time_skew": (late, {"delay": 2e-4}),
    "third_harmonic_distortion": (magnet, {"third_harmonic_distortion_m3_re": 0.01}),
    "mains_hum:frequency_hz=50": (hum, {"mains_hum0_cos": 3e-3, "mains_hum0_sin": 3e-3}),
    "odd_nonlinearity": (cubic, {"odd_nonlinearity0_cos": -0.02, "odd_nonlinearity0_sin": -0.03}),
    "saturation:low_v=-0.97/-9,high_v=0.97/9": (rails, {"clipped_sin": 1.0}),
}
"""By text: what is done to the field's angle u (or to both voltages), and the parameters that say so."""


@cache
def encoder(kind, form: str = "voltages", seed: int = 1) -> Log:
    """2 turns each way at two speeds in 6 runs of 400 samples; u = a + 0.6, offsets of 5 and -3 mV."""
    rng = np.random.default_rng(seed)
    columns = {c: [] for c in ("run", "t_s", *VOLTAGES, "angle_ref_rad")}
    start = 0.0
    for run, rate in enumerate((12.6, -12.6, 40.0, -40.0, 25.0, -25.0)):
        t = start + 1e-3 * np.arange(0, 1000, 2.5)
        a = rate * (t - start)
        u, ref = kind(a + 0.6, a, t) if kind else (a + 0.6, a)
        v = u if np.iscomplexobj(u) else np.exp(1j * u)
        v = v + OFFSET + SIGMA * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
        values = (np.full(400, run), t, v.imag, v.real, ref + REF * rng.standard_normal(400))
        for column, part in zip(columns.values(), values, strict=True):
            column.append(part)
        start += 2.0
    out = {c: np.concatenate(parts) for c, parts in columns.items()}
    out["run"] = out["run"].astype(int)
    if form == "angle":
        y, x = out.pop("v_sin_v"), out.pop("v_cos_v")
        out["angle_rad"] = np.arctan2(y, x)
    sigmas = dict.fromkeys(VOLTAGES, SIGMA) if form == "voltages" else {"angle_rad": SIGMA}
    noise = Noise({c: Sigma(v, "given") for c, v in {**sigmas, "angle_ref_rad": REF}.items()})
    return Log.from_arrays(out, noise)


@pytest.mark.parametrize(
    ("text", "form"),
    [(text, "voltages") for text in KINDS]
    + [pytest.param(text, "angle", marks=pytest.mark.slow) for text in list(KINDS)[:3]],
)
def test_an_effect_of_known_size_is_fitted_saved_and_read_back(text: str, form: str, tmp_path: Path) -> None:
    kind, truth = KINDS[text]
    log = encoder(kind, form)
    fit = hallsym.fit(log, "rotary", effects=(text,), holdout=(4, 5), solver="direct")
    assert fit.status == "converged"
    assert fit.model.texts[text.partition(":")[0]] == text
    for name, value in truth.items():
        assert abs(fit.value(name) - value) < 3.9 * fit.std[fit.model.names.index(name)]  # 1e-4
    rmse = fit.errors.rows()["holdout"]["rmse"]["angle_rad"]
    assert rmse == pytest.approx(fit.noise_floor["angle_rad"], rel=0.1)  # 800 samples: 2.5 % is 1 sigma
    fit.save(tmp_path / "calib.json")
    again = hallsym.load_fit(tmp_path / "calib.json")
    assert (again.model.texts, again.model.names) == (fit.model.texts, fit.model.names)
    noise = fit.noise.std
    table = judged(log, again.model, again.values, noise).table.over((4, 5))
    assert table["rmse"]["angle_rad"] == pytest.approx(rmse, rel=1e-3)  # spikes left out or not


def test_the_name_alone_finds_the_numbers_of_an_encoder() -> None:
    text = model_on(encoder(hum), "rotary", ["mains_hum"]).texts["mains_hum"]
    assert float(text.rpartition("=")[2]) == pytest.approx(50.0, abs=0.06)


def test_a_rail_is_found_in_a_table_without_time() -> None:
    a = np.arange(400) * 2 * np.pi / 400
    y, x = np.clip(np.sin(a), -0.8, 0.8), np.clip(np.cos(a), -0.8, 0.8)
    read = np.unwrap(np.arctan2(y, x)) + np.random.default_rng(0).normal(0, 2e-4, 400)
    table = Log.from_arrays({"angle_ref_rad": a, "angle_rad": read})
    text = model_on(table, "rotary_ideal", ["saturation"]).texts["saturation"]
    assert float(text.rpartition("=")[2]) == pytest.approx(0.8, abs=0.01)


# -- logs that are refused ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def calib(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("encoder") / "calib.json"
    hallsym.fit(encoder(None), "rotary", solver="direct").save(path)
    return path


def test_swapped_voltages_are_said_where_a_calibration_is_judged(calib: Path, tmp_path: Path, capsys) -> None:
    right = encoder(None)
    swapped = altered(right, v_sin_v=right.array("v_cos_v"), v_cos_v=right.array("v_sin_v"))
    log = str(tmp_path / "log.csv")
    hallsym.write_log(swapped, log)
    assert main(["evaluate", str(calib), log]) == 2
    assert "runs the other way round than when the calibration was made" in capsys.readouterr().err
    assert main(["fit", log, "--model", "rotary", "--solver", "direct"]) == 0
    assert "or the two voltages are swapped" in capsys.readouterr().out


def test_a_part_of_a_turn_is_judged_and_a_claim_of_a_fit(calib: Path, tmp_path: Path, capsys) -> None:
    log = encoder(None)
    part = {c: log.array(c) for c in log.columns}
    some = np.mod(part["angle_ref_rad"] + 1e-3, 2 * np.pi) < 1.5
    del part["t_s"]
    table = {c: v[some].astype(int) if c == "run" else v[some] for c, v in part.items()}
    path = str(tmp_path / "log.csv")
    hallsym.write_log(table, path)
    assert main(["fit", path, "--model", "rotary"]) == 3
    assert "deg of a turn" in capsys.readouterr().err
    assert main(["evaluate", str(calib), path]) == 0


# -- Signals by their value: as a filter in numpy, as the chain written out in numpy ------------------------

ANGLES = np.linspace(-3, 9, 25)


def low_pass(n: int) -> tuple[ca.SX, ca.SX]:
    return ca.SX(1 / (1 + (0.3 * n) ** 2)), ca.SX(-0.3 * n / (1 + (0.3 * n) ** 2))


@pytest.mark.parametrize("power", [2, FEW + 3])
def test_a_filter_is_that_of_the_spectrum(power: int) -> None:
    """Few harmonics are multiplied out, many come from values: both as numpy's transform has them."""
    v = waveform(Wave({0: (ca.SX(0.2), ca.SX(0.0)), 1: (ca.SX(1.0), ca.SX(-0.4))}))
    made = v
    for _ in range(power - 1):
        made = made * v
    assert made.degree == power
    grid = 2 * np.pi * np.arange(64) / 64
    spectrum = np.fft.rfft((0.2 + np.cos(grid) - 0.4 * np.sin(grid)) ** power)
    spectrum /= 1 + 0.3j * np.arange(len(spectrum))
    n = np.arange(1, len(spectrum))
    expected = spectrum[0].real / 64 + 2 / 64 * np.real(np.exp(1j * ANGLES[:, None] * n) @ spectrum[1:])
    theta = ca.SX.sym("theta")
    values = ca.Function("f", [theta], [made.filtered(low_pass).at(theta)])(ANGLES[None])
    assert np.allclose(np.array(values)[0], expected, rtol=0, atol=1e-12)


def test_the_angle_behind_bent_voltages_is_that_of_the_formula() -> None:
    texts = ("third_harmonic_distortion:phase=free", "even_nonlinearity:order=4", "odd_nonlinearity:order=5")
    model = rotary_effects.direct(rotary(angle_only()))
    for text in texts:
        model = make_of(text)(model)
    rng = np.random.default_rng(3)
    base = {"Vx": 0.02, "Vy": -0.03, "Ax": 1.0, "Ay": 1.05, "beta": 0.02, "zero": 0.4}
    new = {n: float(rng.uniform(-0.02, 0.02)) for n in model.names if n not in base}
    u = ANGLES + base["zero"]
    field = np.exp(1j * u)
    q = sum(new[f"third_harmonic_distortion_m3_{p}"] * f for p, f in (("re", 1), ("im", 1j)))
    shifted = np.exp(1j * (u + base["beta"]))
    x = base["Vx"] + base["Ax"] * (field + q * np.exp(-3j * u)).real
    y = base["Vy"] + base["Ay"] * (shifted + q * np.exp(-3j * (u + base["beta"]))).imag
    for effect, powers in (("even_nonlinearity", (2, 4)), ("odd_nonlinearity", (3, 5))):
        x, y = (
            v + sum(new[f"{effect}{j}_{plate}"] * v**power for j, power in enumerate(powers))
            for plate, v in (("cos", x), ("sin", y))
        )
    expected = u + np.angle((x + 1j * y) * np.exp(-1j * u))
    reading = model.reading(model.vector(base | new), [], ANGLES[None], np.zeros((0, len(ANGLES))))
    assert np.allclose(np.array(reading)[0], expected, rtol=0, atol=1e-13)


@given(st.lists(st.floats(-20, 20), max_size=30))
def test_a_column_is_unwrapped_as_numpy_does(x: list[float]) -> None:
    steps = np.diff(np.array(x)) / 2.5
    if np.any(np.abs(np.abs(steps - np.round(steps)) - 0.5) < 1e-9):
        return  # half a period either way
    assert np.allclose(unwrapped(np.array(x), 2.5), np.unwrap(x, period=2.5), rtol=0, atol=1e-12)
