"""The curve as it should be, given by expressions: "x = r*(t - sin(t)); y = r*(1 - cos(t))".

Text becomes CasADi expressions: names, numbers, + - * / ** and the functions below, nothing else. Evaluating
it over intervals gives what its derivatives can be between two parameters.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.trajectory import jets
from hallsym.trajectory.intervals import Interval
from hallsym.trajectory.jets import Jet
from hallsym.units import with_unit

Array = np.ndarray
COORDINATES = {"x": "x_m", "y": "y_m", "z": "z_m", "rx": "rx_rad", "ry": "ry_rad", "rz": "rz_rad"}
CONSTANTS = {"pi": math.pi, "e": math.e}
FUNCTIONS: dict[str, Callable[[ca.SX], ca.SX]] = {
    name: getattr(ca, name)
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt")
}
_BINARY: dict[type, Callable] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b, ast.Pow: lambda a, b: a**b,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Nominal:
    """A curve given by expressions in one parameter on [start, stop]; SI units."""

    function: ca.Function
    coordinates: tuple[str, ...]
    start: float
    stop: float
    text: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
    parameter: str = "t"

    def __call__(self, t: Array) -> Array:
        """Return points (len(t), d); refuses parameters where the curve is not a number."""
        t = np.asarray(t, float)
        points = np.asarray(self.function(t.reshape(1, -1)), float).T
        if not np.isfinite(points).all():
            row, k = np.argwhere(~np.isfinite(points))[0]
            raise InputError(
                f"The curve's {self.coordinates[k][: self.coordinates[k].rindex('_')]} is not a finite "
                f"number at {self.parameter} = {t[row]:.9g}; change the expression or its range."
            )
        return points

    def taylor(self, t: Interval, order: int) -> list[list[Interval]]:
        """Return the Taylor coefficients 0 .. order of each coordinate over intervals of the parameter."""
        return [list(jet.terms) for jet in _walk(self.function, Jet.variable(t, order))]


def nominal(text: str, span: tuple[str, str, str], values: Mapping[str, float] | None = None) -> Nominal:
    """Return the curve that `text` states over `span`, the parameter's name and its first and last value.

    `text`: assignments separated by ";" or line breaks; x, y, z are lengths in m, rx, ry, rz angles in rad,
    any other name is a helper for the lines after it. Raises `InputError` for whatever else it holds.
    """
    name, numbers = span[0], dict(CONSTANTS) | dict(values or {})
    if name in numbers or name in FUNCTIONS or name in COORDINATES or not name.isidentifier():
        raise InputError(f"The parameter of the curve cannot be called {name!r}; call it t.")
    ends = [_number(end, numbers) for end in span[1:]]
    if not (np.isfinite(ends).all() and ends[0] < ends[1]):
        raise InputError(
            f"The range of {name} must go from the lesser to the greater number; instead received "
            f"{span[1]}:{span[2]}."
        )
    parameter = ca.SX.sym(name)
    known: dict[str, ca.SX] = {key: ca.SX(value) for key, value in numbers.items()} | {name: parameter}
    assigned: dict[str, ca.SX] = {}
    used: set[str] = set()
    for statement in filter(None, (part.strip() for part in text.replace("\n", ";").split(";"))):
        left, sign, right = statement.partition("=")
        left = left.strip()
        if not sign or not left.isidentifier():
            raise InputError(f"Each part of a curve must be like 'x = r*cos(t)'; got {shortened(statement)}.")
        if left in known or left in FUNCTIONS:
            raise InputError(f"The curve gives {left!r} a value twice, or one that it already has.")
        known[left] = assigned[left] = _expression(right.strip(), known, used)
    unused = [key for key in {**(values or {}), **assigned} if key not in used and key not in COORDINATES]
    if unused:
        raise InputError(f"Value {unused[0]!r} is not used by the curve; take it out or correct its name.")
    coordinates = [key for key in COORDINATES if key in assigned]
    if not {"x", "y", "z"} & set(coordinates):
        raise InputError(
            "A curve must give at least one of x, y and z, such as 'x = r*cos(t); y = r*sin(t)'."
        )
    function = ca.Function("curve", [parameter], [ca.vertcat(*(assigned[key] for key in coordinates))])
    named = tuple(COORDINATES[key] for key in coordinates)
    return Nominal(function, named, ends[0], ends[1], text.strip(), dict(values or {}), name)


def read_value(text: str) -> tuple[str, float]:
    """Return name and SI value of `r=1mm` or `n=2*pi`."""
    name, sign, value = text.partition("=")
    name = name.strip()
    if not sign or not name.isidentifier() or not value.strip():
        raise InputError(f"--value must be NAME=NUMBER with a unit or none, such as r=1mm; got {text!r}.")
    if name in CONSTANTS or name in FUNCTIONS or name in COORDINATES:
        raise InputError(f"A value cannot be called {name!r}: the name is taken.")
    return name, _number(value, CONSTANTS)


def read_span(text: str) -> tuple[str, str, str]:
    """Return the parts of `t=0:2*pi`."""
    name, sign, ends = text.partition("=")
    first, colon, last = ends.partition(":")
    if not (sign and colon and name.strip() and first.strip() and last.strip()):
        raise InputError(f"--range must be PARAMETER=FIRST:LAST, such as t=0:2*pi; got {text!r}.")
    return name.strip(), first.strip(), last.strip()


def shortened(text: str) -> str:
    """Return the text in quotes, cut to what fits into a sentence."""
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


def _number(text: str, known: Mapping[str, float]) -> float:
    value = with_unit(text)
    if value is not None:
        return value[0]
    return float(_expression(text, {key: ca.SX(v) for key, v in known.items()}, set()))


def _expression(text: str, known: Mapping[str, ca.SX], used: set[str]) -> ca.SX:
    """Return the CasADi expression of a text; names it uses are added to `used`."""
    if len(text) > 10_000:
        raise InputError("An expression of a curve may have at most 10000 characters.")
    if "^" in text:
        raise InputError(f"Write ** for a power, not ^, in {shortened(text)}.")
    try:
        return _build(ast.parse(text, mode="eval").body, known, used, text)
    except (SyntaxError, RecursionError, MemoryError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{shortened(text)} is not an expression such as 'r*(t - sin(t))'.") from None


def _build(node: ast.expr, known: Mapping[str, ca.SX], used: set[str], text: str) -> ca.SX:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return ca.SX(float(value))
        case ast.Name(id=name) if name in known:
            used.add(name)
            return known[name]
        case ast.Name(id=name):
            hint = f"; give it with --value {name}=..." if name.isidentifier() else ""
            raise InputError(
                f"Name {name!r} in {shortened(text)} is not known{nearest(name, [*known])}{hint}."
            )
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_build(left, known, used, text), _build(right, known, used, text))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_build(operand, known, used, text)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _build(operand, known, used, text)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](_build(argument, known, used, text))
        case ast.Call(func=ast.Name(id=name)):
            listed = ", ".join(FUNCTIONS)
            raise InputError(
                f"Function {name!r} with these arguments is not known{nearest(name, [*FUNCTIONS])}; "
                f"known, of one argument: {listed}."
            )
    raise InputError(
        f"{shortened(text)} may hold only numbers, names, + - * / **, brackets and functions of one argument."
    )


# -- Taylor coefficients of a CasADi function ------------------------------------------------------------

_ONE: dict[int, Callable[[Jet], Jet]] = {
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: a.constant(1.0) / a,
    ca.OP_SQRT: jets.sqrt,
    ca.OP_EXP: jets.exp,
    ca.OP_LOG: jets.log,
    ca.OP_SIN: lambda a: jets.sin_cos(a)[0],
    ca.OP_COS: lambda a: jets.sin_cos(a)[1],
    ca.OP_TAN: lambda a: reduce(lambda s, c: s / c, jets.sin_cos(a)),
    ca.OP_SINH: lambda a: jets.sinh_cosh(a)[0],
    ca.OP_COSH: lambda a: jets.sinh_cosh(a)[1],
    ca.OP_TANH: lambda a: reduce(lambda s, c: s / c, jets.sinh_cosh(a)),
    ca.OP_ATAN: jets.atan,
    ca.OP_ASIN: jets.asin,
    ca.OP_ACOS: lambda a: a.constant(math.pi / 2) - jets.asin(a),
    ca.OP_ASSIGN: lambda a: a,
}
_TWO: dict[int, Callable[[Jet, Jet], Jet]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
}


def _walk(function: ca.Function, t: Jet) -> list[Jet]:
    work: dict[int, Jet] = {}
    numbers: dict[int, float] = {}
    out: dict[int, Jet] = {}
    for k in range(function.n_instructions()):
        code, i, o = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_CONST:
            numbers[o[0]] = function.instruction_constant(k)
            work[o[0]] = t.constant(numbers[o[0]])
            continue
        if code == ca.OP_INPUT:
            result = t
        elif code == ca.OP_OUTPUT:
            out[o[1]] = work[i[0]]
            continue
        elif code in _ONE:
            result = _ONE[code](work[i[0]])
        elif code in _TWO:
            result = _TWO[code](work[i[0]], work[i[1]])
        elif code in (ca.OP_POW, ca.OP_CONSTPOW):
            base, exponent = work[i[0]], work[i[1]]
            whole = numbers.get(i[1])
            result = jets.exp(jets.log(base) * exponent) if whole is None else jets.power(base, whole)
        else:
            raise InputError("The curve holds an operation whose derivatives cannot be bounded.")
        work[o[0]] = result
        numbers.pop(o[0], None)
    zero = t.constant(0.0)
    return [out.get(k, zero) for k in range(function.numel_out(0))]
