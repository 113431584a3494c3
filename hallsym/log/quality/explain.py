"""Which unit, sign or order of columns would make responses possible that are not.

A response is a matrix of slopes d reading / d reference. A column in another unit multiplies its row or
column of that matrix, a sign inverts it, exchanged columns exchange it: few changes, tried all at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, permutations, product

import numpy as np
import scipy

BEYOND, WITHIN = 1.5, 1.25
"""Factor beyond what a model allows that is still a plausible scale: a matter for fit and diagnosis. What
explains slopes beyond it has to bring them nearer than that: 57.3 times too large is not nearly 100 times."""
CERTAIN = 6.0
"""Standard deviations that a slope must be outside: of a thousand runs with ten slopes, none is by chance."""
MOST = 30_000
"""Changes of references that are tried at most; beyond that, none of unit."""
TOGETHER = 256
"""Changes of references that are tried at once."""
MORE = 0.5
"""Cost of what is wrong with a column beside the first, which costs 1: another sign beside another unit, or
values that are too small by a unit, which only a conversion done twice makes."""
AS_GOOD = 2.0
"""Changes more than the fewest that an explanation by other columns may take to be named beside it."""

Units = Mapping[str, Mapping[float, str]]
"""For each column: factor by which its values are too large -> unit it then holds, "" where there is none."""


@dataclass(frozen=True)
class Change:
    """What a column is said to be and what it holds: `source` carries it, inverted if `sign` is -1.

    `factor`: how much too large its values are, `unit` the unit that makes them so ("" where there is none).
    """

    column: str
    source: str
    sign: int = 1
    factor: float = 1.0
    unit: str = ""

    @property
    def cost(self) -> float:
        """How much has to have gone wrong: 1 for a column that is not what it says, more for two ways."""
        ways = (self.source != self.column) + (self.sign < 0) + (self.factor != 1)
        twice = self.factor != 1 and not self.unit
        return 1 + MORE * (ways - 1 + twice) if ways else 0.0

    @property
    def way(self) -> tuple[bool, int, float]:
        """How the column is not what it says."""
        return self.source != self.column, self.sign, self.factor


@dataclass(frozen=True)
class Explanation:
    """Changes that make the slopes possible, and how far the slopes then are from the middle of the range."""

    references: tuple[Change, ...]
    channels: tuple[Change, ...]
    misfit: float

    @property
    def cost(self) -> float:
        """Sum over columns."""
        return sum(c.cost for c in (*self.references, *self.channels))

    @property
    def changes(self) -> tuple[Change, ...]:
        """The columns that are not what they say."""
        return tuple(c for c in (*self.references, *self.channels) if c.cost)

    @property
    def simple(self) -> bool:
        """Whether at most two columns are not what they say, or all of them in one way."""
        return len(self.changes) <= 2 or len({c.way for c in self.changes}) == 1

    @property
    def named(self) -> bool:
        """Whether each factor is that of a unit."""
        return all(c.unit or c.factor == 1 for c in self.changes)

    @property
    def only_channels(self) -> bool:
        """Whether the references are as they say."""
        return not any(c.cost for c in self.references)

    @property
    def only_references(self) -> bool:
        """Whether the channels are as they say."""
        return not any(c.cost for c in self.channels)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes (n_pose, n_channels) that were found, and what they may be.

    `moved`: (n_pose,) references that moved; of the others nothing is known. `std`: standard uncertainties.
    """

    found: np.ndarray
    std: np.ndarray
    moved: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def possible(self) -> bool:
        """Return whether the columns can be what they say."""
        return self._inside(BEYOND)

    def _inside(self, by: float) -> bool:
        low, high = widened(self.lower, self.upper, by)
        room = CERTAIN * self.std
        inside = (self.found >= low - room) & (self.found <= high + room)
        return bool(np.all(inside[self.moved]))

    def explained(self, by: Explanation, references: Sequence[str], channels: Sequence[str]) -> bool:
        """Return whether changes that explain other slopes explain these."""
        rows, columns = ([c.source for c in part] for part in (by.references, by.channels))
        at = np.ix_([references.index(c) for c in rows], [channels.index(c) for c in columns])
        scale = np.array([c.sign * c.factor for c in by.references])[:, None]
        scale = scale * np.array([c.sign / c.factor for c in by.channels])
        moved = self.moved[at[0][:, 0]]
        turned = Slopes(self.found[at] * scale, self.std[at] * abs(scale), moved, self.lower, self.upper)
        return turned._inside(WITHIN)


def widened(lower: np.ndarray, upper: np.ndarray, by: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a range whose ends are moved out by a factor, further from zero or nearer to it."""
    low = np.where(lower > 0, lower / by, lower * by)
    return low, np.where(upper < 0, upper / by, upper * by)


def explanations(
    slopes: Slopes, references: Sequence[str], channels: Sequence[str], units: Units
) -> list[Explanation]:
    """Return what explains slopes best: changes of few columns, and others that do as well, the best first.

    At most one that changes only channels, one that changes only references, and one that changes both; where
    the best takes a conversion done twice, also the best that does not. Empty where nothing explains them.
    """
    best: dict[str, Explanation] = {}
    for found in _tried(slopes, references, channels, units):
        least = min((e.cost for e in best.values() if e.named), default=math.inf)
        if sum(c.cost for c in found.references) > least + AS_GOOD:
            break
        kind = "channels" if found.only_channels else "references" if found.only_references else "both"
        for key in (kind, "named") if found.named else (kind,):
            if key not in best or _order(found) < _order(best[key]):
                best[key] = found
    ranked = sorted(dict.fromkeys(best.values()), key=_order)
    if not ranked:
        return []
    first = ranked[0]
    others = [
        e for e in ranked[1:] if e.cost <= first.cost + AS_GOOD * (e.only_channels or e.only_references)
    ]
    if not first.named and "named" in best:
        others = [best["named"]]
    return [first, *others]


def _order(found: Explanation) -> tuple[float, float]:
    return round(found.cost, 6), found.misfit


def _tried(
    slopes: Slopes, references: Sequence[str], channels: Sequence[str], units: Units
) -> Iterator[Explanation]:
    """Yield what brings all slopes into their range: every change of references with the channels' best.

    Those that change fewer references come first.
    """
    low, high = widened(slopes.lower, slopes.upper, WITHIN)
    size = np.maximum(np.abs(slopes.lower), np.abs(slopes.upper)).max(axis=1)
    size, middle = np.where(size > 0, size, 1.0), 0.5 * (slopes.lower + slopes.upper)
    scales = sorted({1.0, *(f for c in channels for f in units[c])})
    options = [(sign, factor) for sign in (1, -1) for factor in scales]
    price = _costs(options, channels, units)
    values = np.array([sign / factor for sign, factor in options])[:, None, None, None]
    ways = _of_references(references, slopes.moved, units)
    for first in range(0, len(ways[0]), TOGETHER):
        order, sign, factor = (part[first : first + TOGETHER] for part in ways)
        scale = (sign * factor)[:, None, :, None, None]
        # (way, option, pose, carrier, channel)
        turned = values * (scale * slopes.found[order][:, None, :, :, None])
        room = CERTAIN * np.abs(values * (scale * slopes.std[order][:, None, :, :, None]))
        still = ~slopes.moved[order][:, None, :, None, None]
        inside = (turned >= low[:, None] - room) & (turned <= high[:, None] + room)
        possible = np.all(inside | still, axis=2)
        possible &= np.isfinite(price)
        good = possible.any(axis=1).any(axis=1).all(axis=1) & possible.any(axis=1).any(axis=2).all(axis=1)
        for m in np.flatnonzero(good & ~still[:, 0, :, 0, 0].all(axis=1)):
            gap = np.abs(turned[m] - middle[:, None]) / size[:, None, None]
            off = np.where(still[m], 0.0, gap).sum(axis=1)
            assigned = _assigned(np.where(possible[m], off, np.inf) * 1e-6 + price)
            if assigned is None:
                continue
            picked = tuple(change_of(channels[n], channels[c], *options[k], units) for n, c, k in assigned)
            changes = tuple(
                change_of(c, references[order[m, j]], int(sign[m, j]), float(factor[m, j]), units)
                for j, c in enumerate(references)
            )
            yield Explanation(changes, picked, float(sum(off[k, c, n] for n, c, k in assigned)))


def change_of(column: str, source: str, sign: int, factor: float, units: Units) -> Change:
    """Return a change with the unit that its factor means."""
    return Change(column, source, sign, factor, units[source].get(factor, ""))


def _costs(options: Sequence[tuple[int, float]], channels: Sequence[str], units: Units) -> np.ndarray:
    """Cost of each (option, carrier, channel); infinite for a unit that the carrier cannot be in."""
    cost = [
        [
            [
                change_of(n, c, sign, factor, units).cost if factor == 1 or factor in units[c] else np.inf
                for n in channels
            ]
            for c in channels
        ]
        for sign, factor in options
    ]
    return np.array(cost)


def _assigned(cost: np.ndarray) -> list[tuple[int, int, int]] | None:
    """Return (channel, carrier, option) for each channel; None where one cannot be explained."""
    best = cost.min(axis=0)  # (carrier, channel)
    if not (np.isfinite(best).any(axis=0).all() and np.isfinite(best).any(axis=1).all()):
        return None
    carrier, channel = scipy.optimize.linear_sum_assignment(np.where(np.isfinite(best), best, 1e9))
    if not np.isfinite(best[carrier, channel]).all():
        return None
    found = [(int(n), int(c), int(cost[:, c, n].argmin())) for c, n in zip(carrier, channel, strict=True)]
    return sorted(found)


def _of_references(
    references: Sequence[str], moved: np.ndarray, units: Units
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return every change of references, fewest first: carrier, its sign and its factor, (m, n_pose) each.

    A column that did not move is in its unit and has its sign.
    """
    place = {c: k for k, c in enumerate(references)}
    groups = [list(g) for _, g in groupby(sorted(references, key=_unit_of), key=_unit_of)]
    orders = [
        dict(pair for g, o in zip(groups, way, strict=True) for pair in zip(g, o, strict=True))
        for way in product(*(permutations(g) for g in groups))
    ]
    scales = [(1.0, *units[c]) if here else (1.0,) for c, here in zip(references, moved, strict=True)]
    signs = [(1, -1) if here else (1,) for here in moved]
    if len(orders) * math.prod(map(len, scales)) * math.prod(map(len, signs)) > MOST:
        scales = [(1.0,) for _ in references]
    if len(orders) * math.prod(map(len, signs)) > MOST:
        orders = [{c: c for c in references}]
    carriers = np.array([[place[order[c]] for c in references] for order in orders])
    sign, factor = np.array(list(product(*signs))), np.array(list(product(*scales)))
    pick = np.indices((len(carriers), len(sign), len(factor))).reshape(3, -1)
    order = carriers[pick[0]]
    # sign and unit belong to the column that carries a coordinate
    sign, factor = (np.take_along_axis(v[k], order, axis=1) for v, k in ((sign, pick[1]), (factor, pick[2])))
    ways = (order != np.arange(len(references))).astype(float) + (sign < 0) + (factor != 1)
    nameless = [[f for f, unit in units[c].items() if not unit] for c in references]
    twice = np.array([np.isin(factor[:, j], nameless[j]) for j in range(len(references))]).T
    cost = np.where(ways > 0, 1 + MORE * (ways - 1 + twice), 0.0).sum(axis=1)
    cheap = np.argsort(cost, kind="stable")
    return order[cheap], sign[cheap], factor[cheap]


def _unit_of(column: str) -> str:
    return column.rpartition("_")[2]
