"""Channels that are exchanged, inverted or beside a reference that is not theirs: refused, or put right."""

from itertools import permutations, product

import numpy as np
import pytest
from twins import COLUMNS, HALL, SIGMAS, record, same, with_noise

from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.estimation.factors import summarise
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.plausible import responses_of, wiring_of
from hallsym.families.stage.models import stage31
from hallsym.log.quality.gains import judge_gains

WIRINGS = [(p, s) for p in permutations(range(3)) for s in product((1, -1), repeat=3)]
QUICK = [WIRINGS[0], ((1, 0, 2), (1, 1, 1)), ((2, 0, 1), (1, -1, 1))]


@pytest.fixture(scope="module")
def unequal():
    """A log whose channels differ in noise, so that noise has to follow its channel."""
    sigma = {**SIGMAS, "hall_a_m": 0.3e-6, "hall_b_m": 0.6e-6, "hall_c_m": 1.2e-6}
    columns = record(seed=4, samples=20, sigma=sigma)
    return columns, sigma, fit(with_noise(columns, sigma), "stage31", solver="direct")


@pytest.mark.parametrize(
    ("order", "signs"),
    [pytest.param(*w, marks=pytest.mark.slow if k % 5 else ()) for k, w in enumerate(WIRINGS)],
    ids=str,
)
def test_every_wiring_is_seen(unequal, order, signs):
    """Channel HALL[k] carries probe order[k] times signs[k]; linear least squares alone tells."""
    columns, sigma, _ = unequal
    mixed = columns | {
        HALL[k]: s * columns[HALL[c]] for k, (c, s) in enumerate(zip(order, signs, strict=True))
    }
    log = with_noise(mixed)
    expected = tuple((HALL[order.index(k)], signs[order.index(k)]) for k in range(3))
    wrong = order != (0, 1, 2) or signs != (1, 1, 1)
    seen = judge_gains(log, responses_of(cost_of(summarise(log, stage31()), sigma))).whole
    assert wiring_of(seen) == (expected if wrong else None)


@pytest.mark.parametrize(
    ("order", "signs"),
    [
        pytest.param(*w, marks=() if w in QUICK else pytest.mark.slow, id=str(w))
        for w in dict.fromkeys([*QUICK, *WIRINGS[1::5]])
    ],
)
def test_every_wiring_is_refused_or_resolved(unequal, order, signs):
    """The same optimum, errors and noise as with the right wiring."""
    columns, sigma, right = unequal
    mixed = dict(columns)
    stated = dict(sigma)
    for k, (source, sign) in enumerate(zip(order, signs, strict=True)):
        mixed[HALL[k]] = sign * columns[HALL[source]]
        stated[HALL[k]] = sigma[HALL[source]]
    log = with_noise(mixed, stated)
    wrong = [HALL[k] for k in range(3) if order[k] != k or signs[k] != 1]
    if wrong:
        with pytest.raises(InputError) as caught:
            fit(log, "stage31", solver="direct")
        assert all(channel in str(caught.value) for channel in wrong)
    result = fit(log, "stage31", solver="direct", resolve_wiring=True)
    same(right, result)
    assert result.solver["cost"] == pytest.approx(right.solver["cost"], rel=1e-9)
    for row in ("rmse", "peak"):
        for name, value in right.error_rows["fitted"][row].items():
            assert result.error_rows["fitted"][row][name] == pytest.approx(value, rel=1e-6)
    expected = tuple((HALL[order.index(k)], signs[order.index(k)]) for k in range(3))
    assert result.wiring == (expected if wrong else None)


def test_a_reference_that_does_not_belong_is_refused():
    columns = record(seed=1, samples=30)
    other = dict(columns)
    rng = np.random.default_rng(0)
    for c in COLUMNS[:3]:
        other[c] = rng.permutation(columns[c])
    with pytest.raises(InputError, match="does not belong"):
        fit(with_noise(other), "stage31", solver="direct")
