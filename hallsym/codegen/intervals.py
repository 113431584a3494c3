"""Ranges of an SX graph by interval arithmetic, on many intervals at once.

Each operation gets an enclosure of its exact value, rounded outwards. A comparison that an interval does not
decide is either, so the derivative of `fmin` at its kink is the hull of both sides.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import pi
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.operations import TESTS, Graph, Operation, graph
from hallsym.errors import InputError

ROUNDOFF, TINY = 2.0**-24, 2.0**-149
"""Of float32: largest relative error of one rounding to nearest, and the smallest subnormal number, which is
added where a result underflows (IEEE 754)."""
ULPS = 8 * np.finfo(float).eps
"""Relative widening of each end after an operation, more than any of numpy's functions is off by."""

Numbers = Any
"""A float, or one per interval (s,)."""
Range = tuple[Numbers, Numbers]


@dataclass(frozen=True, eq=False)
class Enclosure:
    """A value within [low, high]."""

    low: Numbers
    high: Numbers

    __array_ufunc__ = None  # arrays leave it to the arithmetic below

    def __abs__(self) -> Numbers:
        """Return the largest magnitude."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def __neg__(self) -> "Enclosure":
        """Return the range of -x."""
        return Enclosure(-self.high, -self.low)

    def __add__(self, other: "Enclosure | float") -> "Enclosure":
        """Return the range of a sum."""
        return _enclosed("add", [self, _ranged(other)])

    def __mul__(self, other: "Enclosure | float") -> "Enclosure":
        """Return the range of a product."""
        return _enclosed("mul", [self, _ranged(other)])

    def __truediv__(self, other: "Enclosure") -> "Enclosure":
        """Return the range of a quotient."""
        return _enclosed("div", [self, other])

    def __rtruediv__(self, other: float) -> "Enclosure":
        """Return the range of a number over this one."""
        return _enclosed("div", [_ranged(other), self])

    __radd__, __rmul__ = __add__, __mul__


def _ranged(value: "Enclosure | float") -> Enclosure:
    return value if isinstance(value, Enclosure) else Enclosure(value, value)


def enclose(expressions: Sequence[ca.SX], inputs: Mapping[str, Enclosure]) -> list[Enclosure]:
    """Return the enclosure of each scalar expression over enclosures of its symbols, by name.

    Raises `InputError` for an operation that has no range here.
    """
    found = graph(expressions)
    made = enclosures(found, inputs)
    return [made[k] for k in found.results]


def enclosures(
    found: Graph, inputs: Mapping[str, Enclosure], room: float = 0.0,
    decided: Mapping[int, Enclosure] | None = None,
) -> list[Enclosure]:  # fmt: skip
    """Return the enclosure of each operation of a graph; see `enclose`.

    `room`: share of itself by which each result may be off, so that ranges hold what is computed too;
    `decided`: outcomes of comparisons.
    """
    made: list[Enclosure] = []
    with np.errstate(all="ignore"):
        for number, operation in enumerate(found.operations):
            if decided and number in decided:
                made.append(decided[number])
            elif operation.op == "input":
                made.append(inputs[operation.symbol])
            elif operation.op == "const":
                made.append(_ranged(operation.value))
            elif other := _other(operation, found.operations):
                made.append(Enclosure(*_share(made[operation.args[0]], made[other])))
            else:
                made.append(_enclosed(operation.op, [made[k] for k in operation.args], room))
    return made


def _other(operation: Operation, operations: Sequence[Operation]) -> int | None:
    """The number of y where an operation is x / (x + y) of two comparisons: a derivative of fmin and fmax."""
    if operation.op != "div" or operations[operation.args[0]].op not in TESTS:
        return None
    x, total = operation.args[0], operations[operation.args[1]]
    if total.op != "add" or x not in total.args or any(operations[k].op not in TESTS for k in total.args):
        return None
    return total.args[1 - total.args.index(x)]


Outcomes = list[tuple[Any, list[Enclosure]]]
"""Where comparisons come out in one way (s,), and the enclosures of the operations there: of each way."""
NARROWED = 2
"""Times that what comparisons say of their arguments is taken back to the inputs: signs, then sizes."""


def outcomes(found: Graph, inputs: Mapping[str, Enclosure], room: float = 0.0) -> Outcomes:
    """Return the enclosures of each operation for each outcome of the comparisons, exact but for `room`.

    A comparison narrows its arguments, and the inputs that these are, so that x < y ? x : y is the lesser.
    """
    tests = [k for k, o in enumerate(found.operations) if o.op in TESTS]
    out: Outcomes = []
    for outcome in product((False, True), repeat=len(tests)):
        given: dict[str, Enclosure] = dict(inputs)
        possible: Any = np.True_
        decided = {k: Enclosure(np.float64(v), np.float64(v)) for k, v in zip(tests, outcome, strict=True)}
        for _ in range(NARROWED if tests else 0):
            made = enclosures(found, given, room, decided)
            for k, holds in zip(tests, outcome, strict=True):
                x, y = found.operations[k].args[:: 1 if holds else -1]
                made[x], made[y] = _meet(made[x], high=made[y].high), _meet(made[y], low=made[x].low)
            for o, size in zip(found.operations, made, strict=True):
                if o.op == "fabs":
                    (k,) = o.args
                    low = np.where(made[k].low >= 0, size.low, -size.high)
                    made[k] = _meet(made[k], low, np.where(made[k].high <= 0, -size.low, size.high))
            for o, e in zip(found.operations, made, strict=True):
                possible = possible & ~np.asarray(e.low > e.high)
                if o.op == "input":
                    given[o.symbol] = e
        out.append((possible, enclosures(found, given, room, decided)))
    return out


def _meet(e: Enclosure, low: Numbers = -np.inf, high: Numbers = np.inf) -> Enclosure:
    return Enclosure(np.maximum(e.low, low), np.minimum(e.high, high))


def hull(some: Sequence[tuple[Any, Any]]) -> Any:
    """Return the range of numbers or enclosures (s,), each where it is possible (s,)."""
    if len(some) == 1:
        return some[0][1]
    low = [np.where(possible, getattr(v, "low", v), np.inf) for possible, v in some]
    high = [np.where(possible, getattr(v, "high", v), -np.inf) for possible, v in some]
    return Enclosure(_hull(*low)[0], _hull(*high)[1])


def _enclosed(op: str, args: list[Enclosure], room: float = 0.0) -> Enclosure:
    if op not in _RANGES:
        raise InputError(f"Operation {op} of the model has no C without libm.")
    low, high = _RANGES[op](*args)
    if op not in EXACT:
        unknown = np.isnan(low) | np.isnan(high)
        low = np.where(unknown, -np.inf, low - ((ULPS + room) * np.abs(low) + (TINY if room else 1e-300)))
        high = np.where(unknown, np.inf, high + ((ULPS + room) * np.abs(high) + (TINY if room else 1e-300)))
    return Enclosure(low, high)


# -- ranges ------------------------------------------------------------------------------------------------


def _hull(*values: Numbers) -> Range:
    stacked = np.array(np.broadcast_arrays(*values))
    return stacked.min(axis=0), stacked.max(axis=0)


def _across(x: Enclosure) -> Numbers:
    return (x.low <= 0) & (x.high >= 0)


def _product(x: Enclosure, y: Enclosure) -> Range:
    return _hull(x.low * y.low, x.low * y.high, x.high * y.low, x.high * y.high)


def _inverse(x: Enclosure) -> Range:
    low, high = np.asarray(x.low, dtype=float), np.asarray(x.high, dtype=float)
    return np.where(_across(x), -np.inf, 1 / high), np.where(_across(x), np.inf, 1 / low)


def _quotient(x: Enclosure, y: Enclosure) -> Range:
    return _product(x, Enclosure(*_inverse(y)))


def _share(x: Enclosure, y: Enclosure) -> Range:
    """x / (x + y) of two comparisons that are not both false."""
    low, high = x.low / (x.low + y.high), x.high / (x.high + y.low)
    return np.where(np.isnan(low), 0.0, low), np.where(np.isnan(high), 1.0, high)


def _size(x: Enclosure) -> Range:
    low, high = _hull(np.abs(x.low), np.abs(x.high))
    return np.where(_across(x), 0.0, low), high


def _square(x: Enclosure) -> Range:
    low, high = _size(x)
    return low * low, high * high


def _wave(function: Callable[[Numbers], Numbers], peak: float) -> Callable[[Enclosure], Range]:
    """Sine or cosine: the ends, and 1 or -1 where a peak or a trough lies between them."""

    def within(x: Enclosure, at: float) -> Numbers:
        return np.floor((x.high - at) / (2 * pi) + 1e-12) >= np.ceil((x.low - at) / (2 * pi) - 1e-12)

    def found(x: Enclosure) -> Range:
        low, high = _hull(function(x.low), function(x.high))
        return np.where(within(x, peak + pi), -1.0, low), np.where(within(x, peak), 1.0, high)

    return found


def _growing(function: Callable[[Numbers], Numbers]) -> Callable[[Enclosure], Range]:
    return lambda x: (function(x.low), function(x.high))


def _arctangent(y: Enclosure, x: Enclosure) -> Range:
    """atan2: its corners; a whole turn where the cut may be crossed."""
    low, high = _hull(*(np.arctan2(b, a) for a in (x.low, x.high) for b in (y.low, y.high)))
    cut = (x.low <= 0) & _across(y)
    return np.where(cut, -pi, low), np.where(cut, pi, high)


def _power(x: Enclosure, n: Enclosure) -> Range:
    exponent = float(np.asarray(n.low).flat[0])
    if np.size(n.low) > 1 or exponent != int(exponent) or exponent < 1:
        return np.full_like(x.low, np.nan), np.full_like(x.high, np.nan)
    low, high = (x.low, x.high) if exponent % 2 else _size(x)
    return low**exponent, high**exponent


def _chosen(c: Enclosure, x: Enclosure) -> Range:
    never, always = (c.low == 0) & (c.high == 0), (c.low > 0) | (c.high < 0)
    low = np.where(never, 0.0, np.where(always, x.low, np.minimum(x.low, 0.0)))
    return low, np.where(never, 0.0, np.where(always, x.high, np.maximum(x.high, 0.0)))


_RANGES: dict[str, Callable[..., Range]] = {
    "assign": lambda x: (x.low, x.high),
    "neg": lambda x: (-x.high, -x.low),
    "twice": lambda x: (2 * x.low, 2 * x.high),
    "fabs": _size,
    "sign": lambda x: (np.sign(x.low), np.sign(x.high)),
    "fmin": lambda x, y: (np.minimum(x.low, y.low), np.minimum(x.high, y.high)),
    "fmax": lambda x, y: (np.maximum(x.low, y.low), np.maximum(x.high, y.high)),
    "lt": lambda x, y: (1.0 * (x.high < y.low), 1.0 * (x.low < y.high)),
    "le": lambda x, y: (1.0 * (x.high <= y.low), 1.0 * (x.low <= y.high)),
    "not": lambda x: (1.0 - x.high, 1.0 - x.low),
    "if_else_zero": _chosen,
    "add": lambda x, y: (x.low + y.low, x.high + y.high),
    "sub": lambda x, y: (x.low - y.high, x.high - y.low),
    "mul": _product,
    "div": _quotient,
    "inv": _inverse,
    "sq": _square,
    "sqrt": _growing(np.sqrt),
    "exp": _growing(np.exp),
    "log": _growing(np.log),
    "sinh": _growing(np.sinh),
    "cosh": lambda x: _growing(np.cosh)(Enclosure(*_size(x))),
    "asin": _growing(np.arcsin),
    "acos": lambda x: (np.arccos(x.high), np.arccos(x.low)),
    "tanh": _growing(np.tanh),
    "atan": _growing(np.arctan),
    "sin": _wave(np.sin, pi / 2),
    "cos": _wave(np.cos, 0.0),
    "atan2": _arctangent,
    "constpow": _power,
    "pow": _power,
}
EXACT = ("assign", "neg", "twice", "fabs", "sign", "fmin", "fmax", *TESTS, "not", "if_else_zero")
"""Operations that do not round."""
