"""What holds on held-out runs: effects that do not, decreases by chance, parameters that no sample shows."""

from dataclasses import replace

import numpy as np
import pytest

from hallsym.diagnosis import (
    BlockErrors,
    coordinates,
    decrease_p,
    diagnose,
    examine,
    interval,
    prepare,
    refit,
    residual_table,
    with_model,
)
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


def blocks(sums):
    sums = np.asarray(sums, dtype=float)
    return BlockErrors(("angle_rad",), np.ones(1), np.full(len(sums), 10.0), sums[:, None], np.ones(1))


def test_a_decrease_by_chance_is_uniform_and_a_real_one_is_certain():
    rng = np.random.default_rng(0)
    draws = rng.chisquare(10, (2, 2000, 10))
    p = np.array([decrease_p(blocks(a), blocks(b)) for a, b in draws.swapaxes(0, 1)])
    for level in (0.05, 0.5):
        assert np.mean(p < level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / 2000))
    size = rng.uniform(1.0, 20.0, 10)  # a strong effect that differs from block to block
    assert decrease_p(blocks(size * draws[0, 0]), blocks(1e-2 * draws[1, 0])) < 1e-5


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
def test_what_is_named_shrinks_the_gap_on_the_held_out_runs(seed):
    found = diagnose(turn(seed, pattern=1.5e-3, noise=7e-4), "rotary")
    assert [e.name for e in found.effects] == ["reference_pole_pairs"]
    assert found.effects[0].interval[0] > 0
    named = {e.name for e in found.effects}
    assert not named & {s.name for s in found.smaller_findings}


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
    assert fit.covariance()[k, k] == 0.0
    assert not residue_names(base) & {"speed", "time in the campaign", "time since the start of the run"}
    assert "time in the campaign" in residue_names(replace(base, timed=True))


def residue_names(base):
    return {c.name for c in coordinates(residual_table(base, base.log.runs))}


@pytest.mark.parametrize("zero", [0.0, 2.0, 5.5])
def test_a_turn_goes_on_from_piece_to_piece(zero):
    whole = prepare(turn(zero=zero), "rotary").log
    assert np.ptp(whole.array("angle_ref_rad")) == pytest.approx(TURN * 199 / 200)


def test_an_interval_around_nothing_contains_it():
    rng = np.random.default_rng(5)
    a, b = rng.chisquare(10, (2, 12))
    low, high = interval(blocks(a), blocks(b))
    assert low < 0 < high
