"""Arrays of finite length on a mover, over rows of sensors that are longer: where each sensor is, and the
decoder of six coordinates on numpy arrays.

A row is the channels that one array passes along its period, side by side. Its sensors are weighted by their
distance from the middle of the array, smoothly, so that nothing steps where they come and go; weighted least
squares of what they read make the phasor at the middle of the array, whichever sensors see it. Tilt makes the
field under one end of the array stronger: rotations from a first solution say by how much at each sensor, and
the second solution has it taken out. So what is left depends on where the sensors are beside the array, and
not on which of them they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement as combined
from math import pi

import numpy as np

from hallsym.codegen.lowering.arrays_fit import APART, SAMPLES, Terms, fewest, together
from hallsym.codegen.lowering.passing import Pass, Window, passes, readings
from hallsym.codegen.lowering.phasors import HARMONICS, PLACES, TURN, WIDE, Phasor, Sample
from hallsym.codegen.lowering.reference import Reference
from hallsym.codegen.lowering.travel_fit import COUNTS, MICRON, RAMP
from hallsym.errors import InputError
from hallsym.model import Model

FAR = 30
"""Wavelengths away at which it is seen whether the arrays end: more than arrays have, and some mrad do not
lift a mover out of sight on the way."""
ENDED = 0.05
"""Share of its swing that a channel may have there."""
NO_COVER = 1e-9
"""Determinant of the normal matrix [V4] of no sensors."""
LEVELLING = 3
MOST_DEGREE = 3
"""Of the products of coordinates that are added at the end."""


@dataclass(frozen=True, eq=False)
class Row:
    """Channels of one array along one row: sensor k reads offset + Re sum c_kn u^n under it.

    u = exp(rising (z - middle) / lc + i x / lc) of the middle of the array, where x is the coordinate `axis`.
    """

    channels: tuple[int, ...]
    axis: int
    place: np.ndarray
    """Coordinate at which the middle of the array is over each sensor (n,) [m]."""
    offset: np.ndarray
    factor: np.ndarray
    lever: np.ndarray
    """What rotations move height and place at the middle of the array by, complex (3,) [m / rad]."""
    length: float

    def design(self, n: int = 1) -> np.ndarray:
        """What each sensor reads of the real and imaginary part of u^n, (2, n_sensors) [V]."""
        own = self.factor[:, n - 1]
        return np.stack([own.real, -own.imag])


@dataclass(frozen=True, eq=False)
class Mover(Reference):
    """A mover over rows of sensors."""

    rows: tuple[Row, ...]
    lc: float
    rising: float
    margin: float = 0.0
    """Wavelengths from the ends of an array within which a sensor does not count."""
    plainly: bool = False
    """Whether higher harmonics are left alone."""

    @property
    def wavelength(self) -> float:
        """In metres."""
        return 2 * pi * self.lc

    @cached_property
    def axes(self) -> dict[int, list[int]]:
        """Numbers of the rows along each axis."""
        return {axis: [k for k, row in enumerate(self.rows) if row.axis == axis] for axis in (0, 1)}

    @cached_property
    def harmonics(self) -> tuple[int, ...]:
        """Those that count, beyond the first."""
        if self.plainly:
            return ()
        reach = np.exp(np.arange(HARMONICS) * self.half[2] / self.lc)
        share = np.max(
            [np.abs(r.factor).max(axis=0) / np.abs(r.factor[:, 0]).max() for r in self.rows], axis=0
        )
        return tuple(n for n in range(2, HARMONICS + 1) if (share * reach)[n - 1] > COUNTS * MICRON / self.lc)

    @property
    def plain(self) -> Phasor:
        """The first harmonic of a row, of which functions are bounded."""
        row = self.rows[0]
        n = len(row.channels)
        zeros = np.zeros((2, n))
        return Phasor(self.lc, self.rising, float(self.middle[2]), zeros[0], row.factor[:, :1], zeros, ())

    # -- the decoder -----------------------------------------------------------------------------------------

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pose per place and height of the rows (6, 2 rows), least squares."""
        n, slopes = len(self.rows), np.zeros((2 * len(self.rows), 6))
        for k, row in enumerate(self.rows):
            slopes[k, row.axis], slopes[n + k, 2] = 1.0, 1.0
            slopes[k, 3:], slopes[n + k, 3:] = row.lever.imag, self.rising * row.lever.real
        scale = np.array([1, 1, 1, *[1 / self.model.family.pose_metric.arm_m] * 3])
        return np.asarray(scale[:, None] * np.linalg.pinv(slopes * scale))

    def tilt_of(self, row: Row) -> int:
        """Number of the rotation that lifts one end of the array: about the axis across it."""
        return 4 if row.axis == 0 else 3

    def lift_of(self, row: Row) -> float:
        """What that rotation adds to ln |u| per metre along the row."""
        return (1.0 if row.axis == 0 else -1.0) * self.rising / self.lc

    def first(self, r: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return places (2, s) along both axes from all sensors alike, in the period of `near` (2, s)."""
        out = []
        for axis, members in self.axes.items():
            rows = [self.rows[k] for k in members]
            alike = sum((row.factor[:, :1].conj() * r[list(row.channels)]).sum(axis=0) for row in rows)
            out.append(self._next_to(near[axis], np.asarray(alike)))
        return np.array(out)

    def _next_to(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        place = self.lc * np.angle(u)
        return np.asarray(place + self.wavelength * np.floor((x - place) / self.wavelength + 0.5))

    def weights(self, row: Row, x: np.ndarray) -> np.ndarray:
        """Return the weight (n, s) of each sensor of a row for a mover at x: 0 beyond the ends."""
        away = np.abs(row.place[:, None] - x)
        depth = (row.length / 2 - self.margin * self.wavelength - away) / (RAMP * self.wavelength)
        inside = np.clip(depth, 0.0, 1.0)
        return np.asarray(inside * inside * (3 - 2 * inside))

    def seen(
        self, r: np.ndarray, at: np.ndarray, before: tuple[np.ndarray, Sequence[np.ndarray]] | None = None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return place and height of each row (2 rows, s), and its phasor.

        `at` (2, s): places that weights are taken at; `before`: rotations (3, s) and phasors, to be taken
        out.
        """
        out, heights, phasors, first = [], [], [], dict(enumerate(at))
        for k, row in enumerate(self.rows):
            w, v = self.weights(row, at[row.axis]), r[list(row.channels)]
            lifted = np.ones_like(w)
            if before is not None:
                turn = before[0][self.tilt_of(row) - 3] * self.lift_of(row)
                lifted = exponential(turn * (at[row.axis] - row.place[:, None]))
                for n in self.harmonics:
                    v = v - (row.factor[:, n - 1 : n] * before[1][k] ** n).real * lifted**n
            rows = row.design()[:, :, None] * lifted
            normal = np.einsum("iks,jks,ks->sij", rows, rows, w)
            low = np.linalg.det(normal) < NO_COVER
            both = np.einsum("iks,ks,ks->si", rows, w, v)
            re, im = np.einsum("sij,sj->is", np.linalg.inv(normal + np.eye(2) * low[:, None, None]), both)
            u = re + 1j * im
            place = self._next_to(first[row.axis], u)
            out.append(place)
            heights.append(self.rising * self.lc * np.log(np.abs(u)))
            phasors.append(u)
        return np.array([*out, *heights]), phasors

    def straight(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Return displacements (6, s) from the middle of the box, linear in places and heights."""
        r = self.without_offset(readings)
        shape = (2, r.shape[1])
        at = self.first(r, np.broadcast_to(self.middle[:2, None], shape) if near is None else near)
        with np.errstate(all="ignore"):
            seen, phasors = self.seen(r, at)
            turns = self.inverse[3:] @ (seen - self.at_middle)
            seen, _ = self.seen(r, at, (turns, phasors))
        return np.asarray(self.inverse @ (seen - self.at_middle))

    def without_offset(self, readings: np.ndarray) -> np.ndarray:
        """Return readings (n, s) less what each sensor reads with no array over it."""
        r = np.array(readings, dtype=float)
        for row in self.rows:
            r[list(row.channels)] -= row.offset[:, None]
        return r

    @property
    def at_middle(self) -> np.ndarray:
        """Places and heights (2 rows, 1) in the middle of the box."""
        n = len(self.rows)
        return np.array([self.middle[row.axis] for row in self.rows] + n * [0.0])[:, None]

    @cached_property
    def sample(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Poses of the box, their phasors, places and heights."""
        pose, readings = self.trials(1, SAMPLES)
        r = self.without_offset(readings)
        seen, phasors = self.seen(r, self.first(r, pose[:2]))
        return pose, phasors, seen

    def wave_of(self, axis: int) -> float:
        """Wavelength along a coordinate [m]."""
        return self.wavelength

    def travels(self) -> bool:
        """Whether some sensor is beyond the end of its array somewhere in the box."""
        return any(
            np.abs(row.place - self.middle[row.axis]).max() + self.half[row.axis] > row.length / 2
            for row in self.rows
        )

    @cached_property
    def bends(self) -> tuple[Terms, ...]:
        """Polynomial terms (numbers of coordinates) added to each coordinate, of displacements."""
        pose, readings = self.trials(1, SAMPLES)
        v = self.straight(readings, pose[:2])
        off = pose - self.middle[:, None] - v
        terms = [c for degree in range(MOST_DEGREE + 1) for c in combined(range(6), degree)]
        columns = np.array([np.prod(v[list(c)], axis=0) for c in terms])
        return tuple(fewest(terms, columns, off[k], float(self.accuracy[k]) / 2) for k in range(6))

    def decoded(self, readings: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses (6, s) as the generated code computes them, functions exact."""
        v = self.straight(readings, near)
        with np.errstate(all="ignore"):
            rows = [b.of([np.prod(v[list(c)], axis=0) for c in b.terms], v.shape[1]) for b in self.bends]
        return np.asarray(self.middle[:, None] + v + np.array(rows))


def exponential(v: np.ndarray) -> np.ndarray:
    """Return exp of small numbers as the code computes it."""
    return np.asarray(1 + v * (1 + v * (0.5 + v * (1 / 6))))


# -- found from the model ------------------------------------------------------------------------------------


def ends(model: Model, p: np.ndarray, middle: np.ndarray, heights: tuple[float, float]) -> bool:
    """Return whether the arrays of a model end: far away its channels read nothing that varies."""
    sample = Sample(model, p, middle, heights)
    for axis in (0, 1):
        x = np.random.default_rng(0).uniform(-1, 1, PLACES) * WIDE
        z, far = np.full(PLACES, sample.middle), FAR * 2 * pi * sample.lc(axis)
        here, away = (readings(sample, axis, x + by, z).std(axis=1).max() for by in (0.0, far))
        if not away < ENDED * here:
            return False
    return True


def mover_of(
    model: Model,
    p: np.ndarray,
    weight: np.ndarray,
    middle: np.ndarray,
    half: np.ndarray,
    accuracy: np.ndarray,
) -> Mover:
    """Return the rows of a model over a box, its middle made level. Raises `InputError` for too few.

    `middle`, `half` (6,): of the box; `accuracy` (6,): what terms may leave of each coordinate.
    """
    sample = Sample(model, p, middle, (middle[2] - half[2], middle[2] + half[2]))
    axes = _axes(sample, half)
    seen = [_Seen(sample, axis, own, half) for axis, own in axes.items()]
    for _ in range(LEVELLING):
        sample.at[3:] -= np.nan_to_num(np.nanmean([s.off_level() for s in seen], axis=0))
    seen = [_Seen(sample, axis, own, half) for axis, own in axes.items()]
    lcs = [s.lc for s in seen]
    rows = [row for s in seen for row in s.rows()]
    along = [sum(row.axis == axis for row in rows) for axis in (0, 1)]
    if min(along) < 1 or len(rows) < 3:
        raise InputError(
            f"Six coordinates are decoded from three arrays or more, along both axes; the readings of "
            f"{model.name} show {along[0]} along {model.pose[0]} and {along[1]} along {model.pose[1]}."
        )
    at = sample.at.copy()
    at[:3] = middle[:3]
    wide = half + np.abs(middle - at)
    return Mover(model, p, weight, at, wide, accuracy, tuple(rows), float(np.mean(lcs)), sample.rising(0))


def _axes(sample: Sample, half: np.ndarray) -> dict[int, list[int]]:
    """Return the numbers of the channels that follow each of the first two coordinates."""
    swings = []
    for axis in (0, 1):
        reach = half[axis] + 4 * pi * sample.lc(axis) + WIDE
        x = sample.at[axis] + np.random.default_rng(0).uniform(-1, 1, 8 * PLACES) * reach
        swings.append(readings(sample, axis, x, np.full(len(x), sample.middle)).std(axis=1))
    follows = np.argmax(swings, axis=0)
    return {axis: np.flatnonzero(follows == axis).tolist() for axis in (0, 1) if (follows == axis).any()}


class _Seen:
    """The channels of one axis, as the mover passes them."""

    def __init__(self, sample: Sample, axis: int, own: Sequence[int], half: np.ndarray) -> None:
        self.sample, self.axis, self.own = sample, axis, list(own)
        rough = sample.lc(axis)
        reach = 4 * half[axis] + 8 * pi * rough + WIDE
        self.passed: Pass
        self.window: Window
        self.passed, self.window, self.lc = passes(sample, axis, own, reach, rough)

    def _factor(self, move: np.ndarray) -> np.ndarray:
        """First harmonics (n,) of the channels, the pose moved by `move` (6,)."""
        return np.array([self.window.fitted(k, self.lc, move)[0][1] for k in range(len(self.own))])

    def _slopes(self, k: int, step: float) -> np.ndarray:
        """What a coordinate moves height (real) and place (imaginary part) of each channel by, (n,)."""
        move = np.zeros(6)
        move[k] = step
        return np.asarray(self.lc * np.log(self._factor(move) / self._factor(-move)) / (2 * step))

    def off_level(self) -> np.ndarray:
        """Rotations (3,) by which the mover is off level, as a step across the array says; NaN of the other.

        A rigid body turned about x and y by small angles: a step across lifts it, turned about z moves it.
        """
        out = np.full(3, np.nan)
        across, sign = self._slopes(1 - self.axis, pi / 2 * self.lc).mean(), 1.0 if self.axis == 0 else -1.0
        out[self.axis] = -sign * self.sample.rising(self.axis) * across.real
        out[2] = sign * across.imag
        return out

    def rows(self) -> list[Row]:
        """Return the rows of the axis: channels that one array passes at one place across it."""
        levers = np.array([self._slopes(k, TURN) for k in (3, 4, 5)])
        spread = np.concatenate([levers.real, levers.imag]).T
        fitted = [self.window.fitted(k, self.lc)[0] for k in range(len(self.own))]
        out = []
        for members in together(spread, APART * 2 * pi * self.lc):
            order = sorted(members, key=lambda k: self.passed.place[k])
            out.append(Row(
                tuple(self.own[k] for k in order), self.axis, self.passed.place[order],
                np.array([fitted[k][0].real for k in order]), np.array([fitted[k][1:] for k in order]),
                levers[:, order].mean(axis=1), self.passed.length,
            ))  # fmt: skip
        return out
