"""`plan`: choose the next runs and predict the uncertainties with them."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError, require
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.likelihood import cost_near
from hallsym.estimation.task import noise_of
from hallsym.experiment.criteria import CRITERIA
from hallsym.experiment.ranges import Ranges
from hallsym.experiment.study import Study, Worst, study
from hallsym.families import build, default_model
from hallsym.log import Log, Meta, Noise, check_log, check_noise_keys
from hallsym.model import Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.simulation import Campaign

FORMAT = "hallsym plan 1"


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A plan: the next runs.

    `campaign`: the chosen runs, setting by setting. `counts`: how often each candidate of `study` is run.
    `value`: the criterion of this choice. `before`, `after`: the worst-determined combination without these
    runs (None where nothing was recorded before) and with them. `std`: (q,) standard uncertainty of each of
    `names` afterwards, SI. `position`: (n_pose,) worst standard uncertainty that the parameters leave in the
    decoded position over the ranges, SI. `recorded`: runs of the log that the plan adds to.
    """

    study: Study
    counts: np.ndarray
    value: float
    campaign: Campaign
    before: Worst | None
    after: Worst
    std: np.ndarray
    position: np.ndarray
    recorded: int
    seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Determined parameters and combinations, in the order of `std`."""
        return self.study.names

    @property
    def minutes(self) -> float:
        """Time it takes, with the resets between runs (0 s where none is stated)."""
        resets = (len(self.campaign.runs) - 1) * (self.study.ranges.reset_s or 0.0)
        return (sum(run.duration_s for run in self.campaign.runs) + resets) / 60.0

    def groups(self) -> list[tuple[int, str, str]]:
        """Return `(how often, setting, trajectory)` of each run that is chosen, in the order of recording."""
        found = self.study.candidates
        order = _order(self.study, self.counts)
        return [(int(self.counts[k]), found[k].setting, found[k].trajectory) for k in order]

    def to_dict(self) -> dict[str, Any]:
        """Return the readable record that `hallsym plan --json` prints."""
        model, ranges = self.study.model, self.study.ranges
        return {
            "format": FORMAT,
            "model": model.name,
            "criterion": self.study.criterion.name,
            "runs": len(self.campaign.runs),
            "minutes": self.minutes,
            "candidates": len(self.study.candidates),
            "chosen": [{"count": n, "setting": s, "trajectory": t} for n, s, t in self.groups()],
            "value": self.value,
            "recorded_runs": self.recorded,
            "worst_before": None if self.before is None else vars(self.before),
            "worst": vars(self.after),
            "std": named(self.names, self.std),
            "position_std": named(model.pose, self.position),
            "reference": named(model.pose, ranges.references(model.pose)),
            "values": {n: float(v) for n, v in self.study.values.items()},
            "noise": dict(self.study.noise),
            "seed": self.study.seed,
            "seconds": self.seconds,
        }


def plan(
    ranges: Ranges,
    model: str | Model | None = None,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    *,
    criterion: str = "D",
    runs: int | None = None,
    minutes: float | None = None,
    after: Log | None = None,
    seed: int = 0,
) -> Plan:
    """Choose the runs within `ranges` with the most information about the parameters of `model`.

    `values`: parameter values by name, SI, over the nominal ones: the information of a run depends on them
    (with gain slopes of zero the tied model loses its x0, y0). `noise`: 1 sigma by column; the ranges' own
    where not given. `criterion`: one of `CRITERIA`. `runs`, `minutes`: over those of the ranges. `after`: a
    log that is recorded already, to which the plan adds. `seed`: of the order in which exchanges are tried.

    Raises `InputError` where nothing is admissible, or where the model stays undetermined.
    """
    began = perf_counter()
    require(criterion in CRITERIA, "Criterion", f"one of {', '.join(CRITERIA)}", criterion, CRITERIA)
    model = model if isinstance(model, Model) else build(model or default_model(Meta()))
    allowed = ranges.allowed(runs, minutes)
    sigma = _noise(model, ranges.noise if noise is None else noise)
    recorded, n_recorded = (None, 0) if after is None else _recorded(after, model, model.vector(values or {}))
    found = study(ranges, model, dict(values or {}), sigma, criterion, recorded, seed)
    counts = found.choose(allowed)
    total, order = found.information(counts), _order(found, counts)
    runs_in_order = tuple(found.candidates[k].run for k in order for _ in range(counts[k]))
    return Plan(
        study=found,
        counts=counts,
        value=found.value(total),
        campaign=Campaign(ranges.step_s, runs_in_order, noise=dict(sigma)),
        before=None if after is None else found.worst(found.known),
        after=found.worst(total),
        std=found.std(total),
        position=found.position(total),
        recorded=n_recorded,
        seconds=perf_counter() - began,
    )


def _noise(model: Model, noise: Mapping[str, float]) -> dict[str, float]:
    columns = columns_of(model)
    check_noise_keys(noise, columns, "the plan")
    sigmas = Noise.given(noise, columns).std
    missing = [c for c in (*model.channels, *model.references) if c not in sigmas]
    if missing:
        raise InputError(
            f"Noise of {missing[0]} is not stated; give 1 sigma of every reading and reference in [noise], "
            "in the unit that its name ends with, or plan with a calibration or a log, which tell it."
        )
    return sigmas


def _recorded(log: Log, model: Model, p: np.ndarray) -> tuple[np.ndarray, int]:
    """Information (n, n) of a log that was recorded, holdout runs left out, and its runs."""
    check_log(log, columns_of(model))
    sigma = noise_of(log, model, log.meta.holdout).std
    cost = cost_near(log, model, p, sigma).without(log.meta.holdout)
    return cost.information(p), len(cost.summary.runs)


def _order(found: Study, counts: np.ndarray) -> list[int]:
    """Chosen candidates setting by setting, with the fewest moves of vertical axes."""

    def place(k: int) -> tuple:
        return tuple(found.candidates[k].run.setting.get(axis, 0.0) for axis in found.model.state)

    return sorted(np.flatnonzero(counts).tolist(), key=place)
