"""What can be said of the arithmetic over the whole box: least gains, size of the pose, rounding."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np

from hallsym.codegen.decoupler import Decoupler, Entry, Step, Whole, computed, of_step, short
from hallsym.codegen.intervals import EXACT, TINY, Enclosure, constant, enclose
from hallsym.codegen.operations import Graph, Operation, graph

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


def least_gains(d: Decoupler) -> dict[str, float]:
    """Return by column what the terms of each margin leave of it within the limits, as a share of its rest.

    The largest magnitude of each term, summed: exact where the box is symmetric and the columns independent.
    """
    values, reach = {e.name: abs(e.value) for e in d.table}, d.box.reach()
    return {
        m.column: 1 - sum(values[e] * prod(reach[c] for c in own) for e, own in m.terms) / values[m.rest]
        for m in d.margins
    }


def pose_bounds(d: Decoupler, digits: int = 24) -> Bounds:
    """Return the bounds of one table, by interval arithmetic on the printed expressions."""
    if d.bounded is None:
        found = _enclosed(d, d.steps, digits)[-len(d.pose) :]
    else:
        found = list(d.bounded(digits).values())
    return Bounds(
        low=dict(zip(d.pose, (e.low for e in found), strict=True)),
        high=dict(zip(d.pose, (e.high for e in found), strict=True)),
        error=dict(zip(d.pose, (e.error for e in found), strict=True)),
        least_gain=least_gains(d),
    )


def step_errors(d: Decoupler, steps: Sequence[Step], digits: int = 24) -> list[float]:
    """Return how far each computed step can be from its expression, over the box, table included."""
    return [float(e.error) for e in _enclosed(d, steps, digits)]


FOLDED = 16
"""Rounding of a table entry as it is computed in double from the parameters, in units of its last place.

Entries are sums of a few products of the inverse of a well-conditioned matrix; the largest seen is 4."""


def _entry(value: float, digits: int) -> Enclosure:
    """Return the enclosure of a table entry: rounded where it is computed and where it is stored."""
    stored = constant(value, digits)
    return replace(stored, error=stored.error + FOLDED * 2.0**-53 * abs(value))


def _enclosed(d: Decoupler, steps: Sequence[Step], digits: int) -> list[Enclosure]:
    dtype = np.float32 if digits == 24 else np.float64
    given = {d.symbols[c].name(): Enclosure(*(float(dtype(v)) for v in d.ends(c))) for c in d.inputs} | {
        d.symbols[e.name].name(): _entry(e.value, digits) for e in (*d.table, *d.offsets)
    }
    for step in steps:
        (given[step.name],) = enclose([step.expression], given, digits)
    return [given[step.name] for step in steps]


# -- rounding of one pose after the other, where intervals over the box relate too little --------------------

BOUNDED = 1000
"""Poses for which the rounding is bounded, one by one."""
ROOM = 1.5
"""Times the largest bound of these poses."""


@dataclass(frozen=True, eq=False)
class PoseByPose:
    """Digits of the significand -> range and rounding of each coordinate, flags clear, offsets at zero.

    Rounding is bounded for each of many poses, and the largest bound is taken with some room.
    """

    pose: tuple[str, ...]
    inputs: tuple[str, ...]
    steps: tuple[Step, ...]
    table: tuple[Entry, ...]
    drawn: Callable[[np.random.Generator, int], np.ndarray]
    """Random inputs (n_inputs, s) of poses in the box."""

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each coordinate."""
        entries = {e.name: e.value for e in self.table} | {f"zero_{short(c)}": 0.0 for c in self.pose}
        inputs = self.drawn(np.random.default_rng(6), BOUNDED)
        named = dict(zip(map(short, self.inputs), inputs, strict=True))
        values, errors = rounding(self.steps, named, entries, digits, len(self.pose))
        ends = (values.min(axis=1), values.max(axis=1), ROOM * errors.max(axis=1))
        return {c: Enclosure(*map(float, e)) for c, *e in zip(self.pose, *ends, strict=True)}


Numbers = dict[str, Any]

_SLOPES: dict[str, Callable[..., tuple]] = {
    "assign": lambda z, x: (1.0,),
    "neg": lambda z, x: (-1.0,),
    "twice": lambda z, x: (2.0,),
    "fabs": lambda z, x: (np.sign(x),),
    "lt": lambda z, x, y: (0.0, 0.0),
    "le": lambda z, x, y: (0.0, 0.0),
    "not": lambda z, x: (0.0,),
    "if_else_zero": lambda z, c, x: (0.0, (c != 0) * 1.0),
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
    graphs = [graph([step.expression]) for step in steps]
    worked = []
    for step, own in zip(steps, graphs, strict=True):
        with np.errstate(all="ignore"):
            worked.append(computed(own, known))
            known[step.name] = of_step(step, own, worked[-1])
    count = len(next(iter(inputs.values())))
    errors = []
    for step in steps[-last:]:
        adjoint: Numbers = {step.name: np.ones(count)}
        total = np.zeros(count)
        for one, own, values in zip(reversed(steps), reversed(graphs), reversed(worked), strict=True):
            if one.name in adjoint and not isinstance(one, Whole):
                total = total + _back(own, values, adjoint.pop(one.name), adjoint, digits)
        for name, value in entries.items():
            total = total + np.abs(adjoint.get(name, 0.0)) * constant(value, digits).error
        errors.append(total)
    return np.array([np.broadcast_to(known[s.name], count) for s in steps[-last:]]), np.array(errors)


def _back(own: Graph, values: list[Any], by: np.ndarray, adjoint: Numbers, digits: int) -> np.ndarray:
    """Add the derivatives by the symbols of a step, whose own is `by`; returns what its operations round."""
    slopes: list[Any] = [0.0] * len(values)
    slopes[own.results[0]] = by
    total = np.zeros_like(by)
    for k in reversed(range(len(values))):
        o, z, slope = own.operations[k], values[k], slopes[k]
        if o.op == "input":
            adjoint[o.symbol] = adjoint.get(o.symbol, 0.0) + slope
            continue
        total = total + np.abs(slope) * _rounded(o, z, digits)
        if o.op != "const":
            for j, own_slope in zip(o.args, _SLOPES[o.op](z, *(values[a] for a in o.args)), strict=True):
                slopes[j] = slopes[j] + slope * own_slope
    return np.asarray(total)


def _rounded(operation: Operation, value: Any, digits: int) -> Any:
    """Bound of what an operation is off by where its arguments are exact; of a number, as it is stored."""
    if operation.op == "const":
        return constant(value, digits).error
    return 0.0 if operation.op in EXACT else 2.0**-digits * np.abs(value) + TINY[digits]
