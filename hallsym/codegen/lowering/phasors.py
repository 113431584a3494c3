"""Channels that read one decaying wave, as a phasor: found from the model's own readings.

The field of a periodic array at the place x along it, h towards it, with lc = wavelength / 2 pi, is

    reading_k = offset_k + Re sum_n c_kn u^n,   u = exp((h - middle) / lc + i x / lc)

because the n-th harmonic decays n times as fast: u^n holds both. Gain, offset, place and tilt of a channel
are in its own c_kn, whatever the parameters of the model are called, so every effect that keeps this form
follows. Weighted least squares turn readings into u + g(u), g the share of the higher harmonics; u is its
fixed point.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

HARMONICS = 12
"""Harmonics of the first that are looked for; Maguire's arrays have 1, 5, 9."""
WIDE = 0.05
"""Travel [m] either side over which it is seen what a channel follows, where a model says no period."""
PLACES, HEIGHTS = 48, 5
"""Samples of a period and of the range of heights: enough for `HARMONICS` and their decay."""
SETTLED = 1e-13
"""Relative change of the wavelength below which its iteration ends."""
ROUNDS = 30
LOST = 1e-12
"""Share of the largest reading below which a harmonic is rounding of the analysis."""
LEVELLING = 5
"""Steps to the level pose."""
TURN = 1e-4
"""Rotation [rad] by which slopes and levers are measured."""
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
    columns = list(model.pose)
    sample = Sample(model, p, np.zeros(len(columns)), ends, columns.index(height))
    return phasor_of(sample, range(len(model.channels)), columns.index(along), weight)


class Sample:
    """Readings of a model over places along one coordinate and a range of heights.

    `middle` (n_pose,): the other coordinates; `height`: number of the coordinate that the wave decays along.
    """

    def __init__(
        self, model: Model, p: np.ndarray, middle: np.ndarray, ends: tuple[float, float], height: int = 2
    ) -> None:
        self.model, self.height, self.at = model, height, np.array(middle, dtype=float)
        self.p, self.run = np.asarray(p, dtype=float), on_arrays(model.reading)
        self.middle, self.half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
        self.z = np.tile(np.linspace(*ends, HEIGHTS), PLACES)
        self.known: dict[int, float] = {}

    def readings(self, axis: int, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Return readings (n_channels, s) at places `x` (s,) and the heights, moved by `move` (n_pose,)."""
        pose = np.tile((self.at + move)[:, None], len(x))
        pose[axis] += x
        pose[self.height] = self.z + move[self.height]
        return np.asarray(self.run(self.p, np.zeros(len(self.model.offsets)), list(pose), [])[0])

    def lc(self, axis: int) -> float:
        """Return the wavelength over 2 pi along a coordinate as far as the model says it, or the decay
        does."""
        column = self.model.pose[axis]
        if column in self.model.period:
            return self.model.period[column] / (2 * pi)
        if axis not in self.known:
            x = np.repeat(np.random.default_rng(0).uniform(-1, 1, PLACES) * WIDE, HEIGHTS)
            seen = self.readings(axis, x, np.zeros(len(self.at))).reshape(-1, PLACES, HEIGHTS)
            low, *_, high = seen.std(axis=1)[seen.std(axis=(1, 2)).argmax()]
            self.known[axis] = 2 * self.half / max(abs(float(np.log(high / low))), 1e-9)
        return self.known[axis]

    def axes(self) -> np.ndarray:
        """Return for each channel which of the first two coordinates it follows more."""
        x = np.repeat(np.random.default_rng(0).uniform(-1, 1, PLACES) * WIDE, HEIGHTS)
        swings = []
        for axis in (0, 1):
            seen = self.readings(axis, x, np.zeros(len(self.at))).reshape(-1, PLACES, HEIGHTS)
            swings.append(seen.std(axis=1).mean(axis=1))
        return np.asarray(np.argmax(swings, axis=0))

    def levelled(self, turns: Sequence[int]) -> "Sample":
        """Turn the middle to where waves are periodic: the mover level, whatever its reference says.

        Gauss-Newton steps on what the form leaves, of the coordinates `turns`.
        """
        axes = self.axes()
        owns = [(a, np.flatnonzero(axes == a)) for a in (0, 1) if (axes == a).any()]

        def left(move: np.ndarray) -> np.ndarray:
            out = []
            for axis, own in owns:
                self.analysed(own.tolist(), axis, move)
                out.append(self.rest.ravel())
            return np.concatenate(out)

        for _ in range(LEVELLING):
            at = left(np.zeros(len(self.at)))
            if np.abs(at).max() < FORM:
                break
            moves = TURN * np.eye(len(self.at))[list(turns)]
            slopes = np.array([(left(move) - at) / TURN for move in moves]).T
            self.at[list(turns)] -= np.linalg.lstsq(slopes, at, rcond=None)[0]
        return self

    def rising(self, axis: int) -> float:
        """1 where the field grows with the height, -1 where it falls."""
        x = np.repeat(np.arange(PLACES) * (2 * pi * self.lc(axis) / PLACES), HEIGHTS)
        seen = self.readings(axis, x, np.zeros(len(self.at)))
        swing = seen.reshape(-1, PLACES, HEIGHTS).std(axis=1).sum(axis=0)
        return 1.0 if swing[-1] > swing[0] else -1.0

    def analysed(
        self, channels: Sequence[int], axis: int, move: np.ndarray, exact: bool = False
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Return lc, offsets (n,) and factors (n, HARMONICS) of the powers of u, the pose moved by `move`.

        `exact`: refuse readings that have another form.
        """
        lc, rising = self.lc(axis), self.rising(axis)
        x = np.repeat(np.arange(PLACES) * (2 * pi * lc / PLACES), HEIGHTS)
        seen = self.readings(axis, x, move)[list(channels)]
        u = (self.z - self.middle) * rising - self.half + 1j * x
        scale = np.abs(seen - seen.mean(axis=1, keepdims=True)).max()
        for _ in range(ROUNDS):
            design, slopes = _basis(u, lc)
            found, *_ = np.linalg.lstsq(design, seen.T, rcond=None)
            rest = seen.T - design @ found
            turned = slopes @ found
            turned = turned - design @ np.linalg.lstsq(design, turned, rcond=None)[0]
            move_lc = float((turned * rest).sum() / max((turned * turned).sum(), 1e-300))
            if np.abs(rest).max() <= 1e-13 * scale or abs(move_lc) < SETTLED:
                break
            lc *= float(np.exp(np.clip(move_lc, -0.1, 0.1)))
        self.rest = rest / scale
        if exact and not np.abs(rest).max() <= FORM * scale:
            raise InputError(
                f"C is generated for sums of waves that decay as they are short; what {self.model.name} with "
                f"{', '.join(self.model.effects) or 'no effect'} reads differs from that by "
                f"{np.abs(rest).max() / scale:.2g} of its swing: generate from a calibration without that "
                "effect."
            )
        factor = found[1 : HARMONICS + 1] + 1j * found[HARMONICS + 1 :]
        shrink = np.exp(-np.arange(1, HARMONICS + 1) * self.half / lc)
        return lc, found[0], (factor * shrink[:, None]).T


def _basis(u: np.ndarray, lc: float) -> tuple[np.ndarray, np.ndarray]:
    """1 and powers of exp(u / lc), (s, 2 HARMONICS + 1), and their derivatives by ln lc."""
    n = np.arange(1, HARMONICS + 1)[:, None]
    powers = np.exp(n * u / lc)
    slopes = -n * u / lc * powers
    one = np.ones_like(u.real)
    return np.vstack([one, powers.real, -powers.imag]).T, np.vstack([0 * one, slopes.real, -slopes.imag]).T


def phasor_of(
    sample: Sample, channels: Sequence[int], axis: int, weight: np.ndarray, exact: bool = True
) -> Phasor:
    """Return the phasor of some channels along a coordinate; `weight`: 1 / variance of all readings.

    `exact`: refuse readings that have another form.
    """
    model = sample.model
    lc, offset, factor = sample.analysed(channels, axis, np.zeros(len(sample.at)), exact=exact)
    strongest = np.exp(sample.half / lc) ** np.arange(1, HARMONICS + 1)
    size = np.abs(factor).max(axis=0) * strongest
    lost = max(LOST, 10 * float(np.abs(sample.rest).max()))
    harmonics = tuple(n for n in range(2, HARMONICS + 1) if size[n - 1] > lost * size[0])
    matrix = np.stack([factor[:, 0].real, -factor[:, 0].imag], axis=1)
    scaled = matrix.T * weight[list(channels)]
    if np.linalg.matrix_rank(matrix, 1e-6 * np.abs(matrix).max()) < 2:
        raise InputError(
            f"Place and height are decoded from sums that see the wave at different places; the "
            f"{len(channels)} of {model.name} do not tell cosine from sine."
        )
    weights = np.linalg.solve(scaled @ matrix, scaled)
    return Phasor(lc, sample.rising(axis), sample.middle, offset, factor, weights, harmonics)
