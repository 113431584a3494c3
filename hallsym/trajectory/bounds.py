"""Bounds of the distance of a curve from the nominal one, rigorous between the points.

In a part of the range the difference of both is its Taylor polynomial at the middle plus a remainder that
ball arithmetic (Arb, in python-flint; Johansson, IEEE Trans. Comput. 66 (2017) 1281) encloses; the part that
may hold the largest error is cut again. The curve is the exact one of its stored numbers.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.curve import Curve, SplineForm
from hallsym.trajectory.nominal import Nominal

Array = np.ndarray
ORDER = 9
"""Order of the Taylor polynomials; the default of python-flint."""
BITS = 128
EQUAL = 1e-14
"""Share of the largest coordinate below which errors count as equal: some roundings of float64."""
MOST_PARTS = 100_000
NARROWEST = 1e-9
"""Share of the range below which a part without a bound is not cut again."""


@dataclass(frozen=True)
class Bound:
    """The largest error lies between `at_least` and `at_most`; `where` is the parameter of the former.

    Lengths in m: distance of the two points at the same parameter, or, for a polyline, from its chord.
    `rotation_rad`: upper bound of the largest error of an angle, None without one.
    """

    at_least: float
    at_most: float
    where: float
    rotation_rad: float | None = None


def bound(
    curve: Curve, nominal: Nominal, span: tuple[float, float] | None = None, *, rel: float = 1e-3
) -> Bound:
    """Return the bound of the error of `curve` over its range, or over `span`.

    `rel`: relative distance of `at_most` from `at_least`. Raises `InputError` if coordinates differ or there
    is no bound.
    """
    if curve.coordinates != nominal.coordinates:
        ours, theirs = (", ".join(each.coordinates) for each in (curve, nominal))
        raise InputError(f"The curve gives {ours}, the nominal one {theirs}.")
    first, last = curve.inner(np.array(span or (curve.start, curve.stop))).tolist()
    edges = curve.form.edges(64)
    edges = np.r_[first, edges[(edges > first) & (edges < last)], last]
    parts = [_Part.of(curve, nominal, a, b) for a, b in pairwise(edges.tolist())]
    best = max(parts, key=lambda part: part.lower)
    tried = len(parts)
    heapq.heapify(parts)
    least = EQUAL * float(np.abs(curve.form.evaluate(edges)).max())
    while parts[0].upper > max(best.lower * (1 + rel), least):
        worst = heapq.heappop(parts)
        cuts = np.linspace(worst.low, worst.high, 4)
        tried += 3
        if worst.high - worst.low < NARROWEST * (last - first) or tried > MOST_PARTS:
            raise InputError(
                "The error between the points cannot be bounded: the curve or its nominal expression has a "
                "pole, a corner or a root of 0 in its range."
            )
        for a, b in pairwise(cuts.tolist()):
            part = _Part.of(curve, nominal, a, b)
            best = max(best, part, key=lambda part: part.lower)
            heapq.heappush(parts, part)
    angle = max(part.rotation for part in parts)
    has_angle = len(curve.lengths) < len(curve.coordinates)
    where = curve.outer((best.low + best.high) / 2)
    return Bound(best.lower, parts[0].upper, where, angle if has_angle else None)


@dataclass(frozen=True)
class _Part:
    """Part of the form's parameter, with bounds of the largest distance and of the angles' errors in it."""

    low: float
    high: float
    upper: float
    lower: float
    rotation: float

    def __lt__(self, other: _Part) -> bool:
        """Order by the upper bound, the largest first."""
        return self.upper > other.upper

    @classmethod
    def of(cls, curve: Curve, nominal: Nominal, low: float, high: float) -> _Part:
        """Bound the difference of both curves from `low` to `high`."""
        middle, half = _around(low, high)
        try:
            thin, wide = (_difference(curve, nominal, at) for at in _arguments(middle, half))
        except (ValueError, ZeroDivisionError):  # a division by what may be 0
            return cls(low, high, np.inf, 0.0, np.inf)
        lengths = curve.lengths
        angular = [k for k in range(len(thin)) if k not in lengths]
        reach = sizes(thin, wide) @ half ** np.arange(ORDER + 1.0)
        rotation = float(reach[angular].max(initial=0.0))
        along = across = [thin[k] for k in lengths], [wide[k] for k in lengths]
        least = most = 0.0
        if is_polyline(curve):
            across, least, most = _from_chord(curve, middle, half, *along)
        near, same = (
            np.linalg.norm(sizes(*each) @ half ** np.arange(ORDER + 1.0)) for each in (across, along)
        )
        upper = np.fmin(np.hypot(near, most), same) * (1 + 1e-12)
        offset = [float(c[0].abs_lower()) for c in across[0]]
        lower = np.linalg.norm([*offset, least]) * (1 - 1e-12)
        return cls(low, high, float(np.nan_to_num(upper, nan=np.inf)), float(np.nan_to_num(lower)), rotation)


def _around(low: float, high: float) -> tuple[float, float]:
    """Middle of a part, and the largest distance of its ends from there."""
    middle = (low + high) / 2
    return middle, max(high - middle, middle - low) * (1 + 1e-15)


def _arguments(middle: float, half: float) -> tuple[Any, Any]:
    """The parameter as power series: about the middle, and about any place of the part."""
    from flint import arb, arb_series

    return arb_series([arb(middle), 1]), arb_series([arb(middle, half), 1])


def _difference(curve: Curve, nominal: Nominal, at: Any) -> list[Any]:
    """Power series of the curve less the nominal one, by the form's parameter."""
    from flint import arb, ctx

    with ctx.workprec(BITS):
        a, b = map(arb, curve.form.domain)
        t = (at - a) / (b - a) * (arb(curve.stop) - arb(curve.start)) + arb(curve.start)
        return [p - q for p, q in zip(curve.form.series(at), nominal.series(t), strict=True)]


def sizes(thin: list[Any], wide: list[Any]) -> Array:
    """Upper bounds (d, ORDER + 1) of Taylor coefficients at the middle; the last holds all over the part."""
    found = [[*(p[k] for k in range(ORDER)), q[ORDER]] for p, q in zip(thin, wide, strict=True)]
    return np.array([[float(c.abs_upper()) for c in row] for row in found]) * (1 + 1e-15)


def bend(curve: Curve, low: float, high: float) -> float:
    """Return an upper bound of the second derivative of the path by the form's parameter in a part."""
    from flint import ctx

    middle, half = _around(low, high)
    with ctx.workprec(BITS):
        thin, wide = ([curve.form.series(at)[k] for k in curve.lengths] for at in _arguments(middle, half))
    k = np.arange(2.0, ORDER + 1)
    return float(np.linalg.norm(sizes(thin, wide)[:, 2:] @ (k * (k - 1) * half ** (k - 2))) * (1 + 1e-12))


def is_polyline(curve: Curve) -> bool:
    """Whether the curve is made of chords, whose error is the distance from them."""
    return isinstance(curve.form, SplineForm) and curve.form.degree == 1


def _from_chord(
    curve: Curve, middle: float, half: float, thin: list[Any], wide: list[Any]
) -> tuple[tuple[list[Any], list[Any]], float, float]:
    """Distance from a chord: differences across it, and how far beyond its ends the nominal points lie.

    The latter is at least the second value at the middle, and at most the third in all of the part.
    """
    from flint import arb, ctx

    form = curve.form
    assert isinstance(form, SplineForm)
    k = int(form.piece(middle))
    places, found = [], []
    with ctx.workprec(BITS):
        left, right = map(arb, form.knots[k : k + 2].tolist())
        chord = [arb(p) - arb(q) for p, q in form.control[[k, k - 1]][:, curve.lengths].T]
        square = sum((c * c for c in chord), arb(0))
        length = float(square.sqrt().abs_upper())
        square = square if length else arb(1)  # both ends are one point
        for at, step in zip(_arguments(middle, half), (thin, wide), strict=True):
            along = sum((c * p for c, p in zip(chord, step, strict=True)), 0 * step[0]) / square
            found.append([p - c * along for c, p in zip(chord, step, strict=True)])
            places.append((at - left) / (right - left) - along)
        out = max(-places[0][0], places[0][0] - 1, key=float)
    reach = float(sizes(places[:1], places[1:])[0, 1:] @ half ** np.arange(1.0, ORDER + 1))
    most = length * (float(out.upper()) + reach)
    return (found[0], found[1]), max(length * float(out.lower()), 0.0), max(most, 0.0)
