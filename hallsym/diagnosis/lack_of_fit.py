"""Lack of fit: does what a model leaves depend on anything? Generic features are fitted to it and tried.

The residual, as error of the decoded pose, is regressed on families of smooth functions (`features`): curves
over each coordinate, gains that follow the state, time, temperature or velocity, polynomials of the pose,
a gain of every run. What a family predicts on runs (or stretches) that it
was not fitted on is lack of fit, whatever the noise floor is said to be; the scatter of that between folds of
runs gives a significance that is honest for noise that is correlated in time. Memory is constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hallsym.diagnosis.features import Features, Key
from hallsym.diagnosis.normal_equations import eliminated
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.regression import FOLDS, NIL, regression, ridge
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.estimation.decoding import decoding_gain

FEWEST_FOLDS = 3
"""Folds from which on a family may be judged."""
NODES = 32
"""Intervals of a curve over a coordinate."""
CHUNK = 32
"""Samples of a stretch of a run; odd ones are predicted from even ones and back."""


@dataclass(frozen=True)
class Shape:
    """How far a family of features lowers the gap metric on runs it was not fitted on, and its p-value."""

    key: Key
    drop: float
    p_value: float


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Families of features, best first."""

    shapes: tuple[Shape, ...]

    def best(self, level: float) -> Shape | None:
        """Return the family that explains most and is no chance (level corrected for all tried)."""
        tried = max(len(self.shapes), 1)
        return next((s for s in self.shapes if s.p_value * tried < level and s.drop > 0), None)


def lack_of_fit(base: Base, runs: Sequence[int]) -> LackOfFit:
    """Hold the families of features against what `base` leaves on `runs`."""
    known = frozenset(runs)
    work = _Work(base, Features(base, known))
    for piece in pieces(base, known):
        work.add(piece)
    return work.finish()


@dataclass(eq=False)
class _Products:
    """Sums over the run that is being read, and over the folds."""

    size: int
    centred: bool = True
    run: np.ndarray = field(init=False)
    folds: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.run = np.zeros((self.size, self.size))
        self.folds = np.zeros((FOLDS, self.size - 1, self.size - 1))

    def close(self, fold: int) -> None:
        """Take the run's mean out (row 0 is the constant) and add it to its fold.

        The mean of a run is only its zero's where runs have zeros; otherwise it is part of the gap.
        """
        M = self.run
        if M[0, 0] > 0:
            self.folds[fold] += eliminated(M, -M[:1, 1:] / M[0, 0]) if self.centred else M[1:, 1:]
        self.run = np.zeros_like(M)


class _Work:
    def __init__(self, base: Base, features: Features) -> None:
        self.base, self.features = base, features
        self.spread = decoding_gain(base.model)
        self.unwhiten = np.linalg.inv(base.whiten)
        self.E = len(base.model.pose)
        self.families: dict[Key, _Products] = {}
        self.run: int | None = None
        self.seen = 0
        self.within = [np.zeros((0, 0)), np.zeros((0, 0))]
        self.gained: list[tuple[float, float]] = []

    # -- one stretch -----------------------------------------------------------------------------------------

    def add(self, piece: Piece) -> None:
        if self.run is not None and piece.run != self.run:
            self._close()
        self.run = piece.run
        piece = self.features.quiet(piece)
        e = self._errors(piece)
        use = piece.used
        for key, rows in self.features.families(piece):
            x = np.vstack([np.ones(len(use)), rows, e])[:, use]
            self._of(key, len(x)).run += x @ x.T
        for key, values in self.features.lines(piece).items():
            self._curve(key, values[use], e[:, use])
        self._stretches(piece, e)

    def _of(self, key: Key, size: int) -> _Products:
        if key not in self.families:
            self.families[key] = _Products(size, bool(self.base.model.zeros))
        return self.families[key]

    def _errors(self, piece: Piece) -> np.ndarray:
        """Error of the decoded pose that the residual makes, rotation as length, (pose, samples) [m]."""
        base = self.base
        model = base.model
        pose, state = ([piece.data[c] for c in columns] for columns in (model.references, model.state))
        (gain,) = self.spread(base.p, pose, state, base.weight)
        K = len(model.channels)
        D = gain.reshape(K, self.E, -1)
        return np.einsum("kis,ks->is", D, self.unwhiten @ piece.residual) * base.pose_weights[:, None]

    def _curve(self, key: Key, x: np.ndarray, e: np.ndarray) -> None:
        """Products of hat functions over one coordinate: two of them meet at each sample."""
        m = NODES + 1
        at = np.minimum((x * NODES).astype(int), NODES - 1)
        high = x * NODES - at
        low = 1 - high
        M = self._of(key, 1 + m + self.E).run
        near = np.bincount(at, low * low, m)
        near[1:] += np.bincount(at, high * high, m)[:-1]
        across = np.bincount(at, low * high, m)[:-1]
        k = 1 + np.arange(m)
        M[k, k] += near
        M[k[:-1], k[1:]] += across
        M[k[1:], k[:-1]] += across
        sums = np.bincount(at, low, m)
        sums[1:] += np.bincount(at, high, m)[:-1]
        M[0, 0] += len(x)
        M[0, 1 : 1 + m] += sums
        M[1 : 1 + m, 0] += sums
        for i, row in enumerate(e):
            c = np.bincount(at, low * row, m)
            c[1:] += np.bincount(at, high * row, m)[:-1]
            M[1 : 1 + m, 1 + m + i] += c
            M[1 + m + i, 1 : 1 + m] += c
        M[1 + m :, 0] += e.sum(axis=1)
        M[0, 1 + m :] += e.sum(axis=1)
        M[1 + m :, 1 + m :] += e @ e.T

    def _stretches(self, piece: Piece, e: np.ndarray) -> None:
        """Products of a run's own gains and trend, over its even and its odd stretches."""
        q = self.features.moved(piece)
        x = np.vstack([q, self.features.unit(piece, "t_s"), np.ones(len(piece.t)), e])[:, piece.used]
        side = (np.arange(x.shape[1]) // CHUNK) % 2
        for k in (0, 1):
            part = x[:, side == k]
            old = self.within[k]
            self.within[k] = part @ part.T + (old if old.size else 0.0)

    # -- runs and the end ------------------------------------------------------------------------------------

    def _close(self) -> None:
        for products in self.families.values():
            products.close(self.seen % FOLDS)
        sides, n = np.array(self.within), len(self.within[0]) - self.E
        if self.within[0].shape == self.within[1].shape and n > 0 and sides[:, n - 1, n - 1].min() >= CHUNK:
            gram, cross = sides[:, :n, :n], sides[:, :n, n:]
            gain = regression(gram, cross, ridge(gram)).squares.sum()
            self.gained.append((float(gain), float(np.trace(sides.sum(axis=0)[n:, n:]))))
        self.within = [np.zeros((0, 0)), np.zeros((0, 0))]
        self.seen += 1

    def finish(self) -> LackOfFit:
        if self.run is not None:
            self._close()
        used = min(self.seen, FOLDS)
        shapes = [judged(key, p.folds[:used], self.E) for key, p in self.families.items()]
        if len(self.gained) > 2:
            gain, total = np.array(self.gained).T
            shapes.append(_shape(Key("a gain or trend of each run"), gain, float(total.sum()), beyond(gain)))
        return LackOfFit(tuple(sorted(shapes, key=lambda s: -s.drop)))


def judged(key: Key, folds: np.ndarray, E: int) -> Shape:
    """Return what a family explains of folds left out in turn; their last E columns are the errors."""
    if len(folds) < FEWEST_FOLDS:
        return Shape(key, 0.0, 1.0)
    n = folds.shape[1] - E
    own = np.diag(folds.sum(axis=0))[:n]
    live = np.flatnonzero(own > NIL * max(own.max(), 1e-300))
    gram, cross = folds[:, live[:, None], live], folds[:, live, n:]
    fit = regression(gram, cross, ridge(gram))
    scores = (fit.left_out * cross).sum(axis=(1, 2))
    noise = (fit.left_out * (cross - gram @ fit.all)).sum(axis=(1, 2))
    total = float(np.trace(folds.sum(axis=0)[n:, n:]))
    return _shape(key, fit.squares, total, beyond(scores, noise))


def _shape(key: Key, squares: np.ndarray, total: float, p_value: float) -> Shape:
    """Return a shape by the squares that it takes away, of `total`."""
    share = float(np.clip(squares.sum() / max(total, 1e-300), 0.0, 1.0))
    return Shape(key, 1 - float(np.sqrt(1 - share)), p_value)
