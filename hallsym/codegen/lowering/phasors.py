"""Channels that read one decaying wave, as a phasor: found from the model's own readings.

The field of a periodic array at the place x along it, h towards it, with lc = wavelength / 2 pi, is

    reading_k = offset_k + Re sum_n c_kn u^n,   u = exp((h - middle) / lc + i x / lc)

because the n-th harmonic decays n times as fast: u^n holds both. Gain, offset, place and tilt of a channel
are in its own c_kn, whatever the parameters of the model are called, so every effect that keeps this form
follows. Weighted least squares turn readings into u + g(u), g the share of the higher harmonics; u is its
fixed point.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

HARMONICS = 12
"""Harmonics of the first that are looked for; Maguire's arrays have 1, 5, 9."""
PLACES, HEIGHTS = 48, 5
"""Samples of a period and of the range of heights: enough for `HARMONICS` and their decay."""
SETTLED = 1e-13
"""Relative change of the wavelength below which its iteration ends."""
ROUNDS = 30
LOST = 1e-12
"""Share of the largest reading below which a harmonic is rounding of the analysis."""
FORM = 1e-9
"""Share of the largest reading that a model of this form may leave."""


@dataclass(frozen=True, eq=False)
class Phasor:
    """Channels that read one wave at parameters `p`, linear in the powers of `u`.

    `offset` (n,) and `factor` (n, HARMONICS) complex are in the unit of the readings, rows of the latter by
    channel; `weights` (2, n) make cos and sin of u of readings without offset.
    """

    lc: float
    rising: float
    """1 where the field grows with the height, -1 where it falls."""
    middle: float
    """Height [m] at which |u| is 1."""
    offset: np.ndarray
    factor: np.ndarray
    weights: np.ndarray
    harmonics: tuple[int, ...]
    """Harmonics beyond the first that count."""

    @property
    def shift(self) -> np.ndarray:
        """What the weighted offsets take off cos and sin, (2,)."""
        return self.weights @ self.offset

    @cached_property
    def shares(self) -> Mapping[int, np.ndarray]:
        """By harmonic n: E (2, 2), the weighted sums of its readings are E (Re u^n, Im u^n)."""
        return {
            n: self.weights @ np.stack([self.factor[:, n - 1].real, -self.factor[:, n - 1].imag], axis=1)
            for n in self.harmonics
        }

    @cached_property
    def parts(self) -> Mapping[int, tuple[complex, complex]]:
        """By harmonic n: (a, b), the weighted sums of its readings are a u^n + b conj(u^n)."""
        return {
            n: (
                complex(e[0, 0] + e[1, 1], e[1, 0] - e[0, 1]) / 2,
                complex(e[0, 0] - e[1, 1], e[1, 0] + e[0, 1]) / 2,
            )
            for n, e in self.shares.items()
        }

    def summed(self, readings: np.ndarray) -> np.ndarray:
        """Return u + g(u), complex (s,), of readings (n, s)."""
        cos, sin = self.weights @ readings - self.shift[:, None]
        return np.asarray(cos + 1j * sin)

    def higher(self, u: np.ndarray) -> np.ndarray:
        """Return g(u), complex, of phasors."""
        total = np.zeros(np.shape(u), dtype=complex)
        for n, (own, conjugate) in self.parts.items():
            power = u**n
            total = total + own * power + conjugate * power.conj()
        return total

    def solved(self, readings: np.ndarray) -> np.ndarray:
        """Return u, complex (s,), of readings (n, s): not finite where nothing is near."""
        seen = self.summed(readings)
        u, move = seen, np.full(seen.shape, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(ROUNDS * 4):
                new = seen - self.higher(u)
                move, u = np.abs(new - u), new
                if not (move > SETTLED * np.abs(u)).any():
                    break
        return np.asarray(u)

    def pose(self, u: np.ndarray) -> np.ndarray:
        """Return place along and height (2, s) [m] of phasors."""
        with np.errstate(all="ignore"):
            height = self.middle + self.rising * self.lc * np.log(np.abs(u))
        return np.array([self.lc * np.angle(u), height])

    def size(self, height: float) -> float:
        """Return |u| at a height."""
        return float(np.exp(self.rising * (height - self.middle) / self.lc))

    # -- what the higher harmonics can do within |u| <= r ---------------------------------------------------

    def largest(self, r: float) -> float:
        """Return a bound of |g(u)|."""
        return float(sum((abs(a) + abs(b)) * r**n for n, (a, b) in self.parts.items()))

    def slope(self, r: float) -> float:
        """Return a Lipschitz constant of g."""
        return float(sum(n * (abs(a) + abs(b)) * r ** (n - 1) for n, (a, b) in self.parts.items()))

    def bend(self, r: float) -> float:
        """Return a Lipschitz constant of the derivative of g."""
        return float(sum(n * (n - 1) * (abs(a) + abs(b)) * r ** (n - 2) for n, (a, b) in self.parts.items()))


def phasor(
    model: Model, p: np.ndarray, weight: np.ndarray, along: str, height: str, ends: tuple[float, float]
) -> Phasor:
    """Return the phasor of all channels of a model at parameters `p`.

    `along`, `height`: its pose coordinates, others at zero; `ends`: of the heights [m]; `weight`: 1 /
    variance of each reading. Raises `InputError` for a model that is no sum of decaying waves.
    """
    period = model.period.get(along)
    if period is None:
        raise InputError(
            f"C of a decaying wave is generated for a model that says the period of {along}; {model.name} "
            f"says none."
        )
    sample = _Sample(model, p, along, height, ends)
    lc = sample.fitted(period / (2 * pi))
    offset, factor = sample.factors(lc)
    size = np.abs(factor).max(axis=0) * sample.strongest(lc) ** np.arange(1, HARMONICS + 1)
    harmonics = tuple(n for n in range(2, HARMONICS + 1) if size[n - 1] > LOST * size[0])
    matrix = np.stack([factor[:, 0].real, -factor[:, 0].imag], axis=1)
    scaled = matrix.T * weight
    if np.linalg.matrix_rank(matrix, 1e-6 * np.abs(matrix).max()) < 2:
        raise InputError(
            f"Place and height are decoded from sums that see the wave at different places; the "
            f"{len(model.channels)} of "
            f"{model.name} do not tell cosine from sine."
        )
    return Phasor(
        lc, sample.rising, sample.middle, offset, factor, np.linalg.solve(scaled @ matrix, scaled), harmonics
    )


class _Sample:
    """Readings of a model over a period and a range of heights."""

    def __init__(
        self, model: Model, p: np.ndarray, along: str, height: str, ends: tuple[float, float]
    ) -> None:
        self.model, period = model, model.period[along]
        self.x = np.repeat(np.arange(PLACES) * (period / PLACES), HEIGHTS)
        self.z = np.tile(np.linspace(*ends, HEIGHTS), PLACES)
        self.middle = (ends[0] + ends[1]) / 2
        self.half = (ends[1] - ends[0]) / 2
        given = {along: self.x, height: self.z}
        pose = [given.get(c, np.zeros_like(self.x)) for c in model.pose]
        zeros = np.zeros(len(model.zeros))
        self.readings = np.asarray(on_arrays(model.reading)(np.asarray(p, dtype=float), zeros, pose, [])[0])
        swing = self.readings.reshape(len(self.readings), PLACES, HEIGHTS).std(axis=1)
        self.rising = 1.0 if swing[:, -1].sum() > swing[:, 0].sum() else -1.0

    def strongest(self, lc: float) -> float:
        """Largest |u| of the range."""
        return float(np.exp(self.half / lc))

    def _basis(self, lc: float) -> tuple[np.ndarray, np.ndarray]:
        """Powers of u over their largest, (HARMONICS, s) complex, and their derivatives by ln lc."""
        u = ((self.z - self.middle) * self.rising - self.half + 1j * self.x) / lc
        n = np.arange(1, HARMONICS + 1)[:, None]
        powers = np.exp(n * u)
        return powers, -n * u * powers

    def fitted(self, lc: float) -> float:
        """Return lc, by Gauss-Newton steps with the linear coefficients projected out."""
        scale = np.abs(self.readings - self.readings.mean(axis=1, keepdims=True)).max()
        for _ in range(ROUNDS):
            powers, slopes = self._basis(lc)
            design = np.vstack([np.ones_like(self.x), powers.real, -powers.imag]).T
            found, *_ = np.linalg.lstsq(design, self.readings.T, rcond=None)
            rest = self.readings.T - design @ found
            turned = np.vstack([np.zeros_like(self.x), slopes.real, -slopes.imag]).T @ found
            turned = turned - design @ np.linalg.lstsq(design, turned, rcond=None)[0]
            move = float((turned * rest).sum() / max((turned * turned).sum(), 1e-300))
            if np.abs(rest).max() <= 1e-13 * scale or abs(move) < SETTLED:
                break
            lc *= float(np.exp(np.clip(move, -0.1, 0.1)))
        if not np.abs(rest).max() <= FORM * scale:
            raise InputError(
                f"C is generated for sums of waves that decay as they are short; what {self.model.name} with "
                f"{', '.join(self.model.effects) or 'no effect'} reads differs from that by "
                f"{np.abs(rest).max() / scale:.2g} of its swing: generate from a calibration without that "
                f"effect."
            )
        return lc

    def factors(self, lc: float) -> tuple[np.ndarray, np.ndarray]:
        """Return offsets (n,) and factors (n, HARMONICS) of the powers of u."""
        powers, _ = self._basis(lc)
        design = np.vstack([np.ones_like(self.x), powers.real, -powers.imag]).T
        found, *_ = np.linalg.lstsq(design, self.readings.T, rcond=None)
        factor = found[1 : HARMONICS + 1] + 1j * found[HARMONICS + 1 :]
        scale = np.exp(-np.arange(1, HARMONICS + 1) * self.half / lc)
        return found[0], (factor * scale[:, None]).T
