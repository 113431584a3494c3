"""Pictures of a plan: what it covers beside what was recorded, and how uncertainty falls with runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.log import Log
from hallsym.report.figures.saving import save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    FAINT,
    GREY,
    SHADE,
    key,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
)
from hallsym.report.words import largest, name, scale
from hallsym.simulation import Campaign

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.experiment import Plan

POINTS = 240
"""Points of a path that are drawn."""
CIRCLES = 60
"""Of the other campaign's path, so many points are drawn as circles."""


def save_plan_pictures(
    plan: Plan, folder: str | Path, other: Campaign | Log | None = None, other_name: str = "recorded"
) -> list[Path]:
    """Draw `coverage` and `criterion_by_runs` as PNG into `folder` (made if missing); returns the files.

    `other`: a campaign or a log to draw beside the plan, called `other_name`.
    """
    return save_figures(
        {
            "coverage": lambda: coverage(plan, other, other_name),
            "criterion_by_runs": lambda: criterion_by_runs(plan),
        },
        folder,
    )


def coverage(plan: Plan, other: Campaign | Log | None = None, other_name: str = "recorded") -> Figure:
    """Draw vertical settings (area: number of runs) and paths of the motion, planned and recorded."""
    model = plan.study.model
    planned = list(_paths(plan.campaign, (*model.pose, *model.state)))
    shown = [] if other is None else list(_paths(other, (*model.pose, *model.state), model.references))
    rows = [list(_pairs(len(model.pose), 0))]
    if len(model.state) >= 2:
        rows.insert(0, list(_pairs(len(model.state), len(model.pose))))
    columns = (*model.pose, *model.state)
    figure, axes = panels(len(rows), 3, 1.75, top=0.3, bottom=0.42, gaps=(0.72, 0.55), right=0.14)
    for line, pairs in zip(axes, rows, strict=True):
        for ax, (i, j) in zip(line, pairs, strict=False):
            both = np.array([largest(np.hstack([p[k] for p in planned + shown])) for k in (i, j)])
            units = [scale(columns[k], most, model.period) for k, most in zip((i, j), both, strict=True)]
            draw = _settings if i >= len(model.pose) else _motion
            draw(ax, shown, (i, j), units, BEFORE, False)
            draw(ax, planned, (i, j), units, AFTER, True)
            label_x(ax, f"{name(columns[i])} [{units[0][1]}]", 0.3)
            label_y(ax, f"{name(columns[j])} [{units[1][1]}]", 0.62)
            ax.margins(0.14)
            ax.grid(color=SHADE, lw=0.5, zorder=0)
    _coverage_legend(figure, len(planned), len(shown), other_name)
    return figure


def _pairs(n: int, first: int) -> Iterator[tuple[int, int]]:
    for i in range(n):
        for j in range(i + 1, n):
            yield first + i, first + j


def _paths(
    source: Campaign | Log, columns: Sequence[str], references: Sequence[str] = ()
) -> Iterator[np.ndarray]:
    """Position of every axis over each run, (columns, points)."""
    if isinstance(source, Campaign):
        for run in source.runs:
            t = np.linspace(0.0, run.duration_s, POINTS)
            yield np.array([run.position(c, t) for c in columns])
        return
    logged = (*references, *columns[len(references) :])
    parts: dict[int, list[np.ndarray]] = {}
    for block in source.blocks(logged):
        rows = np.array([block.data[c] for c in logged])
        parts.setdefault(block.run, []).append(rows[:, :: max(1, rows.shape[1] // POINTS)])
    for pieces in parts.values():
        yield np.hstack(pieces)


def _settings(
    ax: Axes,
    paths: list[np.ndarray],
    at: tuple[int, int],
    units: list[tuple[float, str]],
    color: str,
    full: bool,
) -> None:
    """A disc for each setting, its area the number of runs; a line where the axes move within a run."""
    if not paths:
        return
    factors = np.array([u[0] for u in units])
    middle = factors * np.array([p[list(at)].mean(axis=1) for p in paths])
    places, count = np.unique(np.round(middle, 1), axis=0, return_counts=True)
    look: dict[str, Any] = (
        {"facecolors": color, "alpha": 0.75} if full else {"facecolors": "none", "edgecolors": color}
    )
    x, y = places.T
    ax.scatter(x, y, s=14.0 * count, zorder=3 if full else 4, linewidths=1.0, **look)
    _motion(ax, [p for p in paths if np.ptp(p[list(at)], axis=1).max() > 2e-6], at, units, color, full)


def _motion(
    ax: Axes,
    paths: list[np.ndarray],
    at: tuple[int, int],
    units: list[tuple[float, str]],
    color: str,
    full: bool,
) -> None:
    look: dict[str, Any] = {"lw": 0.9} if full else {"ls": "none", "marker": "o", "ms": 2.2, "mfc": "none"}
    for path in _distinct([p[list(at)] for p in paths]):
        step = 1 if full else max(1, path.shape[1] // CIRCLES)
        x, y = (f * row[::step] for (f, _), row in zip(units, path, strict=True))
        ax.plot(x, y, color=color, zorder=2 + full, **look)


def _distinct(paths: list[np.ndarray]) -> list[np.ndarray]:
    """Paths that are not drawn already."""
    found: dict[bytes, np.ndarray] = {}
    for path in paths:
        found.setdefault(np.round(path * 1e7).astype(int).tobytes(), path)
    return list(found.values())


def _coverage_legend(figure: Figure, planned: int, recorded: int, other_name: str) -> None:
    dot: dict[str, Any] = {"ls": "-", "marker": "o", "ms": 5.0}
    handles = [key(f"planned, {planned} runs", color=AFTER, **dot)]
    if recorded:
        look = dot | {"ls": "none", "mfc": "none"}
        handles.append(key(f"{other_name}, {recorded} runs", color=BEFORE, **look))
    legend(figure, handles, "upper center", ncols=2)


def criterion_by_runs(plan: Plan) -> Figure:
    """Draw how uncertainty by the plan's criterion falls with the number of runs, the comparison marked."""
    runs, values = plan.curve()
    bounds = np.array([plan.study.choose(int(n)).bound for n in runs])
    other = plan.comparison if plan.comparison and plan.comparison.determined else None
    one = other.value if other else plan.choice.value
    what = other.name if other else f"{len(plan.campaign.runs)} runs"
    figure, axes = panels(1, 1, 2.4, top=0.3, bottom=0.42, right=0.2)
    ax = axes[0, 0]
    ax.axhline(1.0, color=FAINT, lw=0.8, zorder=1)
    (limit,) = ax.plot(runs, np.sqrt(one / bounds), color=GREY, ls=DASHED, label="no plan is below")
    (line,) = ax.plot(runs, np.sqrt(one / values), color=AFTER, marker="o", ms=3.6, label="plans")
    handles, all_runs = [line, limit], [*runs]
    here = np.sqrt(one / plan.choice.value)
    handles += ax.plot(
        len(plan.campaign.runs),
        here,
        ls="none",
        marker="o",
        ms=7.5,
        mfc="none",
        color=BLACK,
        label="this plan",
    )
    if other:
        handles += ax.plot(other.runs, 1.0, ls="none", marker="D", ms=5.5, color=BEFORE, label=other.name)
        all_runs.append(other.runs)
    drawn = np.array([*np.sqrt(one / values), *np.sqrt(one / bounds), 1.0])
    log_axis(ax, "x", np.array(all_runs, dtype=float))
    log_axis(ax, "y", drawn)
    ax.grid(color=SHADE, lw=0.5, zorder=0)
    label_x(ax, "runs", 0.3)
    label_y(ax, f"uncertainty by {plan.study.criterion.name}, {what} = 1")
    legend(figure, handles, "upper center", ncols=4)
    return figure
