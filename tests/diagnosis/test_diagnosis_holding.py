"""What holds on held-out runs: effects that do not, decreases by chance, parameters that no sample shows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from test_diagnosis_rotary import HELD, machine, third

from hallsym import bundled_campaign
from hallsym.diagnosis import POLICY, diagnose, examine, prepare
from hallsym.diagnosis.curves import coordinates
from hallsym.diagnosis.refit import refit, with_model
from hallsym.diagnosis.residual_table import residual_table
from hallsym.diagnosis.selection import select
from hallsym.diagnosis.validation import Judged, cross_validated, groups_of
from hallsym.families import effects
from hallsym.families.rotary import FAMILY as ROTARY_FAMILY
from hallsym.log import Log

TURN = 2 * np.pi


def turn(seed=1, pattern=0.0, noise=1e-3, size=200, zero=0.0):
    """A table of knots: an ideal encoder, a stepper of 50 pole pairs as reference, no time."""
    rng = np.random.default_rng(seed)
    step = TURN * np.arange(size) / size + zero
    shaft = step - pattern * np.cos(50 * step + 0.4)
    columns = {
        "angle_rad": np.mod(shaft + noise * rng.standard_normal(size), TURN),
        "angle_ref_rad": np.mod(step, TURN),
    }
    return Log.from_arrays(columns, name="a knot table")


def judged(before, after, fewest=6):
    return Judged(
        np.asarray(before, dtype=float), np.asarray(after, dtype=float), replace(POLICY, fewest=fewest)
    )


@pytest.mark.parametrize("runs", [12, 40])
def test_the_interval_holds_new_recordings_of_as_many_runs(runs):
    """A gap of 1.3 times the noise, other motion in every run: 95 % of new shrinkages lie within."""
    rng = np.random.default_rng(runs)

    def recording():
        gap = rng.uniform(0.3, 1.1, runs)
        return np.array([gap + rng.chisquare(200, runs) / 200, rng.chisquare(200, runs) / 200])

    held = 0
    for _ in range(1000):
        low, high = judged(*recording()).interval()
        held += low < judged(*recording()).value < high
    assert held / 1000 == pytest.approx(0.95, abs=0.025)


def test_an_effect_that_lowers_every_run_holds_no_zero_and_chance_does():
    """One fast run gains most of it: the scatter about the mean says nothing against the others."""
    rng = np.random.default_rng(3)
    gap = np.append(rng.uniform(0.02, 0.1, 9), 3.0)
    low, high = judged(1 + gap, np.ones(10)).interval()
    assert 0 < low < 1 - np.sqrt(10 / (1 + gap).sum()) < high < 1 - 0.5
    wrong = [judged(a, b).interval()[0] > 0 for a, b in rng.chisquare(30, (1000, 2, 6))]
    assert np.mean(wrong) < 0.04  # 2.5 % on that side


def test_few_judges_give_no_interval_and_a_repair_scales_it():
    before, after = np.arange(10.0, 16.0), np.arange(10.0, 4.0, -1.0)
    assert judged(before[:5], after[:5]).interval() is None
    one, half = judged(before, after), judged(before, after).interval(0.5)
    low, high = one.interval()
    assert half == pytest.approx((1 - 0.5 * (1 - low), 1 - 0.5 * (1 - high)))
    assert low < one.value < high


@pytest.mark.slow
def test_a_wave_that_is_nil_at_every_knot_stays_at_its_nominal_value():
    """200 knots sample 100 waves at their crossings: the sine is 0 at each of them."""
    examined = examine(prepare(turn(pattern=1.5e-3), "rotary_ideal"))
    base = examined.before
    wide = effects(ROTARY_FAMILY)["reference_pole_pairs"](base.model, periods=(50, 100))
    fit = refit(with_model(base, wide), [r for r in base.log.runs if r not in base.holdout])
    k = fit.base.model.names.index("reference_pole_pairs_100_sin")
    assert fit.base.p[k] == 0.0
    assert fit.unseen() == (k,)
    assert k not in fit.at_bound()
    assert fit.uncertainty()[0][k, k] == 0.0
    assert not residue_names(base) & {"speed", "time in the campaign", "time since the start of the run"}
    assert "time in the campaign" in residue_names(replace(base, timed=True))


def residue_names(base):
    return {c.name for c in coordinates(residual_table(base, base.log.runs))}


@pytest.mark.slow
def test_the_choice_is_repeated_without_each_group_of_runs():
    """Without any group a clear effect is chosen again, and each run is judged by the others."""
    log = machine(third)
    setup = prepare(log, "ellipse")
    found = select(setup)
    groups = groups_of(setup.runs)
    squares = cross_validated(found.fit, groups, found.others)
    assert len(found.others) > 1
    assert squares == cross_validated(found.fit, groups)
    assert set(squares) == {(r,) for r in log.runs}
    held = [k for k, runs in enumerate(found.fit.tangents.runs) if runs[0] in setup.holdout]
    for k in held:
        assert squares[found.fit.tangents.runs[k]] == found.fit.output[k]
    own = cross_validated(found.fit, [frozenset({r}) for r in setup.runs])
    for k in found.fit.fitted:  # a run that was left out is predicted worse than it was fitted
        assert own[found.fit.tangents.runs[k]] > 0.999 * found.fit.output[k]
    # the runs without a group choose, not the first
    elsewhere = cross_validated(found.start, groups, [found.fit])
    assert all(elsewhere[run] == squares[run] for run in squares if run[0] in setup.runs)


def test_held_out_runs_take_no_part_in_the_choice():
    """The same fitted runs choose the same, whatever the holdout runs hold."""
    log = machine(third)
    columns = {c: log.array(c) for c in log.columns}
    spoiled = np.isin(columns["run"], HELD)
    worse = columns | {"v_sin_v": columns["v_sin_v"] + spoiled * 5e-3 * np.cos(7 * columns["angle_ref_rad"])}
    one, other = (
        select(prepare(Log.from_arrays(c, log.noise, log.meta), "ellipse")) for c in (columns, worse)
    )
    assert [e.name for e in one.effects] == [e.name for e in other.effects] == ["third_harmonic_distortion"]
    assert one.fit.base.p == pytest.approx(other.fit.base.p, rel=1e-9)


def test_runs_that_are_left_out_are_not_chosen_to_judge():
    log = bundled_campaign()
    dead = np.isin(log.array("run"), log.runs[2::5])
    columns = {c: log.array(c) for c in log.columns}
    columns["hall_a_m"] = np.where(dead, columns["hall_a_m"][0], columns["hall_a_m"])
    for drop_bad in (True, False):
        setup = prepare(Log.from_arrays(columns, log.noise, log.meta), "stage31", drop_bad=drop_bad)
        assert not set(setup.holdout) & set(log.runs[2::5])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_record_says_what_its_numbers_say(seed):
    """Knots with steps, slow errors and waves of any size: nothing is named that may do nothing."""
    rng = np.random.default_rng(seed)
    slow = gaussian_filter1d(rng.standard_normal(1200), 25)
    for size in 10 ** rng.uniform(-4, -2, 3):
        log = turn(pattern=size * rng.uniform(), noise=3e-4, size=1200)
        wave = size * slow / slow.std()
        log = Log.from_arrays({c: log.array(c) + wave * (c == "angle_rad") for c in log.columns})
        found = diagnose(log, "rotary")
        assert all(e.interval is None or e.interval[0] > 0 for e in found.effects)
        assert found.metric.after < found.metric.before or not found.effects
        assert ("falls to" in found.sentence) == bool(found.effects)
        assert set(found.ranked) >= {e.name for e in found.effects}
        assert found.verdict != "explained" or found.effects
