"""Picture `measured`: reference, decoded pose and readings of a few runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.log import Log, Weigh
from hallsym.report.data import COLUMNS, Survey, Trace, decoded, held_out, representative
from hallsym.report.figures.style import (
    AFTER,
    BLACK,
    DASHED,
    DASHES,
    LIGHT,
    SERIES,
    label_x,
    label_y,
    legend,
    panels,
)
from hallsym.report.words import LEVEL, largest, name, scale, setting, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRETCHES = tuple(2 * COLUMNS * 4**k for k in range(12))
"""Samples from the start of a run that are tried when the whole run would be a solid block."""
SMEAR = 0.025
"""Motion can be seen while it moves less than this share of its travel within one picture column."""


def measured(log: Log, fit: Fit, survey: Survey, keep: Weigh | None = None) -> Figure:
    """Draw reference, decoded pose and readings of the runs in which each pose coordinate moves most."""
    model = fit.model
    chosen = representative(survey)
    traces = _run_traces(log, fit, survey, chosen, keep)
    n, rows = len(model.pose), len(model.pose) + 1
    figure, axes = panels(rows, len(chosen), 1.16, top=0.42, bottom=0.62, sharex="col", sharey="row")
    every = [range(1 + k, 1 + 3 * n, n) for k in range(n)] + [range(1 + 3 * n, len(traces[0].low))]
    columns = (*model.pose, model.channels[0])
    scales = [scale(c, _largest(traces, k), model.period) for c, k in zip(columns, every, strict=True)]
    for row, word, (_, unit) in zip(axes, (*map(name, model.pose), "reading"), scales, strict=True):
        label_y(row[0], f"{word} [{unit}]")
    timed = survey.time is not None
    looks: tuple[tuple[str, dict[str, Any]], ...] = (
        ("reference", {"color": LIGHT, "lw": 3.2}),
        ("decoded, nominal parameters", {"color": BLACK, "lw": 0.7, "ls": DASHED}),
        ("decoded, fitted", {"color": AFTER, "lw": 0.9}),
    )
    for column, (run, trace) in enumerate(zip(chosen, traces, strict=True)):
        x = trace.low[0] - trace.low[0][0] if timed else trace.samples
        for k in range(n):
            for series, (label, look) in zip(every[k], looks, strict=True):
                at, y = trace.line(series, x)
                axes[k, column].plot(at, scales[k][0] * y, label=label, **look)
        for k, channel in enumerate(model.channels):
            at, y = trace.line(1 + 3 * n + k, x)
            look = {"color": SERIES[k % len(SERIES)], "ls": DASHES[k % len(DASHES)]}
            axes[n, column].plot(at, scales[n][0] * y, label=name(channel), **look)
        label_x(axes[n, column], "time in the run [s]" if timed else "sample of the run")
        axes[0, column].set_title(_run_title(fit, survey, run, trace), loc="left")
    legend(figure, axes[0, 0].lines, "upper center", ncols=len(looks))
    legend(figure, axes[n, 0].lines, "lower center", ncols=min(len(model.channels), 6))
    return figure


def _run_traces(log: Log, fit: Fit, survey: Survey, chosen: Sequence[int], keep: Weigh | None) -> list[Trace]:
    """Trace each chosen run from its start, as far as its motion can still be seen.

    Series: time, reference, pose by nominal parameters, fitted pose, readings.
    """
    model = fit.model
    sizes = dict(zip(survey.runs, np.diff(survey.edges), strict=True))
    lengths = {run: [s for s in STRETCHES if s < sizes[run]] + [sizes[run]] for run in chosen}
    n = 1 + 3 * len(model.pose) + len(model.channels)
    traces = {run: [Trace(n) for _ in lengths[run]] for run in chosen}
    seen: set[int] = set()
    for part in decoded(log, fit, keep):
        run = part.block.run
        if run not in traces:
            if len(seen) == len(traces):
                break
            continue
        seen.add(run)
        values = np.vstack([part.reference, part.nominal, part.fitted, part.rows(model.channels)])
        values = np.vstack([part.time, np.where(part.kept, values, np.nan)])
        for length, trace in zip(lengths[run], traces[run], strict=True):
            if trace.count < length:
                trace.add(values[:, : length - trace.count])
    most = survey.travel.max(axis=0)

    def clear(trace: Trace) -> bool:
        rows = slice(1, 1 + len(most))
        smear = np.nanmedian(trace.high[rows] - trace.low[rows], axis=1)
        return bool(np.all(smear <= SMEAR * most))

    return [next(filter(clear, reversed(traces[run])), traces[run][0]) for run in chosen]


def _largest(traces: Sequence[Trace], series: Sequence[int]) -> float:
    return max(largest(bounds[list(series)]) for t in traces for bounds in (t.low, t.high))


def _run_title(fit: Fit, survey: Survey, run: int, trace: Trace) -> str:
    k = survey.runs.index(run)
    what = "held out" if run in held_out(fit) else ""
    where = ""
    if len(fit.model.state) and not np.any(survey.drift[k] > 20 * LEVEL):
        where = setting(fit.model.state, survey.state[k], 5 * LEVEL, units=True, turning=fit.model.period)
    part = ""
    if trace.count < survey.edges[k + 1] - survey.edges[k]:
        seconds = trace.high[0, -1] - trace.low[0, 0]
        part = f"first {short(seconds)} s" if survey.time is not None else f"first {trace.count} samples"
    return ", ".join(filter(None, (f"run {run}", where, what, part)))
