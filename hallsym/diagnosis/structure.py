"""Is what a model leaves structured? Generic shapes are fitted to it on some runs and tried on others.

The remainder, as error of the decoded pose, is regressed on families of smooth functions: curves over each
coordinate, gains that follow the vertical state, time, temperature or velocity, polynomials of the pose, the
past of the motion, a gain of every run, spectral lines. What a family predicts on runs (or stretches) that it
was not fitted on is structure, whatever the noise floor is said to be; the scatter of that between folds of
runs gives a significance that is honest for noise that is correlated in time. One pass, constant memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.chance import beyond
from hallsym.diagnosis.predicted import Shape, gained, judged, shape, solved
from hallsym.diagnosis.residuals import Piece, pieces
from hallsym.estimation.decoding import decoding_gain
from hallsym.model.arrays import on_arrays

FOLDS = 13
"""Groups of runs left out in turn; a prime, so that they do not fall in step with settings that recur."""
NODES = 128
"""Intervals of the finest curve over a coordinate."""
LEVELS = (1, 4, 16)
"""Curves with NODES / level intervals are tried."""
LAGS = 24
"""Samples of the past that the motion is remembered for."""
WAVES = 12
"""Waves per turn up to which the error of what goes round is a series: smooth, in few samples."""
CHUNK = 32
"""Samples of a stretch of a run; odd ones are predicted from even ones and back."""
SEGMENT = 128
"""Samples of a segment of the spectrum."""
STILL = 5.0
"""An axis that moves less than this many sigma of its noise (rms) stands still.

Its logged place is then noise to 4 % of its variance, and that noise is in the residual too."""
CURVES = ("place", "reading", "displacement")
"""First words of the families that are curves over one coordinate."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Families of shapes, best first; `tried` of them. `lines`: decrease of the metric without its lines."""

    shapes: tuple[Shape, ...]
    lines: float = 0.0

    @property
    def tried(self) -> int:
        """Number of families."""
        return max(len(self.shapes), 1)

    def drop(self, by: str) -> float:
        """Return what one family explains, 0 for an unknown one."""
        return next((s.drop for s in self.shapes if s.by == by), 0.0)

    def best(self, level: float) -> Shape | None:
        """Return the family that explains most and is no chance (level corrected for all tried)."""
        return next((s for s in self.shapes if s.p_value * self.tried < level and s.drop > 0), None)


def structure(base: Base, runs: Sequence[int]) -> Structure:
    """Hold the generic families against what `base` leaves on `runs`."""
    known = frozenset(runs)
    work = _Work(base, _ranges(base, known), len(known))
    for piece in pieces(base, known):
        work.add(piece)
    return work.finish()


def _ranges(base: Base, runs: frozenset[int]) -> dict[str, tuple[float, float]]:
    """Middle and half range of every logged column and rate, from a sample of the log."""
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    for piece in pieces(base, runs):
        columns = piece.data | {c: piece.readings[k] for k, c in enumerate(base.model.channels)}
        for c, values in columns.items():
            low[c] = min(low.get(c, np.inf), float(values.min(initial=np.inf)))
            high[c] = max(high.get(c, -np.inf), float(values.max(initial=-np.inf)))
    return {c: (0.5 * (low[c] + high[c]), max(0.5 * (high[c] - low[c]), 1e-300)) for c in low}


@dataclass(eq=False)
class _Products:
    """Sums over the run that is being read, and over the folds."""

    size: int
    centred: bool = True
    run: np.ndarray = field(init=False)
    folds: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.run = np.zeros((self.size, self.size))
        self.folds = np.zeros((FOLDS, self.size, self.size))

    def close(self, fold: int) -> None:
        """Take the run's mean out (row 0 is the constant) and add it to its fold.

        The mean of a run is only its zero's where runs have zeros; otherwise it is part of the gap.
        """
        M = self.run
        if M[0, 0] > 0:
            self.folds[fold] += M - np.outer(M[0], M[0]) / M[0, 0] if self.centred else M
        self.run = np.zeros_like(M)


class _Work:
    def __init__(self, base: Base, ranges: dict[str, tuple[float, float]], runs: int) -> None:
        self.base, self.ranges = base, ranges
        model = base.model
        self.gain, self.spread = on_arrays(model.gain), decoding_gain(model)
        self.read = on_arrays(model.reading)
        self.unwhiten = np.linalg.inv(base.whiten)
        self.E = len(model.pose)
        self.turning = all(c in model.period for c in model.references)
        self.waves = int(np.clip(runs // 3, 3, 12))
        self.families: dict[str, _Products] = {}
        self.run: int | None = None
        self.seen = 0
        self.within = [np.zeros((0, 0)), np.zeros((0, 0))]
        self.gained: list[tuple[float, float]] = []
        self.power = np.zeros(SEGMENT // 2 + 1)
        self.segments = 0

    # -- one stretch -----------------------------------------------------------------------------------------

    def add(self, piece: Piece) -> None:
        if self.run is not None and piece.run != self.run:
            self._close()
        self.run = piece.run
        piece = self._quiet(piece)
        e = self._errors(piece)
        use = piece.used
        self._spectrum(e, use)
        for by, rows in self._dense(piece).items():
            skip = LAGS if by == "the past of the motion" else 0
            x = np.vstack([np.ones(len(use)), rows, e])[:, skip:][:, use[skip:]]
            self._of(by, len(x)).run += x @ x.T
        for by, values in self._coordinates(piece).items():
            self._curve(by, values[use], e[:, use])
        self._stretches(piece, e)

    def _quiet(self, piece: Piece) -> Piece:
        """Take from the coordinates what noise they share with the residual.

        The reference is smoothed, an axis whose motion is its noise stands still, and readings are the ones
        expected there: else the noise of a coordinate would explain itself.
        """
        base, model, data = self.base, self.base.model, dict(piece.data)
        for c in model.references:
            smooth = data[f"d0_{c}"]
            if np.std(smooth) <= STILL * base.sigma.get(c, 0.0):
                smooth = np.full(len(smooth), smooth.mean() if len(smooth) else 0.0)
                data |= {f"d{k}_{c}": np.zeros(len(smooth)) for k in (1, 2, 3)}
            data[c] = smooth
        pose, state = ([data[c] for c in columns] for columns in (model.references, model.state))
        (expected,) = self.read(base.p, base.zeros_in(piece.run), pose, state)
        return replace(piece, data=data, readings=expected)

    def _of(self, by: str, size: int) -> _Products:
        if by not in self.families:
            self.families[by] = _Products(size, bool(self.base.model.zeros))
        return self.families[by]

    def _errors(self, piece: Piece) -> np.ndarray:
        """Error of the decoded pose that the residual makes, rotation as length, (pose, samples) [m]."""
        base = self.base
        model = base.model
        pose, state = ([piece.data[c] for c in columns] for columns in (model.references, model.state))
        (gain,) = self.spread(base.p, pose, state, base.weight)
        K = len(model.channels)
        D = gain.reshape(K, self.E, -1)
        return np.einsum("kis,ks->is", D, self.unwhiten @ piece.residual) * base.pose_weights[:, None]

    def _unit(self, piece: Piece, column: str) -> np.ndarray:
        middle, half = self.ranges[column]
        return (piece.data[column] - middle) / half

    def _coordinates(self, piece: Piece) -> dict[str, np.ndarray]:
        """Coordinates of the curves, each scaled to 0 .. 1."""
        model = self.base.model
        if self.turning:
            where = {c: f"place in the turn of {c.removesuffix('_ref_rad')}" for c in model.references}
            return {by: piece.data[c] / model.period[c] % 1.0 for c, by in where.items()}
        out = {f"place of {c.removesuffix('_ref_m').removesuffix('_ref_rad')}": (self._unit(piece, c) + 1) / 2
               for c in model.references}  # fmt: skip
        (gain,) = self.gain(self.base.p, [piece.data[c] for c in model.state])
        for k, c in enumerate(model.channels):
            middle, half = self.ranges[c]
            out[f"reading {c}"] = ((piece.readings[k] - middle) / half + 1) / 2
            eta = float(np.asarray(model.gain(self.base.p, np.zeros(len(model.state)))).ravel()[k])
            felt = piece.readings[k] * eta / np.where(gain[k] == 0, 1.0, gain[k])
            out[f"displacement at {c}"] = ((felt - middle) / (1.2 * half) + 1) / 2
        return {by: np.clip(x, 0.0, 1.0) for by, x in out.items()}

    def _dense(self, piece: Piece) -> dict[str, np.ndarray]:
        """Families of few functions, each (n_functions, samples)."""
        model, unit = self.base.model, lambda c: self._unit(piece, c)
        q = self._moved(piece)
        v = np.array([piece.data[f"d1_{c}"] / self.ranges[f"d1_{c}"][1] for c in model.references])
        a = np.array([piece.data[f"d2_{c}"] / self.ranges[f"d2_{c}"][1] for c in model.references])
        j = np.array([piece.data[f"d3_{c}"] / self.ranges[f"d3_{c}"][1] for c in model.references])
        if self.turning:
            return self._around(piece, q, v, a)
        out = {"the pose together": _powers(q, 4)}
        heights = [c for c in ("z_m", "rx_rad", "ry_rad") if c in piece.data]
        if heights:
            s = _powers(np.array([unit(c) for c in heights]), 3)
            out["height and tilts"] = np.vstack([s, *(s * x for x in q), q])
        t = _hats((unit("t_s") + 1) / 2, self.waves)
        out["time"] = np.vstack([t, *(t * x for x in q)])
        if "temperature_degc" in piece.data:
            w = _powers(unit("temperature_degc")[None], 3)
            out["temperature"] = np.vstack([w, *(w * x for x in q), q])
        out["velocity"] = np.vstack(
            [v, np.abs(v), v * np.abs(v), v**3, *(v * x for x in q), *(np.abs(v) * x for x in q)]
        )
        direction = np.tanh(v / 0.05)
        out["direction of motion"] = np.vstack(
            [d * _hats((x + 1) / 2, 9) for d, x in zip(direction, q, strict=True)]
        )
        out["acceleration"] = np.vstack([a, np.abs(a), j, *(a * x for x in q), *(j * x for x in q)])
        past = [np.roll(q, k, axis=1) for k in range(LAGS)]
        out["the past of the motion"] = np.vstack(past)
        return out

    def _moved(self, piece: Piece) -> np.ndarray:
        """Where the pose was: its coordinates over their ranges, two harmonics of what goes round."""
        model = self.base.model
        if not self.turning:
            return np.array([self._unit(piece, c) for c in model.references])
        angles = [2 * np.pi * n / model.period[c] * piece.data[c] for c in model.references for n in (1, 2)]
        return np.array([f(angle) for angle in angles for f in (np.cos, np.sin)])

    def _around(self, piece: Piece, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, np.ndarray]:
        """Families of what goes round: q are harmonics of the turn, v and a its speed and acceleration."""

        model = self.base.model

        def both(x: np.ndarray) -> np.ndarray:
            return np.vstack([x, *(x * row for row in q)])

        turns = [2 * np.pi / model.period[c] * piece.data[c] for c in model.references]
        orders = np.arange(1, WAVES + 1)[:, None]
        out = {"waves of the turn": np.vstack([f(orders * u) for u in turns for f in (np.cos, np.sin)])}
        if "temperature_degc" in piece.data:
            out["temperature"] = both(_powers(self._unit(piece, "temperature_degc")[None], 3))
        if not self.base.timed:  # a counter stands for the time
            return out
        out["time"] = both(_hats((self._unit(piece, "t_s") + 1) / 2, self.waves))
        out["velocity"] = both(np.vstack([v, np.abs(v), v * np.abs(v), v**3]))
        out["direction of motion"] = both(np.tanh(v / 0.05))
        out["acceleration"] = both(np.vstack([a, np.abs(a)]))
        return out

    def _curve(self, by: str, x: np.ndarray, e: np.ndarray) -> None:
        """Products of hat functions over one coordinate: two of them meet at each sample."""
        m = NODES + 1
        at = np.minimum((x * NODES).astype(int), NODES - 1)
        high = x * NODES - at
        low = 1 - high
        M = self._of(by, 1 + m + self.E).run
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
        q = self._moved(piece)
        x = np.vstack([q, self._unit(piece, "t_s"), np.ones(len(piece.t)), e])[:, piece.used]
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
            self.power += (np.abs(np.fft.rfft(part, axis=1)) ** 2).sum(axis=0)
            self.segments += 1

    # -- runs and the end ------------------------------------------------------------------------------------

    def _close(self) -> None:
        for products in self.families.values():
            products.close(self.seen % FOLDS)
        even, odd = self.within
        n = len(even) - self.E
        if even.size and odd.size and min(even[n - 1, n - 1], odd[n - 1, n - 1]) >= CHUNK:
            gain = gained(solved(even, n), odd) + gained(solved(odd, n), even)
            self.gained.append((gain, float(np.trace((even + odd)[n:, n:]))))
        self.within = [np.zeros((0, 0)), np.zeros((0, 0))]
        self.seen += 1

    def finish(self) -> Structure:
        if self.run is not None:
            self._close()
        shapes = []
        for by, products in self.families.items():
            used = products.folds[: min(self.seen, FOLDS)]
            if by.startswith(CURVES):
                shapes += [judged(by, _coarse(used, level, self.E), self.E) for level in LEVELS]
            else:
                shapes.append(judged(by, used, self.E))
        if len(self.gained) > 2:
            gain, total = np.array(self.gained).T
            shapes.append(shape("a gain or trend of each run", gain, float(total.sum()), beyond(gain)))
        return Structure(tuple(sorted(shapes, key=lambda s: -s.drop)), self._lines())

    def _lines(self) -> float:
        """Decrease of the metric without the narrow peaks of the spectrum."""
        if self.segments < 8:
            return 0.0
        P = self.power.copy()
        wide = np.pad(P, 7, mode="reflect")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(wide, 15), axis=1)
        certain = P / smooth > 1 + 8 / np.sqrt(self.E * self.segments)
        certain[:4] = False
        share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
        return 1 - float(np.sqrt(max(1 - share, 0.0)))


def _powers(x: np.ndarray, degree: int) -> np.ndarray:
    """Products of the rows of x up to `degree`, without the constant."""
    rows = [
        np.prod(x[list(pick)], axis=0)
        for n in range(1, degree + 1)
        for pick in combinations_with_replacement(range(len(x)), n)
    ]
    return np.array(rows)


def _hats(x: np.ndarray, count: int) -> np.ndarray:
    """`count` hat functions over 0 .. 1, (count, samples)."""
    return np.maximum(0.0, 1 - np.abs(x * (count - 1) - np.arange(count)[:, None]))


def _coarse(folds: np.ndarray, level: int, E: int) -> np.ndarray:
    """Products of curves with wider hats, which are sums of the finer ones."""
    if level == 1:
        return folds
    m = NODES + 1
    wide = _hats(np.arange(m) / NODES, NODES // level + 1).T
    T = np.zeros((folds.shape[1], 1 + wide.shape[1] + E))
    T[0, 0] = 1.0
    T[1 : 1 + m, 1 : 1 + wide.shape[1]] = wide
    T[1 + m :, 1 + wide.shape[1] :] = np.eye(E)
    return T.T @ folds @ T
