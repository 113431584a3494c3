"""The elastic part of a play, the memory of a hysteresis, in closed form between turning points."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

SIDE_BY_SIDE = 10
"""Samples of a run per run, row and width up to which all are followed side by side, sample by sample."""


class Travel(NamedTuple):
    """A motion `u` (n,) between its turning points.

    `edges`: samples of these and of both ends; `strokes`: from each to the next; `stroke`, `along`: (n - 1,)
    on which one each sample after the first lies, and how far along it.
    """

    u: np.ndarray
    edges: np.ndarray
    strokes: np.ndarray
    stroke: np.ndarray
    along: np.ndarray


def travel(u: np.ndarray) -> Travel:
    """Return a motion with its turning points, which are the same for a play of any width."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(np.sign(np.diff(u))) != 0) + 1, [len(u) - 1]])
    stroke = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    return Travel(u, edges, np.diff(u[edges]), stroke, u[1:] - u[edges[stroke]])


def stop_operator(u: np.ndarray, width: float) -> np.ndarray:
    """Return the elastic part of a play of half-width `width`, -1 to 1, starting from 0.

    z follows du / width and stops at +-1: between turning points it has a closed form.
    """
    return _stops_from(travel(u), width, (0.0,))[0][0] if len(u) else np.empty(0)


def stop_operators(u: np.ndarray, edges: Sequence[int], widths: Sequence[float]) -> np.ndarray:
    """Return `stop_operator` of each row of u (m, n) and each width, (m, widths, n), from 0 at each edge.

    `edges`: (runs + 1,) where runs begin and the last one ends.
    """
    m, n, lengths = len(u), u.shape[1], np.diff(edges)
    longest = int(lengths.max(initial=0))
    if longest > SIDE_BY_SIDE * m * len(widths) * len(lengths):
        each = [[[stop_operator(x[a:b], w) for a, b in pairwise(edges)] for w in widths] for x in u]
        return np.array([[np.concatenate(runs) for runs in row] for row in each])
    place = np.arange(n) - np.repeat(np.asarray(edges[:-1]), lengths)
    run = np.repeat(np.arange(len(lengths)), lengths)
    moved = np.zeros((longest, m, len(lengths)))
    moved[place, :, run] = np.diff(u, prepend=0.0).T
    moved[0] = 0.0
    states = np.zeros((longest, len(widths), m, len(lengths)))
    over = 1 / np.asarray(widths)[:, None, None]
    for k in range(1, longest):
        np.clip(states[k - 1] + moved[k] * over, -1.0, 1.0, out=states[k])
    return np.ascontiguousarray(states[place, :, :, run].transpose(2, 1, 0))


def stop_state(motion: Travel, width: float) -> np.ndarray:
    """Return state and d state / d width of a play whose state at the first sample nobody knows, (2, n).

    From every start s in [-1, 1] the state is clip(s + U, low, high): U the travel over the width, low and
    high the states from -1 and 1. Returned is the mean over all starts; once the motion has covered 2 width,
    low and high are one and the state is known.
    """
    (low, by_low), (high, by_high) = _stops_from(motion, width, (-1.0, 1.0))
    U = (motion.u - motion.u[0]) / width
    a, b = np.clip(low - U, -1.0, 1.0), np.clip(high - U, -1.0, 1.0)
    inside = ((b + U) ** 2 - (a + U) ** 2) / 2
    mean = 0.5 * (low * (a + 1) + inside + high * (1 - b))
    slope = 0.5 * (by_low * (a + 1) - U / width * (b - a) + by_high * (1 - b))
    return np.array([mean, slope])


def _stops_from(motion: Travel, width: float, starts: Sequence[float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """State from each start, and its slope with the width: both in closed form between turning points."""
    u, edges, stroke = motion.u, motion.edges, motion.stroke
    strokes, along = motion.strokes / width, motion.along / width
    out: list[tuple[np.ndarray, np.ndarray]] = []
    for start, states in zip(starts, _states(strokes, starts), strict=True):
        stopped = np.maximum.accumulate(np.where(np.abs(states) < 1.0, 0, np.arange(len(states))))
        # nothing counts of what it covered before it last stopped
        slopes = (u[edges[stopped]] - u[edges]) / width**2
        z, slope = np.full(len(u), start), np.zeros(len(u))
        z[1:] = np.clip(states[stroke] + along, -1.0, 1.0)
        slope[1:] = np.where(np.abs(z[1:]) < 1.0, slopes[stroke] - along / width, 0.0)
        out.append((z, slope))
    return out


def _states(strokes: np.ndarray, starts: Sequence[float]) -> list[np.ndarray]:
    """State before each stroke and after the last, from each start.

    However many strokes make clip(start + travel, low, high), low and high the states from -1 and 1: groups
    of strokes are followed side by side from both, then each group from where the one before it ended.
    """
    count = len(strokes)
    size = max(1, round(math.sqrt(count)))
    moved = np.zeros((size, -(-count // size)))
    moved.T.flat[:count] = strokes
    low, high = np.empty_like(moved), np.empty_like(moved)
    below, above = np.full(moved.shape[1], -1.0), np.full(moved.shape[1], 1.0)
    for k, by in enumerate(moved):
        low[k] = below = np.minimum(np.maximum(below + by, -1.0), 1.0)
        high[k] = above = np.minimum(np.maximum(above + by, -1.0), 1.0)
    travel = np.cumsum(moved, axis=0)
    groups = list(zip(travel[-1].tolist(), low[-1].tolist(), high[-1].tolist(), strict=True))
    out = []
    for start in starts:
        first = [start]
        for by, least, most in groups:
            first.append(min(max(first[-1] + by, least), most))
        states = np.minimum(np.maximum(np.array(first[:-1]) + travel, low), high)
        out.append(np.concatenate([[start], states.T.ravel()[:count]]))
    return out
