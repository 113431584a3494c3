"""Diagnoses of one turn: tables of knots and an overdriven input, made by numpy alone."""

import numpy as np
import pytest
from beside import REAL, needs
from scipy.ndimage import gaussian_filter1d

from hallsym.diagnosis import POLICY, diagnose, prepare
from hallsym.diagnosis.setup import split
from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.log import Log, check_log, read_log
from hallsym.report.views import summary

DEG = np.pi / 180
UNDULATORS = REAL / "linear-hall-undulators"


def table(waves: dict[int, tuple[float, float]], noise_deg: float = 0.01, seed: int = 0) -> Log:
    """200 knots of full steps; `waves`: per turn -> amplitude and phase [deg] of the angle error."""
    a = np.arange(200) * 1.8 * DEG
    error = sum(amp * np.cos(n * a - phase * DEG) for n, (amp, phase) in waves.items())
    error = error + np.random.default_rng(seed).normal(0, noise_deg, 200)
    return Log.from_arrays({"angle_ref_rad": a, "angle_rad": a + 0.3 + error * DEG})


def overdriven(rail: float | None, delay_s: float, scale: float) -> Log:
    """One turn forward and back at 36 deg/s: both channels at a rail, old readings, a short reference."""
    t = np.arange(2100) * 0.01
    a = np.clip(np.minimum(t - 0.25, 20.75 - t), 0, 10) * 36 * DEG
    late = np.interp(t - delay_s, t, a) * (1 + scale)
    y, x = np.sin(late + 0.28), np.cos(late + 0.28)
    if rail is not None:
        y, x = np.clip(y, -rail, rail), np.clip(x, -rail, rail)
    read = np.unwrap(np.arctan2(y, x)) + np.random.default_rng(1).normal(0, 2e-5, len(t))
    return Log.from_arrays({"t_s": t, "angle_ref_rad": a, "angle_rad": read})


LIKE_A_TABLE = {1: (1.1, 200.0), 2: (0.51, 80.0), 4: (0.35, 30.0), 50: (0.082, 60.0)}


@pytest.fixture(scope="module")
def of_a_table():
    return diagnose(table(LIKE_A_TABLE), "rotary_ideal")


@pytest.mark.slow
def test_a_knot_that_is_a_spike_is_judged_among_its_neighbours(of_a_table):
    """One knot off by 3 deg goes and changes no name; a pattern of four knots has none."""
    assert not any("spike" in note for note in of_a_table.notes)
    clean = table(LIKE_A_TABLE)
    angle = clean.array("angle_rad").copy()
    angle[57] += 3 * DEG
    off = Log.from_arrays({"angle_ref_rad": clean.array("angle_ref_rad"), "angle_rad": -angle})
    found = diagnose(off, "rotary_ideal")
    assert "1 of 200 knots is an isolated spike and was left out." in found.notes
    assert found.verdict == of_a_table.verdict
    assert {e.name for e in found.effects} == {e.name for e in of_a_table.effects}
    assert found.metric.after < 1.3 * of_a_table.metric.after


@pytest.mark.slow
def test_a_table_is_taken_apart_by_its_waves(of_a_table):
    """One, two and four waves a turn by causes that make them, the stepper's pattern by the reference."""
    d = of_a_table
    assert d.verdict == "explained"
    assert {"third_harmonic_distortion", "reference_pole_pairs"} <= {e.name for e in d.effects}
    known = {w.per_turn: w.causes for w in d.waves}
    for n in (1, 2):
        assert {e.name for e in d.effects} & set(known[n]), n
    (pattern,) = (e for e in d.effects if e.name == "reference_pole_pairs")
    assert pattern.link == "reference"
    for e in d.effects:  # offset and eccentricity, 8 deg each against each other, would fit as well
        for name, p in e.parameters.items():
            assert name in ("mirrored", "turned") or abs(p.value) < 2 * 1.3 * DEG, (e.name, name, p.value)
    size = [p.value for p in pattern.parameters.values()]
    assert np.degrees(np.hypot(*size)) == pytest.approx(LIKE_A_TABLE[50][0], rel=0.05)
    assert d.not_testable["time_skew"] == "no time logged"
    assert d.shrinkage.value > 0.8
    assert any("every other one as holdout" in note for note in d.notes)
    assert np.degrees(d.metric.after) < 0.02


@pytest.mark.slow
def test_waves_are_what_was_put_in(of_a_table):
    """Amplitudes to what the noise leaves (0.01 deg over 200 knots: 1.4 mdeg of standard deviation)."""
    found = {w.per_turn: w for w in of_a_table.waves}
    assert set(LIKE_A_TABLE) <= set(found)
    for n, (amp, _) in LIKE_A_TABLE.items():
        assert np.degrees(found[n].designed) == pytest.approx(amp, abs=0.006)
        assert np.degrees(found[n].after) < 0.01
    assert not any(w.absorbed for w in found.values())


@pytest.mark.slow
def test_what_the_ellipse_takes_up_is_said():
    d = diagnose(table(LIKE_A_TABLE), "rotary")
    found = {w.per_turn: w for w in d.waves}
    assert found[1].absorbed
    assert found[2].absorbed
    assert not found[4].absorbed
    words = " ".join(summary(d).split())
    assert "The largest harmonic is 1 per turn (1.1 deg). The model's own parameters absorb it" in words
    assert "whichever causes it: offset_error" in words
    assert d.to_dict()["waves"][0]["per_turn"] == 1


def test_waves_of_no_known_cause_are_no_cause():
    d = diagnose(table({6: (0.06, 10.0), 7: (0.06, 50.0), 9: (0.05, 0.0)}), "rotary")
    assert (d.verdict, d.effects) == ("unexplained", ())


@pytest.mark.slow
def test_an_overdriven_input_is_clipping_beside_latency_and_a_short_reference():
    """As of a resolver: 4x of 8 deg by the rails, 34 ms from forward against backward, 0.86 deg in a turn."""
    d = diagnose(overdriven(0.654, 0.034, -0.0024), "rotary")
    assert d.metric.after < 0.02 * d.metric.before
    assert d.verdict == "unexplained"  # what is left is 14 times the noise floor
    assert d.ranked[0] == "saturation"
    assert d.effects[0].p_value < 1e-3  # 1,999 flips of signs show no less than 5e-4
    found = {e.name: {n: p.value for n, p in e.parameters.items()} for e in d.effects}
    assert found["saturation"]["rail"] == pytest.approx(0.654, abs=0.003)
    assert found["saturation"]["clipped"] == pytest.approx(1.0, abs=0.02)
    (late,) = (v for n in ("time_skew", "first_order_lag") if n in found for v in found[n].values())
    assert late == pytest.approx(0.034, abs=0.001)
    assert found["reference_scale_error"]["scale"] == pytest.approx(0.0024, abs=2e-4)
    assert {e.link for e in d.effects if e.name == "reference_scale_error"} == {"reference"}


@pytest.mark.slow
def test_the_same_delay_is_called_by_its_usual_name():
    """At one speed a delay and a low-pass are the same: one group, the delay first."""
    d = diagnose(overdriven(None, 0.034, -0.0024), "rotary")
    assert d.ranked[0] == "time_skew"
    assert ("time_skew", "first_order_lag") in d.groups
    assert "saturation" not in (*d.ranked, *(s.name for s in d.smaller_findings))
    assert not any("differs between runs" in note for note in d.notes)  # it is one recording


@pytest.mark.parametrize("knots", [200, 400])
def test_groups_of_knots_go_round_the_turn_and_see_every_phase_of_a_stepper(knots):
    a = np.arange(knots) * 2 * np.pi / knots
    log, held = split(Log.from_arrays({"angle_ref_rad": a, "angle_rad": a}), POLICY)
    assert sum(log.array("run")[k] in held for k in range(knots)) == knots // 2
    for run in set(log.runs) - set(held):
        at = log.array("t_s")[log.array("run") == run].astype(int)
        assert np.diff(at).max() <= knots // 6
        assert set(at % 4) == {0, 1, 2, 3}


@pytest.mark.parametrize(("samples", "slices"), [(900, 22), (2000, 50), (4535, 100), (60_000, 100)])
def test_a_recording_is_taken_as_many_slices_of_forty_samples_or_more(samples, slices):
    t = 1e-3 * np.arange(samples)
    log, held = split(Log.from_arrays({"t_s": t, "angle_ref_rad": t, "angle_rad": t}), POLICY)
    assert (len(log.runs), len(held)) == (slices, slices // 2)
    assert np.bincount(log.array("run").astype(int)).min() >= 40
    assert np.array_equal(log.array("t_s"), t)  # in the order of the recording


def test_a_slice_that_turns_back_smoothly_is_not_clipped():
    """By itself it would look so: an arc to one side of which the reading hardly changes."""
    t = 1e-3 * np.arange(1200)
    rng = np.random.default_rng(16)
    hz, size = rng.uniform(0.3, 2), rng.uniform(2, 12)
    a = size * np.sin(2 * np.pi * hz * t)
    volts = {c: f(a) + rng.normal(0, 6e-4, len(t)) for c, f in (("v_sin_v", np.sin), ("v_cos_v", np.cos))}
    log, held = split(Log.from_arrays({"t_s": t, "angle_ref_rad": a, **volts}), POLICY)
    found = fit(log, "ellipse", solver="direct", holdout=held, accept=["all"])
    assert found.errors
    assert found.claims == ()


@pytest.mark.parametrize("knots", [48, 100, 175])
@pytest.mark.parametrize("timed", [False, True])
def test_a_short_recording_is_taken_to_fewer_pieces_that_each_can_be_a_run(knots, timed):
    a = np.arange(knots) * 2 * np.pi / knots
    time = {"t_s": 1e-3 * np.arange(knots)} if timed else {}
    log, held = split(Log.from_arrays({**time, "angle_ref_rad": a, "angle_rad": a}), POLICY)
    sizes = np.bincount(log.array("run").astype(int))
    assert sizes.min() >= 8
    assert len(sizes) == 2 * len(held) >= 6
    assert log.rows == knots


def test_magnet_errors_that_repeat_nowhere_foretell_no_other_stretch():
    """A smooth line over 39 periods: knots beside each other know each other's error, stretches do not."""
    a, rng = np.arange(3900) * 2 * np.pi / 100, np.random.default_rng(7)
    slow = gaussian_filter1d(rng.standard_normal(len(a)), 30)
    angle = a + 6e-3 * slow / slow.std() + rng.normal(0, 2e-5, len(a))
    found = diagnose(Log.from_arrays({"angle_ref_rad": a, "angle_rad": angle}), "rotary")
    assert any("stretches of" in note for note in found.notes)
    assert found.verdict != "explained"
    assert found.shrinkage.interval is None or found.shrinkage.interval[0] < 0
    runs = prepare(table(LIKE_A_TABLE), "rotary").log
    assert any("groups of single knots" in note for note in runs.notes)


@needs(UNDULATORS)
@pytest.mark.slow
def test_a_measured_line_is_held_out_in_stretches():
    """Three lines of undulators; interleaved knots said 30.5 to 30.6 % of the first."""
    for name in ("carnauba_two_probes_5.5mm", "delta_sabia_phase04_raw_x0", "deltaB_phase07_x0"):
        found = diagnose(read_log(UNDULATORS / f"{name}.csv", columns={"angle_ref_deg": "ref_deg"}), "rotary")
        assert found.verdict == "unexplained"
        assert any("stretches of" in note for note in found.notes)
        low, high = found.shrinkage.interval or (0.0, 1.0)
        assert high - low > 0.2


def test_a_table_too_short_to_diagnose_is_refused_without_a_word_on_runs():
    a = np.linspace(0.0, 6.2, 40)
    with pytest.raises(InputError, match=r"has 40 samples, too few to hold any out .* at least 48\.$"):
        diagnose(Log.from_arrays({"angle_ref_rad": a, "angle_rad": a}), "rotary")
    with pytest.raises(InputError, match=r"must have at least 8 samples; it has 5"):
        check_log(Log.from_arrays({"angle_ref_rad": a[:5], "angle_rad": a[:5]}))
