"""Recorded encoders, and simulated ones like them: what the program prints can be followed, and is not wrong.

Facts used: the amplitude of both voltages leaves an arctangent alone; a table of knots has no time and no
runs; from which side an encoder is seen is no fault of it; a reference of another zero is the same reference.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from beside import CASES, REAL, needs

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import diagnose
from hallsym.estimation.evaluate import judged
from hallsym.log import Log, Meta, Noise, read_log

ROOT = Path(__file__).resolve().parents[2]
UNDULATOR = REAL / "linear-hall-undulators" / "delta_sabia_phase04_raw_x0.csv"
TURN = 2 * np.pi
KNOTS = (
    "--column",
    "angle_count=raw_count,counts_per_turn=16384",
    "--column",
    "angle_ref_deg=ref_angle_deg",
)


def knots(path: Path, zero: float = 1000.0, sign: int = 1, pattern: float = 0.02) -> Path:
    """A calibration table of 200 full steps, sorted by the counts as an owner's is."""
    turn = np.radians(np.arange(200) * 1.8)
    error = (
        0.35 * np.cos(turn - 1)
        + 0.25 * np.cos(2 * turn)
        + 0.1 * np.cos(4 * turn)
        + pattern * np.cos(50 * turn)
    )
    raw = (
        (sign * turn + np.radians(error)) / TURN * 16384 + zero + np.random.default_rng(2).normal(0, 0.4, 200)
    )
    rows = sorted(zip(raw % 16384, np.degrees(turn), strict=True))
    path.write_text("raw_count,ref_angle_deg\n" + "\n".join(f"{c:.2f},{r:.1f}" for c, r in rows) + "\n")
    return path


def voltages(
    amplitude=1.0, sigma=3e-4, zero=0.5, sine=1, scale=0.0, turns=3.0, meta: Meta | None = None, **more
) -> Log:
    """Runs there and back; `scale`: share by which the reference is long."""
    rng, rows = np.random.default_rng(3), []
    for run, way in enumerate((1, -1, 1, -1)):
        a = way * np.linspace(0, turns * TURN, 600)
        u = a + zero
        y, x = amplitude * np.sin(u), amplitude * np.cos(u)
        y, x = more["clip"](y, x) if "clip" in more else (y, x)
        rows.append((np.full(600, run), 10.0 * run + 5e-3 * np.arange(600), sine * y, x, a * (1 + scale)))
    names = ("run", "t_s", "v_sin_v", "v_cos_v", "angle_ref_rad")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    for c in ("v_sin_v", "v_cos_v"):
        columns[c] = columns[c] + sigma * more.get(c, 1.0) * rng.standard_normal(len(columns[c]))
    return Log.from_arrays(columns, Noise(), meta)


def rmse(fit, row: str = "fitted") -> float:
    return fit.errors.rows()[row]["rmse"]["angle_rad"]


# -- amplitudes, scales, rails -----------------------------------------------------------------------------


@pytest.mark.parametrize("amplitude", [2e-3, 0.6, 7.0])
def test_the_nominal_error_does_not_depend_on_the_common_amplitude(amplitude):
    """Nor on which plate is noisier: a nominal decoder knows of no noise."""
    fit = hallsym.fit(voltages(amplitude, 3e-4 * amplitude, v_sin_v=3.0), "rotary", solver="direct")
    assert rmse(fit, "designed") == pytest.approx(3e-4 * np.sqrt(5), rel=0.05)
    assert rmse(fit) < rmse(fit, "designed") * 1.001


def test_offsets_stay_what_they_are_in_volts():
    """A drawing states offsets in volts; what a smaller amplitude makes of them is an error."""
    log = voltages(0.5, 1e-5)
    shifted = Log.from_arrays({c: log.array(c) + (0.01 if c == "v_cos_v" else 0) for c in log.columns})
    fit = hallsym.fit(shifted, "rotary", solver="direct")
    assert rmse(fit, "designed") == pytest.approx(0.01 / 0.5 / np.sqrt(2), rel=0.02)


@pytest.mark.slow
def test_a_long_reference_is_decoded_on_its_own_turn():
    """500 ppm over three turns are 0.5 deg: of what the effect explains the noise is left, both ways."""
    log = voltages(sigma=2e-4, scale=5e-4, turns=5.0)
    fit = hallsym.fit(log, "rotary", effects=["reference_scale_error"], solver="direct")
    assert fit.value("scale") == pytest.approx(
        5e-4 / (1 + 5e-4), abs=4 * fit.std[fit.model.names.index("scale")]
    )
    assert rmse(fit) == pytest.approx(2e-4, rel=0.05)
    found = diagnose(log)
    assert (found.verdict, found.ranked[0]) == ("explained", "reference_scale_error")


@pytest.mark.parametrize("noisy", [False, True], ids=["hard", "noise behind the rail"])
def test_rails_that_the_model_does_not_reach_at_first_are_fitted(noisy):
    def clip(y, x):
        return np.clip(y, -0.9, 0.9), np.clip(0.99 * x - 0.02, -0.9, 0.9)

    log = voltages(sigma=3e-4 if noisy else 0.0, clip=clip)
    if not noisy:
        columns = {c: log.array(c).copy() for c in log.columns}
        off = (np.abs(columns["v_sin_v"]) < 0.9) & (np.abs(columns["v_cos_v"]) < 0.9)
        for c in ("v_sin_v", "v_cos_v"):
            columns[c] += np.where(off, 3e-4 * np.random.default_rng(1).standard_normal(len(off)), 0.0)
            columns[c] = np.clip(columns[c], -0.9, 0.9)
        log = Log.from_arrays(columns, Noise.given({"v_sin_v": 3e-4, "v_cos_v": 3e-4}, log.columns))
    plain = hallsym.fit(log, "rotary", solver="direct")
    assert plain.goodness.sentence
    assert "clipped" in {claim.name for claim in plain.claims}
    text = "saturation:low_v=-0.9/-0.9,high_v=0.9/0.9"
    fit = hallsym.fit(log, "rotary", effects=[text], solver="direct")
    for name, value in {"Ax": 0.99, "Vx": -0.02, "Ay": 1.0, "clipped_sin": 1.0, "clipped_cos": 1.0}.items():
        assert fit.value(name) == pytest.approx(value, abs=1e-3)
    assert fit.solver.cost_per_degree_of_freedom < 1.5


# -- direction and zero ------------------------------------------------------------------------------------


def test_the_side_that_an_encoder_is_seen_from_is_no_gap():
    """Fit and diagnosis take it alike; only where a log states its model has the sign a right one."""
    log = voltages(sine=-1)
    fit = hallsym.fit(log, "rotary", solver="direct")
    assert any("turns against" in note for note in fit.notes)
    found = diagnose(log, "rotary")
    assert (found.verdict, found.ranked) == ("no gap", ())
    assert any("turns against" in note for note in found.notes)
    stated = diagnose(voltages(sine=-1, meta=Meta(base_model="rotary")))
    assert set(stated.groups[0]) == {"sign_inversion", "channel_swap"}


@pytest.mark.slow
def test_evaluate_says_another_zero_and_takes_it_out(tmp_path, capsys):
    calib, other = tmp_path / "calib.json", tmp_path / "other.csv"
    assert main(["fit", str(knots(tmp_path / "a.csv")), *KNOTS, "-o", str(calib)]) == 3  # 50 waves a turn
    head, *rows = (tmp_path / "a.csv").read_text().splitlines()
    turned = [f"{c},{(float(r) + 266) % 360:.1f}" for c, r in (row.split(",") for row in rows)]
    other.write_text("\n".join([head, *turned]) + "\n")
    capsys.readouterr()
    assert main(["evaluate", str(calib), str(other), *KNOTS]) == 1
    said = capsys.readouterr().out
    assert float(re.search(r"all samples +([\d.]+)", said)[1]) == pytest.approx(94.0, abs=0.5)
    assert re.search(r"angle_ref_rad counts from another zero .* \+9[34]\.\d+\. .*--own-zero", said)
    assert main(["evaluate", str(calib), str(other), *KNOTS, "--own-zero"]) == 3
    said = capsys.readouterr().out
    assert float(re.search(r"all samples +([\d.]+)", said)[1]) < 0.2
    assert "The errors are without it" in said
    assert main(["evaluate", str(calib), str(tmp_path / "a.csv"), *KNOTS]) == 3
    assert "another zero" not in capsys.readouterr().out


@pytest.mark.parametrize("decoded", [False, True], ids=["voltages", "angle"])
def test_runs_of_several_zeros_are_judged_each_from_its_own(decoded):
    log = voltages()
    columns = {c: log.array(c) for c in log.columns}
    homes = np.array([0.0, 2.0, -3.1, 1.0])[columns["run"].astype(int)]
    if decoded:
        columns["angle_rad"] = np.mod(np.arctan2(columns.pop("v_sin_v"), columns.pop("v_cos_v")), TURN)
    fit = hallsym.fit(Log.from_arrays(columns), "rotary", solver="direct")
    homed = Log.from_arrays({**columns, "angle_ref_rad": columns["angle_ref_rad"] + homes})
    noise = fit.noise.std
    table = judged(homed, fit.model, fit.values, noise, own_zero=True).table
    assert table.over()["rmse"]["angle_rad"] == pytest.approx(rmse(fit), rel=0.02)
    assert judged(homed, fit.model, fit.values, noise).table.over()["rmse"]["angle_rad"] > 1.0


# -- logs beside the repository ----------------------------------------------------------------------------


@needs(UNDULATOR)
def test_a_smooth_recording_has_no_spikes_and_its_scale_is_found():
    """Undulator: the period is 52.5186 mm where 52.5 was said, 355 ppm; 0.3 deg of magnet errors are left."""
    found = diagnose(read_log(UNDULATOR, columns={"angle_ref_deg": "ref_deg"}), "rotary")
    assert found.verdict == "unexplained"
    (scale,) = (e.parameters["scale"] for e in found.effects if e.name == "reference_scale_error")
    # the effect is fitted on every other stretch: 9.5 of 19 periods, each with an error of its own
    expected = np.radians(0.3) * np.sqrt(12 / 9.5) / (19 * TURN)
    assert scale.std == pytest.approx(expected, rel=0.3)
    assert abs(scale.value - 355e-6) < 2 * scale.std
    assert not any("left out" in note and "5" in note.split()[0] for note in found.notes)


@needs(CASES / "encoders")
@pytest.mark.parametrize(
    ("name", "effects", "most_deg"),
    [
        ("amplitude_0.6v", (), 0.0100),
        ("reference_scale_500ppm_two_voltages", ("reference_scale_error",), 0.0120),
        ("reference_scale_500ppm_angle", ("reference_scale_error",), 0.0014),
    ],
)
def test_encoders_that_are_perfect_but_for_one_thing(name, effects, most_deg):
    fit = hallsym.fit(
        read_log(CASES / "encoders" / f"{name}.csv"), "rotary", effects=effects, solver="direct"
    )
    assert rmse(fit) < np.radians(most_deg)
    if not effects:
        assert rmse(fit, "designed") < np.radians(most_deg)
