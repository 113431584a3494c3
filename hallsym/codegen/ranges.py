"""Ranges of an SX function over many intervals at once: interval arithmetic on arrays, rounded outwards.

What `hallsym.codegen.intervals` does for the generated arithmetic, one number at a time with its rounding,
this does for a model's own expressions, sines too: one row of intervals through the whole graph. A comparison
that an interval does not decide is either, so the derivative of `fmin` at its kink is the hull of both sides.
"""

from collections.abc import Callable, Sequence
from math import pi

import casadi as ca
import numpy as np

from hallsym.errors import InputError

Range = tuple[np.ndarray, np.ndarray]
"""Least and greatest values, (s,) each."""
ULPS = 8 * np.finfo(float).eps
"""Relative widening after each operation, more than any of numpy's functions is off by."""


def ranges(function: ca.Function, inputs: Sequence[Range]) -> list[Range]:
    """Return the range of each output of an SX function of scalars over intervals (s,) of its inputs.

    Raises `InputError` for an operation whose range is not known here.
    """
    work: dict[int, Range] = {}
    shares: dict[int, tuple[Range, Range]] = {}
    """Slots that hold the sum of two comparisons, and the two."""
    tests: dict[int, Range] = {}
    out: list[Range] = [(np.zeros(1), np.zeros(1))] * function.n_out()
    for k in range(function.n_instructions()):
        code, i, o = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_CONST:
            value = np.array([function.instruction_constant(k)])
            work[o[0]] = (value, value)
        elif code == ca.OP_INPUT:
            work[o[0]] = inputs[i[0]]
        elif code == ca.OP_OUTPUT:
            out[o[0]] = work[i[0]]
        elif code == ca.OP_DIV and i[1] in shares and i[0] in tests:
            work[o[0]] = _share(*shares[i[1]])
        elif code in _EXACT:
            work[o[0]] = _EXACT[code](*(work[j] for j in i))
        elif code in _ROUNDED:
            with np.errstate(all="ignore"):
                low, high = _ROUNDED[code](*(work[j] for j in i))
            room = ULPS * np.maximum(np.abs(low), np.abs(high)) + 1e-300
            bad = np.isnan(low) | np.isnan(high)
            work[o[0]] = (np.where(bad, -np.inf, low - room), np.where(bad, np.inf, high + room))
        else:
            raise InputError(f"The range of operation {code} of the model is not known; C is not generated.")
        if code == ca.OP_OUTPUT:
            continue
        both = tuple(tests[j] for j in i if j in tests) if code == ca.OP_ADD else ()
        for memory in (shares, tests):
            memory.pop(o[0], None)
        if len(both) == 2:
            shares[o[0]] = (both[0], both[1])
        if code in (ca.OP_LE, ca.OP_LT):
            tests[o[0]] = work[o[0]]
    return out


def _share(x: Range, y: Range) -> Range:
    """x / (x + y) of two comparisons that are not both false: CasADi's derivative of fmin and fmax."""
    with np.errstate(all="ignore"):
        low, high = x[0] / (x[0] + y[1]), x[1] / (x[1] + y[0])
    return np.where(np.isnan(low), 0.0, low), np.where(np.isnan(high), 1.0, high)


def _hull(*values: np.ndarray) -> Range:
    stacked = np.array(np.broadcast_arrays(*values))
    return stacked.min(axis=0), stacked.max(axis=0)


def _product(x: Range, y: Range) -> Range:
    return _hull(x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1])


def _inverse(x: Range) -> Range:
    across = (x[0] <= 0) & (x[1] >= 0)
    return np.where(across, -np.inf, 1 / x[1]), np.where(across, np.inf, 1 / x[0])


def _size(x: Range) -> Range:
    low, high = _hull(np.abs(x[0]), np.abs(x[1]))
    return np.where((x[0] <= 0) & (x[1] >= 0), 0.0, low), high


def _square(x: Range) -> Range:
    low, high = _size(x)
    return low * low, high * high


def _wave(function: Callable[[np.ndarray], np.ndarray], peak: float) -> Callable[[Range], Range]:
    """Sine or cosine: the ends, and 1 or -1 where a peak or a trough lies between them."""

    def within(x: Range, at: float) -> np.ndarray:
        return np.floor((x[1] - at) / (2 * pi) + 1e-12) >= np.ceil((x[0] - at) / (2 * pi) - 1e-12)

    def found(x: Range) -> Range:
        low, high = _hull(function(x[0]), function(x[1]))
        return np.where(within(x, peak + pi), -1.0, low), np.where(within(x, peak), 1.0, high)

    return found


def _growing(function: Callable[[np.ndarray], np.ndarray]) -> Callable[[Range], Range]:
    return lambda x: (function(x[0]), function(x[1]))


def _arctangent(y: Range, x: Range) -> Range:
    """atan2: its corners; a whole turn where the cut may be crossed."""
    low, high = _hull(*(np.arctan2(b, a) for a in x for b in y))
    cut = (x[0] <= 0) & (y[0] <= 0) & (y[1] >= 0)
    return np.where(cut, -pi, low), np.where(cut, pi, high)


def _power(x: Range, n: Range) -> Range:
    exponent = float(n[0].flat[0])
    if n[0].size > 1 or exponent != int(exponent) or exponent < 1:
        return np.full_like(x[0], np.nan), np.full_like(x[0], np.nan)
    if exponent % 2:
        return x[0] ** exponent, x[1] ** exponent
    low, high = _size(x)
    return low**exponent, high**exponent


def _less(x: Range, y: Range, or_equal: bool) -> Range:
    sure = x[1] <= y[0] if or_equal else x[1] < y[0]
    never = x[0] > y[1] if or_equal else x[0] >= y[1]
    return np.where(sure, 1.0, 0.0), np.where(never, 0.0, 1.0)


def _chosen(c: Range, x: Range) -> Range:
    never, always = (c[0] == 0) & (c[1] == 0), (c[0] > 0) | (c[1] < 0)
    low = np.where(never, 0.0, np.where(always, x[0], np.minimum(x[0], 0.0)))
    return low, np.where(never, 0.0, np.where(always, x[1], np.maximum(x[1], 0.0)))


_EXACT: dict[int, Callable[..., Range]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_NEG: lambda x: (-x[1], -x[0]),
    ca.OP_TWICE: lambda x: (2 * x[0], 2 * x[1]),
    ca.OP_FABS: _size,
    ca.OP_SIGN: lambda x: (np.sign(x[0]), np.sign(x[1])),
    ca.OP_FMIN: lambda x, y: (np.minimum(x[0], y[0]), np.minimum(x[1], y[1])),
    ca.OP_FMAX: lambda x, y: (np.maximum(x[0], y[0]), np.maximum(x[1], y[1])),
    ca.OP_LT: lambda x, y: _less(x, y, False),
    ca.OP_LE: lambda x, y: _less(x, y, True),
    ca.OP_NOT: lambda x: (np.where((x[0] == 0) & (x[1] == 0), 1.0, 0.0),
                          np.where((x[0] > 0) | (x[1] < 0), 0.0, 1.0)),
    ca.OP_IF_ELSE_ZERO: _chosen,
}  # fmt: skip
_ROUNDED: dict[int, Callable[..., Range]] = {
    ca.OP_ADD: lambda x, y: (x[0] + y[0], x[1] + y[1]),
    ca.OP_SUB: lambda x, y: (x[0] - y[1], x[1] - y[0]),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda x, y: _product(x, _inverse(y)),
    ca.OP_INV: _inverse,
    ca.OP_SQ: _square,
    ca.OP_SQRT: _growing(np.sqrt),
    ca.OP_EXP: _growing(np.exp),
    ca.OP_TANH: _growing(np.tanh),
    ca.OP_ATAN: _growing(np.arctan),
    ca.OP_SIN: _wave(np.sin, pi / 2),
    ca.OP_COS: _wave(np.cos, 0.0),
    ca.OP_ATAN2: _arctangent,
    ca.OP_CONSTPOW: _power,
    ca.OP_POW: _power,
}
