"""Which channels see which array, and the phasor of each: found from the model's own readings.

A channel follows the pose coordinate that its array repeats along. Turning the mover a little changes place
and height of the wave under each channel by its lever, so levers say where a channel lies; those that lie
together see one array.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from hallsym.codegen.lowering.phasors import TURN, Phasor, Sample, phasor_of
from hallsym.errors import InputError
from hallsym.model import Model

APART = 1.0
"""Wavelengths that two arrays are at least apart on the board."""


@dataclass(frozen=True, eq=False)
class Group:
    """Channels that see one array: their numbers, the pose coordinate it repeats along, its phasor."""

    channels: tuple[int, ...]
    axis: int
    phasor: Phasor


def groups_of(
    model: Model, p: np.ndarray, weight: np.ndarray, middle: np.ndarray, heights: tuple[float, float]
) -> tuple[tuple[Group, ...], np.ndarray]:
    """Return the arrays, those along the first coordinate first, and the middle (6,) made level.

    `middle` (6,): pose in the middle of the box; `heights`: range of the third coordinate [m].
    """
    sample = Sample(model, p, middle, heights).levelled((3, 4, 5))
    axes = sample.axes()
    found: list[Group] = []
    for axis in (0, 1):
        own = [k for k in range(len(model.channels)) if axes[k] == axis]
        if not own:
            continue
        places = np.array([_lever(sample, own, axis, turn) for turn in (3, 4, 5)]).T
        lc = sample.analysed(own, axis, np.zeros(6))[0]
        for members in together(places, APART * 2 * pi * lc):
            channels = tuple(own[k] for k in members)
            found.append(Group(channels, axis, phasor_of(sample, channels, axis, weight, exact=False)))
    along = [sum(group.axis == axis for group in found) for axis in (0, 1)]
    if min(along) < 1 or len(found) < 3:
        raise InputError(
            f"Six coordinates are decoded from three arrays or more, along both axes; the readings of "
            f"{model.name} "
            f"show {along[0]} along {model.pose[0]} and {along[1]} along {model.pose[1]}."
        )
    return tuple(found), sample.at


def _lever(sample: Sample, own: Sequence[int], axis: int, turn: int) -> np.ndarray:
    """Return what a rotation moves the wave by under each channel [m / rad]: the larger of place and
    height."""
    move = np.zeros(6)
    move[turn] = TURN
    ends = [sample.analysed(own, axis, sign * move)[2][:, 0] for sign in (-1, 1)]
    change = sample.analysed(own, axis, np.zeros(6))[0] * np.log(ends[1] / ends[0]) / (2 * TURN)
    return np.asarray(
        np.where(np.abs(change.imag).max() > np.abs(change.real).max(), change.imag, change.real)
    )


def together(places: np.ndarray, apart: float) -> list[list[int]]:
    """Return the numbers of places (n, 3) that are nearer than `apart` to another of their kind."""
    left, out = list(range(len(places))), []
    while left:
        members, waiting = [], [left.pop(0)]
        while waiting:
            k = waiting.pop()
            members.append(k)
            near = [j for j in left if np.abs(places[j] - places[k]).max() < apart]
            left = [j for j in left if j not in near]
            waiting += near
        out.append(sorted(members))
    return out
