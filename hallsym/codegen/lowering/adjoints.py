"""Errors of steps to first order, pose by pose: what each operation's rounding makes of the pose.

Intervals take the errors of two numbers as independent, and bound little where both come from the same ones,
as where weights multiply readings and what they are compared with. Here the derivative of the pose by the
result of each operation (reverse mode) multiplies that operation's rounding, and the products are summed
(Higham, Accuracy and Stability of Numerical Algorithms, 2.2 and 3.2).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.codegen.decoupler import Step, Whole
from hallsym.codegen.intervals import TINY, constant
from hallsym.codegen.operations import Graph, Operation, graph

EXACT = ("assign", "neg", "twice", "fabs", "lt", "le", "not", "if_else_zero")
"""Operations that do not round."""

Values = dict[str, Any]

_VALUES: dict[str, Callable[..., Any]] = {
    "assign": lambda x: x,
    "neg": lambda x: -x,
    "twice": lambda x: 2 * x,
    "fabs": np.abs,
    "lt": lambda x, y: (x < y) * 1.0,
    "le": lambda x, y: (x <= y) * 1.0,
    "not": lambda x: (x == 0) * 1.0,
    "if_else_zero": lambda c, x: np.where(c != 0, x, 0.0),
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "inv": lambda x: 1 / x,
    "sq": lambda x: x * x,
}
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
"""Derivatives by the arguments of an operation with result z; choices are between values equal where they
turn."""


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
    known: Values = {**inputs, **entries}
    graphs = [graph([step.expression]) for step in steps]
    worked = []
    for step, own in zip(steps, graphs, strict=True):
        values = _run(own, known)
        worked.append(values)
        result = values[own.results[0]]
        known[step.name] = np.floor(result) if isinstance(step, Whole) else result
    count = len(next(iter(inputs.values())))
    errors = []
    for step in steps[-last:]:
        adjoint: Values = {step.name: np.ones(count)}
        total = np.zeros(count)
        for one, own, values in zip(reversed(steps), reversed(graphs), reversed(worked), strict=True):
            if one.name in adjoint and not isinstance(one, Whole):
                total = total + _back(own, values, adjoint.pop(one.name), adjoint, digits)
        for name, value in entries.items():
            total = total + np.abs(adjoint.get(name, 0.0)) * constant(value, digits).error
        errors.append(total)
    return np.array([np.broadcast_to(known[s.name], count) for s in steps[-last:]]), np.array(errors)


def _run(own: Graph, known: Values) -> list[Any]:
    values: list[Any] = []
    with np.errstate(all="ignore"):
        for o in own.operations:
            if o.op == "input":
                values.append(known[o.symbol])
            elif o.op == "const":
                values.append(o.value)
            else:
                values.append(_VALUES[o.op](*(values[k] for k in o.args)))
    return values


def _back(own: Graph, values: list[Any], by: np.ndarray, adjoint: Values, digits: int) -> np.ndarray:
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
