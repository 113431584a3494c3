"""Picture `errors`: errors of the decoded pose along a coordinate by cause, one panel per coordinate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures import style
from hallsym.report.text.along import span
from hallsym.report.words import largest, name, scale
from hallsym.units import typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.uncertainty import ErrorModel

PANEL, COLUMNS = 1.25, 3  # inches; entries of the legend in a line


def errors(found: ErrorModel) -> Figure:
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
