"""Picture `errors_before_after`: errors of the decoded pose along the campaign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import ErrorTable, Fit
from hallsym.report.data import Survey, Trace, held_out
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    FAINT,
    GREY,
    LEFT,
    SHADE,
    bands,
    key,
    label_x,
    label_y,
    legend,
    panels,
)
from hallsym.report.words import largest, name, scale, short, thinned, three

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
