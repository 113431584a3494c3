"""Pictures of a campaign: what was measured, errors over it and by setting, parameters, and the gap."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Collection, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import ErrorTable, Fit, as_read
from hallsym.log import Log, Weigh
from hallsym.report.data.gather import compared, version_of
from hallsym.report.data.survey import (
    COLUMNS,
    MOST_SETTINGS,
    Group,
    Survey,
    Trace,
    decoded,
    held_out,
    look_over,
    representative,
    settings,
)
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    DASHES,
    FAINT,
    GREY,
    LEFT,
    LIGHT,
    LINE,
    SERIES,
    SHADE,
    bands,
    key,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
    row_panels,
    text_width,
)
from hallsym.report.words import (
    LEVEL,
    MINUS,
    largest,
    name,
    plus_minus,
    scale,
    setting,
    short,
    thinned,
    three,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.diagnosis import Diagnosis, Examined
    from hallsym.estimation import Evaluation


def save_pictures(log: Log, fit: Fit, folder: str | Path | Place, *, keep: Weigh | None = None) -> list[Path]:
    """Draw the pictures of `fit` on `log` into `folder` (made if missing) and return the files written.

    `measured`, `errors_before_after`, `errors_by_setting` and `parameters`. `keep(block) -> (samples,)`
    weights; samples of weight 0 (outliers) take no part and are marked. The log is read twice, in blocks.
    """
    found = _of_errors(as_read(log, fit.model, fit.wiring), fit, keep)
    return save_figures(found | {"parameters": lambda: parameters(fit)}, folder)


TITLES = "Nominal parameters", "Calibration"


def save_evaluation(found: Evaluation, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of an evaluation into `folder` (made if missing) and return the files written.

    `measured`, `errors_before_after` (left by nominal parameters, right by the calibration) and
    `errors_by_setting`; each as for a fit, of the log that was evaluated.
    """
    return save_figures(_of_errors(found.decoded, found.applied, titles=TITLES), folder)


def _of_errors(
    log: Log, fit: Fit, keep: Weigh | None = None, titles: tuple[str, str] | None = None
) -> dict[str, Callable[[], Figure]]:
    survey = cache(lambda: look_over(log, fit, keep))  # once, and only when the folder is there
    return {
        "measured": lambda: measured(log, fit, survey(), keep),
        "errors_before_after": lambda: errors_before_after(fit, survey(), titles),
        "errors_by_setting": lambda: errors_by_setting(fit, survey()),
    }


ACROSS, HEIGHT = 3, 1.4
"""Panels side by side, and how high each is [inches]."""


def gap(found: Diagnosis, period: Collection[str] | None = None) -> Figure:
    """Draw the error on the holdout runs by output: of the model, with the effects found, and noise alone.

    `period`: coordinates of the pose that repeat, which are read in degrees.
    """
    pose = list(found.noise_floor.outputs)
    across = min(len(pose), ACROSS)
    rows = -(-len(pose) // across)
    figure, axes = panels(rows, across, HEIGHT, top=0.3, bottom=0.3, gaps=(0.66, 0.34))
    for ax, c in zip(axes.flat, pose, strict=False):
        sizes = (found.gap_before.rmse[c], found.gap_after.rmse[c], found.noise_floor.outputs[c])
        factor, unit = scale(c, max(sizes), period)
        ax.bar((0, 1), [factor * size for size in sizes[:2]], color=(BEFORE, AFTER), width=0.6)
        ax.axhline(factor * sizes[2], color=BLACK, lw=0.8, ls=DASHED)
        ax.set_xticks((0, 1), ("model", "with effects"))
        ax.set_xlim(-0.6, 1.6)
        label_y(ax, f"rmse {name(c)} [{unit}]")
    for ax in axes.flat[len(pose) :]:
        ax.set_visible(False)
    label = f"noise floor ({found.noise_floor.source})"
    legend(figure, [key(label, color=BLACK, lw=0.8, ls=DASHED)], "upper left")
    return figure


def save_diagnosis(seen: Examined, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of a diagnosis into `folder` (made if missing) and return the files written.

    `errors_before_after` (left the model, right with the effects found; nominal and fitted parameters where
    none was) and `gap`.
    """
    found, fit = seen.diagnosis, seen.fit
    log = seen.before.log
    titles = ("Model fitted", "With effects found") if seen.after else None

    def survey() -> Survey:
        first = look_over(log, fit, fit.keep)
        if seen.after is None:
            return first
        return compared(first, fit, version_of(seen.before, "before"), version_of(seen.after, "after"))

    return save_figures(
        {
            "errors_before_after": lambda: errors_before_after(fit, survey(), titles),
            "gap": lambda: gap(found, fit.model.period),
        },
        folder,
    )


# -- `measured`: reference, decoded pose and readings of a few runs --------------------------------------


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


# -- `errors_before_after`: errors of the decoded pose along the campaign --------------------------------


BAND = 3.0
"""Half-width of the noise band in noise floors: 99.7 % of Gaussian errors lie inside."""


def errors_before_after(fit: Fit, survey: Survey, titles: tuple[str, str] | None = None) -> Figure:
    """Draw the errors of the decoded pose over the whole campaign: nominal parameters left, fitted right.

    `titles`: what the two sides are, where they are something else.

    Every sample counts: of each picture column the least and the greatest error are drawn. The two sides have
    scales of their own, and the right one says by how much it is finer.
    """
    model = fit.model
    n = len(model.pose)
    figure, axes = panels(n, 2, 1.17, top=0.45, bottom=0.62, gaps=(LEFT + 0.06, 0.28), sharex=True)
    tables, highest = (survey.nominal, survey.fitted), np.zeros((n, 2))
    for column, (trace, table) in enumerate(zip(survey.errors, tables, strict=True)):
        for k, coordinate in enumerate(model.pose):
            floor = float(fit.noise_floor.get(coordinate, 0.0))
            peak = max(float(table.peak[:, k].max()), largest(trace.low[k]), largest(trace.high[k]))
            highest[k, column] = max(peak, 1.15 * BAND * floor) or 1e-12
            factor, unit = scale(coordinate, highest[k, column], model.period)
            ax = axes[k, column]
            _campaign_axis(ax, fit, survey)
            x, y = trace.line(k, _campaign_x(survey, trace), survey.edges[1:-1])
            ax.plot(x, factor * y, color=(BEFORE, AFTER)[column], lw=(0.8, 0.5)[column], zorder=2)
            band = (-BAND * factor * floor, BAND * factor * floor)
            ax.hlines(
                band, 0, 1, transform=ax.get_yaxis_transform(), color=BLACK, lw=0.7, ls=DASHED, zorder=3
            )
            limit = 1.08 * factor * highest[k, column]
            ax.ticklabel_format(axis="y", style="plain", useOffset=False)
            ax.set_ylim(-limit * (1.1 if survey.n_rejected else 1.0), limit)
            label_y(ax, f"error in {name(coordinate)} [{unit}]")
            ax.set_title(_error_words(table, k, fit, held_out(fit) if column else ()), loc="left")
    ratios = highest[:, 0] / highest[:, 1]
    finer = ", ".join(">10000" if ratio > 1e4 else short(float(f"{ratio:.2g}")) for ratio in ratios)
    for ax in axes[-1]:
        label_x(ax, _campaign_label(survey))
    left, right = titles or (_nominal_words(fit), "Fitted")
    for ax, title in zip(axes[0], (left, f"{right}; scales {finer} × finer"), strict=True):
        ax.set_title(f"{title}\n{ax.get_title('left')}", loc="left", linespacing=1.6)
    _campaign_legend(figure, fit, survey)
    return figure


def _nominal_words(fit: Fit) -> str:
    return "Nominal parameters" + (", no zero deviations" if fit.model.zeros else "")


def _error_words(table: ErrorTable, k: int, fit: Fit, holdout: Sequence[int]) -> str:
    """Return rmse and peak of coordinate `k`, those of the runs in `holdout` by themselves."""
    coordinate = table.pose[k]
    used, others = table.over([r for r in table.runs if r not in holdout]), table.over(holdout)
    factor, unit = scale(coordinate, float(table.peak[:, k].max()), fit.model.period)
    texts = [
        f"{label} {three(factor * row['rmse'][coordinate])}, {word}{three(factor * row['peak'][coordinate])}"
        for label, word, row in (
            ("rmse", "peak ", used),
            ("held out" if used else "held out: rmse", "", others),
        )
        if row
    ]
    return f"{'; '.join(texts)} {unit}" if texts else "no samples"


def _campaign_x(survey: Survey, trace: Trace) -> np.ndarray:
    if len(survey.runs) == 1 and survey.time is not None:
        return survey.time.low[0] - survey.time.low[0][0]
    return trace.samples


def _campaign_label(survey: Survey) -> str:
    if len(survey.runs) == 1:
        return "time [s]" if survey.time is not None else "sample"
    return "run (as wide as its number of samples)"


def _campaign_axis(ax: Axes, fit: Fit, survey: Survey) -> None:
    """Shade held-out runs, separate runs, number them, and mark rejected samples at the bottom."""
    edges, held = survey.edges - 0.5, held_out(fit)
    x = _campaign_x(survey, survey.rejected)
    hit = np.flatnonzero(np.isfinite(survey.rejected.high[0]))
    if len(hit):
        ax.plot(x[hit], np.full(len(hit), 0.02), transform=ax.get_xaxis_transform(), ls="none", marker="|",
                ms=4, mew=0.6, color=GREY, zorder=4)  # fmt: skip
    if len(survey.runs) == 1:
        ax.set_xlim(x[0], x[-1] if x[-1] > x[0] else x[0] + 1)
        return
    shaded = [(edges[k], edges[k + 1]) for k, run in enumerate(survey.runs) if run in held]
    bands(ax, shaded, SHADE, upright=True)
    if len(survey.runs) <= 80:
        ax.vlines(edges[1:-1], 0, 1, transform=ax.get_xaxis_transform(), color=FAINT, lw=0.3, zorder=1)
    pick = thinned(len(survey.runs), 8)
    ax.set_xticks([float(edges[k : k + 2].mean()) for k in pick], [str(survey.runs[k]) for k in pick])
    ax.set_xlim(edges[0], edges[-1])


def _campaign_legend(figure: Figure, fit: Fit, survey: Survey) -> None:
    from matplotlib.patches import Patch

    label = f"±{BAND:g} × noise floor (99.7 % of pure noise)"
    handles: list[Any] = [key(label, color=BLACK, lw=0.7, ls=DASHED)]
    if set(held_out(fit)) & set(survey.runs) and len(survey.runs) > 1:
        handles.append(Patch(facecolor=SHADE, label="held-out run"))
    if survey.n_rejected:
        label = f"rejected sample ({survey.n_rejected})"
        handles.append(key(label, color=GREY, ls="none", marker="|", ms=6))
    legend(figure, handles, "lower center", ncols=len(handles), columnspacing=1.4, handlelength=2.0)


# -- `errors_by_setting`: rmse at each vertical setting, before and after --------------------------------


def errors_by_setting(fit: Fit, survey: Survey) -> Figure:
    """Draw rmse by vertical setting (by run where there are no settings) before and after."""
    groups, title = settings(fit, survey)
    series = _series(fit, survey, groups)
    ticks, below = _tick_words(groups)
    pose = fit.model.pose
    figure, axes = panels(len(pose), 1, 1.35, top=LINE + 0.12, bottom=below + 0.24, sharex=True)
    for k, (ax, coordinate) in enumerate(zip(axes[:, 0], pose, strict=True)):
        values = np.array([[_rmse(table, runs, k) for runs in sets] for _, table, sets, _, _ in series])
        floor = float(fit.noise_floor.get(coordinate, 0.0))
        factor, shown = scale(coordinate, largest(values), fit.model.period)
        for (label, _, _, look, aside), y in zip(series, factor * values, strict=True):
            ax.plot(np.arange(len(y)) + aside, y, ls="none", label=label, zorder=3, **look)
        if len(groups) <= MOST_SETTINGS:
            reach = np.fmin.reduce(factor * values), np.fmax.reduce(factor * values)
            ax.vlines(np.arange(len(groups)), *reach, color=FAINT, lw=0.6, zorder=1)
        if floor > 0:
            ax.axhline(factor * floor, color=BLACK, lw=0.8, ls=DASHED, label="noise floor", zorder=2)
        log_axis(ax, "y", factor * np.array([*values.ravel(), floor]))
        ax.grid(axis="y", which="major", color=SHADE, lw=0.5, zorder=0)
        label_y(ax, f"rmse {name(coordinate)} [{shown}]")
    _number(axes[-1, 0], groups, ticks)
    label_x(axes[-1, 0], title, below + 0.03)
    handles = axes[0, 0].get_legend_handles_labels()[0]
    legend(figure, handles, "upper center", ncols=len(handles), handlelength=1.8, columnspacing=1.4)
    return figure


def _series(
    fit: Fit, survey: Survey, groups: Sequence[Group]
) -> list[tuple[str, ErrorTable, list[list[int]], dict[str, Any], Any]]:
    """Label, error table, runs of each group, look and shift to the right of every series."""
    held, every = held_out(fit), [runs for _, runs in groups]
    used = [[r for r in runs if r not in held] for runs in every]
    holdout = [[r for r in runs if r in held] for runs in every]
    size = {"ms": 4.2 if len(groups) <= 2 * MOST_SETTINGS else 2.0}
    before = {"marker": "s", "mfc": "white", "color": BEFORE}
    after = {"marker": "o", "mfc": AFTER, "color": AFTER}
    found: list[tuple[str, ErrorTable, list[list[int]], dict[str, Any], Any]] = [
        ("nominal", survey.nominal, every, before | size, 0.0),
        ("fitted", survey.fitted, used, after | size, 0.0),
    ]
    if any(holdout):
        look = {"marker": "D", "mfc": "white", "color": AFTER}
        aside = np.array([0.25 if u and a else 0.0 for u, a in zip(used, holdout, strict=True)])
        found.append(("fitted, held-out runs", survey.fitted, holdout, look | size, aside))
    return found


def _rmse(table: ErrorTable, runs: Sequence[int], k: int) -> float:
    pick = [table.runs.index(run) for run in runs if run in table.runs]
    count = float(table.count[pick].sum()) if pick else 0.0
    return float(np.sqrt(table.squares[pick, k].sum() / count)) if count else float("nan")


def _tick_words(groups: Sequence[Group]) -> tuple[Sequence[int], float]:
    """Which groups get a label, and how many inches the labels take below the axis."""
    ticks = range(len(groups)) if len(groups) <= MOST_SETTINGS else thinned(len(groups), 12)
    longest = max((groups[k][0] for k in ticks), key=len)
    return ticks, 0.12 + (text_width(longest) if _turned(groups, ticks) else LINE)


def _turned(groups: Sequence[Group], ticks: Sequence[int]) -> bool:
    return len(ticks) > 30 or any(not label.lstrip("-").isdigit() for label, _ in groups)


def _number(ax: Axes, groups: Sequence[Group], ticks: Sequence[int]) -> None:
    rotation = 90 if _turned(groups, ticks) else 0
    ax.set_xticks(list(ticks), [groups[k][0] for k in ticks], rotation=rotation)
    if len(ticks) > 30:
        ax.tick_params("x", labelsize=7)
    ax.set_xlim(-0.7, len(groups) - 0.3)


# -- `parameters`: every parameter within its bounds, how sharp it is, and the numbers to copy -----------


COVERAGE = 1.96
"""Standard deviations in half a 95 % interval."""
ROW = 0.155  # inches
POINT: dict[str, Any] = {"ls": "none", "ms": 4.2, "color": AFTER}
NOMINAL: dict[str, Any] = {"ls": "none", "mew": 1.2, "color": BEFORE}


def parameters(fit: Fit) -> Figure:
    """Draw every parameter within its bounds, how narrow its 95 % interval is, and the numbers to copy.

    Left: nominal value and estimate, 0 at the lower and 1 at the upper bound; hollow where the data do not
    determine it. Middle: half the 95 % interval as a share of the bounds. Combinations that the data
    determine instead stand below.
    """
    model, n = fit.model, len(fit.model.parameters)
    words = [_number_words(fit, row) for row in range(n)]
    instead = [plus_minus(c.value, c.half_width, c.unit) for c in fit.combinations]
    header = "estimate ± 95 %"
    right = 0.14 + max(map(text_width, (*words, *instead, header)))
    below = [textwrap.wrap(typeset(c.expression), 84) for c in fit.combinations]
    extra = sum(map(len, below)) + 1.5 if below else 0.0
    figure, (place, sharp) = row_panels(
        model.names, 2, ROW, right=right, gap=0.34, top=0.4, bottom=0.52 + ROW * extra,
        gridspec_kw={"width_ratios": (3, 2)},
    )  # fmt: skip
    _values(place, sharp, fit)
    for row, text in enumerate(words):
        _beside(sharp, row, text)
    _beside(sharp, -1.1, header)
    place.set_xlim(-0.04, 1.04)
    label_x(place, "position within the bounds")
    place.set_xticks((0, 0.25, 0.5, 0.75, 1), ("lower", "", "middle", "", "upper"))
    _precision_axis(sharp, fit)
    if below:
        _combinations(figure, below, instead, right)
    _parameter_legend(figure, fit)
    return figure


def _values(place: Axes, sharp: Axes, fit: Fit) -> None:
    """Draw nominal values, estimates and intervals."""
    lower, upper = fit.model.bounds
    width = np.asarray(upper, dtype=float) - lower
    bounded = np.isfinite(width) & (width > 0)
    for k in np.flatnonzero(~bounded):
        word = "fixed" if width[k] == 0 else "no bounds"
        place.text(0.5, float(k), word, ha="center", va="center_baseline", color=GREY)
    rows = np.flatnonzero(bounded)
    nominal = (np.asarray(fit.model.nominal)[rows] - lower[rows]) / width[rows]
    at, known = (fit.values[rows] - lower[rows]) / width[rows], np.asarray(fit.determined)[rows]
    edge = np.isin(np.array(fit.model.names)[rows], fit.at_bound)
    drawn = np.clip(nominal, -0.03, 1.03)
    place.hlines(rows, drawn, at, color=FAINT, lw=0.8, zorder=1)
    for marker, size, pick in (
        ("|", 6, drawn == nominal),
        (">", 4, drawn < nominal),
        ("<", 4, drawn > nominal),
    ):
        place.plot(drawn[pick], rows[pick], marker=marker, ms=size, **NOMINAL, zorder=2)
    for marker, face, pick in (
        ("s", AFTER, edge),
        ("o", AFTER, known & ~edge),
        ("o", "white", ~known & ~edge),
    ):
        place.plot(at[pick], rows[pick], marker=marker, mfc=face, **POINT, zorder=3)
    half = np.where(known, fit.half_width[rows], np.nan) / width[rows]
    ends = at[known] - half[known], at[known] + half[known]
    place.hlines(rows[known], *ends, color=AFTER, lw=1.4, zorder=2, capstyle="butt")
    sharp.plot(100 * half[half > 0], rows[half > 0], marker="o", **POINT, zorder=3)


def _number_words(fit: Fit, row: int) -> str:
    """The estimate with its interval, or why there is none."""
    p = fit.model.parameters[row]
    if p.width == 0:
        return "fixed"
    if p.name in fit.at_bound:
        return "at its bound"
    if fit.determined[row]:
        return plus_minus(float(fit.values[row]), float(fit.half_width[row]), p.unit)
    return "not identifiable, fixed" if p.name in fit.held else "not identifiable"


def _beside(ax: Axes, row: float, text: str) -> None:
    """Write to the right of a row."""
    ax.text(1.03, row, text, transform=ax.get_yaxis_transform(), va="center_baseline")


def _combinations(figure: Figure, below: Sequence[list[str]], instead: Sequence[str], right: float) -> None:
    """List the identifiable combinations, one picture row per line."""
    width, height = figure.get_size_inches()
    rows = [("Identifiable combinations", "")]
    for lines, value in zip(below, instead, strict=True):
        indents = (1, *[3] * (len(lines) - 1))
        rows += [(" " * i + line, "") for i, line in zip(indents, lines, strict=True)]
        rows[-1] = (rows[-1][0], value)
    for k, (text, value) in enumerate(reversed(rows)):
        y = (0.06 + ROW * k) / height
        figure.text(0.1 / width, y, text)
        figure.text(1 - (right - 0.06) / width, y, value)


def typeset(expression: str) -> str:
    """Return an expression as it is printed: minus signs, no stars."""
    return re.sub(r"(?<!e)-", MINUS, expression.replace("*", " "))


def _precision_axis(ax: Axes, fit: Fit) -> None:
    width = np.array([p.width for p in fit.model.parameters])
    with np.errstate(divide="ignore", invalid="ignore"):
        half = 100 * fit.half_width / width
    half = half[np.isfinite(half) & (half > 0)]
    label_x(ax, "half of the 95 % interval\n[% of the bounds' width]")
    if len(half):
        log_axis(ax, "x", np.array([*half, 0.1, 1.0]))
    else:
        ax.set_xticks([])


def _parameter_legend(figure: Figure, fit: Fit) -> None:
    handles = [
        key("nominal", marker="|", ms=6, **NOMINAL),
        key("estimate", marker="o", **POINT),
    ]
    lower, upper = fit.model.bounds
    if np.any((fit.model.nominal < lower - 0.03 * (upper - lower)) | (fit.model.nominal > upper)):
        beyond = key("nominal beyond the bounds", marker=">", ms=4, **NOMINAL)
        handles.insert(1, beyond)
    if fit.at_bound:
        handles.append(key("estimate at its bound", marker="s", **POINT))
    if not np.all(fit.determined):
        handles.append(key("not identifiable from the data", marker="o", mfc="white", **POINT))
    legend(figure, handles, "upper left", ncols=len(handles))
