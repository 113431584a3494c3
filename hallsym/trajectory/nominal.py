"""The curve as it should be, given by expressions: "x = r*(t - sin(t)); y = r*(1 - cos(t))".

Names, numbers, + - * / ** and the functions below, nothing else. The same expressions are evaluated in
numbers and, for bounds, in power series whose coefficients are balls.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest, require
from hallsym.files import MOST_NUMBER
from hallsym.units import with_unit

Array = np.ndarray
COORDINATES = {"x": "x_m", "y": "y_m", "z": "z_m", "rx": "rx_rad", "ry": "ry_rad", "rz": "rz_rad"}
CONSTANTS = {"pi": math.pi, "e": math.e}
FUNCTIONS: dict[str, Callable] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
}  # fmt: skip
_OF_SERIES: dict[str, Callable[[Any], Any]] = {
    "sinh": lambda x: (x.exp() - (-x).exp()) / 2,
    "cosh": lambda x: (x.exp() + (-x).exp()) / 2,
    "tanh": lambda x: 1 - 2 / ((2 * x).exp() + 1),
}
_BINARY: dict[type, Callable] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b, ast.Pow: lambda a, b: a**b,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Nominal:
    """A curve given by expressions in one parameter on [start, stop]; SI units."""

    statements: Mapping[str, ast.expr]
    coordinates: tuple[str, ...]
    start: float
    stop: float
    text: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
    parameter: str = "t"

    def __call__(self, t: Array) -> Array:
        """Return points (len(t), d); refuses parameters where the curve is not a number."""
        t = np.asarray(t, float)
        with np.errstate(all="ignore"):
            found = self._evaluate(t, np.float64, lambda name, x: FUNCTIONS[name](x))
        points = np.array([np.broadcast_to(p, t.shape) for p in found]).T
        good = np.abs(points) <= MOST_NUMBER
        if not good.all():
            row, k = np.argwhere(~good)[0]
            raise InputError(
                f"The curve's {self.coordinates[k][: self.coordinates[k].rindex('_')]} is not a finite "
                f"number at {self.parameter} = {t[row]:.9g}; change the expression or its range."
            )
        return points

    def series(self, t: Any) -> list[Any]:
        """Return the coordinates as power series of balls for the parameter as one (flint.arb_series).

        Raises ValueError or ZeroDivisionError where a divisor may be 0.
        """
        from flint import arb_series

        def call(name: str, x: Any) -> Any:
            return _OF_SERIES[name](x) if name in _OF_SERIES else getattr(x, name)()

        return self._evaluate(t, lambda value: arb_series([value]), call)

    def _evaluate(self, t: Any, number: Callable[[float], Any], call: Callable[[str, Any], Any]) -> list[Any]:
        names = {name: number(value) for name, value in (CONSTANTS | dict(self.values)).items()}
        names[self.parameter] = t
        for name, node in self.statements.items():
            names[name] = _value(node, names, number, call)
        return [names[c.rpartition("_")[0]] for c in self.coordinates]


def nominal(text: str, span: tuple[str, str, str], values: Mapping[str, float] | None = None) -> Nominal:
    """Return the curve that `text` states over `span`, the parameter's name and its first and last value.

    `text`: assignments separated by ";" or line breaks; x, y, z are lengths in m, rx, ry, rz angles in rad,
    any other name is a helper for the lines after it. Raises `InputError` for whatever else it holds.
    """
    name, numbers = span[0], CONSTANTS | dict(values or {})
    if name in numbers or name in FUNCTIONS or name in COORDINATES or not name.isidentifier():
        raise InputError(f"The parameter of the curve cannot be called {name!r}; call it t.")
    ends = [_number(end, numbers) for end in span[1:]]
    good = np.isfinite(ends).all() and ends[0] < ends[1]
    require(good, f"The range of {name}", "from the lesser to the greater number", f"{span[1]}:{span[2]}")
    known, used, statements = {*numbers, name}, set[str](), dict[str, ast.expr]()
    for statement in filter(None, (part.strip() for part in text.replace("\n", ";").split(";"))):
        left, sign, right = statement.partition("=")
        left = left.strip()
        if not sign or not left.isidentifier():
            raise InputError(f"Each part of a curve must be like 'x = r*cos(t)'; got {shortened(statement)}.")
        if left in known or left in FUNCTIONS:
            raise InputError(f"The curve gives {left!r} a value twice, or one that it already has.")
        statements[left] = _parsed(right.strip(), known)
        used |= {node.id for node in ast.walk(statements[left]) if isinstance(node, ast.Name)}
        known.add(left)
    unused = [key for key in {**(values or {}), **statements} if key not in used and key not in COORDINATES]
    if unused:
        raise InputError(f"Value {unused[0]!r} is not used by the curve; take it out or correct its name.")
    coordinates = tuple(c for key, c in COORDINATES.items() if key in statements)
    if not any(c.endswith("_m") for c in coordinates):
        raise InputError(
            "A curve must give at least one of x, y and z, such as 'x = r*cos(t); y = r*sin(t)'."
        )
    return Nominal(statements, coordinates, ends[0], ends[1], text.strip(), dict(values or {}), name)


def read_value(text: str) -> tuple[str, float]:
    """Return name and SI value of `r=1mm` or `n=2*pi`."""
    name, sign, value = text.partition("=")
    name = name.strip()
    good = sign and name.isidentifier() and value.strip()
    require(good, "--value", "NAME=NUMBER with a unit or none, such as r=1mm", text)
    if name in CONSTANTS or name in FUNCTIONS or name in COORDINATES:
        raise InputError(f"A value cannot be called {name!r}: the name is taken.")
    return name, _number(value, CONSTANTS)


def read_span(text: str) -> tuple[str, str, str]:
    """Return the parts of `t=0:2*pi`."""
    name, sign, ends = text.partition("=")
    first, colon, last = ends.partition(":")
    good = sign and colon and name.strip() and first.strip() and last.strip()
    require(good, "--range", "PARAMETER=FIRST:LAST, such as t=0:2*pi", text)
    return name.strip(), first.strip(), last.strip()


def shortened(text: str) -> str:
    """Return the text in quotes, cut to what fits into a sentence."""
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


def _number(text: str, known: Mapping[str, float]) -> float:
    value = with_unit(text)
    if value is not None:
        return value[0]
    names = {key: np.float64(v) for key, v in known.items()}
    with np.errstate(all="ignore"):
        return float(_value(_parsed(text, known), names, np.float64, lambda name, x: FUNCTIONS[name](x)))


def _parsed(text: str, known: Mapping[str, float] | set[str]) -> ast.expr:
    """Return the tree of an expression that holds nothing but what `_value` evaluates."""
    if len(text) > 10_000:
        raise InputError("An expression of a curve may have at most 10000 characters.")
    if "^" in text:
        raise InputError(f"Write ** for a power, not ^, in {shortened(text)}.")
    try:
        tree = ast.parse(text, mode="eval").body
        with np.errstate(all="ignore"):
            _value(tree, dict.fromkeys(known, np.float64(1)), np.float64, lambda _, x: x, text)
    except (SyntaxError, RecursionError, MemoryError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{shortened(text)} is not an expression such as 'r*(t - sin(t))'.") from None
    return tree


def _value(
    node: ast.expr,
    names: Mapping[str, Any],
    number: Callable[[float], Any],
    call: Callable[[str, Any], Any],
    text: str = "",
) -> Any:
    """Return the value of an expression; refuses what is none (`text` is quoted)."""

    def of(part: ast.expr) -> Any:
        return _value(part, names, number, call, text)

    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return number(float(value))
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.Name(id=name):
            hint = f"; give it with --value {name}=..." if name.isidentifier() else ""
            raise InputError(
                f"Name {name!r} in {shortened(text)} is not known{nearest(name, [*names])}{hint}."
            )
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](of(left), of(right))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -of(operand)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return of(operand)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return call(name, of(argument))
        case ast.Call(func=ast.Name(id=name)):
            listed = ", ".join(FUNCTIONS)
            raise InputError(
                f"Function {name!r} with these arguments is not known{nearest(name, [*FUNCTIONS])}; "
                f"known, of one argument: {listed}."
            )
    raise InputError(
        f"{shortened(text)} may hold only numbers, names, + - * / **, brackets and functions of one argument."
    )
