"""Recordings without a reference: undetermined waves of the heads, turns and speeds for an accuracy."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.estimation.self_calibration import FEW, OPEN_BELOW

RATIOS = (1.5, 2.0, 3.0)
"""Ratios of two speeds that are compared."""


def two_speeds(v_slow: float, v_fast: float, ratio: float) -> float:
    """Return the standard error of a wave from two speeds, fast / slow = `ratio`, of variances at each.

    >>> round(two_speeds(1.0, 1.0, 2.0), 2)
    1.37
    """
    q = ratio**-2
    return float(np.sqrt(v_fast + q * q * v_slow) / (1 - q))


def turns_for(density: np.ndarray, target: float) -> float:
    """Return R = sum S(n) / target^2: turns for a table within `target` rms [rad].

    `density`: (waves,) one-sided S(n) [rad^2 per cycle / turn] of all that is not periodic in the turn; white
    noise sigma at m samples a turn is 2 sigma^2 / m.
    """
    return float(np.sum(density) / target**2)


def table_error(density: np.ndarray, turns: int) -> float:
    """Return the rms error [rad] of a table from some turns; worse by `FEW` from one and two."""
    return float(np.sqrt(np.sum(density) / turns)) * FEW.get(turns, 1.0)


@dataclass(frozen=True, eq=False)
class TurnPlan:
    """Undetermined waves of the heads, and turns for an accuracy [rad, mechanical]; None if unknown."""

    pairs: int
    places: tuple[float, ...]
    seen: np.ndarray
    target: float | None
    density: np.ndarray | None

    @property
    def open(self) -> tuple[int, ...]:
        """Waves per turn that these heads do not determine in any recording."""
        return tuple(int(n) + 1 for n in np.flatnonzero(self.seen < OPEN_BELOW))

    @property
    def turns(self) -> int | None:
        """Whole turns for the accuracy, with the loss by one and two turns."""
        if self.density is None or self.target is None:
            return None
        least = max(int(np.ceil(turns_for(self.density, self.target))), 1)
        return next(
            n for n in range(least, least + 5) if n >= 3 or table_error(self.density, n) <= self.target
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `--json`."""
        return {
            "pole_pairs": self.pairs,
            "places_rad": list(self.places),
            "open_waves": list(self.open),
            "seen": self.seen.tolist(),
            "accuracy_rad": self.target,
            "turns": self.turns,
            "error_rad": {str(n): table_error(self.density, n) for n in (1, 2, 4, 8, 16, 32)}
            if self.density is not None
            else {},
            "two_speeds": {f"{r:g}": two_speeds(1.0, 1.0, r) for r in RATIOS},
        }
