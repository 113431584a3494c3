"""Pictures of a budget, of U over the workspace, and of errors along a coordinate by cause."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.report.figures import style
from hallsym.report.text.tolerances import span
from hallsym.report.words import MINUS, largest, name, scale, setting, short, three
from hallsym.units import fitting, typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.uncertainty import Budget, ErrorModel, UncertaintyMap

MOST_BARS = 12
"""Sources shown one by one; the others are one bar."""
COLOURS = "viridis"
BAR = 0.17  # inches


def budget_bars(budgets: Mapping[str, Budget], *, worst: bool = False) -> Figure:
    """Draw the share of every source in u_c squared: one row per source, one column per quantity.

    `worst`: the budgets are those of the worst position of each coordinate, which the picture then says.
    """
    labels, shares = _bars(list(budgets.values()))
    margin = 0.12 + max(map(style.text_width, labels))
    figure, axes = style.panels(
        1, len(budgets), BAR * len(labels) + 0.1, top=2.6 * style.LINE, bottom=0.46, left=margin, right=0.1,
        gaps=(0.16, 0.12), sharey=True,
    )  # fmt: skip
    place = np.arange(len(labels))
    colours = [style.FAINT if label.startswith("other ") else style.AFTER for label in labels]
    for ax, percent, budget in zip(axes[0], 100 * shares, budgets.values(), strict=True):
        ax.barh(place, percent, height=0.72, color=colours)
        for y, value in zip(place, percent, strict=True):
            words = three(value) if abs(value) >= 0.1 else "0" if abs(value) < 1e-9 else "<0.1"
            ax.annotate(words, (max(value, 0), y), (2, 0), textcoords="offset points", va="center")
        ax.set_yticks(place, labels)
        ax.tick_params(axis="y", length=0)
        ax.set(ylim=(len(labels) - 0.4, -0.6), xlim=(min(0.0, percent.min()), 1.3 * max(percent.max(), 1.0)))
        factor, unit = fitting(budget.unit, budget.expanded, turns=budget.turns)
        what = name(budget.quantity) if budget.value is not None else budget.quantity
        size = f"U = {three(budget.expanded * factor)} {typeset(unit)} (k = {budget.factor:.3g})"
        title = f"{what}{', worst position' if worst else ''}\n{size}"
        ax.set_title(title, loc="left", linespacing=1.4)
        style.label_x(ax, "share of $u_c^2$ [%]", 0.26)
    return figure


def _bars(budgets: Sequence[Budget]) -> tuple[list[str], np.ndarray]:
    """Sources by their largest share in any budget, the small ones as one, and shares (budgets, sources)."""
    names = list(dict.fromkeys(source.name for budget in budgets for source in budget.sources))
    shares = np.zeros((len(budgets), len(names)))
    for row, budget in zip(shares, budgets, strict=True):
        for source, share in zip(budget.sources, budget.shares, strict=True):
            row[names.index(source.name)] = share
    order = np.argsort(-np.abs(shares).max(axis=0), kind="stable")
    names, shares = [names[k] for k in order], shares[:, order]
    if len(names) <= MOST_BARS:
        return names, shares
    rest = shares[:, MOST_BARS - 1 :].sum(axis=1, keepdims=True)
    kept = MOST_BARS - 1
    return [*names[:kept], f"other {len(names) - kept} sources"], np.hstack([shares[:, :kept], rest])


def uncertainty_picture(grid: UncertaintyMap) -> Figure:
    """Draw U over the axes of `grid`: a line over one axis; else maps over the first two.

    Maps have a row per pose coordinate and a column per value of the third axis.
    """
    column, values = next(iter(grid.axes.items()))
    if len(grid.axes) == 1:
        across, shown = scale(column, largest(values), grid.turning)
        label = f"{name(column)} [{shown}]"
        figure = _lines(grid.pose, grid.expanded, across * values, label, grid.turning, top=1.7 * style.LINE)
    else:
        figure = _maps(grid)
    fixed = setting(
        list(grid.fixed), np.array(list(grid.fixed.values())), 0.0, units=True, turning=grid.turning
    )
    level, coverage = grid.settings.level, grid.settings.coverage
    figure.text(
        0.03 / style.WIDTH, 1 - 0.05 / figure.get_size_inches()[1],
        f"Expanded uncertainty U ({f'k = {coverage:g}' if level is None else f'{100 * level:g} %'}) of the "
        "decoded position" + (f" at {fixed}" if fixed != "level" else ""),
        va="top",
    )  # fmt: skip
    return figure


def _lines(
    pose: Sequence[str], U: np.ndarray, place: np.ndarray, label: str, turning: Collection[str], top: float
) -> Figure:
    figure, axes = style.panels(len(pose), 1, 1.4, top=top, bottom=0.44, right=0.14, sharex=True)
    for ax, coordinate, own in zip(axes[:, 0], pose, U, strict=True):
        factor, unit = scale(coordinate, largest(own), turning)
        ax.plot(place, factor * own, color=style.AFTER)
        ax.set_ylim(0.0, 1.15 * factor * own.max())
        style.label_y(ax, f"U {name(coordinate)} [{unit}]")
    style.label_x(axes[-1, 0], label, 0.3)
    return figure


def _maps(grid: UncertaintyMap) -> Figure:
    (across, up), third = list(grid.axes)[:2], next(iter(list(grid.axes)[2:]), None)
    slices = grid.axes[third] if third else np.zeros(1)
    values = grid.expanded.reshape(len(grid.pose), *grid.expanded.shape[1:3], -1)
    scales = [scale(c, largest(grid.axes[c]), grid.turning) for c in (across, up)]
    x, y = (factor * grid.axes[c] for c, (factor, _) in zip((across, up), scales, strict=True))
    bar, gap = 0.75, 0.1
    width = (style.WIDTH - 0.64 - bar - gap * (len(slices) - 1)) / len(slices)
    spread = [float(np.ptp(grid.axes[c])) for c in (across, up)]
    height = float(np.clip(width * spread[1] / spread[0] if spread[0] else width, 0.8, 1.8))
    figure, axes = style.panels(
        len(grid.pose), len(slices), height, top=2.3 * style.LINE, bottom=0.44, right=bar, gaps=(gap, 0.16),
        sharex=True, sharey=True,
    )  # fmt: skip
    for row, coordinate, U in zip(axes, grid.pose, values, strict=True):
        factor, unit = scale(coordinate, float(U.max()), grid.turning)
        _row(figure, row, (x, y), factor * U, f"U {name(coordinate)} [{unit}]")
        style.label_y(row[0], f"{name(up)} [{scales[1][1]}]")
    for first, last, value in zip(axes[0], axes[-1], slices, strict=True):
        first.set_title(_slice_words(third, value, largest(slices), grid.turning), loc="left")
        style.label_x(last, f"{name(across)} [{scales[0][1]}]", 0.3)
    return figure


def _row(
    figure: Figure, axes: np.ndarray, plane: tuple[np.ndarray, np.ndarray], shown: np.ndarray, label: str
) -> None:
    """Draw one pose coordinate: the same colours in every slice, contour lines that need no colour."""
    from matplotlib.ticker import MaxNLocator

    low, high = float(shown.min()), float(shown.max())
    if high - low < 1e-3 * high:  # flat: no colours made of rounding
        low, high = 0.98 * low, 1.02 * high
    picture: Any = None
    for j, ax in enumerate(axes):
        U = shown[:, :, j].T
        picture = ax.pcolormesh(
            *plane, U, shading="gouraud", cmap=COLOURS, vmin=low, vmax=high, rasterized=True
        )
        levels = np.linspace(low, high, 7)[1:-1]
        if np.any((levels > U.min()) & (levels < U.max())):
            ax.contour(*plane, U, levels=levels, colors="white", linewidths=0.5)
        ax.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
        ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    box = axes[-1].get_position()
    beside = figure.add_axes((box.x1 + 0.08 / style.WIDTH, box.y0, 0.1 / style.WIDTH, box.height))
    colours = figure.colorbar(picture, cax=beside)
    colours.set_label(label, labelpad=2)
    colours.ax.yaxis.set_major_formatter(lambda v, _: short(v))
    colours.outline.set_linewidth(0.6)


def _slice_words(column: str | None, value: float, most: float, turning: Collection[str]) -> str:
    """Return `Z = 125 µm`, to a thousandth of the largest height."""
    if column is None:
        return ""
    factor, unit = scale(column, most or 1e-4, turning)
    step = 10.0 ** np.floor(np.log10(factor * (most or 1e-4)) - 2)
    return f"{name(column)} = {short(round(factor * value / step) * step)} {unit}".replace("-", MINUS)


# -- errors along a coordinate -----------------------------------------------------------------------------


PANEL, COLUMNS = 1.25, 3  # inches; entries of the legend in a line


def errors_along(found: ErrorModel) -> Figure:
    """Draw the error of each coordinate of the pose over the one that moves, a line per cause."""
    pose, causes = found.model.pose, found.causes
    lines = -(-len(causes) // COLUMNS)
    figure, axes = style.panels(len(pose), 1, PANEL, top=0.1 + lines * style.LINE, bottom=0.42, sharex=True)
    looks = [
        {"color": style.BLACK, "ls": "-", "lw": 1.4}
        if k and k == len(causes) - 1
        else {"color": style.SERIES[k % len(style.SERIES)], "ls": style.DASHES[k % len(style.DASHES)]}
        for k in range(len(causes))
    ]
    *_, factor, unit, moving = span(found)
    for k, (ax, column) in enumerate(zip(axes[:, 0], pose, strict=True)):
        y_factor, y_unit = scale(
            column, largest(np.array([e.error[k] for *_, e in causes])), found.model.period
        )
        ax.axhline(0, color=style.FAINT, lw=0.6, zorder=0)
        for (*_, e), look in zip(causes, looks, strict=True):
            ax.plot(factor * e.at, y_factor * e.error[k], **look)
        ax.margins(x=0)
        style.label_y(ax, f"error of {name(column)} [{y_unit}]")
    style.label_x(axes[-1, 0], f"{moving} [{typeset(unit)}]")
    keys = [style.key(cause, **look) for (cause, *_), look in zip(causes, looks, strict=True)]
    style.legend(figure, keys, "upper left", ncols=COLUMNS)
    return figure
