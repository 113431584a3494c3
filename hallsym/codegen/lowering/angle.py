"""Lowering of models of one angle: from two voltages or from the decoded angle to the corrected angle.

Two voltages or more: the ellipse is undone by a linear map, the phase taken by an arctangent whose
polynomial is proved (`lowering.odd_series`), and what is left corrected by a table. A
decoded angle: the correction alone. Both wrap. The correction comes from the model by solving it over a turn
(`lowering.phase_curve`, `lowering.correction`), so any effect that is a static function of the angle follows;
for the circle and the ellipse it is empty.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from math import asin, hypot, pi

import casadi as ca
import numpy as np

from hallsym.codegen import integer_c, residual
from hallsym.codegen.decoupler import (
    FAULT,
    Array,
    Bits,
    Box,
    Collected,
    Decoupler,
    Flag,
    Lookup,
    Redundancy,
    Watched,
    short,
)
from hallsym.codegen.integer_c import UNIT, Compiler, Fixed, Program, planned
from hallsym.codegen.lowering import correction as corrections
from hallsym.codegen.lowering import odd_series
from hallsym.codegen.lowering.correction import ROUNDED, SIZES, WORST, Grid
from hallsym.codegen.lowering.odd_series import HALF_PI, PI, Odd, odd, shortest
from hallsym.codegen.lowering.phase_curve import POINTS, Curve, check_static
from hallsym.codegen.lowering.wave_steps import REVERSED, TINY
from hallsym.errors import InputError
from hallsym.log.phase import wrapped as within_turn
from hallsym.model import Model
from hallsym.units import si_symbol

TURN = 2 * pi
WEAK = 0.5
"""Share of its calibrated amplitude below which the field is reported as too weak."""
ROOM = 0.1
"""Share of its swing by which a voltage may leave what the model gives over the box: noise, temperature."""
CUT = 2 * pi * 2.0**-31
"""Phase [rad] that the last bit of a place in a table stands for."""
OCTANT = 7e-8
"""Angle [rad] that the arctangent may be off by: half of what float32 rounds an angle near pi by."""
SIXTH = 1 / 6


def decoupler(
    model: Model,
    p: np.ndarray,
    weight: np.ndarray,
    box: Box,
    *,
    accuracy: float | None = None,
    correction: str | None = None,
) -> Decoupler:
    """Return the decoupler of an angle at parameters `p` over a box; `weight` does not matter.

    `accuracy`: what the correction may leave [rad], default `ENOUGH`; `correction`: the form of one that it
    shall be like. The corrected angle is that at which the model reads the measured phase, so a change of
    both amplitudes alike, by temperature, leaves it alone. Raises `InputError` for readings that depend on
    anything else.
    """
    check_static(model, "the angle")
    curve = Curve(model, np.asarray(p, dtype=float))
    made = _Assembly(curve, box, corrections.smallest_correction(curve, accuracy, correction)).make()
    return replace(made, integers=lambda found, **options: program(found, curve, **options))


def arctangent() -> Odd:
    """Return the polynomial of the arctangent of 0 to 1."""
    found = shortest("atan", 1.0, OCTANT)
    assert found is not None  # it does not depend on a calibration
    return found


@dataclass(eq=False)
class _Assembly(Collected):
    curve: Curve
    given: Box
    correction: Grid
    arrays: list[Array] = field(default_factory=list)
    redundancy: Redundancy | None = None

    def make(self) -> Decoupler:
        model = self.curve.model
        inputs = model.channels
        self.begin(model, inputs)
        flags: tuple[Flag, ...] = ()
        if self.curve.angle_only:
            phase = self._reading()
        else:
            self._ellipse()
            phase = self._arctangent()
            flags = (
                Flag("FIELD", "field", "least_field", f"field below {WEAK:g} of its amplitude: no magnet"),
                residual.flag(),
            )
        self._finish(phase, self.symbols[f"zero_{short(model.pose[0])}"])
        ends, share = self.given.over({c: self._ends(c) for c in inputs}), self.curve.share
        return self.finished(
            model, inputs, ends, flags=flags, approximation=self._left,
            exact=lambda given: self.curve.angle(self.curve.phase(given))[None] * share,
            cut=CUT * share * self.correction.slope,
            listed=self._listed(), redundancy=self.redundancy,
            drawn=residual.drawn_of(model, self.curve.p, self.given) if self.redundancy else None,
            arrays=tuple(self.arrays), options={"correction": self.correction.form}, said=self._said(),
        )  # fmt: skip

    # -- steps -------------------------------------------------------------------------------------------

    def _reading(self) -> ca.SX:
        """The phase that is read, either branch taken."""
        (channel,) = self.curve.model.channels
        name = f"gain_{short(channel)}"
        gain = self.entry(name, 1.0, "1", f"phase per {channel}, 1", "value")
        read = odd_series.wrapped(gain * self.symbols[channel])  # of at most a turn, by the limits
        return self.step("phase", read, "[rad] as read, either branch", most=PI)

    def _ellipse(self) -> None:
        off = []
        for channel, center in zip(self.curve.model.channels, self.curve.center, strict=True):
            name, symbol = short(channel), si_symbol(channel)
            entry = self.entry(f"center_{name}", center, symbol, f"center of {channel}")
            off.append(
                self.step(
                    f"off_{name}", self.symbols[channel] - entry, f"[{symbol}] {channel} from its center"
                )
            )
        for axis, row in zip("xy", self.curve.matrix, strict=True):
            entries = [
                self.entry(
                    f"{axis}_{short(c)}", value, f"1/{si_symbol(c)}", f"{axis} of the unit circle per {c}"
                )
                for c, value in zip(self.curve.model.channels, row, strict=True)
            ]
            self.total(axis, [e * o for e, o in zip(entries, off, strict=True)])
        x, y = self.symbols["x"], self.symbols["y"]
        about = "square of the least share of the calibrated amplitude"
        self.entry("least_field", WEAK**2, "1", about, "sign")
        self.step("field", x * x + y * y, "[1] square of the amplitude, 1 as calibrated")
        if len(off) > 2:
            named = dict(zip(map(short, self.curve.model.channels), off, strict=True))
            about = "off the plane of the ellipse"
            self.redundancy = residual.left_over(self, self.curve.spare, named, about)
            return
        self.step("beside", self.symbols["field"] - 1.0, "[1] of the circle that both voltages lie on")
        self.redundancy = residual.summed(self, [Watched("beside", (0, 1))])

    def _arctangent(self) -> ca.SX:
        x, y = self.symbols["x"], self.symbols["y"]
        across, up = self.step("across", ca.fabs(x)), self.step("up", ca.fabs(y))
        flat = up <= across
        share = self.step(
            "share", ca.if_else(flat, up, across) / (ca.if_else(flat, across, up) + TINY), most=1.0
        )
        ratio = self.step("ratio", ca.if_else(share < 1.0, share, 1.0), "[1] tangent in the first octant")
        square = self.step("square", ratio * ratio)
        octant = self.step(
            "octant", odd(arctangent().coefficients, ratio, square), "[rad] its angle, a polynomial"
        )
        none = ca.SX(0.0)
        quarter = self.step("quarter", ca.fabs(ca.if_else(flat, none, HALF_PI) - octant))
        half = self.step("half", ca.fabs(ca.if_else(x < 0, PI, none) - quarter))
        return self.step("phase", ca.if_else(y < 0, -half, half), "[rad] atan2(y, x)")

    def _finish(self, phase: ca.SX, zero: ca.SX) -> None:
        found = self.correction
        angle = phase
        if found.constant or found.looked_up:
            constant = self.entry("shift", found.constant, "rad", "correction, the same all round")
            angle = phase + constant
        if found.looked_up:
            angle = angle + self._looked_up(found, phase)
        if self.curve.angle_only and angle is not phase:
            angle = self.step("turned", odd_series.wrapped(angle))
        if self.curve.share == 1.0:
            total = self.step("total", zero + angle)
            self.step("angle", odd_series.wrapped(total), "[rad] within half a turn")
            return
        share = self.entry(
            "per_phase", self.curve.share, "1", "angle per phase: one over the periods of a turn"
        )
        total = self.step("total", zero * (1.0 / self.curve.share) + angle)
        self.step("within", odd_series.wrapped(total), "[rad] phase within half a period")
        self.step("angle", share * self.symbols["within"], "[rad] within half a period")

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
        spot = self.whole("spot", place)
        cell = self.add(Bits("cell", spot, "", fine))
        rest = self.add(Bits("rest", spot, "", fine, True))
        part = self.step("part", rest * 2.0**-fine)

        entries = [self.add(Lookup(n, cell, "", array, k)) for n, k in _neighbours(grid.degree).items()]
        between = _between(part, entries, self.step)
        about = f"[{unit}] {'a line' if grid.degree == 1 else 'a cubic'} between entries"
        follows = "place", grid.slope / grid.unit / rate
        if grid.integers:
            return self.step(
                "correction", scale * self.step("between", between, about, follows=follows), "[rad]"
            )
        return self.step("correction", between, about, follows=follows)

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
        seen = self.curve.readings(np.linspace(*angles, 4096) / self.curve.share)[
            self.curve.model.channels.index(channel)
        ]
        middle, swing = (seen.max() + seen.min()) / 2, (seen.max() - seen.min()) / 2 * (1 + ROOM)
        return float(f"{middle - swing:.3g}"), float(f"{middle + swing:.3g}")

    @cached_property
    def _left(self) -> float:
        """What the polynomials and the correction may leave in the angle [rad]."""
        found = self.correction
        octants = 0.0 if self.curve.angle_only else arctangent().error * (1 + found.slope)
        return float(octants + found.left + ROUNDED) * self.curve.share

    def _listed(self) -> tuple[tuple[float, ...], ...]:
        """No field, and the seams of the octants."""
        if self.curve.angle_only:
            return tuple((a,) for a in (-TURN, -pi, -1e-3, 0.0, pi, TURN))
        seams = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]]) / 2**0.5
        back = (np.linalg.pinv(self.curve.matrix) @ seams.T).T + self.curve.center
        return tuple(map(tuple, [self.curve.center.tolist(), *back.tolist()]))

    def _said(self) -> tuple[str, ...]:
        found, out = self.correction, []
        if not self.curve.angle_only:
            out.append(
                f"The arctangent is a polynomial of degree {arctangent().degree}: off by at most "
                f"{arctangent().error:.2g} rad (proved)."
            )
            out.append(f"{REVERSED}: no bit is raised.")
        if found.looked_up:
            size = (2 if found.integers else 4) * len(found.values)
            between = "straight lines" if found.degree == 1 else "cubics"
            out.append(
                f"The correction is a table of {len(found.values)} entries, {size} bytes, with {between} "
                f"between them; it leaves at most {found.left:.2g} rad, the rounding of its entries counted "
                "(proved)."
            )
        elif found.left > 1e-12:
            out.append(f"No correction is needed for the accuracy asked: {found.left:.2g} rad are left.")
        return tuple(out)


def _neighbours(degree: int) -> dict[str, int]:
    """Return the entries that a line or a cubic goes through: how far they are ahead of the cell, by name."""
    return {"left": 0, "right": 1} if degree == 1 else {"before": -1, "left": 0, "right": 1, "after": 2}


def _between(part: ca.SX, entries: Sequence[ca.SX], step: Callable[[str, ca.SX], ca.SX]) -> ca.SX:
    """Return the line or the cubic through entries, `part` of the way between the middle two.

    `step`: names a part of it.
    """
    if len(entries) == 2:
        left, right = entries
        return left + part * (right - left)
    before, left, right, after = entries
    rise = step("rise", right - left)
    bend_left = step("bend_left", (before - left) + rise)
    bend_right = step("bend_right", (after - right) - rise)
    share = step("share_of_bends", (1.0 - part) * SIXTH)
    bends = step("bends", (2.0 - part) * bend_left + (1.0 + part) * bend_right)
    return left + part * (rise - share * bends)


ENOUGH_OF_INTEGERS = 1e-5
"""Angle [rad] that a table of integers may leave unless another accuracy is asked for: 2 arc seconds."""


def program(
    d: Decoupler,
    curve: Curve,
    *,
    accuracy: float | None = None,
    correction: str | None = None,
    plan: Sequence[int] | None = None,
) -> Program:
    """Return the integer program of an angle.

    `accuracy`: what the table may leave [rad], default `ENOUGH_OF_INTEGERS`, CORDIC a thirty-second of it;
    `correction`: as of `table_of`; `plan`: as of `integer_program`.
    """
    aim = ENOUGH_OF_INTEGERS if accuracy is None else accuracy
    table, steps = table_of(curve, aim, correction), integer_c.steps_for(aim)
    return planned(lambda given: _Turns(d, given, curve, table, steps), plan)


def table_of(curve: Curve, accuracy: float, form: str | None) -> Grid | None:
    """Return the smallest table of integers, lines between them, that leaves at most `accuracy` [rad].

    In units of a power of two of 2^-32 turn. `form`: that of one that it shall be like. None where the angle
    needs no more than a constant.
    """
    corrections.check(curve, accuracy, form)
    if form is not None:
        _, entries, _, wide, *power = form.split(":")
        made = _table(curve, int(entries), int(wide), *map(int, power))
        return corrections.like(curve, accuracy, form, made)
    if np.abs(curve.needed[1]).max() <= ROUNDED:
        return None
    forms = sorted((bits * n, bits, n, room) for n in SIZES for bits, room in ((16, -1), (16, 0), (32, 0)))
    # room for twice the correction, where it is as near with it
    tried = (_table(curve, count, bits, room=-room) for _, bits, count, room in forms)
    return corrections.first_within(curve, accuracy, tried, [_table(curve, SIZES[-1], 32)])


def _table(curve: Curve, count: int, bits: int, power: int | None = None, room: int = 0) -> Grid:
    """Return a table in units of 2^`power` BAM, by default the finest with `room` bits to spare."""
    middle, rest = curve.needed
    if power is None:
        least = np.log2(max(np.abs(rest).max() / UNIT / WORST, 1.0))
        power = int(np.ceil(least)) + room if bits == 16 else 0
    unit = UNIT * 2.0**power
    values = np.round(rest[:: POINTS // count] / unit)
    constant = float(within_turn(np.array(round(middle / UNIT) * UNIT), 2 * pi))
    return Grid(constant, np.clip(values, -WORST, WORST) if bits == 16 else values, unit, 1, bits=bits)


class _Turns(Compiler):
    def __init__(
        self, d: Decoupler, plan: Sequence[int] | None, curve: Curve, table: Grid | None, steps: int
    ) -> None:
        super().__init__(d, plan)
        self.curve, self.table, self.steps = curve, table, steps

    def compile(self) -> Program:
        """Return the program."""
        d, p = self.d, self.p
        (pose,) = d.pose
        p.angles = frozenset({pose, *(() if not self.curve.angle_only else d.inputs)})
        if self.curve.angle_only:
            (column,) = d.inputs
            p.inputs[column], phase, error = 0, short(column), 0.0
        else:
            phase, error = self._vector()
        angle, table = phase, self.table
        shift, left, part = self.curve.needed[0], 0.0, self.curve.share
        if table is not None:
            shift, left = table.constant, table.left
            values = np.roll(table.values.astype(np.int64), len(table.values) // 2)
            power = round(np.log2(table.unit / UNIT))
            array = integer_c.AngleTable("correction", values, power, table.bits)
            p.arrays["correction"] = array
            p.options["correction"] = f"{table.form}:{power}"
            error = error * (1 + table.slope) + array.error
            p.said.append(
                f"The correction is a table of {len(values)} entries of {table.bits} bits with straight "
                f"lines between them; it leaves at most {left:.2g} rad, the rounding of its entries counted "
                "(proved)."
            )
            looked = self._line("look", phase, "correction")
        if self._shifts(shift):
            angle = self._line("turn", angle, self._angle("shift", shift, "correction, the same all round"))
            error += UNIT / 2
        if table is not None:
            angle = self._line("turn", angle, looked)
        angle = self._line("turn", angle, self._angle(f"zero_{short(pose)}", 0.0, "set by decoupler_zero()"))
        p.outputs[pose] = (angle, 0)
        p.bounds[pose] = (0.0, 2 * pi * part, (error + left + 1e-13) * part)
        return p

    def _angle(self, name: str, value: float, meaning: str) -> str:
        self.p.unsigned[name] = f"[2^-32 turn] {meaning}"
        self.p.table[name] = (round(value / UNIT) % 2**32, 0)
        return name

    def _shifts(self, shift: float) -> bool:
        moves = self.table is not None or abs(shift) >= UNIT / 2
        planned = bool(self._chosen(lambda: int(moves)))
        if moves and not planned:
            raise InputError(f"The calibration's shift of the angle {integer_c.DOES_NOT_FIT}")
        return planned

    def _vector(self) -> tuple[str, float]:
        """Two voltages to a vector, its angle and the flag of its length.

        Centers have the exponent of the inputs, entries of the map one of their own, so that a recalibration
        of a magnet that is much the same needs the same code.
        """
        d, p, off = self.d, self.p, []
        volts = self._exponent(0.0, max(abs(v) for channel in d.inputs for v in d.ends(channel)))
        for channel, center in zip(d.inputs, self.curve.center, strict=True):
            p.inputs[channel] = volts
            given = Fixed(short(channel), volts, *d.ends(channel))
            entry = self._constant(f"center_{short(channel)}", float(center), volts)
            off.append(self._add(given, entry, minus=True))
        most = float(np.abs(self.curve.matrix).max())
        shared = self._exponent(-most, most)
        x, y = (self._row(axis, row, off, shared) for axis, row in zip("xy", self.curve.matrix, strict=True))
        grown = integer_c.SPREAD * max(x.most, y.most)
        e = self._chosen(lambda: min(x.e, y.e, integer_c.exponent(-grown, grown)))
        self._checked(Fixed("vector", e, -grown, grown))
        x, y = self._cut(x, e), self._cut(y, e)
        field = self._add(self._mul(x, x), self._mul(y, y))
        p.table["least_field"] = (round(WEAK**2 * 2.0**field.e), field.e)
        p.flags["FIELD"] = (field.text, "least_field")
        self._beside(field, off)
        # where the flag is clear, the vector is as long but for the rounding of its square
        length = np.sqrt(max(WEAK**2 - field.error - field.unit, 1e-9))
        moved = asin(min(1.0, hypot(x.error, y.error) / (length - hypot(x.error, y.error))))
        cordic = integer_c.angle_error(length * 2.0**e, self.steps)
        p.said.append(f"{REVERSED}: no bit is raised.")
        p.said.append(
            f"The angle comes from {self.steps} steps of CORDIC, a loop of fixed length: off by at most "
            f"{cordic:.2g} rad where the field is not weak (proved)."
        )
        return self._line("angle", x.text, y.text, self.steps), moved + cordic

    def _beside(self, field: Fixed, off: list[Fixed]) -> None:
        """How far readings are beside their circle, or off its plane: the flag of a fault looks at it."""
        if len(off) == 2:
            beside = Fixed(
                self._line("one", field.text, i=field.e), field.e, 1 - field.high, 1 - field.low, field.error
            )
            return self._least(FAULT, residual.LEAST, self._less(beside))
        spare, e = self.curve.spare, self._exponent(-1.0, 1.0)
        names = residual.left_names(spare, list(map(short, self.d.model.channels)))
        left = [self._row(name, row, off, e) for name, row in zip(names, spare, strict=True)]
        if len(left) == 1:
            return self._least(FAULT, residual.LEAST, self._less(left[0]))
        return self._least(FAULT, residual.LEAST, self._agreement(left))

    def _less(self, v: Fixed) -> Fixed:
        """Less the size of a value."""
        text = self._line("neg", self._line("size", v.text))
        return Fixed(text, v.e, -v.most, 0.0, v.error)

    def _row(self, axis: str, row: np.ndarray, off: list[Fixed], e: int) -> Fixed:
        terms = (
            self._mul(self._constant(f"{axis}_{short(c)}", float(value), e), o)
            for c, value, o in zip(self.d.inputs, row, off, strict=True)
        )
        return reduce(self._add, terms)

    def _cut(self, v: Fixed, e: int) -> Fixed:
        if v.e == e:
            return v
        return Fixed(self._line("right", v.text, i=v.e - e), e, v.low, v.high, v.error + 2.0**-e)
