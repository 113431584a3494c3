"""Steps from the readings of a row of sensors to place and height of a wave that travels along it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Whole
from hallsym.codegen.entries import short, unit
from hallsym.codegen.lowering.choices import (
    BEYOND,
    HELD,
    above_minus,
    at_least,
    at_most,
    held_logarithm,
    inverse,
    logarithm_of_ratio,
    period_count,
    smooth_weight,
)
from hallsym.codegen.lowering.travel_fit import RAMP, TINY, Row
from hallsym.codegen.lowering.wave_steps import (
    AXES,
    Collected,
    Pair,
    Powers,
    Wave,
    arctangent_steps,
    least_inside,
    logarithm_steps,
)

PERIODS = 1 << 12
"""Added to whole periods, so that they are no negative number."""
TRIALS = 2000


@dataclass(eq=False)
class Pieces:
    """Adds the steps of one calibration, one after the other."""

    row: Row
    wave: Wave
    made: Collected
    covered: float
    """Share of the least cover of the box below which the flag is set."""

    def add(self) -> None:
        """Add all steps and entries; the last two steps are the pose."""
        row, made = self.row, self.made
        self.names = [short(c) for c in row.model.channels]
        self.lc = made.entry("lc", row.lc, "m", "wavelength over 2 pi")
        self.whole = made.entry("wavelength", row.wavelength, "m", "wavelength")
        self.per = made.entry("per_wave", 1 / row.wavelength, "1/m", "periods per metre")
        least_inside(made, (self.wave,))
        self._table()
        everything = self._all()
        near = self._near(self._middle())
        x = self._place(everything, near, "_first", self._least_of_all)
        u, log = self._vector(self._weights(x))
        place = self._place(u, x, "", self._least_wide)
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
        divided = first * self._per_energy(total) if made.native else first / (total + TINY)
        at = made.step("energy_middle", divided, "[m] middle of what is read, squared")
        low, high = row.whole
        if not low < high:
            return at
        ends = {
            "low": made.entry("low_whole", low, "m", "least place with all of the array over sensors"),
            "high": made.entry("high_whole", high, "m", "greatest such place"),
        }
        up, down = (made.step(f"beyond_{n}", (at + at) - end) for n, end in ends.items())
        upper = made.step(
            "chosen_upper", ca.fmax(down, at) if made.native else ca.if_else(at < down, down, at)
        )
        return made.step("chosen_middle", at_most(made, up, upper), "[m] also at the ends of the board")

    def _per_energy(self, total: ca.SX) -> ca.SX:
        """1 over the energy of all sensors, as of poses of the box and some beyond."""
        row = self.row
        seen = row.readings(row.poses(np.random.default_rng(3), TRIALS)) - row.offset[:, None]
        energy = (seen**2).sum(axis=0)
        ends = float(energy.min()) / BEYOND, float(energy.max()) * BEYOND
        log = held_logarithm(self.made, total, "all_energy", ends, "V2")
        return inverse(self.made, log, "all_energy", ends, "V2")

    def _place(self, u: Pair, near: ca.SX, tag: str, least: float) -> ca.SX:
        """The place of a phase in the period next to another place; `least`: length of u, of integers."""
        made = self.made
        phase = arctangent_steps(made, self.wave, u, tag, least)
        place = made.step(f"in_wave{tag}", self.lc * phase)
        count = made.step(f"periods{tag}", (near - place) * self.per + (PERIODS + 0.5))
        held = period_count(made, count, tag, PERIODS)
        name = f"whole{tag}"
        made.steps.append(Whole(name, held))
        number = made.symbols.setdefault(name, ca.SX.sym(name))
        return made.step(f"place{tag}", place + self.whole * (number - float(PERIODS)), "[m]")

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

    def _vector(self, weights: Sequence[ca.SX]) -> tuple[Pair, ca.SX]:
        """Weighted least squares of what the sensors read, higher harmonics taken off by rounds.

        Returns the phasor, of integers times the cover, and its logarithm.
        """
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
        low, high = self._covers
        least = made.entry("least_cover", low, "V4", "share of the least of the box")
        if made.native:
            log_cover = held_logarithm(made, cover, "held_cover", (low, high), "V4")
            per = inverse(made, log_cover, "held_cover", (low, high), "V4")
        else:
            per = made.step("per_cover", 1.0 / made.step("held_cover", at_least(made, cover, least)))
        cross = {n: self._cross(n, sums) for n in row.harmonics} if row.rounds else {}
        longest = (HELD if made.native else 2.0) * self.wave.outer
        most = made.entry("longest", longest, "1", "most of a phasor")

        def solved(cos: ca.SX, sin: ca.SX) -> Pair:
            """The phasor times the cover."""
            return ss * cos - cs * sin, cc * sin - cs * cos

        def held(wide: Pair, tag: str) -> Pair:
            """The phasor, no longer than any of the box is."""
            re, im = (made.step(f"raw_{a}{tag}", v * per) for a, v in zip(AXES, wide, strict=True))
            low = [
                made.step(f"held_{a}_low{tag}", above_minus(made, v, most))
                for a, v in zip(AXES, (re, im), strict=True)
            ]
            re, im = (
                made.step(f"held_{a}{tag}", at_most(made, v, most)) for a, v in zip(AXES, low, strict=True)
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
        if not made.native:
            u = held(wide, f"_{row.rounds}")
            return u, logarithm_steps(made, self.wave, u)
        wide = made.step("wide_cos", wide[0]), made.step("wide_sin", wide[1])
        return wide, logarithm_of_ratio(made, wide, log_cover, self._least_wide, ("log", "inside"))

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

    @cached_property
    def _covers(self) -> tuple[float, float]:
        """Determinant of the normal matrix [V4]: below it the flag is set, beyond it there is no pose."""
        row = self.row
        w = row.weights(row.poses(np.random.default_rng(3), TRIALS)[0])
        c, s = row.factor[:, 0].real, -row.factor[:, 0].imag
        cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
        cover = cc * ss - cs * cs
        return self.covered * float(cover.min()), float(cover.max()) * BEYOND

    @property
    def _least_wide(self) -> float:
        """Length of the phasor times the cover, at least, where no flag is set [V4]."""
        return self.wave.least * self._covers[0]

    @property
    def _least_of_all(self) -> float:
        """Length of the sum of all sensors alike, at least, of poses of the box [V2]."""
        row = self.row
        seen = row.readings(row.poses(np.random.default_rng(3), TRIALS)) - row.offset[:, None]
        return float(np.abs((seen * row.factor[:, :1].conj()).sum(axis=0)).min()) / BEYOND

    def _near(self, at: ca.SX) -> ca.SX:
        """A place, of integers held where an array would be beyond all sensors."""
        row, made = self.row, self.made
        if not made.native:
            return at
        far = max(map(abs, row.board)) + row.length / 2
        return made.step(
            "held_middle", made.held(at, "farthest", far, "m", "place of an array beyond all sensors")
        )
