"""Units, signs and order of the columns of the state, by how they move the gains of the channels.

A gain that follows a rigid body's height z and tilts r does so by one slope and the place of its sensor:
d gain / d r over d gain / d z is the sensor's place less that of the point where z is measured
(`hallsym.model.Tie`). Places in the machine have a size; in another unit, they lie a thousand times outside.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, permutations, product
from typing import Any

import numpy as np

from hallsym.log.quality.explain import Change, Explanation
from hallsym.log.quality.findings import Finding
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
SURE = 1.0
"""A decade of odds for an explanation, at least."""


def judge_ties(log: Any, model: Model, seen: Coupling) -> Iterator[Finding]:
    """Judge units, signs and order of the state's columns; silent where the log cannot tell."""
    possible = response_of(model)
    tied = {c for tie in model.ties for c in (tie.column, tie.other)}
    told = (np.abs(seen.found) > CERTAIN * seen.std) & np.array([[c in tied] for c in model.state])
    if possible is None or not told.any():
        return
    as_is = tuple(Change(c, c) for c in model.state)
    start = _score(model, possible, seen, told, as_is)
    if start >= 0 and not _may_be_small(model, seen, told):
        return
    units = {c: other_units(log.table, c) for c in model.state}
    tried = (c for c in _tried(model, units, told) if _price(c) <= MOST)
    best = max(tried, key=lambda c: _score(model, possible, seen, told, c))
    score = _score(model, possible, seen, told, best)
    if best == as_is or score < start + SURE:
        return
    found = Explanation(best, (), 0.0)
    what = model.family.together or listed(model.state)
    yield sentence(f"In {log.name} {said(found)}, judged by how gains follow {what}", remedies(log, found))


def _may_be_small(model: Model, seen: Coupling, told: np.ndarray) -> bool:
    """Return whether every place is so near the origin that a unit could make it more usual."""
    return any(
        len(ratios := _ratios(model, seen, told, tie)[0]) and np.abs(ratios).max() < NEAR for tie in model.ties
    )


def _ratios(
    model: Model, seen: Coupling, told: np.ndarray, tie: Tie
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place less origin by each channel that tells, with standard uncertainty, and which channels tell."""
    one, other = (model.state.index(c) for c in (tie.column, tie.other))
    k = np.flatnonzero(told[other] & (seen.std[one] > 0))
    below = seen.found[other, k]
    ratios = seen.found[one, k] / below
    std = np.hypot(seen.std[one, k], ratios * seen.std[other, k]) / np.abs(below)
    size = max(high - low for low, high in (tie.origin, *tie.places))
    good = std < np.maximum(np.abs(ratios), size) / CERTAIN
    return ratios[good], std[good], k[good]


def _score(
    model: Model, possible: Response, seen: Coupling, told: np.ndarray, changes: Sequence[Change]
) -> float:
    """Return decades of odds for columns that are what `changes` say, beside a usual log."""
    order = [model.state.index(c.source) for c in changes]
    scale = np.array([c.sign * c.factor for c in changes])[:, None]
    turned = Coupling(seen.found[order] * scale, seen.std[order] * np.abs(scale))
    told = told[order]
    wrong = _wrong_sign(possible, turned, told)
    score, before = -_price(changes), dict(zip(model.state, range(len(model.state)), strict=True))
    for tie in model.ties:
        ratios, std, k = _ratios(model, turned, told, tie)
        if len(k) < 2:
            continue
        places = np.array(tie.places)[k]
        reach = max(np.abs(places).max() + max(map(abs, tie.origin)), 1e-300)
        score -= 2 * float(np.log10(np.maximum(np.abs(ratios) / reach, 1.0)).sum())
        room = NEAR + CERTAIN * std
        low = max(tie.origin[0], (places[:, 0] - ratios - room).max())
        wrong |= bool(low > min(tie.origin[1], (places[:, 1] - ratios + room).min()))
        # numbers this much larger are this much more usual among places that may lie anywhere in the machine
        one, other = (changes[before[c]] for c in (tie.column, tie.other))
        score += len(k) * float(np.log10(one.factor / other.factor))
    return score - ODD * wrong


def _wrong_sign(possible: Response, seen: Coupling, told: np.ndarray) -> bool:
    """Return whether a gain follows a column against the only sign that the model allows."""
    room = NEAR * np.abs(np.where(told, seen.found, 0.0)).max(axis=1, keepdims=True) + CERTAIN * seen.std
    below = (possible.state_lower >= 0) & (possible.state_upper > 0) & (seen.found < -room)
    above = (possible.state_upper <= 0) & (possible.state_lower < 0) & (seen.found > room)
    return bool(np.any((below | above) & told))


def _price(changes: Sequence[Change]) -> float:
    """Return decades of odds against the changes: each way of being wrong once, and a little per column."""
    total = 0.0
    for way in (lambda c: c.source != c.column, lambda c: c.sign < 0, lambda c: c.factor):
        ways = [(way(c), _unit_of(c.column)) for c in changes]
        many = {w: ways.count(w) for w in ways if w[0] not in (False, 1.0)}
        total += sum(RARE + ALSO * (n - 1) for n in many.values())
    return total + DOUBLED * any(c.factor != 1 and not c.unit for c in changes)


def _tried(model: Model, units: Mapping[str, Mapping[float, str]], told: np.ndarray) -> Iterator[tuple[Change, ...]]:
    """Yield every change of order, sign and unit of the state's columns."""
    state, known = list(model.state), told.any(axis=1)
    place = {c: k for k, c in enumerate(state)}
    groups = [list(g) for _, g in groupby(sorted(state, key=_unit_of), key=_unit_of)]
    for way in product(*(permutations(g) for g in groups)):
        order = dict(pair for g, o in zip(groups, way, strict=True) for pair in zip(g, o, strict=True))
        for signs in product(*((1, -1) if known[place[order[c]]] else (1,) for c in state)):
            for factors in product(*([1.0, *units[order[c]]] if known[place[order[c]]] else [1.0] for c in state)):
                yield tuple(
                    Change(c, order[c], s, f, units[order[c]].get(f, ""))
                    for c, s, f in zip(state, signs, factors, strict=True)
                )


def _unit_of(column: str) -> str:
    return column.rpartition("_")[2]
