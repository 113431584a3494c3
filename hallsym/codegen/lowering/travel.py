"""Lowering of models of a wave of finite length over a longer row of sensors: absolute place and height.

The sensors that see the wave are weighted smoothly by their distance from its ends, so nothing steps as it
travels, and nothing is remembered from one sample to the next. Where it is follows from which of them see it:
the middle of what they read, squared, says the period, and where the wave reaches beyond the row, the middle
of the rest and the end of the row say it. Least squares of the weighted sensors then give the phasor as of an
endless wave; how far from its ends a sensor must be to count is chosen by what ends and noise leave.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Box, Collected, Decoupler, Flag, Margin, Step, Values, short, unit
from hallsym.codegen.intervals import Enclosure, constant, half_ulp
from hallsym.codegen.lowering import wave_steps
from hallsym.codegen.lowering.passing import passes
from hallsym.codegen.lowering.phasors import HARMONICS, Phasor, Sample
from hallsym.codegen.lowering.wave_steps import Pair, Wave
from hallsym.errors import InputError, counted
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

COUNTS = 1.0
"""Change of a place, over a micrometre, above which a higher harmonic counts."""
MICRON = 1e-6
TINY = 1e-12
"""Added to the energy of all sensors [V2]: it may be zero."""
RAMP = 0.5
"""Wavelengths over which the weight of a sensor goes from 0 to 1."""
NO_COVER = 1e-9
"""Determinant of the normal matrix [V4] of no sensors."""
BATCH = 1000


@dataclass(frozen=True, eq=False)
class Row:
    """Sensors of a model at parameters `p` under a wave of a `length` [m], with a `margin` from its ends.

    `place` (n,): x at which the middle of the wave is over each sensor [m]; `factor` (n, HARMONICS) complex:
    sensor k reads offset + Re sum c_kn u^n, u = exp((z - middle) / lc ... + i x / lc), away from the ends.
    """

    model: Model
    p: np.ndarray
    weight: np.ndarray
    low: np.ndarray
    high: np.ndarray
    """Ends of the box (2,)."""
    lc: float
    rising: float
    length: float
    place: np.ndarray
    offset: np.ndarray
    factor: np.ndarray
    margin: float = 0.0
    """Wavelengths from the ends of the wave."""
    rounds: int = 0

    @property
    def wavelength(self) -> float:
        """In metres."""
        return 2 * pi * self.lc

    @property
    def middle(self) -> np.ndarray:
        """Pose in the middle of the box (2,)."""
        return (self.low + self.high) / 2

    @cached_property
    def board(self) -> tuple[float, float]:
        """Ends of the row of sensors [m], half a pitch beyond the last ones."""
        place = np.sort(self.place)
        half = float(np.median(np.diff(place))) / 2
        return float(place[0]) - half, float(place[-1]) + half

    @property
    def whole(self) -> tuple[float, float]:
        """Places between which all of the wave is over the row; the middle of the row where it never is."""
        low, high = self.board[0] + self.length / 2, self.board[1] - self.length / 2
        return (low, high) if low <= high else ((low + high) / 2,) * 2

    @cached_property
    def harmonics(self) -> tuple[int, ...]:
        """Those that count, beyond the first."""
        size = np.abs(self.factor).max(axis=0)
        half = (self.high[1] - self.low[1]) / 2 / self.lc
        share = size / size[0] * np.exp(half * np.arange(HARMONICS))
        return tuple(n for n in range(2, HARMONICS + 1) if share[n - 1] > COUNTS * MICRON / self.lc)

    @property
    def plain(self) -> Phasor:
        """The first harmonic alone, of which functions are bounded."""
        n = len(self.place)
        return Phasor(
            self.lc, self.rising, float(self.middle[1]), np.zeros(n), self.factor[:, :1], np.zeros((2, n)), ()
        )

    # -- the model itself ------------------------------------------------------------------------------------

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.reading)

    @cached_property
    def _decoded(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.decoded)

    def readings(self, pose: np.ndarray) -> np.ndarray:
        """Return readings (n, s) at poses (2, s)."""
        return np.asarray(self._run(self.p, np.zeros(len(self.model.zeros)), list(pose), [])[0])

    def exact(self, readings: np.ndarray) -> np.ndarray:
        """Return the poses (2, s) of weighted least squares over all channels: the reference decoder."""
        zeros, parts = np.zeros(len(self.model.zeros)), []
        with np.errstate(all="ignore"):
            for first in range(0, readings.shape[1], BATCH):
                part = list(np.asarray(readings[:, first : first + BATCH], dtype=float))
                parts.append(self._decoded(self.p, zeros, part, [], self.weight)[0])
        return np.hstack(parts)

    def poses(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random poses of the box, corners among them."""
        share = rng.random((2, count))
        share[:, : count // 20] = np.round(share[:, : count // 20])
        return np.asarray(self.low[:, None] + (self.high - self.low)[:, None] * share)

    # -- the decoder -----------------------------------------------------------------------------------------

    def decoded(self, readings: np.ndarray, rounds: int) -> np.ndarray:
        """Return the poses (2, s) as the generated code computes them, functions exact."""
        r = readings - self.offset[:, None]
        with np.errstate(all="ignore"):
            x = next_to(self.lc, self.first(r), (r * self.factor[:, :1].conj()).sum(axis=0))
            w = self.weights(x)
            rows = np.stack([self.factor[:, 0].real, -self.factor[:, 0].imag])  # 2, n
            normal = np.einsum("ik,jk,ks->sij", rows, rows, w)
            seen = np.einsum("ik,ks,ks->si", rows, w, r)
            inverse = np.linalg.inv(normal + np.eye(2) * (np.linalg.det(normal) < NO_COVER)[:, None, None])
            u = _complex(inverse, seen)
            for _ in range(rounds):
                left = seen.copy()
                for n in self.harmonics:
                    own = self.factor[:, n - 1]
                    power = u**n
                    cross = np.einsum("ik,jk,ks->sij", rows, np.stack([own.real, -own.imag]), w)
                    left -= np.einsum("sij,js->si", cross, np.stack([power.real, power.imag]))
                u = _complex(inverse, left)
            height = self.middle[1] + self.rising * self.lc * np.log(np.abs(u))
        return np.array([next_to(self.lc, x, u), height])

    def first(self, r: np.ndarray) -> np.ndarray:
        """Return the middle (s,) of what sensors read, squared; at the ends of the row of all the wave."""
        energy = r * r
        at = (energy * self.place[:, None]).sum(axis=0) / (energy.sum(axis=0) + TINY)
        low, high = self.whole
        return np.minimum(np.maximum(at, 2 * at - high), 2 * at - low) if low < high else at

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Return the weight (n, s) of each sensor for a wave whose middle is at x: 0 beyond its ends."""
        return weights(self.place, x, self.length, self.margin, self.wavelength)


def weights(place: np.ndarray, x: np.ndarray, length: float, margin: float, wave: float) -> np.ndarray:
    """Return the weight (n, s) of sensors at `place` (n,) for a wave whose middle is at x (s,)."""
    away = np.abs(place[:, None] - x)
    inside = np.clip((length / 2 - margin * wave - away) / (RAMP * wave), 0.0, 1.0)
    return np.asarray(inside * inside * (3 - 2 * inside))


def next_to(lc: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the place of the phase of u in the period next to x."""
    place, wave = lc * np.angle(u), 2 * pi * lc
    return np.asarray(place + wave * np.floor((x - place) / wave + 0.5))


def _complex(inverse: np.ndarray, seen: np.ndarray) -> np.ndarray:
    cos, sin = np.einsum("sij,sj->is", inverse, seen)
    return np.asarray(cos + 1j * sin)


def row_of(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Row:
    """Return the row of sensors of a model. Raises `InputError` where no sensor sees the wave come and go."""
    low, high = np.array([box.ends[c] for c in model.pose]).T
    sample = Sample(model, p, np.array([(low[0] + high[0]) / 2, 0.0]), (low[1], high[1]), 1)
    rough, every = sample.lc(0), range(len(model.channels))
    reach = 1.5 * (high[0] - low[0]) + 2 * 2 * pi * rough
    passed, window, lc = passes(sample, 0, every, reach, rough)
    fitted = [window.fitted(k, lc)[0] for k in every]
    offset, factor = np.array([f[0].real for f in fitted]), np.array([f[1:] for f in fitted])
    return Row(model, p, weight, low, high, lc, sample.rising(0), passed.length, passed.place, offset, factor)


MARGINS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Wavelengths from the ends of the wave within which a sensor does not count, of which one is chosen."""
TRIALS = 4000
COVER = 0.5
"""Share of the least cover of the box below which the flag is set."""
MOST_ROUNDS = 4
COVERED = "too few sensors see the array: it is at an end of the board or beyond"


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float) -> Decoupler:
    """Return the decoupler of a travelling wave at parameters `p` over a box; see `lowering.wave.decoupler`.

    The first pose coordinate is along the wave, the second its height.
    """
    row = row_of(model, np.asarray(p, dtype=float), weight, box)
    wave = wave_steps.wave_of(row.plain, box.ends[model.pose[1]], accuracy)
    best = min((_Tried(row, wave, margin, accuracy) for margin in MARGINS), key=lambda t: t.size)
    if not best.resolved:
        raise InputError(
            f"Over the box the sensors do not say which period {model.pose[0]} is in: too few of them see "
            f"the array at its ends; give fewer with --range {model.pose[0]}."
        )
    row = replace(best.row, rounds=best.rounds)
    return _Assembly(row, wave, box).make()


class _Tried:
    """What a margin leaves of poses of the box, with the noise of the calibration."""

    def __init__(self, row: Row, wave: Wave, margin: float, accuracy: float) -> None:
        self.row, self.size, self.resolved, self.rounds = replace(row, margin=margin), np.inf, False, 0
        if 2 * margin * row.wavelength >= row.length - row.wavelength:
            return
        rng = np.random.default_rng(7)
        pose = row.poses(rng, TRIALS)
        readings = row.readings(pose)
        noisy = readings + rng.standard_normal(readings.shape) / np.sqrt(row.weight)[:, None]
        with np.errstate(all="ignore"):  # where no sensor counts there is no pose
            found = self.row.decoded(noisy, 0)
            for rounds in range(1, MOST_ROUNDS + 1):
                again = self.row.decoded(noisy, rounds)
                if not np.abs(again - found).max() >= accuracy / 4:
                    break
                found, self.rounds = again, rounds
            off = found - pose
        self.resolved = bool(np.abs(off[0]).max() < row.wavelength / 4)
        self.size = float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


@dataclass(eq=False)
class _Assembly:
    row: Row
    wave: Wave
    given: Box
    made: Collected = field(default_factory=Collected)

    def make(self) -> Decoupler:
        model, made = self.row.model, self.made
        inputs = model.channels
        made.begin(model, inputs)
        self._add()
        made.keep((*map(short, model.pose), "inside", "cover"))
        ends = self._ends
        values, leaves = made.values(inputs, ends), self._leaves
        return made.finished(
            model, inputs, ends, margins=(Margin(inputs[0], "lc"),), exact=self.row.exact,
            flags=(
                Flag("FIELD", "inside", "least_inside", wave_steps.FIELD),
                Flag("COVER", "cover", "least_cover", COVERED),
            ),
            leaves=leaves, bounded=Rounding(self.row, self.wave, tuple(made.steps), values, self.drawn),
            drawn=self.drawn, said=self._said(leaves), evident=False,
        )  # fmt: skip

    @cached_property
    def _ends(self) -> Box:
        seen = self.row.readings(self.row.poses(np.random.default_rng(4), TRIALS))
        ends = {}
        for c, values in zip(self.row.model.channels, seen, strict=True):
            end = float(f"{(1 + wave_steps.SWING) * np.abs(values).max():.3g}")
            ends[c] = self.given.ends.get(c, (-end, end))
        return Box(ends)

    def drawn(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return self.row.readings(self.row.poses(rng, count))

    @cached_property
    def _leaves(self) -> dict[str, float]:
        """What ends, harmonics and functions leave of each coordinate."""
        pose = self.row.poses(np.random.default_rng(5), TRIALS)
        readings = self.row.readings(pose)
        off = self.row.decoded(readings, self.row.rounds) - self.row.exact(readings)
        functions = self.wave.error * self.row.lc
        return {
            c: wave_steps.SAFE * (float(np.abs(v).max()) + functions)
            for c, v in zip(self.row.model.pose, off, strict=True)
        }

    def _said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        row = self.row
        return (
            f"{counted(len(row.model.channels), 'sensor')} over {1e3 * row.board[0]:.4g} to "
            f"{1e3 * row.board[1]:.4g} mm, an array of {1e3 * row.length:.3g} mm with a wavelength of "
            f"{1e3 * row.wavelength:.6g} mm: {row.model.pose[0]} is absolute, from the readings of one "
            f"sample. A sensor counts from {1e3 * row.margin * row.wavelength:.3g} mm inside the ends of the "
            "array on, and fully half a wavelength further.",
            "Give all readings at every sample, also of sensors that the array is not over: the code weights "
            "them.",
            *wave_steps.measured(wave_steps.AGAINST, leaves, TRIALS),
        )

    def _add(self) -> None:
        row, made = self.row, self.made
        self.names = [short(c) for c in row.model.channels]
        self.lc = made.entry("lc", row.lc, "m", "wavelength over 2 pi")
        made.entry("wavelength", row.wavelength, "m", "wavelength")
        made.entry("per_wave", 1 / row.wavelength, "1/m", "periods per metre")
        wave_steps.least_inside(made, (self.wave,))
        self._table()
        alike = [[a * f for a, f in zip(part, self.fields, strict=True)] for part in (self.cos, self.sin)]
        everything = made.total("cos_all", alike[0], "all alike"), made.total("sin_all", alike[1])
        x = place_steps(made, self.wave, everything, self._middle(), "_first")
        u = self._vector(self._weights(x))
        log = wave_steps.logarithm_steps(made, self.wave, u)
        place = place_steps(made, self.wave, u, x)
        along, height = row.model.pose
        middle = made.entry("middle", float(row.middle[1]), "m", f"{height} at which the phasor is 1")
        level = middle + made.symbols[f"zero_{short(height)}"]
        rise = self.lc * log
        made.step(short(along), place + made.symbols[f"zero_{short(along)}"], f"[{unit(along)}]")
        made.step(short(height), level + rise if row.rising > 0 else level - rise, f"[{unit(height)}]")

    def _table(self) -> None:
        row, made = self.row, self.made
        self.cos, self.sin, self.places, self.fields = [], [], [], []
        for name, c, at, off in zip(self.names, row.factor[:, 0], row.place, row.offset, strict=True):
            self.cos.append(made.entry(f"cos_{name}", c.real, "V", f"read by {name} of the cosine"))
            self.sin.append(made.entry(f"sin_{name}", -c.imag, "V", f"read by {name} of the sine"))
            self.places.append(made.entry(f"at_{name}", at, "m", f"place at which the array is over {name}"))
            offset = made.entry(f"offset_{name}", off, "V", f"offset of {name} under the array")
            reading = made.symbols[row.model.channels[len(self.cos) - 1]]
            self.fields.append(made.step(f"field_{name}", reading - offset))

    def _middle(self) -> ca.SX:
        """The middle of the wave as far as the squares of the readings say it."""
        made, row = self.made, self.row
        energy = [made.step(f"energy_{n}", f * f) for n, f in zip(self.names, self.fields, strict=True)]
        total = self.made.total("energy", energy, "[V2] of all sensors")
        first = self.made.total("energy_first", [a * e for a, e in zip(self.places, energy, strict=True)])
        at = made.step("energy_middle", first / (total + TINY), "[m] middle of what is read, squared")
        low, high = row.whole
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

    def _weights(self, x: ca.SX) -> list[ca.SX]:
        """Weight of each sensor: 1 well under the wave, 0 beyond, smooth."""
        made, row, out = self.made, self.row, []
        ramp = RAMP * row.wavelength
        half = row.length / 2 - row.margin * row.wavelength
        start = made.entry("depth", half / ramp, "1", "half of what counts of the array, over the ramp")
        rate = made.entry("per_ramp", 1 / ramp, "1/m", "a weight goes from 0 to 1 over its inverse")
        for name, at in zip(self.names, self.places, strict=True):
            away = made.step(f"away_{name}", ca.fabs(at - x))
            depth = made.step(f"depth_{name}", start - away * rate)
            out.append(smooth_weight(made, depth, name))
        return out

    def _vector(self, weights: Sequence[ca.SX]) -> Pair:
        """Weighted least squares of what the sensors read, higher harmonics taken off by rounds."""
        made, row = self.made, self.row
        wc = [made.step(f"wcos_{n}", w * c) for n, w, c in zip(self.names, weights, self.cos, strict=True)]
        ws = [made.step(f"wsin_{n}", w * s) for n, w, s in zip(self.names, weights, self.sin, strict=True)]
        both = list(zip(wc, ws, strict=True))

        def sums(name: str, other: Sequence[ca.SX]) -> Pair:
            return (
                self.made.total(f"cos_{name}", [c * o for (c, _), o in zip(both, other, strict=True)]),
                self.made.total(f"sin_{name}", [s * o for (_, s), o in zip(both, other, strict=True)]),
            )

        cc, cs = sums("by_cos", self.cos)
        ss = self.made.total("sin_by_sin", [s * o for s, o in zip(ws, self.sin, strict=True)])
        seen = sums("seen", self.fields)
        cover = made.step("cover", cc * ss - cs * cs, "[V4] how well the sensors tell cosine from sine")
        weighted = row.weights(row.poses(np.random.default_rng(3), COVERS_SEEN)[0])
        own = least_cover(weighted, row.factor[:, 0].real, -row.factor[:, 0].imag)
        least = made.entry("least_cover", own, "V4", "share of the least of the box")
        per = made.step("per_cover", 1.0 / made.step("held_cover", ca.if_else(cover > least, cover, least)))
        cross = {n: self._cross(n, sums) for n in row.harmonics} if row.rounds else {}
        most = made.entry("longest", 2.0 * self.wave.outer, "1", "most of a phasor")

        def solved(cos: ca.SX, sin: ca.SX) -> Pair:
            """The phasor times the cover."""
            return ss * cos - cs * sin, cc * sin - cs * cos

        def held(wide: Pair, tag: str) -> Pair:
            """The phasor, no longer than any of the box is."""
            re, im = (made.step(f"raw_{a}{tag}", v * per) for a, v in zip(wave_steps.AXES, wide, strict=True))
            low = [
                made.step(f"held_{a}_low{tag}", ca.if_else(v > -most, v, -most))
                for a, v in zip(wave_steps.AXES, (re, im), strict=True)
            ]
            re, im = (
                made.step(f"held_{a}{tag}", ca.if_else(v < most, v, most))
                for a, v in zip(wave_steps.AXES, low, strict=True)
            )
            return re, im

        wide = solved(*seen)
        for k in range(1, row.rounds + 1):
            powers = wave_steps.Powers(made, *held(wide, f"_{k - 1}"), f"_{k}")
            off = [ca.SX(0), ca.SX(0)]
            for n, ((a, b), (c, d)) in cross.items():
                re, im = powers(n)
                off = [off[0] + (a * re + b * im), off[1] + (c * re + d * im)]
            left = [
                made.step(f"left_{a}_{k}", s - o) for a, s, o in zip(wave_steps.AXES, seen, off, strict=True)
            ]
            wide = solved(left[0], left[1])
        return held(wide, f"_{row.rounds}")

    def _cross(self, n: int, sums: Callable[[str, Sequence[ca.SX]], Pair]) -> tuple[Pair, Pair]:
        """Weighted sums of what the sensors read of a harmonic: per cosine and sine of its power."""
        made, factor = self.made, self.row.factor[:, n - 1]
        re, im = (
            [
                made.entry(f"{a}_{n}_{name}", float(v), "V", f"read by {name} of {a} {n}")
                for name, v in zip(self.names, values, strict=True)
            ]
            for a, values in (("cos", factor.real), ("sin", -factor.imag))
        )
        (a, c), (b, d) = sums(f"by_cos_{n}", re), sums(f"by_sin_{n}", im)
        return (a, b), (c, d)


COVERS_SEEN = 2000


def least_cover(w: np.ndarray, c: np.ndarray, s: np.ndarray) -> float:
    """Return the determinant of the normal matrix [V4] below which the flag is set.

    `w` (n, s): weights of sensors that read `c` (n,) of the cosine and `s` (n,) of the sine.
    """
    cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
    return COVER * float((cc * ss - cs * cs).min())


def smooth_weight(made: Collected, depth: ca.SX, name: str) -> ca.SX:
    """Add the steps of w^2 (3 - 2 w), w = `depth` between 0 and 1; returns it."""
    # 0 to 1 without a branch: its rounding is a millionth of a weight
    share = made.step(f"share_{name}", (ca.fabs(depth) - ca.fabs(depth - 1.0) + 1.0) * 0.5)
    return made.step(f"weight_{name}", share * share * (3.0 - (share + share)))


def place_steps(made: Collected, wave: Wave, u: Pair, near: ca.SX, tag: str = "") -> ca.SX:
    """Add the steps of the place [m] of a phase in the period next to another place; returns it."""
    lc, whole, per = (made.symbols[name] for name in ("lc", "wavelength", "per_wave"))
    place = made.step(f"in_wave{tag}", lc * wave_steps.arctangent_steps(made, wave, u, tag))
    number = wave_steps.periods_steps(made, (near - place) * per, tag)
    return made.step(f"place{tag}", place + whole * number, "[m]")


BOUNDED = 2000
ROOM = 1.5
"""Times the largest bound of trial poses."""
BESIDE = 4
"""Roundings of a term beside those of its sum: entry, weight times entry, product, reading less offset."""
DETERMINANT, SOLVED = 4, 6
"""Roundings of the determinant and its inverse, and of each coordinate that is solved for."""


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of place and height, flags clear, zeros at zero."""

    row: Row
    wave: Wave
    steps: tuple[Step, ...]
    values: Values
    drawn: Callable[[np.random.Generator, int], np.ndarray]

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each coordinate."""
        row, wave = self.row, self.wave
        vector = ROOM * float(self._vector(2.0**-digits).max())
        far = float(np.abs([row.low[0], row.high[0]]).max()) + row.wavelength
        periods = constant(row.wavelength, digits).error * np.ceil(far / row.wavelength)
        up = float(np.abs([row.low[1], row.high[1]]).max()) + row.lc
        errors = (
            wave_steps.place_error(wave, vector, digits) + float(periods) + 2 * half_ulp(far, digits),
            wave_steps.height_error(wave, vector, digits)
            + constant(float(row.middle[1]), digits).error
            + half_ulp(up, digits),
        )
        inputs = self.drawn(np.random.default_rng(6), BOUNDED)
        ranges = wave_steps.ranges_of(self.steps, row.model.channels, inputs, self.values, row.model.pose)
        last = [ranges[step.name] for step in self.steps[-2:]]
        return {c: Enclosure(*last[k], errors[k]) for k, c in enumerate(row.model.pose)}

    def _vector(self, u: float) -> np.ndarray:
        """Length (s,) by which rounding to a share u moves the vector of each trial pose."""
        row = self.row
        pose = row.poses(np.random.default_rng(8), BOUNDED)
        r = np.abs(row.readings(pose) - row.offset[:, None]) + 2 * np.abs(row.offset)[:, None]
        w = row.weights(pose[0])
        count = u * ((w > 0).sum(axis=0) + BESIDE)
        own = row.factor[:, 0]
        rows = np.stack([own.real, -own.imag])
        size = np.abs(rows)
        normal = np.einsum("ik,jk,ks->sij", rows, rows, w)
        inverse = np.abs(np.linalg.inv(normal))
        length = np.exp(np.abs(pose[1] - row.middle[1]) / row.lc)  # of the vector, at most
        seen = np.einsum("ik,ks,ks->si", size, w, r)
        moved = count[:, None] * (seen + np.einsum("ik,jk,ks->si", size, size, w) * length[:, None])
        slope = np.zeros(len(length))
        for n in row.harmonics if row.rounds else ():
            h = row.factor[:, n - 1]
            cross = np.einsum("ik,k,ks->si", size, np.abs(h), w)
            moved += cross * (length**n * (count + 2 * n * u))[:, None]
            slope += np.einsum("sij,sj->si", inverse, cross).max(axis=1) * n * length ** (n - 1)
        cc, cs, ss = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
        share = DETERMINANT * (cc * ss + cs * cs) / (cc * ss - cs * cs)
        solved = share * length + SOLVED * np.einsum("sij,sj->si", inverse, seen).max(axis=1)
        total = np.hypot(*np.einsum("sij,sj->is", inverse, moved)) + u * solved
        return np.asarray(total / np.maximum(1 - slope, 0.1))
