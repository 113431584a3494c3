"""Pictures of what data determine: correlations and effects of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hallsym.inference import VERDICTS
from hallsym.report import picture as p
from hallsym.report.words import largest, minus, name, scale

if TYPE_CHECKING:
    from hallsym.inference import Identifiability, ParameterReport


def drawable(report: Identifiability) -> list[Callable[[Identifiability], p.Picture]]:
    """Return the pictures that there is something to draw of: no correlation of a single parameter."""
    out: list[Callable[[Identifiability], p.Picture]] = []
    if np.isfinite(np.diag(report.correlation)).sum() > 1:
        out.append(correlation)
    if shown(report):
        out.append(effects)
    return out


def shown(report: Identifiability) -> list[ParameterReport]:
    """Return the parameters that are not fixed."""
    return [entry for entry in report.parameters if entry.verdict.word != "fixed"]


def present(entries: Sequence[ParameterReport]) -> list[str]:
    """Return the verdicts that occur, best first."""
    found = {entry.verdict.word for entry in entries}
    return [word for word in VERDICTS if word in found]


# -- correlation -----------------------------------------------------------------------------------------

CELL, WRITTEN, HIGH = 24.0, 22, 560.0
"""Height of a cell, at most [px]; so many parameters have their numbers written; height of all [px]."""


def correlation(report: Identifiability) -> p.Picture:
    """Return the correlation of every two determined parameters: cells above the diagonal, numbers below.

    The fuller a cell the larger the correlation; negative ones have a dash.
    """
    order = np.flatnonzero(np.isfinite(np.diag(report.correlation)))
    names = [report.model.names[k] for k in order]
    values, n = report.correlation[np.ix_(order, order)], len(order)
    rest = [entry for k, entry in enumerate(report.parameters) if k not in order]
    left_out = (
        f"{word}: {', '.join(entry.name for entry in rest if entry.verdict.word == word)}"
        for word in present(rest)
    )
    written = n <= WRITTEN
    drawn = np.where(np.triu(np.ones((n, n)), 1) if written else ~np.eye(n, dtype=bool), values, np.nan)
    edges = np.arange(n + 1) - 0.5
    layers = p.tiles(edges, edges, drawn, 1.0, labels=("correlated", "anticorrelated"))
    if written:
        row, column = np.tril_indices(n, -1)
        layers.append(p.text([_short(v) for v in values[row, column]], column, row, "center"))
    panel = p.Panel(
        p.Axis(low=-0.5, high=max(n, WRITTEN) - 0.5, names=names),
        p.Axis(low=n - 0.5, high=-0.5, names=names),
        layers,
        height=min(CELL * n, HIGH),
    )
    return p.Picture([panel], words=f"Left out, {'; '.join(left_out)}." if rest else "")


def _short(value: float) -> str:
    """Two digits without the zero before the point."""
    if abs(value) < 0.005:
        return "0"
    text = "1.0" if abs(value) >= 0.995 else f"{abs(value):.2f}"[1:]
    return minus(("-" if value < 0 else "") + text)


# -- effects of the parameters ---------------------------------------------------------------------------


LOOKS = {
    "determined": p.AFTER,
    "weak": p.Look(p.INK, p.YELLOW, hatch="////", width=0.4),
    "at bound": p.Look(p.INK, "#f0b070", hatch="....", width=0.4),
    "not determined": p.Look(p.INK, p.PINK, hatch="xxxx", width=0.4),
    "no effect": p.OTHER,
}
"""Of bars by verdict."""
MODEST, SMALL = p.Look(p.SOFT, p.PAPER, width=0.7), p.Look(p.SOFT, p.SOFT, marker="<", size=2.6)
"""Bars of 1 % of a value; mark of what is too small for a bar."""
STRIPE = p.Look(p.GRID, "#f4f4f4", width=0)
ROW, BAR = 14.4, 0.38
"""Height of a row [px]; of a bar, in rows."""
LEAST = 1e-3
"""Changes below this part of the noise of one reading are not drawn to length."""


def effects(report: Identifiability) -> p.Picture:
    """Return the largest change of each pose coordinate over the workspace, one panel each.

    Upper bar of a row: one standard uncertainty of the parameter, in the look of its verdict. Lower bar: 1 %
    of its value. Everything else is fixed.
    """
    entries = shown(report)
    panels = [_effect_panel(entries, column, report) for column in report.model.pose]
    return p.Picture(panels, across=len(panels))


def _effect_panel(entries: list[ParameterReport], column: str, report: Identifiability) -> p.Panel:
    sigma = np.array([np.nan if e.sigma is None else e.sigma.worst[column] for e in entries])
    percent = np.array([e.percent.worst[column] for e in entries])
    floor, together = (report.outputs[column].noise_floor, report.outputs[column].parameters_worst)
    every = np.array([*sigma, *percent, floor, together])
    factor, unit = scale(column, largest(every), report.model.period)
    least = LEAST * floor if floor > 0 else 0.0
    lined = factor * every[np.isfinite(every) & (every > least)]
    low, high = (lined.min() / 1.6, 1.6 * lined.max()) if len(lined) else (0.1, 1.0)
    rows, words = np.arange(len(entries)), [e.verdict.word for e in entries]
    layers = [p.boxes(low, high, rows[::2] - 0.5, rows[::2] + 0.5, STRIPE)]
    bars = [
        (np.where([w == word for w in words], sigma, np.nan), -BAR, LOOKS[word], f"1 sigma, {word}")
        for word in present([e for e in entries if e.sigma is not None])
    ]
    for values, aside, look, label in (*bars, (percent, BAR, MODEST, "1 % of the value")):
        ends = np.where(values > least, factor * values, np.nan)
        layers.append(p.boxes(low, ends, rows + min(aside, 0.0), rows + max(aside, 0.0), look, label))
        small = rows[(values > 0) & (values <= least)] + 0.5 * aside
        layers.append(p.points([low] * len(small), small, SMALL, f"below 1/{1 / LEAST:.0f} of the noise"))
    for value, look, label in (
        (floor, p.FLOOR, "noise of one reading"),
        (together, p.Look(p.BLUE, dash=":"), "all parameters together, 1 sigma"),
    ):
        layers += [p.level(factor * value, look, label, up=True)] if value > 0 else []
    first, last = column == report.model.pose[0], column == report.model.pose[-1]
    x = p.Axis(f"largest change of {name(column)} [{unit}]", low, high, log=True)
    y = p.Axis(low=len(rows) - 0.5, high=-0.5, names=[e.name for e in entries] if first else ())
    return p.Panel(x, y, layers, height=ROW * len(rows), grid=False, beside=words if last else ())
