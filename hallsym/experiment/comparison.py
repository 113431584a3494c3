"""A plan beside another campaign: how much smaller in as many runs, as small in how many."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.experiment.study import Outcome, Study
from hallsym.records import named
from hallsym.simulation import Campaign


@dataclass(frozen=True, eq=False)
class Comparison:
    """Another campaign (`name`, `runs`, `seconds` recorded) and plans by the same criterion.

    `other`: what the campaign determines, `planned`: what a plan of as many runs does; None where the
    campaign does not determine the model. `runs_same_value`, `runs_same_std`: how many planned runs reach its
    criterion, and its every standard uncertainty; None where more than its own.
    """

    name: str
    runs: int
    seconds: float
    other: Outcome | None = None
    planned: Outcome | None = None
    runs_same_value: int | None = None
    runs_same_std: int | None = None

    @property
    def factor(self) -> np.ndarray | None:
        """How many times smaller each standard uncertainty of the plan is, (q,); None as for `other`."""
        return self.other.std / self.planned.std if self.other and self.planned else None

    def to_dict(self, names: tuple[str, ...], pose: tuple[str, ...]) -> dict[str, Any]:
        """Return the record for JSON."""
        record: dict[str, Any] = {"name": self.name, "runs": self.runs, "seconds": self.seconds}
        if self.other is None or self.planned is None:
            return record | {"determined": False}
        for outcome, ending in ((self.other, ""), (self.planned, "_as_many")):
            record |= {
                f"value{ending}": outcome.value,
                f"std{ending}": named(names, outcome.std),
                f"position_std{ending}": named(pose, outcome.position),
                f"worst_std{ending}": outcome.worst.std,
            }
        return record | {
            "determined": True,
            "std_factor": named(names, self.factor),
            "runs_same_value": self.runs_same_value,
            "runs_same_std": self.runs_same_std,
        }


def compare(study: Study, campaign: Campaign, name: str) -> Comparison:
    """Compare `campaign`, recorded after what is known already, with plans of the study."""
    information, runs = study.known + study.of(campaign), len(campaign.runs)
    seconds = float(sum(run.duration_s for run in campaign.runs))
    if not study.determined(information):
        return Comparison(name, runs, seconds)
    other = study.outcome(information)

    def as_certain(n: int) -> bool:
        found = study.choose(n).information
        return study.determined(found) and bool(np.all(study.std(found) <= other.std * (1 + 1e-9)))

    return Comparison(
        name,
        runs,
        seconds,
        other,
        study.outcome(study.choose(runs).information),
        _fewest(lambda n: study.choose(n).value >= other.value, runs),
        _fewest(as_certain, runs),
    )


def _fewest(enough: Callable[[int], bool], most: int) -> int | None:
    """Least n up to `most` that is enough, by bisection: more runs tell more."""
    if not enough(most):
        return None
    low, high = 0, most
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
