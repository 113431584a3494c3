"""Normal equations of a model and of candidate effects, run by run.

One pass over the log stacks, sample by sample, the columns [zeros | parameters | effects | residual]: the
derivatives of the reading with respect to each, and the residual of the model. Of each run only the products
of these columns are kept, twice: weighted by the noise of the readings (what a fit minimises) and mapped to
the decoded pose (what the gap metric measures). The zeros of a run are eliminated at once. With these
matrices any set of effects can be fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hallsym.diagnosis.derivatives import Slopes, reading_and_derivatives
from hallsym.diagnosis.products import NormalEquations, Products
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.stacked_products import stacked_products
from hallsym.estimation import pseudo_inverse, solve
from hallsym.estimation.decoding import columns_of, decoding_gain
from hallsym.log.batches import Batch, batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.arrays import FEWEST

UNITS = 64
"""Runs whose matrices are kept one by one; beyond that neighbouring runs are pooled."""
ENTRIES = 500_000
"""Derivatives of the readings, and products of them, that are held at once: 4 MB each."""


class Unit(NamedTuple):
    """Runs, products for the likelihood and in the output, samples, and products with the zeros."""

    runs: tuple[int, ...]
    white: Products
    out: Products
    samples: float
    offsets: np.ndarray | None = None

    def plus(self, other: "Unit") -> "Unit":
        """Return both together."""
        runs = tuple(dict.fromkeys((*self.runs, *other.runs)))
        white, out = self.white.plus(other.white), self.out.plus(other.out)
        return Unit(runs, white, out, self.samples + other.samples)


def normal_equations(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None,
    length: int | None = None,
    *,
    decoded: bool = True,
) -> NormalEquations:
    """Read the log once and return the tangents of `candidates`: key -> (extended model, new parameters).

    New parameters are taken at their nominal value, where they have no effect. `length`: samples of a unit,
    where a run is to be several. `decoded`: with the products mapped to the pose; a step of a fit has no
    need of them, and without them they mean nothing.
    """
    work = Accumulator(base, candidates, length, decoded=decoded)
    for batch, weights in work.weighed():
        work.add(batch, weights)
    return work.result()


def coefficients(M: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the coefficients of `columns` that explain the last column in least squares, from products."""
    return pseudo_inverse(M[np.ix_(columns, columns)]) @ M[columns, -1]


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
        widths = {k: s.stop - s.start for k, s in self.slopes.span.items()}
        ends = np.cumsum([0, *(k * k for k in widths.values())]).tolist()
        self.places = {key: slice(*ends[j : j + 2]) for j, key in enumerate(widths)}
        pairs = [np.indices((k, k)).reshape(2, -1) + self.span[c].start for c, k in widths.items()]
        self.pairs = np.concatenate([np.zeros((2, 0), dtype=int), *pairs], axis=1)
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

    def add(self, batch: Batch, weights: np.ndarray | None) -> None:
        """Add a batch to the runs that it belongs to."""
        if self.length:
            batch = batch.cut(self.length, self.seen if batch.blocks[0].run == self.run else 0)
        near, D = self._near(batch, weights), self._to_pose(batch)
        rows = self.slopes.rows(batch, self.base.zeros_of(batch), weights)
        for first, last in batch.groups(max(1, ENTRIES // (len(self.near) * self.size))):
            lay = batch.layout(first, last)
            white, out = stacked_products(self, lay(near), [lay(r) for r in rows], lay(D))
            for k, block in enumerate(batch.blocks[first:last]):
                part = slice(batch.edges[first + k], batch.edges[first + k + 1])
                count = float(part.stop - part.start if weights is None else weights[part].sum())
                unit = Unit((block.run,), white.block(k), out.block(k), count)
                self._gather(unit, part.stop - part.start)

    def nil(self, blocks: int) -> Products:
        """Return products of so many blocks, still nil."""
        return Products(
            np.zeros((blocks, len(self.near), self.size)), np.zeros((blocks, self.pairs.shape[1]))
        )

    def own_of(self, made: Products, key: str) -> np.ndarray:
        """Return a view (blocks, k, k) of the products of a candidate's columns with each other."""
        k = self.slopes.span[key].stop - self.slopes.span[key].start
        return made.inner[:, self.places[key]].reshape(-1, k, k)

    def _to_pose(self, batch: Batch) -> np.ndarray:
        """What turns readings into the decoded pose, rotation as length: (pose, K, samples), or no row."""
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
        z = self.z
        across = np.sum([u.white.border[:z] for u in self.open], axis=0)
        follow = -solve(across[:, :z], across[:, z:]) if z else np.zeros((0, self.size))
        # candidates are scored, not stepped to: with them nobody asks, and a log may have many runs
        self.follow.append(follow[:, :0] if self.slopes.columns else follow)
        whole = len(self.open) == 1
        root = np.linalg.cholesky(pseudo_inverse(across[:, :z])).T if z and not whole else np.zeros((z, z))
        left = [tuple(self._eliminated(p, follow) for p in (u.white, u.out)) for u in self.open]
        nil = self._clear([u.white for u in self.open], left)
        for u, (white, out) in zip(self.open, left, strict=True):
            rest = u.white.border[:z, z:] + u.white.border[:z, :z] @ follow
            rest[:, nil] = 0.0
            self.done.append(u._replace(white=white, out=out, offsets=None if whole else root @ rest))
        self.open = []
        if len(self.done) > 2 * UNITS and not self.length:
            self._pool()

    def _eliminated(self, p: Products, follow: np.ndarray) -> Products:
        """Return products once the zeros follow the other columns as `follow` (zeros, c) says."""
        z, rows = self.z, self.near[self.z :] - self.z
        half = p.border[:z, z:] + 0.5 * p.border[:z, :z] @ follow
        border = p.border[z:, z:] + half[:, rows].T @ follow + follow[:, rows].T @ half
        i, j = self.pairs
        inner = (half[:, i] * follow[:, j] + follow[:, i] * half[:, j]).sum(axis=0)
        return Products(border, p.inner + inner)

    def _clear(self, before: Sequence[Products], left: Sequence[tuple[Products, ...]]) -> np.ndarray:
        """Set to 0 the columns of which the zeros of a run leave rounding: a step between runs is one.

        `before`, `left`: of each part of the run. Returns the columns.
        """
        i, j = self.pairs
        own = i == j
        rest, whole = (np.sum([p.inner[own] for p in of], axis=0) for of in ([p for p, _ in left], before))
        nil = i[own][rest <= NIL * whole]
        for p in (p for both in left for p in both if len(nil)):
            p.border[:, nil] = 0.0
            p.inner[np.isin(i, nil) | np.isin(j, nil)] = 0.0
        return np.asarray(nil)

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
        parts = any(u.offsets is not None for u in self.done)
        none = np.zeros((self.z, self.size - self.z))
        return NormalEquations(
            _stacked([u.white for u in self.done]),
            _stacked([u.out for u in self.done]),
            np.array([u.samples for u in self.done]),
            tuple(u.runs for u in self.done),
            self.span,
            self.places,
            np.array(self.follow),
            tuple(self.order),
            frozenset(self.slopes.spoiled),
            np.array([none if u.offsets is None else u.offsets for u in self.done]) if parts else None,
        )


def _stacked(made: Sequence[Products]) -> Products:
    return Products(np.array([p.border for p in made]), np.array([p.inner for p in made]))
