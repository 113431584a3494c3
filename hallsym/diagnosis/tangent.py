"""What every candidate effect does to the readings, to first order, as one small matrix per run.

One pass over the log stacks, sample by sample, the columns [zeros | parameters | effects | residual]: the
derivatives of the reading with respect to each, and what the model leaves. Per run only their products are
kept, twice: weighted by the noise of the readings (what a fit minimises) and mapped to the decoded pose (what
the gap metric measures). A run's zeros are eliminated at once. From these matrices any set of effects can be
fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from hallsym.arrays import on_arrays
from hallsym.batches import Batch, Weigh, batches
from hallsym.computed import extended
from hallsym.decoding import columns_of
from hallsym.log import Log
from hallsym.model import Model

UNITS = 64
"""Runs whose matrices are kept one by one; beyond that neighbouring runs are pooled."""


@dataclass(frozen=True, eq=False)
class Base:
    """A fitted model on a log: what all tangents are taken at.

    `p`: (n,) values; `zeros`: displacement by run; `covariance`: (K, K) of one residual; `free`: index of
    parameters that the fit moves; `length_m`: what turns rotation into length in the gap metric; `apart`:
    held-out runs; `timed`: whether the log holds time, and not a counter in its place.
    """

    log: Log
    model: Model
    p: np.ndarray
    zeros: Mapping[int, np.ndarray]
    covariance: np.ndarray
    free: tuple[int, ...]
    length_m: float
    apart: frozenset[int]
    sigma: Mapping[str, float]
    keep: Weigh | None = None
    timed: bool = True

    @property
    def weight(self) -> np.ndarray:
        """1 / variance of each channel's reading, for decoding with more probes than coordinates."""
        return 1.0 / np.diag(self.covariance)


@dataclass(frozen=True, eq=False)
class Tangents:
    """Products of the columns [parameters | effects | residual], the zeros of each run eliminated.

    `likelihood`, `output`: (units, c, c). `count`: (units,) samples. `runs`: the runs of each unit.
    `span`: columns of each candidate, by its key; the base's parameters are under "".
    """

    likelihood: np.ndarray
    output: np.ndarray
    count: np.ndarray
    runs: tuple[tuple[int, ...], ...]
    span: dict[str, slice]
    follow: np.ndarray
    """(runs, zeros, c): how the zeros of a run follow the other columns; none with candidates."""
    order: tuple[int, ...]
    """The runs of `follow`."""
    spoiled: frozenset[str] = frozenset()
    """Candidates whose slope is not finite somewhere; their columns are 0."""

    def units(self, runs: Sequence[int]) -> np.ndarray:
        """Return the index of the units whose runs are all among `runs`."""
        known = set(runs)
        return np.array([k for k, unit in enumerate(self.runs) if known.issuperset(unit)], dtype=int)


Unit = tuple[tuple[int, ...], np.ndarray, np.ndarray, float]
"""Runs, products for the likelihood, products in the output, samples."""
Signature = Callable[..., list[np.ndarray]]


def signature(model: Model, new: Sequence[str]) -> Signature:
    """Return `(p, zeros, pose, state) -> d reading / d new parameters` on arrays, (K * n_new, samples)."""
    s = model.symbols
    index = [model.names.index(name) for name in new]
    slope = ca.jacobian(s.full(s.reading), s.parameters)[:, index]
    return on_arrays(ca.Function("signature", [s.parameters, s.zeros, s.pose, s.state], [ca.densify(slope)]))


def decoding_gain(model: Model) -> Signature:
    """Return `(p, pose, state, weight) -> d pose / d reading` on arrays, (K * n_pose, samples).

    A chip that gives the pose itself has 1: where its channels clip it loses the pose, not its unit.
    """
    if len(model.channels) > 1:
        return on_arrays(model.noise_gain_at)
    return lambda p, pose, state, weight: [np.ones((1, np.size(pose[0])))]


@lru_cache(maxsize=16)
def _base_functions(model: Model) -> tuple[Signature, Signature]:
    s = model.symbols
    reading = s.full(s.reading)
    both = [ca.densify(reading), ca.densify(ca.jacobian(reading, s.parameters))]
    if len(model.zeros):
        both.append(ca.densify(ca.jacobian(reading, s.zeros)))
    run = on_arrays(ca.Function("base", [s.parameters, s.zeros, s.pose, s.state], both))
    return run, decoding_gain(model)


def tangents(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]],
    on_rows: Callable[[int], None] | None = None,
) -> Tangents:
    """Read the log once and return the tangents of `candidates`: key -> (extended model, new parameters).

    New parameters are taken at their nominal value, where they have no effect.
    """
    work = Products(base, candidates)
    log = extended(base.log, _with_rules(base.model, [m for m, _ in candidates.values()]), base.sigma)
    columns = tuple(
        dict.fromkeys(c for m in (base.model, *(m for m, _ in candidates.values())) for c in columns_of(m))
    )
    for batch in batches(log, columns, on_rows):
        work.add(batch, batch.weights(base.keep))
    return work.result()


def _with_rules(model: Model, others: Sequence[Model]) -> Model:
    for other in others:
        model = model.with_columns(*other.computed)
    return model


class Products:
    """Accumulates the products of each run."""

    def __init__(
        self, base: Base, candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None
    ) -> None:
        self.base = base
        self.read, self.gain = _base_functions(base.model)
        self.z, self.n = len(base.model.zeros), len(base.free)
        self.signatures = []
        self.span, at = {"": slice(0, self.n)}, self.n
        for key, (model, new) in (candidates or {}).items():
            p = model.vector(dict(zip(base.model.names, base.p.tolist(), strict=True)))
            self.signatures.append((key, signature(model, new), model, p, len(new)))
            self.span[key] = slice(at, at + len(new))
            at += len(new)
        self.size = self.z + at + 1
        self.whiten = np.linalg.cholesky(np.linalg.inv(base.covariance)).T
        self.scale = np.where(np.arange(len(base.model.pose)) == 2, base.length_m, 1.0)
        self.run: int | None = None
        self.done: list[Unit] = []
        self.order: list[int] = []
        self.begun = 0
        self.follow: list[np.ndarray] = []
        self.spoiled: set[str] = set()

    def add(self, batch: Batch, weights: np.ndarray | None) -> None:
        """Add a batch to the runs that it belongs to."""
        A, D = self.columns(batch, weights)
        for block, part in batch.parts():
            a = A[:, :, part]
            white = self._whitened(a)
            out = _mapped(D[:, :, part], a)
            count = float(part.stop - part.start if weights is None else weights[part].sum())
            self._gather(block.run, self._products(white), self._products(out), count)

    def _products(self, rows: np.ndarray) -> np.ndarray:
        """Products of all columns with zeros, parameters and residual, and of each candidate with itself.

        Those between two candidates are nobody's business and stay 0.
        """
        own = self.z + self.n
        near = np.vstack([rows[:own], rows[-1:]])
        M = np.zeros((self.size, self.size))
        across = rows @ near.T
        M[:, :own], M[:, -1] = across[:, :own], across[:, -1]
        M[:own], M[-1] = M[:, :own].T, M[:, -1]
        for span in self.span.values():
            k = slice(self.z + span.start, self.z + span.stop)
            if span.start >= self.n:
                M[k, k] = rows[k] @ rows[k].T
        return M

    def _whitened(self, a: np.ndarray) -> np.ndarray:
        return _mapped(self.whiten[:, :, None], a)

    def columns(self, batch: Batch, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns, (c, K, samples), and what turns them into decoded pose, (pose, K, samples)."""
        base, model = self.base, self.base.model
        samples, K = len(batch), len(model.channels)
        own = np.array([base.zeros.get(b.run, np.zeros(self.z)) for b in batch.blocks])
        zeros = np.repeat(own, np.diff(batch.edges), axis=0).T
        pose, state = batch.columns(model.references), batch.columns(model.state)
        A = np.empty((self.size, K, samples))
        reading, *slopes = self.read(base.p, zeros, pose, state)
        A[self.z : self.z + self.n] = slopes[0].reshape(-1, K, samples)[list(base.free)]
        if self.z:
            A[: self.z] = slopes[1].reshape(-1, K, samples)
        at = self.z + self.n
        for key, run, extended_model, p, new in self.signatures:
            (slope,) = run(p, zeros, pose, batch.columns(extended_model.state))
            if not np.isfinite(slope).all():
                self.spoiled.add(key)
                slope = np.zeros_like(slope)
            A[at : at + new] = slope.reshape(new, K, samples)
            at += new
        A[-1] = np.array(batch.columns(model.channels)) - reading
        if weights is not None:
            A *= np.sqrt(weights)
        (spread,) = self.gain(base.p, pose, state, base.weight)
        D = spread.reshape(K, len(model.pose), samples).swapaxes(0, 1) * self.scale[:, None, None]
        return A, D

    def segments(self, size: int) -> Iterator[tuple[int, float, np.ndarray]]:
        """Yield run, first time [s since the log began] and products of each stretch of `size` samples."""
        origin: float | None = None
        log = extended(self.base.log, self.base.model, self.base.sigma)
        for batch in batches(log, (*columns_of(self.base.model), "t_s")):
            A, _ = self.columns(batch, batch.weights(self.base.keep))
            t = batch.data["t_s"]
            origin = float(t[0]) if origin is None else origin
            for block, part in batch.parts():
                for low in range(part.start, part.stop, size):
                    white = self._whitened(A[:, :, low : min(low + size, part.stop)])
                    yield block.run, float(t[low]) - origin, white @ white.T

    def _gather(self, run: int, white: np.ndarray, out: np.ndarray, count: float) -> None:
        if run != self.run:
            self.done.append(((run,), white, out, count))
            self.order.append(run)
            self.begun += 1
            self.run = run
        else:
            _, w, o, c = self.done[-1]
            self.done[-1] = ((run,), w + white, o + out, c + count)
        if len(self.done) > 1 and len(self.follow) < self.begun - 1:
            self.done[-2] = self._reduced(self.done[-2])
            if len(self.done) > 2 * UNITS:
                self._pool()

    def _pool(self) -> None:
        """Pool neighbouring units of the same side, all but the last, which is still being read."""
        sides: dict[bool, list[Unit]] = {True: [], False: []}
        for unit in self.done[:-1]:
            sides[unit[0][0] in self.base.apart].append(unit)
        pooled = []
        for units in sides.values():
            for k in range(0, len(units), 2):
                pair = units[k : k + 2]
                runs = tuple(run for r, *_ in pair for run in r)
                white = np.sum([w for _, w, _, _ in pair], axis=0)
                out = np.sum([o for _, _, o, _ in pair], axis=0)
                pooled.append((runs, white, out, float(sum(count for *_, count in pair))))
        self.done[:-1] = pooled

    def _reduced(self, entry: Unit) -> Unit:
        """Eliminate the zeros of a run: they follow the likelihood, also where the output is measured."""
        run, white, out, count = entry
        z = self.z
        if z == 0:
            self.follow.append(np.zeros((0, self.size)))
            return entry
        follow = -np.linalg.lstsq(white[:z, :z], white[:z, z:], rcond=1e-12)[0]
        # candidates are scored, not stepped to: with them nobody asks, and a log may have many runs
        self.follow.append(follow[:, :0] if self.signatures else follow)
        half = out[z:, :z] @ follow
        half += half.T + follow.T @ out[:z, :z] @ follow
        return run, white[z:, z:] + white[z:, :z] @ follow, out[z:, z:] + half, count

    def result(self) -> Tangents:
        """Return what has been gathered."""
        if self.done and len(self.follow) < self.begun:
            self.done[-1] = self._reduced(self.done[-1])
        return Tangents(
            np.array([w for _, w, _, _ in self.done]),
            np.array([o for _, _, o, _ in self.done]),
            np.array([c for *_, c in self.done]),
            tuple(runs for runs, *_ in self.done),
            self.span,
            np.array(self.follow),
            tuple(self.order),
            frozenset(self.spoiled),
        )


def _mapped(D: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Apply (J, K, samples or 1) to columns (c, K, samples); entries that are nil throughout cost nothing."""
    out = np.zeros((len(a), len(D), a.shape[2]))
    for j, row in enumerate(D):
        for k, factor in enumerate(row):
            if np.any(factor):
                out[:, j] += factor * a[:, k]
    return out.reshape(len(a), -1)
