"""What can be said of the arithmetic over the whole box: least gains, size of the pose, rounding."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import (
    FAULT,
    Bits,
    Decoupler,
    Flag,
    Lookup,
    Step,
    Whole,
    needed,
    run_step,
    short,
)
from hallsym.codegen.intervals import (
    EXACT,
    ROUNDOFF,
    TINY,
    Enclosure,
    Outcomes,
    enclose,
    hull,
    outcomes,
)
from hallsym.codegen.operations import BRANCHES, Graph, chosen
from hallsym.records import named

LEAST_GAIN = 0.1
"""Share of its gain at rest below which a probe must not fall within the box."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Over every input in the box: pose within `low`, `high`, and the computed one off by at most `error`.

    `error` counts the rounding of each operation and of each table entry.
    """

    low: Mapping[str, float]
    high: Mapping[str, float]
    error: Mapping[str, float]


def pose_bounds(d: Decoupler) -> Bounds:
    """Return the bounds of one table, by interval arithmetic on the printed expressions."""
    low, high, error = pose_by_pose(d) if d.sampled else _by_cells(d)
    if d.at_pose or straight(d.steps):  # the range as an analysis of the C sees it
        known = given_of(d)[0]
        for step in d.steps:
            enclosed_step(step, known)
        low, high = np.array([[float(known[s.name].low), float(known[s.name].high)] for s in _last(d)]).T
    return Bounds(*(named(d.pose, side) for side in (low, high, error)))


def _last(d: Decoupler) -> Sequence[Step]:
    return d.steps[-len(d.pose) :]


def least_gains(d: Decoupler) -> dict[str, float]:
    """Return what the largest terms within the box leave of each margin, as a share of its value at rest.

    Exact where the box is symmetric and the columns independent.
    """
    values, reach = {e.name: abs(e.value) for e in d.table}, d.box.reach()
    return {
        m.column: 1 - sum(values[e] * prod(reach[c] for c in own) for e, own in m.terms) / values[m.rest]
        for m in d.margins
    }


def straight(steps: Sequence[Step]) -> bool:
    """Whether steps hold arithmetic and magnitudes only: no comparison or choice."""
    return not any(o.op in BRANCHES - {"fabs"} for step in steps for o in step.graph.operations)


FOLDED = 16
"""Rounding of a table entry as it is computed in double from the parameters, in units of its last place.

Entries are sums of a few products of the inverse of a well-conditioned matrix; the largest seen is 4."""


def enclosed_step(step: Step, known: dict[str, Enclosure]) -> Outcomes:
    """Add the range of a step to those by symbol; returns those of its operations."""
    every = [] if isinstance(step, Lookup) else outcomes(step.graph, known)
    known[step.name] = _range_of(step, known, every)
    return every


def _range_of(step: Step, known: Mapping[str, Enclosure], every: Outcomes) -> Enclosure:
    """Return the range of a step: of a row that is looked up, and of bits, all that they can be."""
    if isinstance(step, Lookup):
        return known[step.array.name]
    if isinstance(step, Bits):
        return Enclosure(0.0, float((1 << step.first) - 1 if step.below else (2**32 - 1) >> step.first))
    last = step.graph.results[0]
    found: Enclosure = hull([(possible, values[last]) for possible, values in every])
    if step.most is None:
        return found
    (end,) = enclose([ca.SX(step.most)], known)
    return Enclosure(np.maximum(found.low, -end.high), np.minimum(found.high, end.high))


def stored_error(value: float) -> float:
    """Return by how much a number differs from the float32 one in its place."""
    return abs(value - float(np.float32(value)))


def given_of(d: Decoupler) -> tuple[dict[str, Enclosure], dict[str, float]]:
    """Return the ranges of inputs, over the box, and of entries, and what entries are off by as they are made
    and stored; both by symbol."""
    ranges = {d.symbols[c].name(): Enclosure(*(float(np.float32(v)) for v in d.ends(c))) for c in d.inputs}
    errors = {}
    for e in (*d.table, *d.offsets):
        name, made = d.symbols[e.name].name(), FOLDED * 2.0**-53 * abs(e.value) * (e.holds != "value")
        errors[name] = error = stored_error(e.value) + made
        ranges[name] = Enclosure(e.value - error, e.value + error)
    return ranges | {a.name: Enclosure(min(a.values), max(a.values)) for a in d.arrays}, errors


CELLS = 512
"""Most parts of the box over which the rounding of an iteration is bounded at a time."""
WAYS = 8
"""Times as many ways through comparisons as cells: beyond them, slopes are from 0 to 1 where one is open."""
ROUNDS = 8
"""Times that the worst of them are cut in half along each side."""


def rounded(
    steps: Sequence[Step],
    results: Sequence[str],
    ranges: Mapping[str, Enclosure],
    errors: Mapping[str, float],
    flags: Sequence[Flag] = (),
) -> np.ndarray:
    """Return less the least value, the greatest one and the rounding error of results, (3 results, s).

    `ranges`, `errors`: by symbol, numbers or those of s cells. Proved: what operations round, each times the
    slope of the result by it, enclosed over all values of a cell, rounded ones too (mean value theorem).
    Slopes have signs, so terms of an expanded polynomial cancel as they do in its value. NaN in cells
    in which a flag is set wherever the inputs are: they say nothing.
    """
    count = max((np.size(e.low) for e in ranges.values()), default=1)
    known, cell, worked = dict(ranges), np.arange(count), list[list[Enclosure]]()
    for step in steps:
        every = [] if isinstance(step, Lookup) else outcomes(step.graph, known, ROUNDOFF)
        some = [np.flatnonzero(np.broadcast_to(possible, cell.shape)) for possible, _ in every]
        if len(every) > 1 and sum(map(len, some)) > WAYS * count:
            every = [(True, [hull([(v, own[k]) for v, own in every]) for k in range(len(every[0][1]))])]
        elif len(every) > 1:  # each way that comparisons come out is a cell of its own
            take, pairs = np.concatenate(some), list(zip(every, some, strict=True))
            parts = [[_of_cells(e, own) for e in values] for (_, values), own in pairs]
            every = [(True, [_joined(es, some) for es in zip(*parts, strict=True)])]
            known = {name: _of_cells(e, take) for name, e in known.items()}
            worked, cell = [[_of_cells(e, take) for e in values] for values in worked], cell[take]
        known[step.name] = _range_of(step, known, every)
        worked.append(every[0][1] if every else [])
    clear = np.ones(len(cell), bool)
    for flag in flags:
        clear &= known[flag.step].high >= known[flag.least].low
    with np.errstate(all="ignore"):  # what grows without end is bounded by nothing
        off = [_rounded(step.graph, values) for step, values in zip(steps, worked, strict=True)]
        if len(cell) > count:  # what is computed may go another way than what is exact
            off = [[_most_of(v, cell, count)[cell] for v in own] for own in off]
        found = [np.where(clear, e, -np.inf) for e in _errors(steps, worked, off, errors, results)]
    rows = (*(-known[n].low for n in results), *(known[n].high for n in results), *found)
    out = np.array([_most_of(v, cell, count) for v in rows])
    return np.where(np.isneginf(out), np.nan, out)


def _by_cells(d: Decoupler) -> tuple[np.ndarray, ...]:
    """Return range and rounding of the pose over all cells that what most steps start from is cut into."""
    flags = [flag for flag in d.flags if flag.name != FAULT]
    pose = [step.name for step in _last(d)]
    every = needed(d.steps, [*pose, *(f.step for f in flags)])
    ranges, errors = given_of(d)
    varies = {step.name for step in every} | {d.symbols[c].name() for c in d.inputs}
    crossing: list[set[str]] = [set()]
    for step in reversed(every):  # what the steps from this one on read of what is before them
        reads = {s.name() for s in ca.symvar(step.expression)} & varies
        crossing.append((crossing[-1] - {step.name}) | reads)
    crossing = crossing[len(d.pose) :][::-1]
    seen = [k for k, step in enumerate(every) if step.name in {flag.step for flag in flags}]
    first = min(range(min(seen, default=len(crossing))), key=lambda k: len(crossing[k]))
    steps, names = every[first:], sorted(crossing[first])
    least, most, error = np.split(rounded(every[:first], names, ranges, errors)[:, 0], 3)
    errors |= named(names, error)

    def bounded(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return rounded(
            steps, pose, ranges | dict(zip(names, map(Enclosure, low, high), strict=True)), errors, flags
        )

    parts = max(2, int(CELLS ** (1 / len(names)) + 1e-9))
    low, high = _cut(-least[:, None], most[:, None], parts)
    found, n = bounded(low, high), 2 * len(d.pose)
    for _ in range(ROUNDS):
        usual = np.nanmedian(found[n:], axis=1, keepdims=True)
        order = np.argsort(np.nan_to_num((found[n:] / usual).max(axis=0), nan=0.0))
        kept, worst = np.split(order, [-max(1, CELLS >> len(names))])
        finer = _cut(low[:, worst], high[:, worst], 2)
        low, high = (np.hstack([a[:, kept], b]) for a, b in zip((low, high), finer, strict=True))
        found = np.hstack([found[:, kept], bounded(*finer)])
    less, most, error = np.split(np.nanmax(found, axis=1), 3)
    return -less, most, error


def _of_cells(e: Enclosure, some: np.ndarray) -> Enclosure:
    return Enclosure(*(v[some] if np.ndim(v) else v for v in (e.low, e.high)))


def _joined(parts: Sequence[Enclosure], some: Sequence[np.ndarray]) -> Enclosure:
    sides = zip(*((e.low, e.high) for e in parts), strict=True)
    return Enclosure(*(
        np.concatenate([np.broadcast_to(v, own.shape) for v, own in zip(side, some, strict=True)])
        for side in sides
    ))  # fmt: skip


def _most_of(values: Any, cell: np.ndarray, count: int) -> np.ndarray:
    """Return the largest value (count,) of the ways through each cell."""
    out = np.full(count, -np.inf)
    np.maximum.at(out, cell, np.broadcast_to(values, cell.shape))
    return out


def _cut(low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the cells (n, s) cut into so many parts along each side."""
    sides = np.array(np.meshgrid(*[np.arange(count)] * len(low))).reshape(len(low), 1, -1)
    grid = [
        low[..., None] * (1 - share) + high[..., None] * share
        for share in (sides / count, (sides + 1) / count)
    ]
    return grid[0].reshape(len(low), -1), grid[1].reshape(len(low), -1)


# -- rounding of one pose after the other, where intervals over the box relate too little --------------------

BOUNDED = 1000
"""Poses for which the rounding is bounded, one by one."""
ROOM = 1.5
"""Times the largest bound of these poses."""


def pose_by_pose(d: Decoupler) -> tuple[np.ndarray, ...]:
    """Return range and rounding (n_pose,) of each coordinate, flags clear, offsets at zero.

    Rounding is bounded for each of many poses of the box, and the largest bound is taken with some room.
    """
    assert d.drawn is not None  # of every decoder that claims nothing of readings of no pose
    inputs = d.drawn(np.random.default_rng(6), BOUNDED)
    known: Numbers = dict(zip(map(short, d.inputs), inputs, strict=True)) | {
        e.name: e.value for e in d.entries
    }
    stored, pose = {e.name: stored_error(e.value) for e in d.entries}, [step.name for step in _last(d)]
    with np.errstate(all="ignore"):
        worked = [run_step(step, known) for step in d.steps]
        off = [_rounded(step.graph, values) for step, values in zip(d.steps, worked, strict=True)]
        errors = _errors(d.steps, worked, off, stored, pose)
    values = np.array([known[name] for name in pose])
    return values.min(axis=1), values.max(axis=1), ROOM * np.array([np.max(e) for e in errors])


Numbers = dict[str, Any]


def _sign(x: Any) -> Any:
    if isinstance(x, Enclosure):
        return Enclosure(np.sign(x.low), np.sign(x.high))
    return np.sign(x)


def _taken(c: Any) -> Any:
    """What a choice makes of its value: 1 or 0, of a range of conditions perhaps either."""
    if isinstance(c, Enclosure):
        return Enclosure(np.clip(c.low, 0.0, 1.0), np.clip(c.high, 0.0, 1.0))
    return (c != 0) * 1.0


_SLOPES: dict[str, Callable[..., tuple]] = {
    "assign": lambda z, x: (1.0,),
    "neg": lambda z, x: (-1.0,),
    "twice": lambda z, x: (2.0,),
    "fabs": lambda z, x: (_sign(x),),
    "lt": lambda z, x, y: (0.0, 0.0),
    "le": lambda z, x, y: (0.0, 0.0),
    "not": lambda z, x: (0.0,),
    "if_else_zero": lambda z, c, x: (0.0, _taken(c)),
    "add": lambda z, x, y: (1.0, 1.0),
    "sub": lambda z, x, y: (1.0, -1.0),
    "mul": lambda z, x, y: (y, x),
    "div": lambda z, x, y: (1 / y, -z / y),
    "inv": lambda z, x: (-z * z,),
    "sq": lambda z, x: (2 * x,),
}
"""Derivatives by the arguments of an operation of result z; choices are between equals where they turn."""


def _errors(
    steps: Sequence[Step],
    worked: Sequence[list[Any]],
    off: Sequence[list[Any]],
    before: Mapping[str, float],
    results: Sequence[str],
) -> list[Any]:
    """Return the rounding errors of results, by the names of their symbols.

    `worked`: the values of each step's operations, numbers (s,) or enclosures of s cells; `off`: what each
    rounds; `before`: what symbols are off by that no step makes.
    """
    errors = []
    for result in results:
        adjoint: Numbers = {result: 1.0}
        total: Any = 0.0
        for one, values, own in zip(reversed(steps), reversed(worked), reversed(off), strict=True):
            if one.name in adjoint and not isinstance(one, Whole | Bits | Lookup):
                by = adjoint.pop(one.name)
                total = total + _back(one.graph, values, own, by, adjoint)
                if one.follows:  # bits of a place that are cut off move it too
                    place, slope = one.follows
                    adjoint[place] = adjoint.get(place, 0.0) + Enclosure(-slope, slope) * abs(by)
                    total = total + slope * abs(by)
        for name, error in before.items():
            total = total + abs(adjoint.get(name, 0.0)) * error
        errors.append(total)
    return errors


def _back(own: Graph, values: list[Any], off: list[Any], by: Any, adjoint: Numbers) -> Any:
    """Add the derivatives by the symbols of a step, whose own is `by`; returns what its operations round."""
    slopes: list[Any] = [0.0] * len(values)
    slopes[own.results[0]] = by
    total: Any = 0.0
    for k in reversed(range(len(values))):
        o, z, slope = own.operations[k], values[k], slopes[k]
        total = total + abs(slope) * off[k]
        if o.op == "input":
            adjoint[o.symbol] = adjoint.get(o.symbol, 0.0) + slope
        elif o.op != "const":
            for j, own_slope in zip(o.args, _SLOPES[o.op](z, *(values[a] for a in o.args)), strict=True):
                slopes[j] = slopes[j] + slope * own_slope
    return total


def _rounded(own: Graph, values: list[Any]) -> list[Any]:
    """Bounds of what operations are off by where their arguments are exact; of numbers, as they are stored.

    Nothing of those whose results are not chosen.
    """
    found: list[Any] = []
    counts: list[Any] = [np.False_] * len(values)
    if values:
        counts[own.results[0]] = np.True_
    for k in reversed(range(len(values))):
        o = own.operations[k]
        for j in o.args:
            used = counts[k]
            if o.op == "if_else_zero" and j == o.args[1]:
                used = used & (abs(_taken(values[o.args[0]])) > 0)
            counts[j] = counts[j] | used
    for o, z, count in zip(own.operations[: len(values)], values, counts, strict=True):
        off: Any = 0.0
        if o.op == "const":
            off = stored_error(o.value)
        elif o.op not in ("input", *EXACT) and not chosen(o, own.operations):
            off = _half_unit(abs(z)) + TINY
            if o.op in ("add", "sub"):
                # either argument is a number itself, as far off as the other; and a multiple of the units of
                # both has no digits to lose (Sterbenz)
                args = [values[k] for k in o.args]
                least = np.minimum(*(_half_unit(_least(a)) for a in args))
                exact = abs(z) <= 2 / ROUNDOFF * least
                off = np.where(exact, 0.0, np.minimum(off, np.minimum(*map(abs, args))))
            if o.op == "mul" and any(_is_power_of_two(values[k]) for k in o.args):
                off = 0.0
        found.append(np.where(count, off, 0.0))
    return found


def _is_power_of_two(x: Any) -> bool:
    low, high = (x.low, x.high) if isinstance(x, Enclosure) else (x, x)
    return bool(np.ndim(low) == 0 and low == high and abs(np.frexp(low)[0]) == 0.5)


def _half_unit(value: Any) -> Any:
    """Half of a unit in the last place of numbers of these sizes."""
    return np.exp2(np.floor(np.log2(value))) * ROUNDOFF


def _least(x: Any) -> Any:
    return np.maximum(np.maximum(x.low, -x.high), 0.0) if isinstance(x, Enclosure) else abs(x)
