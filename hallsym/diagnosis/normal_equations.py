"""Normal equations of a model and of candidate effects, run by run.

One pass over the log stacks, sample by sample, the columns [zeros | parameters | effects | residual]: the
derivatives of the reading with respect to each, and the residual of the model. Of each run only the products
of these columns are kept, twice: weighted by the noise of the readings (what a fit minimises) and mapped to
the decoded pose (what the gap metric measures). The zeros of a run are eliminated at once. With these
matrices any set of effects can be fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residuals import Base
from hallsym.estimation import pseudo_inverse, solve
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.log.batches import Batch, batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.arrays import FEWEST, on_arrays


class Products(NamedTuple):
    """Products of columns: `border` (..., rows, c) of the model's own ones and the residual with all columns,
    `inner` (..., e) of each candidate's with each other, matrix by matrix.

    Products between two candidates are nobody's business. The residual is the last row and column.
    """

    border: np.ndarray
    inner: np.ndarray

    def plus(self, other: "Products") -> "Products":
        """Return the sum."""
        return Products(self.border + other.border, self.inner + other.inner)

    def block(self, k: int) -> "Products":
        """Return the products of block k."""
        return Products(self.border[k], self.inner[k])

    def of(self, span: slice, place: slice) -> np.ndarray:
        """Return the products (..., p, p) of own columns, those of one candidate, and the residual.

        `span`: its columns, `place`: its products; both may be empty.
        """
        n, k = self.border.shape[-2] - 1, span.stop - span.start
        out = np.empty((*self.border.shape[:-2], n + k + 1, n + k + 1))
        own, here = np.array([*range(n), n + k]), slice(n, n + k)
        out[..., own[:, None], own] = self.border[..., [*range(n), -1]]
        out[..., own, here] = self.border[..., span]
        out[..., here, own] = self.border[..., span].swapaxes(-1, -2)
        out[..., here, here] = self.inner[..., place].reshape(*self.inner.shape[:-1], k, k)
        return out


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of the columns [parameters | effects | residual], the zeros of each run eliminated.

    `whitened`, `decoded`: of each unit, weighted by the noise and mapped to the pose. `count`: (units,)
    samples. `runs`: the runs of each unit. `span`: columns of each candidate, by its key; the base's
    parameters are under "". `places`: of its products in `Products.inner`.
    """

    whitened: Products
    decoded: Products
    count: np.ndarray
    runs: tuple[tuple[int, ...], ...]
    span: dict[str, slice]
    places: dict[str, slice]
    follow: np.ndarray
    """(runs, zeros, c): how the zeros of a run follow the other columns; none with candidates."""
    order: tuple[int, ...]
    """The runs of `follow`."""
    spoiled: frozenset[str] = frozenset()
    """Candidates whose slope is not finite somewhere; their columns are 0."""
    offsets: np.ndarray | None = None
    """(units, zeros, c): products with the run's own zeros, in units in which these are orthonormal.

    Over a whole run they add up to 0. None where every unit is a whole run."""

    @property
    def likelihood(self) -> np.ndarray:
        """Products (units, p, p) of the model's own columns and the residual, weighted by the noise."""
        return self.of(None) if self.places else self.whitened.border

    @property
    def output(self) -> np.ndarray:
        """The same mapped to the pose."""
        return self.of(None, decoded=True) if self.places else self.decoded.border

    def of(self, key: str | None, *, decoded: bool = False) -> np.ndarray:
        """Return products (units, p, p) of the model's columns, those of a candidate, and the residual."""
        none = slice(0, 0)
        span, place = (self.span[key], self.places[key]) if key else (none, none)
        return (self.decoded if decoded else self.whitened).of(span, place)

    def units(self, runs: Iterable[int]) -> np.ndarray:
        """Return the index of the units whose runs are all among `runs`."""
        known = set(runs)
        return np.array([k for k, unit in enumerate(self.runs) if known.issuperset(unit)], dtype=int)


def reading_and_derivatives(model: Model) -> Callable[..., list[np.ndarray]]:
    """Return `(p, zeros, pose, state) -> reading, its derivatives by parameters and by zeros`, on arrays."""

    def made() -> Callable[..., list[np.ndarray]]:
        s = model.symbols
        reading = s.full(s.reading)
        parts = [reading, ca.jacobian(reading, s.parameters), ca.jacobian(reading, s.zeros)]
        inputs = [s.parameters, s.zeros, s.pose, s.state]
        return on_arrays(ca.Function("base", inputs, [ca.densify(part) for part in parts]))

    return model.remember("reading, derivatives", made)


class Slope(NamedTuple):
    """d reading / d parameters where it is not nil: `rows`, each with its channel and column (parameter)."""

    rows: ca.SX
    channel: np.ndarray
    column: np.ndarray


def slopes_of(models: Sequence[tuple[Model, Sequence[str]]]) -> list[Slope]:
    """Return d reading / d some parameters of each model, at their nominal values.

    What models share of their expressions, their slopes share too.
    """
    slopes: list[ca.SX] = []
    at: dict[int, tuple[ca.SX, ca.SX]] = {}
    for model, names in models:
        s, index = model.symbols, [model.names.index(name) for name in names]
        slopes.append(ca.jacobian(s.reading, s.parameters[index]))  # what is derived depends on no parameter
        symbols = (*ca.vertsplit(s.parameters[index]), *ca.vertsplit(s.derived))
        values = (*map(ca.SX, model.nominal[index].tolist()), *ca.vertsplit(s.derived_as))
        at |= {symbol.element_hash(): (symbol, value) for symbol, value in zip(symbols, values, strict=True)}
    known = [ca.vertcat(*each) for each in zip(*at.values(), strict=True)] or [ca.SX(0, 1)] * 2
    out = []
    for slope in map(ca.sparsify, ca.substitute(slopes, known[:1], known[1:])):
        channel, column = (np.array(k, dtype=int) for k in slope.sparsity().get_triplet())
        out.append(Slope(ca.vec(slope.nz[:]), channel, column))
    return out


class Slopes:
    """The rows of all candidates, channel by channel.

    `span`: columns of each candidate, `columns` of them in all. For each channel k `column[k]` is the column
    of each row and `parts[k]` the rows of each candidate. `spoiled`: candidates that were not finite
    somewhere; their rows are 0 there.
    """

    def __init__(
        self, model: Model, p: np.ndarray, candidates: Mapping[str, tuple[Model, Sequence[str]]]
    ) -> None:
        self.model, self.p, self.keys = model, p, list(candidates)
        ends = np.cumsum([0, *(len(new) for _, new in candidates.values())]).tolist()
        self.span = {key: slice(*ends[j : j + 2]) for j, key in enumerate(candidates)}
        self.columns = ends[-1]
        self.spoiled: set[str] = set()
        wide = [(wide, *new) for wide, new in candidates.values()]
        self.run, self.state, channel, column = model.remember(
            ("slopes", *wide), lambda: _rows_of(model, list(candidates.values()))
        )
        self.owner = np.searchsorted(ends, column, side="right") - 1
        self.edges = np.searchsorted(channel, np.arange(len(model.channels) + 1)).tolist()
        self.column = [column[a:b] for a, b in pairwise(self.edges)]
        self.parts = [
            [slice(*np.searchsorted(self.owner[a:b], (j, j + 1)).tolist()) for j in range(len(self.keys))]
            for a, b in pairwise(self.edges)
        ]

    def rows(self, batch: Batch, zeros: np.ndarray, weights: np.ndarray | None) -> list[np.ndarray]:
        """Return the rows of each channel, (rows, samples), times the root of the weights."""
        pose, state = batch.columns(self.model.references), batch.columns(self.state)
        (values,) = self.run(self.p, zeros, pose, state)
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            spoiled = np.unique(self.owner[bad])
            self.spoiled |= {self.keys[j] for j in spoiled}
            values[np.isin(self.owner, spoiled)] = 0.0
        if weights is not None:
            values *= np.sqrt(weights)
        return [values[a:b] for a, b in pairwise(self.edges)]


def _rows_of(
    model: Model, candidates: Sequence[tuple[Model, Sequence[str]]]
) -> tuple[Callable[..., list[np.ndarray]], tuple[str, ...], np.ndarray, np.ndarray]:
    """Return `run(p, zeros, pose, state)` of all rows, the columns `state`, channel and column of each."""
    each = slopes_of(candidates)
    starts = np.cumsum([0, *(len(new) for _, new in candidates)])
    channel = np.concatenate([np.zeros(0, dtype=int), *(s.channel for s in each)])
    column = np.concatenate(
        [np.zeros(0, dtype=int), *(s.column + start for s, start in zip(each, starts[:-1], strict=True))]
    )
    order = np.lexsort((column, channel))
    rows = ca.vertcat(*(s.rows for s in each))[order.tolist()] if len(order) else ca.SX(0, 1)
    s = model.symbols
    state = {
        symbol.element_hash(): (name, symbol)
        for wide, _ in candidates
        for name, symbol in zip(wide.state, ca.vertsplit(wide.symbols.state), strict=True)
    }
    inputs = [s.parameters, s.zeros, s.pose, ca.vertcat(*(symbol for _, symbol in state.values()))]
    run = on_arrays(ca.Function("slopes", inputs, [ca.densify(rows)]))
    return run, tuple(name for name, _ in state.values()), channel[order], column[order]


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


def within_bounds(M: np.ndarray, lower: np.ndarray, upper: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the coefficients (n,) of `columns` that explain the last column inside their bounds.

    What would leave its bounds by most stops there, and the others are solved again beside it.
    """
    out, moving = np.zeros(len(lower)), columns
    while len(moving):
        left = M.copy()
        stopped = np.setdiff1d(np.arange(len(out)), moving)
        left[:, -1] -= M[:, stopped] @ out[stopped]
        out[moving] = coefficients(left, moving)
        beyond = np.maximum(lower - out, out - upper)[moving] / np.maximum(upper - lower, 1e-300)[moving]
        out = np.clip(out, lower, upper)
        if beyond.max() <= 0:
            break
        moving = np.delete(moving, np.argmax(beyond))
    return out


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

    def batches(self, log: Log) -> Iterator[Batch]:
        """Yield a log in batches with all columns that the models read."""
        base, wide = self.base, self.base.model
        for model in self.models:
            wide = wide.with_columns(*model.computed)
        columns = tuple(dict.fromkeys(c for m in self.models for c in columns_of(m)))
        return batches(extended(log, wide, base.sigma, base.values), columns)

    def columns(self, batch: Batch, weights: np.ndarray | None) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the columns of zeros, parameters and residual, and the rows of the candidates."""
        return self._near(batch, weights), self.slopes.rows(batch, self.base.zeros_of(batch), weights)

    def weighed(self) -> Iterator[tuple[Batch, np.ndarray | None]]:
        """Yield the log in batches of at most `most` samples, with the weights of their samples."""
        for batch in self.batches(self.base.log):
            weights = batch.weights(self.base.keep)
            for piece, at in batch.pieces(self.most):
                yield piece, None if weights is None else weights[at]

    def add(self, batch: Batch, weights: np.ndarray | None) -> None:
        """Add a batch to the runs that it belongs to."""
        if self.length:
            batch = batch.cut(self.length, self.seen if batch.blocks[0].run == self.run else 0)
        (near, rows), D = self.columns(batch, weights), self._to_pose(batch)
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
        spread = base.to_pose(batch.columns(model.references), batch.columns(model.state))
        return spread * base.pose_weights[:, None, None]

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


# -- products of a batch -------------------------------------------------------------------------------------


def stacked_products(
    work: Accumulator, near: np.ndarray, rows: list[np.ndarray], D: np.ndarray
) -> tuple[Products, Products]:
    """Return products under the precision of `work`, and mapped to the pose by D; where D is empty no others.

    `work`: the `Accumulator`. `near`: (own, K, blocks, samples) of zeros, parameters and residual, `rows`:
    (rows, blocks, samples) of each channel, `D`: (n_pose, K, blocks, samples).
    """
    first, blocks, precision = work.z + work.n, near.shape[2], work.precision
    white, decoded = np.tensordot(work.whiten, near, axes=(1, 1)).swapaxes(0, 1), _decoded(D, near)
    out = work.nil(blocks), work.nil(blocks)
    for M, columns in zip(out, (white, decoded), strict=True):
        M.border[:, :, work.near] = _gram(columns)
    if not any(map(len, rows)):
        return out
    metric = np.tensordot(precision, near, axes=(1, 1)).swapaxes(0, 1)
    mapped = np.einsum("ikbs,oibs->okbs", D, decoded)
    for M, columns in zip(out, (metric, mapped), strict=True):
        for k, block in enumerate(rows):
            if len(block):
                across = columns[:, k].transpose(1, 0, 2) @ block.transpose(1, 2, 0)
                M.border[:, :, first + work.slopes.column[k]] += across
    for c, key in enumerate(work.slopes.span):
        _add_own(work, rows, c, precision, D, *(work.own_of(M, key) for M in out))
    return out


def _decoded(D: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return (own, n_pose, blocks, samples): what the columns `near` are as an error of the pose."""
    out = np.empty((len(near), len(D), *near.shape[2:]))
    for k, column in enumerate(near):
        np.einsum("ikbs,kbs->ibs", D, column, out=out[k])
    return out


def _gram(columns: np.ndarray) -> np.ndarray:
    """Return the products (blocks, own, own) of columns (own, rows, blocks, samples) with each other."""
    flat = columns.transpose(2, 0, 1, 3).reshape(columns.shape[2], len(columns), -1)
    return np.array([own @ own.T for own in flat])


def _add_own(
    work: Accumulator,
    rows: list[np.ndarray],
    c: int,
    precision: np.ndarray,
    D: np.ndarray,
    white: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the products of the rows of candidate c with each other, (blocks, k, k) twice."""
    parts = [work.slopes.parts[k][c] for k in range(len(rows))]
    channel = np.repeat(np.arange(len(rows)), [part.stop - part.start for part in parts])
    if not len(channel):
        return
    stack = np.concatenate([block[part] for block, part in zip(rows, parts, strict=True)]).swapaxes(0, 1)
    column = np.concatenate([work.slopes.column[k][part] for k, part in enumerate(parts)])
    known, place = np.unique(column, return_inverse=True)
    at = known - list(work.slopes.span.values())[c].start
    one = (place == np.arange(len(known))[:, None]).astype(float)  # (columns, rows)
    gram = (stack @ stack.swapaxes(1, 2)) * precision[channel[:, None], channel]
    white[:, at[:, None], at] += one @ gram @ one.T
    for spread in D[:, channel].swapaxes(1, 2):
        moved = one @ (spread * stack)
        out[:, at[:, None], at] += moved @ moved.swapaxes(1, 2)
