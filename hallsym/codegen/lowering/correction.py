"""The correction of a phase: a table with lines or cubics between its entries.

It has as many entries as an accuracy asks for. What it leaves is proved from the model: over an interval of
the angle a, with phase f(a) and correction t, the error E = f + t(f) - a moves by at most half the interval's
width times the largest |f' (1 + t') - 1|, and f' is enclosed by interval arithmetic (`Curve.slopes`), kinks
of a clipped voltage included.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import degrees, pi

import numpy as np

from hallsym.codegen.lowering.phase_curve import POINTS, Curve
from hallsym.errors import InputError, require
from hallsym.log.phase import wrapped

ENOUGH = 3e-8
"""Angle [rad] that a correction may leave unless another accuracy is asked for: a quarter of what float32
rounds an angle near pi by."""
SIZES = (64, 128, 256, 512, 1024)
"""Entries of a table."""
DEGREES = {"lines": 1, "cubics": 3}
NONE = "none"
FORM = re.compile(
    rf"{NONE}|table:({'|'.join(map(str, SIZES))}):({'|'.join(DEGREES)}):(16|32)(:\d\d?)?", re.ASCII
)
"""A constant alone, or a table: entries, what is between them, bits of each, power of their unit."""
COARSEST, FINEST = 1 << 12, 1 << 18
"""Intervals of a turn in a proof."""
ROUNDED = 1e-13
WORST = 32767
"""Largest entry of a table of 16 bits."""


@dataclass(frozen=True, eq=False)
class Grid:
    """constant + unit * values at phases -pi, -pi + h, ..., lines (degree 1) or cubics (3) between [rad].

    A value alone, of 0, is no table.
    """

    constant: float
    values: np.ndarray
    unit: float
    degree: int
    left: float = np.inf
    bits: int = 16
    """Of an entry where those are integers."""

    @property
    def integers(self) -> bool:
        """Whether the entries are integers, times a unit."""
        return self.unit != 1.0

    @property
    def looked_up(self) -> bool:
        """Whether it is more than a constant."""
        return len(self.values) > 1

    @property
    def form(self) -> str:
        """What code depends on."""
        if not self.looked_up:
            return NONE
        between = next(name for name, degree in DEGREES.items() if degree == self.degree)
        return f"table:{len(self.values)}:{between}:{self.bits if self.integers else 32}"

    @property
    def step(self) -> float:
        """Phase between two entries [rad]."""
        return 2 * pi / len(self.values)

    @cached_property
    def _polynomials(self) -> np.ndarray:
        """Coefficients (4, n) [rad] of 1, p, p^2, p^3 in each cell, p from 0 to 1."""
        y = self.unit * self.values
        before, right, after = np.roll(y, 1), np.roll(y, -1), np.roll(y, -2)
        if self.degree == 1:
            return np.array([y, right - y, 0 * y, 0 * y])
        return np.array([
            y, right - before / 3 - y / 2 - after / 6, (before + right) / 2 - y,
            (after - before) / 6 + (y - right) / 2,
        ])  # fmt: skip

    def at(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the correction (s,) [rad] and its derivative (s,) at phases (s,)."""
        place = (phase + pi) / self.step
        cell = np.floor(place)
        c, p = self._polynomials[:, cell.astype(np.int64) % len(self.values)], place - cell
        total = self.constant + ((c[3] * p + c[2]) * p + c[1]) * p + c[0]
        return total, ((3 * c[3] * p + 2 * c[2]) * p + c[1]) / self.step

    @property
    def bend(self) -> float:
        """Bound of its second derivative within the cells."""
        c = self._polynomials
        return float(np.maximum(np.abs(2 * c[2]), np.abs(2 * c[2] + 6 * c[3])).max() / self.step**2)

    @property
    def slope(self) -> float:
        """Bound of its derivative."""
        c = self._polynomials
        ends = np.maximum(np.abs(c[1]), np.abs(c[1] + 2 * c[2] + 3 * c[3])).max() / self.step
        return float(ends + self.bend * self.step / 8)

    @property
    def most(self) -> float:
        """Largest magnitude of an entry [rad]."""
        return float(np.abs(self.unit * self.values).max())


def smallest_correction(curve: Curve, accuracy: float | None = None, form: str | None = None) -> Grid:
    """Return the correction of fewest bytes that leaves at most `accuracy` [rad] (default `ENOUGH`).

    `form`: that of a correction that it shall be like. Raises `InputError` where none does, with what is
    within reach.
    """
    aim = ENOUGH if accuracy is None else accuracy
    check(curve, aim, form)
    if form is not None:
        _, *given = form.split(":")
        return like(curve, aim, form, grid(curve, int(given[0]), DEGREES[given[1]], given[2] == "16")
                    if given else _constant(curve))  # fmt: skip
    forms = [(n, degree, integers) for n in SIZES for degree in (1, 3) for integers in (True, False)]
    tables = (grid(curve, *form) for form in sorted(forms, key=lambda form: table_bytes(*form)))
    longest = [grid(curve, SIZES[-1], degree, False) for degree in (1, 3)]
    return first_within(curve, aim, (g for some in ([_constant(curve)], tables) for g in some), longest)


def check(curve: Curve, aim: float, form: str | None) -> None:
    """Refuse what no correction is made for."""
    require(0 < aim < np.inf, "The accuracy of a correction", "a positive angle in rad", aim)
    if form is not None and not FORM.fullmatch(form):
        raise InputError(
            f"The code in the folder has a correction {form!r}, which is not made any more: generate the "
            "folder again with --force."
        )
    if np.abs(curve.needed[1]).max() >= 1.0:
        raise InputError(
            f"The distortion of this calibration of {curve.model.name} is more than 1 rad; no correction "
            "of the angle is generated for it."
        )


def first_within(curve: Curve, aim: float, tried: Iterable[Grid], longest: Iterable[Grid]) -> Grid:
    """Return the first of some corrections that leaves at most `aim` [rad], which is proved of it.

    Raises `InputError` with what the `longest` ones leave where none does.
    """
    for made in tried:
        if sampled(curve, made) <= aim:
            sure = replace(made, left=proved(curve, made, aim))
            if sure.left <= aim:
                return sure
    best = 1.01 * min(proved(curve, made, 1.05 * sampled(curve, made)) for made in longest)
    instead = " and ".join(curve.model.effects) or "so large a distortion"
    raise InputError(
        f"A correction of this calibration of {curve.model.name} that leaves at most {aim:.3g} rad takes a "
        f"table of more than {SIZES[-1]} entries; {best:.2g} rad ({degrees(best):.2g} deg) is within reach: "
        f"give --accuracy angle_rad={best:.2g}, or fit a model without {instead}."
    )


def like(curve: Curve, aim: float, form: str, made: Grid) -> Grid:
    """Return a correction of a given form with what it leaves, or refuse it."""
    sure = replace(made, left=proved(curve, made, max(aim, 1.05 * sampled(curve, made))))
    if made.most >= 1.0 or sure.left > aim:
        raise InputError(
            f"A correction {form} leaves {sure.left:.2g} rad of this calibration of {curve.model.name}, more "
            f"than {aim:.3g} rad: generate the folder again with --force, or give a coarser --accuracy."
        )
    return sure


def proved(curve: Curve, found: Grid, accuracy: float) -> float:
    """Return a bound of |angle - phase - correction| [rad] over all phases that the model reads.

    In finer intervals while it is beyond `accuracy`. Where the phase is the angle but for rounding at all of
    `Curve.turn`, what a constant leaves is that rounding: waves of more than `POINTS` / 2 a turn are none.
    """
    if not found.looked_up and np.abs(curve.needed[1]).max() <= ROUNDED:
        return float(np.abs(curve.needed[1]).max())
    count, bound = COARSEST, np.inf
    while count <= FINEST and not bound <= accuracy:
        if 40 / count < np.sqrt(accuracy) or count == FINEST:  # coarser ones would add as much
            bound = min(bound, _bounded(curve, found, count))
        count *= 4
    return bound


def _bounded(curve: Curve, found: Grid, count: int) -> float:
    low, high, angle, phase = curve.slopes(count)
    width, moved = 2 * pi / count, np.diff(phase)
    if (moved < low * width - ROUNDED).any() or (moved > high * width + ROUNDED).any():
        raise curve.too_large  # it jumps
    added, slope = found.at(wrapped(phase, 2 * pi))
    error = np.abs(wrapped(phase + added - angle, 2 * pi))
    room = found.bend * high * width
    least = 1 + np.minimum(slope[:-1], slope[1:]) - room
    most = 1 + np.maximum(slope[:-1], slope[1:]) + room
    steepest = np.max([np.abs(a * b - 1) for a in (low, high) for b in (least, most)], axis=0)
    return float((np.maximum(error[:-1], error[1:]) + width / 2 * steepest).max() + ROUNDED)


def sampled(curve: Curve, found: Grid) -> float:
    """Return the largest error at some angles: what is worth a proof."""
    angle, phase = curve.trial
    return float(np.abs(wrapped(phase + found.at(phase)[0] - angle, 2 * pi)).max())


def table_bytes(count: int, degree: int, integers: bool) -> int:
    """About how many bytes a table takes, code and entries, on a Cortex-M4F."""
    return (2 * count + 36 if integers else 4 * count) + (72 if degree == 1 else 184)


def grid(curve: Curve, count: int, degree: int, integers: bool) -> Grid:
    """Return the table of `count` entries; `left` is not yet known."""
    middle, rest = curve.needed
    needed = rest[:: POINTS // count]
    unit = float(np.float32(max(np.abs(needed).max(), 1e-9) / WORST)) if integers else 1.0
    values = np.round(needed / unit) if integers else needed.astype(np.float32).astype(float)
    return Grid(float(wrapped(np.array(middle), 2 * pi)), np.clip(values, -WORST, WORST), unit, degree)


def _constant(curve: Curve) -> Grid:
    constant = float(wrapped(np.array(curve.needed[0]), 2 * pi))
    return Grid(constant if abs(constant) > ROUNDED else 0.0, np.zeros(1), 1.0, 1)
