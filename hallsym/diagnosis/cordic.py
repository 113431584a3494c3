"""Whether a decoded angle was computed with few steps of CORDIC: only certain angles are read then."""

from dataclasses import dataclass
from math import pi, tau

import numpy as np

from hallsym.diagnosis.p_values import as_often
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.regression import NIL
from hallsym.families.cordic import CHIP_STEPS, Levels, levels

TOLERANCE = 0.25
"""How near a value must be to one of some levels, in distances of neighbouring ones, to be one of them.

It leaves room for a rounding to counts of half that distance; half of all values would be as near."""


@dataclass(frozen=True, eq=False)
class Cordic:
    """Steps of CORDIC that the values of a reading tell; `p_value`: of as many values being levels, over all
    tried."""

    levels: Levels
    p_value: float


def cordic(values: np.ndarray, policy: Policy, spread: float, step: float = 0.0) -> Cordic | None:
    """Return the fewest steps of CORDIC that explain the distinct `values` [rad] of an angle, None for none.

    The zero register of a chip may turn all of them by any angle. `spread`: rms of what a model leaves [rad].
    `step`: equal steps between the values where they have them: levels less than two of them apart are not
    told from a rounding, and not looked for. Nor are levels that equal steps of any size are nearer to: a
    rounding, or a motor that goes from step to step.
    """
    v = np.unique(np.round(np.mod(values, tau) / NIL)) * NIL
    tried = [
        k
        for k in map(levels, CHIP_STEPS)
        if k.rms**2 > policy.negligible * spread**2
        and (1 - policy.minor) * len(v) <= 4 * len(k.angles)  # rounded to counts a level has two at most
        and not 2 * TOLERANCE < step / k.distance < 1 - TOLERANCE
    ]
    for k in tried:
        near, off, bins = _hits(v, k)
        p = min(1.0, as_often(near, len(v), 2 * TOLERANCE) * bins * len(tried))
        if near >= (1 - policy.minor) * len(v) and p < 1.0 and off < _off_even(v, k.distance, bins):
            return Cordic(k, p)
    return None


def _hits(v: np.ndarray, k: Levels) -> tuple[int, float, int]:
    """Values near a level at the best offset, their rms distance [rad], and how many offsets were tried."""
    bins = int(2 ** np.ceil(np.log2(tau / (TOLERANCE**2 * k.distance))))
    width, reach = tau / bins, TOLERANCE * k.distance
    at = np.sort(np.mod(np.concatenate([k.angles, k.angles + pi]), tau))  # all of a turn
    centres = (np.arange(bins) + 0.5) * width
    cost = np.minimum(_apart(centres, at) ** 2, reach**2)
    total = np.fft.irfft(np.fft.rfft(_held(v, bins)) * np.conj(np.fft.rfft(cost)), bins)
    best = float(np.argmin(total)) * width
    for _ in range(2):  # offsets between those tried
        off = _apart(np.mod(v - best, tau), at)
        near = np.abs(off) <= reach
        if not near.any():
            return 0, reach, bins
        best -= float(np.median(off[near]))
    return int(near.sum()), float(np.sqrt(np.mean(off[near] ** 2))), bins


def _off_even(v: np.ndarray, distance: float, bins: int) -> float:
    """Rms distance of the values from the equal steps that suit them best, `distance` or more [rad]."""
    waves = np.arange(bins + 1) / 2  # per turn; the steps need not divide it
    size = np.abs(np.fft.rfft(_held(v, bins), 2 * bins))
    asked = (waves >= 4) & (waves <= tau / ((1 - TOLERANCE) * distance))
    best = float(waves[asked][np.argmax(size[asked])])
    near = best + np.linspace(-0.5, 0.5, 51)
    length = np.abs(np.exp(1j * np.outer(near, v)).mean(axis=1))
    at = int(np.argmax(length))
    return float(np.sqrt(max(-2 * np.log(max(length[at], 1e-300)), 0.0)) / near[at])


def _held(v: np.ndarray, bins: int) -> np.ndarray:
    return np.bincount((v / tau * bins).astype(int) % bins, minlength=bins).astype(float)


def _apart(angles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Signed distance of each angle within a turn from the nearest of `at`."""
    round_ = np.concatenate([at[-1:] - tau, at, at[:1] + tau])
    after = np.clip(np.searchsorted(round_, angles), 1, len(round_) - 1)
    above, below = round_[after] - angles, round_[after - 1] - angles
    return np.where(above < -below, above, below)
