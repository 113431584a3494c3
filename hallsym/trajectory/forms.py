"""The other forms of a curve, on [0, 1]: B-splines, polynomials by their values at Chebyshev nodes, AAA.

Each has the methods of `FgForm`: evaluate, derivative, taylor, breaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.corner_cutting import BLOCK, UNIT
from hallsym.trajectory.intervals import Interval
from hallsym.trajectory.jets import Jet

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class SplineForm:
    """A B-spline of a degree: knots (n + degree + 2,), control points (n + 1, d). Degree 1 is a polyline."""

    knots: Array
    degree: int
    control: Array

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return float(self.knots[self.degree]), float(self.knots[-self.degree - 1])

    @property
    def numbers(self) -> int:
        """How many numbers a controller has to store: control points and inner knots."""
        return self.control.size + max(len(self.knots) - 2 * self.degree - 2, 0)

    def breaks(self) -> Array:
        """Return the inner knots."""
        inner = np.unique(self.knots)
        start, stop = self.domain
        return inner[(inner > start) & (inner < stop)]

    def evaluate(self, t: Array) -> Array:
        """Return points (len(t), d) of the curve."""
        if self.degree == 0:  # scipy takes the piece after a knot; so do we
            return self.control[np.searchsorted(self.knots[1:-1], t, side="right")]
        from scipy.interpolate import BSpline  # slow to load

        return BSpline(self.knots, self.control, self.degree)(t)

    def derivative(self) -> SplineForm:
        """Return the derivative by t, of one degree less; that of constants is zero."""
        if self.degree == 0:
            return SplineForm(self.knots, 0, np.zeros_like(self.control))
        p, k = self.degree, self.knots
        width = (k[p + 1 : -1] - k[1 : -p - 1])[:, None]
        step = np.diff(self.control, axis=0)
        control = np.divide(p * step, width, out=np.zeros_like(step), where=width > 0)
        return SplineForm(k[1:-1], p - 1, control)

    def taylor(self, middle: Array, half: Array, order: int) -> tuple[Array, Array]:
        """Return Taylor coefficients (order, S, d) at the middles and a bound of what they miss (S, d).

        Within a piece a spline is a polynomial: what is missed is the terms beyond `order`, bounded by
        control points, and rounding: de Boor's algorithm takes convex combinations, degree of them, 5 u each.
        """
        form, terms = self, []
        missed = np.zeros((len(middle), self.control.shape[1]))
        for k in range(max(order, self.degree + 1)):
            most = np.abs(form.control).max(axis=0) / factorial(k)
            if k < order:
                terms.append(form.evaluate(middle) / factorial(k))
                missed += np.outer(half**k, most) * (5 * self.degree + 5 * k + 5) * UNIT
            else:
                missed += np.outer(half**k, most) * (1 + 1e-12)
            form = form.derivative()
        return np.array(terms), missed


@dataclass(frozen=True, eq=False)
class ChebyshevForm:
    """The polynomial through values (n + 1, d) at the Chebyshev nodes of the first kind of [0, 1].

    Evaluated by the second barycentric formula (Berrut and Trefethen, SIAM Review 2004, 46, 501,
    doi:10.1137/S0036144502417715), which is stable for thousands of nodes.
    """

    control: Array

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return 0.0, 1.0

    @property
    def numbers(self) -> int:
        """How many numbers a controller has to store; the nodes follow from their count."""
        return self.control.size

    @property
    def nodes(self) -> Array:
        """Parameters of the values (n + 1,), increasing."""
        return chebyshev_nodes(len(self.control))

    def breaks(self) -> Array:
        """Return parameters where the curve is not smooth: none."""
        return np.empty(0)

    def evaluate(self, t: Array) -> Array:
        """Return points (len(t), d) of the curve."""
        nodes, n = self.nodes, len(self.control)
        weights = np.sin(np.pi * (2 * np.arange(n) + 1) / (2 * n)) * (-1.0) ** np.arange(n)
        return barycentric(t, nodes, self.control, weights)

    @property
    def coefficients(self) -> Array:
        """Coefficients (n + 1, d) of T_k(2 t - 1)."""
        n = len(self.control)
        angle = np.pi * (2 * np.arange(n)[::-1] + 1) / (2 * n)  # node j is (1 + cos(angle_j))/2
        c = 2 / n * np.cos(np.outer(np.arange(n), angle)) @ self.control
        c[0] /= 2
        return c

    def derivative(self) -> ChebyshevForm:
        """Return the derivative by t, given by its values at the same nodes."""
        c = 2 * np.polynomial.chebyshev.chebder(self.coefficients)
        return ChebyshevForm(
            np.polynomial.chebyshev.chebval(2 * self.nodes - 1, c).T.reshape(self.control.shape)
        )

    def taylor(self, middle: Array, half: Array, order: int) -> tuple[Array, Array]:
        """Return Taylor coefficients (order, S, d) at the middles and a bound of what they miss (S, d).

        |T_k| <= 1, so that a derivative is at most the sum of its coefficients; that also bounds rounding.
        Last coefficients that are rounding themselves are not differentiated: their sum is missed.
        """
        c, n, terms = self.coefficients, len(self.control), []
        after = np.abs(c[::-1]).cumsum(axis=0)[::-1]
        kept = max(int((after > 8 * UNIT * np.abs(c).max(axis=0)).any(axis=1).sum()), 1)
        missed = np.broadcast_to(np.abs(c[kept:]).sum(axis=0), (len(middle), c.shape[1])).copy()
        c = c[:kept]
        for k in range(order):
            terms.append(np.polynomial.chebyshev.chebval(2 * middle - 1, c).T / factorial(k))
            missed += np.outer(half**k, np.abs(c).sum(axis=0) / factorial(k)) * (n + 4 * k + 8) * 4 * UNIT
            c = 2 * np.polynomial.chebyshev.chebder(c)
        left = np.abs(c).sum(axis=0) / factorial(order) * (1 + (n + 8) * 8 * UNIT)
        return np.array(terms), missed + np.outer(half**order, left)


@dataclass(frozen=True, eq=False)
class RationalForm:
    """One rational function per coordinate in barycentric form (AAA: Nakatsukasa, Sete, Trefethen 2018).

    `support`, `values`, `weights`: one array per coordinate, of lengths that may differ.
    """

    support: tuple[Array, ...]
    values: tuple[Array, ...]
    weights: tuple[Array, ...]

    @property
    def control(self) -> Array:
        """The longest list of support values, the others filled with nan: there are no control points."""
        out = np.full((max(map(len, self.values)), len(self.values)), np.nan)
        for k, v in enumerate(self.values):
            out[: len(v), k] = v
        return out

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return 0.0, 1.0

    @property
    def numbers(self) -> int:
        """How many numbers a controller has to store: support, values and weights."""
        return 3 * sum(map(len, self.support))

    def breaks(self) -> Array:
        """Return the support parameters, so that each part between them can be bounded."""
        inner = np.unique(np.concatenate(self.support))
        return inner[(inner > 0) & (inner < 1)]

    def evaluate(self, t: Array) -> Array:
        """Return points (len(t), d) of the curve."""
        parts = zip(self.support, self.values, self.weights, strict=True)
        return np.column_stack([barycentric(t, z, f[:, None], w)[:, 0] for z, f, w in parts])

    def derivative(self) -> RationalForm:
        """Refuse: no controller is given rational curves here."""
        raise InputError("A curve by AAA has no derivatives here; choose another --method.")

    def taylor(self, middle: Array, half: Array, order: int) -> tuple[Array, Array]:
        """Return Taylor coefficients (order, S, d) at the middles and a bound of what they miss (S, d).

        Enclosed in interval arithmetic; infinite where the denominator may vanish.
        """
        at, around = Interval.of(middle), Interval(middle - half, middle + half)
        terms, missed = np.empty((order, len(middle), len(self.support))), []
        for k, parts in enumerate(zip(self.support, self.values, self.weights, strict=True)):
            thin = _rational(at, order - 1, *parts).terms
            wide = _rational(around, order, *parts).terms[order]
            terms[:, :, k] = [(a.low + a.high) / 2 for a in thin]
            slack = sum((a.high - a.low) * half**j for j, a in enumerate(thin))
            missed.append(wide.most * half**order + slack)
        known = np.isfinite(terms)
        return np.where(known, terms, 0.0), np.where(known.all(axis=0), np.array(missed).T, np.inf)


def _rational(t: Interval, order: int, support: Array, values: Array, weights: Array) -> Jet:
    """Enclose a barycentric quotient; numerator and denominator are multiplied by t - (nearest support)."""
    middle = (t.low + t.high) / 2
    nearest = np.argmin(np.abs(middle[:, None] - support), axis=1)
    zero = Interval.of(np.zeros_like(middle))
    top, bottom = [zero] * (order + 1), [zero] * (order + 1)
    for j, (z, f, w) in enumerate(zip(support, values, weights, strict=True)):
        own = nearest == j
        away = t - Interval.of(z)
        away = Interval(np.where(own, 1.0, away.low), np.where(own, 1.0, away.high))
        term = Interval.of(np.where(own, 0.0, w)) / away
        for k in range(order + 1):
            top[k], bottom[k] = top[k] + term.scaled(float(f)), bottom[k] + term
            term = -(term / away)
    shift = t - Interval.of(support[nearest])
    own_f = Interval.of(values[nearest]) * Interval.of(weights[nearest])
    jets = []
    for sums, first in ((top, own_f), (bottom, Interval.of(weights[nearest]))):
        rest = [first, *sums[:-1]]
        jets.append(Jet(tuple(shift * a + b for a, b in zip(sums, rest, strict=True))))
    return jets[0] / jets[1]


Form = SplineForm | ChebyshevForm | RationalForm


def chebyshev_nodes(n: int) -> Array:
    """Return the n Chebyshev nodes of the first kind on [0, 1], increasing: (1 - cos(pi (2k + 1)/(2n)))/2."""
    return np.sin(np.pi * (2 * np.arange(n) + 1) / (4 * n)) ** 2


def barycentric(t: Array, nodes: Array, points: Array, weights: Array) -> Array:
    """Return sum_k w_k points_k/(t - t_k) over sum_k w_k/(t - t_k), shape (len(t), d)."""
    out = np.empty((len(t), points.shape[1]))
    for first in range(0, len(t), BLOCK):
        part = t[first : first + BLOCK]
        distance = part[:, None] - nodes
        row, node = np.nonzero(distance == 0)
        distance[row] = 1.0
        shares = weights / distance
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole is infinite
            out[first : first + BLOCK] = (shares @ points) / shares.sum(axis=1)[:, None]
        out[first + row] = points[node]
    return out
