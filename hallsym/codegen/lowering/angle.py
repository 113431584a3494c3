"""Lowering of models of one angle: from two voltages or from the decoded angle to the corrected angle.

Two voltages: the ellipse is undone by a linear map, the phase taken by an arctangent whose polynomial is
proved (`lowering.trigonometry`), and what is left corrected by a series of its waves or by a table. A
decoded angle: the correction alone. Both wrap. The correction comes from the model by solving it over a turn
(`lowering.phase_curve`, `lowering.correction`), so any effect that is a static function of the angle
follows; for the circle and the ellipse it is empty.
"""

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import asin, pi, sqrt

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import (
    Array,
    Bits,
    Box,
    Collected,
    Decoupler,
    Flag,
    Lookup,
    Margin,
    Whole,
    limits,
    short,
    zeros_of,
)
from hallsym.codegen.intervals import Enclosure, constant, enclose, half_ulp
from hallsym.codegen.lowering import angle_integers
from hallsym.codegen.lowering.correction import Grid, Series, shortest_correction
from hallsym.codegen.lowering.odd_series import (
    ARCTANGENT,
    HALF_PI,
    PI,
    SINE,
    arctangent_error,
    odd,
    sine_error,
    wrapped,
)
from hallsym.codegen.lowering.phase_curve import Curve
from hallsym.errors import InputError, counted
from hallsym.model import Model

TURN = 2 * pi
WEAK = 0.5
"""Share of its calibrated amplitude below which the field is reported as too weak."""
ROOM = 0.1
"""Share of its swing by which a voltage may leave what the model gives over the box: noise, temperature."""
TINY = 1e-30
"""Added to a divisor that may be zero; lost in rounding where it is not."""
ROUNDED = 1e-13
CUT = 2 * pi * 2.0**-31
"""Phase [rad] that the last bit of a place in a table stands for."""
NEIGHBOURS = ("before", "left", "right", "after")
SIXTH = 1 / 6
EVIDENT = 8
"""Waves up to which Frama-C EVA sees by itself that their sum is small: its intervals grow with each."""


def decoupler(
    model: Model,
    p: np.ndarray,
    weight: np.ndarray,
    box: Box,
    *,
    accuracy: float | None = None,
    correction: str = "auto",
) -> Decoupler:
    """Return the decoupler of an angle at parameters `p` over a box; `weight` does not matter.

    `accuracy`: what the correction may leave [rad], default `ENOUGH`; `correction`: one of `KINDS`. The
    corrected angle is that at which the model reads the measured phase, so a change of both amplitudes
    alike, by temperature, leaves it alone. Raises `InputError` for readings that depend on anything else.
    """
    if model.state:
        raise InputError(
            f"C for an angle is generated from readings that depend on the angle alone; {model.name} with "
            f"{', '.join(model.effects)} needs {', '.join(model.state)}: generate from a calibration without "
            "it."
        )
    if sum(link == "reference" for link, _ in model.steps) > bool(model.zeros):  # a zero is set by a reset
        raise InputError(
            f"The calibration of {model.name} with {', '.join(model.effects)} holds errors of its reference, "
            "which a controller does not have; fit without that effect, or correct the log's reference."
        )
    curve = Curve(model, np.asarray(p, dtype=float))
    made = _Assembly(curve, box, shortest_correction(curve, accuracy, correction)).make()
    return replace(made, integers=lambda **options: angle_integers.program(made, curve, WEAK, **options))


@dataclass(eq=False)
class _Assembly(Collected):
    """Collects entries, symbols and steps of one calibration."""

    curve: Curve
    given: Box
    correction: Series | Grid
    arrays: list[Array] = field(default_factory=list)

    def make(self) -> Decoupler:
        model = self.curve.model
        inputs = model.channels
        self.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        (zero,) = zeros_of(model)
        self.symbols[zero.name] = ca.SX.sym(zero.name)
        flags: tuple[Flag, ...] = ()
        if self.curve.angle_only:
            margin, phase = self._reading(), self.symbols["phase"]
        else:
            margin, phase = self._ellipse(), self._arctangent()
            flags = (
                Flag("FIELD", "field", "least_field", f"field below {WEAK:g} of its amplitude: no magnet"),
            )
        self._finish(phase, self.symbols[zero.name])
        ends = self.given.over({c: self._ends(c) for c in inputs})
        return Decoupler(
            model=model,
            inputs=inputs,
            table=tuple(self.table),
            limits=limits(inputs, ends),
            zeros=(zero,),
            steps=tuple(self.steps),
            at_pose=(),
            margins=(margin,),
            box=ends,
            exact=lambda given: self.curve.angle(self.curve.phase(given))[None],
            symbols=self.symbols,
            flags=flags,
            approximation=self._left,
            cut=CUT * self.correction.slope if isinstance(self.correction, Grid) else 0.0,
            bounded=Rounding(self.curve, self.correction, WEAK),
            listed=self._listed(),
            arrays=tuple(self.arrays),
            options={"correction": self.correction.form},
            said=self._said(),
        )

    # -- steps -------------------------------------------------------------------------------------------

    def _reading(self) -> Margin:
        """The phase that is read, either branch taken."""
        (channel,) = self.curve.model.channels
        name = f"gain_{short(channel)}"
        gain = self.entry(name, 1.0, "1", f"phase per {channel}, 1")
        self.step("phase", wrapped(gain * self.symbols[channel]), "[rad] as read, either branch")
        return Margin(channel, name)

    def _ellipse(self) -> Margin:
        """Voltages to a vector of length 1."""
        off = []
        for channel, center in zip(self.curve.model.channels, self.curve.center, strict=True):
            name = short(channel)
            entry = self.entry(f"center_{name}", center, "V", f"center of {channel}")
            off.append(
                self.step(f"off_{name}", self.symbols[channel] - entry, f"[V] {channel} from its center")
            )
        for axis, row in zip("xy", self.curve.matrix, strict=True):
            entries = [
                self.entry(f"{axis}_{short(c)}", value, "1/V", f"{axis} of the unit circle per {c}")
                for c, value in zip(self.curve.model.channels, row, strict=True)
            ]
            self.step(axis, entries[0] * off[0] + entries[1] * off[1])
        x, y = self.symbols["x"], self.symbols["y"]
        self.entry("least_field", WEAK**2, "1", "square of the least share of the calibrated amplitude")
        self.step("field", x * x + y * y, "[1] square of the amplitude, 1 as calibrated")
        return Margin(self.curve.model.channels[0], "least_field")

    def _arctangent(self) -> ca.SX:
        """atan2(y, x) by octants."""
        x, y = self.symbols["x"], self.symbols["y"]
        across, up = self.step("across", ca.fabs(x)), self.step("up", ca.fabs(y))
        flat = up <= across
        share = self.step("share", ca.if_else(flat, up, across) / (ca.if_else(flat, across, up) + TINY))
        ratio = self.step("ratio", ca.if_else(share < 1.0, share, 1.0), "[1] tangent in the first octant")
        square = self.step("square", ratio * ratio)
        octant = self.step("octant", odd(ARCTANGENT, ratio, square), "[rad] its angle, a polynomial")
        none = ca.SX(0.0)
        quarter = self.step("quarter", ca.fabs(ca.if_else(flat, none, HALF_PI) - octant))
        half = self.step("half", ca.fabs(ca.if_else(x < 0, PI, none) - quarter))
        return self.step("phase", ca.if_else(y < 0, -half, half), "[rad] atan2(y, x)")

    def _finish(self, phase: ca.SX, zero: ca.SX) -> None:
        """The correction, the zero, and the branch."""
        found = self.correction
        angle = phase
        if found.constant or found.most:
            constant = self.entry("shift", found.constant, "rad", "correction, the same all round")
            angle = phase + constant
        if isinstance(found, Grid):
            angle = angle + self._looked_up(found, phase)
        elif found.cos:
            angle = angle + self._waves(found, phase)
        if self.curve.angle_only and angle is not phase:
            angle = self.step("turned", wrapped(angle))
        total = self.step("total", zero + angle)
        self.step("angle", wrapped(total), "[rad] within half a turn")

    def _whole(self, step: Whole | Bits) -> ca.SX:
        self.steps.append(step)
        return self.symbols.setdefault(step.name, ca.SX.sym(step.name))

    def _looked_up(self, grid: Grid, phase: ca.SX) -> ca.SX:
        """Entry of the table, and a line or a cubic to the next."""
        count = len(grid.values)
        unit = "1" if grid.integers else "rad"
        if grid.integers:
            scale = self.entry(
                "correction_unit", grid.unit, "rad", "one unit of the entries of the correction"
            )
        array = Array(
            "correction", tuple(grid.values.tolist()), "correction_unit" if grid.integers else "rad",
            f"correction at {count} angles from half a turn below zero", grid.integers,
        )  # fmt: skip
        self.arrays.append(array)
        fine = 31 - (count.bit_length() - 1)
        rate = count * 2.0**fine / (2 * pi)
        place = self.step("place", (phase + PI) * rate, f"in 2^-{fine} of the way between two entries")
        spot = self._whole(Whole("spot", place))
        cell = self._whole(Bits("cell", spot, "", fine))
        rest = self._whole(Bits("rest", spot, "", fine, True))
        part = self.step("part", rest * 2.0**-fine)

        def entry(name: str, ahead: int) -> ca.SX:
            self.symbols[name] = ca.SX.sym(name)
            self.steps.append(Lookup(name, cell, "", array, ahead))
            return self.symbols[name]

        if grid.degree == 1:
            left, right = entry("left", 0), entry("right", 1)
            between = left + part * (right - left)
        else:
            before, left, right, after = (entry(n, k) for k, n in enumerate(NEIGHBOURS, -1))
            rise = self.step("rise", right - left)
            bend_left = self.step("bend_left", (before - left) + rise)
            bend_right = self.step("bend_right", (after - right) - rise)
            bends = (2.0 - part) * bend_left + (1.0 + part) * bend_right
            share = self.step("share_of_bends", (1.0 - part) * SIXTH)
            self.step("bends", bends)
            between = left + part * (rise - share * self.symbols["bends"])
        about = f"[{unit}] {'a line' if grid.degree == 1 else 'a cubic'} between entries"
        if grid.integers:
            return self.step("correction", scale * self.step("between", between, about), "[rad]")
        return self.step("correction", between, about)

    def _waves(self, series: Series, phase: ca.SX) -> ca.SX:
        """Sum of the waves by Horner's rule for complex numbers, highest first."""
        entries = []
        for n, pair in enumerate(zip(series.cos, series.sin, strict=True), 1):
            about = f"{counted(n, 'wave')} per turn of the correction"
            cosine = self.entry(f"cos_{n}", pair[0], "rad", f"{about}, cosine")
            entries.append((cosine, self.entry(f"sin_{n}", pair[1], "rad", f"{about}, sine")))
        self.step("upright", HALF_PI - ca.fabs(phase), "[rad] angle from the other axis")
        cos = self._of("upright", "cosine")
        self.step("side", HALF_PI - ca.fabs(self.symbols["upright"]))
        size = self._of("side", "size")
        sin = self.step("sine", ca.if_else(phase < 0, -size, size))
        a, b = entries[-1]
        for n in range(len(entries) - 1, 0, -1):
            c, s = entries[n - 1]
            real = self.step(f"real_{n}", c + (cos * a + sin * b))
            imaginary = self.step(f"imaginary_{n}", s + (cos * b - sin * a))
            a, b = real, imaginary
        if len(entries) <= EVIDENT:
            return self.step("correction", cos * a + sin * b, "[rad] its waves")
        waves = self.step("waves", cos * a + sin * b, "[rad] of the correction")
        held = ca.if_else(waves < -1.0, -1.0, ca.if_else(waves > 1.0, 1.0, waves))
        return self.step("correction", held, "they sum to less than 1 rad; said again for a prover")

    def _of(self, argument: str, name: str) -> ca.SX:
        x = self.symbols[argument]
        square = self.step(f"{argument}_square", x * x)
        return self.step(name, odd(SINE, x, square))

    # -- ranges and what is said --------------------------------------------------------------------------

    def _ends(self, channel: str) -> tuple[float, float]:
        given = self.given.ends
        if self.curve.angle_only:
            low, high = given[channel]
            if low < -TURN or high > TURN:
                raise InputError(
                    f"The range of {channel} must lie within one turn in either direction "
                    f"(-{TURN:.6g} to {TURN:.6g} rad); C decodes one turn."
                )
            return low, high
        if channel in given:
            return given[channel]
        (angles,) = (given[c] for c in self.curve.model.pose)
        seen = self.curve.readings(np.linspace(*angles, 4096))[self.curve.model.channels.index(channel)]
        middle, swing = (seen.max() + seen.min()) / 2, (seen.max() - seen.min()) / 2 * (1 + ROOM)
        return float(f"{middle - swing:.3g}"), float(f"{middle + swing:.3g}")

    @cached_property
    def _left(self) -> float:
        """What the polynomials and the correction may leave in the angle [rad]."""
        found = self.correction
        arctangent = 0.0 if self.curve.angle_only else arctangent_error() * (1 + found.slope)
        sines = 0.0
        if isinstance(found, Series):
            # sine and cosine off by e change wave n by at most n e sqrt 2 (1 + e)^n
            sines = sine_error() * 2**0.5 * found.slope * (1 + 2 * sine_error()) ** len(found.cos)
        return float(arctangent + sines + found.left + ROUNDED)

    def _listed(self) -> tuple[tuple[float, ...], ...]:
        """No field, and the seams of the octants."""
        if self.curve.angle_only:
            return tuple((a,) for a in (-TURN, -pi, -1e-3, 0.0, pi, TURN))
        seams = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]]) / 2**0.5
        back = np.linalg.solve(self.curve.matrix, seams.T).T + self.curve.center
        return tuple(map(tuple, [self.curve.center.tolist(), *back.tolist()]))

    def _said(self) -> tuple[str, ...]:
        found, out = self.correction, []
        if not self.curve.angle_only:
            out.append(
                f"The arctangent is a polynomial of degree {2 * len(ARCTANGENT) - 1}: off by at most "
                f"{arctangent_error():.2g} rad (proved)."
            )
        if isinstance(found, Grid):
            size = (2 if found.integers else 4) * len(found.values)
            between = "straight lines" if found.degree == 1 else "cubics"
            out.append(
                f"The correction is a table of {len(found.values)} entries, {size} bytes, with {between} "
                f"between them; it leaves at most {found.left:.2g} rad, the rounding of its entries counted "
                "(proved)."
            )
        elif found.cos:
            count = len(found.cos)
            left = f"those left out sum to {found.left:.2g} rad"
            if not found.summed:
                left = f"it leaves at most {found.left:.2g} rad (proved)"
            out.append(
                f"The correction is a series of {count} waves per turn, {8 * count + 4} bytes of table; "
                f"{left}."
            )
        elif found.left > 1e-12:
            out.append(f"No correction is needed for the accuracy asked: {found.left:.2g} rad are left.")
        return tuple(out)


CELLS = 256


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of the angle, where the field is not weak."""

    curve: Curve
    correction: Series | Grid
    weak: float

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each pose coordinate, zeros at zero."""
        found, u = self.correction, 2.0**-digits
        phase = self._read(digits) if self.curve.angle_only else self._vector(digits) + octants(digits)
        error = phase * (1 + found.slope)
        if found.most:
            error += self._looked_up(found, digits) if isinstance(found, Grid) else self._waves(found, digits)
            error += half_ulp(pi + abs(found.constant) + found.most, digits)
        if found.most or found.constant:
            error += u * abs(found.constant) + half_ulp(pi + abs(found.constant), digits)
            error += half_ulp(pi, digits)  # a wrap rounds once: its first difference is exact
        end = float(np.float32(pi)) * (1 + 4 * u) + error
        return {c: Enclosure(-end, end, float(error)) for c in self.curve.model.pose}

    def _read(self, digits: int) -> float:
        """The wrap of the reading: rounded once, by the second part of a turn."""
        return half_ulp(pi, digits)

    def _vector(self, digits: int) -> float:
        """The angle by which rounding can turn (x, y) = M (reading - center), M and center rounded too.

        Difference, entry, product and sum round by a share each, of |M| |reading - center|, which is at most
        |M| |M^-1| times the radius; only the center's own rounding counts more where the field is weak.
        """
        u, matrix = 2.0**-digits, np.abs(self.curve.matrix)
        spread = np.linalg.norm(matrix, 2) * np.linalg.norm(np.linalg.inv(self.curve.matrix), 2)
        center = np.linalg.norm(matrix @ np.abs(self.curve.center)) * u
        moved = (1 + 8 * u) * (4 * u * spread + center / (self.weak * (1 - 8 * u)))
        return asin(min(1.0, float(moved)))

    def _looked_up(self, grid: Grid, digits: int) -> float:
        """A place that rounding moves, by the slope of what is looked up, and the arithmetic between entries.

        The interpolation is continuous, and what rounding takes into the next cell is looked up there.
        """
        u, count = 2.0**-digits, len(grid.values)
        scale = count / (2 * pi)
        moved = constant(PI, digits).error + half_ulp(2 * pi, digits)
        moved += (constant(scale, digits).error * 2 * pi + half_ulp(count, digits)) / scale
        moved += 2 * pi * 2.0**-31  # bits of a place that are cut off
        return moved * grid.slope + _between(grid, digits) + u * grid.most

    def _waves(self, series: Series, digits: int) -> float:
        """The complex Horner rule: |partial sums| <= sum of amplitudes, |exp(i phase)| <= 1 + its error."""
        u = 2.0**-digits
        sine = sqrt(2) * _sine(digits)
        most = sum(series.waves) * (1 + 1e-5)
        error = u * series.waves[-1]  # of the entries
        for size in reversed([0.0, *series.waves[:-1]]):
            # two products, their sum, the entry's own rounding and its addition, in two components
            error = error * (1 + sine) + sine * most + sqrt(2) * u * (2 * most + most + size + size + most)
        return float(error)


def _between(grid: Grid, digits: int) -> float:
    """Rounding from entries and part of a cell to the correction; a part is exact, entries are as stored."""
    part, left, right, before, after = (ca.SX.sym(n) for n in ("part", "left", "right", "before", "after"))
    line = left + part * (right - left)
    if grid.degree == 3:
        rise = right - left
        bends = (2.0 - part) * ((before - left) + rise) + (1.0 + part) * ((after - right) - rise)
        line = left + part * (rise - (1.0 - part) * (1 / 6) * bends)
    scale = constant(grid.unit, digits) if grid.integers else Enclosure(1.0, 1.0)
    most = float(np.abs(grid.values).max())
    given = dict.fromkeys(("left", "right", "before", "after"), Enclosure(-most, most))
    (found,) = enclose([line], {"part": Enclosure(0.0, 1.0), **given}, digits)
    return float(found.error * grid.unit + most * scale.error + 2.0**-digits * grid.most * 2)


@cache
def octants(digits: int) -> float:
    """From a rounded ratio to the phase, polynomials exact; the ratio in cells, each with intervals."""
    ratio, u = ca.SX.sym("ratio"), 2.0**-digits
    ends = np.linspace(0.0, 1.0, CELLS + 1)
    cells = Enclosure(ends[:-1], ends[1:], 2 * u * ends[1:])
    (octant,) = enclose([odd(ARCTANGENT, ratio, ratio * ratio)], {"ratio": cells}, digits)
    first = octant.error.max()
    quarter = first + constant(HALF_PI, digits).error + half_ulp(pi / 2, digits)
    return float(quarter + constant(PI, digits).error + half_ulp(pi, digits))


@cache
def _sine(digits: int) -> float:
    """Rounding of the sine polynomial at a rounded argument, which two differences from pi / 2 give."""
    x, angle = ca.SX.sym("x"), ca.SX.sym("angle")
    quarter = constant(HALF_PI, digits)
    (once,) = enclose([x - angle], {"x": quarter, "angle": Enclosure(0.0, pi)}, digits)
    (twice,) = enclose([x - angle], {"x": quarter, "angle": Enclosure(0.0, pi / 2, once.error)}, digits)
    (found,) = enclose([odd(SINE, x, x * x)], {"x": Enclosure(-pi / 2, pi / 2, twice.error)}, digits)
    return float(found.error)
