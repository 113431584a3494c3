"""Lowering of models of arrays of finite length over rows of sensors longer than they are.

One array over one row gives place and height, several give six coordinates. Which sensors count follows from
where the mover is: weights go to zero smoothly at the ends of each array, so nothing steps as sensors come
and go, and nothing is remembered from one sample to the next. Least squares of the weighted sensors give a
phasor as of an endless wave; further solutions take off what tilt and higher harmonics add to each sensor.
How far from its ends a sensor must be to count is chosen by what ends and noise leave.

Of one row the place is absolute: the middle of what it reads, squared, says the period, and where the array
reaches beyond the row, the middle of the rest and the end of the row say it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.decoupler import Box, Collected, Decoupler, Flag, Redundancy, Watched, short
from hallsym.codegen.lowering import wave_steps
from hallsym.codegen.lowering.arrays import NEAR, TRIALS, Assembly, ends_and_leaves
from hallsym.codegen.lowering.arrays_fit import Arrays, Group, check_along
from hallsym.codegen.lowering.phasors import HARMONICS, WIDE, Phasor, Sample, Window, levelled
from hallsym.codegen.lowering.remainders import UNKNOWNS
from hallsym.codegen.lowering.wave_steps import Pair, wave_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

COUNTS = 1.0
"""Change of a place, over a micrometre, above which a higher harmonic counts."""
MICRON = 1e-6
TINY = 1e-12
"""Added to the energy of all sensors [V2]: it may be zero."""
RAMP = 0.5
"""Wavelengths over which the weight of a sensor goes from 0 to 1."""
COVER = 0.5
"""Share of the least cover of the box below which the flag is set."""
COVERED = "too few sensors see an array: it is at an end of the board or beyond"


@dataclass(frozen=True, eq=False)
class Rows(Arrays):
    """Arrays over rows of sensors, at parameters `p`, over poses `middle` +- `half`."""

    margin: float = 0.0
    """Wavelengths from the ends of an array within which a sensor does not count."""
    rounds: int = 0
    """Solutions after the first: each takes off what the one before says of tilt and higher harmonics."""
    plainly: bool = False
    """Whether higher harmonics are left alone."""

    @property
    def wavelength(self) -> float:
        """In metres."""
        return 2 * pi * self.lc

    @property
    def absolute(self) -> bool:
        """Whether the readings say which period it is: of one array that is not tilted."""
        return not self.turns

    @property
    def lc(self) -> float:
        """Wavelength over 2 pi [m]."""
        return self.groups[0].phasor.lc

    @property
    def rising(self) -> float:
        """1 where the field grows with the height, -1 where it falls."""
        return self.groups[0].phasor.rising

    @cached_property
    def harmonics(self) -> tuple[int, ...]:
        """Those that count, beyond the first."""
        if self.plainly:
            return ()
        reach = np.exp(np.arange(HARMONICS) * self.half[self.height] / self.lc)
        sizes = [np.abs(row.phasor.factor) for row in self.groups]
        share = np.max([size.max(axis=0) / size[:, 0].max() for size in sizes], axis=0)
        counts = share * reach > COUNTS * MICRON / self.lc
        return tuple(n for n in range(2, HARMONICS + 1) if counts[n - 1])

    # -- the decoder -----------------------------------------------------------------------------------------

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pose per place and height of the rows (n_pose, 2 rows), least squares."""
        n, slopes = len(self.groups), np.zeros((2 * len(self.groups), len(self.middle)))
        for k, row in enumerate(self.groups):
            slopes[k, row.axis], slopes[n + k, self.height] = 1.0, 1.0
            slopes[k, 3:], slopes[n + k, 3:] = row.lever.imag, self.rising * row.lever.real
        arm = self.model.family.pose_metric.arm_m
        scale = np.array([1 / arm if k in self.turns else 1.0 for k in range(len(self.middle))])
        return np.asarray(scale[:, None] * np.linalg.pinv(slopes * scale))

    def tilt_of(self, row: Group) -> int:
        """Number of the rotation that lifts one end of the array: about the axis across it."""
        return 4 if row.axis == 0 else 3

    def lift_of(self, row: Group) -> float:
        """What that rotation adds to ln |u| per metre along the row."""
        return (1.0 if row.axis == 0 else -1.0) * self.rising / self.lc

    @cached_property
    def whole(self) -> tuple[float, float]:
        """Places between which all of one array is over its row; the middle of the row where it never is."""
        (row,) = self.groups
        place = np.sort(row.place)
        half = (row.length - float(np.median(np.diff(place)))) / 2
        low, high = float(place[0]) + half, float(place[-1]) - half
        return (low, high) if low <= high else ((low + high) / 2,) * 2

    def travels(self) -> bool:
        """Whether some sensor is beyond the end of its array somewhere in the box."""
        return any(
            np.abs(row.place - self.middle[row.axis]).max() + self.half[row.axis] > row.length / 2
            for row in self.groups
        )


# -- found from the model ------------------------------------------------------------------------------------


PER_WAVE = 16
"""Samples per wavelength of what is seen as the wave passes a sensor."""
BEYOND = 0.02
"""Share of the largest energy that a sensor may see where the wave has passed."""
FROM_END = 0.75
"""Wavelengths from the ends of the wave from which on what a sensor reads is fitted."""
UNDER = 96
"""Places of a sensor under the wave that its reading is fitted to."""


class NeverEnds(InputError):
    """No end of the array lies in the search range."""


def passed(sample: Sample, axis: int, channels: list[int], half: np.ndarray) -> Window:
    """Return what channels read under the wave that passes them, seen beyond a box of `half`.

    What is seen of the pass depends little on the wavelength, which is found twice.
    """
    rough = sample.lc(axis)
    reach = 4 * half[axis] + 8 * pi * rough + WIDE
    for _ in range(2):
        place, length = _pass(sample, axis, channels, reach, 2 * pi * rough)
        under = max(length / 2 - FROM_END * 2 * pi * rough, pi * rough)
        window = Window(sample, axis, channels, np.linspace(-under, under, UNDER), place, rough, length)
        rough = window.lc
    return window


def _pass(
    sample: Sample, axis: int, channels: list[int], reach: float, wavelength: float
) -> tuple[np.ndarray, float]:
    """Return where the middle of the wave is over each channel (n,), from the middle of the box, and its
    length; it must end there."""
    step = wavelength / PER_WAVE
    count = int(reach / step)
    x = step * np.arange(-count, count + 1)
    seen = sample.readings(axis, x, np.full(len(x), sample.middle))[channels]
    field = (seen - seen[:, [0, -1]].mean(axis=1, keepdims=True)) ** 2
    pair = PER_WAVE // 8  # an eighth of a wavelength to both sides: squares of a cosine and a sine
    energy = np.zeros_like(field)
    energy[:, pair:-pair] = field[:, : -2 * pair] + field[:, 2 * pair :]
    total = energy.sum(axis=1)
    place = (energy * x).sum(axis=1) / total
    level = np.array([e[np.abs(x - at) < wavelength].mean() for e, at in zip(energy, place, strict=True)])
    ends = energy[:, [pair, -pair - 1]].max(axis=1)
    if not (np.isfinite(place).all() and (ends < BEYOND * level).all()):
        raise NeverEnds(
            "C of decaying waves is generated for one coordinate that repeats and one height, or for an "
            f"array shorter than the board; what {sample.model.name} reads does not end where the array "
            "has passed."
        )
    return place, float(np.median(total * step / level))


def rows_of(
    model: Model, p: np.ndarray, weight: np.ndarray, box: tuple[np.ndarray, np.ndarray], accuracy: np.ndarray
) -> Rows:
    """Return the rows of a model over a box, its middle made level. Raises `InputError` for too few.

    `box`: its middle and half (n_pose,); `accuracy` (n_pose,): what terms may leave of each coordinate.
    """
    middle, half = box
    height = Arrays.height_of(middle)
    sample = Sample(model, p, middle, (middle[height] - half[height], middle[height] + half[height]), height)
    windows = levelled(sample, half, lambda sample, axis, own: passed(sample, axis, own, half))
    like = Phasor(
        float(np.mean([w.lc for w in windows])), sample.rising(0), float(middle[height]),
        np.zeros(0), np.zeros((0, 0)), np.zeros((2, 0)), (),
    )  # fmt: skip
    rows = tuple(row for w in windows for row in _rows(w, like))
    if len(middle) > height + 1:
        check_along(model, [row.axis for row in rows])
    at = np.concatenate([middle[:3], sample.at[3:]])
    return Rows(model, p, weight, at, half + np.abs(middle - at), accuracy, rows)


def _rows(window: Window, like: Phasor) -> list[Group]:
    """Return the rows of an axis: channels that one array passes at one place across it.

    u of their phasors is 1 where the middle of the array is at 0.
    """
    place = window.place + window.sample.at[window.axis]
    _, offset, factor, _ = window.fitted()
    factor = factor * np.exp(-1j * np.arange(1, HARMONICS + 1) * place[:, None] / window.lc)
    out = []
    for members, lever in window.arrays():
        order = sorted(members, key=lambda k: place[k])
        phasor = replace(like, offset=offset[order], factor=factor[order])
        channels = tuple(window.own[k] for k in order)
        out.append(Group(channels, window.axis, phasor, place[order], lever, window.length))
    return out


MARGINS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Wavelengths from the ends of the wave within which a sensor does not count, of which one is chosen."""
MOST_ROUNDS = 4
TRIED = 1000
"""Poses over which margins and rounds are compared."""
HARDLY = 1.1
"""Times what is left with it: a round that brings less is left out."""


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float) -> Decoupler | None:
    """Return the decoupler of arrays over longer rows over a box; see `lowering.wave.decoupler`.

    None for several arrays that do not end near the box, or where no sensor is ever beyond the end of its
    array. Raises `InputError` for one that does not end.
    """
    middle, half, leaves = ends_and_leaves(model, box, accuracy)
    p, height = np.asarray(p, dtype=float), Arrays.height_of(middle)
    low, high = middle[height] - half[height], middle[height] + half[height]
    several = len(middle) > height + 1
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    try:
        found = replace(rows_of(model, p, weight, (middle, half), leaves), model=own)
    except NeverEnds:
        if several:
            return None
        raise
    if several and not found.travels():
        return None
    tilted = float(np.abs(np.array([row.lever for row in found.groups])).max(axis=0) @ half[3:])
    first = found.groups[0].phasor
    plain = replace(first, factor=first.factor[:, :1], harmonics=())  # functions of it are bounded
    wave = wave_of(plain, (low - tilted, high + tilted), float(leaves[0]))

    def assembly(found: Rows) -> _Assembly:
        return _Assembly(found, (wave,) * len(found.groups), box)

    return assembly(_best(found, assembly)).make()


def _best(found: Rows, assembly: "Callable[[Rows], _Assembly]") -> Rows:
    """Return the rows with the margin that leaves least of ends and noise, and rounds that are worth it."""
    tried: list[tuple[float, int, Rows]] = []
    least = 1 if found.turns else 0
    for margin in MARGINS:
        one = replace(found, margin=margin, rounds=least, plainly=True)
        if 2 * margin * one.wavelength >= min(r.length for r in one.groups) - one.wavelength:
            continue
        size, price = _left(assembly(one)), 1.0
        tried.append((size, len(tried), one))
        for rounds in range(1, MOST_ROUNDS + 1):
            one = replace(found, margin=margin, rounds=rounds)
            before, size, price = size, _left(assembly(one)), price * HARDLY
            if not size * HARDLY < before:
                break
            tried.append((size * price, len(tried), one))
    size, _, best = min(tried, default=(np.inf, 0, found))
    if not np.isfinite(size):
        along = " and ".join(found.model.pose[axis] for axis in found.axes)
        raise InputError(
            f"Over the box too few sensors see an array at its ends to tell {along} and which period that is "
            f"in; give fewer {along} with --range, or more sensors in the layout."
        )
    return best


def _left(made: "_Assembly") -> float:
    """What is left, rms, of coordinates over their accuracy, with the noise of the calibration."""
    found = made.found
    pose, readings = found.trials(7, TRIED)
    noise = np.random.default_rng(8).standard_normal(readings.shape) / np.sqrt(found.weight)[:, None]
    made.steps()
    off = made.decoded(readings + noise, pose[:2]) - pose
    if not np.isfinite(off).all() or np.abs(off[list(found.axes)]).max() >= found.wavelength / 4:
        return np.inf  # where no sensor counts there is no pose
    return float(np.sqrt(((off / found.accuracy[:, None]) ** 2).mean()))


@dataclass(eq=False)
class _Assembly(Assembly):
    found: Rows

    def wide(self, axis: int) -> bool:
        return not self.found.absolute and super().wide(axis)

    # -- from readings to places and heights ---------------------------------------------------------------

    def rows(self) -> list[ca.SX]:
        """Add the steps from the readings to places from the middle [m] and logarithms of all rows."""
        made, found = self.made, self.found
        made.entry("lc", found.lc, "m", "wavelength over 2 pi", "sign")
        made.entry("wavelength", found.wavelength, "m", "wavelength", "sign")
        made.entry("per_wave", 1 / found.wavelength, "1/m", "periods per metre", "sign")
        wave_steps.least_inside(made, self.waves[:1])
        self.at = {axis: self._first(axis, members) for axis, members in found.axes.items()}
        for row, name in zip(found.groups, self.names, strict=True):
            self._weights(row, name)
        tags = [*(f"_{k}" for k in range(found.rounds)), ""]
        seen = self._solved(tags[0])
        self.spread = self.spread_of([value.name() for value in seen.values()])
        self._covered(tags[0])
        for before, tag in pairwise(tags):
            tilts = sorted({found.tilt_of(row) for row in found.groups}) if found.turns else ()
            turns = {k: self._first_turn(k, seen, before) for k in tilts}
            seen = self._solved(tag, before, turns)
        return list(seen.values())

    def _center(self, axis: int) -> ca.SX:
        """The middle of the box along an axis."""
        value, column = float(self.found.middle[axis]), short(self.found.model.pose[axis])
        if not value:
            return ca.SX(0)
        return self.made.entry(f"{column}_middle", value, "m", "middle of the box")

    def _first(self, axis: int, members: Sequence[int]) -> ca.SX:
        """The place along an axis that all its sensors agree on, in the period that is meant."""
        made, column, cos, sin = self.made, short(self.found.model.pose[axis]), [], []
        for k in members:
            row = self.found.groups[k]
            design = row.phasor.design()
            for j, (name, reading) in enumerate(self.readings_of(row).items()):
                offset = made.entry(f"offset_{name}", float(row.phasor.offset[j]), "V", f"offset of {name}")
                f = made.step(f"field_{name}", reading - offset)
                cos.append(f * made.entry(f"cos_{name}", design[0, j], "V", f"read by {name} of the cosine"))
                sin.append(f * made.entry(f"sin_{name}", design[1, j], "V", f"read by {name} of the sine"))
                about = f"place at which the array is over {name}"
                made.entry(f"at_{name}", float(row.place[j]), "m", about)
        u = made.total(f"cos_all_{column}", cos, "all alike"), made.total(f"sin_all_{column}", sin)
        if self.found.absolute:
            near = self._middle_seen()
        else:
            near = made.symbols[f"{column}_near_m"] if self.wide(axis) else self._center(axis)
        return place_steps(made, self.waves[0], u, near, f"_{column}")

    def _middle_seen(self) -> ca.SX:
        """The middle of one array as far as the squares of the readings say it."""
        made, (row,), (low, high) = self.made, self.found.groups, self.found.whole
        names = list(self.readings_of(row))
        energy = [made.step(f"energy_{n}", made.symbols[f"field_{n}"] ** 2) for n in names]
        total = made.total("energy", energy, "[V2] of all sensors")
        places = [made.symbols[f"at_{n}"] * e for n, e in zip(names, energy, strict=True)]
        at = made.step("energy_middle", made.total("energy_first", places) / (total + TINY),
                       "[m] middle of what is read, squared")  # fmt: skip
        if not low < high:
            return at
        ends = {
            "low": made.entry("low_whole", low, "m", "least place with all of the array over sensors"),
            "high": made.entry("high_whole", high, "m", "greatest such place"),
        }
        up, down = (made.step(f"beyond_{n}", (at + at) - end) for n, end in ends.items())
        upper = made.step("chosen_upper", ca.if_else(at < down, down, at))
        return made.step(
            "chosen_middle", ca.if_else(up < upper, up, upper), "[m] also at the ends of the board"
        )

    def _weights(self, row: Group, tag: str) -> None:
        """Weight of each sensor, w^2 (3 - 2 w): 1 well under the array, 0 beyond, smooth."""
        made, found = self.made, self.found
        ramp = RAMP * found.wavelength
        half = row.length / 2 - found.margin * found.wavelength
        about = "half of what counts of the array, over the ramp"
        start = made.entry(f"depth_{tag}", half / ramp, "1", about)
        rate = made.entry("per_ramp", 1 / ramp, "1/m", "a weight goes from 0 to 1 over its inverse", "sign")
        for name in self.readings_of(row):
            at = made.symbols[f"at_{name}"]
            beside = made.step(f"beside_{name}", self.at[row.axis] - at, "[m] of the middle of the array")
            depth = made.step(f"deep_{name}", start - ca.fabs(beside) * rate)
            # 0 to 1 without a branch: its rounding is a millionth of a weight, far away half of one
            between = (ca.fabs(depth) - ca.fabs(depth - 1.0) + 1.0) * 0.5
            share = made.step(f"share_{name}", between, most=1.5)
            made.step(f"weight_{name}", share * share * (3.0 - (share + share)))

    def _solved(
        self, tag: str, before: str | None = None, turns: dict[int, ca.SX] | None = None
    ) -> dict[str, ca.SX]:
        """Place from the middle and logarithm of each row by label.

        `before`: the tag of the solution whose harmonics are taken off, `turns`: its rotations.
        """
        found, made, places, logs = self.found, self.made, {}, {}
        for k, (row, name) in enumerate(zip(found.groups, self.names, strict=True)):
            turn = turns[found.tilt_of(row)] if turns else None
            u = self._vector(row, name, tag, before, turn)
            log = wave_steps.logarithm_steps(made, self.waves[k], u, f"_{name}{tag}")
            place = place_steps(made, self.waves[0], u, self.at[row.axis], f"_{name}{tag}")
            away = made.step(f"along_{name}{tag}", place - self._center(row.axis), "[m] from the middle")
            places[f"along_{name}"], logs[f"log_{name}"] = away, log
        return places | logs

    def _first_turn(self, k: int, values: dict[str, ca.SX], tag: str) -> ca.SX:
        """Estimate of a rotation, within its range: of readings of no pose it could be anything."""
        made, column = self.made, short(self.found.model.pose[k])
        half_more = 1.5 * float(self.found.half[3:].max())
        most = made.entry(f"most_{column}", half_more, "rad", f"largest {column} that is taken out", "sign")
        turn = made.step(f"seen_{column}{tag}", self.total(k, values), "[rad] estimate")
        up = made.step(f"above_{column}{tag}", ca.if_else(turn < most, turn, most))
        return made.step(f"taken_{column}{tag}", ca.if_else(up > -most, up, -most))

    def _vector(self, row: Group, name: str, tag: str, before: str | None, turn: ca.SX | None) -> Pair:
        made, sensors = self.made, list(self.readings_of(row))
        field = [made.symbols[f"field_{s}"] for s in sensors]
        cos, sin, weight = ([made.symbols[f"{n}_{s}"] for s in sensors] for n in ("cos", "sin", "weight"))
        lifted: list[ca.SX] = []
        if turn is not None:  # how much stronger the field is at each sensor than at the array's middle
            about = "of ln |u| per metre and rotation"
            lift = made.entry(f"lift_{name}", self.found.lift_of(row), "1/m", about)
            steep = made.step(f"steep_{name}{tag}", lift * turn)
            for s in sensors:
                v = made.step(f"tilt_{s}{tag}", steep * made.symbols[f"beside_{s}"])
                lifted.append(made.step(f"lifted_{s}{tag}", 1.0 + v * (1.0 + v * (0.5 + v * (1 / 6)))))
            both = (cos, sin)
            cos, sin = (
                [
                    made.step(f"lifted_{axis}_{s}{tag}", c * v)
                    for s, c, v in zip(sensors, part, lifted, strict=True)
                ]
                for axis, part in zip(wave_steps.AXES, both, strict=True)
            )
        if before is not None:
            field = self._without_harmonics(row, name, field, lifted, before, tag)

        def product(label: str, a: Sequence[ca.SX], b: Sequence[ca.SX], tag: str) -> ca.SX:
            return made.total(f"{label}_{name}{tag}", [x * y for x, y in zip(a, b, strict=True)])

        own = tag if turn is not None or before is None else "_0"  # without tilt all solutions share it
        wc = [made.step(f"wcos_{s}{own}", w * c) for s, w, c in zip(sensors, weight, cos, strict=True)]
        ws = [made.step(f"wsin_{s}{own}", w * c) for s, w, c in zip(sensors, weight, sin, strict=True)]
        pairs = {"cos_cos": (wc, cos), "cos_sin": (wc, sin), "sin_sin": (ws, sin)}
        cc, cs, ss = (product(label, *pair, own) for label, pair in pairs.items())
        per = self._per_cover(name, cc * ss - cs * cs, own)
        re, im = product("cos_seen", wc, field, tag), product("sin_seen", ws, field, tag)
        return self._clamped((ss * re - cs * im, cc * im - cs * re), per, f"{name}{tag}")

    def _per_cover(self, name: str, determinant: ca.SX, tag: str) -> ca.SX:
        """One over the determinant of a normal matrix, no less than where the flag is set."""
        made = self.made
        cover = made.step(f"cover_{name}{tag}", determinant, "[V4] cosine told from sine")
        value = COVER * float(self.tried([cover.name()]).min())
        least = made.entry(f"least_cover_{name}", value, "V4", "share of the least of the box", "sign")
        clamped = made.step(f"held_cover_{name}{tag}", ca.if_else(cover > least, cover, least))
        return made.step(f"per_cover_{name}{tag}", 1.0 / clamped)

    def _clamped(self, wide: Pair, per: ca.SX, tag: str) -> Pair:
        """A phasor, no longer than any of the box is, from what is as many times it as 1 over `per`."""
        made, u = self.made, []
        most = made.entry("longest", 2.0 / self.waves[0].least, "1", "most of a phasor", "sign")
        for axis, v in zip(wave_steps.AXES, wide, strict=True):
            raw = made.step(f"raw_{axis}_{tag}", v * per)
            low = made.step(f"above_{axis}_{tag}", ca.if_else(raw > -most, raw, -most))
            u.append(made.step(f"held_{axis}_{tag}", ca.if_else(low < most, low, most)))
        return u[0], u[1]

    def _without_harmonics(
        self, row: Group, name: str, field: Sequence[ca.SX], lifted: Sequence[ca.SX], before: str, tag: str
    ) -> list[ca.SX]:
        """Readings without the higher harmonics that an earlier solution says."""
        made, out = self.made, list(field)
        cos, sin = (made.symbols[f"held_{axis}_{name}{before}"] for axis in wave_steps.AXES)
        powers = wave_steps.Powers(made, cos, sin, f"_{name}{tag}_of")
        known = [{1: v} for v in lifted]
        for n in self.found.harmonics:
            re, im = powers(n)
            design = row.phasor.design(n)
            for k, sensor in enumerate(self.readings_of(row)):
                a, b = (
                    made.entry(f"{part}_{n}_{sensor}", design[j, k], "V", f"read by {sensor} of {part} {n}")
                    for j, part in enumerate(wave_steps.AXES)
                )
                off = a * re + b * im
                if lifted:
                    off = off * wave_steps.power(made, known[k], n, f"lifted_{sensor}{tag}")
                out[k] = made.step(f"left_{n}_{sensor}{tag}", out[k] - off)
        return out

    # -- the linear pose -----------------------------------------------------------------------------------

    @property
    def labels(self) -> list[str]:
        """Of what the pose is linear in: places, then logarithms."""
        return [f"along_{n}" for n in self.names] + [f"log_{n}" for n in self.names]

    @property
    def matrix(self) -> np.ndarray:
        """Pose per label (6, labels)."""
        n = len(self.names)
        scale = np.array(n * [1.0] + n * [self.found.rising * self.found.lc])
        return np.asarray(self.found.inverse * scale)

    def _covered(self, tag: str) -> None:
        """Add the step that the flag of the cover looks at: what the row that has least has to spare."""
        made, (first, *others) = self.made, [
            self.made.step(
                f"covered_{name}",
                self.made.symbols[f"cover_{name}{tag}"] - self.made.symbols[f"least_cover_{name}"], "[V4]",
            )
            for name in self.names
        ]  # fmt: skip
        for name, own in zip(self.names[1:], others, strict=True):
            first = made.step(f"cover_to_{name}", ca.if_else(first < own, first, own))
        made.step("cover", first)
        made.entry("least_cover", 0.0, "V4", "what each row must have more than its least", "value")

    def linear(self) -> list[ca.SX]:
        """Add the steps from the readings to the linear pose; returns its displacements from the middle."""
        seen = self.rows()
        self.least()
        return self.pose(seen, {})

    def redundancy(self, linear: Sequence[ca.SX]) -> Redundancy | None:
        """Add what is left of each sensor under an array, weighted as it counts."""
        made, watched = self.made, []
        last = self.found.harmonics[-1:] if self.found.rounds else ()
        lifted = "lifted_" if self.found.turns else ""
        for row, name in zip(self.found.groups, self.names, strict=True):
            if len(row.channels) <= UNKNOWNS:
                continue
            seen = [made.symbols[f"held_{axis}_{name}"] for axis in wave_steps.AXES]
            for number, s in zip(row.channels, self.readings_of(row), strict=True):
                rest = made.symbols[f"left_{last[0]}_{s}" if last else f"field_{s}"]
                for axis, part in zip(wave_steps.AXES, seen, strict=True):
                    rest = rest - made.symbols[f"{lifted}{axis}_{s}"] * part
                off = made.step(f"off_{s}", rest, "[V] beside what is decoded")
                made.step(f"rest_{s}", made.symbols[f"weight_{s}"] * off)
                watched.append(Watched(f"rest_{s}", (number,), f"off_{s}"))
        return residual.summed(made, watched) if watched else None

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Status bits beyond the ranges."""
        return (*super().flags, Flag("COVER", "cover", "least_cover", COVERED))

    def said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        """Return sentences for header and report."""
        found = self.found
        rows = ", ".join(
            f"{n} {counted(len(r.channels), 'reading')} over {1e3 * np.ptp(r.place):.4g} mm, array of "
            f"{1e3 * r.length:.3g} mm"
            for n, r in zip(self.names, found.groups, strict=True)
        )
        return (
            f"Rows: {rows}, wavelength {1e3 * found.wavelength:.6g} mm.",
            f"A sensor counts from {1e3 * found.margin * found.wavelength:.3g} mm inside the "
            "ends of its array on, and fully half a wavelength further: weights are smooth, so nothing steps "
            "where sensors come and go.",
            "Give all readings at every sample, also of sensors that no array is over: the code weights "
            "them.",
            f"{found.model.pose[0]} is absolute, from the readings of one sample."
            if found.absolute
            else "What says the period, x_near_m and y_near_m where they are inputs, is the position so far "
            f"or the commanded one, within {1e3 * NEAR * found.wavelength:.2g} mm: it chooses the period and "
            "nothing else.",
            f"{wave_steps.REVERSED}, or nearly: in many places no bit is raised.",
            *wave_steps.measured("It", leaves, TRIALS, " of the poses of the model"),
        )


def place_steps(made: Collected, wave: wave_steps.Wave, u: Pair, near: ca.SX, tag: str = "") -> ca.SX:
    """Add the steps of the place [m] of a phase in the period next to another place; returns it."""
    lc, whole, per = (made.symbols[name] for name in ("lc", "wavelength", "per_wave"))
    place = made.step(f"in_wave{tag}", lc * wave_steps.arctangent_steps(made, wave, u, tag))
    number = wave_steps.periods_steps(made, (near - place) * per, tag)
    return made.step(f"place{tag}", place + whole * number, "[m]")
