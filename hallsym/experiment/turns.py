"""Recordings without a reference: undetermined waves of the heads, turns and speeds for an accuracy."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.estimation.self_calibration import FEW, OPEN_BELOW
from hallsym.shown import Shown

RATIOS = (1.5, 2.0, 3.0)
"""Ratios of two speeds that are compared."""
TURNS = (1, 2, 4, 8, 16, 32)
"""Numbers of turns whose error is stated."""


def two_speeds(ratio: float) -> float:
    """Return the standard error of a wave from two speeds, fast / slow = `ratio`, of variance 1 at each.

    >>> round(two_speeds(2.0), 2)
    1.37
    """
    q = ratio**-2
    return float(np.sqrt(1 + q * q) / (1 - q))


def turns_for(density: np.ndarray, target: float) -> float:
    """Return R = sum S(n) / target^2: turns for a table within `target` rms [rad].

    `density`: (waves,) one-sided S(n) [rad^2 per cycle / turn] of all that is not periodic in the turn; white
    noise sigma at m samples a turn is 2 sigma^2 / m.
    """
    return float(np.sum(density) / target**2)


def table_error(density: np.ndarray, turns: int) -> float:
    """Return the rms error [rad] of a table from some turns; worse by `FEW` from one and two."""
    return float(np.sqrt(np.sum(density) / turns)) * FEW.get(turns, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class TurnPlan(Shown):
    """Undetermined waves of the heads, and turns for an accuracy [rad, mechanical]; None if unknown.

    `density`: as in `turns_for`. `lasting`: (waves,) standard errors [rad] of the table that do not fall with
    the turns: the ripple of the motion as the heads identify it, and what it does to other waves.
    """

    pairs: int
    places: tuple[float, ...]
    seen: np.ndarray
    target: float | None
    density: np.ndarray | None
    lasting: np.ndarray | None = None

    @property
    def open(self) -> tuple[int, ...]:
        """Waves per turn that these heads do not determine in any recording."""
        return tuple(int(n) + 1 for n in np.flatnonzero(self.seen < OPEN_BELOW))

    @property
    def least(self) -> float:
        """The rms error of the table that no number of turns lowers [rad]."""
        return 0.0 if self.lasting is None else float(np.linalg.norm(self.lasting))

    def error(self, turns: int) -> float | None:
        """Return the rms error of a table from some turns [rad]."""
        return None if self.density is None else float(np.hypot(table_error(self.density, turns), self.least))

    @property
    def turns(self) -> int | None:
        """Whole turns for the accuracy, with the loss by one and two turns; None if no number reaches it."""
        if self.density is None or self.target is None or self.target <= self.least:
            return None
        random = float(np.sqrt(self.target**2 - self.least**2))
        least = max(int(np.ceil(turns_for(self.density, random))), 1)
        return next(n for n in range(least, least + 5) if n >= 3 or table_error(self.density, n) <= random)

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `--json`."""
        return {
            "pole_pairs": self.pairs,
            "places_rad": list(self.places),
            "open_waves": list(self.open),
            "seen": self.seen.tolist(),
            "accuracy_rad": self.target,
            "turns": self.turns,
            "least_rad": None if self.density is None else self.least,
            "error_rad": {} if self.density is None else {str(n): self.error(n) for n in TURNS},
            "two_speeds": {f"{r:g}": two_speeds(r) for r in RATIOS},
        }
