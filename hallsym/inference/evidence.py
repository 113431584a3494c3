"""Where a report's numbers come from: a fit with its log, or a campaign that is still a plan.

Beside it the recorded workspace, thinned, and what a change of each parameter does to the pose over it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import (
    Cost,
    Determination,
    Fit,
    Uncertainty,
    as_read,
    cost_near,
    determine,
    fit,
    uncertainty,
)
from hallsym.estimation.decoding import columns_of
from hallsym.families import same_layout
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.influence import influence
from hallsym.simulation import Campaign, simulate

SAMPLES = 2000
"""Poses that stand for the workspace of a log."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses that a log visited: `pose` (n_pose, s), `state` (n_state, s), `runs` (s,)."""

    pose: np.ndarray
    state: np.ndarray
    runs: np.ndarray


def visited(
    log: Log,
    model: Model,
    most: int = SAMPLES,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> Workspace:
    """Return about `most` poses of `log`, evenly spread over its samples; one pass over the log.

    `sigma`: noise by column, `values`: parameters by name, for the columns that are computed.
    """
    step = max(1, -(-log.rows // most))
    pose: list[np.ndarray] = []
    state: list[np.ndarray] = []
    runs: list[np.ndarray] = []
    offset = 0
    for batch in batches(extended(log, model, sigma, values), columns_of(model)):
        pick = slice(offset, None, step)
        number = np.repeat([block.run for block in batch.blocks], np.diff(batch.edges))
        runs.append(number[pick])
        pose.append(_rows(batch.columns(model.references), pick, len(runs[-1])))
        state.append(_rows(batch.columns(model.state), pick, len(runs[-1])))
        offset = (offset - len(batch)) % step
    return Workspace(np.hstack(pose), np.hstack(state), np.concatenate(runs))


def _rows(columns: Sequence[np.ndarray], pick: slice, n: int) -> np.ndarray:
    return np.array([c[pick] for c in columns]) if columns else np.zeros((0, n))


@dataclass(frozen=True, eq=False)
class Change:
    """How far the decoded pose moves [unit of each pose column] when something changes: over a workspace."""

    rms: Mapping[str, float]
    worst: Mapping[str, float]

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Return `{x_m: {rms, worst}, ...}`."""
        return {c: {"rms": self.rms[c], "worst": self.worst[c]} for c in self.rms}


@dataclass(frozen=True, eq=False)
class Slopes:
    """d pose / d parameters over a workspace, (s, n_pose, n), the zero deviations held."""

    pose: tuple[str, ...]
    slopes: np.ndarray

    def change(self, step: np.ndarray) -> Change:
        """Return what the parameter step (n,) does to the decoded pose."""
        moved = self.slopes @ step
        return Change(
            dict(zip(self.pose, np.sqrt(np.mean(moved**2, axis=0)).tolist(), strict=True)),
            dict(zip(self.pose, np.abs(moved).max(axis=0).tolist(), strict=True)),
        )

    def spread(self, covariance: np.ndarray) -> Change:
        """Return the standard uncertainty of the decoded pose that a covariance (n, n) leaves."""
        variance = np.einsum("spi,ij,spj->sp", self.slopes, covariance, self.slopes)
        variance = np.maximum(variance, 0.0)
        return Change(
            dict(zip(self.pose, np.sqrt(variance.mean(axis=0)).tolist(), strict=True)),
            dict(zip(self.pose, np.sqrt(variance.max(axis=0)).tolist(), strict=True)),
        )


def slopes_over(workspace: Workspace, cost: Cost, p: np.ndarray) -> Slopes:
    """Return the slopes of the decoded pose with the parameters at every pose of a workspace."""
    model, summary = cost.summary.model, cost.summary
    own = dict(zip(summary.runs, cost.at(p).zeros, strict=True))
    none = np.zeros(len(model.zeros))
    zeros = np.array([own.get(int(run), none) for run in workspace.runs]).T
    found = influence(model, p, zeros, workspace.pose, workspace.state, 1.0 / cost.reading_variance)
    return Slopes(model.pose, found.parameters)


MOVED = 5.0
"""Standard uncertainties by which another log may move a parameter before the report says so."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihood `cost`, its optimum `p` (n,), what it determines (`found`), and how certainly.

    `recorded`: what to call the log or the plan; `log`: its samples. `amiss`: the sentence that a report
    begins with where the model does not describe the log; it is the first of the notes too.
    """

    cost: Cost
    p: np.ndarray
    found: Determination
    uncertainty: Uncertainty
    workspace: Workspace
    recorded: str
    log: Log
    notes: tuple[str, ...] = ()
    amiss: str = ""

    @property
    def model(self) -> Model:
        """The model whose parameters these are."""
        return self.cost.summary.model

    @cached_property
    def information(self) -> np.ndarray:
        """What all runs tell of the parameters, (n, n)."""
        return self.cost.information(self.p)


def from_fit(known: Fit, log: Log | None = None) -> Evidence:
    """Return the evidence of a fit; `log` is needed when the fit was read from a file.

    The log is fitted again from the calibration's values: on its own log nothing moves; on another one the
    notes say what did. Raises `InputError` when model and log do not belong together.
    """
    found, notes = known, known.notes
    if log is not None or known.likelihood is None:
        if log is None:
            raise InputError("A calibration read from a file does not hold its log; give the log as well.")
        found, notes = _fitted_again(known, log)
    cost, determination, source = found.likelihood, found.determination, found.source
    assert cost is not None
    assert determination is not None
    assert source is not None
    _check_samples(cost, found.model, source.name)
    sigma = found.noise.std
    fitted = known.goodness if known.goodness and (log is None or _same_log(known, log)) else found.goodness
    amiss = fitted and fitted.sentence
    notes = (amiss, *notes) if amiss else notes
    return Evidence(
        cost,
        found.values,
        determination,
        uncertainty(cost.at(found.values), determination),
        visited(source, found.model, sigma=sigma, values=found.model.named(found.values)),
        source.name,
        source,
        notes,
        amiss or "",
    )


def from_plan(
    model: Model, values: Mapping[str, float], campaign: Campaign, noise: Mapping[str, float], name: str
) -> Evidence:
    """Return what a campaign will determine about a machine with these values, before it is recorded.

    The motion is simulated without noise; `noise` is the standard deviation of every column.
    """
    p = model.vector(values)
    log = Log.from_arrays(simulate(model, values, campaign, None, seed=0))
    missing = [c for c in model.channels if not noise.get(c, 0.0) > 0]
    if missing:
        raise InputError(f"A plan needs the noise of every channel; {missing[0]} has none: state it.")
    cost = replace(cost_near(log, model, p, noise), planned=True)
    _check_samples(cost, model, name)
    found = determine(cost, p)
    reason = "a plan: white noise of the stated size is taken for granted"
    told = replace(uncertainty(cost.at(p), found), method="likelihood", reason=reason)
    return Evidence(cost, p, found, told, visited(log, model), name, log)


def _fitted_again(known: Fit, log: Log) -> tuple[Fit, tuple[str, ...]]:
    """Fit `log` from the calibration's values, as the calibration was made."""
    model, own = known.model, _same_log(known, log)
    if not own and not same_layout(model, log.meta):
        raise InputError(
            f"The probes in the meta.json of {log.name} are not those of the calibration: another machine, "
            "or another layout; fit this log by itself."
        )
    log = as_read(log, model, known.wiring)
    if own:
        log = replace(log, noise=log.noise.merged(known.noise))
    again = fit(
        log,
        model,
        solver="direct",
        holdout=known.log["holdout"] if own else None,
        loss=known.solver.get("loss", "auto"),
        start=known.values,
    )
    if own:
        return again, again.notes
    both = np.sqrt(np.where(known.determined, known.std, np.nan) ** 2 + again.std**2)
    moved = np.abs(again.values - known.values) / both
    far = [model.names[k] for k in np.flatnonzero(moved > MOVED)]
    note = "This is not the log that the calibration was fitted to: the values below are this log's."
    if far:
        worst = int(np.nanargmax(moved))
        note += (
            f" {', '.join(far)} moved by more than {MOVED:g} standard uncertainties "
            f"({model.names[worst]} by {moved[worst]:.0f}): another machine, or this one has changed."
        )
    return again, (note, *again.notes)


def _same_log(known: Fit, log: Log) -> bool:
    said = known.log.get("sha256")
    return said is not None and said == log.sha256


def _check_samples(cost: Cost, model: Model, name: str) -> None:
    """Refuse a log with fewer readings than there is to estimate: no covariance can be formed."""
    open_ = sum(p.width > 0 for p in model.parameters)
    zeros = len(model.zeros) * len(cost.summary.runs)
    readings = int(cost.summary.counts.sum()) * len(model.channels)
    if readings <= open_ + zeros:
        raise InputError(
            f"{name} holds {readings} readings for {open_} parameters and {zeros} zero deviations: too few "
            "to form a covariance; record more samples."
        )
