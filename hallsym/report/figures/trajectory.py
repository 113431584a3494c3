"""Pictures of a curve to follow: its control polygon, error along it, error against number of points."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.errors import InputError
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    DASHES,
    GREY,
    MARKERS,
    SERIES,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
)
from hallsym.trajectory import Choice, Curve, Nominal, Points
from hallsym.trajectory.choose import Candidate, Target
from hallsym.trajectory.curve import FgForm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 2001
MOST_SHOWN = 60
COUNTS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16, 18, 21, 26, 31, 41, 51, 61, 81, 101, 151, 201, 301)
MOST = 1e5
"""Largest error shown [um]."""
LEAST = 1e-9
"""Least error shown [um]: 1e-15 m, the rounding of float64 at some mm."""


def curve_picture(curve: Curve, data: Nominal | Points) -> Figure:
    """Draw the curve in mm, its control polygon (of up to 60 points), and where it was given points."""
    from matplotlib.lines import Line2D

    figure, axes = panels(1, 1, 3.6, top=0.3, bottom=0.42, right=0.15)
    ax, t = axes[0, 0], np.linspace(curve.start, curve.stop, SAMPLES)
    lengths = curve.lengths[:2]
    points = 1e3 * curve(t)[:, lengths]
    flat = len(lengths) == 1
    across = (lambda p, u: (u, p[:, 0])) if flat else (lambda p, u: (p[:, 0], p[:, 1]))
    handles = [Line2D([], [], color=AFTER, label="curve")]
    polygon = curve.form.control
    if not flat and len(polygon) <= MOST_SHOWN:
        ax.plot(*(1e3 * polygon[:, lengths]).T, color=GREY, ls=DASHED, marker="s", ms=3, mfc="none", lw=0.7)
        name = (
            "control polygon" if _within_hull(curve) else "coefficients (the curve need not lie between them)"
        )
        handles.append(Line2D([], [], color=GREY, ls=DASHED, marker="s", ms=3, mfc="none", label=name))
    if isinstance(data, Points):
        ax.plot(*across(1e3 * data.points[:, lengths], data.t), color=BEFORE, ls="", marker=".", ms=2.5)
        handles.append(Line2D([], [], color=BEFORE, ls="", marker=".", label=f"{len(data.t)} points given"))
    ax.plot(*across(points, t), color=AFTER)
    names = [name[: -len("_m")] for name in np.array(curve.coordinates)[lengths]]
    label_x(ax, "parameter" if flat else f"{names[0]} [mm]")
    label_y(ax, f"{names[-1]} [mm]")
    if not flat:
        ax.set_aspect("equal", adjustable="datalim")
    legend(figure, handles, "upper left", ncols=3)
    return figure


def _within_hull(curve: Curve) -> bool:
    return not isinstance(curve.form, FgForm) or curve.form.basis.name == "bernstein"


def error_along(choice: Choice, target: Target) -> Figure:
    """Draw the distance from the nominal curve along the parameter for the nearest methods, and the bound."""
    from matplotlib.lines import Line2D

    shown = sorted((c for c in choice.candidates if c.curve is not None), key=lambda c: c.error_m)
    shown = [choice.best, *(c for c in shown if c is not choice.best)][: len(DASHES) - 1]
    figure, axes = panels(1, 1, 2.9, top=_above(len(shown) + 1), bottom=0.42, right=0.15)
    ax, u, handles, everything = axes[0, 0], np.linspace(0, 1, SAMPLES), [], []
    for k, c in enumerate(shown):
        assert c.curve is not None
        apart = target.errors(c.curve, u, target.at(u))[:, c.curve.lengths]
        error = np.maximum(1e6 * np.linalg.norm(apart, axis=1), LEAST)
        everything.append(error)
        t = c.curve.start + u * (c.curve.stop - c.curve.start)
        ax.plot(t, error, color=SERIES[k % len(SERIES)], ls=DASHES[k], lw=1.3 if k == 0 else 0.8)
        name = f"{c.method.words}: {c.curve.control_points} control points"
        handles.append(Line2D([], [], color=SERIES[k % len(SERIES)], ls=DASHES[k], label=name))
    ax.axhline(1e6 * choice.best.error_m, color=BLACK, lw=0.6)
    handles.append(Line2D([], [], color=BLACK, lw=0.6, label=f"bound of {choice.best.method.words}"))
    log_axis(ax, "y", np.maximum(np.concatenate(everything), np.concatenate(everything).max() * 1e-6))
    assert isinstance(target.source, Nominal)
    label_x(ax, target.source.parameter)
    label_y(ax, "distance from the nominal curve [µm]")
    legend(figure, handles, "upper left", ncols=2)
    return figure


def error_by_points(target: Target, candidates: tuple[Candidate, ...], tolerance: float | None) -> Figure:
    """Draw the largest error of every method against its number of control points."""
    from matplotlib.lines import Line2D

    figure, axes = panels(1, 1, 3.4, top=_above(len(candidates) + 1), bottom=0.42, right=0.15)
    ax, handles, values = axes[0, 0], [], []
    for k, c in enumerate(candidates):
        found = [(n, e) for n in COUNTS if (e := _error_with(target, c, n)) is not None]
        if not found:
            continue
        n, e = np.array(found).T
        e = np.maximum(1e6 * e, LEAST)
        values.append(e)
        look: dict[str, Any] = {"color": SERIES[k % len(SERIES)], "ls": DASHES[k % len(DASHES)], "lw": 0.8,
                "marker": MARKERS[k % len(MARKERS)], "ms": 3}  # fmt: skip
        ax.plot(n, e, **look)
        handles.append(Line2D([], [], label=c.method.words, **look))
    if tolerance is not None:
        ax.axhline(1e6 * tolerance, color=BLACK, lw=0.6)
        handles.append(Line2D([], [], color=BLACK, lw=0.6, label="tolerance"))
    log_axis(ax, "y", np.minimum(np.concatenate(values), MOST))
    log_axis(ax, "x", np.array([COUNTS[0], COUNTS[-1]], float))
    label_x(ax, "points (control points of least squares)")
    label_y(ax, "largest distance [µm]")
    legend(figure, handles, "upper left", ncols=2)
    return figure


def _above(entries: int) -> float:
    """Inches that a legend of two columns takes above the axes."""
    return 0.12 + 0.178 * -(-entries // 2)


def _error_with(target: Target, c: Candidate, count: int) -> float | None:
    """Largest sampled error of a method with so many points; None where it makes no curve."""
    if not c.method.least <= count <= max(c.method.most, 101 * (not c.method.fitted)):
        return None
    taken, control = (max(c.points, 2 * count), count) if c.method.fitted else (count, 0)
    try:
        found = target.sampled(target.made(c.method, taken, control))
    except InputError:
        return None
    return found if np.isfinite(found) else None


def save_trajectory(choice: Choice, data: Nominal | Points, folder: str | Path | Place) -> list[Path]:
    """Save the pictures into `folder` (made if missing) and return the files written.

    Of points only the curve: nothing else is known between them.
    """
    draw = {"trajectory_curve": partial(curve_picture, choice.curve, data)}
    if isinstance(data, Nominal):
        target = Target(data)
        draw["trajectory_error"] = partial(error_along, choice, target)
        draw["trajectory_points"] = partial(error_by_points, target, choice.candidates, choice.tolerance_m)
    return save_figures(draw, folder)
