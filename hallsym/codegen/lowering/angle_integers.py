"""The corrected angle in 32-bit integers: binary angles, CORDIC, and a table.

A decoded angle is counted in 2^-32 of a turn, so it wraps by itself and every bit pattern is an angle. Two
voltages go through the linear map of the float code, in integers whose exponents come from their ranges, and
through CORDIC. The correction is looked up, with straight lines between entries: fewer instructions without a
floating-point unit than any series.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import asin, hypot, pi

import numpy as np

from hallsym.codegen import binary_angle
from hallsym.codegen.decoupler import Decoupler, Entry, short
from hallsym.codegen.integer_c import DOES_NOT_FIT, Compiler, Fixed, Program, exponent, planned
from hallsym.codegen.lowering.correction import (
    ROUNDED,
    SIZES,
    WORST,
    Grid,
    check,
    like,
    out_of_reach,
    proved,
    sampled,
)
from hallsym.codegen.lowering.phase_curve import POINTS, Curve
from hallsym.errors import InputError
from hallsym.log.phase import wrapped

ENOUGH = 1e-5
"""Angle [rad] that a table of integers may leave unless another accuracy is asked for: 2 arc seconds."""


def program(
    d: Decoupler,
    curve: Curve,
    weak: float,
    *,
    accuracy: float | None = None,
    correction: str = "auto",
    plan: Sequence[int] | None = None,
) -> Program:
    """Return the integer program of an angle; `weak`: share of the amplitude below which a flag is set.

    `accuracy`: what the table may leave [rad], default `ENOUGH`, and CORDIC a thirty-second of it;
    `correction`: as of `table_of`; `plan`: as of `integer_program`.
    """
    if correction.startswith("series"):
        raise InputError(
            "--arithmetic q31 corrects an angle from a table, which takes fewer instructions than a series "
            "without a floating-point unit: leave out --correction series."
        )
    aim = ENOUGH if accuracy is None else accuracy
    table, steps = table_of(curve, aim, correction), binary_angle.steps_for(aim)
    return planned(lambda given: _Turns(d, given, curve, weak, table, steps), plan)


def table_of(curve: Curve, accuracy: float, kind: str) -> Grid | None:
    """Return the smallest table of integers, lines between them, that leaves at most `accuracy` [rad].

    In units of a power of two of 2^-32 turn. `kind`: "auto", "table", or the form of one that it shall be
    like. None where the angle needs no more than a constant.
    """
    check(curve, accuracy, kind)
    if ":" in kind:
        _, entries, _, wide, *power = kind.split(":")
        return like(curve, accuracy, kind, _table(curve, int(entries), int(wide), *map(int, power)))
    if np.abs(curve.needed[1]).max() <= ROUNDED:
        return None
    forms = sorted((bits * n, bits, n, room) for n in SIZES for bits, room in ((16, -1), (16, 0), (32, 0)))
    for _, bits, count, room in forms:  # room for twice the correction, where it is as near with it
        found = _table(curve, count, bits, room=-room)
        if sampled(curve, found) <= accuracy:
            sure = replace(found, left=proved(curve, found, accuracy))
            if sure.left <= accuracy:
                return sure
    raise InputError(out_of_reach(curve, accuracy, "table", [_table(curve, SIZES[-1], 32)]))


def _table(curve: Curve, count: int, bits: int, power: int | None = None, room: int = 0) -> Grid:
    """Return a table in units of 2^`power` BAM, by default the finest with `room` bits to spare."""
    middle, rest = curve.needed
    if power is None:
        least = np.log2(max(np.abs(rest).max() / binary_angle.UNIT / WORST, 1.0))
        power = int(np.ceil(least)) + room if bits == 16 else 0
    unit = binary_angle.UNIT * 2.0**power
    values = np.round(rest[:: POINTS // count] / unit)
    constant = float(wrapped(np.array(round(middle / binary_angle.UNIT) * binary_angle.UNIT), 2 * pi))
    return Grid(constant, np.clip(values, -WORST, WORST) if bits == 16 else values, unit, 1, bits=bits)


class _Turns(Compiler):
    def __init__(
        self,
        d: Decoupler,
        plan: Sequence[int] | None,
        curve: Curve,
        weak: float,
        table: Grid | None,
        steps: int,
    ) -> None:
        super().__init__(d, plan)
        self.curve, self.weak, self.table, self.steps = curve, weak, table, steps

    def compile(self) -> Program:
        """Return the program."""
        d, p = self.d, self.p
        (pose,) = d.pose
        p.angles = frozenset({pose, *(() if not self.curve.angle_only else d.inputs)})
        phase, error = self._read() if self.curve.angle_only else self._vector()
        angle, table = phase, self.table
        shift, left = self.curve.needed[0], 0.0
        if table is not None:
            shift, left = table.constant, table.left
            values = np.roll(table.values.astype(np.int64), len(table.values) // 2)
            power = round(np.log2(table.unit / binary_angle.UNIT))
            array = binary_angle.AngleTable("correction", values, power, table.bits)
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
            angle = self._turn(angle, self._angle("shift", shift, "correction, the same all round"))
            error += binary_angle.UNIT / 2
        if table is not None:
            angle = self._turn(angle, looked)
        angle = self._turn(angle, self._angle(f"zero_{short(pose)}", 0.0, "set by decoupler_zero()"))
        p.outputs[pose] = (angle, 0)
        p.bounds[pose] = (0.0, 2 * pi, error + left + 1e-13)
        return p

    def _angle(self, name: str, value: float, meaning: str) -> str:
        self.p.unsigned[name] = f"[2^-32 turn] {meaning}"
        self.p.table[name] = (round(value / binary_angle.UNIT) % 2**32, 0)
        return name

    def _turn(self, a: str, b: str) -> str:
        return self._line("turn", a, b)

    def _shifts(self, shift: float) -> bool:
        """Whether a constant is added to the angle."""
        moves = self.table is not None or abs(shift) >= binary_angle.UNIT / 2
        planned = bool(self._chosen(lambda: int(moves)))
        if moves and not planned:
            raise InputError(f"The calibration's shift of the angle {DOES_NOT_FIT}")
        return planned

    def _read(self) -> tuple[str, float]:
        (column,) = self.d.inputs
        self.p.inputs[column] = 0
        return short(column), 0.0

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
        grown = binary_angle.SPREAD * max(x.most, y.most)
        e = self._chosen(lambda: min(x.e, y.e, exponent(-grown, grown)))
        self._checked(Fixed("vector", e, -grown, grown))
        x, y = self._cut(x, e), self._cut(y, e)
        field = self._add(self._mul(x, x), self._mul(y, y))
        least = Entry(
            "least_field", self.weak**2, "1", "square of the least share of the calibrated amplitude"
        )
        p.table[least.name] = (round(least.value * 2.0**field.e), field.e)
        p.flags["FIELD"] = (field.text, least.name)
        # where the flag is clear, the vector is as long but for the rounding of its square
        length = np.sqrt(max(self.weak**2 - field.error - field.unit, 1e-9))
        moved = asin(min(1.0, hypot(x.error, y.error) / (length - hypot(x.error, y.error))))
        cordic = binary_angle.angle_error(length * 2.0**e, self.steps)
        p.said.append(
            f"The angle comes from {self.steps} steps of CORDIC, a loop of fixed length: off by at most "
            f"{cordic:.2g} rad where the field is not weak (proved)."
        )
        return self._line("angle", x.text, y.text, self.steps), moved + cordic

    def _row(self, axis: str, row: np.ndarray, off: list[Fixed], e: int) -> Fixed:
        """One coordinate of the unit circle."""
        first, second = (
            self._mul(self._constant(f"{axis}_{short(c)}", float(value), e), o)
            for c, value, o in zip(self.d.inputs, row, off, strict=True)
        )
        return self._add(first, second)

    def _cut(self, v: Fixed, e: int) -> Fixed:
        if v.e == e:
            return v
        return Fixed(self._line("right", v.text, i=v.e - e), e, v.low, v.high, v.error + 2.0**-e)
