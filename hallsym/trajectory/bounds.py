"""How far a curve is from the nominal one everywhere: bounded between the points, not sampled.

The range is cut into parts. In each, the difference of both curves is its Taylor polynomial at the middle
plus what that can miss, enclosed by interval arithmetic; parts that may hold the largest error are cut again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.forms import SplineForm
from hallsym.trajectory.intervals import Interval
from hallsym.trajectory.nominal import Nominal

Array = np.ndarray
ORDER = 8
MOST_PARTS = 20_000
ROUNDS = 12
UNIT = 2.0**-53


@dataclass(frozen=True)
class Bound:
    """The largest error lies between `at_least` and `at_most`; `where` is the parameter of the former.

    Lengths in m: distance of the two points at the same parameter, or, for a polyline, from its chord.
    `rotation_rad`: the same bound of the largest error of an angle, None without one.
    """

    at_least: float
    at_most: float
    where: float
    rotation_rad: float | None = None


def bound(
    curve: Curve, nominal: Nominal, span: tuple[float, float] | None = None, *, rel: float = 1e-3
) -> Bound:
    """Return the bound of the error of `curve` over its range, or over `span`.

    `rel`: how close `at_most` shall come to `at_least`; refining ends sooner where the arithmetic of float64
    is all that is left. Raises `InputError` if other coordinates are stated or nothing can be bounded.
    """
    if curve.coordinates != nominal.coordinates:
        raise InputError(
            f"The curve gives {', '.join(curve.coordinates)}, the nominal one "
            f"{', '.join(nominal.coordinates)}."
        )
    first, last = span or (curve.start, curve.stop)
    edges = curve.parts(min(max(64, 4 * curve.control_points), 4096))
    edges = np.r_[first, edges[(edges > first) & (edges < last)], last]
    low, high = edges[:-1], edges[1:]
    best, where, settled, angle, before = 0.0, float(low[0]), 0.0, 0.0, np.inf
    for turn in range(ROUNDS + 1):
        upper, lower, rotation = _parts(curve, nominal, low, high)
        k = int(np.argmax(lower))
        if lower[k] > best:
            best, where = float(lower[k]), float((low[k] + high[k]) / 2)
        again = upper > max(best * (1 + rel), settled)
        worst = float(upper.max())
        if turn == ROUNDS or 3 * np.count_nonzero(again) > MOST_PARTS or worst > 0.95 * before:
            again[:] = False  # smaller parts would show no more: what is left is rounding
        before = worst if turn else np.inf
        settled = max(settled, float(upper[~again].max(initial=0.0)))
        angle = max(angle, float(rotation[~again].max(initial=0.0)))
        if not again.any():
            break
        cuts = low[again] + np.arange(4)[:, None] / 3 * (high - low)[again]
        cuts[3] = high[again]
        low, high = cuts[:-1].ravel(), cuts[1:].ravel()
    if not np.isfinite(settled):
        raise InputError(
            "The error between the points cannot be bounded: the curve or its nominal expression has a "
            "pole, a corner or a root of 0 in its range."
        )
    has_angle = len(curve.lengths) < len(curve.coordinates)
    return Bound(best, settled, where, angle if has_angle else None)


def _parts(curve: Curve, nominal: Nominal, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Upper and lower bound of the largest distance in each part, and upper bound of the angles' errors."""
    middle = (low + high) / 2
    half = np.maximum(high - middle, middle - low) * (1 + 4 * UNIT)
    around = Interval(middle - half, middle + half)
    thin = nominal.taylor(Interval.of(middle), ORDER - 1)
    wide = nominal.taylor(around, ORDER)
    inner, rate = curve.inner(middle), curve.rate
    terms, missed = curve.form.taylor(inner, half * rate * (1 + 4 * UNIT), ORDER)
    # the form's own parameter is rounded: that moves the point along the curve
    shift = 6 * UNIT * np.maximum(np.abs(inner), 1.0)
    missed = missed + shift[:, None] * np.abs(terms[1]) * 2
    scale = rate ** np.arange(ORDER)
    powers = half ** np.arange(ORDER)[:, None]
    centre, radius, values = [], [], []
    for k in range(len(curve.coordinates)):
        rest = missed[:, k] + wide[k][ORDER].most * half**ORDER
        differences = []
        for j in range(ORDER):
            own = terms[j][:, k] * scale[j]
            low_j, high_j = thin[k][j].low - own, thin[k][j].high - own
            differences.append((low_j + high_j) / 2)
            rest = rest + ((high_j - low_j) / 2 + 4 * UNIT * np.abs(own)) * powers[j]
        values.append(differences)
        centre.append(differences[0])
        radius.append(rest)
    e, slack = np.array(values), np.array(radius)  # (d, ORDER, S), (d, S)
    lengths = curve.lengths
    turning = [k for k in range(len(e)) if k not in lengths]
    reach = np.abs(e[:, 1:]) * powers[1:]
    rotation = (np.abs(e[turning, 0]) + reach[turning].sum(axis=1) + slack[turning]).max(axis=0, initial=0.0)
    if is_polyline(curve):
        upper, lower = _from_chord(curve, middle, e[lengths], slack[lengths], powers)
    else:
        size = np.abs(e[lengths, 0]) + reach[lengths].sum(axis=1) + slack[lengths]
        upper = np.sqrt(np.sum(size**2, axis=0))
        lower = np.sqrt(np.sum(np.maximum(np.abs(e[lengths, 0]) - slack[lengths], 0.0) ** 2, axis=0))
    return np.where(np.isnan(upper), np.inf, upper * (1 + 8 * UNIT)), np.nan_to_num(lower), rotation


def chords(curve: Curve, inner: Array) -> tuple[Array, Array, Array]:
    """Return piece of a polyline at each parameter of its form, its direction (d, len) and length."""
    points, knots = curve.form.control[:, curve.lengths], polyline_knots(curve)
    piece = np.clip(np.searchsorted(knots, inner, side="right") - 1, 0, len(points) - 2)
    chord = points[piece + 1] - points[piece]
    long = np.linalg.norm(chord, axis=1)
    return piece, np.divide(chord, long[:, None], out=np.zeros_like(chord), where=long[:, None] > 0).T, long


def polyline_knots(curve: Curve) -> Array:
    """Return the parameters of the corners of a polyline."""
    return curve.form.knots[1:-1] if isinstance(curve.form, SplineForm) else np.empty(0)


def is_polyline(curve: Curve) -> bool:
    """Whether the curve is made of chords, whose error is the distance from them."""
    return isinstance(curve.form, SplineForm) and curve.form.degree == 1


def _from_chord(curve: Curve, middle: Array, e: Array, slack: Array, powers: Array) -> tuple[Array, Array]:
    """Distance from the chord: the error across it, and along it only where it reaches beyond the ends."""
    inner, knots = curve.inner(middle), polyline_knots(curve)
    piece, way, long = chords(curve, inner)
    share = (inner - knots[piece]) / (knots[piece + 1] - knots[piece])
    slack = np.sqrt(np.sum(slack**2, axis=0)) + 16 * UNIT * np.abs(e).sum(axis=(0, 1))
    along = np.einsum("ds,dks->ks", way, e)
    across = e - way[:, None] * along
    size = np.abs(across[:, 0]) + (np.abs(across[:, 1:]) * powers[1:]).sum(axis=1)
    moved = np.abs(along[0]) + (np.abs(along[1:]) * powers[1:]).sum(axis=0) + slack
    half_chord = powers[1] * long / 2 * 2 * curve.rate / np.maximum(knots[piece + 1] - knots[piece], 1e-300)
    beyond = np.maximum(moved - np.minimum(share, 1 - share) * long + half_chord, 0.0)
    beyond = np.minimum(beyond, moved)
    upper = np.hypot(np.sqrt(np.sum(size**2, axis=0)) + slack, beyond)
    lower = np.maximum(np.sqrt(np.sum(across[:, 0] ** 2, axis=0)) - slack, 0.0)
    return upper, lower
