"""Steps from the readings of a row of sensors to place and height of a wave that travels along it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Whole
from hallsym.codegen.entries import short, unit
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
        w = row.weights(row.poses(np.random.default_rng(3), TRIALS)[0])
        c, s = row.factor[:, 0].real, -row.factor[:, 0].imag
        cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
        return self.covered * float((cc * ss - cs * cs).min())


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
