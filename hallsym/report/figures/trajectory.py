"""Pictures of a curve to follow: its control polygon, and the error along it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    DASHES,
    GREY,
    SERIES,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
)
from hallsym.trajectory import Choice, Curve, Nominal, Points
from hallsym.trajectory.choose import Target
from hallsym.trajectory.curve import FgForm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 2001
MOST_SHOWN = 60
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


def _above(entries: int) -> float:
    """Inches that a legend of two columns takes above the axes."""
    return 0.12 + 0.178 * -(-entries // 2)


def save_trajectory(choice: Choice, data: Nominal | Points, folder: str | Path | Place) -> list[Path]:
    """Save the pictures into `folder` (made if missing) and return the files written.

    Of points only the curve: nothing else is known between them.
    """
    draw = {"trajectory_curve": partial(curve_picture, choice.curve, data)}
    if isinstance(data, Nominal):
        draw["trajectory_error"] = partial(error_along, choice, Target(data))
    return save_figures(draw, folder)
