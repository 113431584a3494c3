"""The evidence behind a report: a fit with its log, or a campaign that is planned."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import Fit, fit
from hallsym.estimation.covariance import Samples, Uncertainty, uncertainty
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost, Point, cost_near
from hallsym.estimation.prediction import is_own
from hallsym.families import same_layout
from hallsym.families.recording import as_read
from hallsym.log import Log
from hallsym.log.batches import Weigh, batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.influence import influence
from hallsym.simulation import Campaign, simulate

SAMPLES = 2000
"""Poses that stand for the workspace of a log."""


def visited(
    log: Log,
    model: Model,
    offsets: Mapping[int, np.ndarray],
    most: int = SAMPLES,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return offsets (n_offsets, s), pose (n_pose, s), state (n_state, s) at about `most` samples of `log`.

    They are evenly spread over the samples. `offsets`: by run, 0 where a run is not in it. `sigma`: noise by
    column, `values`: parameters by name, for the columns that are computed.
    """
    step = max(1, -(-log.rows // most))
    parts, own, offset = [], [], 0
    for batch in batches(extended(log, model, sigma, values), columns_of(model)):
        pick = slice(offset, None, step)
        parts.append(np.array([c[pick] for c in batch.columns((*model.references, *model.state))]))
        own.append(batch.offsets(offsets, len(model.offsets))[:, pick])
        offset = (offset - len(batch)) % step
    pose, state = np.split(np.hstack(parts), [len(model.references)])
    return np.hstack(own), pose, state


MOVED = 5.0
"""Standard uncertainties by which another log may move a parameter without a note."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The likelihood at its optimum (`point`), its identifiability (`found`) and uncertainties.

    `slopes`: d pose / d parameters over the workspace, (s, n_pose, n), at fixed zero deviations. `recorded`:
    name of the log or the plan; `log`: its samples. `amiss`: the first sentence of a report where the model
    does not describe the log; also the first of the notes.
    """

    point: Point
    found: Determination
    uncertainty: Uncertainty
    slopes: np.ndarray
    recorded: str
    log: Log
    notes: tuple[str, ...] = ()
    amiss: str = ""

    @property
    def cost(self) -> Cost:
        """The likelihood."""
        return self.point.cost

    @property
    def p(self) -> np.ndarray:
        """The optimum, (n,)."""
        return self.point.p

    @property
    def model(self) -> Model:
        """The model whose parameters these are."""
        return self.cost.summary.model

    @cached_property
    def information(self) -> np.ndarray:
        """Information of all runs about the parameters, (n, n)."""
        return self.point.total_information()


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
    assert found.likelihood is not None
    assert found.determination is not None
    assert found.source is not None
    goodness = known.goodness if known.goodness and (log is None or is_own(known, log)) else found.goodness
    amiss = (goodness and goodness.sentence) or ""
    return _at(
        found.likelihood.at(found.values),
        found.determination,
        found.source,
        found.source.name,
        sigma=found.noise.std,
        values=found.model.named(found.values),
        keep=found.keep,
        notes=(amiss, *notes) if amiss else notes,
        amiss=amiss,
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
    point = replace(cost_near(log, model, p, noise), planned=True).at(p)
    planned = _at(point, determine(point.cost, p), log, name)
    reason = "a plan: white noise of the stated size is taken for granted"
    return replace(planned, uncertainty=replace(planned.uncertainty, method="likelihood", reason=reason))


def _at(
    point: Point,
    found: Determination,
    log: Log,
    name: str,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    keep: Weigh | None = None,
    **said: Any,
) -> Evidence:
    """Return the evidence of a log at an optimum; `sigma`, `values` as for `visited`, `said`: notes.

    `keep`: weight of each sample. The noise of a plan is white: it has no `sigma`. Refuses a log with fewer
    readings than unknowns, for which there is no covariance.
    """
    cost, model = point.cost, point.cost.summary.model
    open_ = sum(p.width > 0 for p in model.parameters)
    offsets = len(model.offsets) * len(cost.summary.runs)
    readings = int(cost.summary.counts.sum()) * len(model.channels)
    if readings <= open_ + offsets:
        raise InputError(
            f"{name} holds {readings} readings for {open_} parameters and {offsets} zero deviations: too few "
            "to form a covariance; record more samples."
        )
    own = dict(zip(cost.summary.runs, point.offsets, strict=True))
    workspace = visited(log, model, own, sigma=sigma, values=values)
    slopes = influence(model, point.p, *workspace, 1.0 / cost.reading_variance).parameters
    samples = [] if sigma is None else [Samples(log, sigma, keep)]
    return Evidence(point, found, uncertainty(point, found, samples), slopes, name, log, **said)


def _fitted_again(known: Fit, log: Log) -> tuple[Fit, tuple[str, ...]]:
    """Fit `log` from the calibration's values, as the calibration was made."""
    model, own = known.model, is_own(known, log)
    if not own and not same_layout(model, log.meta):
        raise InputError(
            f"The probes in the meta.json of {log.name} are not those of the calibration: another machine, "
            "or another layout; fit this log by itself."
        )
    log = as_read(log, model, known.corrections)
    if own:
        log = replace(log, noise=log.noise.merged(known.noise))
    again = fit(
        log,
        model,
        solver="direct",
        holdout=known.log.holdout if own else None,
        loss=known.solver.loss,
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
