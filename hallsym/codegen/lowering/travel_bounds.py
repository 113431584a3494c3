"""Rounding error bound of place and height of a wave that travels along a row of sensors.

Sums of few terms (sensors without weight add less than half a unit of the last place) round by a share of the
sum of their magnitudes (Higham, Accuracy and Stability of Numerical Algorithms, 3.1), which 2 x 2 least
squares passes on: both are bounded for each of many poses, and the largest is taken with some room.
Arctangent and logarithm are bounded as of one wave (`lowering.wave_bounds`). Weights multiply reading and
model alike, so what they are off by moves the vector by that share of what ends leave, which is far less.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hallsym.codegen.decoupler import Step
from hallsym.codegen.intervals import Enclosure, constant
from hallsym.codegen.lowering.angle_bounds import half_ulp
from hallsym.codegen.lowering.arrays_bounds import ranges_of
from hallsym.codegen.lowering.travel_fit import Row
from hallsym.codegen.lowering.wave_bounds import Values, height_error, place_error
from hallsym.codegen.lowering.wave_steps import Wave

TRIALS = 2000
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
        inputs = self.drawn(np.random.default_rng(6), TRIALS)
        ranges = ranges_of(self.steps, row.model.channels, inputs, self.values, row.model.pose)
        last = [ranges[step.name] for step in self.steps[-2:]]
        return {c: Enclosure(*last[k], errors[k]) for k, c in enumerate(row.model.pose)}

    def _vector(self, u: float) -> np.ndarray:
        """Length (s,) by which rounding to a share u moves the vector of each trial pose."""
        row = self.row
        pose = row.poses(np.random.default_rng(8), TRIALS)
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
