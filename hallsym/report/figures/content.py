"""Whether a picture shows anything: one that is a straight line or a single dot does not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STRAIGHT = 1e-9
"""Points of a line are straight where they leave it by less than this part of its extent: rounding."""


def is_bare(figure: Figure) -> bool:
    """Return whether all that is drawn in each of the axes is one dot or lies on one straight line.

    Lines across the axes that lead the eye (`axhline`) do not count; bars, areas, intervals and images are a
    picture.
    """
    return bool(figure.axes) and all(map(_bare, figure.axes))


def _bare(ax: Axes) -> bool:
    from matplotlib.collections import PathCollection

    if ax.patches or ax.images or any(not isinstance(c, PathCollection) for c in ax.collections):
        return False
    drawn = [
        np.column_stack([np.asarray(a, dtype=float) for a in line.get_data()])
        for line in ax.lines
        if line.get_transform() == ax.transData
    ]
    drawn += [np.ma.filled(np.ma.asarray(c.get_offsets(), dtype=float), np.nan) for c in ax.collections]
    points = np.vstack([np.zeros((0, 2)), *drawn])
    points = np.unique(points[np.isfinite(points).all(axis=1)], axis=0)
    if len(points) < 3 or not np.ptp(points, axis=0).all():
        return True
    scaled = (points - points.mean(axis=0)) / np.ptp(points, axis=0)
    return bool(np.linalg.svd(scaled, compute_uv=False)[1] < STRAIGHT * len(points))
