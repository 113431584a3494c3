"""Smooth curves of a residual over a coordinate: fitted, left out run by run, and tested against chance.

Per sensor the residual may have an offset and a gain that follow the coordinate smoothly: linear
interpolation between knots, bending penalised. What a curve explains is counted on runs that it was not
fitted on, so that it cannot exceed what is there. Its p-value rests on signs: without the effect the blocks'
products with the curve are as often positive as negative, whatever the noise within a block. Blocks count
alike, however large their residual. Products of a block with itself and with its neighbour in the same run
are left out, so that correlation in time does not count.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import gammaincc

from hallsym.diagnosis.residue import Coordinate, Residue, hats, knots
from hallsym.families.play import stop_operator

BEND = 0.01
"""Weight of the bending penalty against the data."""
TINY = 1e-6
MEMORIES = (0.05, 0.15, 0.4, 1.0)
"""Half-widths of the play that is looked for, over the standard deviation of what a sensor feels."""
NO_ORDER = ("direction", "acceleration", "states")
"""Coordinates that are several features and no place on a line."""
FINE = 96
"""Bins of a fine map, at most; none narrower than 8 sigma of what places it, which is in the residual."""


@dataclass(frozen=True, eq=False)
class Curve:
    """How a residual follows a coordinate.

    `at`: (m,) places. `offset`, `gain`: (K, m), the residual is offset + gain * felt / scale [m]; `gain` None
    where it has none. `spread`, `gain_spread`: standard errors of these, from runs left out in turn.
    `explained`: whitened squares that it removes from runs it was not fitted on; `predicted`: (K, n).
    """

    coordinate: Coordinate
    values: np.ndarray
    at: np.ndarray
    offset: np.ndarray
    gain: np.ndarray | None
    spread: np.ndarray
    gain_spread: np.ndarray | None
    scale: float
    explained: float
    p_value: float
    predicted: np.ndarray
    fine: bool = False


class Smooth:
    """Smooth curves over one coordinate: what does not depend on the residual is computed once."""

    def __init__(self, r: Residue, coordinate: Coordinate) -> None:
        self.r, self.coordinate = r, coordinate
        values = _values(r, coordinate)
        self.values = values
        if values is None:
            return
        self.scale = float(np.sqrt(np.mean(r.felt**2))) or 1.0
        self.at, self.phi = self._features(values)
        K, nf, n = self.phi.shape
        flat = self.phi.reshape(K * nf, n)
        P = np.kron(r.precision, np.ones((nf, nf)))
        self.gram = np.array([flat[:, s] @ flat[:, s].T * P for s in _slices(r.fold)])
        total = self.gram.sum(axis=0)
        size = np.diag(total).reshape(K, nf)
        self.penalty = _penalty(size, len(self.at), nf // len(self.at))

    def _features(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r, c = self.r, self.coordinate
        if c.column in NO_ORDER:
            phi = _unordered(r, c, r)
            at = np.array(MEMORIES) if c.column == "direction" else np.arange(float(phi.shape[1]))
            return at, phi
        each = x if x.ndim == 2 else np.broadcast_to(x, r.residual.shape)
        at = knots(each)
        phi = np.array([hats(row, at) for row in each])
        if c.gain:
            phi = np.concatenate([phi, phi * (r.felt / self.scale)[:, None, :]], axis=1)
        return at, phi

    def curve(self, residual: np.ndarray) -> Curve | None:
        """Return the curve of a residual (K, n): a parabola, or a smooth curve where that explains more."""
        if self.values is None:
            return None
        r = self.r
        K, nf, n = self.phi.shape
        weighted = r.precision @ residual
        b_of = np.einsum("kfn,kn->kfn", self.phi, weighted).reshape(K * nf, n)
        sums = np.array([b_of[:, s].sum(axis=1) for s in _slices(r.fold)])
        blocks = np.array([b_of[:, s].sum(axis=1) for s in _slices(r.block)])
        blocks *= level_weights(r, residual, r.block)[:, None]
        fits = [self._fit(V, sums, blocks) for V in self._bases()]
        p = min(1.0, len(fits) * min(p for _, _, p in fits))
        explained, coefficients, _ = max(fits, key=lambda f: f[0])
        beta, left = coefficients[0].reshape(K, nf), coefficients[1:]
        U, m = len(left), len(self.at)
        error = np.sqrt((U - 1) / U * ((left - left.mean(axis=0)) ** 2).sum(axis=0)).reshape(K, nf)
        predicted = np.einsum("kf,kfn->kn", beta, self.phi)
        both = nf == 2 * m and self.coordinate.gain
        return Curve(
            self.coordinate, self.values, self.at, beta[:, :m], beta[:, m:] if both else None, error[:, :m],
            error[:, m:] if both else None, self.scale, explained, p, predicted,
        )  # fmt: skip

    def _bases(self) -> list[np.ndarray]:
        """Columns that coefficients may be made of: all knots; parabolas through them."""
        size, m = len(self.penalty), len(self.at)
        every = [np.eye(size)]
        if self.coordinate.column in NO_ORDER or m <= 3:
            return every
        x = 2 * (self.at - self.at[0]) / (self.at[-1] - self.at[0]) - 1
        return [np.kron(np.eye(size // m), np.vander(x, 3)), *every]

    def _fit(self, V: np.ndarray, sums: np.ndarray, blocks: np.ndarray) -> tuple[float, np.ndarray, float]:
        """What coefficients V a explain on runs left out, they (of all, then without each), and chance."""
        gram = V.T @ self.gram @ V
        b, penalty = sums @ V, V.T @ self.penalty @ V
        G, B = gram.sum(axis=0), b.sum(axis=0)
        left = np.linalg.solve(G - gram + penalty, (B - b)[:, :, None])[:, :, 0]
        explained = float(2 * (b * left).sum() - np.einsum("ui,uij,uj->", left, gram, left))
        scores = blocks @ V
        p = chance_of_signs(scores @ np.linalg.solve(G + penalty, scores.T), self.r.run_of(self.r.block))
        full = np.linalg.solve(G + penalty, B)
        return explained, np.vstack([full, left]) @ V.T, p


class FineMap:
    """Offsets in many narrow bins of a coordinate, each drawn towards 0 by what its samples can tell."""

    def __init__(self, r: Residue, coordinate: Coordinate) -> None:
        self.r, self.coordinate = r, coordinate
        x = _values(r, coordinate)
        if x is None:
            self.values = None
            return
        self.values = x
        each = x if x.ndim == 2 else np.broadcast_to(x, r.residual.shape)
        low, high = np.quantile(each, [0.002, 0.998])
        noise = max((r.sigma.get(c, 0.0) for c in r.sigma if c.endswith(f"_{coordinate.unit}")), default=0.0)
        self.bins = int(np.clip((high - low) / max(8 * noise, 1e-300), 12, FINE))
        self.width = (high - low) / self.bins
        self.at = low + self.width * (np.arange(self.bins) + 0.5)
        self.bin = np.clip(((each - low) / self.width).astype(int), 0, self.bins - 1)
        self.prior = r.residual.size / max(r.excess, 1e-3 * r.residual.size)

    def curve(self, residual: np.ndarray) -> Curve | None:
        """Return the map of a residual (K, n)."""
        if self.values is None:
            return None
        r, K = self.r, len(residual)
        n, sums = self._sums(residual, r.fold)
        N, S = n.sum(axis=0), sums.sum(axis=0)
        left = (S - sums) / (N - n + self.prior)
        weight = np.diag(r.precision)[:, None]
        explained = float((weight * (2 * sums * left - n * left**2)).sum())
        mean = S / (N + self.prior)
        _, parts = self._sums(residual, r.block)
        parts *= level_weights(r, residual, r.block)[:, None, None]
        scores = (parts * np.sqrt(weight / (N + self.prior))).reshape(len(parts), -1)
        U = len(left)
        error = np.sqrt((U - 1) / U * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
        predicted = np.array([mean[k][self.bin[k]] for k in range(K)])
        return Curve(
            self.coordinate, self.values, self.at, mean, None, error, None, 1.0, explained,
            chance_of_signs(scores @ scores.T, r.run_of(r.block)), predicted, True,
        )  # fmt: skip

    def _sums(self, residual: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples and sums of the residual by group, sensor and bin, (groups, K, bins) each."""
        _, index = np.unique(group, return_inverse=True)
        groups, K = index.max() + 1, len(residual)
        place = (index * K + np.arange(K)[:, None]) * self.bins + self.bin
        flat = place.ravel()
        shape = (groups, K, self.bins)
        size = groups * K * self.bins
        n = np.bincount(flat, minlength=size).reshape(shape).astype(float)
        return n, np.bincount(flat, residual.ravel(), size).reshape(shape)


def own_gains(r: Residue, residual: np.ndarray) -> tuple[float, float]:
    """Return what a gain of its own in every run explains, and its p-value.

    Each stretch of a run is predicted by the other stretches of the same run.
    """
    weighted = r.precision @ residual
    products = r.felt * weighted
    parts = _slices(r.part)
    b = np.array([products[:, s].sum(axis=1) for s in parts])
    G = np.array([r.felt[:, s] @ r.felt[:, s].T * r.precision for s in parts])
    run = np.array([r.run[s.start] for s in parts])
    explained, q = 0.0, np.zeros((len(parts), len(parts)))
    even = level_weights(r, residual, r.part)[:, None] * b
    for number in np.unique(run):
        at = np.flatnonzero(run == number)
        total = G[at].sum(axis=0)
        total = total + np.diag(np.diag(total)) * 1e-3
        if len(at) < 3 or np.diag(total).min() <= 0:
            continue
        scale = np.sqrt(np.diag(total))
        inverse = np.linalg.pinv(total / np.outer(scale, scale), rcond=1e-9) / np.outer(scale, scale)
        q[np.ix_(at, at)] = even[at] @ inverse @ even[at].T
        for j in at:
            rest = total - G[j]
            beta = np.linalg.lstsq(rest / np.outer(scale, scale), (b[at].sum(axis=0) - b[j]) / scale,
                                   rcond=1e-9)[0] / scale  # fmt: skip
            explained += float(2 * b[j] @ beta - beta @ G[j] @ beta)
    return explained, chance_of_signs(q, run)


def level_weights(r: Residue, residual: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return 1 / rms of the whitened residual in each group: a few wild blocks do not decide on their own."""
    squares = np.einsum("kn,kl,ln->n", residual, r.precision, residual)
    means = np.array([squares[s].mean() for s in _slices(group)])
    return np.asarray(1.0 / np.sqrt(np.maximum(means, 1e-300)))


def chance_of_signs(q: np.ndarray, run: np.ndarray) -> float:
    """Return the probability that random signs of the blocks make as much of `q` as there is, one-sided.

    `q`: (blocks, blocks) products of the blocks' scores; `run`: (blocks,) where each lies. Products of a
    block with itself and with its neighbours in the same run are left out. The distribution over the signs is
    taken as a gamma distribution with the mean, variance and skewness that quadratic forms have.
    """
    q = q.copy()
    k = np.arange(len(q))
    near = (np.abs(k[:, None] - k) <= 1) & (run[:, None] == run)
    q[near | np.eye(len(q), dtype=bool)] = 0.0
    variance = 2 * float((q**2).sum())
    if variance <= 0 or len(q) < 6:
        return 1.0
    z = float(q.sum()) / np.sqrt(variance)
    skew = max(8 * float(np.einsum("ij,ji->", q @ q, q)) / variance**1.5, 0.05)
    shape = 4 / skew**2  # gamma with mean 0, variance 1 and this skewness
    x = shape + z * np.sqrt(shape)
    return float(gammaincc(shape, x)) if x > 0 else 1.0


def _values(r: Residue, c: Coordinate) -> np.ndarray | None:
    if c.column == "acceleration":
        return r.columns.get(f"d2_{r.references[0]}")
    if c.column == "states":
        return r.columns[r.state[0]] if all(np.std(r.columns[k]) > 0 for k in r.state) else None
    if c.column == "direction":
        return np.sign(r.speed) if np.std(r.felt) > 0 else None
    return c.values(r)


def _unordered(r: Residue, c: Coordinate, like: Residue) -> np.ndarray:
    """Features of a coordinate that is no place on a line, (K, features, n), scaled as on `like`."""
    if c.column == "direction":
        size = float(np.std(like.felt))
        return np.stack([_memory(r, size * w) for w in MEMORIES], axis=1)
    names = r.state if c.column == "states" else tuple(f"d2_{p}" for p in r.references)
    old, new = (np.array([x.columns[n] for n in names]) for x in (like, r))
    spread = np.maximum(old.std(axis=1), 1e-300)[:, None]
    if c.column == "acceleration":
        rows = new / spread
        return np.broadcast_to(rows, (len(r.channels), *rows.shape)).copy()
    rows = (new - old.mean(axis=1)[:, None]) / spread
    gains = rows * (r.felt / (float(np.sqrt(np.mean(like.felt**2))) or 1.0))[:, None, :]
    return np.concatenate([np.broadcast_to(rows, gains.shape), gains], axis=1)


def predicted(c: Curve, fitted: Residue, other: Residue) -> np.ndarray | None:
    """Return what a curve of `fitted` says of other samples, (K, n); None where they lack the coordinate."""
    x = _values(other, c.coordinate)
    if x is None:
        return None
    if c.coordinate.column in NO_ORDER:
        return np.asarray(np.einsum("kf,kfn->kn", c.offset, _unordered(other, c.coordinate, fitted)))
    each = x if x.ndim == 2 else np.broadcast_to(x, other.felt.shape)
    if c.fine:
        step = c.at[1] - c.at[0]
        bins = np.clip(np.rint((each - c.at[0]) / step).astype(int), 0, len(c.at) - 1)
        return np.take_along_axis(c.offset, bins, axis=1)
    out = np.array([np.interp(row, c.at, curve) for row, curve in zip(each, c.offset, strict=True)])
    if c.gain is not None:
        gain = np.array([np.interp(row, c.at, curve) for row, curve in zip(each, c.gain, strict=True)])
        out = out + gain * other.felt / c.scale
    return out


def _memory(r: Residue, width: float) -> np.ndarray:
    """Elastic part of a play of half-width `width` in what each sensor feels: its memory of the direction."""
    out = np.empty_like(r.felt)
    for s in _slices(r.run):
        for k, row in enumerate(r.felt[:, s]):
            out[k, s] = stop_operator(row, width)
    return out


def _slices(group: np.ndarray) -> list[slice]:
    """Consecutive samples of one group each."""
    edges = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(group)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _penalty(size: np.ndarray, m: int, curves: int) -> np.ndarray:
    """Penalty on the second differences of each sensor's curves, and a trace of one on their size."""
    D = np.diff(np.eye(m), 2, axis=0)
    bend = D.T @ D if m > 2 else np.zeros((m, m))
    out = []
    for row in size:
        for part in row.reshape(curves, m):
            weight = max(float(part.mean()), 1e-300)
            out.append(BEND * weight * bend + TINY * weight * np.eye(m))
    n = sum(len(p) for p in out)
    penalty, at = np.zeros((n, n)), 0
    for p in out:
        penalty[at : at + m, at : at + m] = p
        at += m
    return penalty
