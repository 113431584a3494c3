"""A plan beside another campaign: how much smaller in as many runs, as small in how many."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.experiment.study import Study
from hallsym.records import named
from hallsym.simulation import Campaign


@dataclass(frozen=True, eq=False)
class Comparison:
    """Another campaign (`name`, `runs`, `seconds` recorded) and plans by the same criterion.

    `determined`: whether it determines the model; nothing below is known if not. `value`, `value_as_many`:
    the criterion, and that of a plan of as many runs. `std`, `std_as_many`: (q,) standard uncertainties.
    `position`, `position_as_many`: (n_pose,) worst over the workspace. `worst`, `worst_as_many`: of the
    worst-determined combination, share of bound width. `runs_same_value`, `runs_same_std`: how many planned
    runs reach its criterion, and its every standard uncertainty; None where more than its own.
    """

    name: str
    runs: int
    seconds: float
    determined: bool
    value: float
    value_as_many: float
    std: np.ndarray
    std_as_many: np.ndarray
    position: np.ndarray
    position_as_many: np.ndarray
    worst: float | None
    worst_as_many: float | None
    runs_same_value: int | None
    runs_same_std: int | None

    @property
    def factor(self) -> np.ndarray:
        """How many times smaller each standard uncertainty is in as many runs, (q,)."""
        return self.std / self.std_as_many

    def to_dict(self, names: tuple[str, ...], pose: tuple[str, ...]) -> dict[str, Any]:
        """Return the record for JSON."""
        if not self.determined:
            return {"name": self.name, "runs": self.runs, "seconds": self.seconds, "determined": False}
        return {
            "name": self.name,
            "runs": self.runs,
            "seconds": self.seconds,
            "determined": True,
            "value": self.value,
            "value_as_many": self.value_as_many,
            "std": named(names, self.std),
            "std_as_many": named(names, self.std_as_many),
            "std_factor": named(names, self.factor),
            "position_std": named(pose, self.position),
            "position_std_as_many": named(pose, self.position_as_many),
            "worst_std": self.worst,
            "worst_std_as_many": self.worst_as_many,
            "runs_same_value": self.runs_same_value,
            "runs_same_std": self.runs_same_std,
        }


def compare(study: Study, campaign: Campaign, name: str) -> Comparison:
    """Compare `campaign`, recorded after what is known already, with plans of the study."""
    other, runs = study.known + study.of(campaign), len(campaign.runs)
    seconds = float(sum(run.duration_s for run in campaign.runs))
    if not study.determined(other):
        nan, q = np.full(len(study.model.pose), np.nan), np.full(len(study.names), np.nan)
        return Comparison(name, runs, seconds, False, 0.0, 0.0, q, q, nan, nan, None, None, None, None)
    value, std = study.value(other), study.std(other)
    many = study.choose(runs).information

    def as_certain(n: int) -> bool:
        information = study.choose(n).information
        return study.determined(information) and bool(np.all(study.std(information) <= std * (1 + 1e-9)))

    return Comparison(
        name=name,
        runs=runs,
        seconds=seconds,
        determined=True,
        value=value,
        value_as_many=study.value(many),
        std=std,
        std_as_many=study.std(many),
        position=study.position(other),
        position_as_many=study.position(many),
        worst=study.directions.worst(other).std,
        worst_as_many=study.directions.worst(many).std,
        runs_same_value=_fewest(lambda n: study.choose(n).value >= value, runs),
        runs_same_std=_fewest(as_certain, runs),
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
