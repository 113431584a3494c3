"""Channels that read one decaying wave, as a phasor: found from the model's own readings.

The field of a periodic array at the place x along it, h towards it, with lc = wavelength / 2 pi, is

    reading_k = offset_k + Re sum_n c_kn u^n,   u = exp((h - middle) / lc + i x / lc)

because the n-th harmonic decays n times as fast: u^n holds both. Gain, offset, place and tilt of a channel
are in its own c_kn, whatever the parameters of the model are called, so every effect that keeps this form
follows. Weighted least squares turn readings into u + g(u), g the share of the higher harmonics; u is its
fixed point.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import perm, pi

import casadi as ca
import numpy as np
from scipy.sparse.csgraph import connected_components

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
LEVELLING = 4
"""Steps to the level pose: each squares what it is off by."""
LEVEL = 1e-12
"""Rotation [rad] that is rounding of the analysis."""
LOOKED_AT = 3
"""Channels that a wavelength is fitted to."""
SPACING = 1.0
"""Wavelengths that two arrays are at least apart on the board."""
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

    def design(self, n: int = 1) -> np.ndarray:
        """Return what each channel reads of the real and imaginary part of u^n, (2, n_channels)."""
        own = self.factor[:, n - 1]
        return np.stack([own.real, -own.imag])

    @property
    def shift(self) -> np.ndarray:
        """What the weighted offsets take off cos and sin, (2,)."""
        return self.weights @ self.offset

    @cached_property
    def shares(self) -> Mapping[int, np.ndarray]:
        """By harmonic n: E (2, 2), the weighted sums of its readings are E (Re u^n, Im u^n)."""
        return {n: self.weights @ self.design(n).T for n in self.harmonics}

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

    def bound(self, r: float, order: int = 0) -> float:
        """Return a bound of |g(u)|, or of its derivative of an order."""
        return float(
            sum(perm(n, order) * (abs(a) + abs(b)) * r ** (n - order) for n, (a, b) in self.parts.items())
        )


def phasor(
    model: Model, p: np.ndarray, weight: np.ndarray, along: str, height: str, ends: tuple[float, float]
) -> Phasor:
    """Return the phasor of all channels of a model at parameters `p`.

    `along`, `height`: its pose coordinates, others at zero; `ends`: of the heights [m]; `weight`: 1 /
    variance of each reading. Raises `InputError` for a model that is no sum of decaying waves.
    """
    columns = list(model.pose)
    sample = Sample(model, p, np.zeros(len(columns)), ends, columns.index(height))
    window = Window.of_period(sample, columns.index(along), range(len(model.channels)))
    return phasor_of(window, range(len(model.channels)), weight, exact=not model.nearly)


class Sample:
    """Readings of a model about a pose, `at` (n_pose,), over places along a coordinate and heights.

    `ends`: of the heights [m]; `height`: number of the coordinate that waves decay along.
    """

    def __init__(
        self, model: Model, p: np.ndarray, middle: np.ndarray, ends: tuple[float, float], height: int = 2
    ) -> None:
        self.model, self.height, self.at = model, height, np.array(middle, dtype=float)
        self.p = np.asarray(p, dtype=float)
        self.middle, self.half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
        self.z = np.linspace(*ends, HEIGHTS)
        self.known: dict[int, float] = {}

    def poses(self, axis: int, x: np.ndarray, z: np.ndarray, move: np.ndarray | None = None) -> np.ndarray:
        """Return poses (n_pose, s) at displacements `x` and heights `z` (s,), moved by `move` (n_pose,)."""
        pose = np.tile(self.at[:, None], len(x))
        pose[axis] += x
        pose[self.height] = z
        return np.asarray(pose if move is None else pose + move[:, None])

    def readings(self, axis: int, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return readings (n_channels, s) there."""
        return self.model.readings(self.p, self.poses(axis, x, z))

    def swings(self, axis: int, x: np.ndarray) -> np.ndarray:
        """Return by how much each channel varies over places at each height, (n_channels, HEIGHTS)."""
        seen = self.readings(axis, np.repeat(x, HEIGHTS), np.tile(self.z, len(x)))
        return np.asarray(seen.reshape(-1, len(x), HEIGHTS).std(axis=1))

    def lc(self, axis: int) -> float:
        """Return the wavelength over 2 pi along a coordinate as far as the model says it, or the decay
        does."""
        column = self.model.pose[axis]
        if column in self.model.period:
            return self.model.period[column] / (2 * pi)
        if axis not in self.known:
            swings = self.swings(axis, np.random.default_rng(0).uniform(-1, 1, PLACES) * WIDE)
            low, *_, high = swings[swings.sum(axis=1).argmax()]
            self.known[axis] = 2 * self.half / max(abs(float(np.log(high / low))), 1e-9)
        return self.known[axis]

    def rising(self, axis: int) -> float:
        """1 where the field grows with the height, -1 where it falls."""
        low, *_, high = self.swings(axis, period_of(self.lc(axis))).sum(axis=0)
        return 1.0 if high > low else -1.0

    def followed(self, half: np.ndarray) -> dict[int, list[int]]:
        """Return the channels that follow each of the first two coordinates, seen beyond a box of `half`."""
        swings = []
        for axis in (0, 1):
            reach = half[axis] + 4 * pi * self.lc(axis) + WIDE
            x = np.random.default_rng(0).uniform(-1, 1, 8 * PLACES) * reach
            swings.append(self.swings(axis, x).mean(axis=1))
        follows = np.argmax(swings, axis=0)
        return {axis: np.flatnonzero(follows == axis).tolist() for axis in (0, 1) if (follows == axis).any()}


def period_of(lc: float) -> np.ndarray:
    """Return places over a period (PLACES,)."""
    return np.arange(PLACES) * (2 * pi * lc / PLACES)


class Window:
    """What channels read along a coordinate, as an offset and powers of u.

    `x`: displacements [m], from `place` (n,) of each channel, at every height; `rough`: about the wavelength
    over 2 pi, which is found. `length`: of the wave that they are under.
    """

    def __init__(
        self, sample: Sample, axis: int, channels: Sequence[int], x: np.ndarray, place: np.ndarray,
        rough: float, length: float = np.inf,
    ) -> None:  # fmt: skip
        self.sample, self.axis, self.own = sample, axis, list(channels)
        self.place, self.length, self.lc = place, length, rough
        pose = ca.SX.sym("pose", len(sample.at))
        read = ca.vertsplit(sample.model.reading(sample.p, np.zeros(len(sample.model.offsets)), pose, []))
        self.read = [on_arrays(ca.Function("reading", [pose], [read[k]])) for k in channels]
        self.x, self.z = np.repeat(x, HEIGHTS), np.tile(sample.z, len(x))
        some = np.unique(np.linspace(0, len(place) - 1, LOOKED_AT).astype(int))
        self.lc = self.fitted(some.tolist(), settle=True)[0]

    @classmethod
    def of_period(cls, sample: Sample, axis: int, channels: Sequence[int]) -> "Window":
        """Return the window of waves that do not end: a period from the middle on, or about it where they
        are waves nearly."""
        lc = sample.lc(axis)
        x = period_of(lc) - (pi * lc if sample.model.nearly else 0.0)
        return cls(sample, axis, channels, x, np.zeros(len(channels)), lc)

    def fitted(
        self, some: Sequence[int] | None = None, move: np.ndarray | None = None, settle: bool = False
    ) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Return lc, offsets (n,), factors (n, HARMONICS) of the powers of u from each place, and what is
        left (s, n) of the largest reading; of `some` channels, the pose moved by `move` (n_pose,).

        `settle`: with the wavelength that leaves least.
        """
        sample, half, lc = self.sample, self.sample.half, self.lc
        seen = np.array([
            self.read[k](list(sample.poses(self.axis, self.x + self.place[k], self.z, move)))[0][0]
            for k in (range(len(self.own)) if some is None else some)
        ])  # fmt: skip
        u = (self.z - sample.middle) * sample.rising(self.axis) - half + 1j * self.x
        scale = np.abs(seen - seen.mean(axis=1, keepdims=True)).max()
        for _ in range(ROUNDS):
            design, slopes = _basis(u, lc)
            found, *_ = np.linalg.lstsq(design, seen.T, rcond=None)
            rest = seen.T - design @ found
            if not settle:
                break
            rotation = slopes @ found
            rotation = rotation - design @ np.linalg.lstsq(design, rotation, rcond=None)[0]
            move_lc = float((rotation * rest).sum() / max((rotation * rotation).sum(), 1e-300))
            if np.abs(rest).max() <= 1e-13 * scale or abs(move_lc) < SETTLED:
                break
            lc *= float(np.exp(np.clip(move_lc, -0.1, 0.1)))
        factor = found[1 : HARMONICS + 1] + 1j * found[HARMONICS + 1 :]
        shrink = np.exp(-np.arange(1, HARMONICS + 1) * half / lc)
        return lc, found[0], (factor * shrink[:, None]).T, rest / scale

    def slopes(self, k: int, step: float) -> np.ndarray:
        """What a coordinate moves height (real) and place (imaginary part) of each channel by, (n,)."""
        move = step * np.eye(len(self.sample.at))[k]
        up, down = (self.fitted(move=by)[2][:, 0] for by in (move, -move))
        return np.asarray(self.lc * np.log(up / down) / (2 * step))

    def off_level(self) -> np.ndarray:
        """Rotations (3,) by which the mover is off level, as a step across the array says; NaN of the other.

        A rigid body turned about x and y by small angles: a step across lifts it, turned about z moves it.
        """
        out = np.full(3, np.nan)
        across, sign = self.slopes(1 - self.axis, pi / 2 * self.lc).mean(), 1.0 if self.axis == 0 else -1.0
        out[self.axis] = -sign * self.sample.rising(self.axis) * across.real
        out[2] = sign * across.imag
        return out

    def arrays(self) -> list[tuple[list[int], np.ndarray]]:
        """Return the numbers of the channels of each array, and its lever: what rotations move its height and
        place by, complex (3,) or (0,) [m / rad]."""
        turns = range(3, len(self.sample.at))
        levers = np.array([self.slopes(k, TURN) for k in turns]).reshape(len(turns), len(self.own))
        spread = np.concatenate([levers.real, levers.imag]).T
        near = np.abs(spread[:, None] - spread).max(axis=2, initial=0.0) < SPACING * 2 * pi * self.lc
        count, kind = connected_components(near, directed=False)
        found = [np.flatnonzero(kind == k).tolist() for k in range(count)]
        return [(members, levers[:, members].mean(axis=1)) for members in found]


def levelled(
    sample: Sample, half: np.ndarray, window: Callable[[Sample, int, list[int]], Window]
) -> list[Window]:
    """Return the windows of the channels of each axis, the pose of a mover turned to where it is level.

    `half` of the box (n_pose,), beyond which it is seen what channels follow.
    """
    if len(sample.at) <= sample.height + 1:
        return [window(sample, 0, list(range(len(sample.model.channels))))]
    axes = sample.followed(half)
    windows = [window(sample, axis, own) for axis, own in axes.items()]
    for _ in range(LEVELLING):
        each = np.array([w.off_level() for w in windows])
        off = np.nansum(each, axis=0) / np.maximum(np.isfinite(each).sum(axis=0), 1)
        if np.abs(off).max() < LEVEL:
            break
        sample.at[3:] -= off
    return [window(sample, axis, own) for axis, own in axes.items()]


def _basis(u: np.ndarray, lc: float) -> tuple[np.ndarray, np.ndarray]:
    """1 and powers of exp(u / lc), (s, 2 HARMONICS + 1), and their derivatives by ln lc."""
    n = np.arange(1, HARMONICS + 1)[:, None]
    powers = np.exp(n * u / lc)
    slopes = -n * u / lc * powers
    one = np.ones_like(u.real)
    return np.vstack([one, powers.real, -powers.imag]).T, np.vstack([0 * one, slopes.real, -slopes.imag]).T


def phasor_of(window: Window, members: Sequence[int], weight: np.ndarray, exact: bool = True) -> Phasor:
    """Return the phasor of some channels of a window; `weight`: 1 / variance of all readings.

    `exact`: refuse readings that have another form.
    """
    sample, model, channels = window.sample, window.sample.model, [window.own[k] for k in members]
    lc, offset, factor, rest = window.fitted(members, settle=True)
    left = float(np.abs(rest).max())
    if exact and not left <= FORM:
        raise InputError(
            f"C is generated for sums of waves that decay as they are short; what {model.name} with "
            f"{', '.join(model.effects) or 'no effect'} reads differs from that by {left:.2g} of its swing: "
            "generate from a calibration without that effect."
        )
    strongest = np.exp(sample.half / lc) ** np.arange(1, HARMONICS + 1)
    size = np.abs(factor).max(axis=0) * strongest
    # harmonics of a wave with ends stand out of the rest
    lost = max(LOST, left if model.nearly else 10 * left)
    harmonics = tuple(n for n in range(2, HARMONICS + 1) if size[n - 1] > lost * size[0])
    matrix = np.stack([factor[:, 0].real, -factor[:, 0].imag], axis=1)
    scaled = matrix.T * weight[channels]
    if np.linalg.matrix_rank(matrix, 1e-6 * np.abs(matrix).max()) < 2:
        raise InputError(
            f"Place and height are decoded from sums that see the wave at different places; the "
            f"{len(channels)} of {model.name} do not tell cosine from sine."
        )
    weights = np.linalg.solve(scaled @ matrix, scaled)
    return Phasor(lc, sample.rising(window.axis), sample.middle, offset, factor, weights, harmonics)
