"""Angles as unsigned integers, 2^32 to a turn (binary angles, BAM): C, the same in numpy, and their errors.

Sums of binary angles wrap by themselves. The angle of a vector comes from CORDIC in vectoring mode (Volder
1959, doi:10.1109/TEC.1959.5222693): step k turns it by atan 2^-k towards the x axis, with shifts and sums.
"""

from dataclasses import dataclass
from math import asin, atan, pi, prod, sqrt

import numpy as np

from hallsym.errors import InputError

UNIT = 2 * pi / 2**32
"""Value [rad] of the last bit of a binary angle."""
MASK = 2**32 - 1
STEPS = 26
"""Most steps of CORDIC: beyond them shifts of 32 bits cut off more than a step leaves."""
ARCTANGENTS = tuple(round(atan(2.0**-k) / UNIT) for k in range(STEPS))
SPREAD = prod(1 + 2.0**-k for k in range(STEPS))
"""What intervals make of the growth of a vector: each coordinate by the other's, whatever their signs."""
FINE = 15
"""Bits of the way between two entries of a table."""


def steps_for(accuracy: float) -> int:
    """Return how many steps of CORDIC leave a thirty-second of an accuracy [rad], `STEPS` at most."""
    return next((n for n in range(8, STEPS) if atan(2.0 ** (1 - n)) <= accuracy / 32), STEPS)


def angle_of(x: np.ndarray, y: np.ndarray, steps: int = STEPS) -> np.ndarray:
    """Return the binary angle of vectors of integers, as `angle_of` of the generated C."""
    behind = x < 0
    across, up = np.where(behind, -x, x), np.where(behind, -y, y)
    angle = np.where(behind, np.int64(2**31), np.int64(0))
    for k, turn in enumerate(ARCTANGENTS[:steps]):
        a, b = across >> k, up >> k
        below = up < 0
        across, up = np.where(below, across - b, across + b), np.where(below, up + a, up - a)
        angle = np.where(below, angle - turn, angle + turn)
        if np.any(np.abs(across) >= 2**31) or np.any(np.abs(up) >= 2**31):
            raise OverflowError("a vector overflows in CORDIC")
    return np.asarray(angle & MASK)


def angle_error(least: float, steps: int = STEPS) -> float:
    """Return the bound of |angle_of - atan2| [rad] for vectors of at least that length, in units of a bit.

    A shift cuts off less than a bit of each coordinate, of a vector that has grown to the length of its step;
    an entry is off by half a bit; the last step leaves less than its angle.
    """
    length, cut = least, 0.0
    for k in range(steps):
        length = length * sqrt(1 + 4.0**-k) - (sqrt(2) if k else 0.0)
        cut += asin(min(1.0, sqrt(2) / length)) if k else 0.0
    return cut + steps * UNIT / 2 + atan(2.0 ** (1 - steps)) * (1 + 1e-9)


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Entries at phases 0, h, 2 h, ... of a turn in units of 2^`shift` BAM, straight lines between them.

    `bits`: 16 or 32 of each entry; with 32 `shift` is 0.
    """

    name: str
    values: np.ndarray
    shift: int
    bits: int

    def __post_init__(self) -> None:
        """Refuse what could overflow."""
        wide = np.abs(np.diff(self.values, append=self.values[:1])).max()
        if wide * 2.0**self.shift >= 2**30 or np.abs(self.values).max() * 2.0**self.shift >= 2**30:
            raise InputError("The correction does not fit into 32 bits; use float.")

    @property
    def first(self) -> int:
        """Bits of a phase below those that count entries."""
        return 32 - (len(self.values).bit_length() - 1)

    def at(self, phase: np.ndarray) -> np.ndarray:
        """Return the value [BAM] at binary phases, as the generated C."""
        cell = phase >> self.first
        rest = (phase >> (self.first - FINE)) & (2**FINE - 1)
        left = self.values[cell]
        rise = self.values[(cell + 1) % len(self.values)] - left
        if self.bits == 16:
            return np.asarray((left << self.shift) + ((rise * rest) >> (FINE - self.shift)))
        return np.asarray(left + (rise >> FINE) * rest + (((rise & (2**FINE - 1)) * rest) >> FINE))

    @property
    def error(self) -> float:
        """Bound of |at - straight lines between the entries| [rad]: what bits that are cut off change."""
        wide = float(np.abs(np.diff(self.values, append=self.values[:1])).max()) * 2.0**self.shift
        return UNIT * (wide * 2.0**-FINE + 2)
