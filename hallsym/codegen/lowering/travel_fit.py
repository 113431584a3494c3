"""A wave of finite length over a row of sensors: where each sensor is and what it reads, from the model's own
readings, and the decoder of it on arrays."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from hallsym.codegen.decoupler import Box
from hallsym.codegen.lowering.passing import passes
from hallsym.codegen.lowering.phasors import HARMONICS, Phasor, Sample
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

COUNTS = 1.0
"""Change of a place, over a micrometre, above which a higher harmonic counts."""
MICRON = 1e-6
TINY = 1e-12
"""Added to the energy of all sensors [V2]: it may be zero."""
RAMP = 0.5
"""Wavelengths over which the weight of a sensor goes from 0 to 1."""
NO_COVER = 1e-9
"""Determinant of the normal matrix [V4] of no sensors."""
BATCH = 1000


@dataclass(frozen=True, eq=False)
class Row:
    """Sensors of a model at parameters `p` under a wave of a `length` [m], with a `margin` from its ends.

    `place` (n,): x at which the middle of the wave is over each sensor [m]; `factor` (n, HARMONICS) complex:
    sensor k reads offset + Re sum c_kn u^n, u = exp((z - middle) / lc ... + i x / lc), away from the ends.
    """

    model: Model
    p: np.ndarray
    weight: np.ndarray
    low: np.ndarray
    high: np.ndarray
    """Ends of the box (2,)."""
    lc: float
    rising: float
    length: float
    place: np.ndarray
    offset: np.ndarray
    factor: np.ndarray
    margin: float = 0.0
    """Wavelengths from the ends of the wave."""
    rounds: int = 0

    @property
    def wavelength(self) -> float:
        """In metres."""
        return 2 * pi * self.lc

    @property
    def middle(self) -> np.ndarray:
        """Pose in the middle of the box (2,)."""
        return (self.low + self.high) / 2

    @cached_property
    def board(self) -> tuple[float, float]:
        """Ends of the row of sensors [m], half a pitch beyond the last ones."""
        place = np.sort(self.place)
        half = float(np.median(np.diff(place))) / 2
        return float(place[0]) - half, float(place[-1]) + half

    @property
    def whole(self) -> tuple[float, float]:
        """Places between which all of the wave is over the row; the middle of the row where it never is."""
        low, high = self.board[0] + self.length / 2, self.board[1] - self.length / 2
        return (low, high) if low <= high else ((low + high) / 2,) * 2

    @cached_property
    def harmonics(self) -> tuple[int, ...]:
        """Those that count, beyond the first."""
        size = np.abs(self.factor).max(axis=0)
        half = (self.high[1] - self.low[1]) / 2 / self.lc
        share = size / size[0] * np.exp(half * np.arange(HARMONICS))
        return tuple(n for n in range(2, HARMONICS + 1) if share[n - 1] > COUNTS * MICRON / self.lc)

    @property
    def plain(self) -> Phasor:
        """The first harmonic alone, of which functions are bounded."""
        n = len(self.place)
        return Phasor(
            self.lc, self.rising, float(self.middle[1]), np.zeros(n), self.factor[:, :1], np.zeros((2, n)), ()
        )

    # -- the model itself ------------------------------------------------------------------------------------

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.reading)

    @cached_property
    def _decoded(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.decoded)

    def readings(self, pose: np.ndarray) -> np.ndarray:
        """Return readings (n, s) at poses (2, s)."""
        return np.asarray(self._run(self.p, np.zeros(len(self.model.zeros)), list(pose), [])[0])

    def exact(self, readings: np.ndarray) -> np.ndarray:
        """Return the poses (2, s) of weighted least squares over all channels: the reference decoder."""
        zeros, parts = np.zeros(len(self.model.zeros)), []
        with np.errstate(all="ignore"):
            for first in range(0, readings.shape[1], BATCH):
                part = list(np.asarray(readings[:, first : first + BATCH], dtype=float))
                parts.append(self._decoded(self.p, zeros, part, [], self.weight)[0])
        return np.hstack(parts)

    def poses(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random poses of the box, corners among them."""
        share = rng.random((2, count))
        share[:, : count // 20] = np.round(share[:, : count // 20])
        return np.asarray(self.low[:, None] + (self.high - self.low)[:, None] * share)

    # -- the decoder -----------------------------------------------------------------------------------------

    def decoded(self, readings: np.ndarray, rounds: int) -> np.ndarray:
        """Return the poses (2, s) as the generated code computes them, functions exact."""
        r = readings - self.offset[:, None]
        with np.errstate(all="ignore"):
            x = self._next_to(self.first(r), (r * self.factor[:, :1].conj()).sum(axis=0))
            w = self.weights(x)
            rows = np.stack([self.factor[:, 0].real, -self.factor[:, 0].imag])  # 2, n
            normal = np.einsum("ik,jk,ks->sij", rows, rows, w)
            seen = np.einsum("ik,ks,ks->si", rows, w, r)
            inverse = np.linalg.inv(normal + np.eye(2) * (np.linalg.det(normal) < NO_COVER)[:, None, None])
            u = _complex(inverse, seen)
            for _ in range(rounds):
                left = seen.copy()
                for n in self.harmonics:
                    own = self.factor[:, n - 1]
                    power = u**n
                    cross = np.einsum("ik,jk,ks->sij", rows, np.stack([own.real, -own.imag]), w)
                    left -= np.einsum("sij,js->si", cross, np.stack([power.real, power.imag]))
                u = _complex(inverse, left)
            height = self.middle[1] + self.rising * self.lc * np.log(np.abs(u))
        return np.array([self._next_to(x, u), height])

    def first(self, r: np.ndarray) -> np.ndarray:
        """Return the middle (s,) of what sensors read, squared; at the ends of the row of all the wave."""
        energy = r * r
        at = (energy * self.place[:, None]).sum(axis=0) / (energy.sum(axis=0) + TINY)
        low, high = self.whole
        return np.minimum(np.maximum(at, 2 * at - high), 2 * at - low) if low < high else at

    def _next_to(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Place of the phase of u in the period next to x."""
        place = self.lc * np.angle(u)
        return np.asarray(place + self.wavelength * np.floor((x - place) / self.wavelength + 0.5))

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Return the weight (n, s) of each sensor for a wave whose middle is at x: 0 beyond its ends."""
        away = np.abs(self.place[:, None] - x)
        depth = (self.length / 2 - self.margin * self.wavelength - away) / (RAMP * self.wavelength)
        inside = np.clip(depth, 0.0, 1.0)
        return np.asarray(inside * inside * (3 - 2 * inside))


def _complex(inverse: np.ndarray, seen: np.ndarray) -> np.ndarray:
    cos, sin = np.einsum("sij,sj->is", inverse, seen)
    return np.asarray(cos + 1j * sin)


def row_of(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Row:
    """Return the row of sensors of a model. Raises `InputError` where no sensor sees the wave come and go."""
    low, high = np.array([box.ends[c] for c in model.pose]).T
    sample = Sample(model, p, np.array([(low[0] + high[0]) / 2, 0.0]), (low[1], high[1]), 1)
    rough, every = sample.lc(0), range(len(model.channels))
    reach = 1.5 * (high[0] - low[0]) + 2 * 2 * pi * rough
    passed, window, lc = passes(sample, 0, every, reach, rough)
    fitted = [window.fitted(k, lc)[0] for k in every]
    offset, factor = np.array([f[0].real for f in fitted]), np.array([f[1:] for f in fitted])
    return Row(model, p, weight, low, high, lc, sample.rising(0), passed.length, passed.place, offset, factor)
