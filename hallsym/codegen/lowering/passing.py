"""Waves of finite length that sensors are passed by: where each sensor is, and what it reads under the wave.

All from the readings of the model itself."""

from collections.abc import Sequence
from math import pi

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from hallsym.codegen.lowering.phasors import HARMONICS, HEIGHTS, Sample
from hallsym.errors import InputError
from hallsym.model.arrays import on_arrays

STEPS = 16
"""Samples per wavelength of what is seen as the wave passes a sensor."""
BEYOND = 0.02
"""Share of the largest energy that a sensor may see where the wave has passed."""
FROM_END = 0.75
"""Wavelengths from the ends of the wave from which on what a sensor reads is fitted."""
WINDOW = 96
"""Places of a sensor under the wave that its reading is fitted to."""
LOOKED_AT = 3
"""Sensors that the wavelength is fitted to."""
OFF = 0.1
"""Share by which a first wavelength, from the decay with the height, may be off."""


class NeverEnds(InputError):
    """The wave does not end within what is looked at of it."""


class Pass:
    """What sensors see as a wave passes them: places, offsets, length of a wave that must end there."""

    def __init__(
        self, sample: Sample, axis: int, channels: Sequence[int], reach: float, wavelength: float
    ) -> None:
        step = wavelength / STEPS
        count = int(reach / step)
        x = step * np.arange(-count, count + 1)
        seen = readings(sample, axis, x + sample.at[axis], np.full(len(x), sample.middle))[list(channels)]
        self.offset = seen[:, [0, -1]].mean(axis=1)
        field = (seen - self.offset[:, None]) ** 2
        pair = STEPS // 8  # an eighth of a wavelength to both sides: squares of a cosine and a sine
        energy = np.zeros_like(field)
        energy[:, pair:-pair] = field[:, : -2 * pair] + field[:, 2 * pair :]
        total = energy.sum(axis=1)
        self.place = (energy * x).sum(axis=1) / total + sample.at[axis]
        level = np.array([e[np.abs(x + sample.at[axis] - at) < wavelength].mean()
                          for e, at in zip(energy, self.place, strict=True)])  # fmt: skip
        ends = energy[:, [pair, -pair - 1]].max(axis=1)
        if not (np.isfinite(self.place).all() and (ends < BEYOND * level).all()):
            raise NeverEnds(
                "C of decaying waves is generated for one coordinate that repeats and one height, or for an "
                f"array shorter than the board; what {sample.model.name} reads does not end where the array "
                "has passed."
            )
        self.length = float(np.median(total * step / level))


class Window:
    """What sensors read while they are well under a wave, as an offset and powers of u."""

    def __init__(
        self, sample: Sample, axis: int, channels: Sequence[int], passed: Pass, wavelength: float
    ) -> None:
        self.sample, self.axis, self.place = sample, axis, passed.place
        reach = max(passed.length / 2 - FROM_END * wavelength, wavelength / 2)
        pose = ca.SX.sym("pose", len(sample.at))
        read = ca.vertsplit(sample.model.reading(sample.p, np.zeros(len(sample.model.offsets)), pose, []))
        self.read = [on_arrays(ca.Function("reading", [pose], [read[k]])) for k in channels]
        self.x = np.repeat(np.linspace(-reach, reach, WINDOW), HEIGHTS)
        self.designs: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self.z = np.tile(sample.z[:HEIGHTS], WINDOW)

    def fitted(self, k: int, lc: float, move: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Return offset and factors (1 + HARMONICS,) of sensor k, of absolute places, and the sum of squares
        left; the pose moved by `move` (n_pose,)."""
        return self._fitted(self._seen(k, move), k, lc)

    def _seen(self, k: int, move: np.ndarray | None = None) -> np.ndarray:
        pose = _poses(self.sample, self.axis, self.x + self.place[k], self.z, move)
        return np.asarray(self.read[k](list(pose))[0])[0]

    def _fitted(self, seen: np.ndarray, k: int, lc: float) -> tuple[np.ndarray, float]:
        if lc not in self.designs:  # what is read of offset and powers of u at places from a sensor's own
            m = np.arange(1, HARMONICS + 1)[:, None]
            high = (self.z - self.sample.middle) * self.sample.rising(self.axis) / lc - self.sample.half / lc
            powers = np.exp(m * (high + 1j * self.x / lc))
            made = np.vstack([np.ones_like(self.x), powers.real, -powers.imag]).T
            self.designs = {lc: (made, np.linalg.pinv(made))}
        design, inverse = self.designs[lc]
        found, n, half = inverse @ seen, np.arange(1, HARMONICS + 1), self.sample.half / lc
        rest = seen - design @ found
        factor = (found[1 : HARMONICS + 1] + 1j * found[HARMONICS + 1 :]) * np.exp(-n * half)
        factor = factor * np.exp(-1j * n * self.place[k] / lc)  # of absolute places
        return np.concatenate([[found[0]], factor]), float(rest @ rest)

    def lc(self, rough: float) -> float:
        """Return the wavelength over 2 pi that leaves least of what some sensors read."""
        some = np.linspace(0, len(self.place) - 1, min(LOOKED_AT, len(self.place))).astype(int)
        seen = {int(k): self._seen(int(k)) for k in some}
        found = minimize_scalar(
            lambda lc: sum(self._fitted(v, k, lc)[1] for k, v in seen.items()),
            bounds=(rough * (1 - OFF), rough * (1 + OFF)), method="bounded", options={"xatol": 1e-9 * rough},
        )  # fmt: skip
        return float(found.x)


def passes(
    sample: Sample, axis: int, channels: Sequence[int], reach: float, rough: float
) -> tuple[Pass, Window, float]:
    """Return what channels see as the wave passes them within `reach` of the middle, and its wavelength over
    2 pi, near `rough`. What is seen of the pass depends little on the wavelength."""
    for _ in range(2):
        passed = Pass(sample, axis, channels, reach, 2 * pi * rough)
        window = Window(sample, axis, channels, passed, 2 * pi * rough)
        rough = window.lc(rough)
    return passed, window, rough


def readings(sample: Sample, axis: int, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return readings (n, s) at places along a coordinate and heights (s,), the rest as in the middle."""
    pose = list(_poses(sample, axis, x, z))
    return np.asarray(sample.run(sample.p, np.zeros(len(sample.model.offsets)), pose, [])[0])


def _poses(
    sample: Sample, axis: int, x: np.ndarray, z: np.ndarray, move: np.ndarray | None = None
) -> np.ndarray:
    pose = np.tile(sample.at[:, None], len(x))
    pose[axis], pose[sample.height] = x, z
    return np.asarray(pose if move is None else pose + move[:, None])
