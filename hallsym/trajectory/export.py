"""A curve as a table at a clock and as G-code, with the error that each adds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hallsym.errors import InputError
from hallsym.files import atomic_write
from hallsym.trajectory.basis import BERNSTEIN
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.forms import SplineForm
from hallsym.trajectory.polynomials import pieces_of

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


def at_times(curve: Curve, t_s: Array, duration_s: float, *, steady: bool = False) -> Mapping[str, Array]:
    """Return x_m, y_m, rz_rad of the curve at times (samples,), 0 where it has no such coordinate.

    It runs from start to stop in `duration_s`, at constant speed of the parameter, or along the path
    (`steady`). Before and after it stands still. This is what a campaign follows.
    """
    if not 0 < duration_s < np.inf:
        raise InputError(f"The duration of a curve must be a positive number of seconds; got {duration_s!r}.")
    share = np.clip(np.asarray(t_s, float) / duration_s, 0.0, 1.0)
    if steady:
        parameter = curve.at_length(share * curve.length())
    else:
        parameter = np.clip(curve.start + share * (curve.stop - curve.start), curve.start, curve.stop)
    points = curve(parameter)
    named = dict(zip(curve.coordinates, points.T, strict=True))
    zero = np.zeros(len(points))
    return {name: named.pop(name, zero) for name in ("x_m", "y_m", "rz_rad")} | named


def write_table(
    curve: Curve, path: str | Path, *, duration_s: float, step_s: float, steady: bool = False
) -> int:
    """Write `t_s` and the coordinates of a curve at a clock as CSV; returns the number of rows."""
    clock = times(duration_s, step_s)
    found = at_times(curve, clock, duration_s, steady=steady)
    rows = np.column_stack([clock, *(found[name] for name in curve.coordinates)])

    def fill(target: Path) -> None:
        np.savetxt(target, rows, "%.17g", ",", header=",".join(("t_s", *curve.coordinates)), comments="")

    atomic_write(path, fill)
    return len(rows)


# -- G-code ----------------------------------------------------------------------------------------------


def chord_points(curve: Curve, chord_m: float) -> Array:
    """Return parameters between which no chord is farther than `chord_m` from the curve.

    A chord over a step h of the parameter is at most h^2/8 times the largest second derivative away, bounded
    in each part by its Taylor enclosure; corners of splines are points. The least number of equal steps is
    taken in each part.
    """
    edges, lengths = curve.parts(64), curve.lengths
    middle, half = (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2 * (1 + 1e-15)
    rate = curve.rate
    if not isinstance(curve.form, FgForm | SplineForm):
        pieces = pieces_of(curve)  # the same polynomial in a form whose derivatives are quickly bounded
        curve = Curve(
            FgForm(BERNSTEIN, pieces.control[0]), curve.start, curve.stop, curve.coordinates, curve.method
        )
        rate = curve.rate
    if isinstance(curve.form, SplineForm) and curve.form.degree == 1:
        return curve.parts(1)
    two = curve.form.derivative().derivative()
    terms, missed = two.taylor(curve.inner(middle), half * rate, 6)
    size = (np.abs(terms) * (half * rate)[:, None] ** np.arange(6)[:, None, None]).sum(axis=0) + missed
    bend = np.sqrt(np.sum(size[:, lengths] ** 2, axis=1)) * rate**2
    counts = np.maximum(np.ceil(2 * half * np.sqrt(bend / (8 * chord_m))), 1)
    if counts.sum() > MOST_BLOCKS:
        raise InputError(
            f"A chord error of {1e6 * chord_m:.3g} um takes {counts.sum():.3g} blocks; at most {MOST_BLOCKS} "
            "are written: allow a larger one."
        )
    parts = zip(edges[:-1], edges[1:], counts.astype(int), strict=True)
    return np.r_[np.concatenate([np.linspace(a, b, n + 1)[:-1] for a, b, n in parts]), edges[-1]]


def gcode(curve: Curve, *, chord_m: float | None = None, feed_m_s: float = 1e-3) -> str:
    """Return G-code in mm: G1 blocks within a chord error, or G5 or G5.2 blocks of the curve itself.

    G5 (cubic pieces) takes splines of degree 3 in a plane; G5.2 (NURBS of one piece) takes Bernstein curves.
    Both as LinuxCNC reads them. Raises `InputError` for other curves without a chord error.
    """
    names = {"x_m": "X", "y_m": "Y", "z_m": "Z"}
    axes = [names[name] for name in curve.coordinates if name in names]
    if not 0 < feed_m_s < np.inf:
        raise InputError(f"The feed must be a positive speed; got {feed_m_s!r} m/s.")
    error = (
        "not known" if curve.max_error_m is None else f"{1e6 * curve.max_error_m:.4g} um, {curve.error_kind}"
    )
    turning = [name for name in curve.coordinates if name not in names]
    head = [
        f"(hallsym trajectory: {curve.method}, {curve.control_points} control points)",
        f"(error of the curve: {error}; rounding adds at most "
        f"{500 * 10.0**-DIGITS * len(axes) ** 0.5 * 2:.2g} um)",
        *([f"({', '.join(turning)} cannot be written as G-code: left out)"] if turning else []),
    ]
    start = ["G21 G90 G17", f"G0 {_block(axes, 1e3 * curve(curve.start)[0, curve.lengths])}"]
    speed = f"F{6e4 * feed_m_s:.6g}"
    if chord_m is None and isinstance(curve.form, SplineForm) and curve.form.degree == 1:
        lines = [f"G1 {_block(axes, p)}" for p in 1e3 * curve(curve.parts(1))[1:, curve.lengths]]
        return "\n".join([*head, *start, speed, *lines, "M2", ""])
    if chord_m is not None:
        if not 0 < chord_m < np.inf:
            raise InputError(f"The chord error must be a positive length; got {chord_m!r} m.")
        points = 1e3 * curve(chord_points(curve, chord_m))[1:, curve.lengths]
        lines = [f"G1 {_block(axes, p)}" for p in points]
        lines[0] += f" {speed}"
        head.append(f"(G1: chords within {1e6 * chord_m:.4g} um of the curve, {len(points)} blocks)")
        return "\n".join([*head, *start, *lines, "M2", ""])
    if axes != ["X", "Y"]:
        raise InputError("G5 and G5.2 blocks need the coordinates x and y; give --chord for G1 blocks.")
    return "\n".join([*head, *start, speed, *_curved(curve), "M2", ""])


def _curved(curve: Curve) -> list[str]:
    pieces = pieces_of(curve)
    control = 1e3 * pieces.control[:, :, curve.lengths]
    if pieces.degree == 3:
        lines = []
        for p in control:
            (i, j), (a, b) = p[1] - p[0], p[2] - p[3]
            lines.append(
                f"G5 I{_digits(i)} J{_digits(j)} P{_digits(a)} Q{_digits(b)} {_block(['X', 'Y'], p[3])}"
            )
        return lines
    if len(control) > 1:
        raise InputError(
            f"A spline of degree {pieces.degree} has no G-code block; take --method cubic for G5, or "
            "--chord for G1."
        )
    rest = [f"{_block(['X', 'Y'], p)} P1" for p in control[0][1:]]
    return [f"G5.2 P1 L{pieces.degree + 1}", *rest, "G5.3"]


def _block(axes: list[str], values: Array) -> str:
    return " ".join(f"{axis}{_digits(value)}" for axis, value in zip(axes, values.tolist(), strict=True))


def _digits(value: float) -> str:
    text = f"{value:.{DIGITS}f}"
    return text if float(text) else f"{0:.{DIGITS}f}"
