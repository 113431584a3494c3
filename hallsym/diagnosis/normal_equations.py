"""Normal equations of a model and of candidate effects, run by run.

One pass over the log stacks, sample by sample, the columns [zeros | parameters | effects | residual]: the
derivatives of the reading with respect to each, and the residual of the model. Of each run only the products
of these columns are kept, twice: weighted by the noise of the readings (what a fit minimises) and mapped to
the decoded pose (what the gap metric measures). The zeros of a run are eliminated at once. With these
matrices any set of effects can be fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hallsym.diagnosis.derivatives import Slopes, reading_and_derivatives
from hallsym.diagnosis.many_channels import Shared, by_candidate
from hallsym.diagnosis.residuals import Base
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.estimation.decoding import columns_of, decoding_gain
from hallsym.log.batches import Batch, batches
from hallsym.log.derived import extended
from hallsym.model import Model

UNITS = 64
"""Runs whose matrices are kept one by one; beyond that neighbouring runs are pooled."""
TOGETHER = 16
"""Blocks whose products are made in one call: a matrix each, of some 0.5 MB with the whole catalogue."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of the columns [parameters | effects | residual], the zeros of each run eliminated.

    `likelihood`, `output`: (units, c, c); the latter means nothing where it was not asked for.
    `count`: (units,) samples. `runs`: the runs of each unit.
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
    offsets: np.ndarray | None = None
    """(units, zeros, c): products with the run's own zeros, in units in which these are orthonormal.

    Over a whole run they add up to 0. None where every unit is a whole run."""

    def units(self, runs: Sequence[int]) -> np.ndarray:
        """Return the index of the units whose runs are all among `runs`."""
        known = set(runs)
        return np.array([k for k, unit in enumerate(self.runs) if known.issuperset(unit)], dtype=int)


MANY = 6
"""Channels above which products are made candidate by candidate, not for each pair of channels."""
ENTRIES, FEWEST = 2_000_000, 256
"""Derivatives of the readings that are held at once, 16 MB, and samples that are taken together at least: a
refit of many channels with a number each would hold all channels times itself."""


class Unit(NamedTuple):
    """Runs, products for the likelihood and in the output, samples, and products with the zeros."""

    runs: tuple[int, ...]
    white: np.ndarray
    out: np.ndarray
    samples: float
    offsets: np.ndarray | None = None

    def plus(self, other: "Unit") -> "Unit":
        """Return both together."""
        runs = tuple(dict.fromkeys((*self.runs, *other.runs)))
        return Unit(runs, self.white + other.white, self.out + other.out, self.samples + other.samples)


def normal_equations(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None,
    length: int | None = None,
    *,
    decoded: bool = True,
) -> NormalEquations:
    """Read the log once and return the tangents of `candidates`: key -> (extended model, new parameters).

    New parameters are taken at their nominal value, where they have no effect. `length`: samples of a unit,
    where a run is to be several. `decoded`: with `output`, which a fit on its way has no need of.
    """
    return of_parts(base, [candidates or {}], length, decoded=decoded)[0]


def of_parts(
    base: Base,
    parts: Sequence[Mapping[str, tuple[Model, Sequence[str]]]],
    length: int | None = None,
    *,
    decoded: bool = True,
) -> list[NormalEquations]:
    """Return the same for each of some parts of the candidates; the model is evaluated once for all."""
    works = [Accumulator(base, part, length, decoded=decoded) for part in parts]
    first = works[0]
    first.models = tuple(dict.fromkeys(model for work in works for model in work.models))
    first.most = min(work.most for work in works)
    for batch, weights in first.weighed():
        near = first.near_of(batch, weights)
        for work in works:
            work.add(near, weights)
    return [work.result() for work in works]


def coefficients(M: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the coefficients of `columns` that explain the last column in least squares, from products."""
    return pseudo_inverse(M[np.ix_(columns, columns)]) @ M[columns, -1]


def eliminated(M: np.ndarray, follow: np.ndarray) -> np.ndarray:
    """Return products (..., c - z, c - z) once the first z columns follow the others as `follow` says."""
    z = len(follow)
    half = (M[..., z:, :z] + 0.5 * follow.T @ M[..., :z, :z]) @ follow
    return M[..., z:, z:] + half + half.swapaxes(-1, -2)


@dataclass
class Stretch:
    """Products (c, c) of consecutive samples of a run: `size` readings from `start_s` [s of the log] on."""

    run: int
    start_s: float
    products: np.ndarray
    size: float


class Group(NamedTuple):
    """Some blocks of a batch, `first` to `last` (exclusive): what lays samples out by block, what it makes of
    the columns of the model and of their metric, and products of these where channels are many."""

    first: int
    last: int
    lay: Callable[[np.ndarray], np.ndarray]
    own: np.ndarray
    metric: np.ndarray
    many: Shared | None


@dataclass(frozen=True, eq=False)
class Near:
    """What all candidates share of a batch, by groups of blocks: columns of the model, and the residual."""

    batch: Batch
    groups: list[Group]


class Accumulator:
    """Accumulates the products of each run."""

    def __init__(
        self,
        base: Base,
        candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None,
        length: int | None = None,
        *,
        decoded: bool = True,
    ) -> None:
        self.base, self.length, self.decoded = base, length, decoded
        model = base.model
        self.read = reading_and_derivatives(model)
        self.z, self.n = len(base.model.zeros), len(base.free)
        self.slopes = Slopes(base.model, base.p, candidates or {})
        self.models = (base.model, *(model for model, _ in (candidates or {}).values()))
        own = self.z + self.n
        self.size = own + self.slopes.columns + 1
        self.span = {"": slice(0, self.n)}
        self.span |= {k: slice(self.n + s.start, self.n + s.stop) for k, s in self.slopes.span.items()}
        self.near = np.array([*range(own), self.size - 1])
        rows = max(len(self.near) * len(model.channels), sum(map(len, self.slopes.column)))
        self.most = max(FEWEST, ENTRIES // rows)
        self.precision = np.linalg.inv(base.covariance)
        self.whiten = np.linalg.cholesky(self.precision).T
        self.run: int | None = None
        self.seen = 0
        self.open: list[Unit] = []
        self.done: list[Unit] = []
        self.order: list[int] = []
        self.follow: list[np.ndarray] = []

    def batches(self, *further: str) -> Iterator[Batch]:
        """Yield the log with the columns that the model and its candidates read, and `further` ones."""
        base, wide = self.base, self.base.model
        for model in self.models:
            wide = wide.with_columns(*model.computed)
        columns = dict.fromkeys((*(c for m in self.models for c in columns_of(m)), *further))
        yield from batches(extended(base.log, wide, base.sigma, base.values), tuple(columns))

    def weighed(self, *further: str) -> Iterator[tuple[Batch, np.ndarray | None]]:
        """Yield the same in batches of at most `most` samples, with the weights of their samples."""
        for batch in self.batches(*further):
            weights = batch.weights(self.base.keep)
            for piece, at in batch.pieces(self.most):
                yield piece, None if weights is None else weights[at]

    def near_of(self, batch: Batch, weights: np.ndarray | None) -> Near:
        """Return what all candidates share of a batch that goes on where the last one ended."""
        if self.length:
            batch = batch.cut(self.length, self.seen if batch.blocks[0].run == self.run else 0)
        A, K = self._near(batch, weights), len(self.base.model.channels)
        D = self._to_pose(batch)
        metric = np.einsum("iks,ils->kls", D, D) if K <= MANY and self.decoded else D
        groups = []
        for first, last in batch.groups(max(1, TOGETHER * MANY // max(K, MANY))):
            lay = batch.layout(first, last)
            own, by = lay(A), lay(metric)
            many = Shared(own, by, self.whiten, self.precision) if K > MANY else None
            groups.append(Group(first, last, lay, own, by, many))
        return Near(batch, groups)

    def add(self, near: Near, weights: np.ndarray | None) -> None:
        """Add a batch to the runs that it belongs to."""
        batch = near.batch
        rows = self.slopes.rows(batch, self.base.zeros_of(batch), weights)
        for first, last, lay, own, metric, many in near.groups:
            others = [lay(r) for r in rows]
            if many:
                white, out = by_candidate(self, many, others)
            else:
                white = self._products(own, others, self.precision[:, :, None, None])
                out = self._products(own, others, metric) if self.decoded else white
            for k, block in enumerate(batch.blocks[first:last]):
                part = slice(batch.edges[first + k], batch.edges[first + k + 1])
                count = float(part.stop - part.start if weights is None else weights[part].sum())
                self._gather(Unit((block.run,), white[k], out[k], count), part.stop - part.start)

    def _products(self, near: np.ndarray, rows: list[np.ndarray], metric: np.ndarray) -> np.ndarray:
        """Products (blocks, c, c) of all columns with zeros, parameters and residual, and of each candidate
        with itself, under `metric` (K, K, blocks or 1, samples or 1).

        `near`: (own, K, blocks, samples); `rows`: (rows, blocks, samples) of each channel. Products between
        two candidates are nobody's business and stay 0.
        """
        own, K = len(near), near.shape[1]
        M = np.zeros((near.shape[2], self.size, self.size))
        mapped = np.zeros_like(near)
        for k in range(K):
            for j in range(K):
                if np.any(metric[k, j]):
                    mapped[:, k] += metric[k, j] * near[:, j]
        inner = np.zeros((near.shape[2], own, own))
        for k in range(K):
            inner += _dot(near[:, k], mapped[:, k])
        M[:, self.near[:, None], self.near] = inner
        first = self.z + self.n
        for k, block in enumerate(rows):
            if len(block):
                across = _dot(block, mapped[:, k])
                M[:, (first + self.slopes.column[k])[:, None], self.near] += across
        M[:, self.near[:-1], first:-1] = M[:, first:-1, self.near[:-1]].swapaxes(1, 2)
        M[:, -1, first:-1] = M[:, first:-1, -1]
        for k in range(K):
            for j in range(k, K):
                if len(rows[k]) and len(rows[j]) and np.any(metric[k, j]):
                    self._own(M, rows[k] * metric[k, j], rows[j], k, j)
        return M

    def _own(self, M: np.ndarray, left: np.ndarray, right: np.ndarray, k: int, j: int) -> None:
        """Add the products of each candidate's rows in channel k with its own in channel j."""
        first = self.z + self.n
        for a, b in zip(self.slopes.parts[k], self.slopes.parts[j], strict=True):
            if a.start == a.stop or b.start == b.stop:
                continue
            P = _dot(left[a], right[b])
            at, to = first + self.slopes.column[k][a], first + self.slopes.column[j][b]
            M[:, at[:, None], to] += P
            if k != j:
                M[:, to[:, None], at] += P.swapaxes(1, 2)

    def _to_pose(self, batch: Batch) -> np.ndarray:
        """What turns readings into the decoded pose, rotation as length: (pose, K, samples), 0 for none."""
        base, model = self.base, self.base.model
        if not self.decoded:
            return np.zeros((0, len(model.channels), len(batch)))
        pose, state = batch.columns(model.references), batch.columns(model.state)
        (spread,) = decoding_gain(model)(base.p, pose, state, base.weight)
        spread = spread.reshape(len(model.channels), len(model.pose), len(batch))
        return spread.swapaxes(0, 1) * base.pose_weights[:, None, None]

    def _near(self, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
        """Columns of zeros, parameters and residual, (own + 1, K, samples)."""
        base, model = self.base, self.base.model
        samples, K, own = len(batch), len(model.channels), self.z + self.n
        pose, state = batch.columns(model.references), batch.columns(model.state)
        A = np.empty((own + 1, K, samples))
        reading, *slopes = self.read(base.p, self.base.zeros_of(batch), pose, state)
        A[self.z : own] = slopes[0].reshape(-1, K, samples)[list(base.free)]
        if self.z:
            A[: self.z] = slopes[1].reshape(-1, K, samples)
        A[-1] = np.array(batch.columns(model.channels)) - reading
        if weights is not None:
            A *= np.sqrt(weights)
        return A

    def whitened(self, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
        """Return all columns [zeros | parameters | candidates | residual], whitened, (c, K, samples)."""
        return self.whitener(batch, weights)(slice(None))

    def whitener(self, batch: Batch, weights: np.ndarray | None) -> Callable[[slice], np.ndarray]:
        """Return what gives all columns, whitened, of some samples: of all at once they may be 1 GB."""
        near = self._near(batch, weights)
        rows = self.slopes.rows(batch, self.base.zeros_of(batch), weights)

        def white(part: slice) -> np.ndarray:
            A = np.zeros((self.size, *near[:, :, part].shape[1:]))
            A[self.near] = near[:, :, part]
            for k, own in enumerate(rows):
                A[self.z + self.n + self.slopes.column[k], k] = own[:, part]
            return self.whiten @ A

        return white

    def stretches(self, length: int) -> Iterator[list[Stretch]]:
        """Yield the stretches of `length` samples of each run; zeros are the first columns."""
        run: list[Stretch] = []
        seen, origin = 0, None
        for batch, weights in self.weighed("t_s"):
            white = self.whitener(batch, weights)
            t = batch.data["t_s"]
            origin = float(t[0]) if origin is None else origin
            for block, part in batch.parts():
                if run and run[0].run != block.run:
                    yield run
                    run, seen = [], 0
                edges = range(part.start - seen % length, part.stop, length)
                for low, high in ((max(e, part.start), min(e + length, part.stop)) for e in edges):
                    here = white(slice(low, high)).reshape(self.size, -1)
                    products = here @ here.T
                    if (seen + low - part.start) % length:  # goes on from the block before
                        run[-1].products += products
                        run[-1].size += here.shape[1]
                    else:
                        run.append(Stretch(block.run, float(t[low]) - origin, products, here.shape[1]))
                seen += part.stop - part.start
        if run:
            yield run

    def _gather(self, part: Unit, samples: int) -> None:
        if part.runs[0] != self.run:
            self._close()
            self.run, self.seen = part.runs[0], 0
            self.order.append(self.run)
        if self.open and (self.length is None or self.seen % self.length):
            self.open[-1] = self.open[-1].plus(part)
        else:
            self.open.append(part)
        self.seen += samples

    def _close(self) -> None:
        """Eliminate the zeros of a run: they follow the likelihood, also where the output is measured."""
        if not self.open:
            return
        z, total = self.z, np.sum([u.white for u in self.open], axis=0)
        own, follow = eliminate(total, z)
        # candidates are scored, not stepped to: with them nobody asks, and a log may have many runs
        self.follow.append(follow[:, :0] if self.slopes.columns else follow)
        if len(self.open) == 1:
            (unit,) = self.open
            self.done.append(unit._replace(white=own, out=eliminated(unit.out, follow)))
        else:
            root = np.linalg.cholesky(pseudo_inverse(total[:z, :z])).T if z else np.zeros((0, 0))
            self.done += [
                u._replace(
                    white=eliminated(u.white, follow),
                    out=eliminated(u.out, follow),
                    offsets=root @ (u.white[:z, z:] + u.white[:z, :z] @ follow),
                )
                for u in self.open
            ]
        self.open = []
        if len(self.done) > 2 * UNITS and not self.length:
            self._pool()

    def _pool(self) -> None:
        """Pool neighbouring units of the same side."""
        sides: dict[bool, list[Unit]] = {True: [], False: []}
        for unit in self.done:
            sides[unit.runs[0] in self.base.holdout].append(unit)
        self.done = [
            units[k].plus(units[k + 1]) if k + 1 < len(units) else units[k]
            for units in sides.values()
            for k in range(0, len(units), 2)
        ]

    def result(self) -> NormalEquations:
        """Return what has been gathered."""
        self._close()
        done, self.done = self.done, []  # their memory goes as the arrays are made
        parts = any(u.offsets is not None for u in done)
        none = np.zeros((self.z, self.size - self.z))
        return NormalEquations(
            np.array([u.white for u in done]),
            np.array([u.out for u in done]),
            np.array([u.samples for u in done]),
            tuple(u.runs for u in done),
            self.span,
            np.array(self.follow),
            tuple(self.order),
            frozenset(self.slopes.spoiled),
            np.array([none if u.offsets is None else u.offsets for u in done]) if parts else None,
        )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of rows (m, blocks, samples) with rows (n, blocks, samples), (blocks, m, n)."""
    return a.transpose(1, 0, 2) @ b.transpose(1, 2, 0)
