"""What candidate effects do with the residual: products by block of samples, and what they take up of it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.normal_equations import Accumulator, eliminated, following
from hallsym.diagnosis.p_values import of_signs
from hallsym.diagnosis.refit import inverse, solve
from hallsym.diagnosis.residual_table import BLOCKS, FEWEST, FOLDS, SHORTEST, at_rest
from hallsym.diagnosis.residuals import pieces
from hallsym.diagnosis.scores import NIL, Score
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

ROOM = 40_000
"""Samples that are looked at: of a longer log some runs, evenly chosen, and of long runs the beginning."""
FEW = 8
"""Runs that are looked at at least."""
PARTS = 11
"""Groups of runs that are left out in turn."""


class Blocks:
    """Products of the columns [parameters | effects | residual] by block of samples, zeros eliminated.

    `span`: columns of each effect. `readings`: whitened readings in all.
    """

    def __init__(
        self,
        M: np.ndarray,
        readings: np.ndarray,
        run: np.ndarray,
        span: Mapping[str, slice],
        bounds: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Take the model's own parameters out: of all for significance, of the others for the shares."""
        self.run, self.span, self.bounds = run, {k: v for k, v in span.items() if k}, bounds
        self.readings = float(readings.sum())
        own = span[""].stop
        self.offset = own
        self.all, parts = _without(M.sum(axis=0), own, M)
        self.raw = np.diag(M.sum(axis=0))[own:]
        level = np.sqrt(readings / np.maximum(parts[:, -1, -1], 1e-300))
        self.scores = parts[:, :-1, -1] * level[:, None]
        order = np.unique(run, return_inverse=True)[1] % PARTS
        self.folds = []
        for k in np.unique(order):
            train, (test,) = _without(M[order != k].sum(axis=0), own, M[order == k].sum(axis=0)[None])
            self.folds.append((train, test))
        self.known: dict[tuple[str, ...], float] = {(): 0.0}

    def at(self, names: Sequence[str]) -> np.ndarray:
        """Return the columns of some effects."""
        spans = [self.span[n] for n in names]
        return np.concatenate([np.arange(s.start, s.stop) for s in spans] or [np.zeros(0, int)]) - self.offset

    def takes(self, names: Sequence[str]) -> float:
        """Return the whitened squares that some effects together take off runs they were not fitted on."""
        key = tuple(sorted(names))
        if key not in self.known:
            at = self.at(key)
            pick, total = np.append(at, -1), 0.0
            for train, test in self.folds:
                seen = np.flatnonzero(np.diag(train)[at] > NIL * self.raw[at])
                theta = np.zeros(len(at))
                theta[seen] = solve(train[np.ix_(pick, pick)], seen)
                theta = np.clip(theta, self.bounds[0][at], self.bounds[1][at])
                total += float(2 * theta @ test[at, -1] - theta @ test[np.ix_(at, at)] @ theta)
            self.known[key] = total
        return self.known[key]

    def chance(self, name: str) -> float:
        """Return the p-value of one effect: signs of its scores, block by block."""
        at = self.at([name])
        scores = self.scores[:, at]
        q = scores @ inverse(self.all[np.ix_(at, at)]) @ scores.T
        return of_signs(q, self.run)


def _without(total: np.ndarray, own: int, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return products with the first `own` columns taken out as `total` says: of `total` and of `parts`."""
    follow = -inverse(total[:own, :own]) @ total[:own, own:]
    return eliminated(total, follow), eliminated(parts, follow)


def blocks_of(base: Base, tried: Mapping[str, Score]) -> Blocks:
    """Read the fitted runs once more, where the axes were: see `smoothed`."""
    candidates = {
        name: (s.model, [n for n in s.model.names if n not in base.model.names]) for name, s in tried.items()
    }
    models = [m for m, _ in candidates.values()]
    base = replace(base, log=smoothed(base, models), keep=None)
    work = Accumulator(base, candidates)
    runs = base.log.runs
    # a log of many runs has a block for each group of neighbours, one of few runs several blocks in each
    group = {run: k * min(FOLDS, len(runs)) // len(runs) for k, run in enumerate(runs)}
    length = max(SHORTEST, -(-base.log.rows // BLOCKS)) if len(runs) < FEWEST else base.log.rows
    sums: dict[tuple[int, int], np.ndarray] = {}
    count: dict[tuple[int, int], float] = {}
    for run in work.stretches(length):
        follow = following(np.sum([s.products for s in run], axis=0), work.z)
        for part, s in enumerate(run):
            key = group[s.run], part
            sums[key] = sums.get(key, 0) + eliminated(s.products, follow)
            count[key] = count.get(key, 0.0) + s.size
    keys = sorted(sums)
    span = {k: v for k, v in work.span.items() if k not in work.slopes.spoiled}
    return Blocks(
        np.array([sums[k] for k in keys]), np.array([count[k] for k in keys]), np.array([k[0] for k in keys]),
        span, _bounds(candidates),
    )  # fmt: skip


def smoothed(base: Base, models: Sequence[Model]) -> Log:
    """Return fitted runs with the reference smoothed, readings shifted so that the residual stays as it is.

    The noise of the reference is in the residual and in what an effect makes of the reference: an effect of
    an axis that stood still would take up that noise, which is none of its doing.
    """
    model, made = base.model, {c.name for m in models for c in m.computed}
    needs = [
        c for m in (base.model, *models) for c in (*columns_of(m), *(n for k in m.computed for n in k.needs))
    ]
    kept = tuple(dict.fromkeys(c for c in (*needs, "t_s") if c not in made and c in base.log.columns))
    fitted = [run for run in base.log.runs if run not in base.apart]
    most = max(FEW, round(ROOM / base.log.rows * len(base.log.runs)))
    chosen = fitted[:: max(1, -(-len(fitted) // most))]
    read, back = on_arrays(model.reading), np.linalg.inv(base.whiten)
    count = dict.fromkeys(chosen, 0)
    parts = []
    for piece in pieces(base, frozenset(chosen), kept):
        if count[piece.run] >= ROOM / len(chosen) + SHORTEST:
            continue
        count[piece.run] += len(piece.t)
        pose = [at_rest(piece.data[f"d0_{c}"], base.sigma.get(c, 0.0)) for c in model.references]
        state = [piece.data[c] for c in model.state]
        readings = read(base.p, base.zeros_in(piece.run), pose, state)[0] + back @ piece.residual
        data = {c: piece.data[c] for c in kept} | {"run": np.full(len(piece.t), piece.run)}
        parts.append(data | dict(zip((*model.references, *model.channels), (*pose, *readings), strict=True)))
    joined = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    return Log.from_arrays(joined, base.log.noise, base.log.meta, base.log.name)


def _bounds(candidates: Mapping[str, tuple[Model, list[str]]]) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = [], []
    for model, new in candidates.values():
        low, high = (b[[model.names.index(n) for n in new]] for b in model.bounds)
        lower.append(low)
        upper.append(high)
    return np.concatenate([*lower, []]), np.concatenate([*upper, []])
