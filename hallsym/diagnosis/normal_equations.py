"""Normal equations of a model and of candidate effects, run by run.

One pass over the log stacks, sample by sample, the columns [offsets | parameters | effects | residual]: the
derivatives of the reading with respect to each, and the residual of the model. Of each run only the products
of these columns are kept, twice: weighted by the noise of the readings (what a fit minimises) and mapped to
the decoded pose (what the gap metric measures). The offsets of a run are eliminated at once. With these
matrices any set of effects can be fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hallsym.diagnosis.residuals import NIL, Base
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.factors import pseudo_inverse, solve
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


def reading_and_slopes(
    model: Model, free: Sequence[int]
) -> tuple[Callable[..., list[np.ndarray]], np.ndarray, np.ndarray]:
    """Return `run(p, zeros, pose, state) -> reading, slopes (rows, samples)`, channel and column of each row.

    Columns are the offsets, then the parameters `free`; slopes that are nil everywhere have no row.
    """

    def made() -> tuple[Callable[..., list[np.ndarray]], np.ndarray, np.ndarray]:
        s = model.symbols
        reading = s.full(s.reading)
        slope = ca.jacobian(reading, ca.vertcat(s.zeros, s.parameters[list(free)]))
        channel, column = (np.array(k, dtype=int) for k in slope.sparsity().get_triplet())
        inputs = [s.parameters, s.zeros, s.pose, s.state]
        rows = ca.vec(slope.nz[:]) if len(channel) else ca.SX(0, 1)
        run = on_arrays(ca.Function("base", inputs, [ca.densify(reading), ca.densify(rows)]))
        return run, channel, column

    found: tuple[Callable[..., list[np.ndarray]], np.ndarray, np.ndarray]
    found = model.remember(("reading, slopes", *free), made)
    return found


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
    """The rows of all candidates, channel by channel, from one graph: what they share is computed once.

    `span`: columns of each candidate, `columns` of them in all. `channel`, `column`: (rows,) of each row,
    rows of one channel together at `of_channel`. `own`: of each candidate, see `OwnRows`. `spoiled`:
    candidates that were not finite somewhere; their rows are 0 there.
    """

    def __init__(
        self, model: Model, p: np.ndarray, candidates: Mapping[str, tuple[Model, Sequence[str]]]
    ) -> None:
        self.model, self.p, self.keys = model, p, list(candidates)
        ends = np.cumsum([0, *(len(new) for _, new in candidates.values())]).tolist()
        self.span = {key: slice(*pair) for key, pair in zip(candidates, pairwise(ends), strict=True)}
        self.columns = ends[-1]
        self.spoiled: set[str] = set()
        wide = [(wide, *new) for wide, new in candidates.values()]
        self.run, self.state, self.channel, self.column = model.remember(
            ("slopes", *wide), lambda: _rows_of(model, list(candidates.values()))
        )
        self.owner = np.searchsorted(ends, self.column, side="right") - 1
        limits = np.searchsorted(self.channel, range(len(model.channels) + 1)).tolist()
        self.of_channel = [slice(*pair) for pair in pairwise(limits)]
        self.own = [self._own(c, start) for c, start in enumerate(ends[:-1])]

    def _own(self, c: int, start: int) -> "OwnRows":
        rows = np.flatnonzero(self.owner == c)
        rows = rows[np.argsort(self.column[rows], kind="stable")]
        first = np.flatnonzero(np.diff(self.column[rows], prepend=-1))
        return OwnRows(rows, self.channel[rows], first, self.column[rows][first] - start)

    def rows(self, batch: Batch, zeros: np.ndarray, weights: np.ndarray | None) -> np.ndarray:
        """Return all rows (rows, samples), times the root of the weights."""
        if not len(self.owner):
            return np.zeros((0, len(batch)))
        pose, state = batch.columns(self.model.references), batch.columns(self.state)
        values: np.ndarray
        (values,) = self.run(self.p, zeros, pose, state)
        spoiled = np.unique(self.owner[~np.isfinite(values).all(axis=1)])
        if len(spoiled):
            self.spoiled |= {self.keys[k] for k in spoiled}
            values[np.isin(self.owner, spoiled)] = 0.0
        if weights is not None:
            values *= np.sqrt(weights)
        return values


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
    rows = ca.cse(ca.vertcat(*(s.rows for s in each))[order.tolist()]) if len(order) else ca.SX(0, 1)
    s = model.symbols
    state = {
        symbol.element_hash(): (name, symbol)
        for wide, _ in candidates
        for name, symbol in zip(wide.state, ca.vertsplit(wide.symbols.state), strict=True)
    }
    inputs = [s.parameters, s.zeros, s.pose, ca.vertcat(*(symbol for _, symbol in state.values()))]
    run = on_arrays(ca.Function("slopes", inputs, [ca.densify(rows)]))
    return run, tuple(name for name, _ in state.values()), channel[order], column[order]


class OwnRows(NamedTuple):
    """Which rows (r,) a candidate has, column by column, and the channel of each.

    `first`: where each column that is not nil begins among them, `column`: its place in the candidate.
    """

    rows: np.ndarray
    channel: np.ndarray
    first: np.ndarray
    column: np.ndarray


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of the columns [parameters | effects | residual], the offsets of each run eliminated.

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
    """(runs, offsets, c): how the offsets of a run follow the other columns; none with candidates."""
    order: tuple[int, ...]
    """The runs of `follow`."""
    slopes: Slopes
    """What computes the columns of the candidates."""
    spoiled: frozenset[str] = frozenset()
    """Candidates whose slope is not finite somewhere; their columns are 0."""
    offsets: np.ndarray | None = None
    """(units, offsets, c): products with the run's own offsets, in units in which these are orthonormal.

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


UNITS = 64
"""Runs whose matrices are kept one by one; beyond that neighbouring runs are pooled."""
ENTRIES = 500_000
"""Derivatives of the readings, and products of them, that are held at once: 4 MB each."""


class Units(NamedTuple):
    """Stretches of runs: the `run` of each, samples, sum of their weights, and the products of their columns.

    Shapes (units,); `Products` as a fit weighs them (`white`, `inner`) and in the output.
    """

    run: np.ndarray
    samples: np.ndarray
    weight: np.ndarray
    white: np.ndarray
    inner: np.ndarray
    output: np.ndarray
    output_inner: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Units"]) -> "Units":
        """Return units one after the other."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def at(self, index: Any) -> "Units":
        """Return some of them."""
        return Units(*(values[index] for values in self))

    def summed(self, first: np.ndarray, order: Any = slice(None)) -> "Units":
        """Return stretches that begin at `first` of those taken in `order` as one unit each."""
        if len(first) == len(self.run):
            return self
        return Units(self.run[order][first], *(np.add.reduceat(v[order], first) for v in self[1:]))


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
        slopes: Slopes | None = None,
    ) -> None:
        self.base, self.length, self.decoded = base, length, decoded
        model = base.model
        self.read = reading_and_slopes(model, base.free)
        self.z, self.n = len(base.model.zeros), len(base.free)
        self.slopes = slopes or Slopes(base.model, base.p, candidates or {})
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
        rows = max(len(self.near) * len(model.channels), len(self.slopes.column))
        self.most = max(FEWEST, ENTRIES // rows)
        self.precision = np.linalg.inv(base.covariance)
        self.whiten = np.linalg.cholesky(self.precision).T
        self.run: int | None = None
        self.seen = 0
        self.open: Units | None = None
        self.done: list[Units] = []
        self.members: list[tuple[int, ...]] = []
        self.offsets: list[np.ndarray] = []
        self.order: list[int] = []
        self.follow: list[np.ndarray] = []

    def batches(self, log: Log) -> Iterator[Batch]:
        """Yield a log in batches with all columns that the models read."""
        base, wide = self.base, self.base.model
        for model in self.models:
            wide = wide.with_columns(*model.computed)
        columns = tuple(dict.fromkeys(c for m in self.models for c in columns_of(m)))
        return batches(extended(log, wide, base.sigma, base.values), columns)

    def columns(self, batch: Batch, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns of offsets, parameters and residual, and the rows of the candidates."""
        return self._near(batch, weights), self.slopes.rows(batch, self.base.zeros_of(batch), weights)

    def weighed(self) -> Iterator[tuple[Batch, np.ndarray | None]]:
        """Yield the log in batches of at most `most` samples, with the weights of their samples."""
        for batch in self.batches(self.base.log):
            weights = batch.weights(self.base.keep)
            for piece, at in batch.pieces(self.most):
                yield piece, None if weights is None else weights[at]

    def add(self, batch: Batch, weights: np.ndarray | None) -> None:
        """Add a batch to the runs that it belongs to."""
        run = np.array([block.run for block in batch.blocks])
        if self.length:
            batch = batch.cut(self.length, self.seen if run[0] == self.run else 0)
            run = np.array([block.run for block in batch.blocks])
        samples = np.diff(batch.edges)
        count = samples if weights is None else np.add.reduceat(weights, batch.edges[:-1])
        (near, rows), D = self.columns(batch, weights), self._to_pose(batch)
        for first, last in batch.groups(max(1, ENTRIES // (len(near) * self.size))):
            lay, at = batch.layout(first, last), slice(first, last)
            white, out = stacked_products(self, lay(near), lay(rows), lay(D))
            self._gather(Units(run[at], samples[at], count[at].astype(float), *white, *out))

    def _to_pose(self, batch: Batch) -> np.ndarray:
        """What turns readings into the decoded pose, rotation as length: (pose, K, samples), or no row."""
        base, model = self.base, self.base.model
        if not self.decoded:
            return np.zeros((0, len(model.channels), len(batch)))
        spread = base.to_pose(batch.columns(model.references), batch.columns(model.state))
        return spread * base.pose_weights[:, None, None]

    def _near(self, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
        """Columns of offsets, parameters and residual, (own + 1, K, samples)."""
        base, model = self.base, self.base.model
        pose, state = batch.columns(model.references), batch.columns(model.state)
        run, channel, column = self.read
        reading, slopes = run(base.p, base.zeros_of(batch), pose, state)
        A = np.zeros((self.z + self.n + 1, len(model.channels), len(batch)))
        A[column, channel] = slopes
        A[-1] = np.array(batch.columns(model.channels)) - reading
        if weights is not None:
            A *= np.sqrt(weights)
        return A

    def _gather(self, more: Units) -> None:
        """Add stretches to the units that they belong to, and close the runs that are complete."""
        u = more if self.open is None else Units.joined([self.open, more])
        first = np.flatnonzero(np.append(True, u.run[1:] != u.run[:-1]))
        begins = np.zeros(len(u.run), dtype=bool)
        begins[first] = True
        if self.length:
            before = np.cumsum(u.samples) - u.samples
            before -= np.repeat(before[first], np.diff([*first, len(u.run)]))
            begins |= before % self.length == 0
        u = u.summed(np.flatnonzero(begins))
        last = int(np.argmax(u.run == u.run[-1]))
        self.run, self.open = int(u.run[-1]), u.at(slice(last, None))
        self.seen = int(self.open.samples.sum())
        if last:
            self._close(u.at(slice(last)))

    def _close(self, u: Units) -> None:
        """Eliminate the offsets of whole runs: they follow the likelihood, in the output too."""
        z, first = self.z, np.flatnonzero(np.append(True, u.run[1:] != u.run[:-1]))
        parts = np.diff([*first, len(u.run)])
        across = np.add.reduceat(u.white[:, :z], first)
        follow = -solve(across[:, :, :z], across[:, :, z:]) if z else across
        self.order += u.run[first].tolist()
        # candidates are scored, not stepped to: with them nobody asks, and a log may have many runs
        self.follow.append(follow[:, :, :0].copy() if self.slopes.columns else follow)
        by_unit = np.repeat(follow, parts, axis=0)
        white, inner = self._eliminated(u.white, u.inner, by_unit)
        output, output_inner = self._eliminated(u.output, u.output_inner, by_unit)
        i, j = self.pairs
        own = i == j
        # a run's zeros leave rounding of some columns, such as a step between runs
        left, whole = (np.add.reduceat(x[:, own], first) for x in (inner, u.inner))
        run, candidate = np.nonzero(left <= NIL * whole)
        nil = np.zeros((len(first), self.size - z), dtype=bool)
        nil[run, i[own][candidate]] = True
        nil = np.repeat(nil, parts, axis=0)
        if len(run):
            for border, products in ((white, inner), (output, output_inner)):
                border[np.broadcast_to(nil[:, None], border.shape)] = 0.0
                products[nil[:, i] | nil[:, j]] = 0.0
        if self.length:
            self.offsets.append(self._offsets(u.white[:, :z], across, by_unit, nil, parts))
        self.done.append(Units(u.run, u.samples, u.weight, white, inner, output, output_inner))
        self.members += [(run,) for run in u.run.tolist()]
        if len(self.members) > 2 * UNITS and not self.length:
            self._pool()

    def _offsets(
        self, border: np.ndarray, across: np.ndarray, follow: np.ndarray, nil: np.ndarray, parts: np.ndarray
    ) -> np.ndarray:
        """Return `NormalEquations.offsets` of the units of some runs; nil of those that are whole runs."""
        z = self.z
        out = border[:, :, z:] + border[:, :, :z] @ follow
        out[np.broadcast_to(nil[:, None], out.shape)] = 0.0
        root = np.zeros((len(parts), z, z))
        if z and (cut := parts > 1).any():
            root[cut] = np.linalg.cholesky(pseudo_inverse(across[cut, :, :z])).swapaxes(1, 2)
        return np.repeat(root, parts, axis=0) @ out

    def _eliminated(
        self, border: np.ndarray, inner: np.ndarray, follow: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return products once the offsets follow the other columns as `follow` (units, offsets, c) says."""
        z, rows = self.z, self.near[self.z :] - self.z
        half = border[:, :z, z:] + 0.5 * border[:, :z, :z] @ follow
        left = border[:, z:, z:] + half[..., rows].swapaxes(1, 2) @ follow
        left += follow[..., rows].swapaxes(1, 2) @ half
        i, j = self.pairs
        return left, inner + (half[..., i] * follow[..., j] + follow[..., i] * half[..., j]).sum(axis=1)

    def _pool(self) -> None:
        """Pool neighbouring units of the same side, whenever there are too many."""
        new, u = len(self.done[-1].run), Units.joined(self.done)
        self.done.clear()
        known = len(u.run) - new
        groups: list[tuple[int, ...]] = [(k,) for k in range(known)]
        for k in range(known, len(u.run)):
            groups.append((k,))
            if len(groups) > 2 * UNITS:
                judging = [self.members[group[0]][0] in self.base.holdout for group in groups]
                sides = (
                    [g for g, held in zip(groups, judging, strict=True) if held is of] for of in (True, False)
                )
                groups = [tuple(chain(*side[k : k + 2])) for side in sides for k in range(0, len(side), 2)]
        first = np.cumsum([0, *map(len, groups[:-1])])
        self.done.append(u.summed(first, np.array([*chain(*groups)])))
        self.members = [tuple(chain(*(self.members[k] for k in group))) for group in groups]

    def result(self) -> NormalEquations:
        """Return what has been gathered."""
        if self.open is not None:
            self._close(self.open)
        u = Units.joined(self.done)
        parts = self.z > 0 and len(self.order) < len(u.run) and bool(self.length)
        return NormalEquations(
            Products(u.white, u.inner),
            Products(u.output, u.output_inner),
            u.weight,
            tuple(self.members),
            self.span,
            self.places,
            np.concatenate(self.follow),
            tuple(self.order),
            self.slopes,
            frozenset(self.slopes.spoiled),
            np.concatenate(self.offsets) if parts else None,
        )


# -- products of a batch -------------------------------------------------------------------------------------


def stacked_products(
    work: Accumulator, near: np.ndarray, rows: np.ndarray, D: np.ndarray
) -> tuple[Products, Products]:
    """Return products under the precision of `work`, and mapped to the pose by D; where D is empty no others.

    `work`: the `Accumulator`. `near`: (own, K, blocks, samples) of offsets, parameters and residual, `rows`:
    (rows, blocks, samples) of the candidates, `D`: (n_pose, K, blocks, samples).
    """
    first, blocks, precision = work.z + work.n, near.shape[2], work.precision
    white, decoded = np.tensordot(work.whiten, near, axes=(1, 1)).swapaxes(0, 1), _decoded(D, near)
    shapes = (blocks, len(work.near), work.size), (blocks, work.pairs.shape[1])
    out = Products(*map(np.zeros, shapes)), Products(*map(np.zeros, shapes))
    for M, columns in zip(out, (white, decoded), strict=True):
        M.border[:, :, work.near] = _gram(columns)
    if not len(rows):
        return out
    metric = np.tensordot(precision, near, axes=(1, 1)).swapaxes(0, 1)
    mapped = np.einsum("ikbs,oibs->okbs", D, decoded)
    for M, columns in zip(out, (metric, mapped), strict=True):
        for k, at in enumerate(work.slopes.of_channel):
            across = columns[:, k].transpose(1, 0, 2) @ rows[at].transpose(1, 2, 0)
            M.border[:, :, first + work.slopes.column[at]] += across
    for (key, span), own in zip(work.slopes.span.items(), work.slopes.own, strict=True):
        if len(own.rows):
            square = (blocks, *(span.stop - span.start,) * 2)
            _add_own(work, rows, own, D, *(M.inner[:, work.places[key]].reshape(square) for M in out))
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
    work: Accumulator, rows: np.ndarray, own: OwnRows, D: np.ndarray, white: np.ndarray, out: np.ndarray
) -> None:
    """Add the products of the rows of a candidate with each other, (blocks, k, k) twice."""
    stack, count, K = rows[own.rows].swapaxes(0, 1), len(own.column), len(work.whiten)
    at = own.column[:, None], own.column

    def by_column(values: np.ndarray, axis: int = 1) -> np.ndarray:
        """Sum rows of one column."""
        return values if count == len(own.rows) else np.add.reduceat(values, own.first, axis=axis)

    if len(own.rows) ** 2 <= count * K * (count + K):
        gram = (stack @ stack.swapaxes(1, 2)) * work.precision[own.channel[:, None], own.channel]
        white[:, *at] += by_column(by_column(gram), axis=2)
    else:  # most columns have a row in most channels
        place = np.repeat(np.arange(count), np.diff([*own.first, len(own.rows)]))
        most = max(1, ENTRIES // (count * K * rows.shape[1]))
        for part in (rows[own.rows, :, k : k + most] for k in range(0, rows.shape[2], most)):
            columns = np.zeros((count, K, *part.shape[1:]))
            columns[place, own.channel] = part
            white[:, *at] += _gram(np.tensordot(work.whiten, columns, axes=(1, 1)).swapaxes(0, 1))
    for spread in D[:, own.channel].swapaxes(1, 2):
        moved = by_column(spread * stack)
        out[:, *at] += moved @ moved.swapaxes(1, 2)
