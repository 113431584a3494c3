"""Where a report's numbers come from: a fit with its log, or a campaign that is still a plan."""

from collections.abc import Mapping
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
from hallsym.families import same_layout
from hallsym.inference.workspace import Workspace, visited
from hallsym.log import Log
from hallsym.model import Model
from hallsym.simulation import Campaign, simulate

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
    _check_bounds(known)
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
        uncertainty(cost, found.values, determination),
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
    told = replace(uncertainty(cost, p, found), method="likelihood", reason=reason)
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


def _check_bounds(known: Fit) -> None:
    lower, upper = known.model.bounds
    slack = 1e-9 * np.maximum(np.abs(lower), np.abs(upper), where=np.isfinite(lower), out=np.ones(len(lower)))
    for k in np.flatnonzero(~((known.values >= lower - slack) & (known.values <= upper + slack))):
        name = known.model.names[k]
        raise InputError(
            f"Bounds {lower[k]:g} to {upper[k]:g} of {name} exclude its estimate {known.values[k]:g}; widen "
            "them and fit again."
        )


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
