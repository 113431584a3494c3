"""Picture of a campaign: errors by setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.families.recording import as_read
from hallsym.log import Log, Weigh
from hallsym.report import picture as p
from hallsym.report.data.survey import MOST_SETTINGS, Group, Survey, held_out, look_over, settings
from hallsym.report.words import largest, name, scale

if TYPE_CHECKING:
    from hallsym.estimation import Evaluation


def fit_figure(log: Log, fit: Fit, keep: Weigh | None = None) -> p.Picture:
    """Return `errors_by_setting` of `fit` on `log`, which is read once, in blocks.

    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part.
    """
    return errors_by_setting(fit, look_over(as_read(log, fit.model, fit.corrections), fit, keep))


def evaluation_figure(found: Evaluation) -> p.Picture:
    """Return `errors_by_setting` of the log that was evaluated."""
    return errors_by_setting(found.applied, look_over(found.decoded, found.applied))


# -- `errors_by_setting`: rmse at each vertical setting, before and after --------------------------------


def errors_by_setting(fit: Fit, survey: Survey) -> p.Picture:
    """Return rmse by vertical setting (by run where there are no settings) before and after."""
    groups, title = settings(fit, survey)
    series, panels = _series(fit, survey, groups), []
    few = len(groups) <= MOST_SETTINGS
    for k, coordinate in enumerate(fit.model.pose):
        values = np.array([[_rmse(table, runs, k) for runs in sets] for _, table, sets, _, _ in series])
        floor = float(fit.noise_floor.get(coordinate, 0.0))
        factor, shown = scale(coordinate, largest(values), fit.model.period)
        place = np.arange(len(groups))
        layers: list[p.Layer] = [
            p.points(place + aside, factor * y, look, label)
            for (label, _, _, look, aside), y in zip(series, values, strict=True)
        ]
        layers += [p.level(factor * floor, label="noise floor")] if floor > 0 else []
        if few:  # a stroke from the least to the largest of each
            reach = np.array([np.fmin.reduce(values), np.fmax.reduce(values), np.full(len(groups), np.nan)])
            layers.append(p.line(np.repeat(place, 3), factor * reach.T.ravel(), p.Look(p.FAINT, width=0.6)))
        names = [label for label, _ in groups] if k == len(fit.model.pose) - 1 else ()
        x = p.Axis(title if names else "", -0.7, len(groups) - 0.3, names=names)
        panels.append(
            p.Panel(
                x,
                p.Axis(f"rmse {name(coordinate)} [{shown}]", log=bool((values > 0).any())),
                layers,
                height=97.0,
            )
        )
    return p.Picture(panels, across=1)


def _series(
    fit: Fit, survey: Survey, groups: Sequence[Group]
) -> list[tuple[str, ErrorTable, list[list[int]], p.Look, Any]]:
    """Label, error table, runs of each group, look and shift to the right of every series."""
    left_out, every = held_out(fit), [runs for _, runs in groups]
    used = [[r for r in runs if r not in left_out] for runs in every]
    holdout = [[r for r in runs if r in left_out] for runs in every]
    size = 4.2 if len(groups) <= 2 * MOST_SETTINGS else 2.0
    before, after, marked = (replace(look, size=size) for look in (p.BEFORE, p.AFTER, p.HOLDOUT))
    found: list[tuple[str, ErrorTable, list[list[int]], p.Look, Any]] = [
        ("nominal", survey.nominal, every, before, 0.0),
        ("fitted", survey.fitted, used, after, 0.0),
    ]
    if any(holdout):
        aside = np.array([0.25 if u and a else 0.0 for u, a in zip(used, holdout, strict=True)])
        found.append(("fitted, holdout runs", survey.fitted, holdout, marked, aside))
    return found


def _rmse(table: ErrorTable, runs: Sequence[int], k: int) -> float:
    found = table.over(runs) if runs else None
    return found["rmse"][table.pose[k]] if found else float("nan")
