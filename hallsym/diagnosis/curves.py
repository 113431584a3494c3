"""Curves of a residual over coordinates: fitted, cross-validated run by run, and tested.

Coordinates are states, readings, motion, time, places on an axis or within its period. Per sensor the
residual may have an offset and a gain that follow the coordinate smoothly: linear interpolation between
knots with a penalty on curvature. The explained part is measured on runs that the curve was not fitted to, so
it cannot be too large. Significance comes from sign flips (`p_values`): without the effect the products of
blocks with the curve are as often positive as negative, whatever the noise within a block. All blocks have
the same weight, however large their residual. Products of a block with itself and with its neighbour in the
same run are left out, so that autocorrelation does not count.

The part of the residual that a curve, or a gain of every run, predicts on runs (or stretches) that it was not
fitted to is lack of fit, whatever the stated noise floor.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import tau

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.p_values import drawn, moments, of_products, of_sums, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residual_table import (
    PARTS,
    ResidualTable,
    means,
    phase,
    residual_table,
    slices,
    sums,
)
from hallsym.diagnosis.residuals import NIL, Base, found_once, pieces
from hallsym.diagnosis.survey import SEGMENT
from hallsym.estimation.goodness_of_fit import MEMORIES, STILL
from hallsym.families.mechanisms import stop_operators
from hallsym.log.core import edges_of
from hallsym.units import readable

RIDGE = 1e-3
"""Ridge over the squares of a column: coefficients that no group determines stay 0."""


@dataclass(frozen=True, eq=False)
class Regression:
    """Coefficients of n features: `all` (..., n), and `left_out` (U, ..., n) without each group.

    `squares`: (U, ...) decrease of each group's squares by the coefficients that the other groups give.
    """

    all: np.ndarray
    left_out: np.ndarray
    squares: np.ndarray


def regression(
    gram: np.ndarray, cross: np.ndarray, penalty: np.ndarray, rest: np.ndarray | None = None
) -> Regression:
    """Solve penalised least squares from the products of U groups.

    `gram`: (U, ..., n, n) of the features, `cross`: (U, ..., n) of features and target, `penalty`:
    (..., n, n). `rest`: `others(gram)`, where it is known.
    """
    total, targets = gram.sum(axis=0), cross.sum(axis=0)
    d = lengths(total + penalty)
    scale = d[..., :, None] * d[..., None, :]

    def solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.solve((A + penalty) / scale, (b / d)[..., None])[..., 0] / d)

    left = solved(others(gram) if rest is None else rest, others(cross))
    squares = (left * (2 * cross - (gram @ left[..., None])[..., 0])).sum(axis=-1)
    return Regression(solved(total, targets), left, squares)


def lengths(gram: np.ndarray) -> np.ndarray:
    """Return the lengths (..., n) of columns, to scale them by; infinite for a column that never moves."""
    square = np.diagonal(gram, axis1=-2, axis2=-1)
    length = np.sqrt(np.maximum(square, 0.0))  # differences of sums may round below 0
    return np.maximum(length, NIL * length.max(axis=-1, keepdims=True, initial=1e-140))


def ridge(gram: np.ndarray) -> np.ndarray:
    """Return a penalty (n, n) of `RIDGE` times the squares that all groups but one have, on average."""
    return np.diag(RIDGE * (1 - 1 / len(gram)) * lengths(gram.sum(axis=0)) ** 2)


def others(parts: np.ndarray) -> np.ndarray:
    """Sum of all parts but one, for each; the total less one part would leave rounding in place of 0."""
    if len(parts) < 2:
        return parts[:0]
    out = np.zeros_like(parts)
    np.cumsum(parts[:0:-1], axis=0, out=out[-2::-1])
    out[1:] += np.cumsum(parts[:-1], axis=0)
    return out


@dataclass(frozen=True)
class Coordinate:
    """A coordinate that a residual may depend on: its `name`, its `column` and the unit of that.

    `gain`: it may also change the gain. `own`: every sensor has its own, from `sensed` or `rate`. `fine`: the
    residual may have fine structure over it. `of`: several columns that together are the coordinate, and
    `memory`: the direction of motion of each sensor; neither is a place on a line.
    """

    name: str
    column: str
    unit: str
    gain: bool = True
    own: bool = False
    fine: bool = False
    of: tuple[str, ...] = ()
    memory: bool = False

    @property
    def ordered(self) -> bool:
        """Whether it is a place on a line."""
        return not self.of and not self.memory

    def values(self, r: ResidualTable) -> np.ndarray | None:
        """Return (n,) values, (K, n) for each sensor's own; None where there are none or they do not vary."""
        if self.memory:
            return np.sign(r.rate) if np.std(r.sensed) > 0 else None
        if self.of:
            there = all(c in r.columns and (not self.gain or np.std(r.columns[c]) > 0) for c in self.of)
            return r.columns[self.of[0]] if there else None
        x = getattr(r, self.column) if self.own else r.columns.get(self.column)
        if x is None:
            return None
        if self.unit == "rad" and self.fine and np.ptp(x) > tau:
            x = np.mod(x, tau)
        return x if np.std(x) > max(STILL * r.base.sigma.get(self.column, 0.0), 1e-15) else None


def coordinates(r: ResidualTable) -> tuple[Coordinate, ...]:
    """Return the coordinates that a residual may depend on, in the order of preference.

    Of two that explain the same the first is named. Where all references are periodic, their place within the
    period stands for readings and pose.
    """
    model = r.base.model
    words, references = model.family.words, model.references
    stems = {c: readable(c)[2].removesuffix("_ref").replace("_", " ") for c in (*references, *model.state)}
    of = {c: f" of {stems[c]}" if len(references) > 1 else "" for c in references}
    turn = {c: "turn" if unit_of(c) == "rad" else "period" for c in references}
    phases = [
        Coordinate(f"place in the {turn[c]}{of[c]}", phase(c), unit_of(c), gain=False, fine=True)
        for c in references
        if c in model.period
    ]
    if len(phases) == len(references):
        motion = [Coordinate(f"speed{of[c]}", f"d1_{c}", f"{unit_of(c)}/s") for c in references]
        known = [*phases, *(motion if r.base.timed else ())]
    else:
        reading = unit_of(model.channels[0])
        made = {c.name for c in model.computed}
        states = [Coordinate(words.get(c, stems[c]), c, unit_of(c)) for c in model.state if c not in made]
        if len(states) > 1:
            together = model.family.together or ", ".join(s.name for s in states) + " together"
            states.append(Coordinate(together, "states", "1", of=tuple(s.column for s in states)))
        places = {c: f"place in the stroke of {stems[c]}" for c in references}
        for c in references:
            if unit_of(c) == "rad":
                far = np.ptp(r.columns[f"d0_{c}"]) > tau
                places[c] = f"place in the turn of {stems[c]}" if far else f"angle {stems[c]}"
        rates = tuple(f"d2_{c}" for c in references)
        known = [
            *states,
            *phases,
            Coordinate("the reading itself", "sensed", reading, gain=False, own=True, fine=True),
            Coordinate("direction of motion", "direction", "1", gain=False, own=True, memory=True),
            Coordinate("velocity", "rate", f"{reading}/s", own=True),
            Coordinate("acceleration", "acceleration", "m/s2", gain=False, of=rates),
            *(Coordinate(words.get(c, places[c]), f"d0_{c}", unit_of(c), fine=True) for c in references),
        ]
    clock = (
        Coordinate("time in the campaign", "campaign_s", "s"),
        Coordinate("time since the start of the run", "run_s", "s", gain=False),
    )
    warmth = Coordinate("temperature", "temperature_degc", "degC")
    return (warmth, *known, *(clock if r.base.timed else ()))


def unit_of(column: str) -> str:
    """Return the unit of a column: the end of its name."""
    unit = column.rpartition("_")[2]
    return "degC" if unit == "degc" else unit


def knots(x: np.ndarray) -> np.ndarray:
    """Return up to 9 knots of a smooth curve over x, quantiles: none closer than 2 % of the range."""
    wanted = np.quantile(x, np.linspace(0.0, 1.0, 9))
    low, high = wanted[0], wanted[-1]
    kept = [low]
    for k in wanted[1:-1]:
        if k - kept[-1] > 0.02 * (high - low) and high - k > 0.02 * (high - low):
            kept.append(k)
    return np.array([*kept, high])


def hats(x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return linear interpolation between `at` as features of each row of x (rows, n), (rows, len(at), n)."""
    out = np.zeros((len(x), len(at), x.shape[1]))
    columns = np.arange(x.shape[1])
    for own, row in zip(out, x, strict=True):
        k = np.clip(np.searchsorted(at, row, side="right") - 1, 0, len(at) - 2)
        share = np.clip((row - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0)
        own[k, columns], own[k + 1, columns] = 1.0 - share, share
    return out


# -- curves --------------------------------------------------------------------------------------------------


BENDS = (0.01, 0.3, 10.0)
"""Weights of the bending penalty against the data that are tried, from free knots to nearly a straight line.

The penalty with the smallest cross-validated error is taken: a free curve overfits, a stiff one has no
bend."""


@dataclass(frozen=True, eq=False)
class Curve:
    """How a residual follows the coordinate that it was fitted `over`.

    `beta`: (K, features) offsets at the m places `over.at`, then gains, if any: the residual is offset + gain
    * sensed / scale [m]. `left`: (folds, K, features) the same with runs left out in turn, `cross_validated`:
    (K, n) its cross-validated prediction, `explained`: whitened squares that this removes. `statistic`:
    (draws,) with random signs, that of the log first.
    """

    over: "Smooth | FineMap"
    beta: np.ndarray
    left: np.ndarray
    cross_validated: np.ndarray
    explained: float
    statistic: np.ndarray

    @property
    def p_value(self) -> float:
        """P-value of this curve alone: the share of draws with as large a statistic."""
        return float((self.statistic >= self.statistic[0]).mean())

    @property
    def coordinate(self) -> Coordinate:
        """The coordinate."""
        return self.over.coordinate

    @property
    def offset(self) -> np.ndarray:
        """Offsets at each place, (K, m)."""
        return self.beta[:, : len(self.over.at)]

    @property
    def gain(self) -> np.ndarray | None:
        """Gains at each place, (K, m); None where it has none."""
        gain = self.beta[:, len(self.over.at) :]
        return gain if self.coordinate.ordered and gain.size else None

    @property
    def spread(self) -> np.ndarray:
        """Standard errors of the coefficients (K, features), by a jackknife over the folds."""
        U = len(self.left)
        return np.sqrt((U - 1) / U * ((self.left - self.left.mean(axis=0)) ** 2).sum(axis=0))

    def says(self, r: ResidualTable) -> np.ndarray | None:
        """Return the residual (K, n) of some samples; None where the coordinate does not vary."""
        x = self.over.values if r is self.over.r else self.coordinate.values(r)
        return None if x is None else self.over.predicted(self.beta, r, x)

    @cached_property
    def predicted(self) -> np.ndarray:
        """The residual (K, n) of the samples that it was fitted to."""
        return self.over.predicted(self.beta, self.over.r, self.over.values)


class Smooth:
    """Smooth curves over one coordinate; products of features, which no residual changes, are computed once.

    `at`: places at which there is an offset. `scale`: of the expected reading, by which gains are stated.
    """

    def __init__(self, r: ResidualTable, coordinate: Coordinate, values: np.ndarray) -> None:
        """Take the residual on some runs, where the coordinate has the `values`."""
        self.r, self.coordinate, self.values, c = r, coordinate, values, coordinate
        self.scale = float(np.sqrt(np.mean(r.sensed**2))) or 1.0
        free = MEMORIES if c.memory else np.arange(len(c.of) * (1.0 + c.gain))
        self.at = knots(self.values) if c.ordered else np.asarray(free)
        self.folds, self.blocks = slices(r.fold), slices(r.block)
        self.own = 1 / r.variance
        self.products: tuple[np.ndarray, np.ndarray] | None = None

    def _products(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the products of features by fold and sensor, and those of all other folds."""
        parts = (phi[:, :, s] for s in self.folds)
        grams = self.own[:, None, None] * np.array([own @ own.swapaxes(1, 2) for own in parts])
        return grams, others(grams)

    def _features(self, r: ResidualTable, x: np.ndarray) -> np.ndarray:
        """Return the features of some samples where the coordinate has the values `x`, (K, features, n)."""
        c = self.coordinate
        if c.ordered:
            phi = hats(np.atleast_2d(x), self.at)
        elif c.memory:
            size = float(np.std(self.r.sensed))
            phi = stop_operators(r.sensed, edges_of(r.run), [size * w for w in MEMORIES])
        else:
            old, new = (np.array([of.columns[n] for n in c.of]) for of in (self.r, r))
            middle = old.mean(axis=1, keepdims=True) if c.gain else 0.0
            phi = ((new - middle) / np.maximum(old.std(axis=1, keepdims=True), 1e-300))[None]
        phi = np.broadcast_to(phi, (len(r.residual), *phi.shape[1:]))
        if not c.gain:
            return phi
        both = np.empty((len(phi), 2, *phi.shape[1:]))  # filled in place: they are most of the memory
        both[:, 0] = phi
        np.multiply(phi, (r.sensed / self.scale)[:, None, :], out=both[:, 1])
        return both.reshape(len(phi), -1, phi.shape[2])

    def predicted(self, coefficients: np.ndarray, r: ResidualTable, x: np.ndarray) -> np.ndarray:
        """Return the residual (K, n) where the coordinate has the values `x`."""
        return np.asarray((coefficients[:, None] @ self._features(r, x))[:, 0])

    def curve(self, residual: np.ndarray) -> Curve:
        """Return the curve of a residual (K, n), with the penalty of the smallest cross-validated error."""
        fits = self._fits(residual)
        z = np.max([f.statistic for f in fits], axis=0)
        return replace(max(fits, key=lambda f: f.explained), statistic=z)

    def _fits(self, residual: np.ndarray) -> list[Curve]:
        """Fit the coefficients of each sensor to its own residual, for each bending penalty."""
        r = self.r
        phi = self._features(r, self.values)  # not kept: of all coordinates together they fill the memory
        grams, rests = self.products = self.products or self._products(phi)
        targets, scores = (
            np.array([sums(own * row, group).T for own, row in zip(phi, rows, strict=True)])
            for rows, group in ((self.own[:, None] * residual, r.fold), (r.precision @ residual, r.block))
        )
        scores *= level_weights(r, residual, r.block)[:, None]
        total, n, out = grams.sum(axis=0), len(self.blocks), list[Curve]()
        for bend in BENDS if self.coordinate.ordered else BENDS[:1]:
            penalty = _penalty(np.diagonal(total, axis1=1, axis2=2), len(self.at), bend)
            found = regression(grams, targets.swapaxes(0, 1), penalty, rests)
            q = np.hstack([*scores]) @ np.linalg.solve(total + penalty, scores.swapaxes(1, 2)).reshape(-1, n)
            parts = zip(found.left_out, self.folds, strict=True)
            predicted = np.hstack([(own[:, None] @ phi[:, :, s])[:, 0] for own, s in parts])
            explained = float((predicted * (r.precision @ (2 * residual - predicted))).sum())
            statistic = of_products(q, r.run_of(r.block), r.base.policy)
            out.append(Curve(self, found.all, found.left_out, predicted, explained, statistic))
        return out


class FineMap:
    """Offsets in many narrow bins of a coordinate, each shrunk towards 0 by its precision.

    No bin is narrower than 8 sigma of the coordinate's noise, which is in the residual. There are up to 96:
    twice as many predict a ripple no better on runs left out.
    """

    scale = 1.0

    def __init__(self, r: ResidualTable, coordinate: Coordinate, values: np.ndarray) -> None:
        """Take the residual on some runs, where the coordinate has the `values`."""
        self.r, self.coordinate, self.values = r, coordinate, values
        self.low, high = np.quantile(_by_sensor(self.values, r), [0.002, 0.998])
        of_places = [s for c, s in r.base.sigma.items() if c.endswith(f"_{coordinate.unit}")]
        width = max(8 * max(of_places, default=0.0), 1e-300)
        self.bins = int(np.clip((high - self.low) / width, 12, 96))
        self.width = (high - self.low) / self.bins
        self.at = self.low + self.width * (np.arange(self.bins) + 0.5)
        self.bin = self._bin(self.values, r)
        self.count = self._sums(np.ones_like(r.residual), r.fold, self.bin)
        self.prior = r.residual.size / max(r.excess, 1e-3 * r.residual.size)

    def predicted(self, coefficients: np.ndarray, r: ResidualTable, x: np.ndarray) -> np.ndarray:
        """Return the offsets (K, n) where the coordinate has the values `x`."""
        return np.take_along_axis(coefficients, self._bin(x, r), axis=1)

    def curve(self, residual: np.ndarray) -> Curve:
        """Return the map of a residual (K, n)."""
        r, n = self.r, self.count
        of_folds, of_blocks = (self._sums(residual, group, self.bin) for group in (r.fold, r.block))
        N, S = n.sum(axis=0), of_folds.sum(axis=0)
        left = (S - of_folds) / (N - n + self.prior)
        weight = np.diag(r.precision)[:, None]
        explained = float((weight * (2 * of_folds * left - n * left**2)).sum())
        of_blocks *= level_weights(r, residual, r.block)[:, None, None]
        scores = (of_blocks * np.sqrt(weight / (N + self.prior))).reshape(len(of_blocks), -1)
        z = of_products(scores @ scores.T, r.run_of(r.block), r.base.policy)
        predicted = left[_index(r.fold), np.arange(len(residual))[:, None], self.bin]
        return Curve(self, S / (N + self.prior), left, predicted, explained, z)

    def _bin(self, x: np.ndarray, r: ResidualTable) -> np.ndarray:
        return np.clip(((_by_sensor(x, r) - self.low) / self.width).astype(int), 0, self.bins - 1)

    def _sums(self, values: np.ndarray, group: np.ndarray, bins: np.ndarray) -> np.ndarray:
        """Return the sums of values (K, n) by group, sensor and bin, (groups, K, bins)."""
        index, K = _index(group), len(values)
        place = (index * K + np.arange(K)[:, None]) * self.bins + bins
        shape = (index[-1] + 1, K, self.bins)
        return np.bincount(place.ravel(), values.ravel(), int(np.prod(shape))).reshape(shape)


def over(r: ResidualTable, c: Coordinate) -> Iterator[Smooth | FineMap]:
    """Yield the fitters of a residual over a coordinate: none where that does not vary."""
    values = c.values(r)
    if values is not None:
        yield Smooth(r, c, values)
        if c.fine:
            yield FineMap(r, c, values)


def run_gains(r: ResidualTable, residual: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the squares that a gain for each run explains, its statistic (draws,) and prediction (K, n).

    Each stretch of a run is predicted by the other stretches of the same run. The first draw is the log.
    """
    parts = slices(r.part)
    cross = sums(r.sensed * (r.precision @ residual), r.part).T
    gram = np.array([r.sensed[:, s] @ r.sensed[:, s].T * r.precision for s in parts])
    run = r.run[edges_of(r.part)[:-1]]
    explained, total, variance, third, predicted = 0.0, 0.0, 0.0, 0.0, np.zeros_like(residual)
    signs = drawn(len(parts))
    even = level_weights(r, residual, r.part)[:, None] * cross
    for number in np.unique(run):
        at = np.flatnonzero(run == number)
        if len(at) < PARTS or np.diag(gram[at].sum(axis=0)).min() <= 0:
            continue
        penalty = ridge(gram[at])
        found = regression(gram[at], cross[at], penalty)
        explained += float(found.squares.sum())
        for k, gain in zip(at, found.left_out, strict=True):
            predicted[:, parts[k]] = gain[:, None] * r.sensed[:, parts[k]]
        q = even[at] @ np.linalg.solve(gram[at].sum(axis=0) + penalty, even[at].T)
        q[np.abs(np.subtract.outer(at, at)) <= 1] = 0.0
        total = total + ((signs[:, at] @ q) * signs[:, at]).sum(axis=1)
        variance, third = (a + b for a, b in zip((variance, third), moments(q), strict=True))
    enough = len(parts) >= r.base.policy.fewest
    return explained, of_sums(total + np.zeros(len(signs)), variance, third, enough=enough), predicted


def level_weights(r: ResidualTable, residual: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return 1 / rms of the whitened residual in each group, so that a few large blocks do not decide alone.

    It is 0 for a group that is fitted exactly, such as a single knot with an offset.
    """
    size = means(r.whitened_squares(residual), group)
    some = size > NIL * size.mean()
    return np.where(some, 1.0 / np.sqrt(np.where(some, size, 1.0)), 0.0)


def _index(group: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the consecutive group that each sample is in."""
    return np.cumsum(np.diff(group, prepend=group[0]) != 0)


def _by_sensor(x: np.ndarray, r: ResidualTable) -> np.ndarray:
    """Return values of a coordinate for each sensor, (K, n)."""
    return x if x.ndim == 2 else np.broadcast_to(x, r.residual.shape)


def _penalty(size: np.ndarray, m: int, bend: float) -> np.ndarray:
    """Penalty on the second differences of each curve over m knots, and a trace of one on their size.

    `size`: (K, curves * m) squares of the features; the penalty is (K, curves * m, curves * m).
    """
    D, (K, n) = np.diff(np.eye(m), 2, axis=0), size.shape
    weight = np.maximum(size.reshape(K, -1, m).mean(axis=2, keepdims=True), 1e-300)
    each = weight[..., None] * np.eye(n // m)[:, :, None]  # (K, curves, curves, 1)
    each = each[:, :, None] * (bend * D.T @ D + RIDGE * np.eye(m))[:, None]
    return np.asarray(each.reshape(K, n, n))


# -- lack of fit ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shape:
    """Cross-validated decrease of the gap metric by a family of curves, and its p-value.

    `name`: of the coordinate.
    """

    name: str
    drop: float
    p_value: float


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Families of curves, best first; `tones`: decrease of the gap metric without its steady tones."""

    shapes: tuple[Shape, ...]
    tones: float = 0.0

    def best(self, level: float) -> Shape | None:
        """Return the significant family that explains most (level corrected for all tried)."""
        tried = max(len(self.shapes), 1)
        return next((s for s in self.shapes if s.p_value * tried < level and s.drop > 0), None)


@found_once
def lack_of_fit(base: Base, runs: frozenset[int]) -> LackOfFit:
    """Test the families of curves on the residual of `base` on `runs`."""
    r = residual_table(base, runs)
    if r is None:
        return LackOfFit(())
    whole = max(r.metric(r.residual), 1e-300)

    def shape(name: str, predicted: np.ndarray, p: float) -> Shape:
        return Shape(name, 1 - r.metric(r.residual - predicted) / whole, p)

    def tested(c: Coordinate) -> list[Shape]:  # features of one coordinate at a time: they take most memory
        curves = (each.curve(r.residual) for each in over(r, c))
        return [shape(c.name, curve.cross_validated, curve.p_value) for curve in curves]

    _, z, predicted = run_gains(r, r.residual)
    shapes = [shape("gain of its own", predicted, float((z >= z[0]).mean()))]
    shapes += [each for c in coordinates(r) for each in tested(c)]
    return LackOfFit(tuple(sorted(shapes, key=lambda s: -s.drop)), tones(base, runs))


# -- steady tones --------------------------------------------------------------------------------------------


LOBE = 4
"""Frequencies in the main lobe of a line in a spectrum with Hann's window: so many at the slow end are drift,
and a median over four lobes is the level between lines."""


def tones(base: Base, runs: Iterable[int]) -> float:
    """Return by how much the gap metric of `runs` falls without the steady tones of the decoded error."""
    model, back, length = base.model, np.linalg.inv(base.whiten), 2 * SEGMENT
    run, power = [], [np.zeros((0, SEGMENT + 1))]
    for piece in pieces(base, frozenset(runs)):
        pose, state = ([piece.data[c] for c in names] for names in (model.references, model.state))
        e = np.einsum("iks,ks->is", base.to_pose(pose, state), back @ piece.residual)
        e = np.where(piece.used, e * base.pose_weights[:, None], 0.0)
        parts = e[:, : e.shape[1] // length * length].reshape(len(e), -1, length)
        parts = (parts - parts.mean(axis=2, keepdims=True)) * np.hanning(length)
        run += [piece.run] * parts.shape[1]
        power.append((np.abs(np.fft.rfft(parts)) ** 2).sum(axis=0))
    if len(run) < base.policy.fewest:
        return 0.0
    each = np.concatenate(power)
    P = each.sum(axis=0)
    smooth = median_filter(P, 4 * LOBE - 1, mode="reflect")
    freedom = 2 * len(model.pose) * len(run)
    certain = P * freedom > smooth * statistic_at(base.policy.certain / len(P), freedom)
    certain[:LOBE] = False
    if not _steady(np.array(run), each, certain, base.policy):
        return 0.0
    share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
    return 1 - float(np.sqrt(max(1 - share, 0.0)))


def _steady(run: np.ndarray, power: np.ndarray, certain: np.ndarray, policy: Policy) -> bool:
    """Return whether lines have the same power (segments, frequencies) all through a run, unlike noise.

    With few segments some noise is steady by chance, so no more of the other frequencies may be as steady
    than the false-alarm rate allows; with many, all noise is nearly as steady, so the line must be clearly
    more so. Runs of one segment are compared with each other.
    """
    _, index, count = np.unique(run, return_inverse=True, return_counts=True)
    alone = count[index] == 1
    _, group, count = np.unique(np.where(alone, -1, index), return_inverse=True, return_counts=True)
    level = np.array([power[group == k].mean(axis=0) for k in range(len(count))]).clip(1e-300)
    varies = ((power - level[group]) ** 2 / level[group]).sum(axis=0)
    squares = (count - 1) @ level
    beside = np.convolve(certain, np.ones(3), mode="same") > 0  # a part of the line's power is theirs
    rest = varies[~beside] / np.maximum(squares[~beside], 1e-300)
    if not len(rest) or not squares[certain].sum() > 0:
        return True
    line = varies[certain].sum() / squares[certain].sum()
    return bool(np.mean(rest <= line) < policy.false_alarm and line < (1 - policy.minor) * np.median(rest))
