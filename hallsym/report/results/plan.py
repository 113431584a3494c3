"""What a person reads of a plan, in um and urad."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from hallsym.errors import counted
from hallsym.experiment import Plan, Worst
from hallsym.log import Log, as_log
from hallsym.output import said_time
from hallsym.report import picture as p
from hallsym.report.content import Content, Section, Table
from hallsym.report.words import each, largest, name, number, scale
from hallsym.simulation import Campaign


def plan_content(plan: Plan) -> Content:
    """Return what is said of a plan: what it determines, and the runs."""
    study, n = plan.study, len(plan.campaign.runs)
    long, resets = study.ranges.seconds_per_run, study.ranges.reset_s
    time = said_time(60 * plan.minutes) + ("" if resets is not None else " without resets")
    pose, period = study.model.pose, study.model.period
    worst = dict(zip(pose, plan.position, strict=True))
    uncertain = f"worst u (1 sigma) of the position over the ranges: {each(worst, period)}"
    if study.criterion.name == "max-u":
        counted_in = dict(zip(pose, study.ranges.references(pose), strict=True))
        uncertain += f" (counted in {each(counted_in, period)})"
    before: list[str] = []
    if plan.before is not None:
        recorded = counted(plan.recorded, "run")
        before = [f"worst-determined combination of the {recorded} recorded: {worst_text(plan.before)}"]
    rows = [[str(k), setting, trajectory] for k, setting, trajectory in plan.groups()]
    return Content(
        f"Plan for {study.model.name}",
        f"{counted(n, 'run')} of {long:g} s ({time}); worst-determined combination with the plan: "
        f"{worst_text(plan.after)}.",
        [Section("runs", "Runs", [Table(["runs", "setting", "trajectory"], rows, "runs to record", left=3)])],
        [
            f"{study.model.name}: criterion {study.criterion.name}, from {len(study.candidates)} candidates",
            *before,
            uncertain,
        ],
        pictures={"coverage": lambda log: coverage(plan, None if log is None else as_log(log))},
        seconds=plan.seconds,
        columns=dict(
            zip(("runs", "setting", "trajectory"), map(list, zip(*plan.groups(), strict=True)), strict=True)
        ),
    )


def worst_text(worst: Worst) -> str:
    """Return the combination and how well it is known."""
    if worst.std is None:
        return f"{worst.text}, not determined"
    known = f"known to {number(100 * worst.std, 2)} % (1 sigma)"
    return f"{worst.text}, {known}, each over the width of its bounds"


# -- picture: planned and recorded settings and paths ---------------------------------------------------


POINTS = 240
"""Points of a path that are drawn."""
CIRCLES = 60
"""Of the other campaign's path, so many points are drawn as circles."""
PLANNED, RECORDED = replace(p.AFTER, size=3.7), p.Look(p.BEFORE.color, marker="o", size=3.7)


def coverage(plan: Plan, other: Campaign | Log | None = None, other_name: str = "recorded") -> p.Picture:
    """Return vertical settings (area: number of runs) and paths of the motion, planned and recorded.

    `other`: a campaign or a log to draw beside the plan, called `other_name`.
    The path of a single pose coordinate is drawn over the run. A row shows three panels at most.
    """
    model = plan.study.model
    n, columns = len(model.pose), (*model.pose, *model.state)
    planned = list(_paths(plan.campaign, columns))
    shown = [] if other is None else list(_paths(other, columns, model.references))
    drawn = [(planned, PLANNED, f"planned, {len(planned)} runs")]
    drawn += [(shown, RECORDED, f"{other_name}, {len(shown)} runs")] if shown else []
    pairs = list(combinations(range(n), 2)) or [(len(columns), 0)]
    pairs = [*combinations(range(n, len(columns)), 2), *pairs]
    panels = []
    for at in pairs:
        words, factors = [], []
        for k in at:
            most = max(largest(path[k]) for path in planned + shown)
            factor, unit = scale(columns[k], most, model.period) if k < len(columns) else (100.0, "%")
            factors.append(factor)
            words.append(f"{name(columns[k]) if k < len(columns) else 'part of the run'} [{unit}]")
        layers: list[p.Layer] = []
        for paths, look, label in drawn:
            here, shows = (
                [path[list(at)] for path in paths],
                _settings if n <= at[0] < len(columns) else _motion,
            )
            layers += shows(here, np.array(factors), look, label)
        panels.append(p.Panel(p.Axis(words[0]), p.Axis(words[1]), layers, height=126.0))
    return p.Picture(panels)


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


def _settings(paths: list[np.ndarray], factors: np.ndarray, look: p.Look, label: str) -> list[p.Layer]:
    """A disc for each setting, its area the number of runs; a line where the axes move within a run."""
    middle = factors * np.array([path.mean(axis=1) for path in paths])
    places, count = np.unique(np.round(middle, 1), axis=0, return_counts=True)
    moved = [path for path in paths if np.ptp(path, axis=1).max() > 2e-6]
    discs = []
    for n in np.unique(count):
        x, y = places[count == n].T
        discs.append(p.points(x, y, replace(look, size=look.size * n**0.5), label))
    return [*discs, *_motion(moved, factors, look, label)]


def _motion(paths: list[np.ndarray], factors: np.ndarray, look: p.Look, label: str) -> list[p.Layer]:
    distinct = {np.round(path * 1e7).astype(int).tobytes(): factors[:, None] * path for path in paths}
    if look.face != "none":
        return [p.line(x, y, look, label) for x, y in distinct.values()]
    thin = [path[:, :: max(1, path.shape[1] // CIRCLES)] for path in distinct.values()]
    return [p.points(x, y, replace(look, size=2.2), label) for x, y in thin]
