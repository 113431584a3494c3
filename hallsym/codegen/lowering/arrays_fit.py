"""What turns the phasors of several arrays into six coordinates: found by least squares on the model's own
readings.

Place and height of each array are linear in the pose but for two things. A tilted mover is nearer to one end
of its patch of sensors, which moves them by terms that turn with the phasor: conj(u) / u, u^4, conj(u)^5 / u
times rotations. And rotations multiply displacements. Both are found by regression over poses in the box, as
few terms as leave at most an accuracy, largest first.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement as combined
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen.lowering.phasors import TURN, Phasor, Sample, phasor_of
from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

BATCH = 2048
"""Samples that the reference decoder takes at a time."""
NEWTON = 3
"""Steps from the closed form: each leaves a thousandth of what the one before did, or less."""


@dataclass(frozen=True, eq=False)
class Reference(ABC):
    """A model of place and height or of six coordinates at parameters `p`, over poses `middle` +- `half`."""

    model: Model
    p: np.ndarray
    weight: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    accuracy: np.ndarray
    """What terms may leave of each coordinate (n_pose,)."""
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

    @abstractmethod
    def straight(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Return displacements (n_pose, s) from the middle, linear in places and heights without tilt."""

    @abstractmethod
    def _bent(self) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (n_pose, s) that products of coordinates are fitted to, and their `straight`."""

    @cached_property
    def bends(self) -> "tuple[Terms, ...]":
        """Polynomial terms (numbers of coordinates) of displacements that are added to each coordinate.

        Rotations make them: none without.
        """
        if not self.turns:
            return (Terms((), ()),) * len(self.middle)
        pose, v = self._bent()
        off = pose - self.middle[:, None] - v
        terms = [c for degree in range(4) for c in combined(range(6), degree)]
        columns = np.array([np.prod(v[list(c)], axis=0) for c in terms])
        return tuple(fewest(terms, columns, off[k], float(self.accuracy[k]) / 2) for k in range(6))

    def decoded(self, readings: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses (n_pose, s) as the generated code computes them, functions exact."""
        v = self.straight(readings, near)
        with np.errstate(all="ignore"):
            rows = [b.of([np.prod(v[list(c)], axis=0) for c in b.terms], v.shape[1]) for b in self.bends]
        return np.asarray(self.middle[:, None] + v + np.array(rows))

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.reading)

    @cached_property
    def _slopes(self) -> Callable[..., list[np.ndarray]]:
        """Poses -> d readings / d pose, column by column."""
        pose = ca.SX.sym("pose", len(self.middle))
        readings = self.model.reading(self.p, np.zeros(len(self.model.zeros)), pose, [])
        return on_arrays(ca.Function("slopes", [pose], [ca.densify(ca.vec(ca.jacobian(readings, pose)))]))

    def readings(self, pose: np.ndarray) -> np.ndarray:
        """Return readings (n, s) at poses (n_pose, s)."""
        return np.asarray(self._run(self.p, np.zeros(len(self.model.zeros)), list(pose), [])[0])

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

    def solved(self, readings: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses (n_pose, s) of weighted least squares over all channels: the reference decoder.

        `near` (2, s): places in the period that is meant; the middle of the box without it.
        """
        parts = []
        for first in range(0, readings.shape[1], BATCH):
            part = slice(first, first + BATCH)
            parts.append(self._solved(readings[:, part], None if near is None else near[:, part]))
        return np.hstack(parts)

    def _solved(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Steps with the slopes at the closed form, which is within some um of the solution."""
        n, count, root = len(self.model.channels), len(self.middle), np.sqrt(self.weight)[:, None]
        with np.errstate(all="ignore"):
            pose = np.clip(np.nan_to_num(self.decoded(readings, near)), -1e3, 1e3)
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
STEP = 1e-6
"""Step [m, rad] of the slopes of places and heights."""
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


@dataclass(frozen=True, eq=False)
class Terms:
    """A sum of terms: their factors."""

    terms: tuple[tuple, ...]
    factors: tuple[float, ...]

    def of(self, columns: Sequence[np.ndarray], size: int) -> np.ndarray:
        """Return the sum (s,) of the terms' columns."""
        total = np.zeros(size)
        for factor, column in zip(self.factors, columns, strict=True):
            total = total + factor * column
        return total


APART = 1.0
"""Wavelengths that two arrays are at least apart on the board."""


@dataclass(frozen=True, eq=False)
class Group:
    """Channels that see one array: their numbers, the pose coordinate it repeats along, its phasor."""

    channels: tuple[int, ...]
    axis: int
    phasor: Phasor


@dataclass(frozen=True, eq=False)
class Arrays(Reference):
    """Arrays of a model at parameters `p`, over poses `middle` +- `half` (6,)."""

    groups: tuple[Group, ...]

    def wave_of(self, axis: int) -> float:
        """Wavelength along a coordinate [m]."""
        return 2 * pi * self.groups[self.axes[axis][0]].phasor.lc

    # -- places and heights ----------------------------------------------------------------------------------

    @cached_property
    def axes(self) -> dict[int, list[int]]:
        """Numbers of the arrays along each axis."""
        return {axis: [k for k, g in enumerate(self.groups) if g.axis == axis] for axis in (0, 1)}

    def phasors(self, readings: np.ndarray) -> list[np.ndarray]:
        """Return the phasor (s,) of each array."""
        return [g.phasor.solved(readings[list(g.channels)]) for g in self.groups]

    def seen(self, phasors: Sequence[np.ndarray], near: np.ndarray | None = None) -> np.ndarray:
        """Return place and height (2 arrays, s) [m], places by the mean of an axis near `near`."""
        places: list[np.ndarray] = [np.zeros(0)] * len(self.groups)
        for axis, members in self.axes.items():
            first, lc = members[0], self.groups[members[0]].phasor.lc
            turns = [np.angle(phasors[k] * phasors[first].conj()) for k in members]
            mean = np.angle(phasors[first]) + sum(turns) / len(members)
            at = np.zeros(1) if near is None else near[axis] - self.middle[axis]
            at = at + lc * self._phase[axis]
            mean = mean + 2 * pi * np.round((at / lc - mean) / (2 * pi))
            for k, turn in zip(members, turns, strict=True):
                places[k] = lc * (mean + turn - sum(turns) / len(members))
        heights = [g.phasor.pose(u)[1] for g, u in zip(self.groups, phasors, strict=True)]
        return np.array([*places, *heights])

    @cached_property
    def _phase(self) -> dict[int, float]:
        """Mean phase [rad] of the arrays of an axis in the middle of the box."""
        u = self.phasors(self.readings(self.middle[:, None]))
        return {
            axis: float(np.angle(u[m[0]][0]))
            + sum(float(np.angle(u[k][0] * np.conj(u[m[0]][0]))) for k in m) / len(m)
            for axis, m in self.axes.items()
        }

    @cached_property
    def at_middle(self) -> np.ndarray:
        """Places and heights (2 arrays, 1) in the middle of the box."""
        return self.seen(self.phasors(self.readings(self.middle[:, None])))

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pose per place and height (6, 2 arrays), by least squares weighted with their variances."""
        slopes = np.zeros((2 * len(self.groups), 6))
        for k in range(6):
            move = np.zeros((6, 1))
            move[k] = STEP
            ends = [self.seen(self.phasors(self.readings(self.middle[:, None] + s * move))) for s in (-1, 1)]
            slopes[:, k] = (ends[1] - ends[0])[:, 0] / (2 * STEP)
        sigma2 = [
            float((g.phasor.weights**2 / self.weight[list(g.channels)]).sum()) * g.phasor.lc**2
            for g in self.groups
        ]
        scaled = slopes.T / np.array([*sigma2, *sigma2])
        return np.asarray(np.linalg.solve(scaled @ slopes, scaled))

    # -- terms -----------------------------------------------------------------------------------------------

    @cached_property
    def sample(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Poses of which no place wraps, their phasors, places and heights."""
        pose = self.poses(np.random.default_rng(1), SAMPLES)
        phasors = self.phasors(self.readings(pose))
        seen = self.seen(phasors, pose[:2])
        inside = np.abs(self.inverse @ (seen - self.at_middle) + self.middle[:, None] - pose)[:2].max(axis=0)
        inside = inside < self.groups[0].phasor.lc
        return pose[:, inside], [u[inside] for u in phasors], seen[:, inside]

    def rotations(self, seen: np.ndarray) -> np.ndarray:
        """Return first rotations (3, s) of places and heights."""
        return np.asarray(self.inverse[3:] @ (seen - self.at_middle))

    @cached_property
    def turning(self) -> tuple[Terms, ...]:
        """What a tilt adds to each place and height, (2 arrays)."""
        pose, phasors, seen = self.sample
        smooth = np.array([
            np.prod(((pose - self.middle[:, None]) / self.half[:, None])[list(c)], axis=0)
            for degree in range(4)
            for c in combined(range(6), degree)
        ])  # fmt: skip
        basis, _ = np.linalg.qr(smooth.T)
        rotations, out = self.rotations(seen), []
        # what one place or height adds to the coordinates, over what they may be off by
        share = (np.abs(self.inverse) / self.accuracy[:, None]).max(axis=0)
        for row in range(2 * len(self.groups)):
            u = phasors[row % len(self.groups)]
            terms = [
                (kind, c, part)
                for kind in KINDS
                for degree in (0, 1, 2)
                for c in combined(range(3), degree)
                for part in (0, 1)
            ]
            columns = np.array([turning_of(u, rotations, term) for term in terms])
            free = columns - (columns @ basis) @ basis.T
            target = seen[row] - (seen[row] @ basis) @ basis.T
            out.append(fewest(terms, free, target, 1 / (2 * share[row])))
        return tuple(out)

    def straight(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Return displacements (6, s) from the middle, linear in places and heights without tilt."""
        phasors = self.phasors(readings)
        return self._straightened(phasors, self.seen(phasors, near))

    def _straightened(self, phasors: Sequence[np.ndarray], seen: np.ndarray) -> np.ndarray:
        rotations, size = self.rotations(seen), seen.shape[1]
        off = [
            found.of([turning_of(phasors[row % len(self.groups)], rotations, t) for t in found.terms], size)
            for row, found in enumerate(self.turning)
        ]
        return np.asarray(self.inverse @ (seen - self.at_middle - np.array(off)))

    def _bent(self) -> tuple[np.ndarray, np.ndarray]:
        pose, phasors, seen = self.sample
        return pose, self._straightened(phasors, seen)


def turning_of(u: np.ndarray, rotations: np.ndarray, term: Term) -> np.ndarray:
    """Return a term (s,) of a phasor and rotations (3, s)."""
    kind, turns, part = term
    with np.errstate(all="ignore"):
        flat = u.conj() / u
        value = {"2": flat, "4": u**4, "6": u.conj() ** 5 / u, "-4": flat * flat}[kind]
    return np.asarray((value.imag if part else value.real) * np.prod(rotations[list(turns)], axis=0))


def fewest(terms: Sequence[tuple], columns: np.ndarray, target: np.ndarray, enough: float) -> Terms:
    """Return terms whose sum leaves at most `enough` of a target: that which explains most first."""
    sizes = np.sqrt((columns * columns).sum(axis=1)) + 1e-300
    unit, rest = columns / sizes[:, None], target
    chosen: list[int] = []
    left = [float(np.abs(rest).max())]
    while len(chosen) < MOST_TERMS and left[-1] > enough:
        gain = np.abs(unit @ rest)
        gain[chosen] = 0
        chosen.append(int(gain.argmax()))
        factors, *_ = np.linalg.lstsq(unit[chosen].T, target, rcond=None)
        rest = target - factors @ unit[chosen]
        left.append(float(np.abs(rest).max()))
    chosen = chosen[: next(k for k, v in enumerate(left) if v <= max(enough, HARDLY * left[-1]))]
    factors, *_ = np.linalg.lstsq(unit[chosen].T, target, rcond=None)
    return Terms(tuple(terms[k] for k in chosen), tuple((factors / sizes[chosen]).tolist()))


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


def _lever(sample: Sample, own: Sequence[int], axis: int, turn: int) -> np.ndarray:
    """Return what a rotation moves the wave by under each channel [m / rad]: the larger of two parts."""
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
