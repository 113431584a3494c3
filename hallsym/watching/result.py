"""What `watch` returns: each log against its calibration, test by test, and what changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from hallsym.inference import ParameterChange
from hallsym.shown import Shown

BELONGS, CHANGED, NOT_JUDGED = "belongs", "changed", "not judged"
RESIDUAL, TOGETHER = "residual error", "parameters together"
"""Names of the tests that are not of one parameter."""
PARAMETER = "parameter"
"""Kind of the other tests."""


@dataclass(frozen=True)
class WatchTest:
    """One quantity of one log against the calibration.

    `kind`: `RESIDUAL`, `TOGETHER` or `PARAMETER`; `name`: the parameter, or the kind. `score`: distance from
    the calibration in standard deviations of a normal distribution of the same p-value, with the sign of the
    change: one scale for every test. `limit`: score beyond which the log does not belong.
    """

    kind: str
    name: str
    p_value: float
    score: float
    limit: float

    @property
    def two_sided(self) -> bool:
        """Whether a score below minus the limit counts too."""
        return self.kind == PARAMETER

    @property
    def distance(self) -> float:
        """Score over its limit: above 1 the quantity has changed."""
        return (abs(self.score) if self.two_sided else self.score) / self.limit

    @property
    def beyond(self) -> bool:
        """Whether the quantity has changed."""
        return self.distance > 1.0


@dataclass(frozen=True)
class WatchedLog:
    """One log against the calibration.

    `residual`: residual error under the calibration, in multiples of the noise of the calibration;
    `refitted`: the same after a fit of this log; `floor`: of the calibration itself. `errors`: rmse of the
    decoded pose under the calibration, SI. `tests`: what was tested, `changes`: values behind the tests of
    parameters. `not_identified`: parameter -> why this log says nothing of it. `reason`: why a log was not
    judged.
    """

    name: str
    verdict: str
    rows: int = 0
    runs: int = 0
    residual: float | None = None
    refitted: float | None = None
    floor: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    tests: tuple[WatchTest, ...] = ()
    changes: tuple[ParameterChange, ...] = ()
    not_identified: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    reason: str = ""

    @property
    def beyond(self) -> tuple[WatchTest, ...]:
        """The tests that say that the log does not belong."""
        return tuple(test for test in self.tests if test.beyond)

    @property
    def sentence(self) -> str:
        """What is to be said of the log in one line."""
        if self.verdict == NOT_JUDGED:
            return self.reason
        if not self.beyond:
            return f"all {len(self.tests)} tests are inside their limits"
        return "; ".join(self._said(test) for test in self.beyond)

    def _said(self, test: WatchTest) -> str:
        if test.kind == RESIDUAL:
            return (
                f"residual error {self.refitted:.3g} x the noise after a fit of its own,"
                f" {self.floor:.3g} x at the calibration"
            )
        if test.kind == TOGETHER:
            return "the parameters together have moved"
        change = next(c for c in self.changes if c.name == test.name)
        unit = "" if change.unit == "1" else f" {change.unit}"
        return f"{test.name} {change.before:.6g} -> {change.after:.6g}{unit}"


@dataclass(frozen=True, eq=False, repr=False)
class Watch(Shown):
    """What `watch` returns: a control chart of logs in the order in which they were given.

    `false_alarm`: probability that a log which belongs is called changed, over all its tests together.
    """

    calibration: str
    model: str
    false_alarm: float
    logs: tuple[WatchedLog, ...]
    notes: tuple[str, ...] = ()

    @property
    def changed(self) -> tuple[WatchedLog, ...]:
        """The logs that do not belong to the calibration."""
        return tuple(log for log in self.logs if log.verdict == CHANGED)

    @property
    def not_judged(self) -> tuple[WatchedLog, ...]:
        """The logs of which nothing can be said."""
        return tuple(log for log in self.logs if log.verdict == NOT_JUDGED)

    def names(self) -> Sequence[str]:
        """Return what was tested of any log, the residual first."""
        return list(dict.fromkeys(test.name for log in self.logs for test in log.tests))

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym watch --json` prints."""
        return {
            "calibration": self.calibration,
            "model": self.model,
            "false_alarm": self.false_alarm,
            "changed": [log.name for log in self.changed],
            "logs": [
                {
                    **asdict(log),
                    "sentence": log.sentence,
                    "tests": [{**asdict(test), "beyond": test.beyond} for test in log.tests],
                }
                for log in self.logs
            ],
            "notes": list(self.notes),
        }
