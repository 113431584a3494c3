"""Picture `coverage` of a plan: what it covers beside what was recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.log import Log
from hallsym.report.figures.style import AFTER, BEFORE, SHADE, key, label_x, label_y, legend, panels
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


def coverage(plan: Plan, other: Campaign | Log | None = None, other_name: str = "recorded") -> Figure:
    """Draw vertical settings (area: number of runs) and paths of the motion, planned and recorded.

    `other`: a campaign or a log to draw beside the plan, called `other_name`.
    The path of a single pose coordinate is drawn over the run. A row shows three pairs of axes at most.
    """
    model = plan.study.model
    n, columns = len(model.pose), (*model.pose, *model.state)
    planned = list(_paths(plan.campaign, columns))
    shown = [] if other is None else list(_paths(other, columns, model.references))
    rows = [list(combinations(range(n), 2)) or [(len(columns), 0)]]
    if len(model.state) >= 2:
        rows.insert(0, list(combinations(range(n, len(columns)), 2)))
    across = min(3, max(map(len, rows)))
    figure, axes = panels(len(rows), across, 1.75, top=0.3, bottom=0.42, gaps=(0.72, 0.55), right=0.14)
    for line, pairs in zip(axes, rows, strict=True):
        for ax, at in zip(line, pairs, strict=False):
            words, factors = [], []
            for k in at:
                most = max(largest(path[k]) for path in planned + shown)
                factor, unit = scale(columns[k], most, model.period) if k < len(columns) else (100.0, "%")
                factors.append(factor)
                words.append(f"{name(columns[k]) if k < len(columns) else 'part of the run'} [{unit}]")
            draw = _settings if n <= at[0] < len(columns) else _motion
            draw(ax, shown, at, factors, BEFORE, False)
            draw(ax, planned, at, factors, AFTER, True)
            label_x(ax, words[0], 0.3)
            label_y(ax, words[1], 0.62)
            ax.margins(0.14)
            ax.grid(color=SHADE, lw=0.5, zorder=0)
        for ax in line[len(pairs) :]:
            ax.set_axis_off()
    dot: dict[str, Any] = {"ls": "-", "marker": "o", "ms": 5.0}
    handles = [key(f"planned, {len(planned)} runs", color=AFTER, **dot)]
    if shown:
        look = dot | {"ls": "none", "mfc": "none"}
        handles.append(key(f"{other_name}, {len(shown)} runs", color=BEFORE, **look))
    legend(figure, handles, "upper center", ncols=2)
    return figure


def _paths(
    source: Campaign | Log, columns: Sequence[str], references: Sequence[str] = ()
) -> Iterator[np.ndarray]:
    """Yield the position of every axis over each run, and last the part of the run, (columns + 1, points)."""
    if isinstance(source, Campaign):
        for run in source.runs:
            t = np.linspace(0.0, run.duration_s, POINTS)
            yield np.array([*(run.position(c, t) for c in columns), t / run.duration_s])
        return
    logged = (*references, *columns[len(references) :])
    parts: dict[int, list[np.ndarray]] = {}
    for block in source.blocks(logged):
        rows = np.array([block.data[c] for c in logged])
        parts.setdefault(block.run, []).append(rows[:, :: max(1, rows.shape[1] // POINTS)])
    for pieces in parts.values():
        path = np.hstack(pieces)
        yield np.vstack([path, np.linspace(0.0, 1.0, path.shape[1])])


def _settings(
    ax: Axes, paths: list[np.ndarray], at: tuple[int, int], factors: list[float], color: str, full: bool
) -> None:
    """A disc for each setting, its area the number of runs; a line where the axes move within a run."""
    if not paths:
        return
    middle = np.array(factors) * np.array([p[list(at)].mean(axis=1) for p in paths])
    places, count = np.unique(np.round(middle, 1), axis=0, return_counts=True)
    look: dict[str, Any] = (
        {"facecolors": color, "alpha": 0.75} if full else {"facecolors": "none", "edgecolors": color}
    )
    x, y = places.T
    ax.scatter(x, y, s=14.0 * count, zorder=3 if full else 4, linewidths=1.0, **look)
    _motion(ax, [p for p in paths if np.ptp(p[list(at)], axis=1).max() > 2e-6], at, factors, color, full)


def _motion(
    ax: Axes, paths: list[np.ndarray], at: tuple[int, int], factors: list[float], color: str, full: bool
) -> None:
    look: dict[str, Any] = {"lw": 0.9} if full else {"ls": "none", "marker": "o", "ms": 2.2, "mfc": "none"}
    distinct: dict[bytes, np.ndarray] = {}
    for path in (p[list(at)] for p in paths):
        distinct.setdefault(np.round(path * 1e7).astype(int).tobytes(), path)
    for path in distinct.values():
        step = 1 if full else max(1, path.shape[1] // CIRCLES)
        x, y = (f * row[::step] for f, row in zip(factors, path, strict=True))
        ax.plot(x, y, color=color, zorder=2 + full, **look)
