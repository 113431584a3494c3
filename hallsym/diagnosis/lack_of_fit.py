"""Lack of fit: does what a model leaves depend on anything? Generic features are fitted to it and tried.

The residual, as error of the decoded pose, is regressed on families of smooth functions (`features`): curves
over each coordinate, gains that follow the state, time, temperature or velocity, polynomials of the pose, the
past of the motion, a gain of every run, spectral lines. What a family predicts on runs (or stretches) that it
was not fitted on is lack of fit, whatever the noise floor is said to be; the scatter of that between folds of
runs gives a significance that is honest for noise that is correlated in time. Memory is constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hallsym.diagnosis.coordinates import hats
from hallsym.diagnosis.features import LAGS, PAST, Features, Key
from hallsym.diagnosis.normal_equations import eliminated
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.regression import regression, ridge
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.estimation.decoding import decoding_gain

FOLDS = 13
"""Groups of runs left out in turn; a prime, so that they do not fall in step with settings that recur."""
FEWEST_FOLDS = 3
"""Folds from which on a family may be judged."""
NODES = 128
"""Intervals of the finest curve over a coordinate."""
LEVELS = (1, 4, 16)
"""Curves with NODES / level intervals are tried."""
CHUNK = 32
"""Samples of a stretch of a run; odd ones are predicted from even ones and back."""
SEGMENT = 128
"""Samples of a segment of the spectrum."""
FEWEST_SEGMENTS = 8
"""Segments from which on a spectrum has lines."""
AROUND = 7
"""Frequencies on either side of one whose median is what a line stands out from."""
SLOWEST = 4
"""Frequencies of a segment that are drift and no line."""
CERTAIN = 8.0
"""Standard deviations of the mean power of noise by which a line stands out."""
STEADY = 0.5
"""Variance of a line's power within runs, over its square and over that of noise, below which it is a tone.

The power of noise, also of a resonance that noise excites, scatters in each line by as much as it is."""
NIL = 1e-9
"""Squares of a feature, over the largest of its family, below which it never moves."""


@dataclass(frozen=True)
class Shape:
    """How far a family of features lowers the gap metric on runs it was not fitted on, and its p-value."""

    key: Key
    drop: float
    p_value: float


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Families of features, best first; `lines`: decrease of the metric without the lines of steady tones."""

    shapes: tuple[Shape, ...]
    lines: float = 0.0

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
        self.curves: set[Key] = set()
        self.run: int | None = None
        self.seen = 0
        self.within = [np.zeros((0, 0)), np.zeros((0, 0))]
        self.gained: list[tuple[float, float]] = []
        self.power = np.zeros(SEGMENT // 2 + 1)
        self.segments = 0
        self.of_run: list[np.ndarray] = []
        self.single: list[np.ndarray] = []
        self.scatter = np.zeros((2, SEGMENT // 2 + 1))

    # -- one stretch -----------------------------------------------------------------------------------------

    def add(self, piece: Piece) -> None:
        if self.run is not None and piece.run != self.run:
            self._close()
        self.run = piece.run
        piece = self.features.quiet(piece)
        e = self._errors(piece)
        use = piece.used
        self._spectrum(e, use)
        for key, rows in self.features.families(piece):
            skip = LAGS if key == PAST else 0
            x = np.vstack([np.ones(len(use)), rows, e])[:, skip:][:, use[skip:]]
            self._of(key, len(x)).run += x @ x.T
        for key, values in self.features.lines(piece).items():
            self.curves.add(key)
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

    def _spectrum(self, e: np.ndarray, use: np.ndarray) -> None:
        e = np.where(use, e, 0.0)
        window = np.hanning(SEGMENT)
        for low in range(0, e.shape[1] - SEGMENT + 1, SEGMENT):
            part = e[:, low : low + SEGMENT]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            self.of_run.append((np.abs(np.fft.rfft(part, axis=1)) ** 2).sum(axis=0))
            self.segments += 1

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
        if self.of_run:
            self.power += np.sum(self.of_run, axis=0)
            if len(self.of_run) == 1:
                self.single += self.of_run
            else:
                self._scattered(self.of_run)
            self.of_run = []
        self.seen += 1

    def _scattered(self, segments: Sequence[np.ndarray]) -> None:
        """Add the squares by which the power of segments scatters, and those of its mean."""
        mean = np.mean(segments, axis=0)
        squares = np.sum((np.array(segments) - mean) ** 2, axis=0)
        self.scatter += np.array([squares, (len(segments) - 1) * mean**2])

    def finish(self) -> LackOfFit:
        if self.run is not None:
            self._close()
        shapes = []
        for key, products in self.families.items():
            used = products.folds[: min(self.seen, FOLDS)]
            for level in LEVELS if key in self.curves else (1,):
                shapes.append(judged(key, _coarse(used, level, self.E), self.E))
        if len(self.gained) > 2:
            gain, total = np.array(self.gained).T
            shapes.append(_shape(Key("a gain or trend of each run"), gain, float(total.sum()), beyond(gain)))
        return LackOfFit(tuple(sorted(shapes, key=lambda s: -s.drop)), self._lines())

    def _lines(self) -> float:
        """Decrease of the metric without the narrow peaks of the spectrum."""
        if self.segments < FEWEST_SEGMENTS:
            return 0.0
        P = self.power.copy()
        wide = np.pad(P, AROUND, mode="reflect")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(wide, 2 * AROUND + 1), axis=1)
        certain = P / smooth > 1 + CERTAIN / np.sqrt(self.E * self.segments)
        certain[:SLOWEST] = False
        if not self._steady(certain):
            return 0.0
        share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
        return 1 - float(np.sqrt(max(1 - share, 0.0)))

    def _steady(self, certain: np.ndarray) -> bool:
        """Return whether lines have the same power all through a run, unlike noise of their frequency.

        Runs too short for that are held against each other.
        """
        if len(self.single) > 1:
            self._scattered(self.single)
        varies, squares = self.scatter
        noise = ~certain & (squares > 0)
        if not noise.any() or not squares[certain].sum() > 0:
            return True
        # the median: a few frequencies beside a line have a part of its power
        usual = float(np.median(varies[noise] / squares[noise]))
        return bool(varies[certain].sum() < STEADY * usual * squares[certain].sum())


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


def _coarse(folds: np.ndarray, level: int, E: int) -> np.ndarray:
    """Products of curves with wider hats, which are sums of the finer ones."""
    if level == 1:
        return folds
    m = NODES + 1
    wide = hats(np.arange(float(m)), np.arange(0.0, m, level)).T
    T = np.zeros((folds.shape[1], wide.shape[1] + E))
    T[:m, : wide.shape[1]] = wide
    T[m:, wide.shape[1] :] = np.eye(E)
    return T.T @ folds @ T
