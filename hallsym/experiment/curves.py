"""Closed curves that a run could follow: tours of the corners of the ranges, spirals, rounded rasters.

All are uniform B-splines of degree 3 (`hallsym.trajectory`), whose path stays within its control points and
so within the ranges. A sine is at the ends of its range for a short time only; a tour goes along the edges of
the box and waits at its corners, where a pose tells most of slopes. Lissajous figures are what sines of
different frequencies make already.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations, permutations

import numpy as np

from hallsym.simulation import Following
from hallsym.trajectory import Curve
from hallsym.trajectory.forms import SplineForm
from hallsym.trajectory.nominal import COORDINATES

LONGEST_WAIT = 8
"""Control points at one corner, at most: the share of the time spent there grows ever less with more."""
MOST_TURNS, PER_TURN = 4, 12
"""Turns of a spiral, and lines of a raster; control points of a turn."""


def closed_curves(reach: Mapping[str, float], duration_s: float, fastest_hz: float) -> Iterator[Following]:
    """Yield closed curves about 0 that reach as far in each axis as `reach` says, for runs of `duration_s`.

    No axis moves faster, or accelerates more, than a sine over its range at `fastest_hz` does; curves that
    would have to are left out. Axes are those that curves know; other axes have none.
    """
    axes = [axis for axis in reach if axis in COORDINATES.values()]
    for n in range(1, len(axes) + 1):
        for some in (turned for found in combinations(axes, n) for turned in _by_fastest(found)):
            tours = [_tour(n, wait) for wait in range(LONGEST_WAIT, 0, -1)]
            yield from _first("corners", some, tours, reach, duration_s, fastest_hz)
    lengths = [axis for axis in axes if axis.endswith("_m")]
    turns = range(MOST_TURNS, 1, -1)
    for some in combinations(lengths, 2):
        yield from _first("spiral", some, [_spiral(k) for k in turns], reach, duration_s, fastest_hz)
    for some in permutations(lengths, 2):
        yield from _first("raster", some, [_raster(k) for k in turns], reach, duration_s, fastest_hz)


def _first(
    kind: str,
    axes: tuple[str, ...],
    polygons: list[np.ndarray],
    reach: Mapping[str, float],
    duration_s: float,
    fastest_hz: float,
) -> Iterator[Following]:
    """The first curve that can be followed in the time, as often as there is time for it."""
    name = "_".join([kind, *(axis.rpartition("_")[0] for axis in axes)])
    for control in polygons:
        times = int(duration_s / _shortest_s(control, fastest_hz) + 1e-9)
        if times:
            sizes = np.array([reach[axis] for axis in axes])
            yield Following(_closed(control * sizes, axes), duration_s, times=times, name=name)
            return


def _by_fastest(axes: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The axes of a tour with each of them first, which moves most often; of two axes both move alike."""
    return [(axes[k], *axes[:k], *axes[k + 1 :]) for k in range(len(axes) if len(axes) > 2 else 1)]


def _shortest_s(control: np.ndarray, fastest_hz: float) -> float:
    """Time of a round in which no axis exceeds the speed and acceleration of a sine of amplitude 1.

    Control points of the derivatives bound them: n steps of the parameter make a round.
    """
    n = len(control)
    step = np.diff(control, axis=0, append=control[:1])
    bend = np.diff(step, axis=0, append=step[:1])
    return float(n * max(np.abs(step).max(), np.sqrt(np.abs(bend).max())) / (2 * np.pi * fastest_hz))


def _tour(n: int, wait: int) -> np.ndarray:
    """Corners of a cube of n axes in Gray's order, one axis at a time, each `wait` times: (wait 2^n, n)."""
    order = np.arange(2**n)
    gray = order ^ (order >> 1)
    corners = 1.0 - 2.0 * ((gray[:, None] >> np.arange(n)) & 1)
    return np.repeat(corners, wait, axis=0)


def _spiral(turns: int) -> np.ndarray:
    """From the middle outwards and back, in a plane."""
    share = np.arange(turns * PER_TURN) / (turns * PER_TURN)
    angle, radius = 2 * np.pi * turns * share, 1 - np.abs(2 * share - 1)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _raster(lines: int) -> np.ndarray:
    """Lines along the first axis, up the second and back down; the corners are rounded."""
    up = np.linspace(-1.0, 1.0, lines + 1)
    rows = np.r_[up, up[-2:0:-1]]
    ends = np.where(np.arange(len(rows)) % 2, 1.0, -1.0)
    there, back = np.column_stack([ends, rows]), np.column_stack([-ends, rows])
    return np.repeat(np.stack([there, back], axis=1).reshape(-1, 2), 2, axis=0)


def _closed(control: np.ndarray, axes: tuple[str, ...]) -> Curve:
    """The closed uniform B-spline of degree 3 with these control points, over 0 .. 1."""
    n = len(control)
    form = SplineForm(np.arange(n + 7, dtype=float), 3, control[np.arange(n + 3) % n])
    return Curve(form, 0.0, 1.0, axes, "cubic", 0.0, "bounded", {"control": "closed"})
