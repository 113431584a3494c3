"""How often something was found in so many trials, with the bounds of Clopper and Pearson.

C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404, doi:10.1093/biomet/26.4.404.
"""

from dataclasses import dataclass

from scipy.special import betaincinv

from hallsym.estimation.calibration import INTERVAL

REPEATS = 20
"""Trials of each size: if all find it, it is found in at least 83 % (two-sided 95 %)."""
FIRST_LOOK_S = 100.0
"""Seconds of a first look; a trial begins only if it can be expected to end in them."""
FOUND = 0.9
"""Share of trials, at a size and all larger ones, from which on an effect counts as found there.

A choice: 18 of 20, which is at least 68 % (two-sided 95 %)."""


@dataclass(frozen=True)
class Rate:
    """A share of trials, with its two-sided 95 % bounds."""

    count: int
    trials: int

    @property
    def share(self) -> float:
        """The share that was seen."""
        return self.count / self.trials if self.trials else 0.0

    @property
    def low(self) -> float:
        """Lower bound."""
        k, n = self.count, self.trials
        return float(betaincinv(k, n - k + 1, 0.5 * (1 - INTERVAL))) if k else 0.0

    @property
    def high(self) -> float:
        """Upper bound."""
        k, n = self.count, self.trials
        return float(betaincinv(k + 1, n - k, 0.5 * (1 + INTERVAL))) if k < n else 1.0


@dataclass(frozen=True)
class CurvePoint:
    """Detection at one size: `ratio`, gap over noise floor, None where nothing can be scaled.

    `found`: share of trials in which the effect was named first or in one group with the first, with bounds
    `low` and `high`; `noticed`: share in which the diagnosis said that there is a gap.
    """

    ratio: float | None
    trials: int
    found: float
    low: float
    high: float
    noticed: float


def curve_point(ratio: float | None, found: int, noticed: int, trials: int) -> CurvePoint:
    """Return a point of a detection curve from counts."""
    rate = Rate(found, trials)
    return CurvePoint(ratio, trials, rate.share, rate.low, rate.high, noticed / trials if trials else 0.0)
