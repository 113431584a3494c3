"""The arctangent as encoder chips compute it: CORDIC in vectoring mode, without its rounding."""

from dataclasses import dataclass
from functools import cache
from math import pi

import numpy as np

from hallsym.errors import require

CHIP_STEPS = range(4, 15)
"""Steps that chips take: the error of 4 is 7 deg, that of 14 less than a count of 14 bits."""
MOST_STEPS = 32
"""Most steps: the error of another one is far below the resolution of float64."""


def cordic_angle(y: np.ndarray, x: np.ndarray, steps: int) -> np.ndarray:
    """Return the angle [rad] of (x, y) after `steps` rotations by atan(2^-k), k = 0 .. steps - 1, same shape.

    The vector is rotated into the right half plane first. The error is at most atan(2^-(steps - 1)): for 8
    steps 0.007812 rad, which is 0.4476 deg. Volder, IRE Trans. Electron. Comput. 8 (1959) 330,
    doi:10.1109/TEC.1959.5222693.

    >>> float(np.round(cordic_angle(np.array(1.0), np.array(1.0), 1), 6))
    0.785398
    """
    require(steps >= 1, "Input steps of cordic_angle", "1 or more", steps)
    x, y = np.array(x, dtype=float), np.array(y, dtype=float)
    angle = np.where(x < 0, np.where(y >= 0, np.pi, -np.pi), 0.0)
    flip = np.where(x < 0, -1.0, 1.0)
    x, y = x * flip, y * flip
    for k in range(steps):
        turn, size = np.where(y >= 0, 1.0, -1.0), 2.0**-k
        x, y = x + turn * y * size, y - turn * x * size
        angle = angle + turn * np.arctan(size)
    return angle


def worst_of(steps: int) -> float:
    """Return the largest error of `steps` steps [rad]: the last rotation.

    >>> round(worst_of(8), 6)
    0.007812
    """
    return float(np.arctan(2.0 ** (1 - steps)))


@dataclass(frozen=True, eq=False)
class Levels:
    """Possible results of `steps` steps of CORDIC: `angles` (n,) [rad] in half a turn about 0, ascending.

    The other half turn has the same, half a turn on. `rms` and `worst`: of the error over a turn [rad].
    """

    steps: int
    angles: np.ndarray
    rms: float
    worst: float

    @property
    def distance(self) -> float:
        """Angle from level to level [rad], but where branches overlap."""
        return 2 * self.worst


@cache
def levels(steps: int) -> Levels:
    """Return the angles that `cordic_angle` gives, with its error, followed rotation by rotation.

    Their spacing is 2 atan(2^-(steps - 1)), but where branches overlap, about 2^(steps + 0.7) a turn. The one
    nearest is not always the answer, so the error is 1.26 times that of equal steps as many.

    >>> levels(8).angles.size, round(levels(8).rms, 6)
    (208, 0.004477)
    """
    angle, low, high = np.zeros(1), np.full(1, -pi / 2), np.full(1, pi / 2)
    for k in range(steps):
        turn, up, down = np.arctan(2.0**-k), high > angle, low < angle
        low, high = (
            np.concatenate([np.maximum(low, angle)[up], low[down]]),
            np.concatenate([high[up], np.minimum(high, angle)[down]]),
        )
        angle = np.concatenate([angle[up] + turn, angle[down] - turn])
    mean_square = float(((high - angle) ** 3 - (low - angle) ** 3).sum()) / 3 / pi
    return Levels(steps, np.sort(angle), float(np.sqrt(mean_square)), worst_of(steps))
