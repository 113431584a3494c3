"""Units, signs and order of the columns of the state, by how they move the gains of the channels.

A gain that follows a rigid body's height z and tilts r does so by one slope and the place of its sensor:
d gain / d r over d gain / d z is the sensor's place less that of the point where z is measured
(`hallsym.model.Tie`). Places in the machine have a size; in another unit, they lie a thousand times outside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, permutations, product
from typing import Any

import numpy as np

from hallsym.log.quality.explain import Explanation, Units, change_of
from hallsym.log.quality.findings import Finding, name_of
from hallsym.log.quality.gains import listed, remedies, said, sentence
from hallsym.log.quality.responses import Coupling
from hallsym.log.quality.units import other_units
from hallsym.model import Model, Tie
from hallsym.model.response import Response, response_of

CERTAIN = 5.0
"""Standard deviations that a change of gain must differ from zero to be judged by."""
NEAR = 0.1
"""Part of the largest change of gain with a column by which another may have the wrong sign, and metres by
which a place may lie outside the machine."""
RARE = 3.0
"""A column is not what it says in one log of 10^3."""
ALSO = 0.5
"""The same for a further column of the same unit that is wrong in the same way."""
ODD = 9.0
"""A machine whose sensors lie elsewhere than the model allows is rarer than three such mistakes at once."""
DOUBLED = 1.0
"""Values that are too small, which takes a conversion done twice, are ten times as rare."""
MOST = 10.0
"""Decades against what is tried, at most: three mistakes at once."""
APART = 7.6
"""Half a unit on a scale of decades: 7.6 times 7.6 is 57.3, the smallest unit. Two units that change a ratio
by less do not explain it better than an odd machine."""
SURE = 1.0
"""A decade of odds for an explanation, at least."""


@dataclass(frozen=True, eq=False)
class _Ways:
    """Ways in which columns are not what they say, the first that they are: (m, n_state) each.

    `order`: the column that carries each coordinate; `sign`, `factor`: of that column. `price`: (m,).
    """

    order: np.ndarray
    sign: np.ndarray
    factor: np.ndarray
    price: np.ndarray


def judge_ties(log: Any, model: Model, seen: Coupling) -> Iterator[Finding]:
    """Judge units, signs and order of the state's columns; silent where the log cannot tell."""
    possible = response_of(model)
    tied = {c for tie in model.ties for c in (tie.column, tie.other)}
    told = (np.abs(seen.found) > CERTAIN * seen.std) & np.array([[c in tied] for c in model.state])
    if possible is None or not told.any():
        return
    here = np.arange(len(model.state))[None]
    as_is = _Ways(here, np.ones(here.shape), np.ones(here.shape), np.zeros(1))
    start = float(_scores(model, possible, seen, told, as_is)[0])
    if start >= 0 and not _may_be_small(model, seen, told):
        return
    units = {c: other_units(log.table, c) for c in model.state}
    ways = _ways(model, units, told)
    scores = _scores(model, possible, seen, told, ways)
    best = int(scores.argmax())
    if scores[best] < start + SURE:
        return
    found = Explanation(
        tuple(
            change_of(c, model.state[n], int(ways.sign[best, k]), float(ways.factor[best, k]), units)
            for k, (c, n) in enumerate(zip(model.state, ways.order[best], strict=True))
        ),
        (),
        0.0,
    )
    what = model.family.together or listed(model.state)
    yield sentence(
        f"In {name_of(log)} {said(found)}, judged by how gains follow {what}", remedies(log, found)
    )


def _may_be_small(model: Model, seen: Coupling, told: np.ndarray) -> bool:
    """Return whether every place is so near the origin that a unit could make it more usual."""
    for tie in model.ties:
        ratios, _, good = _ratios(model, seen.found[None], seen.std[None], told[None], tie)
        if good.any() and np.abs(ratios[good]).max() < NEAR:
            return True
    return False


def _ratios(
    model: Model, found: np.ndarray, std: np.ndarray, told: np.ndarray, tie: Tie
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place less origin by each channel (m, K), with standard uncertainty, and whether the channel tells."""
    one, other = (model.state.index(c) for c in (tie.column, tie.other))
    below = np.where(told[:, other], found[:, other], 1.0)
    ratios = found[:, one] / below
    spread = np.hypot(std[:, one], ratios * std[:, other]) / np.abs(below)
    size = max(high - low for low, high in (tie.origin, *tie.places))
    return ratios, spread, told[:, other] & (spread < np.maximum(np.abs(ratios), size) / CERTAIN)


def _scores(model: Model, possible: Response, seen: Coupling, told: np.ndarray, ways: _Ways) -> np.ndarray:
    """Return decades of odds for each way (m,), beside a usual log."""
    scale = (ways.sign * ways.factor)[:, :, None]
    found, std, told = seen.found[ways.order] * scale, seen.std[ways.order] * np.abs(scale), told[ways.order]
    wrong, scores = _wrong_sign(possible, found, std, told), -ways.price
    for tie in model.ties:
        ratios, spread, good = _ratios(model, found, std, told, tie)
        good &= good.sum(axis=1, keepdims=True) > 1
        places = np.array(tie.places)
        reach = np.abs(places).max() + max(map(abs, tie.origin))
        beyond = np.log10(np.maximum(np.abs(ratios) / reach, 1.0))
        scores = scores - 2 * np.where(good, beyond, 0.0).sum(axis=1)
        room = NEAR + CERTAIN * spread
        low = np.where(good, places[:, 0] - ratios - room, -np.inf).max(axis=1)
        high = np.where(good, places[:, 1] - ratios + room, np.inf).min(axis=1)
        wrong = wrong | (np.maximum(low, tie.origin[0]) > np.minimum(high, tie.origin[1]))
        # numbers this much larger are this much more usual among places that may lie anywhere in the machine
        one, other = (ways.factor[:, model.state.index(c)] for c in (tie.column, tie.other))
        scores = scores + good.sum(axis=1) * np.log10(one / other)
    return np.asarray(scores - ODD * wrong)


def _wrong_sign(possible: Response, found: np.ndarray, std: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Return whether a gain follows a column against the only sign that the model allows, (m,)."""
    room = NEAR * np.abs(np.where(told, found, 0.0)).max(axis=2, keepdims=True) + CERTAIN * std
    below = (possible.state_lower >= 0) & (possible.state_upper > 0) & (found < -room)
    above = (possible.state_upper <= 0) & (possible.state_lower < 0) & (found > room)
    return np.asarray(((below | above) & told).any(axis=(1, 2)))


def _ways(model: Model, units: Units, told: np.ndarray) -> _Ways:
    """Return every change of order, sign and unit of the state's columns that three mistakes can make."""
    state, known = list(model.state), [bool(row.any()) for row in told]
    place = {c: k for k, c in enumerate(state)}
    groups = [list(g) for _, g in groupby(sorted(state, key=_unit_of), key=_unit_of)]
    signs = [(1.0, -1.0) if here else (1.0,) for here in known]
    factors = [(1.0, *units[c]) if here else (1.0,) for c, here in zip(state, known, strict=True)]
    signs_of = np.array(list(product(*signs)))
    factors_of, prices = _priced_factors(state, factors, units, model.ties)
    flips = np.array([_price(row) for row in (signs_of < 0).tolist()])
    found: list[tuple[np.ndarray, ...]] = []
    for way in product(*(permutations(g) for g in groups)):
        carrier = dict(pair for g, o in zip(groups, way, strict=True) for pair in zip(g, o, strict=True))
        order = np.array([place[carrier[c]] for c in state])
        swapped = RARE * bool((order != np.arange(len(order))).any())
        price = (swapped + flips)[:, None] + prices
        i, j = np.nonzero((price <= MOST) & (swapped + flips <= MOST)[:, None])
        here = np.broadcast_to(order, (len(i), len(order)))
        found.append((here, signs_of[i][:, order], factors_of[j][:, order], price[i, j]))
    return _Ways(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _priced_factors(
    state: Sequence[str], factors: Sequence[Sequence[float]], units: Units, ties: Sequence[Tie]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the factors of all columns (m, n_state) that may be tried together, with their prices (m,).

    Units that change a ratio change it by more than a plausible scale.
    """
    at = np.array(list(product(*(range(len(each)) for each in factors))))
    tried = np.column_stack([np.array(each)[k] for each, k in zip(factors, at.T, strict=True)])
    far = np.ones(len(tried), dtype=bool)
    for tie in ties:
        ratio = tried[:, state.index(tie.column)] / tried[:, state.index(tie.other)]
        far &= (ratio == 1) | (ratio <= 1 / APART) | (ratio >= APART)
    tried = tried[far]
    price = np.zeros(len(tried))
    for unit in dict.fromkeys(map(_unit_of, state)):  # each unit once, and a little for every further column
        own = tried[:, [_unit_of(c) == unit for c in state]]
        for factor in np.unique(own[own != 1]):
            often = np.count_nonzero(own == factor, axis=1)
            price += np.where(often > 0, RARE + ALSO * (often - 1), 0.0)
    doubled = [
        [f for f in each if f != 1 and not units[c][f]] for c, each in zip(state, factors, strict=True)
    ]
    twice = [np.isin(column, some) for column, some in zip(tried.T, doubled, strict=True)]
    return tried, price + DOUBLED * np.any(twice, axis=0)


def _price(wrong: Sequence[bool]) -> float:
    """Return decades of odds against columns that are wrong in one way."""
    return RARE + ALSO * (sum(wrong) - 1) if any(wrong) else 0.0


def _unit_of(column: str) -> str:
    return column.rpartition("_")[2]
