"""The elastic part of a play, the memory of a hysteresis, in closed form between turning points."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESET = 4.0
"""A stroke, over the width, that brings a play to one of its ends from wherever it is."""


class Travel(NamedTuple):
    """A motion `u` (n,) of one or several runs between its turning points.

    `edges`: samples of these and of both ends of each run; `strokes`: from each to the next, `last`: whether
    it is the last of a run; `stroke`, `along`: (n,) on which one each sample lies, and how far along it.
    `moved`: (n,) how far it is from the first sample of its run.
    """

    u: np.ndarray
    edges: np.ndarray
    strokes: np.ndarray
    last: np.ndarray
    stroke: np.ndarray
    along: np.ndarray
    moved: np.ndarray


def travel(u: np.ndarray, edges: Sequence[int] | None = None) -> Travel:
    """Return a motion with its turning points, which are the same for a play of any width.

    `edges`: (runs + 1,) where runs begin and the last one ends; one run by default.
    """
    limits = np.array([0, len(u)] if edges is None else edges)
    first, ends, turning = limits[:-1], limits[1:] - 1, np.zeros(len(u), dtype=bool)
    turning[1:-1] = np.diff(np.sign(np.diff(u))) != 0
    turning[first] = turning[ends] = True
    edge, stroke = np.flatnonzero(turning), np.cumsum(turning) - turning - 1
    stroke[first] += 1
    strokes, last = np.append(np.diff(u[edge]), 0.0), np.isin(edge, ends)
    moved = u - np.repeat(u[first], np.diff(limits))
    return Travel(u, edge, strokes, last, stroke, u - u[edge[stroke]], moved)


def stop_operator(motion: Travel, width: float) -> np.ndarray:
    """Return the elastic part of a play of half-width `width`, -1 to 1, starting each run from 0.

    z follows du / width and stops at +-1: between turning points it has a closed form.
    """
    _, (low, high) = _from_ends(motion, width)
    return np.clip(motion.moved / width, low, high)


def stop_operators(u: np.ndarray, edges: Sequence[int], widths: Sequence[float]) -> np.ndarray:
    """Return `stop_operator` of each row of u (m, n) and each width, (m, widths, n), from 0 at each edge.

    `edges`: (runs + 1,) where runs begin and the last one ends.
    """
    motions = [travel(row, edges) for row in u]
    return np.array([[stop_operator(motion, width) for width in widths] for motion in motions])


def stop_state(motion: Travel, width: float) -> np.ndarray:
    """Return state and d state / d width of a play whose state where a run begins nobody knows, (2, n).

    From every start s in [-1, 1] the state is clip(s + U, low, high): U the travel over the width, low and
    high the states from -1 and 1. Returned is the mean over all starts; once the motion has covered 2 width,
    low and high are one and the state is known.
    """
    states, (low, high) = _from_ends(motion, width)
    by_low, by_high = _slopes(motion, width, states, np.array([low, high]))
    U = motion.moved / width
    a, b = np.clip(low - U, -1.0, 1.0), np.clip(high - U, -1.0, 1.0)
    inside = ((b + U) ** 2 - (a + U) ** 2) / 2
    mean = 0.5 * (low * (a + 1) + inside + high * (1 - b))
    slope = 0.5 * (by_low * (a + 1) - U / width * (b - a) + by_high * (1 - b))
    return np.array([mean, slope])


def _from_ends(motion: Travel, width: float) -> tuple[np.ndarray, np.ndarray]:
    """States at the edges (2, edges) and at all samples (2, n) if each run starts from -1 and from 1."""
    strokes = motion.strokes / width
    both = np.array([np.where(motion.last, end, strokes) for end in (-RESET, RESET)])
    both[0, -1] = RESET  # what follows is the same motion from the other end
    states = _states(both.ravel(), -1.0).reshape(both.shape)
    return states, np.clip(states[:, motion.stroke] + motion.along / width, -1.0, 1.0)


def _slopes(motion: Travel, width: float, states: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the slopes (2, n) of states `z` with the width; nothing counts of what was covered before the
    play last stopped, as the `states` at the edges say."""
    at = motion.u[motion.edges]
    stopped = np.maximum.accumulate(np.where(np.abs(states) < 1.0, 0, np.arange(len(at))), axis=1)
    slopes = (at[stopped] - at) / width**2
    return np.where(np.abs(z) < 1.0, slopes[:, motion.stroke] - motion.along / width**2, 0.0)


def _states(strokes: np.ndarray, start: float) -> np.ndarray:
    """State before each stroke.

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
    travelled = np.cumsum(moved, axis=0)
    first = [start]
    for by, least, most in zip(travelled[-1].tolist(), low[-1].tolist(), high[-1].tolist(), strict=True):
        first.append(min(max(first[-1] + by, least), most))
    states = np.minimum(np.maximum(np.array(first[:-1]) + travelled, low), high)
    return np.append(start, states.T.ravel()[: count - 1])
