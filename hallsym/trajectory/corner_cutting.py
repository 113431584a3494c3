"""Curves in an fg-Bernstein basis: evaluation by corner cutting, derivatives, bounds.

With h_k = u_k/(u_0 + .. + u_k), each point Q_k = (1 - h_k) Q_(k-1) + h_k P_k lies between two others, and the
curve is Q_n times the sum of the basis functions. This takes O(n) steps where de Casteljau takes O(n^2)
(Wozny and Chudy, Computer-Aided Design 2020, 118, 102760, doi:10.1016/j.cad.2019.102760).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.basis import Basis

Array = np.ndarray
BLOCK = 4096
"""Points evaluated at a time: their arrays stay in the cache of a core."""
UNIT = 2.0**-53


@dataclass(frozen=True, eq=False)
class FgForm:
    """sum_k control[k] u_k(t), control points (n + 1, d)."""

    basis: Basis
    control: Array

    @property
    def order(self) -> int:
        """n: one less than the number of control points."""
        return len(self.control) - 1

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return self.basis.start, self.basis.stop

    @property
    def numbers(self) -> int:
        """How many numbers a controller has to store."""
        return self.control.size

    def breaks(self) -> Array:
        """Return parameters where the curve is not smooth: none."""
        return np.empty(0)

    def evaluate(self, t: Array) -> Array:
        """Return points (len(t), d) of the curve."""
        out = np.empty((self.control.shape[1], len(t)))
        for first in range(0, len(t), BLOCK):
            part = t[first : first + BLOCK]
            f, g = self.basis.f(part), self.basis.g(part)
            _cut(f, g, self.control, out[:, first : first + BLOCK])
            if not self.basis.partition:
                out[:, first : first + BLOCK] *= (f + g) ** self.order
        return out.T

    def derivative(self) -> FgForm:
        """Return the derivative by t, a curve of the same order: f' and g' are combinations of f and g."""
        if self.basis.rates is None:
            raise InputError(
                f"The basis {self.basis.name!r} does not state its rates, so its curves have no derivatives."
            )
        alpha, beta = self.basis.rates
        p, n = self.control, self.order
        k = np.arange(n + 1)[:, None]
        after = np.vstack([p[1:], p[-1:]]) - (p if self.basis.partition else 0)
        before = np.vstack([p[:1], p[:-1]]) - (p if self.basis.partition else 0)
        middle = 0 if self.basis.partition else (2 * k - n) * alpha * p
        return FgForm(self.basis, (n - k) * beta * after + middle - k * beta * before)

    def taylor(self, middle: Array, half: Array, order: int) -> tuple[Array, Array]:
        """Return Taylor coefficients (order, S, d) at the middles, and a bound of everything else (S, d).

        The bound, of what they miss within `half` of the middle, counts the terms left out (a derivative is
        at most its largest control point times the largest sum of the basis) and the rounding of those kept.
        """
        form, terms = self, []
        most = self.basis.largest(self.order)
        rounding = np.zeros((len(middle), self.control.shape[1]))
        for k in range(order):
            terms.append(form.evaluate(middle) / factorial(k))
            scale = most * np.abs(form.control).max(axis=0) / factorial(k)
            rounding += np.outer(half**k, scale) * rounding_bound(self.order + k)
            form = form.derivative()
        left = most * np.abs(form.control).max(axis=0) / factorial(order) * (1 + rounding_bound(order + 1))
        return np.array(terms), rounding + np.outer(half**order, left)


def rounding_bound(order: int) -> float:
    """Bound of the rounding error of corner cutting, as a share of the largest control point.

    h_k has a relative error of at most 7k u, which moves Q_k by 14k u at most; each step rounds three times.
    """
    return (7 * order * order + 20 * order + 20) * UNIT


def _cut(f: Array, g: Array, control: Array, out: Array) -> None:
    n = len(control) - 1
    h, share, part = np.ones_like(f), np.empty_like(f), np.empty_like(f)
    out[:] = control[0][:, None]
    for k in range(1, n + 1):
        np.multiply(h, f, h)
        np.multiply(h, float(n - k + 1), h)
        np.multiply(g, float(k), share)
        np.add(share, h, share)
        np.divide(h, share, h)
        for point, q in zip(control[k].tolist(), out, strict=True):
            np.subtract(point, q, part)
            np.multiply(part, h, part)
            np.add(q, part, q)
