"""Pictures of a campaign: errors by setting, and the gap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.families.recording import as_read
from hallsym.log import Log, Weigh
from hallsym.report.data.survey import MOST_SETTINGS, Group, Survey, held_out, look_over, settings
from hallsym.report.figures import style
from hallsym.report.words import largest, name, scale, thinned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.diagnosis import Diagnosis
    from hallsym.estimation import Evaluation


def fit_figure(log: Log, fit: Fit, keep: Weigh | None = None) -> Figure:
    """Draw `errors_by_setting` of `fit` on `log`, which is read once, in blocks.

    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part.
    """
    return errors_by_setting(fit, look_over(as_read(log, fit.model, fit.corrections), fit, keep))


def evaluation_figure(found: Evaluation) -> Figure:
    """Draw `errors_by_setting` of the log that was evaluated."""
    return errors_by_setting(found.applied, look_over(found.decoded, found.applied))


ACROSS, HEIGHT = 3, 1.4
"""Panels side by side, and how high each is [inches]."""


def gap(found: Diagnosis) -> Figure:
    """Draw the error on the holdout runs by output: of the model, with the effects found, and noise alone."""
    pose = list(found.noise_floor.outputs)
    across = min(len(pose), ACROSS)
    rows = -(-len(pose) // across)
    figure, axes = style.panels(rows, across, HEIGHT, top=0.3, bottom=0.3, gaps=(0.66, 0.34))
    for ax, c in zip(axes.flat, pose, strict=False):
        sizes = (found.gap_before.rmse[c], found.gap_after.rmse[c], found.noise_floor.outputs[c])
        factor, unit = scale(c, max(sizes))
        ax.bar((0, 1), [factor * size for size in sizes[:2]], color=(style.BEFORE, style.AFTER), width=0.6)
        ax.axhline(factor * sizes[2], color=style.BLACK, lw=0.8, ls=style.DASHED)
        ax.set_xticks((0, 1), ("model", "with effects"))
        ax.set_xlim(-0.6, 1.6)
        style.label_y(ax, f"rmse {name(c)} [{unit}]")
    for ax in axes.flat[len(pose) :]:
        ax.set_visible(False)
    label = f"noise floor ({found.noise_floor.source})"
    style.legend(figure, [style.key(label, color=style.BLACK, lw=0.8, ls=style.DASHED)], "upper left")
    return figure


# -- `errors_by_setting`: rmse at each vertical setting, before and after --------------------------------


def errors_by_setting(fit: Fit, survey: Survey) -> Figure:
    """Draw rmse by vertical setting (by run where there are no settings) before and after."""
    groups, title = settings(fit, survey)
    series, pose = _series(fit, survey, groups), fit.model.pose
    ticks = range(len(groups)) if len(groups) <= MOST_SETTINGS else thinned(len(groups), 12)
    turned = len(ticks) > 30 or any(not label.lstrip("-").isdigit() for label, _ in groups)
    longest = max((groups[k][0] for k in ticks), key=len)
    below = 0.12 + (style.text_width(longest) if turned else style.LINE)
    figure, axes = style.panels(len(pose), 1, 1.35, top=style.LINE + 0.12, bottom=below + 0.24, sharex=True)
    for k, (ax, coordinate) in enumerate(zip(axes[:, 0], pose, strict=True)):
        values = np.array([[_rmse(table, runs, k) for runs in sets] for _, table, sets, _, _ in series])
        floor = float(fit.noise_floor.get(coordinate, 0.0))
        factor, shown = scale(coordinate, largest(values), fit.model.period)
        for (label, _, _, look, aside), y in zip(series, factor * values, strict=True):
            ax.plot(np.arange(len(y)) + aside, y, ls="none", label=label, zorder=3, **look)
        if len(groups) <= MOST_SETTINGS:
            reach = np.fmin.reduce(factor * values), np.fmax.reduce(factor * values)
            ax.vlines(np.arange(len(groups)), *reach, color=style.FAINT, lw=0.6, zorder=1)
        if floor > 0:
            ax.axhline(
                factor * floor, color=style.BLACK, lw=0.8, ls=style.DASHED, label="noise floor", zorder=2
            )
        style.log_axis(ax, "y", factor * np.array([*values.ravel(), floor]))
        ax.grid(axis="y", which="major", color=style.SHADE, lw=0.5, zorder=0)
        style.label_y(ax, f"rmse {name(coordinate)} [{shown}]")
    last = axes[-1, 0]
    last.set_xticks(list(ticks), [groups[k][0] for k in ticks], rotation=90 if turned else 0)
    if len(ticks) > 30:
        last.tick_params("x", labelsize=7)
    last.set_xlim(-0.7, len(groups) - 0.3)
    style.label_x(axes[-1, 0], title, below + 0.03)
    handles = axes[0, 0].get_legend_handles_labels()[0]
    style.legend(figure, handles, "upper center", ncols=len(handles), handlelength=1.8, columnspacing=1.4)
    return figure


def _series(
    fit: Fit, survey: Survey, groups: Sequence[Group]
) -> list[tuple[str, ErrorTable, list[list[int]], dict[str, Any], Any]]:
    """Label, error table, runs of each group, look and shift to the right of every series."""
    held, every = held_out(fit), [runs for _, runs in groups]
    used = [[r for r in runs if r not in held] for runs in every]
    holdout = [[r for r in runs if r in held] for runs in every]
    size = {"ms": 4.2 if len(groups) <= 2 * MOST_SETTINGS else 2.0}
    before = {"marker": "s", "mfc": "white", "color": style.BEFORE}
    after = {"marker": "o", "mfc": style.AFTER, "color": style.AFTER}
    found: list[tuple[str, ErrorTable, list[list[int]], dict[str, Any], Any]] = [
        ("nominal", survey.nominal, every, before | size, 0.0),
        ("fitted", survey.fitted, used, after | size, 0.0),
    ]
    if any(holdout):
        look = {"marker": "D", "mfc": "white", "color": style.AFTER}
        aside = np.array([0.25 if u and a else 0.0 for u, a in zip(used, holdout, strict=True)])
        found.append(("fitted, held-out runs", survey.fitted, holdout, look | size, aside))
    return found


def _rmse(table: ErrorTable, runs: Sequence[int], k: int) -> float:
    found = table.over(runs) if runs else None
    return found["rmse"][table.pose[k]] if found else float("nan")
