"""Ranges and rounding errors of an SX graph: our own interval argument for the generated arithmetic.

Each node carries an enclosure of its exact value and a bound of |computed - exact|. One rounding to nearest
adds at most u |z| (u = 2^-24 in float32), and the smallest subnormal where a result underflows (IEEE 754).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.errors import InputError

TINY = {24: 2.0**-149, 53: 2.0**-1074}


@dataclass(frozen=True)
class Enclosure:
    """Exact value within [low, high]; the computed one differs by at most `error`."""

    low: float
    high: float
    error: float = 0.0

    @property
    def most(self) -> float:
        """Largest magnitude that the computed value can have."""
        return max(abs(self.low), abs(self.high)) + self.error


UNBOUNDED = Enclosure(-np.inf, np.inf, np.inf)
_BRANCHES = (ca.OP_FABS, ca.OP_SIGN, ca.OP_NOT, ca.OP_LT, ca.OP_LE, ca.OP_IF_ELSE_ZERO)


def enclose(function: ca.Function, inputs: Sequence[Enclosure], digits: int = 24) -> list[Enclosure]:
    """Return the enclosures of the outputs of an SX function of scalars, `digits` bits of significand.

    `inputs`: one per scalar input, with the rounding error that it has already.
    """
    work: dict[int, Enclosure] = {}
    out: list[Enclosure] = [Enclosure(0.0, 0.0)] * function.n_out()
    for k in range(function.n_instructions()):
        code, i, o = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_CONST:
            value = function.instruction_constant(k)
            stored = float(np.float32(value)) if digits == 24 else value
            work[o[0]] = Enclosure(value, value, abs(value - stored))
        elif code == ca.OP_INPUT:
            work[o[0]] = inputs[i[0]]
        elif code == ca.OP_OUTPUT:
            out[o[0]] = work[i[0]]
        else:
            work[o[0]] = _apply(code, [work[j] for j in i], digits)
    return out


def _apply(code: int, a: list[Enclosure], digits: int) -> Enclosure:
    if not all(np.isfinite(v.most) for v in a):
        return UNBOUNDED
    if code in _BRANCHES:
        return _branch(code, a)
    if code == ca.OP_NEG:
        return Enclosure(-a[0].high, -a[0].low, a[0].error)
    if code in (ca.OP_FMIN, ca.OP_FMAX):
        pick = min if code == ca.OP_FMIN else max
        return Enclosure(pick(a[0].low, a[1].low), pick(a[0].high, a[1].high), max(a[0].error, a[1].error))
    if code == ca.OP_SQ:
        ends = sorted((a[0].low * a[0].low, a[0].high * a[0].high))
        low = 0.0 if a[0].low <= 0 <= a[0].high else ends[0]
        return _rounded(low, ends[1], a[0].error * (2 * a[0].most + a[0].error), digits)
    if code == ca.OP_TWICE:
        return Enclosure(2 * a[0].low, 2 * a[0].high, 2 * a[0].error)
    if code == ca.OP_INV:
        return _apply(ca.OP_DIV, [Enclosure(1.0, 1.0), a[0]], digits)
    x, y = a
    if code == ca.OP_ADD:
        return _rounded(x.low + y.low, x.high + y.high, x.error + y.error, digits)
    if code == ca.OP_SUB:
        return _rounded(x.low - y.high, x.high - y.low, x.error + y.error, digits)
    if code == ca.OP_MUL:
        ends = [p * q for p in (x.low, x.high) for q in (y.low, y.high)]
        return _rounded(min(ends), max(ends), x.error * y.most + y.error * x.most, digits)
    if code == ca.OP_DIV:
        if y.low - y.error <= 0 <= y.high + y.error:
            return UNBOUNDED
        ends = [p / q for p in (x.low, x.high) for q in (y.low, y.high)]
        least = min(abs(y.low), abs(y.high)) - y.error
        error = (x.error + max(map(abs, ends)) * y.error) / least
        return _rounded(min(ends), max(ends), error, digits)
    raise InputError(f"Operation {code} of the model has no C without libm.")


def _branch(code: int, a: list[Enclosure]) -> Enclosure:
    """Comparisons (1 or 0) and what hangs on them; a comparison that rounding can turn has error 1."""
    if code == ca.OP_FABS:
        most = max(abs(a[0].low), abs(a[0].high))
        low = 0.0 if a[0].low <= 0 <= a[0].high else min(abs(a[0].low), abs(a[0].high))
        return Enclosure(low, most, a[0].error)
    if code == ca.OP_SIGN:
        sure = a[0].low - a[0].error > 0 or a[0].high + a[0].error < 0
        low, high = float(np.sign(a[0].low)), float(np.sign(a[0].high))
        return Enclosure(low, high, 0.0 if sure or not a[0].error else 2.0)
    if code == ca.OP_NOT:
        return Enclosure(1 - a[0].high, 1 - a[0].low, a[0].error)
    x, y = a
    if code == ca.OP_IF_ELSE_ZERO:
        if x.low == x.high and not x.error:
            return y if x.low else Enclosure(0.0, 0.0)
        return Enclosure(min(y.low, 0.0), max(y.high, 0.0), y.most if x.error else y.error)
    room = x.error + y.error
    if x.high + room < y.low:
        return Enclosure(1.0, 1.0)
    if x.low - room > y.high:
        return Enclosure(0.0, 0.0)
    return Enclosure(0.0, 1.0, 1.0 if room else 0.0)


def _rounded(low: float, high: float, error: float, digits: int) -> Enclosure:
    most = max(abs(low), abs(high)) + error
    if not np.isfinite(most):
        return UNBOUNDED
    return Enclosure(low, high, error + most * 2.0**-digits + TINY[digits])
