"""A curve as a table at a clock and as G-code."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, require
from hallsym.files import atomic_write
from hallsym.trajectory.bounds import bend, is_polyline
from hallsym.trajectory.curve import Curve

Array = np.ndarray
MOST_ROWS = 5_000_000
MOST_BLOCKS = 500_000
DIGITS = 6
"""Decimal places of G-code in mm: 1 nm per unit, so that rounding adds at most 0.71 nm in a plane."""


def times(duration_s: float, step_s: float) -> Array:
    """Return the clock from 0 to the duration; the last step ends there."""
    count = duration_s / step_s
    if not 1 <= count <= MOST_ROWS:
        raise InputError(
            f"A duration of {duration_s:g} s at a step of {step_s:g} s makes {count:.3g} rows; between 1 and "
            f"{MOST_ROWS} are possible."
        )
    clock = np.arange(int(np.floor(count * (1 + 1e-12))) + 1) * step_s
    return clock if clock[-1] >= duration_s * (1 - 1e-12) else np.r_[clock, duration_s]


def at_times(curve: Curve, t_s: Array, duration_s: float) -> Mapping[str, Array]:
    """Return the coordinates of the curve at times (samples,).

    It runs from start to stop in `duration_s`, at constant speed of the parameter, and rests before and
    after. A campaign follows these.
    """
    require(0 < duration_s < np.inf, "The duration of a curve", "a positive number of seconds", duration_s)
    share = np.clip(np.asarray(t_s, float) / duration_s, 0.0, 1.0)
    points = curve(np.clip(curve.start + share * (curve.stop - curve.start), curve.start, curve.stop))
    return dict(zip(curve.coordinates, points.T, strict=True))


def write_table(curve: Curve, path: str | Path, *, duration_s: float, step_s: float) -> int:
    """Write `t_s` and the coordinates of a curve at a clock as CSV; returns the number of rows."""
    clock = times(duration_s, step_s)
    found = at_times(curve, clock, duration_s)
    rows = np.column_stack([clock, *(found[name] for name in curve.coordinates)])

    def fill(target: Path) -> None:
        np.savetxt(target, rows, "%.17g", ",", header=",".join(("t_s", *curve.coordinates)), comments="")

    atomic_write(path, fill)
    return len(rows)


def chord_points(curve: Curve, chord_m: float) -> Array:
    """Return parameters between which no chord is farther than `chord_m` from the curve.

    A chord over a step h of the parameter is at most h^2/8 times the largest second derivative away, bounded
    in each part; corners of splines are points. The least number of equal steps is taken in each part.
    """
    require(0 < chord_m < np.inf, "The chord error", "a positive length in m", chord_m)
    if is_polyline(curve):
        return curve.outer(curve.form.edges(1))
    edges = curve.form.edges(64)
    bends = np.array([bend(curve, a, b) for a, b in pairwise(edges.tolist())])
    counts = np.maximum(np.ceil(np.diff(edges) * np.sqrt(bends / (8 * chord_m))), 1)
    if counts.sum() > MOST_BLOCKS:
        raise InputError(
            f"A chord error of {1e6 * chord_m:.3g} um takes {counts.sum():.3g} blocks; at most {MOST_BLOCKS} "
            "are written: allow a larger one."
        )
    parts = zip(edges[:-1], edges[1:], counts.astype(int), strict=True)
    return curve.outer(np.r_[np.concatenate([np.linspace(a, b, n + 1)[:-1] for a, b, n in parts]), edges[-1]])


def gcode(curve: Curve, *, chord_m: float, duration_s: float | None = None) -> str:
    """Return G-code in mm: G1 blocks within a chord error, fed so that the path takes `duration_s`.

    Without a duration the feed is 1 mm/s.
    """
    names = {"x_m": "X", "y_m": "Y", "z_m": "Z"}
    axes = [names[name] for name in curve.coordinates if name in names]
    known = curve.max_error_m
    error = "not known" if known is None else f"{1e6 * known:.4g} um, {curve.error_kind}"
    angular = [name for name in curve.coordinates if name not in names]
    points = 1e3 * curve(chord_points(curve, chord_m))[:, curve.lengths]
    feed = 60.0 if duration_s is None else 6e4 * curve.length() / duration_s
    lines = [
        f"(hallsym trajectory: {curve.method}, {curve.control_points} control points)",
        f"(error of the curve: {error}; rounding adds at most "
        f"{500 * 10.0**-DIGITS * len(axes) ** 0.5 * 2:.2g} um)",
        *([f"({', '.join(angular)} cannot be written as G-code: left out)"] if angular else []),
        f"(chords within {1e6 * chord_m:.4g} um of the curve, {len(points) - 1} blocks)",
        "G21 G90 G17",
        f"G0 {_block(axes, points[0])}",
        *(f"G1 {_block(axes, p)}" for p in points[1:]),
        "M2",
        "",
    ]
    lines[-len(points) - 1] += f" F{feed:.6g}"
    return "\n".join(lines)


def _block(axes: list[str], values: Array) -> str:
    shown = [f"{value:.{DIGITS}f}" for value in values.tolist()]
    zero = f"{0:.{DIGITS}f}"
    return " ".join(f"{axis}{text if float(text) else zero}" for axis, text in zip(axes, shown, strict=True))
