"""Lowering of models of arrays of finite length on a mover, over rows of sensors longer than they are.

Which sensors count follows from where the mover is: weights go to zero smoothly at the ends of each array.
Nothing is remembered from one sample to the next, and no choice makes a step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Box, Decoupler, Flag, Step, Values, Whole, computed, of_step, short
from hallsym.codegen.intervals import TINY, Enclosure, constant
from hallsym.codegen.lowering import travel, wave_steps
from hallsym.codegen.lowering.arrays import FIELD, NEAR, TILTED, TRIALS, Assembly, ends_and_leaves
from hallsym.codegen.lowering.arrays_fit import APART, SAMPLES, Reference, check_along, together
from hallsym.codegen.lowering.passing import NeverEnds, passes, readings
from hallsym.codegen.lowering.phasors import HARMONICS, PLACES, TURN, WIDE, Phasor, Sample
from hallsym.codegen.lowering.travel import weights
from hallsym.codegen.lowering.wave_steps import Pair, wave_of
from hallsym.codegen.operations import Graph, Operation, graph
from hallsym.errors import InputError, counted
from hallsym.model import Model
from hallsym.records import named

FAR = 30
"""Wavelengths away at which it is seen whether the arrays end: more than arrays have, and some mrad do not
lift a mover out of sight on the way."""
ENDED = 0.05
"""Share of its swing that a channel may have there."""
LEVELLING = 3


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
        return tuple(
            n
            for n in range(2, HARMONICS + 1)
            if (share * reach)[n - 1] > travel.COUNTS * travel.MICRON / self.lc
        )

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
            out.append(travel.next_to(self.lc, near[axis], np.asarray(alike)))
        return np.array(out)

    def weights(self, row: Row, x: np.ndarray) -> np.ndarray:
        """Return the weight (n, s) of each sensor of a row for a mover at x: 0 beyond the ends."""
        return weights(row.place, x, row.length, self.margin, self.wavelength)

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
            low = np.linalg.det(normal) < travel.NO_COVER
            both = np.einsum("iks,ks,ks->si", rows, w, v)
            re, im = np.einsum("sij,sj->is", np.linalg.inv(normal + np.eye(2) * low[:, None, None]), both)
            u = re + 1j * im
            place = travel.next_to(self.lc, first[row.axis], u)
            out.append(place)
            heights.append(self.rising * self.lc * np.log(np.abs(u)))
            phasors.append(u)
        return np.array([*out, *heights]), phasors

    def straight(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Return displacements (6, s) from the middle, linear in places and heights without tilt."""
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

    def _bent(self) -> tuple[np.ndarray, np.ndarray]:
        pose, readings = self.trials(1, SAMPLES)
        return pose, self.straight(readings, pose[:2])


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
    model: Model, p: np.ndarray, weight: np.ndarray, box: tuple[np.ndarray, np.ndarray], accuracy: np.ndarray
) -> Mover:
    """Return the rows of a model over a box, its middle made level. Raises `InputError` for too few.

    `box`: its middle and half (6,); `accuracy` (6,): what terms may leave of each coordinate.
    """
    middle, half = box
    sample = Sample(model, p, middle, (middle[2] - half[2], middle[2] + half[2]))
    swings = []
    for axis in (0, 1):
        reach = half[axis] + 4 * pi * sample.lc(axis) + WIDE
        x = sample.at[axis] + np.random.default_rng(0).uniform(-1, 1, 8 * PLACES) * reach
        swings.append(readings(sample, axis, x, np.full(len(x), sample.middle)).std(axis=1))
    follows = np.argmax(swings, axis=0)
    axes = {axis: np.flatnonzero(follows == axis).tolist() for axis in (0, 1) if (follows == axis).any()}
    seen = [_Seen(sample, axis, own, half) for axis, own in axes.items()]
    for _ in range(LEVELLING):
        sample.at[3:] -= np.nan_to_num(np.nanmean([s.off_level() for s in seen], axis=0))
    seen = [_Seen(sample, axis, own, half) for axis, own in axes.items()]
    rows, lc = [row for s in seen for row in s.rows()], float(np.mean([s.lc for s in seen]))
    check_along(model, [row.axis for row in rows])
    at = np.concatenate([middle[:3], sample.at[3:]])
    wide = half + np.abs(middle - at)
    return Mover(model, p, weight, at, wide, accuracy, tuple(rows), lc, sample.rising(0))


class _Seen:
    """The channels of one axis, as the mover passes them."""

    def __init__(self, sample: Sample, axis: int, own: Sequence[int], half: np.ndarray) -> None:
        self.sample, self.axis, self.own = sample, axis, list(own)
        rough = sample.lc(axis)
        reach = 4 * half[axis] + 8 * pi * rough + WIDE
        self.passed, self.window, self.lc = passes(sample, axis, own, reach, rough)

    def _slopes(self, k: int, step: float) -> np.ndarray:
        """What a coordinate moves height (real) and place (imaginary part) of each channel by, (n,)."""
        moves, channels = step * np.eye(6)[k] * np.array([[1.0], [-1.0]]), range(len(self.own))
        up, down = np.array([[self.window.fitted(j, self.lc, m)[0][1] for j in channels] for m in moves])
        return np.asarray(self.lc * np.log(up / down) / (2 * step))

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


TRIED = 1000
"""Poses over which margins are compared."""
HARDLY = 1.1
"""Times what is left with them: harmonics that bring less are left alone."""
BOUNDED = 1000
"""Poses for which the rounding is bounded, one by one."""
ROOM = 1.5
"""Times the largest bound of these poses."""


def decoupler(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float | None = None
) -> Decoupler | None:
    """Return the decoupler of a mover over longer rows over a box; see `lowering.wave.decoupler`.

    None where arrays do not end near the box, or no sensor is ever beyond the end of its array.
    """
    middle, half, leaves = ends_and_leaves(model, box, accuracy)
    p = np.asarray(p, dtype=float)
    if not ends(model, p, middle, (middle[2] - half[2], middle[2] + half[2])):
        return None
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    try:
        found = replace(mover_of(model, p, weight, (middle, half), leaves), model=own)
    except NeverEnds:
        return None
    if not found.travels():
        return None
    found = _best(found)
    low, high = middle[2] - half[2], middle[2] + half[2]
    tilted = float(np.abs(np.array([row.lever for row in found.rows])).max(axis=0) @ half[3:])
    wave = wave_of(found.plain, (low - tilted, high + tilted), float(leaves[0]))
    return _Assembly(found, (wave,) * len(found.rows), box).make()


def _best(found: Mover) -> Mover:
    """Return the mover with the margin that leaves least of ends and noise; harmonics where they count."""
    tried: list[tuple[float, int, Mover]] = []
    for margin in travel.MARGINS:
        for plainly in (True, False):
            one = replace(found, margin=margin, plainly=plainly)
            if 2 * margin * one.wavelength < min(r.length for r in one.rows) - one.wavelength:
                tried.append((_left(one) * (1.0 if plainly else HARDLY), len(tried), one))
    size, _, best = min(tried, default=(np.inf, 0, found))
    if not np.isfinite(size):
        x, y = found.model.pose[:2]
        raise InputError(
            f"Over the box too few sensors see an array at its ends; give fewer {x} and {y} with --range, or "
            "more sensors in the layout."
        )
    return best


def _left(found: Mover) -> float:
    """What is left, rms, of coordinates over their accuracy, with the noise of the calibration."""
    pose, readings = found.trials(7, TRIED)
    noisy = (
        readings + np.random.default_rng(8).standard_normal(readings.shape) / np.sqrt(found.weight)[:, None]
    )
    with np.errstate(all="ignore"):  # where no sensor counts there is no pose
        off = (found.decoded(noisy, pose[:2]) - pose) / found.accuracy[:, None]
        return float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


@dataclass(eq=False)
class _Assembly(Assembly):
    found: Mover  # type: ignore[assignment]

    def _channels(self, row: Row) -> list[str]:
        return [short(self.found.model.channels[k]) for k in row.channels]

    # -- from readings to places and heights ---------------------------------------------------------------

    def rows(self) -> list[ca.SX]:
        """Add the steps from the readings to places from the middle [m] and logarithms of all rows."""
        made, found = self.made, self.found
        made.entry("lc", found.lc, "m", "wavelength over 2 pi")
        made.entry("wavelength", found.wavelength, "m", "wavelength")
        made.entry("per_wave", 1 / found.wavelength, "1/m", "periods per metre")
        wave_steps.least_inside(made, self.waves[:1])
        self.at = {axis: self._first(axis, members) for axis, members in found.axes.items()}
        for row, name in zip(found.rows, self.names, strict=True):
            self._weights(row, name)
        before = self._solved("_first")
        turns = {k: self._first_turn(k, before) for k in sorted({found.tilt_of(row) for row in found.rows})}
        return list(self._solved("", turns).values())

    def _first(self, axis: int, members: Sequence[int]) -> ca.SX:
        """The place along an axis that all its sensors alike say, in the period that is meant."""
        made, column, cos, sin = self.made, short(self.found.model.pose[axis]), [], []
        for k in members:
            row = self.found.rows[k]
            design = row.design()
            for j, name in enumerate(self._channels(row)):
                offset = made.entry(f"offset_{name}", float(row.offset[j]), "V", f"offset of {name}")
                field = made.step(
                    f"field_{name}", made.symbols[self.found.model.channels[row.channels[j]]] - offset
                )
                cos.append(
                    field * made.entry(f"cos_{name}", design[0, j], "V", f"read by {name} of the cosine")
                )
                sin.append(
                    field * made.entry(f"sin_{name}", design[1, j], "V", f"read by {name} of the sine")
                )
        u = self.made.total(f"cos_all_{column}", cos, "all alike"), self.made.total(f"sin_all_{column}", sin)
        made.entry(f"{column}_middle", float(self.found.middle[axis]), "m", "middle of the box")
        near = made.symbols[f"{column}_near_m" if self.wide(axis) else f"{column}_middle"]
        return travel.place_steps(made, self.waves[0], u, near, f"_{column}")

    def _weights(self, row: Row, tag: str) -> None:
        """Weight of each sensor: 1 well under the array, 0 beyond, smooth."""
        made, found = self.made, self.found
        ramp = travel.RAMP * found.wavelength
        half = row.length / 2 - found.margin * found.wavelength
        start = made.entry(
            f"depth_{tag}", half / ramp, "1", "half of what counts of the array, over the ramp"
        )
        if "per_ramp" not in made.symbols:
            made.entry("per_ramp", 1 / ramp, "1/m", "a weight goes from 0 to 1 over its inverse")
        rate = made.symbols["per_ramp"]
        for name, place in zip(self._channels(row), row.place, strict=True):
            at = made.entry(f"at_{name}", float(place), "m", f"place at which the array is over {name}")
            beside = made.step(f"beside_{name}", self.at[row.axis] - at, "[m] of the middle of the array")
            depth = made.step(f"deep_{name}", start - ca.fabs(beside) * rate)
            travel.smooth_weight(made, depth, name)

    def _solved(self, tag: str, turns: dict[int, ca.SX] | None = None) -> dict[str, ca.SX]:
        """Place from the middle and logarithm of each row by label; `turns`: rotations to be taken out."""
        found, made, places, logs = self.found, self.made, {}, {}
        for k, (row, name) in enumerate(zip(found.rows, self.names, strict=True)):
            turn = None if turns is None else turns[found.tilt_of(row)]
            u = self._vector(row, name, tag, turn)
            log = wave_steps.logarithm_steps(made, self.waves[k], u, f"_{name}{tag}")
            place = travel.place_steps(made, self.waves[0], u, self.at[row.axis], f"_{name}{tag}")
            middle = made.symbols[f"{short(found.model.pose[row.axis])}_middle"]
            places[f"along_{name}"] = made.step(f"along_{name}{tag}", place - middle, "[m] from the middle")
            logs[f"deep_{name}"] = log
        return places | logs

    def _first_turn(self, k: int, values: dict[str, ca.SX]) -> ca.SX:
        """First estimate of a rotation, within its range: of readings of no pose it could be anything."""
        made, column = self.made, short(self.found.model.pose[k])
        half_more = 1.5 * float(self.found.half[3:].max())
        most = made.entry(f"most_{column}", half_more, "rad", f"largest {column} that is taken out")
        turn = made.step(f"seen_{column}", self.total(k, values), "[rad] first estimate")
        up = made.step(f"above_{column}", ca.if_else(turn < most, turn, most))
        return made.step(f"first_{column}", ca.if_else(up > -most, up, -most))

    def _vector(self, row: Row, name: str, tag: str, turn: ca.SX | None) -> Pair:
        made, sensors = self.made, self._channels(row)
        field = [made.symbols[f"field_{s}"] for s in sensors]
        cos, sin, weight = ([made.symbols[f"{n}_{s}"] for s in sensors] for n in ("cos", "sin", "weight"))
        if turn is not None:  # how much stronger the field is at each sensor than at the array's middle
            about, lifted = "of ln |u| per metre and rotation", []
            lift = made.entry(f"lift_{name}", self.found.lift_of(row), "1/m", about)
            steep = made.step(f"steep_{name}", lift * turn)
            for s in sensors:
                v = made.step(f"tilt_{s}", steep * made.symbols[f"beside_{s}"])
                lifted.append(made.step(f"lifted_{s}", 1.0 + v * (1.0 + v * (0.5 + v * (1 / 6)))))
            field = self._without_harmonics(row, name, field, lifted)
            cos = [made.step(f"lifted_cos_{s}", c * v) for s, c, v in zip(sensors, cos, lifted, strict=True)]
            sin = [made.step(f"lifted_sin_{s}", c * v) for s, c, v in zip(sensors, sin, lifted, strict=True)]
        wc = [made.step(f"wcos_{s}{tag}", w * c) for s, w, c in zip(sensors, weight, cos, strict=True)]
        ws = [made.step(f"wsin_{s}{tag}", w * c) for s, w, c in zip(sensors, weight, sin, strict=True)]

        def product(label: str, a: Sequence[ca.SX], b: Sequence[ca.SX]) -> ca.SX:
            return self.made.total(f"{label}_{name}{tag}", [x * y for x, y in zip(a, b, strict=True)])

        cc, cs, ss = product("cos_cos", wc, cos), product("cos_sin", wc, sin), product("sin_sin", ws, sin)
        re, im = product("cos_seen", wc, field), product("sin_seen", ws, field)
        cover = made.step(f"cover_{name}{tag}", cc * ss - cs * cs, "[V4] cosine told from sine")
        if f"least_cover_{name}" not in made.symbols:
            pose = self.found.poses(np.random.default_rng(3), travel.COVERS_SEEN)
            end = travel.least_cover(self.found.weights(row, pose[row.axis]), *row.design())
            made.entry(f"least_cover_{name}", end, "V4", "share of the least of the box")
        least = made.symbols[f"least_cover_{name}"]
        held = made.step(f"held_cover_{name}{tag}", ca.if_else(cover > least, cover, least))
        per = made.step(f"per_cover_{name}{tag}", 1.0 / held)
        return self._held_parts((ss * re - cs * im, cc * im - cs * re), per, f"{name}{tag}")

    def _held_parts(self, wide: Pair, per: ca.SX, tag: str) -> Pair:
        """A phasor, no longer than any of the box is, from what is as many times it as 1 over `per`."""
        made = self.made
        if "longest" not in made.symbols:
            made.entry("longest", 2.0 * self.waves[0].outer, "1", "most of a phasor")
        most, names = made.symbols["longest"], [f"{axis}_{tag}" for axis in wave_steps.AXES]
        raw = [made.step(f"raw_{n}", v * per) for n, v in zip(names, wide, strict=True)]
        u = []
        for n, v in zip(names, raw, strict=True):
            low = made.step(f"above_{n}", ca.if_else(v > -most, v, -most))
            u.append(made.step(f"held_{n}", ca.if_else(low < most, low, most)))
        return u[0], u[1]

    def _without_harmonics(
        self, row: Row, name: str, field: Sequence[ca.SX], lifted: Sequence[ca.SX]
    ) -> list[ca.SX]:
        """Readings without the higher harmonics that the first solution says."""
        made, out = self.made, list(field)
        cos, sin = (made.symbols[f"held_{axis}_{name}_first"] for axis in wave_steps.AXES)
        powers = wave_steps.Powers(made, cos, sin, f"_{name}_first")
        known = [{1: v} for v in lifted]
        for n in self.found.harmonics:
            re, im = powers(n)
            design = row.design(n)
            for k, sensor in enumerate(self._channels(row)):
                a, b = (
                    made.entry(f"{part}_{n}_{sensor}", design[j, k], "V", f"read by {sensor} of {part} {n}")
                    for j, part in enumerate(("cos", "sin"))
                )
                strong = wave_steps.power(made, known[k], n, f"lifted_{sensor}")
                out[k] = made.step(f"left_{n}_{sensor}", out[k] - (a * re + b * im) * strong)
        return out

    # -- the linear pose -----------------------------------------------------------------------------------

    @property
    def labels(self) -> list[str]:
        """Of what the pose is linear in: places, then logarithms."""
        return [f"along_{n}" for n in self.names] + [f"deep_{n}" for n in self.names]

    @property
    def matrix(self) -> np.ndarray:
        """Pose per label (6, labels)."""
        n = len(self.names)
        scale = np.array(n * [1.0] + n * [self.found.rising * self.found.lc])
        return np.asarray(self.found.inverse * scale)

    def covered(self) -> None:
        """Add the step that the flag of the cover looks at: what the row that has least has to spare."""
        made = self.made
        value = None
        for name in self.names:
            own = made.step(
                f"covered_{name}",
                made.symbols[f"cover_{name}_first"] - made.symbols[f"least_cover_{name}"],
                "[V4]",
            )
            least = own if value is None else ca.if_else(value < own, value, own)
            value = own if value is None else made.step(f"cover_to_{name}", least)
        made.entry("least_cover", 0.0, "V4", "what each row must have more than its least")

    def linear(self, nears: Sequence[str]) -> list[ca.SX]:
        """Add the steps from the readings to the linear pose; returns its displacements from the middle."""
        seen = self.rows()
        self.covered()
        self.least()
        return self.pose(seen, {})

    @property
    def never_zero(self) -> str:
        """An entry that decoupler_check() looks at: a wavelength over 2 pi."""
        return "lc"

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Status bits beyond the ranges."""
        last = self.names[-1]
        return (
            Flag("FIELD", f"least_to_{last}", "least_inside", FIELD),
            Flag("TILT", "turns", "least_turns", TILTED),
            Flag("COVER", f"cover_to_{last}", "least_cover", travel.COVERED),
        )

    def bounded(self, values: Values, nears: tuple[str, ...]) -> Callable[[int], Mapping[str, Enclosure]]:
        """Return what bounds the rounding."""
        return PoseByPose(self.found, tuple(self.made.steps), dict(values), nears, self.drawn_of_box)

    def leaves(self) -> dict[str, float]:
        """What is left of each coordinate: met over trial poses by exact functions, and what these leave."""
        found = self.found
        pose, readings = found.trials(5, TRIALS)
        met = np.abs(found.decoded(readings, pose[:2]) - pose).max(axis=1)
        each = np.full(2 * len(found.rows), self.waves[0].error * found.lc)
        return named(found.model.pose, wave_steps.SAFE * (met + np.abs(found.inverse) @ each))

    def said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        """Return sentences for header and report."""
        found = self.found
        rows = ", ".join(
            f"{n} {counted(len(r.channels), 'reading')} over {1e3 * np.ptp(r.place):.4g} mm, array of "
            f"{1e3 * r.length:.3g} mm"
            for n, r in zip(self.names, found.rows, strict=True)
        )
        return (
            f"Rows: {rows}. A sensor counts from {1e3 * found.margin * found.wavelength:.3g} mm inside the "
            "ends of its array on, and fully half a wavelength further: weights are smooth, so nothing steps "
            "where sensors come and go.",
            "Give all readings at every sample, also of sensors that no array is over: the code weights "
            "them.",
            f"What says the period, x_near_m and y_near_m where they are inputs, is the position so far or "
            f"the commanded one, within {1e3 * NEAR * found.wavelength:.2g} mm: it chooses the period and "
            "nothing else.",
            *wave_steps.measured("It", leaves, TRIALS, " of the poses of the model"),
        )


@dataclass(frozen=True, eq=False)
class PoseByPose:
    """Digits of the significand -> range and rounding of each coordinate, flags clear, zeros at zero.

    Rounding is bounded for each of many poses, and the largest bound is taken with some room.
    """

    found: Mover
    steps: tuple[Step, ...]
    values: Values
    nears: tuple[str, ...]
    drawn: Callable[[np.random.Generator, int], np.ndarray]

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each coordinate."""
        model = self.found.model
        entries = {n: v for n, v in self.values.items() if not isinstance(v, tuple)}
        entries |= {f"zero_{short(c)}": 0.0 for c in model.pose}
        columns = [short(c) for c in (*model.channels, *self.nears)]
        inputs = dict(zip(columns, self.drawn(np.random.default_rng(6), BOUNDED), strict=True))
        values, errors = rounding(self.steps, inputs, entries, digits, len(model.pose))
        ends = (values.min(axis=1), values.max(axis=1), ROOM * errors.max(axis=1))
        return {c: Enclosure(*map(float, e)) for c, *e in zip(model.pose, *ends, strict=True)}


EXACT = ("assign", "neg", "twice", "fabs", "lt", "le", "not", "if_else_zero")
"""Operations that do not round."""

Numbers = dict[str, Any]

_SLOPES: dict[str, Callable[..., tuple]] = {
    "assign": lambda z, x: (1.0,),
    "neg": lambda z, x: (-1.0,),
    "twice": lambda z, x: (2.0,),
    "fabs": lambda z, x: (np.sign(x),),
    "lt": lambda z, x, y: (0.0, 0.0),
    "le": lambda z, x, y: (0.0, 0.0),
    "not": lambda z, x: (0.0,),
    "if_else_zero": lambda z, c, x: (0.0, (c != 0) * 1.0),
    "add": lambda z, x, y: (1.0, 1.0),
    "sub": lambda z, x, y: (1.0, -1.0),
    "mul": lambda z, x, y: (y, x),
    "div": lambda z, x, y: (1 / y, -z / y),
    "inv": lambda z, x: (-z * z,),
    "sq": lambda z, x: (2 * x,),
}
"""Derivatives by the arguments of an operation of result z; choices are between equals where they turn."""


def rounding(
    steps: Sequence[Step],
    inputs: Mapping[str, np.ndarray],
    entries: Mapping[str, float],
    digits: int,
    last: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and rounding errors (last, s) of the last steps.

    `inputs` (s,) by symbol, exact; `entries`: numbers of the table; `digits`: of the significand.
    """
    known: Numbers = {**inputs, **entries}
    graphs = [graph([step.expression]) for step in steps]
    worked = []
    for step, own in zip(steps, graphs, strict=True):
        with np.errstate(all="ignore"):
            worked.append(computed(own, known))
            known[step.name] = of_step(step, own, worked[-1])
    count = len(next(iter(inputs.values())))
    errors = []
    for step in steps[-last:]:
        adjoint: Numbers = {step.name: np.ones(count)}
        total = np.zeros(count)
        for one, own, values in zip(reversed(steps), reversed(graphs), reversed(worked), strict=True):
            if one.name in adjoint and not isinstance(one, Whole):
                total = total + _back(own, values, adjoint.pop(one.name), adjoint, digits)
        for name, value in entries.items():
            total = total + np.abs(adjoint.get(name, 0.0)) * constant(value, digits).error
        errors.append(total)
    return np.array([np.broadcast_to(known[s.name], count) for s in steps[-last:]]), np.array(errors)


def _back(own: Graph, values: list[Any], by: np.ndarray, adjoint: Numbers, digits: int) -> np.ndarray:
    """Add the derivatives by the symbols of a step, whose own is `by`; returns what its operations round."""
    slopes: list[Any] = [0.0] * len(values)
    slopes[own.results[0]] = by
    total = np.zeros_like(by)
    for k in reversed(range(len(values))):
        o, z, slope = own.operations[k], values[k], slopes[k]
        if o.op == "input":
            adjoint[o.symbol] = adjoint.get(o.symbol, 0.0) + slope
            continue
        total = total + np.abs(slope) * _rounded(o, z, digits)
        if o.op != "const":
            for j, own_slope in zip(o.args, _SLOPES[o.op](z, *(values[a] for a in o.args)), strict=True):
                slopes[j] = slopes[j] + slope * own_slope
    return np.asarray(total)


def _rounded(operation: Operation, value: Any, digits: int) -> Any:
    """Bound of what an operation is off by where its arguments are exact; of a number, as it is stored."""
    if operation.op == "const":
        return constant(value, digits).error
    return 0.0 if operation.op in EXACT else 2.0**-digits * np.abs(value) + TINY[digits]
