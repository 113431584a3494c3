"""Normal equations of a model and of candidate effects, run by run.

One pass over the log stacks, sample by sample, the columns [offsets | parameters | effects | residual]: the
derivatives of the reading with respect to each, and the residual of the model. Of each run only the products
of these columns are kept, twice: weighted by the noise of the readings (the cost of a fit) and mapped to the
decoded pose (the gap metric). The offsets of a run are eliminated at once. With these
matrices any set of effects can be fitted, cross-validated and judged without reading the log again.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count, islice, pairwise, takewhile
from typing import NamedTuple

import casadi as ca
import numpy as np

from hallsym.diagnosis.residuals import NIL, Base
from hallsym.estimation.covariance import ENTRIES
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.factors import pseudo_inverse, solve
from hallsym.log import Log
from hallsym.log.batches import Batch, batches
from hallsym.log.derived import extended
from hallsym.model import Model, Signals
from hallsym.model.arrays import FEWEST, jacobian, on_arrays
from hallsym.model.model import column_of, mapped


class Products(NamedTuple):
    """Products of columns: `border` (..., rows, c) of the model's own ones and the residual with all columns,
    `inner` (..., e) of each candidate's with each other, matrix by matrix.

    Products between two candidates are not kept. The residual is the last row and column.
    """

    border: np.ndarray
    inner: np.ndarray

    def summed(self) -> "Products":
        """Return the sum over all matrices, as one."""
        return Products(*(each.sum(axis=0, keepdims=True) for each in self))

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


def slopes_of(model: Model, tried: Sequence[tuple[Model, Sequence[str]]]) -> list[ca.SX]:
    """Return d reading / d some parameters of models that extend `model`, without entries of 0.

    At the nominal values of these parameters, where a model reads as `model` does. A model is differentiated
    up to the last step that it adds; the derivative of the steps that follow is built once for all models.
    """
    tails: dict[int, Tail] = {}
    heads = list[tuple[Tail, Signals, dict[int, ca.SX] | None]]()
    for wide, _ in tried:
        pairs = zip(reversed(model.steps), reversed(wide.steps), strict=False)
        common = len(list(takewhile(lambda pair: pair[0] is pair[1], pairs)))
        if common not in tails:
            tails[common] = Tail(model, common)
        heads.append((tails[common], *tails[common].head(wide)))
    slopes, at = list[ca.SX](), dict[int, tuple[ca.SX, ca.SX]]()
    for (wide, names), (tail, signals, moved) in zip(tried, heads, strict=True):
        new = wide.symbols_of("parameter", names)
        nominal = ca.SX(wide.nominal[[wide.names.index(name) for name in names]])
        if moved is None:
            slopes.append(jacobian(signals["reading"], new))  # what is derived depends on no parameter
        else:
            slopes.append(tail.slope(moved) @ jacobian(column_of(moved.values()), new))
        values = *zip(*map(ca.vertsplit, (new, nominal)), strict=True), *signals.derived.values()
        at |= {symbol.element_hash(): (symbol, value) for symbol, value in values}
    return [ca.sparsify(slope) for slope in substituted(slopes, at.values())]


def substituted(expressions: list[ca.SX], pairs: Iterable[tuple[ca.SX, ca.SX]]) -> list[ca.SX]:
    """Return expressions with a value in place of each symbol: (symbol, value)."""
    symbols, values = zip(*pairs, strict=True) if (pairs := list(pairs)) else ((), ())
    return list(ca.substitute(expressions, [column_of(symbols)], [column_of(values)]))


class Tail:
    """The last `steps` of a model, as a function of the signals that reach them.

    `moved`: a symbol for each entry of these signals that another model changes, by its number.
    """

    def __init__(self, model: Model, steps: int) -> None:
        self.model, self.first = model, len(model.steps) - steps
        self.signals = model.signals(self.first)
        self.form, self.entries = _entries(self.signals, self.signals)
        self.moved: dict[int, ca.SX] = {}

    def head(self, wide: Model) -> tuple[Signals, dict[int, ca.SX] | None]:
        """Return the signals with which `wide` comes to these steps, and their entries that differ from those
        of the model, by number. Of signals of another form: all of `wide`, and None."""
        signals = wide.signals(len(wide.steps) - len(self.model.steps) + self.first)
        form, entries = _entries(signals, self.signals)
        same = form == self.form and signals.functions == self.signals.functions
        if not form or not same or signals.keys() - self.signals.keys() - set(wide.state):
            return wide.signals(len(wide.steps)), None
        pairs = enumerate(zip(entries, self.entries, strict=True))
        moved = {k: a for k, (a, b) in pairs if a.element_hash() != b.element_hash()}
        self.moved |= {k: ca.SX.sym("moved") for k in moved if k not in self.moved}
        return signals, moved

    def slope(self, moved: Iterable[int]) -> ca.SX:
        """Return d reading / d some entries, all of which have been asked for by `head`."""
        order = {k: place for place, k in enumerate(self.moved)}
        return self._slopes[:, [order[k] for k in moved]]

    @cached_property
    def _slopes(self) -> ca.SX:
        numbers, signals = count(), self.signals.copied()

        def as_symbols(x: ca.SX) -> ca.SX:
            each = (self.moved.get(k, self.entries[k]) for k in islice(numbers, x.nnz()))
            return ca.SX(x.sparsity(), column_of(each))

        signals.update({name: mapped(value, as_symbols) for name, value in signals.items()})
        self.model.through(signals, self.first, len(self.model.steps))
        slopes = [jacobian(signals["reading"], column_of(self.moved.values()))]
        made = (pair for name, pair in signals.derived.items() if name not in self.signals.derived)
        known = ((symbol, self.entries[k]) for k, symbol in self.moved.items())
        return substituted(substituted(slopes, made), known)[0]


def _entries(signals: Signals, names: Iterable[str]) -> tuple[str, list[ca.SX]]:
    """Return the form of the named signals, and the entries of their expressions.

    The form is empty where a signal is missing, or holds more than expressions, numbers and containers.
    """
    entries = list[ca.SX]()

    def form(x: ca.SX) -> str:
        single = x.is_scalar(True)
        entries.extend([x] if single else ca.vertsplit(ca.SX(x.nz[:])) if x.nnz() else ())
        return "1" if single else repr(x.sparsity())

    try:
        return repr([mapped(signals[name], form) for name in names]), entries
    except (KeyError, TypeError):
        return "", []


def entries(slope: ca.SX) -> np.ndarray:
    """Return channel and column of each entry of a slope that is not nil, (2, entries)."""
    return np.array(slope.sparsity().get_triplet(), dtype=int)


class Graph(NamedTuple):
    """Compiled slopes: `run(p, offsets, pose, state)` returns them in one array, channel by channel.

    `state`: the columns that it reads. `entries`: channel, column and row of each slope, (3, entries), by
    channel; columns are [offsets | parameters | candidates | reading], and equal slopes of one channel
    are one row. `first`: row at which each channel begins, and the number of rows.
    """

    run: Callable[..., list[np.ndarray]]
    state: tuple[str, ...]
    entries: np.ndarray
    first: np.ndarray


def _graph(model: Model, free: Sequence[int], candidates: Sequence[tuple[Model, Sequence[str]]]) -> Graph:
    """Compile the readings of a model and all slopes; common subexpressions are computed once.

    Channel by channel: few values are needed at once.
    """
    s = model.symbols
    reading = s.full(s.reading)
    own = jacobian(reading, ca.vertcat(s.offsets, s.parameters[list(free)]))
    parts = [own, *slopes_of(model, candidates), ca.densify(reading)]
    starts = np.cumsum([0, *(part.shape[1] for part in parts)])
    places = [entries(part) + np.outer([0, 1], start) for part, start in zip(parts, starts[:-1], strict=True)]
    channel, column = np.concatenate(places, axis=1)
    slopes = ca.cse(ca.vertcat(*(ca.vec(part.nz[:]) for part in parts if part.nnz())))
    hashes = [slope.element_hash() for slope in ca.vertsplit(slopes)]
    order, rows = np.lexsort((column, channel)), dict[tuple[int, int, bool], int]()
    residual = column == starts[-2]  # a reading is the slope by its gain as well, a residual is not
    row = [rows.setdefault((channel[k], hashes[k], residual[k]), len(rows)) for k in order]
    chosen = order[np.unique(row, return_index=True)[1]]
    state = {
        symbol.element_hash(): (name, symbol)
        for one in (model, *(wide for wide, _ in candidates))
        for name, symbol in zip(one.state, ca.vertsplit(one.symbols_of("column", one.state)), strict=True)
    }
    inputs = [s.parameters, s.offsets, s.pose, ca.vertcat(*(symbol for _, symbol in state.values()))]
    run = on_arrays(ca.Function("slopes", inputs, [ca.densify(slopes[chosen.tolist()])]))
    for wide, _ in candidates:
        wide.forget()  # few are fitted, and all are remembered
    known = np.array([channel[order], column[order], row])
    first = np.searchsorted(channel[chosen], range(len(model.channels) + 1))
    return Graph(run, tuple(name for name, _ in state.values()), known, first)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of the columns [parameters | effects | residual], the offsets of each run eliminated.

    `whitened`: of each unit, weighted by the noise; `decoded`: mapped to the pose, of each unit or of groups
    of runs. `count`: (units,) samples. `runs`: the runs of each unit, `unit_of`: that of each run and stretch
    of it. `span`: columns of each candidate, by its key; the base's parameters are under "". `places`: of its
    products in `Products.inner`. `follow`: (runs, offsets, c) offsets of a run of `order` as functions of the
    other columns; none with candidates. `spoiled`: candidates whose slope is not finite somewhere; their
    columns are 0. `offsets`: (units, offsets, c) products with the run's own offsets, in units in which these
    are orthonormal, which over a whole run add up to 0; None where every unit is a whole run. `graph`: of the
    columns.
    """

    whitened: Products
    decoded: Products
    count: np.ndarray
    runs: tuple[tuple[int, ...], ...]
    unit_of: dict[tuple[int, int], int]
    span: dict[str, slice]
    places: dict[str, slice]
    follow: np.ndarray
    order: tuple[int, ...]
    spoiled: frozenset[str]
    offsets: np.ndarray | None
    graph: Graph

    @property
    def likelihood(self) -> np.ndarray:
        """Products (units, p, p) of the model's own columns and the residual, weighted by the noise."""
        return self.of(None) if self.places else self.whitened.border

    def of(self, key: str | None) -> np.ndarray:
        """Return products (units, p, p) of the model's columns, those of a candidate, and the residual."""
        return self.whitened.of(*((self.span[key], self.places[key]) if key else (NONE, NONE)))

    def units(self, runs: Iterable[int]) -> np.ndarray:
        """Return the index of the units whose runs are all among `runs`."""
        known = set(runs)
        return np.array([k for k, unit in enumerate(self.runs) if known.issuperset(unit)], dtype=int)


NONE = slice(0, 0)
"""Columns of no candidate."""
UNITS = 64
"""Most runs whose matrices are kept singly; of more, neighbouring runs are pooled."""


def normal_equations(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None,
    length: int | None = None,
    *,
    decoded: bool = True,
    judged: Sequence[Collection[int]] | None = None,
) -> NormalEquations:
    """Read the log once and return the tangents of `candidates`: key -> (extended model, new parameters).

    New parameters are taken at their nominal value, where they have no effect. `length`: samples of a unit,
    where a run is split into several. `decoded`: also map products to the pose, which the step of a fit does
    not need; without it they are not valid. `judged`: groups of runs whose products mapped to the pose are
    kept as sums, of no others; None: those of each unit.
    """
    work, runs, groups = Columns(base, candidates), base.log.runs, pooled(base)
    pool = {run: k for k, group in enumerate(groups) for run in group}
    most = (base.log.rows // length + len(runs),) * 2 if length else (len(runs), len(groups))
    fold = {run: k for k, group in enumerate(judged or ()) for run in group}
    folds = most[1] if judged is None else len(judged) + 1  # the last one of all others
    border, inner = (len(work.near) - work.z, work.size - work.z), work.pairs.shape[1]
    made = [Products(np.zeros((size, *border)), np.zeros((size, inner))) for size in (most[1], folds)]
    count, offsets = np.zeros(most[1]), np.zeros((2, most[0], work.z, work.size))
    parts: dict[tuple[int, int], int] = {}  # which (run, stretch) each row of `offsets` is of
    seen: dict[int, int] = {}
    for whole, weights in work.weighed():
        batch, keys = stretches(whole, seen, length)
        rows = work.rows(batch, weights)
        near = work.dense(rows)
        D = work.to_pose(batch) if decoded else np.zeros((0, near.shape[1], len(batch)))
        weight = np.diff(batch.edges) if weights is None else np.add.reduceat(weights, batch.edges[:-1])
        products = max(len(near) * work.size, work.pairs.shape[1])
        for first, last in batch.groups(max(1, ENTRIES // products)):
            lay = batch.layout(first, last)
            both = stacked_products(work, lay(near), lay(rows), lay(D))
            for k, key in enumerate(keys[first:last]):
                part = parts.setdefault(key, len(parts))
                unit = part if length else pool[key[0]]
                count[unit] += weight[first + k]
                into = unit, unit if judged is None else fold.get(key[0], folds - 1)
                for M, place, own, more in zip(made, into, offsets, both, strict=True):
                    own[part] += more.border[k, : work.z]
                    M.border[place] += more.border[k, work.z :, work.z :]
                    M.inner[place] += more.inner[k]
    run = np.array([number for number, _ in parts])
    if length:
        groups = [(number,) for number in run.tolist()]
    units = np.arange(len(run)) if length else np.array([pool[number] for number in run.tolist()])
    sums = np.array([fold.get(number, folds - 1) for number in run.tolist()])
    sizes = len(groups), len(groups) if judged is None else folds
    whitened, output = (Products(*(x[:size] for x in M)) for M, size in zip(made, sizes, strict=True))
    follow, of_offsets = eliminated(
        work, (whitened, output), offsets[:, : len(run)], run, (units, units if judged is None else sums)
    )
    return NormalEquations(
        whitened,
        output if judged is None else Products(*(x[:-1] for x in output)),
        count[: len(groups)],
        tuple(groups),
        dict(zip(parts, units.tolist(), strict=True)),
        work.span,
        work.places,
        follow,
        tuple(dict.fromkeys(run.tolist())),
        frozenset(work.spoiled),
        of_offsets,
        work.graph,
    )


def pooled(base: Base) -> list[tuple[int, ...]]:
    """Return the runs in groups: neighbours of the same side together, whenever there are too many."""
    groups: list[tuple[int, ...]] = []
    for run in base.log.runs:
        groups.append((run,))
        if len(groups) > 2 * UNITS:
            sides = ([g for g in groups if (g[0] in base.holdout) is inside] for inside in (True, False))
            groups = [tuple(chain(*side[k : k + 2])) for side in sides for k in range(0, len(side), 2)]
    return groups


def stretches(batch: Batch, seen: dict[int, int], length: int | None) -> tuple[Batch, list[tuple[int, int]]]:
    """Return a batch in blocks that end at every `length` samples of a run, and (run, stretch) of each.

    `seen`: samples of each run before the batch; it is brought up to date.
    """
    batch = batch.cut(length, seen.get(batch.runs[0], 0)) if length else batch
    keys = list[tuple[int, int]]()
    for run, part in batch.parts():
        done = seen.get(run, 0)
        keys.append((run, done // length if length else 0))
        seen[run] = done + part.stop - part.start
    return batch, keys


def eliminated(
    work: "Columns",
    made: tuple[Products, Products],
    offsets: np.ndarray,
    run: np.ndarray,
    units: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray | None]:
    """Let the offsets of whole runs follow the likelihood, in the output too.

    `made`: products of all other columns, which are changed in place. `offsets`: (2, parts, offsets, columns)
    products with the offsets; `run`: (parts,) of each part of a run, `units`: where it is in each of `made`.
    Returns `follow`, which only the step of a fit without candidates needs, and `offsets` of
    `NormalEquations`.
    """
    z, near, (i, j) = work.z, work.near[work.z :] - work.z, work.pairs
    first = np.flatnonzero(np.append(True, run[1:] != run[:-1]))
    sizes = np.diff([*first, len(run)])
    of_run, own, inner = np.repeat(np.arange(len(first)), sizes), i == j, made[0].inner
    group = first if len(inner) == len(run) else np.arange(len(inner))  # units of one run
    whole = np.add.reduceat(inner[:, own], group)
    across = np.add.reduceat(offsets[0], first) if len(first) < len(run) else offsets[0]
    follow = np.zeros((len(first), z, 0 if work.count else work.size - z))
    step = min(UNITS, max(1, ENTRIES // max(1, z * len(i))))
    for low in range(0, len(run) if z else 0, step):  # some at a time: a log may have many runs
        at = slice(low, low + step)
        by = -solve(*np.split(across[of_run[at]], [z], axis=2))
        if not work.count:
            follow[of_run[at]] = by
        for M, part, unit in zip(made, offsets[:, at], units, strict=True):
            half = part[:, :, z:] + 0.5 * part[:, :, :z] @ by
            more = half[..., near].swapaxes(1, 2) @ by + by[..., near].swapaxes(1, 2) @ half
            of_pairs = (half[..., i] * by[..., j] + by[..., i] * half[..., j]).sum(axis=1)
            for k, border, products in zip(unit[at], more, of_pairs, strict=True):
                M.border[k] += border
                M.inner[k] += products
    # a run's offsets leave rounding of some columns, such as a step between runs
    of, candidate = np.nonzero(np.add.reduceat(inner[:, own], group) <= NIL * whole)
    nil = np.zeros((len(group), work.size - z), dtype=bool)
    nil[of, i[own][candidate]] = True
    nil = np.repeat(nil, np.diff([*group, len(inner)]), axis=0)
    for M, unit in zip(made, units, strict=True) if nil.any() else ():
        none = np.ones((len(M.inner), work.size - z), dtype=bool)
        np.logical_and.at(none, unit, nil[units[0]])
        M.border[np.broadcast_to(none[:, None], M.border.shape)] = 0.0
        M.inner[none[:, i] | none[:, j]] = 0.0
    if not z or len(first) == len(run):
        return follow, None
    every = -solve(across[:, :, :z], across[:, :, z:])
    of_offsets = offsets[0][:, :, z:] + offsets[0][:, :, :z] @ every[of_run]
    of_offsets[np.broadcast_to(nil[:, None], of_offsets.shape)] = 0.0
    root = np.zeros((len(first), z, z))
    cut = sizes > 1
    root[cut] = np.linalg.cholesky(pseudo_inverse(across[cut, :, :z])).swapaxes(1, 2)
    return follow, root[of_run] @ of_offsets


def coefficients(M: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the coefficients of `columns` that explain the last column in least squares, from products."""
    return pseudo_inverse(M[np.ix_(columns, columns)]) @ M[columns, -1]


class Columns:
    """The columns [offsets | parameters | candidates | residual] of a log, batch by batch.

    `z`, `n`: offsets and parameters. `near`: where offsets, parameters and residual lie among all `size`
    columns. `span`, `places`: as in `NormalEquations`. `pairs`: the columns, offsets not counted, of each
    product within a candidate. `channel`, `column`, `row`: of each slope, those of one channel together at
    `of_channel`, their rows at `rows_of`; `residual`: (K,) rows of the residual. `own`: the slopes (r,) of
    each candidate, column by column. `within`: which slopes are of `near`, `place`: where there. `touched`:
    columns of `near` with the channels that they touch. `most`: samples whose columns are in memory at once.
    `spoiled`: candidates that were not finite somewhere; such rows are 0 there.
    """

    def __init__(
        self,
        base: Base,
        candidates: Mapping[str, tuple[Model, Sequence[str]]] | None = None,
        graph: Graph | None = None,
    ) -> None:
        """`graph`: of these columns, where it is known. That of the steps of a fit is kept by its model."""
        self.base, model, tried = base, base.model, candidates or {}
        if graph is None and tried:
            graph = _graph(model, base.free, list(tried.values()))
        self.graph = graph or model.remember(("columns", base.free), lambda: _graph(model, base.free, ()))
        self.models = (base.model, *(wide for wide, _ in tried.values()))
        self.z, self.n = len(base.model.offsets), len(base.free)
        widths = [len(new) for _, new in tried.values()]
        ends = np.cumsum([0, *widths])
        self.count, own = int(ends[-1]), self.z + self.n
        self.size = own + self.count + 1
        self.span = {"": slice(0, self.n)}
        self.span |= {key: slice(*pair) for key, pair in zip(tried, pairwise(self.n + ends), strict=True)}
        self.near = np.array([*range(own), self.size - 1])
        squares = np.cumsum([0, *(k * k for k in widths)]).tolist()
        self.places = {key: slice(*pair) for key, pair in zip(tried, pairwise(squares), strict=True)}
        pairs = [
            np.indices((k, k)).reshape(2, -1) + self.span[c].start for c, k in zip(tried, widths, strict=True)
        ]
        self.pairs = np.concatenate([np.zeros((2, 0), dtype=int), *pairs], axis=1)
        self.channel, self.column, self.row = self.graph.entries
        self.owner = np.searchsorted(own + ends, self.column, side="right") - 1
        self.residual = self.row[self.column == self.size - 1]
        limits = np.searchsorted(self.channel, range(len(model.channels) + 1)).tolist()
        self.of_channel = [slice(*pair) for pair in pairwise(limits)]
        self.rows_of = [slice(*pair) for pair in pairwise(self.graph.first.tolist())]
        by_column = np.argsort(self.column, kind="stable")
        self.own = [by_column[self.owner[by_column] == k] for k in range(len(tried))]
        self.spoiled: set[str] = set()
        self.most = max(FEWEST, ENTRIES // max(len(self.near) * len(model.channels), self.graph.first[-1]))
        self.precision = np.linalg.inv(base.covariance)
        self.whiten = np.linalg.cholesky(self.precision).T
        self.within = np.isin(self.column, self.near)
        self.place = np.minimum(self.column[self.within], own)
        touched = np.zeros((own + 1, len(self.precision)), dtype=bool)
        touched[self.place, self.channel[self.within]] = True
        alike, inverse = np.unique(touched, axis=0, return_inverse=True)
        groups = ((np.flatnonzero(inverse.ravel() == k), channels) for k, channels in enumerate(alike))
        self.touched = [(which, np.flatnonzero(channels)) for which, channels in groups]

    def batches(self, log: Log) -> Iterator[Batch]:
        """Yield a log in batches with all columns that the models read."""
        base, wide = self.base, self.base.model
        for model in self.models:
            wide = wide.with_columns(*model.computed)
        columns = tuple(dict.fromkeys(c for m in self.models for c in columns_of(m)))
        return batches(extended(log, wide, base.sigma, base.values), columns)

    def weighed(self) -> Iterator[tuple[Batch, np.ndarray | None]]:
        """Yield the log in batches of at most `most` samples, with the weights of their samples."""
        for batch in self.batches(self.base.log):
            weights = batch.weights(self.base.keep)
            for piece, at in batch.pieces(self.most):
                yield piece, None if weights is None else weights[at]

    def rows(self, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
        """Return the slopes and the residual, (rows, samples), times the root of the weights."""
        base, model, graph = self.base, self.base.model, self.graph
        pose, state = batch.columns(model.references), batch.columns(graph.state)
        (rows,) = graph.run(base.p, base.offsets_of(batch), pose, state)
        rows[self.residual] = np.array(batch.columns(model.channels)) - rows[self.residual]
        spoiled = (self.owner >= 0) & (self.owner < len(self.own))
        spoiled[spoiled] = ~np.isfinite(rows).all(axis=1)[self.row[spoiled]]
        if spoiled.any():
            self.spoiled |= {list(self.places)[k] for k in self.owner[spoiled]}
            rows[self.row[spoiled]] = 0.0
        if weights is not None:
            rows *= np.sqrt(weights)
        return rows

    def dense(self, rows: np.ndarray) -> np.ndarray:
        """Return the columns of offsets, parameters and residual, (own + 1, K, samples)."""
        out = np.zeros((len(self.near), len(self.precision), rows.shape[1]))
        out[self.place, self.channel[self.within]] = rows[self.row[self.within]]
        return out

    def to_pose(self, batch: Batch) -> np.ndarray:
        """Return d pose / d reading, rotation as length: (pose, K, samples)."""
        base, model = self.base, self.base.model
        spread = base.to_pose(batch.columns(model.references), batch.columns(model.state))
        return spread * base.pose_weights[:, None, None]


# -- products of a batch -------------------------------------------------------------------------------------


def stacked_products(
    work: Columns, near: np.ndarray, rows: np.ndarray, D: np.ndarray
) -> tuple[Products, Products]:
    """Return products under the precision of `work`, and mapped to the pose by D; where D is empty no others.

    `work`: the `Columns`. `near`: (own, K, blocks, samples) of offsets, parameters and residual, `rows`:
    (rows, blocks, samples) of all, `D`: (n_pose, K, blocks, samples).
    """
    blocks = near.shape[2]
    shapes = (blocks, len(work.near), work.size), (blocks, work.pairs.shape[1])
    out = Products(*map(np.zeros, shapes)), Products(*map(np.zeros, shapes))
    step = max(1, 4 * ENTRIES // near[..., 0].size)
    for low in range(0, near.shape[3], step):
        at = (..., slice(low, low + step))
        _add_products(work, near[at], rows[at], D[at], out)
    own = out[0].border[:, :, work.near]
    out[0].border[:, :, work.near] = 0.5 * (own + own.swapaxes(1, 2))
    return out


def _add_products(
    work: Columns, near: np.ndarray, rows: np.ndarray, D: np.ndarray, out: tuple[Products, Products]
) -> None:
    """Add the products of some samples of each block."""
    decoded, metric = _decoded(work, D, near), _weighted(work, near)
    for k, (at, here) in enumerate(zip(work.of_channel, work.rows_of, strict=True)):
        across = metric[:, k].swapaxes(0, 1) @ rows[here].transpose(1, 2, 0)
        out[0].border[:, :, work.column[at]] += across[:, :, work.row[at] - here.start]
    out[1].border[:, :, work.near] += _gram(decoded)
    for key, at in zip(work.places, work.own, strict=True):
        if len(at):
            _add_own(work, key, rows[work.row[at]], D, decoded, out)


def _decoded(work: Columns, D: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the columns `near` mapped to errors of the pose, (own, n_pose, blocks, samples)."""
    out = np.empty((len(near), len(D), *near.shape[2:]))
    for which, at in work.touched:
        for k in which:
            np.einsum("ikbs,kbs->ibs", D[:, at], near[k, at], out=out[k])
    return out


def _weighted(work: Columns, near: np.ndarray) -> np.ndarray:
    """Return the columns `near` times the precision, of the same shape."""
    out = np.empty(near.shape)
    for which, at in work.touched:
        out[which] = np.tensordot(work.precision[:, at], near[which[:, None], at], (1, 1)).swapaxes(0, 1)
    return out


def _gram(columns: np.ndarray) -> np.ndarray:
    """Return the products (blocks, own, own) of columns (own, rows, blocks, samples) with each other."""
    flat = columns.transpose(2, 0, 1, 3).reshape(columns.shape[2], len(columns), -1)
    return np.array([own @ own.T for own in flat])


def _add_own(
    work: Columns, key: str, rows: np.ndarray, D: np.ndarray, decoded: np.ndarray, out: tuple[Products, ...]
) -> None:
    """Add the products of the `rows` of a candidate with each other, and of its decoded errors with those of
    the model's columns, `decoded`."""
    span, at = work.span[key], work.own[list(work.places).index(key)]
    width = span.stop - span.start
    white, inner = (M.inner[:, work.places[key]].reshape(-1, width, width) for M in out)
    stack, channel, K = rows.swapaxes(0, 1), work.channel[at], len(work.whiten)
    first = np.flatnonzero(np.diff(work.column[at], prepend=-1))
    place = work.column[at][first] - work.z - span.start
    block, k = np.ix_(place, place), len(first)

    def by_column(values: np.ndarray, axis: int = 1) -> np.ndarray:
        """Sum rows of one column."""
        return values if k == len(at) else np.add.reduceat(values, first, axis=axis)

    if len(at) ** 2 <= k * K * (k + K):
        gram = (stack @ stack.swapaxes(1, 2)) * work.precision[channel[:, None], channel]
        white[:, *block] += by_column(by_column(gram), axis=2)
    else:  # most columns have a row in most channels
        most = max(1, ENTRIES // (k * K * rows.shape[1]))
        for part in (rows[:, :, low : low + most] for low in range(0, rows.shape[2], most)):
            columns = np.zeros((k, K, *part.shape[1:]))
            columns[np.repeat(np.arange(k), np.diff([*first, len(at)])), channel] = part
            white[:, *block] += _gram(np.tensordot(work.whiten, columns, axes=(1, 1)).swapaxes(0, 1))
    across, gram = (np.zeros((len(stack), n, k)) for n in (len(decoded), k))
    for spread, own in zip(D[:, channel].swapaxes(1, 2), decoded.swapaxes(0, 1), strict=True):
        moved = by_column(spread * stack)
        gram += moved @ moved.swapaxes(1, 2)
        across += own.swapaxes(0, 1) @ moved.swapaxes(1, 2)
    inner[:, *block] += gram
    out[1].border[:, :, work.z + span.start + place] += across
