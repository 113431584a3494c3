"""What can be said of the arithmetic over the whole box: least gains, size of the pose, rounding."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Decoupler, Step, short
from hallsym.codegen.intervals import Enclosure, constant, enclose

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


def spreads(d: Decoupler) -> list[Step]:
    """Return `spread_k`, how far the rest of each margin can move within the limits.

    The largest magnitude of each term, summed: exact where the box is symmetric and the columns independent.
    """
    symbols = {e.name: d.symbols.get(e.name, ca.SX.sym(e.name)) for e in d.entries}
    steps = []
    for margin in d.margins:
        total = ca.SX(0)
        for entry, columns in margin.terms:
            c = symbols[entry]
            total = total + ca.fmax(c, -c) * _reach(d, symbols, columns)
        steps.append(Step(f"spread_{short(margin.column)}", total))
    return steps


def _reach(d: Decoupler, symbols: Mapping[str, ca.SX], columns: Sequence[str]) -> ca.SX:
    most = ca.SX(1)
    for column in columns:
        name = short(column)
        if d.box.symmetric(column):
            most = most * symbols[f"limit_{name}"]
        else:
            most = most * ca.fmax(-symbols[f"low_{name}"], symbols[f"high_{name}"])
    return most


def pose_bounds(d: Decoupler, digits: int = 24) -> Bounds:
    """Return the bounds of one table, by interval arithmetic on the printed expressions."""
    if d.bounded is None:
        found = _enclosed(d, d.steps, digits)[-len(d.pose) :]
    else:
        found = list(d.bounded(digits).values())
    values = {e.name: e.value for e in d.entries}
    least = {}
    for step, margin in zip(spreads(d), d.margins, strict=True):
        symbols = ca.symvar(step.expression)
        f = ca.Function("spread", symbols, [step.expression])
        spread = float(f(*(values[s.name()] for s in symbols))) if symbols else float(step.expression)
        least[margin.column] = 1 - spread / abs(values[margin.rest])
    return Bounds(
        low=dict(zip(d.pose, (e.low for e in found), strict=True)),
        high=dict(zip(d.pose, (e.high for e in found), strict=True)),
        error=dict(zip(d.pose, (e.error for e in found), strict=True)),
        least_gain=least,
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
        d.symbols[e.name].name(): _entry(e.value, digits) for e in (*d.table, *d.zeros)
    }
    for step in steps:
        (given[step.name],) = enclose([step.expression], given, digits)
    return [given[step.name] for step in steps]
