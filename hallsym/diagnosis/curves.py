"""Curves of a residual over a coordinate: fitted, left out run by run, and tested against chance.

Per sensor the residual may have an offset and a gain that follow the coordinate smoothly: linear
interpolation between knots, bending penalised. What a curve explains is counted on runs that it was not
fitted on, so that it cannot exceed what is there. Its significance rests on signs (`sign_flips`): without the
effect the blocks' products with the curve are as often positive as negative, whatever the noise within a
block. Blocks count alike, however large their residual. Products of a block with itself and with its
neighbour in the same run are left out, so that correlation in time does not count; so is what residual and
coordinate have in common because both hold the noise of the references (`measurement_error`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hallsym.diagnosis.coordinates import Coordinate, hats, knots
from hallsym.diagnosis.regression import NIL, RIDGE, others, regression, ridge
from hallsym.diagnosis.residual_table import PARTS, ResidualTable, slices
from hallsym.diagnosis.sign_flips import drawn, moments, of_products, of_sums
from hallsym.estimation.residual_noise import MEMORIES
from hallsym.families.play import stop_operators

BENDS = (0.01, 0.3, 10.0)
"""Weights of the bending penalty against the data that are tried, from free knots to nearly a straight line.

The curve that predicts runs left out best is taken: a free one runs wild beyond its runs, a stiff one follows
no bend."""


@dataclass(frozen=True, eq=False)
class Curve:
    """How a residual follows a coordinate.

    `at`: (m,) places. `offset`, `gain`: (K, m), the residual is offset + gain * sensed / scale [m]; `gain`
    None where it has none. `spread`, `gain_spread`: standard errors of these, from runs left out in turn.
    `explained`: whitened squares that it removes from runs it was not fitted on. `statistic`: (draws,) with
    random signs, that of the log first. `predicted`: (K, n), `foreseen`: the same without the fold of each
    sample; `says`: of other samples, None where the coordinate does not vary.
    """

    coordinate: Coordinate
    values: np.ndarray
    at: np.ndarray
    offset: np.ndarray
    spread: np.ndarray
    explained: float
    statistic: np.ndarray
    predicted: np.ndarray
    foreseen: np.ndarray
    says: Callable[[ResidualTable], np.ndarray | None]
    gain: np.ndarray | None = None
    gain_spread: np.ndarray | None = None
    scale: float = 1.0
    fine: bool = False

    @property
    def p_value(self) -> float:
        """P-value of this curve alone: the share of draws with as large a statistic."""
        return float((self.statistic >= self.statistic[0]).mean())


class _Fit(NamedTuple):
    """Coefficients of a curve of all runs, (K, features), and without each fold, (folds, K, features).

    `foreseen`: (K, n) what the latter predict of their folds, `explained`: whitened squares that this
    removes. `statistic`: (draws,), of all sensors.
    """

    explained: float
    foreseen: np.ndarray
    beta: np.ndarray
    left: np.ndarray
    statistic: np.ndarray


class Smooth:
    """Smooth curves over one coordinate: what does not depend on the residual is computed once."""

    def __init__(self, r: ResidualTable, coordinate: Coordinate, moved: ResidualTable | None = None) -> None:
        """Take the residual on some runs; `moved`: the same with more noise in the references."""
        self.r, self.coordinate = r, coordinate
        self.values = values = _values(coordinate, r)
        self.scale = float(np.sqrt(np.mean(r.sensed**2))) or 1.0
        c = coordinate
        free = MEMORIES if c.memory else np.arange(len(c.of) * (1.0 + c.gain))
        self.at = knots(values) if c.ordered else np.asarray(free)
        self.phi = self._features(r, values)
        self.folds, self.blocks = slices(r.fold), slices(r.block)
        there = None if moved is None else c.values(moved)
        by = np.zeros((*self.phi.shape[:2], 1))
        if moved is not None and there is not None:
            change = r.precision @ (moved.residual - r.residual)
            by = (self._features(moved, there) - self.phi) * change[:, None, :]
        self.shared = [
            np.array([by[:, :, s].sum(axis=2) for s in group]) for group in (self.folds, self.blocks)
        ]
        self.own = 1 / np.diag(np.linalg.inv(r.precision))
        self.gram = self.own[:, None, None, None] * np.array(
            [[phi[:, s] @ phi[:, s].T for s in self.folds] for phi in self.phi]
        )
        self.rest = [others(gram) for gram in self.gram]

    def _features(self, r: ResidualTable, x: np.ndarray) -> np.ndarray:
        """Return the features of some samples where the coordinate has the values `x`, (K, features, n)."""
        c = self.coordinate
        if c.ordered:
            phi = np.array([hats(row, self.at) for row in _by_sensor(x, r)])
        elif c.memory:
            size = float(np.std(self.r.sensed))
            edges = [*(s.start for s in slices(r.run)), len(r.run)]
            phi = stop_operators(r.sensed, edges, [size * w for w in MEMORIES])
        else:
            old, new = (np.array([of.columns[n] for n in c.of]) for of in (self.r, r))
            middle = old.mean(axis=1, keepdims=True) if c.gain else 0.0
            rows = (new - middle) / np.maximum(old.std(axis=1, keepdims=True), 1e-300)
            phi = np.broadcast_to(rows, (len(r.channels), *rows.shape))
        return np.concatenate([phi, phi * (r.sensed / self.scale)[:, None, :]], axis=1) if c.gain else phi

    def curve(self, residual: np.ndarray) -> Curve:
        """Return the curve of a residual (K, n)."""
        fits = self._fits(residual)
        explained, foreseen, beta, left, _ = max(fits, key=lambda f: f.explained)
        z = np.max([f.statistic for f in fits], axis=0)
        U, m = len(left), len(self.at)
        error = np.sqrt((U - 1) / U * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
        both = self.coordinate.ordered and self.coordinate.gain
        predicted = (beta[:, None] @ self.phi)[:, 0]

        def says(other: ResidualTable) -> np.ndarray | None:
            x = self.coordinate.values(other)
            return None if x is None else (beta[:, None] @ self._features(other, x))[:, 0]

        return Curve(
            self.coordinate, self.values, self.at, beta[:, :m], error[:, :m], explained, z, predicted,
            foreseen, says, beta[:, m:] if both else None, error[:, m:] if both else None, self.scale,
        )  # fmt: skip

    def _fits(self, residual: np.ndarray) -> list["_Fit"]:
        """Fit the coefficients of each sensor to its own residual, for each bending penalty."""
        r = self.r
        level, weighted = level_weights(r, residual, r.block)[:, None], r.precision @ residual
        cross, scores = (
            [
                np.array([phi[:, s] @ row[s] for s in group]) - shared[:, k]
                for k, (phi, row) in enumerate(zip(self.phi, rows, strict=True))
            ]
            for rows, group, shared in (
                (self.own[:, None] * residual, self.folds, self.shared[0]),
                (weighted, self.blocks, self.shared[1]),
            )
        )
        out = []
        for bend in BENDS if self.coordinate.ordered else BENDS[:1]:
            q = np.zeros((len(self.blocks),) * 2)
            each = []
            for gram, rest, targets, of_blocks in zip(self.gram, self.rest, cross, scores, strict=True):
                penalty = _penalty(np.diag(gram.sum(axis=0)), len(self.at), bend)
                each.append(regression(gram, targets, penalty, rest))
                own = level * of_blocks
                q += own @ np.linalg.solve(gram.sum(axis=0) + penalty, own.T)
            left = np.stack([fit.left_out for fit in each], axis=1)
            beta = np.array([fit.all for fit in each])
            parts = zip(left, self.folds, strict=True)
            foreseen = np.hstack([(own[:, None] @ self.phi[:, :, s])[:, 0] for own, s in parts])
            explained = float((foreseen * (r.precision @ (2 * residual - foreseen))).sum())
            out.append(_Fit(explained, foreseen, beta, left, of_products(q, r.run_of(r.block), r.policy)))
        return out


class FineMap:
    """Offsets in many narrow bins of a coordinate, each drawn towards 0 by what its samples can tell.

    No bin is narrower than 8 sigma of what places it, which is in the residual. There are up to 96: with
    twice as many a ripple is predicted no better on runs left out.
    """

    def __init__(self, r: ResidualTable, coordinate: Coordinate, moved: ResidualTable | None = None) -> None:
        """Take the residual on some runs; `moved`: the same with more noise in the references."""
        self.r, self.coordinate = r, coordinate
        self.values = x = _values(coordinate, r)
        low, high = np.quantile(_by_sensor(x, r), [0.002, 0.998])
        noise = max((r.sigma.get(c, 0.0) for c in r.sigma if c.endswith(f"_{coordinate.unit}")), default=0.0)
        self.bins = int(np.clip((high - low) / max(8 * noise, 1e-300), 12, 96))
        self.width = (high - low) / self.bins
        self.at = low + self.width * (np.arange(self.bins) + 0.5)
        self.low = low
        self.bin = self._bin(x, r)
        self.shared: Callable[[np.ndarray], np.ndarray | float] = lambda group: 0.0
        there = None if moved is None else coordinate.values(moved)
        if moved is not None and there is not None:
            change, other = moved.residual - r.residual, self._bin(there, r)
            self.shared = lambda group: (
                self._sums(change, group, other)[1] - self._sums(change, group, self.bin)[1]
            )
        self.prior = r.residual.size / max(r.excess, 1e-3 * r.residual.size)

    def curve(self, residual: np.ndarray) -> Curve:
        """Return the map of a residual (K, n)."""
        r = self.r
        n, sums = self._sums(residual, r.fold, self.bin)
        sums = sums - self.shared(r.fold)
        N, S = n.sum(axis=0), sums.sum(axis=0)
        left = (S - sums) / (N - n + self.prior)
        weight = np.diag(r.precision)[:, None]
        explained = float((weight * (2 * sums * left - n * left**2)).sum())
        mean = S / (N + self.prior)
        _, parts = self._sums(residual, r.block, self.bin)
        parts = parts - self.shared(r.block)
        parts *= level_weights(r, residual, r.block)[:, None, None]
        scores = (parts * np.sqrt(weight / (N + self.prior))).reshape(len(parts), -1)
        U = len(left)
        error = np.sqrt((U - 1) / U * ((left - left.mean(axis=0)) ** 2).sum(axis=0))

        def says(other: ResidualTable) -> np.ndarray | None:
            x = self.coordinate.values(other)
            return None if x is None else np.take_along_axis(mean, self._bin(x, other), axis=1)

        z = of_products(scores @ scores.T, r.run_of(r.block), r.policy)
        predicted = np.take_along_axis(mean, self.bin, axis=1)
        fold = np.unique(r.fold, return_inverse=True)[1]
        foreseen = left[fold, np.arange(len(left[0]))[:, None], self.bin]
        return Curve(
            self.coordinate, self.values, self.at, mean, error, explained, z, predicted, foreseen, says,
            fine=True,
        )  # fmt: skip

    def _bin(self, x: np.ndarray, r: ResidualTable) -> np.ndarray:
        return np.clip(((_by_sensor(x, r) - self.low) / self.width).astype(int), 0, self.bins - 1)

    def _sums(
        self, residual: np.ndarray, group: np.ndarray, bins: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Samples and sums of the residual by group, sensor and bin, (groups, K, bins) each."""
        _, index = np.unique(group, return_inverse=True)
        groups, K = index.max() + 1, len(residual)
        place = (index * K + np.arange(K)[:, None]) * self.bins + bins
        flat = place.ravel()
        shape = (groups, K, self.bins)
        size = groups * K * self.bins
        n = np.bincount(flat, minlength=size).reshape(shape).astype(float)
        return n, np.bincount(flat, residual.ravel(), size).reshape(shape)


def over(r: ResidualTable, c: Coordinate, moved: ResidualTable | None = None) -> list[Smooth | FineMap]:
    """Return what fits a residual over a coordinate: nothing where that does not vary."""
    if c.values(r) is None:
        return []
    return [make(r, c, moved) for make in ((Smooth, FineMap) if c.fine else (Smooth,))]


def _values(coordinate: Coordinate, r: ResidualTable) -> np.ndarray:
    values = coordinate.values(r)
    if values is None:
        raise ValueError(f"{coordinate.name} does not vary")
    return values


def run_gains(r: ResidualTable, residual: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return what a gain of its own in every run explains, its statistic (draws,), what it foresees (K, n).

    Each stretch of a run is predicted by the other stretches of the same run. The first draw is the log.
    """
    products = r.sensed * (r.precision @ residual)
    parts = slices(r.part)
    cross = np.array([products[:, s].sum(axis=1) for s in parts])
    gram = np.array([r.sensed[:, s] @ r.sensed[:, s].T * r.precision for s in parts])
    run = np.array([r.run[s.start] for s in parts])
    explained, sums, variance, third, foreseen = 0.0, 0.0, 0.0, 0.0, np.zeros_like(residual)
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
            foreseen[:, parts[k]] = gain[:, None] * r.sensed[:, parts[k]]
        q = even[at] @ np.linalg.solve(gram[at].sum(axis=0) + penalty, even[at].T)
        q[np.abs(np.subtract.outer(at, at)) <= 1] = 0.0
        sums = sums + ((signs[:, at] @ q) * signs[:, at]).sum(axis=1)
        variance, third = (a + b for a, b in zip((variance, third), moments(q), strict=True))
    statistic = of_sums(sums + np.zeros(len(signs)), variance, third, enough=len(parts) >= r.policy.fewest)
    return explained, statistic, foreseen


def level_weights(r: ResidualTable, residual: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return 1 / rms of the whitened residual in each group: a few wild blocks do not decide on their own.

    It is 0 for a group that is fitted exactly, such as a single knot with a zero of its own.
    """
    squares = np.einsum("kn,kl,ln->n", residual, r.precision, residual)
    means = np.array([squares[s].mean() for s in slices(group)])
    some = means > NIL * means.mean()
    return np.where(some, 1.0 / np.sqrt(np.where(some, means, 1.0)), 0.0)


def _by_sensor(x: np.ndarray, r: ResidualTable) -> np.ndarray:
    """Return values of a coordinate for each sensor, (K, n)."""
    return x if x.ndim == 2 else np.broadcast_to(x, r.residual.shape)


def _penalty(size: np.ndarray, m: int, bend: float) -> np.ndarray:
    """Penalty on the second differences of each curve over m knots, and a trace of one on their size.

    `size`: (curves * m,) squares of the features.
    """
    D = np.diff(np.eye(m), 2, axis=0)
    weight = np.maximum(size.reshape(-1, m).mean(axis=1), 1e-300)
    return np.kron(np.diag(weight), bend * D.T @ D + RIDGE * np.eye(m))
