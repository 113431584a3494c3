"""What turns the phasors of several arrays into six coordinates: found by least squares on the model's own
readings.

Place and height of each array are linear in the pose but for two things. A tilted mover is nearer to one end
of its patch of sensors, which moves them by terms that turn with the phasor: conj(u) / u, u^4, conj(u)^5 / u
times rotations. And rotations multiply displacements. Both are found by regression over poses in the box, as
few terms as leave at most an accuracy, largest first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen.lowering.phasors import Phasor, Sample, Window, levelled, phasor_of
from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

BATCH = 2048
"""Samples that the reference decoder takes at a time."""
NEWTON = 3
"""Steps from the closed form: each leaves a thousandth of what the one before did, or less."""


@dataclass(frozen=True, eq=False)
class Group:
    """Channels that see one array: their numbers, the pose coordinate `axis` it repeats along, its phasor."""

    channels: tuple[int, ...]
    axis: int
    phasor: Phasor
    place: np.ndarray
    """Coordinate at which the middle of an array that ends is over each channel (n,) [m]."""
    lever: np.ndarray
    """What rotations move height and place at the middle of the array by, complex (3,) or (0,) [m / rad]."""
    length: float
    """Of the array [m]."""


@dataclass(frozen=True, eq=False)
class Arrays:
    """Arrays of a model of place and height or of six coordinates at parameters `p`, over poses `middle` +-
    `half`."""

    model: Model
    p: np.ndarray
    weight: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    accuracy: np.ndarray
    """What terms may leave of each coordinate (n_pose,)."""
    groups: tuple[Group, ...]
    memory: dict = field(default_factory=dict, kw_only=True)
    """Trial poses and their readings by seed and number, the same whatever is chosen for a decoder."""

    @staticmethod
    def height_of(pose: np.ndarray) -> int:
        """Number of the coordinate that waves decay along: the third of six, the last of two."""
        return min(2, len(pose) - 1)

    @property
    def height(self) -> int:
        """The same, of this model."""
        return self.height_of(self.middle)

    @property
    def turns(self) -> range:
        """Numbers of the rotations among the coordinates."""
        return range(self.height + 1, len(self.middle))

    @cached_property
    def axes(self) -> dict[int, list[int]]:
        """Numbers of the arrays along each axis."""
        along = {axis: [k for k, g in enumerate(self.groups) if g.axis == axis] for axis in (0, 1)}
        return {axis: members for axis, members in along.items() if members}

    def wave_of(self, axis: int) -> float:
        """Wavelength along a coordinate [m]."""
        return 2 * pi * self.groups[self.axes[axis][0]].phasor.lc

    def phasors(self, readings: np.ndarray) -> list[np.ndarray]:
        """Return the phasor (s,) of each array."""
        return [g.phasor.solved(readings[list(g.channels)]) for g in self.groups]

    @cached_property
    def swept(self) -> list[np.ndarray]:
        """Phasors (s,) of each array at trial poses."""
        return self.phasors(self.trials(2, 2000)[1])

    @cached_property
    def _slopes(self) -> Callable[..., list[np.ndarray]]:
        """Poses -> d readings / d pose, column by column."""
        pose = ca.SX.sym("pose", len(self.middle))
        readings = self.model.reading(self.p, np.zeros(len(self.model.offsets)), pose, [])
        return on_arrays(ca.Function("slopes", [pose], [ca.densify(ca.vec(ca.jacobian(readings, pose)))]))

    def readings(self, pose: np.ndarray) -> np.ndarray:
        """Return readings (n, s) at poses (n_pose, s)."""
        return self.model.readings(self.p, pose)

    def poses(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random poses of the box, corners among them."""
        share = rng.uniform(-1, 1, (len(self.middle), count))
        share[:, : count // 20] = np.sign(share[:, : count // 20])
        return np.asarray(self.middle[:, None] + self.half[:, None] * share)

    def trials(self, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return random poses (n_pose, s) of the box and their readings (n, s)."""
        if (seed, count) not in self.memory:
            pose = self.poses(np.random.default_rng(seed), count)
            self.memory[seed, count] = pose, self.readings(pose)
        return self.memory[seed, count]

    def solved(self, readings: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return the poses (n_pose, s) of weighted least squares over all channels: the reference decoder.

        `start` (n_pose, s): poses as the generated code computes them.
        """
        parts = [slice(first, first + BATCH) for first in range(0, readings.shape[1], BATCH)]
        return np.hstack([self._solved(readings[:, part], start[:, part]) for part in parts])

    def _solved(self, readings: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Steps with the slopes at the start, which is within some um of the solution."""
        n, count, root = len(self.model.channels), len(self.middle), np.sqrt(self.weight)[:, None]
        with np.errstate(all="ignore"):
            pose = np.clip(np.nan_to_num(start), -1e3, 1e3)
            scaled = (np.asarray(self._slopes(list(pose))[0]).reshape(count, n, -1) * root).transpose(2, 0, 1)
            left = scaled @ scaled.transpose(0, 2, 1)  # s, n_pose, n_pose
            bad = ~np.isfinite(left).all(axis=(1, 2))
            left[bad], scaled[bad] = np.eye(count), 0.0
            left = left + np.eye(count) * 1e-14 * np.trace(left, axis1=1, axis2=2)[:, None, None]
            inverse = np.linalg.inv(left) @ scaled  # s, n_pose, n
            for _ in range(NEWTON):
                off = np.nan_to_num(readings - self.readings(pose), posinf=0.0, neginf=0.0)
                pose = pose + (inverse @ (root * off).T[..., None])[..., 0].T
        return np.asarray(pose)


SAMPLES = 6000
"""Poses in the box that terms are fitted to, and as many others that they are judged on."""
KINDS = ("2", "4", "6", "-4")
"""Terms that turn with u: conj(u)/u, u^4, conj(u)^5/u, conj(u)^2/u^2."""
MOST_TERMS = 14
"""Terms of each place, height or coordinate."""
HARDLY = 1.1
"""Times what all terms leave: those after the first that leave no more than this are not worth their code."""
NEGLIGIBLE = 0.01
"""Share of an accuracy below which an entry of a matrix is left out."""

Term = tuple[str, tuple[int, ...], int]
"""Kind, numbers of the rotations that it is multiplied by, and 0 for its real or 1 for its imaginary part."""


def turning_of(u: np.ndarray, rotations: np.ndarray, term: Term) -> np.ndarray:
    """Return a term (s,) of a phasor and rotations (3, s)."""
    kind, turns, part = term
    with np.errstate(all="ignore"):
        flat = u.conj() / u
        value = {"2": flat, "4": u**4, "6": u.conj() ** 5 / u, "-4": flat * flat}[kind]
    return np.asarray((value.imag if part else value.real) * np.prod(rotations[list(turns)], axis=0))


def fewest(
    terms: Sequence[tuple],
    columns: np.ndarray,
    target: np.ndarray,
    enough: float,
    size: Callable[[np.ndarray], float] = lambda rest: float(np.abs(rest).max()),
) -> dict[tuple, float]:
    """Return factors by term whose sum leaves at most `enough` of a target (s,): what explains most first.

    `columns` (terms, s); `size`: of what is left.
    """
    sizes = np.sqrt((columns * columns).sum(axis=1)) + 1e-300
    unit, rest = columns / sizes[:, None], target
    chosen: list[int] = []
    left = [size(rest)]
    while len(chosen) < min(MOST_TERMS, len(terms)) and left[-1] > enough:
        gain = np.abs(unit @ rest)
        gain[chosen] = -1.0
        chosen.append(int(gain.argmax()))
        factors, *_ = np.linalg.lstsq(unit[chosen].T, target, rcond=None)
        rest = target - factors @ unit[chosen]
        left.append(size(rest))
    chosen = chosen[: next(k for k, v in enumerate(left) if v <= max(enough, HARDLY * left[-1]))]
    factors, *_ = np.linalg.lstsq(unit[chosen].T, target, rcond=None)
    return {terms[k]: float(f) for k, f in zip(chosen, factors / sizes[chosen], strict=True)}


def groups_of(
    model: Model, p: np.ndarray, weight: np.ndarray, middle: np.ndarray, heights: tuple[float, float]
) -> tuple[tuple[Group, ...], np.ndarray]:
    """Return the arrays, those along the first coordinate first, and the middle (6,) made level.

    `middle` (6,): pose in the middle of the box; `heights`: range of the third coordinate [m].
    """
    sample = Sample(model, p, middle, heights)
    found = [
        Group(
            tuple(w.own[k] for k in members), w.axis, phasor_of(w, members, weight, exact=False),
            w.place[members], lever, w.length,
        )
        for w in levelled(sample, np.zeros(len(middle)), Window.of_period)
        for members, lever in w.arrays()
    ]  # fmt: skip
    check_along(model, [group.axis for group in found])
    return tuple(found), sample.at


def check_along(model: Model, axes: Sequence[int]) -> None:
    """Refuse arrays, by the axis of each, that do not say six coordinates."""
    along = [axes.count(axis) for axis in (0, 1)]
    if min(along) < 1 or len(axes) < 3:
        raise InputError(
            "Six coordinates are decoded from three arrays or more, along both axes; the readings of "
            f"{model.name} show {along[0]} along {model.pose[0]} and {along[1]} along {model.pose[1]}."
        )
