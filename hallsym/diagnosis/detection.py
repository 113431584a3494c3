"""What a self-test finds: trials, how often an effect of a size is found, and the answer as a whole."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from scipy.special import betaincinv

from hallsym.diagnosis.validation import QUIET
from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import INTERVAL


@dataclass(frozen=True)
class Trial:
    """One injection and what the blind diagnosis said.

    `ratio`: gap over noise floor that was asked for, None where nothing can be scaled; `gap_m`: noise-free
    gap metric that was reached. `size`: parameter -> (value in SI, unit). `imperfection`: the effect that is
    present beside it, too small to report. `outcome`: "found" (named first), "group" (in one group with the
    first), "listed" (named, not first), "other", "unexplained", "no gap", or "refused" (the diagnosis would
    not take the log).
    """

    name: str
    ratio: float | None
    repeat: int
    gap_m: float
    size: dict[str, tuple[float, str]]
    imperfection: str
    outcome: str
    verdict: str
    named: tuple[str, ...]
    seconds: float

    @property
    def found(self) -> bool:
        """Whether the injected effect is named first, or in one group with the first."""
        return self.outcome in ("found", "group")

    @property
    def noticed(self) -> bool:
        """Whether the diagnosis said that there is a gap."""
        return self.verdict not in QUIET


@dataclass(frozen=True)
class CurvePoint:
    """Detection at one size: `ratio`, gap over noise floor, None where nothing can be scaled.

    `found`: share of trials in which the effect was found, with its two-sided 95 % bounds `low` and `high`;
    `noticed`: share in which the diagnosis said that there is a gap.
    """

    ratio: float | None
    trials: int
    found: float
    low: float
    high: float
    noticed: float


def curve_point(ratio: float | None, found: Sequence[bool], noticed: Sequence[bool]) -> CurvePoint:
    """Return how often something was found and noticed in trials; nil of none."""
    n, low_high = len(found), clopper_pearson(sum(found), len(found))
    return CurvePoint(ratio, n, sum(found) / max(n, 1), *low_high, sum(noticed) / max(n, 1))


def clopper_pearson(count: int, trials: int) -> tuple[float, float]:
    """Return the two-sided 95 % bounds of a rate.

    C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404, doi:10.1093/biomet/26.4.404.
    """
    k, n = count, trials
    low = float(betaincinv(k, n - k + 1, 0.5 * (1 - INTERVAL))) if k else 0.0
    return low, float(betaincinv(k + 1, n - k, 0.5 * (1 + INTERVAL))) if k < n else 1.0


@dataclass(frozen=True)
class Findable:
    """The result of the trials of one effect.

    `status`: "found" (from `ratio` on, in 90 % of the trials), "not found", "not testable" (`reason` says
    why) or "not run". `form`: how it was injected. `gap_m` and `size` are those of `ratio`; `confused_with`:
    named beside or instead of it. `curve`: how often it was found at each size.
    """

    name: str
    link: str
    status: str
    reason: str = ""
    form: str = ""
    ratio: float | None = None
    gap_m: float | None = None
    size: dict[str, tuple[float, str]] = field(default_factory=dict)
    confused_with: tuple[str, ...] = ()
    curve: tuple[CurvePoint, ...] = ()
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True)
class SelfTest:
    """The answer of `selftest`. `complete` is False when it was interrupted: `effects` hold what was done.

    `outputs`: names of the pose. `false_alarm_rate`: `found` is the share of logs without an effect in which
    the diagnosis said that there is a gap. Gaps are in m, or in rad where the pose is an angle alone.
    """

    effects: tuple[Findable, ...]
    false_alarms: int
    false_alarm_rate: CurvePoint
    quiet_trials: tuple[Trial, ...]
    floor_m: float
    threshold: float
    ratios: tuple[float, ...]
    repeats: int
    seed: int
    noise: dict[str, Any]
    thinning: str
    rows: int
    model: str
    outputs: tuple[str, ...]
    log: dict[str, Any]
    complete: bool
    notes: tuple[str, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON data."""
        return asdict(self)

    def effect(self, name: str) -> Findable:
        """Return the row of one effect."""
        known = [e.name for e in self.effects]
        if name not in known:
            raise InputError(f"The self-test has no effect {name!r}{nearest(name, known)}.")
        return self.effects[known.index(name)]
