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

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import (
    Box,
    Collected,
    Decoupler,
    Flag,
    Margin,
    Step,
    Whole,
    limits,
    short,
    unit,
    zeros_of,
)
from hallsym.codegen.intervals import Enclosure, constant, half_ulp
from hallsym.codegen.lowering.arrays_bounds import ranges_of
from hallsym.codegen.lowering.travel_fit import RAMP, TINY, Row, row_of
from hallsym.codegen.lowering.wave_bounds import Values, height_error, place_error
from hallsym.codegen.lowering.wave_steps import (
    AXES,
    Pair,
    Powers,
    Wave,
    arctangent_steps,
    least_inside,
    logarithm_steps,
    wave_of,
)
from hallsym.errors import InputError, counted
from hallsym.model import Model

SWING = 0.1
"""Share of its swing by which a reading may leave what the model gives over the box: noise, temperature."""
MARGINS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Wavelengths from the ends of the wave within which a sensor does not count, of which one is chosen."""
TRIALS = 4000
SAFE = 1.5
"""What errors met over trial poses are multiplied by where they are stated."""
COVER = 0.5
"""Share of the least cover of the box below which the flag is set."""
MOST_ROUNDS = 4
FIELD = "field beyond the calibrated heights: too near, too far, or no array"
COVERED = "too few sensors see the array: it is at an end of the board or beyond"


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float) -> Decoupler:
    """Return the decoupler of a travelling wave at parameters `p` over a box; see `lowering.wave.decoupler`.

    The first pose coordinate is along the wave, the second its height.
    """
    row = row_of(model, np.asarray(p, dtype=float), weight, box)
    wave = wave_of(row.plain, box.ends[model.pose[1]], accuracy)
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
    """Collects the decoupler of one calibration."""

    row: Row
    wave: Wave
    given: Box
    made: Collected = field(default_factory=Collected)

    def make(self) -> Decoupler:
        model, made = self.row.model, self.made
        inputs = model.channels
        made.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        zeros = zeros_of(model)
        made.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        self._add()
        made.keep((*map(short, model.pose), "inside", "cover"))
        ends = self._ends
        values: dict[str, float | tuple[float, float]] = {e.name: e.value for e in made.table}
        values |= {short(c): ends.ends[c] for c in inputs}
        leaves = self._leaves
        return Decoupler(
            model=model, inputs=inputs, table=tuple(made.table), limits=limits(inputs, ends), zeros=zeros,
            steps=tuple(made.steps), at_pose=(), margins=(Margin(inputs[0], "lc"),), box=ends,
            exact=self.row.exact, symbols=made.symbols,
            flags=(
                Flag("FIELD", "inside", "least_inside", FIELD), Flag("COVER", "cover", "least_cover", COVERED)
            ),
            approximation=max(leaves.values()), leaves=leaves,
            bounded=Rounding(self.row, self.wave, tuple(made.steps), values, self.drawn),
            drawn=self.drawn, said=self._said(leaves), evident=False,
        )  # fmt: skip

    @cached_property
    def _ends(self) -> Box:
        """Ranges of readings over poses of the box."""
        seen = self.row.readings(self.row.poses(np.random.default_rng(4), TRIALS))
        ends = {}
        for c, values in zip(self.row.model.channels, seen, strict=True):
            end = float(f"{(1 + SWING) * np.abs(values).max():.3g}")
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
            c: SAFE * (float(np.abs(v).max()) + functions)
            for c, v in zip(self.row.model.pose, off, strict=True)
        }

    def _said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        row = self.row
        listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
        return (
            f"{counted(len(row.model.channels), 'sensor')} over {1e3 * row.board[0]:.4g} to "
            f"{1e3 * row.board[1]:.4g} mm, an array of {1e3 * row.length:.3g} mm with a wavelength of "
            f"{1e3 * row.wavelength:.6g} mm: {row.model.pose[0]} is absolute, from the readings of one "
            f"sample. A sensor counts from {1e3 * row.margin * row.wavelength:.3g} mm inside the ends of the "
            "array on, and fully half a wavelength further.",
            "Give all readings at every sample, also of sensors that the array is not over: the code weights "
            "them.",
            f"Against least squares over all readings, converged, in double it leaves at most {listed}: "
            f"{SAFE:g} times what {TRIALS} poses of the box met, and what polynomials leave (measured, not "
            "proved for every pose).",
            "Only readings of a pose in the box have that error: others give a finite pose, mostly a flag.",
        )

    def _add(self) -> None:
        """Add all steps and entries; the last two steps are the pose."""
        row, made = self.row, self.made
        self.names = [short(c) for c in row.model.channels]
        self.lc = made.entry("lc", row.lc, "m", "wavelength over 2 pi")
        made.entry("wavelength", row.wavelength, "m", "wavelength")
        made.entry("per_wave", 1 / row.wavelength, "1/m", "periods per metre")
        least_inside(made, (self.wave,))
        self._table()
        everything = self._all()
        x = place_steps(made, self.wave, everything, self._middle(), "_first")
        u = self._vector(self._weights(x))
        log = logarithm_steps(made, self.wave, u)
        place = place_steps(made, self.wave, u, x)
        along, height = row.model.pose
        middle = made.entry("middle", float(row.middle[1]), "m", f"{height} at which the phasor is 1")
        level = middle + made.symbols[f"zero_{short(height)}"]
        rise = self.lc * log
        made.step(short(along), place + made.symbols[f"zero_{short(along)}"], f"[{unit(along)}]")
        made.step(short(height), level + rise if row.rising > 0 else level - rise, f"[{unit(height)}]")

    def _table(self) -> None:
        row, made = self.row, self.made
        self.cos, self.sin, self.places = [], [], []
        for name, c, at, off in zip(self.names, row.factor[:, 0], row.place, row.offset, strict=True):
            self.cos.append(made.entry(f"cos_{name}", c.real, "V", f"read by {name} of the cosine"))
            self.sin.append(made.entry(f"sin_{name}", -c.imag, "V", f"read by {name} of the sine"))
            self.places.append(made.entry(f"at_{name}", at, "m", f"place at which the array is over {name}"))
            offset = made.entry(f"offset_{name}", off, "V", f"offset of {name} under the array")
            made.step(f"field_{name}", made.symbols[row.model.channels[len(self.cos) - 1]] - offset)

    def _fields(self) -> list[ca.SX]:
        return [self.made.symbols[f"field_{n}"] for n in self.names]

    def _all(self) -> Pair:
        """Cosine and sine of all sensors alike."""
        fields = self._fields()
        return (
            self.made.total("cos_all", [a * f for a, f in zip(self.cos, fields, strict=True)], "all alike"),
            self.made.total("sin_all", [a * f for a, f in zip(self.sin, fields, strict=True)]),
        )

    def _middle(self) -> ca.SX:
        """The middle of the wave as far as the squares of the readings say it."""
        made, row = self.made, self.row
        energy = [made.step(f"energy_{n}", f * f) for n, f in zip(self.names, self._fields(), strict=True)]
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
        seen = sums("seen", self._fields())
        cover = made.step("cover", cc * ss - cs * cs, "[V4] how well the sensors tell cosine from sine")
        least = made.entry("least_cover", self._least_cover, "V4", "share of the least of the box")
        per = made.step("per_cover", 1.0 / made.step("held_cover", ca.if_else(cover > least, cover, least)))
        cross = {n: self._cross(n, sums) for n in row.harmonics} if row.rounds else {}
        most = made.entry("longest", 2.0 * self.wave.outer, "1", "most of a phasor")

        def solved(cos: ca.SX, sin: ca.SX) -> Pair:
            """The phasor times the cover."""
            return ss * cos - cs * sin, cc * sin - cs * cos

        def held(wide: Pair, tag: str) -> Pair:
            """The phasor, no longer than any of the box is."""
            re, im = (made.step(f"raw_{a}{tag}", v * per) for a, v in zip(AXES, wide, strict=True))
            low = [
                made.step(f"held_{a}_low{tag}", ca.if_else(v > -most, v, -most))
                for a, v in zip(AXES, (re, im), strict=True)
            ]
            re, im = (
                made.step(f"held_{a}{tag}", ca.if_else(v < most, v, most))
                for a, v in zip(AXES, low, strict=True)
            )
            return re, im

        wide = solved(*seen)
        for k in range(1, row.rounds + 1):
            powers = Powers(made, *held(wide, f"_{k - 1}"), f"_{k}")
            off = [ca.SX(0), ca.SX(0)]
            for n, ((a, b), (c, d)) in cross.items():
                re, im = powers(n)
                off = [off[0] + (a * re + b * im), off[1] + (c * re + d * im)]
            left = [made.step(f"left_{a}_{k}", s - o) for a, s, o in zip(AXES, seen, off, strict=True)]
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

    @property
    def _least_cover(self) -> float:
        """Determinant of the normal matrix [V4] below which the flag is set."""
        row = self.row
        w = row.weights(row.poses(np.random.default_rng(3), COVERS_SEEN)[0])
        c, s = row.factor[:, 0].real, -row.factor[:, 0].imag
        cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
        return COVER * float((cc * ss - cs * cs).min())


PERIODS = 1 << 12
"""Added to whole periods, so that they are no negative number."""
COVERS_SEEN = 2000


def smooth_weight(made: Collected, depth: ca.SX, name: str) -> ca.SX:
    """Add the steps of w^2 (3 - 2 w), w = `depth` between 0 and 1; returns it."""
    # 0 to 1 without a branch: its rounding is a millionth of a weight
    share = made.step(f"share_{name}", (ca.fabs(depth) - ca.fabs(depth - 1.0) + 1.0) * 0.5)
    return made.step(f"weight_{name}", share * share * (3.0 - (share + share)))


def place_steps(made: Collected, wave: Wave, u: Pair, near: ca.SX, tag: str = "") -> ca.SX:
    """Add the steps of the place [m] of a phase in the period next to another place; returns it."""
    lc, whole, per = (made.symbols[name] for name in ("lc", "wavelength", "per_wave"))
    place = made.step(f"in_wave{tag}", lc * arctangent_steps(made, wave, u, tag))
    count = made.step(f"periods{tag}", (near - place) * per + (PERIODS + 0.5))
    most = 2.0 * PERIODS  # of readings of no pose it could be anything
    held = made.step(f"counted{tag}", ca.if_else(count < 0.0, 0.0, ca.if_else(count > most, most, count)))
    made.steps.append(Whole(f"whole{tag}", held))
    number = made.symbols.setdefault(f"whole{tag}", ca.SX.sym(f"whole{tag}"))
    return made.step(f"place{tag}", place + whole * (number - float(PERIODS)), "[m]")


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
            place_error(wave, vector, digits) + float(periods) + 2 * half_ulp(far, digits),
            height_error(wave, vector, digits)
            + constant(float(row.middle[1]), digits).error
            + half_ulp(up, digits),
        )
        inputs = self.drawn(np.random.default_rng(6), BOUNDED)
        ranges = ranges_of(self.steps, row.model.channels, inputs, self.values, row.model.pose)
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
