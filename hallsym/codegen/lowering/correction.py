"""The correction of a phase: a short series of waves, or a table with lines or cubics between.

Either is as long as it must be for an accuracy, and the one that takes fewer bytes is taken. What it leaves
is proved from the model: over an interval of the angle a, with phase f(a) and correction t, the error
E = f + t(f) - a moves by at most half the interval's width times the largest |f' (1 + t') - 1|, and f' is
enclosed by interval arithmetic (`Curve.slopes`), kinks of a clipped voltage included.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import degrees, pi
from typing import TypeVar

import numpy as np

from hallsym.codegen.lowering.phase_curve import POINTS, Curve
from hallsym.errors import InputError, require
from hallsym.log.phase import wrapped

ENOUGH = 3e-8
"""Angle [rad] that a correction may leave unless another accuracy is asked for: a quarter of what float32
rounds an angle near pi by."""
MOST_WAVES = 32
SIZES = (64, 128, 256, 512, 1024)
"""Entries of a table."""
KINDS = ("auto", "series", "table")
DEGREES = {"lines": 1, "cubics": 3}
FORM = re.compile(
    rf"series:\d\d?|table:({'|'.join(map(str, SIZES))}):({'|'.join(DEGREES)}):(16|32)(:\d\d?)?", re.ASCII
)
"""A series of so many waves, or a table: entries, what is between them, bits of each, power of their unit."""
SMOOTH = 1e-10
"""Sum [rad] of the last quarter of the waves that are computed, below which the others are all there are."""
COARSEST, FINEST = 1 << 12, 1 << 18
"""Intervals of a turn in a proof."""
ROUNDED = 1e-13
WORST = 32767
"""Largest entry of a table of 16 bits."""


@dataclass(frozen=True)
class Series:
    """constant + sum of cos_n cos(n phase) + sin_n sin(n phase) [rad]; `left`: what it leaves."""

    constant: float
    cos: tuple[float, ...]
    sin: tuple[float, ...]
    left: float = np.inf
    summed: bool = False
    """Whether `left` is the sum of the waves left out, not a bound over intervals."""

    def at(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the correction (s,) [rad] and its derivative (s,) at phases (s,)."""
        total, turning = np.full(np.shape(phase), self.constant, dtype=complex), np.exp(-1j * phase)
        slope, wave = np.zeros(np.shape(phase), dtype=complex), np.ones(np.shape(phase), dtype=complex)
        for n, (c, s) in enumerate(zip(self.cos, self.sin, strict=True), 1):
            wave = wave * turning
            total += (c + 1j * s) * wave
            slope += -1j * n * (c + 1j * s) * wave
        return total.real, slope.real

    @property
    def waves(self) -> Sequence[float]:
        """Amplitude of each wave [rad]."""
        return np.hypot(self.cos, self.sin).tolist()

    @property
    def slope(self) -> float:
        """Bound of its derivative."""
        return float(sum(n * size for n, size in enumerate(self.waves, 1)))

    @property
    def bend(self) -> float:
        """Bound of its second derivative."""
        return float(sum(n**2 * size for n, size in enumerate(self.waves, 1)))

    @property
    def form(self) -> str:
        """What code depends on."""
        return f"series:{len(self.cos)}"

    @property
    def most(self) -> float:
        """Bound of its magnitude, without the constant."""
        return float(sum(self.waves))

    @property
    def bytes(self) -> int:
        """About how many bytes it takes, code and entries, on a Cortex-M4F."""
        return 148 + 48 * len(self.cos) if self.cos else 0


@dataclass(frozen=True, eq=False)
class Grid:
    """constant + unit * values at phases -pi, -pi + h, ..., lines (degree 1) or cubics (3) between [rad]."""

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
    def form(self) -> str:
        """What code depends on."""
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

    @property
    def bytes(self) -> int:
        """About how many bytes it takes, code and entries, on a Cortex-M4F."""
        return table_bytes(len(self.values), self.degree, self.integers)


Form = TypeVar("Form", Series, Grid)


def shortest_correction(curve: Curve, accuracy: float | None = None, kind: str = "auto") -> Series | Grid:
    """Return the correction of fewest bytes that leaves at most `accuracy` [rad] (default `ENOUGH`).

    `kind`: one of `KINDS`, or the `form` of a correction that shall be like it. Raises `InputError` where
    none does, with what is within reach.
    """
    aim = ENOUGH if accuracy is None else accuracy
    check(curve, aim, kind)
    if ":" in kind:
        name, count, *rest = kind.split(":")
        if name == "series":
            return like(curve, aim, kind, _waves(curve, int(count)))
        return like(curve, aim, kind, grid(curve, int(count), DEGREES[rest[0]], rest[1] == "16"))
    series = _series(curve, aim) if kind != "table" else None
    table = None
    if kind != "series":
        try:
            table = _table(curve, aim, series.bytes if series else 1 << 16)
        except InputError:  # nothing can be proved of a table: an operation whose range is not known
            if series is None:
                raise
    found = table or series
    if found is None:
        raise InputError(out_of_reach(curve, aim, kind))
    return found


def check(curve: Curve, aim: float, kind: str) -> None:
    """Refuse what no correction is made for."""
    known = kind in KINDS or FORM.fullmatch(kind)
    require(known, "A correction", f"one of {', '.join(KINDS)}", kind, KINDS)
    require(0 < aim < np.inf, "The accuracy of a correction", "a positive angle in rad", aim)
    if np.abs(curve.needed[1]).max() >= 1.0:
        raise InputError(
            f"The distortion of this calibration of {curve.model.name} is more than 1 rad; no correction "
            "of the angle is generated for it."
        )


def like(curve: Curve, aim: float, form: str, made: Form) -> Form:
    """Return a correction of a given form with what it leaves, or refuse it."""
    sure = replace(made, left=proved(curve, made, max(aim, 1.05 * sampled(curve, made))))
    if made.most >= 1.0 or sure.left > aim:
        raise InputError(
            f"A correction {form} leaves {sure.left:.2g} rad of this calibration of {curve.model.name}, more "
            f"than {aim:.3g} rad: generate the folder again with --force, or give a coarser --accuracy."
        )
    return sure


def proved(curve: Curve, found: Series | Grid, accuracy: float) -> float:
    """Return a bound of |angle - phase - correction| [rad] over all phases that the model reads.

    In finer intervals while it is beyond `accuracy`.
    """
    count, bound = COARSEST, np.inf
    while count <= FINEST and not bound <= accuracy:
        if 40 / count < np.sqrt(accuracy) or count == FINEST:  # coarser ones would add as much
            bound = min(bound, _bounded(curve, found, count))
        count *= 4
    return bound


def _bounded(curve: Curve, found: Series | Grid, count: int) -> float:
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


def _series(curve: Curve, accuracy: float) -> Series | None:
    """Return the shortest series that is as near, if there is one."""
    size = np.abs(curve.waves[1])
    left = np.append(np.cumsum(size[::-1])[::-1], 0.0)  # left[k]: waves k + 1 and up
    smooth = size[3 * len(size) // 4 :].sum() <= SMOOTH
    for count in range(0, MOST_WAVES + 2, 2):
        made = _waves(curve, count)
        if made.most >= 1.0:
            break
        if smooth and left[count] <= accuracy:
            return replace(made, left=float(left[count]), summed=True)
        if (not smooth or accuracy > 10 * ENOUGH) and sampled(curve, made) <= accuracy:
            bound = proved(curve, made, accuracy)
            if bound <= accuracy:
                return replace(made, left=bound)
    return None


def _waves(curve: Curve, count: int) -> Series:
    mean, waves = curve.waves
    kept, constant = waves[:count], float(wrapped(np.array(mean), 2 * pi))
    if not count and abs(constant) <= 1e-12:
        constant = 0.0
    return Series(constant, tuple(kept.real.tolist()), tuple((-kept.imag).tolist()))


def sampled(curve: Curve, found: Series | Grid) -> float:
    """Return the largest error at some angles: what is worth a proof."""
    angle, phase = curve.trial
    return float(np.abs(wrapped(phase + found.at(phase)[0] - angle, 2 * pi)).max())


def _table(curve: Curve, accuracy: float, below: int) -> Grid | None:
    """Return the table of fewest bytes that is as near, if one has fewer than `below`."""
    forms = [(n, degree, integers) for n in SIZES for degree in (1, 3) for integers in (True, False)]
    for form in sorted(forms, key=lambda form: table_bytes(*form)):
        if table_bytes(*form) >= below:
            break
        made = grid(curve, *form)
        if sampled(curve, made) <= accuracy:
            sure = replace(made, left=proved(curve, made, accuracy))
            if sure.left <= accuracy:
                return sure
    return None


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


def out_of_reach(curve: Curve, accuracy: float, kind: str, longest: Sequence[Series | Grid] = ()) -> str:
    """Return the sentence that says so, with what is within reach; `longest`: what was tried last."""
    waves, entries = f"more than {MOST_WAVES} waves per turn", f"a table of more than {SIZES[-1]} entries"
    tried = {"series": [waves], "table": [entries]}.get(kind, [waves, entries])
    if kind == "series":
        longest = [_waves(curve, MOST_WAVES)]
    elif not longest:
        longest = [grid(curve, SIZES[-1], degree, False) for degree in (1, 3)]
    reach = [proved(curve, form, 1.05 * sampled(curve, form)) for form in longest]
    best = float(f"{1.01 * min(reach):.2g}")
    instead = " and ".join(curve.model.effects) or "so large a distortion"
    return (
        f"A correction of this calibration of {curve.model.name} that leaves at most {accuracy:.3g} rad "
        f"takes {' and '.join(tried)}; {best:.2g} rad ({degrees(best):.2g} deg) is within reach: give "
        f"--accuracy angle_rad={best:.2g}, or fit a model without {instead}."
    )
