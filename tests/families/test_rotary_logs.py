"""Logs of encoders: both forms, wraps, directions, counts, and one clear sentence for each bad one."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from beside import CASES, REAL, needs
from test_rotary import ANGLE, TURN, angle_log, plates, voltage_log, wrap

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import diagnose
from hallsym.errors import InputError
from hallsym.families import build, default_model
from hallsym.log import Log, Meta, Noise, check_log
from hallsym.report.results.fit import circumstances

V = {"Vx": 0.01, "Vy": -0.02, "Ax": 1.01, "Ay": 0.98, "beta": 0.004, "zero": 3.1}
FORTH = np.linspace(0, 3 * TURN, 500)
BOTH = np.r_[FORTH, FORTH[::-1]]
LUTS, RESOLVER = REAL / "rotary-mechaduino-luts", REAL / "rotary-resolver-amci"


def fitted(log: Log, **options):
    return hallsym.fit(log, "rotary", solver="direct", **options)


def test_the_form_follows_from_the_columns():
    assert build("rotary", meta=voltage_log(V, BOTH).meta).channels == ("v_sin_v", "v_cos_v")
    assert build("rotary", meta=angle_log(V, BOTH).meta).channels == ("angle_rad",)
    assert default_model(angle_log(V, BOTH).meta) == "rotary"
    assert default_model(Meta(columns=("x_ref_m", "z_m", "rx_rad", "ry_rad"))) == "stage31"
    assert default_model(Meta(columns=("x_ref_m",))) == "stage30"  # its gains follow no height, no tilts
    with pytest.raises(InputError, match=r"neither a stage .* nor an encoder .*; map columns with --column"):
        default_model(Meta(columns=("run", "t_s")))
    assert build("ellipse").name == "rotary"
    assert build("ideal_arctan").name == "rotary_ideal"
    chosen = build("rotary", meta=Meta(probes=[{"channel": "angle_rad"}]))
    assert chosen.layout == ANGLE
    stated = build("rotary", meta=Meta(nominal={"amplitude_v": 0.6, "Ax": 0.7, "magnet": "N42"}))
    assert [stated.named(stated.nominal)[name] for name in ("Ax", "Ay")] == [0.7, 0.6]


@pytest.mark.parametrize("make", [angle_log, voltage_log])
@pytest.mark.parametrize("wrap_reference", [False, True])
@pytest.mark.parametrize("zero", [-3.14, 0.0, 3.13])
def test_turns_wraps_and_any_zero(make, wrap_reference, zero):
    log = make(V | {"zero": zero}, BOTH, 1e-4)
    if wrap_reference:
        columns = {c: log.array(c) for c in log.columns if c != "run"}
        log = Log.from_arrays(columns | {"angle_ref_rad": wrap(columns["angle_ref_rad"])})
    fit = fitted(log)
    assert abs(wrap(fit.value("zero") - zero)) < 1e-4
    assert fit.errors.rows()["fitted"]["rmse"]["angle_rad"] < 1.3e-4


@pytest.mark.parametrize("make", [angle_log, voltage_log])
def test_an_encoder_that_turns_against_its_reference(make, tmp_path):
    log = make(V, -BOTH, 1e-4)
    columns = {c: log.array(c) for c in log.columns if c != "run"}
    log = Log.from_arrays(columns | {"angle_ref_rad": BOTH})
    fit = fitted(log)
    assert fit.assignment[0][1] == -1
    assert any("turns against" in note for note in fit.notes)
    assert fit.errors.rows()["fitted"]["rmse"]["angle_rad"] < 1.3e-4
    fit.save(tmp_path / "calib.json")
    hallsym.write_log(log, tmp_path / "log.csv")
    assert main(["evaluate", str(tmp_path / "calib.json"), str(tmp_path / "log.csv"), "--json"]) == 0


def test_the_noise_floor_is_that_of_the_decoded_angle():
    log = voltage_log({"Ax": 2.0, "Ay": 2.0}, BOTH, 1e-3)
    sigma = {"v_sin_v": 1e-3, "v_cos_v": 1e-3, "angle_ref_rad": 3e-4}
    noise = hallsym.Noise({c: hallsym.log.Sigma(s, "given") for c, s in sigma.items()})
    known = Log.from_arrays({c: log.array(c) for c in log.columns if c != "run"}, noise)
    assert fitted(known).noise_floor["angle_rad"] == pytest.approx(np.hypot(5e-4, 3e-4), rel=1e-3)


# -- bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [angle_log, voltage_log])
@pytest.mark.parametrize(
    ("reference", "a", "says"),
    [
        (None, np.linspace(0, 1.2, 300), "covers only .* of a turn; .*record at least one full turn"),
        (lambda a: a**2 / 3, FORTH, "does not follow angle_ref_rad"),
    ],
)
def test_references_that_tell_no_encoder_are_claims(make, reference, a, says):
    log = make(V, a, 1e-4)
    if reference:
        columns = {c: log.array(c) for c in log.columns if c != "run"}
        log = Log.from_arrays(columns | {"angle_ref_rad": reference(a)})
    said = [claim.text for claim in fitted(log).claims]
    assert any(re.search(says, text) for text in said), said
    assert all(text.count(". ") == 0 for text in said)


STATED = {"angle_rad": 1e-4, "v_sin_v": 1e-4, "v_cos_v": 1e-4, "angle_ref_rad": 1e-5}


def stated(columns):
    return Log.from_arrays(columns, Noise.given({c: s for c, s in STATED.items() if c in columns}, columns))


@pytest.mark.parametrize(
    ("make", "reference", "a", "correction"),
    [
        pytest.param(angle_log, lambda a: 2 * a, BOTH, "scale angle_ref_rad 0.5", marks=pytest.mark.slow),
        (voltage_log, lambda a: a / 7, 7 * BOTH, "scale angle_ref_rad 7"),
        (angle_log, lambda a: np.degrees(a) % 360, BOTH, "scale angle_ref_rad deg"),
        pytest.param(voltage_log, np.degrees, BOTH, "scale angle_ref_rad deg", marks=pytest.mark.slow),
    ],
)
def test_a_reference_of_another_scale_is_claimed_with_what_puts_it_right(make, reference, a, correction):
    log = make(V, a, 1e-4)
    columns = {c: log.array(c) for c in log.columns if c != "run"} | {"angle_ref_rad": reference(a)}
    first = fitted(stated(columns)).claims[0]
    assert f"--correct '{correction}'" in first.text
    right = fitted(stated(columns), corrections=[correction])
    assert not right.claims
    assert right.value("beta") == pytest.approx(V["beta"], abs=1e-4)


def test_parts_of_a_turn_may_be_repeated():
    """Each pass ends where the next one does not begin: no wrap of the reference, which the encoder shows."""
    a = np.tile(np.linspace(0, 0.8 * TURN, 200), 4)
    for make in (angle_log, voltage_log):
        assert fitted(make(V, a, 1e-4)).value("beta") == pytest.approx(V["beta"], abs=1e-3)


def test_spikes_do_not_hide_how_an_encoder_turns():
    y, x = plates(V, BOTH)
    y, x = (v + 2e-4 * np.random.default_rng(k).standard_normal(len(v)) for k, v in enumerate((y, x)))
    y[50::80] = 100.0
    fit = fitted(Log.from_arrays({"v_sin_v": y, "v_cos_v": x, "angle_ref_rad": BOTH}))
    assert fit.value("Ay") == pytest.approx(V["Ay"], rel=1e-3)


def test_voltages_of_another_scale_are_claimed():
    """Amplitudes of 10 uV lie beyond their bounds; which power of ten is meant, no log tells."""
    log = voltage_log(V, BOTH, 1e-4)
    columns = {c: log.array(c) for c in log.columns if c != "run"}
    columns |= {c: 1e-5 * columns[c] for c in ("v_sin_v", "v_cos_v")}
    noise = Noise.given({"v_sin_v": 1e-9, "v_cos_v": 1e-9, "angle_ref_rad": 1e-5}, list(columns))
    (claim,) = fitted(Log.from_arrays(columns, noise)).claims
    assert (claim.name, claim.columns) == ("scale", ("v_sin_v", "v_cos_v"))
    assert claim.explains > 0.9


def test_rows_in_no_order_need_a_stated_noise():
    """Differences of shuffled knots are no noise: 50 deg of it, and every parameter at its nominal value."""
    log = angle_log(V, np.arange(200) * TURN / 200, 1e-4)
    order = np.random.default_rng(5).permutation(200)
    columns = {c: log.array(c)[order] for c in ("angle_rad", "angle_ref_rad")}
    said = [claim.text for claim in fitted(Log.from_arrays(columns)).claims]
    assert any(re.search(r"in no order .* sort them by angle_ref_rad, or state the noise", t) for t in said)
    stated = Noise.given({"angle_rad": 1e-4, "angle_ref_rad": 1e-5}, list(columns))
    assert fitted(Log.from_arrays(columns, stated)).value("beta") == pytest.approx(V["beta"], abs=1e-3)


def test_noise_that_is_estimated_too_large_is_said():
    """A sample every 1.7 rad: differences of the angle's error are no noise, and what is left shows it."""
    log = angle_log(V, 1.7 * np.arange(1000), 1e-4)
    fit = fitted(Log.from_arrays({c: log.array(c) for c in log.columns if c != "run"}))
    said = "; ".join(circumstances(fit))
    assert "noise was estimated" in said
    assert "state it with --noise" in said
    assert "noise was estimated" not in "; ".join(circumstances(fitted(angle_log(V, BOTH, 1e-4))))


def test_one_direction_and_a_gap_are_said():
    fit = fitted(angle_log(V, np.linspace(0, TURN * 0.85, 300), 1e-4))
    assert any("one direction only: hysteresis looks" in n and "not observable" in n for n in fit.notes)
    assert not any("latency" in n for n in fit.notes)  # without time there is none
    assert any("No sample lies in 50 deg of the turn" in n for n in fit.notes)
    assert not any("direction" in n for n in fitted(angle_log(V, BOTH, 1e-4)).notes)


def counts(tmp_path: Path, text: str = "", header: str = "raw,ref") -> Path:
    a = BOTH
    y, x = plates(V, a)
    raw = np.mod(np.arctan2(y, x), TURN) / TURN * 4096
    file = tmp_path / "enc.csv"
    rows = "\n".join(f"{c:.2f},{r:.6f}" for c, r in zip(raw, np.degrees(a), strict=True))
    file.write_text(f"{header}\n{text}{rows}\n")
    return file


MAPPED = {"angle_count": "raw", "angle_ref_deg": "ref"}


def test_counts_become_angles(tmp_path):
    file = counts(tmp_path)
    log = hallsym.read_log(file, columns=MAPPED, counts_per_turn=4096)
    assert np.ptp(log.array("angle_rad")) == pytest.approx(TURN, abs=0.05)
    (tmp_path / "c.toml").write_text(
        'counts_per_turn = 4096\n[columns]\nangle_count = "raw"\nangle_ref_deg = "ref"\n'
    )
    same = hallsym.read_log(file, column_file=tmp_path / "c.toml")
    assert np.array_equal(same.array("angle_rad"), log.array("angle_rad"))
    (tmp_path / "log").mkdir()
    file.rename(tmp_path / "log" / "log.csv")
    (tmp_path / "log" / "meta.json").write_text(json.dumps({"counts_per_turn": 4096}))
    meta = hallsym.read_log(tmp_path / "log", columns=MAPPED)
    assert np.array_equal(meta.array("angle_rad"), log.array("angle_rad"))
    assert abs(fitted(meta).value("beta") - V["beta"]) < 1e-3


@pytest.mark.parametrize(
    ("per_turn", "says"),
    [
        (None, "is an angle in counts; say how many make a turn with --column angle_count="),
        (0, "must be a number of 2 or more"),
        (float("nan"), "must be a number of 2 or more"),
    ],
)
def test_counts_that_cannot_be(tmp_path, per_turn, says):
    with pytest.raises(InputError, match=says):
        hallsym.read_log(counts(tmp_path), columns=MAPPED, counts_per_turn=per_turn)


def test_counts_of_another_resolution_are_said_by_the_fit(tmp_path):
    log = hallsym.read_log(counts(tmp_path), columns=MAPPED, counts_per_turn=1024)
    assert "--correct 'scale angle_rad 0.25'" in fitted(log).claims[0].text


def test_signed_counts_are_a_turn_too():
    a = np.linspace(-np.pi, np.pi, 200)
    raw = np.round(a / TURN * 4096)
    file = {"angle_rad": raw / 4096 * TURN, "angle_ref_rad": a}
    assert check_log(Log.from_arrays(file)) == []  # and a table without time lacks no runs


# -- the command line ------------------------------------------------------------------------------------


def test_a_campaign_that_moves_what_a_model_lacks_is_refused():
    with pytest.raises(InputError, match=r"moves .*, which rotary has not; it has angle_rad"):
        hallsym.simulate(build("rotary"), {}, hallsym.paper_campaign(), seed=1)


# -- logs beside the repository --------------------------------------------------------------------------


@needs(CASES / "labels.json")
@pytest.mark.parametrize(
    "case", ["dev_016", *(pytest.param(f"dev_0{k}", marks=pytest.mark.slow) for k in range(17, 21))]
)
def test_cases_of_another_plant_give_the_gap_that_they_state(case):
    label = json.loads((CASES / "labels.json").read_text())[case]
    log = hallsym.read_log(CASES / "dev" / case)
    fit = hallsym.fit(log, solver="direct", loss="none")
    stated = label["noisy"]["before"]["output_rmse"]["angle_rad"]
    assert fit.errors.rows()["holdout"]["rmse"]["angle_rad"] == pytest.approx(stated, rel=0.02)


def apart(log: Log, held: np.ndarray) -> Log:
    """Run 0: the knots to fit; run 1: those held out."""
    order = np.argsort(held, kind="stable")
    columns = {c: log.array(c)[order] for c in ("angle_rad", "angle_ref_rad")}
    return Log.from_arrays({"run": held[order].astype(int), **columns})


@needs(LUTS)
@pytest.mark.slow
def test_recorded_encoders_calibrate_to_what_their_reference_repeats():
    """AS5047D on stepper motors: held-out knots keep what knots keep that were fitted themselves.

    What is left is the pattern of the steps of the reference, four knots to a pole pair: of every second knot
    the fit sees one phase and takes its mean for the zero, so that a step pattern counts twice between them.
    """
    columns = {"angle_count": "raw_count", "angle_ref_deg": "ref_angle_deg"}
    for file in sorted(LUTS.glob("*.csv")):
        log = hallsym.read_log(file, columns=columns, counts_per_turn=16384)
        a, r, k = log.array("angle_rad"), log.array("angle_ref_rad"), np.arange(log.rows)
        e = wrap(a - r - np.angle(np.exp(1j * (a - r)).mean()))
        waves = [f(n * r) for n in range(1, 9) for f in (np.cos, np.sin)]
        basis = np.column_stack([np.ones(len(r)), *waves])
        rest = float(np.std(e - basis @ np.linalg.lstsq(basis, e, rcond=None)[0]))
        for held, most in ((k % 2, 2.0), (k // 4 % 2, 1.1)):
            split = apart(log, held)
            fit = hallsym.fit(split, "rotary", effects=["harmonics"], holdout=[1], solver="direct")
            assert fit.errors.rows()["holdout"]["rmse"]["angle_rad"] < most * rest, file.name


@needs(RESOLVER)
@pytest.mark.parametrize(
    ("name", "most"),
    [("divider_on_excitation", 2.0), pytest.param("normal_connection", 6.0, marks=pytest.mark.slow)],
)
def test_a_recorded_resolver_loads_as_it_is(name, most):
    columns = {"angle_deg": "resolver_deg", "angle_ref_deg": "ref_deg", "speed_deg_s": "vel_deg_s"}
    log = hallsym.read_log(RESOLVER / f"{name}.csv", columns=columns, drop_bad=True)
    fit = hallsym.fit(log, "rotary", solver="direct", drop_bad=True)
    assert fit.errors.rows()["fitted"]["rmse"]["angle_rad"] < np.radians(most)
    assert not any("isolated spikes" in note for note in fit.notes)  # it rests half of the time


@needs(RESOLVER)
@pytest.mark.slow
def test_a_recorded_resolver_is_overdriven_late_and_its_reference_short():
    columns = {"angle_deg": "resolver_deg", "angle_ref_deg": "ref_deg"}
    for name, clipped in (("normal_connection", True), ("divider_on_excitation", False)):
        log = hallsym.read_log(RESOLVER / f"{name}.csv", columns=columns)
        d = diagnose(log, "rotary")
        assert (d.ranked[0] == "saturation") == clipped, name
        found = {e.name: {n: p.value for n, p in e.parameters.items()} for e in d.effects}
        (late,) = (v for n in ("time_skew", "first_order_lag") if n in found for v in found[n].values())
        assert late == pytest.approx(latency(log), abs=4e-4), name
        assert found["reference_scale_error"]["scale"] == pytest.approx(0.003, abs=5e-4), name


def latency(log: hallsym.Log) -> float:
    """Return what goes with the speed in an error, beside 24 waves per turn and a slope."""
    t, turn = log.array("t_s"), log.array("angle_ref_rad")
    waves = [f(k * turn) for k in range(25) for f in (np.cos, np.sin)]
    columns = np.array([np.gradient(turn, t), turn, *waves]).T
    error = np.angle(np.exp(1j * (log.array("angle_rad") - turn)))
    late = -np.linalg.lstsq(columns, error, rcond=None)[0][0]
    assert late == pytest.approx(0.0345, abs=5e-4)  # of the published recordings: 34 ms, 2.45 deg at 36 deg/s
    return float(late)
