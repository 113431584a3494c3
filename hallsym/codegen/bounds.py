"""What can be said of the arithmetic over the whole box: least gains, size of the pose, rounding."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Bits, Decoupler, Lookup, Step, Whole, run_step, short
from hallsym.codegen.intervals import EXACT, TINY, Enclosure, constant, enclosures
from hallsym.codegen.operations import Graph, Operation

LEAST_GAIN = 0.1
"""Share of its gain at rest below which a probe must not fall within the box."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Over every input in the box: pose within `low`, `high`, and the computed one off by at most `error`.

    `error` counts the rounding of each operation and of each table entry. `least_gain`: by column of the
    margins, as a share of its value at rest.
    """

    low: Mapping[str, float]
    high: Mapping[str, float]
    error: Mapping[str, float]
    least_gain: Mapping[str, float]


def pose_bounds(d: Decoupler, digits: int = 24) -> Bounds:
    """Return the bounds of one table, by interval arithmetic on the printed expressions."""
    if d.bounded is None:
        found = enclosed(d, d.steps, digits)[-len(d.pose) :]
        if d.at_pose:  # an iteration takes each value again: over the whole box its error grows in each round
            errors = _errors_by_cells(d, digits)
            found = [replace(e, error=np.fmin(e.error, own)) for e, own in zip(found, errors, strict=True)]
    else:
        found = list(d.bounded(d, digits).values())
    values, reach = {e.name: abs(e.value) for e in d.table}, d.box.reach()
    # what the largest terms leave of a margin: exact where the box is symmetric and the columns independent
    least = {
        m.column: 1 - sum(values[e] * prod(reach[c] for c in own) for e, own in m.terms) / values[m.rest]
        for m in d.margins
    }
    return Bounds(
        low=dict(zip(d.pose, (e.low for e in found), strict=True)),
        high=dict(zip(d.pose, (e.high for e in found), strict=True)),
        error=dict(zip(d.pose, (e.error for e in found), strict=True)),
        least_gain=least,
    )


FOLDED = 16
"""Rounding of a table entry as it is computed in double from the parameters, in units of its last place.

Entries are sums of a few products of the inverse of a well-conditioned matrix; the largest seen is 4."""


def enclosed(d: Decoupler, steps: Sequence[Step], digits: int) -> list[Enclosure]:
    """Return the enclosure of each step over the box; errors count those of the table."""
    known = given_of(d, digits)
    for step in steps:
        enclosed_step(step, known, digits)
    return [known[step.name] for step in steps]


def enclosed_step(step: Step, known: dict[str, Enclosure], digits: int | None = None) -> list[Enclosure]:
    """Add the enclosure of a step to those by symbol; returns those of its operations.

    A row that is looked up, and bits, are anything that they can be.
    """
    if isinstance(step, Lookup):
        known[step.name] = known[step.array.name]
        return []
    every = enclosures(step.graph, known, digits)
    found = every[step.graph.results[0]]
    if isinstance(step, Bits):
        found = Enclosure(0.0, float((1 << step.first) - 1 if step.below else (2**32 - 1) >> step.first))
    known[step.name] = found
    return every


def given_of(d: Decoupler, digits: int) -> dict[str, Enclosure]:
    """Return the enclosures of inputs, over the box, and of entries, rounded as they are made and stored."""
    dtype = np.float32 if digits == 24 else np.float64
    found = {d.symbols[c].name(): Enclosure(*(float(dtype(v)) for v in d.ends(c))) for c in d.inputs}
    for e in (*d.table, *d.offsets):
        error = constant(e.value, digits).error + FOLDED * 2.0**-53 * abs(e.value)
        found[d.symbols[e.name].name()] = Enclosure(e.value, e.value, error)
    return found


CELLS = 512
"""Most parts of the box over which the rounding of an iteration is bounded at a time."""
ROUNDS = 5
"""Times that the worst of them are cut in half along each side."""


def _errors_by_cells(d: Decoupler, digits: int) -> np.ndarray:
    """Return the rounding of the pose (pose,) over all cells that what an iteration starts from is cut into.

    Proved: what operations round, each times the slope of the pose by it, enclosed over all values of a cell,
    rounded ones too (mean value theorem); where an iteration may be at an end of its range, slopes are 0 to
    1. Slopes have signs, so terms of an expanded polynomial cancel as they do in its value.
    """
    made, given = {step.name for step in d.steps}, given_of(d, digits)
    varies = made | {d.symbols[c].name() for c in d.inputs}
    reads = [{s.name() for s in ca.symvar(step.expression)} & varies for step in d.steps]
    crossing = []
    for k in range(len(d.steps) - len(d.pose) + 1):  # what the steps from k on read of what is before them
        later = {step.name for step in d.steps[k:]}
        crossing.append(sorted(set().union(*reads[k:]) - later))
    first = min(range(len(crossing)), key=lambda k: len(crossing[k]))
    for step in d.steps[:first]:
        enclosed_step(step, given, digits)
    steps, names = d.steps[first:], crossing[first]
    before = {name: float(e.error) for name, e in given.items()}

    def bounded(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        cell = zip(names, low, high, strict=True)
        known = given | {name: Enclosure(least, most, before[name]) for name, least, most in cell}
        worked = [
            [Enclosure(v.low - v.error, v.high + v.error) for v in enclosed_step(step, known, digits)]
            for step in steps
        ]
        with np.errstate(all="ignore"):  # what grows without end is bounded by nothing
            return np.array(_errors(steps, worked, before, digits, len(d.pose)))

    ends = np.array([[given[name].low, given[name].high] for name in names], dtype=float)
    low, high = _cut(ends[:, :1], ends[:, 1:], max(2, int(CELLS ** (1 / len(names)) + 1e-9)))
    found = bounded(low, high)
    usual = np.median(found, axis=1, keepdims=True)
    for _ in range(ROUNDS):
        order = np.argsort((found / usual).max(axis=0))
        kept, worst = np.split(order, [-max(1, CELLS >> len(names))])
        parts = _cut(low[:, worst], high[:, worst], 2)
        low, high = (np.hstack([a[:, kept], b]) for a, b in zip((low, high), parts, strict=True))
        found = np.hstack([found[:, kept], bounded(*parts)])
    return np.asarray(found.max(axis=1))


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


def pose_by_pose(d: Decoupler, digits: int) -> dict[str, Enclosure]:
    """Return range and rounding of each coordinate, flags clear, offsets at zero; `digits`: of the
    significand.

    Rounding is bounded for each of many poses of the box, and the largest bound is taken with some room.
    """
    assert d.drawn is not None  # of every decoder that claims nothing of readings of no pose
    inputs = d.drawn(np.random.default_rng(6), BOUNDED)
    named = dict(zip(map(short, d.inputs), inputs, strict=True))
    values, errors = rounding(d.steps, named, {e.name: e.value for e in d.entries}, digits, len(d.pose))
    ends = (values.min(axis=1), values.max(axis=1), ROOM * errors.max(axis=1))
    return {c: Enclosure(*map(float, e)) for c, *e in zip(d.pose, *ends, strict=True)}


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


def rounding(
    steps: Sequence[Step],
    inputs: Mapping[str, np.ndarray],
    entries: Mapping[str, float],
    digits: int,
    last: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and rounding errors (last, s) of the last steps.

    `inputs` (s,) by symbol, exact; `entries`: numbers of the table; `digits`: of the significand.
    """
    known: Numbers = {**inputs, **entries}
    with np.errstate(all="ignore"):
        worked = [run_step(step, known) for step in steps]
    stored = {name: float(constant(value, digits).error) for name, value in entries.items()}
    values, errors = (
        [np.broadcast_to(v, np.shape(next(iter(inputs.values())))) for v in found]
        for found in (
            [known[step.name] for step in steps[-last:]],
            _errors(steps, worked, stored, digits, last),
        )
    )
    return np.array(values), np.array(errors)


def _errors(
    steps: Sequence[Step],
    worked: Sequence[list[Any]],
    before: Mapping[str, float],
    digits: int,
    last: int,
) -> list[Any]:
    """Return the rounding errors of the last steps.

    `worked`: the values of each step's operations, numbers (s,) or enclosures of s cells; `before`: what
    symbols are off by that no step makes.
    """
    errors = []
    for step in steps[-last:]:
        adjoint: Numbers = {step.name: 1.0}
        total: Any = 0.0
        for one, values in zip(reversed(steps), reversed(worked), strict=True):
            if one.name in adjoint and not isinstance(one, Whole):
                total = total + _back(one.graph, values, adjoint.pop(one.name), adjoint, digits)
        for name, error in before.items():
            total = total + abs(adjoint.get(name, 0.0)) * error
        errors.append(total)
    return errors


def _back(own: Graph, values: list[Any], by: Any, adjoint: Numbers, digits: int) -> Any:
    """Add the derivatives by the symbols of a step, whose own is `by`; returns what its operations round."""
    slopes: list[Any] = [0.0] * len(values)
    slopes[own.results[0]] = by
    total: Any = 0.0
    for k in reversed(range(len(values))):
        o, z, slope = own.operations[k], values[k], slopes[k]
        if o.op == "input":
            adjoint[o.symbol] = adjoint.get(o.symbol, 0.0) + slope
            continue
        total = total + abs(slope) * _rounded(o, z, digits)
        if o.op != "const":
            for j, own_slope in zip(o.args, _SLOPES[o.op](z, *(values[a] for a in o.args)), strict=True):
                slopes[j] = slopes[j] + slope * own_slope
    return total


def _rounded(operation: Operation, value: Any, digits: int) -> Any:
    """Bound of what an operation is off by where its arguments are exact; of a number, as it is stored."""
    if operation.op == "const":
        return constant(operation.value, digits).error
    return 0.0 if operation.op in EXACT else 2.0**-digits * abs(value) + TINY[digits]
