"""Whether a decoded angle was computed with few steps of CORDIC: only certain angles are read then."""

from dataclasses import dataclass
from math import pi

import numpy as np

from hallsym.diagnosis.chance import as_often
from hallsym.families.rotary_cordic import Levels, levels

STEPS = range(4, 15)
"""Steps that are looked for: the error of 4 is 7 deg, that of 14 less than a count of 14 bits."""
TOLERANCE = 0.25
"""How near an angle must be, in distances of neighbouring levels, to be one of them.

It leaves room for a rounding to counts of half that distance; half of all angles would be as near."""
MOSTLY = 0.9
"""Part of the readings' values that must be levels: of equal steps half are, of another number of steps 60 %."""
WORTH, MOST = 0.02, 2.0
"""Mean square of CORDIC's error over that of the residual: what is looked for lies between."""
FINE = 16
"""Offsets of the zero that are tried, per distance of neighbouring levels, at least."""
DIGITS = 1e-9
"""Readings nearer than this [rad] are one value."""
TURN = 2 * pi


@dataclass(frozen=True, eq=False)
class Cordic:
    """Steps of CORDIC that the values of a reading tell.

    `seen`: how many of its angles occur. `p_value`: of as many readings being levels, over all that was tried.
    """

    levels: Levels
    seen: int
    p_value: float

    @property
    def distance(self) -> float:
        """Angle from level to level [rad]."""
        return _distance(self.levels)


def cordic(values: np.ndarray, spread: float, step: float = 0.0) -> Cordic | None:
    """Return the fewest steps of CORDIC that explain the distinct `values` [rad] of an angle, None for none.

    The zero register of a chip may turn all of them by any angle. `spread`: rms of what a model leaves [rad].
    `step`: equal steps between the values where they have them: levels less than two of them apart are not told
    from a rounding, and not looked for.
    """
    v = np.unique(np.round(np.mod(values, TURN) / DIGITS)) * DIGITS
    known = [levels(n) for n in STEPS]
    tried = [
        k
        for k in known
        if WORTH * spread**2 < k.rms**2 < MOST * spread**2
        and MOSTLY * len(v) <= 4 * len(k.angles)  # rounded to counts a level has two at most
        and (step >= 0.9 * _distance(k) or step <= 0.5 * _distance(k))
    ]
    for k in tried:
        near, bins = _hits(v, k)
        p = min(1.0, as_often(near, len(v), _covered(k)) * bins * len(tried))
        if near >= MOSTLY * len(v) and p < 1.0:
            return Cordic(k, len(v), p)
    return None


def _distance(k: Levels) -> float:
    return 2 * float(np.arctan(2.0 ** -(k.steps - 1)))


def _circle(k: Levels) -> np.ndarray:
    """All levels of a turn, ascending from 0."""
    return np.sort(np.mod(np.concatenate([k.angles, k.angles + pi]), TURN))


def _covered(k: Levels) -> float:
    """Part of a turn that is near a level."""
    at = _circle(k)
    gaps = np.diff(at, append=at[0] + TURN)
    return float(np.minimum(gaps, 2 * TOLERANCE * _distance(k)).sum()) / TURN


def _hits(v: np.ndarray, k: Levels) -> tuple[int, int]:
    """Most values that are near a level, over all offsets of the zero, and how many offsets were tried."""
    bins = int(2 ** np.ceil(np.log2(FINE * TURN / _distance(k))))
    width, at, reach = TURN / bins, _circle(k), TOLERANCE * _distance(k)
    centres = (np.arange(bins) + 0.5) * width
    comb = (_apart(centres, at) <= reach).astype(float)
    held = np.bincount((v / width).astype(int) % bins, minlength=bins).astype(float)
    counts = np.fft.irfft(np.fft.rfft(held) * np.conj(np.fft.rfft(comb)), bins)
    best = float(np.argmax(counts)) * width
    near = _apart(np.mod(v - best, TURN), at) <= reach
    return int(near.sum()), bins


def _apart(angles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Distance of each angle within a turn from the nearest of `at`."""
    round_ = np.concatenate([at[-1:] - TURN, at, at[:1] + TURN])
    after = np.searchsorted(round_, angles)
    after = np.clip(after, 1, len(round_) - 1)
    return np.minimum(np.abs(round_[after] - angles), np.abs(angles - round_[after - 1]))
