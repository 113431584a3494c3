"""Fit a model to a log: summaries, starts, global search, refinement, uncertainty, error tables.

The path is the same for every family: one pass over the log gives run summaries; a closed form and SHTLBO
give starting points; IPOPT refines them inside the bounds; a second pass tabulates errors.
"""

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import metadata
from time import perf_counter
from typing import Any

import numpy as np

from hallsym import outliers, start, uncertainty
from hallsym.batches import Weigh, remembered
from hallsym.calibration import Errors, Fit
from hallsym.cost import Cost, cost_of
from hallsym.decoding import columns_of, error_tables, logged_columns
from hallsym.determination import Determination, determine
from hallsym.errors import InputError, nearest
from hallsym.families import adapted, build, default_model, plain
from hallsym.linearised import exact
from hallsym.log import Log, Noise, check_log, clean_log, estimate_noise
from hallsym.log.drop import Drop, without
from hallsym.model import Inspection, Model
from hallsym.passes import optimum
from hallsym.search import SOLVERS, Search, refit, search
from hallsym.summary import Summary, summarise
from hallsym.turning import continuous, designed, home_notes, nearest_turn
from hallsym.wiring import as_read, check_wiring, find_wiring, rewired

__all__ = ["LOSSES", "SOLVERS", "fit", "noise_of", "refit"]

LOSSES = ("auto", "none", "reject", "tukey")
SUSPECT = 6.5
"""Peak error in noise floors above which outliers are looked for."""
ROUNDS = 12
"""Of taking outliers out and fitting again, at most."""
LEAST_SIGMA = 1e-13
"""Standard deviation [m] given to a reading that shows no noise at all (a noise-free simulation)."""

Progress = Callable[[str], None]


def fit(
    log: Log,
    model: str | Model | None = None,
    *,
    solver: str = "hybrid",
    holdout: Sequence[int] | None = None,
    loss: str = "auto",
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    effects: Sequence[str] = (),
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    resolve_wiring: bool = False,
    drop_bad: bool = False,
    seed: int = 0,
    start: np.ndarray | None = None,
    on_progress: Progress | None = None,
) -> Fit:
    """Calibrate `model` on `log` and return values, uncertainties and errors.

    `model`: a name or a Model; the log's own `base_model`, else what its columns suggest. `solver`: "hybrid"
    (SHTLBO and a closed form, then IPOPT), "direct" (closed form, then IPOPT) or a global method for the
    hybrid.
    `holdout`: runs that take no part in the fit; the log's own by default. Their zero deviations are
    estimated from themselves. `loss`: "auto" takes out isolated spikes if there are any and says so, "reject"
    always looks for them, "tukey" weighs every sample by Tukey's biweight, "none" is plain least squares.
    `parameters`: changed nominal values and bounds. `effects`: effects to add, by name, with their numbers or
    without (`hysteresis:half_width_m=6e-05`; `hallsym.diagnosis.choose.model_on` finds them on a log). `own`:
    the user's effects by name. `start`: (n,) values to begin from instead of the closed form.

    A model that has no run summaries (memory, rates, a term of higher order in the zeros) is fitted from the
    optimum of the model without its effects by Gauss-Newton steps, one pass over the log each.

    Raises `InputError` for a log that cannot be what the model needs.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    _choice(solver, SOLVERS, "solver")
    _choice(loss, LOSSES, "loss")
    if isinstance(model, Model):
        model = adapted(model, tuple(effects), parameters or {}, own)
    else:
        name = model or default_model(log.meta)
        model = build(name, meta=log.meta, added=tuple(effects), parameters=parameters, own=own)
    say("checking the log")
    columns = logged_columns(model)
    log = clean_log(log, columns) if drop_bad else log
    notes = list(log.notes) if drop_bad else check_log(log, columns)
    mounted = model.inspect(model, log) if model.inspect else Inspection()
    notes += mounted.notes
    log = as_read(log, model, mounted.wiring)
    apart = _apart(log, log.meta.holdout if holdout is None else holdout)
    if not exact(model):
        first = None
        if exact(base := plain(model)):
            first = fit(
                log, base, solver=solver, holdout=apart, loss=loss, resolve_wiring=resolve_wiring, seed=seed,
                on_progress=on_progress,
            )  # fmt: skip
        result = _by_passes(log, model, first, apart, notes, solver, loss, seed, start, say, began)
        everything = tuple(dict.fromkeys((*mounted.notes, *result.notes)))
        return replace(result, wiring=result.wiring or mounted.wiring, notes=everything)
    task = _Task(log, model, noise_of(log, model, apart), solver, seed, say, start)
    state = task.solve(task.summary(), apart)
    wiring, gain = find_wiring(state.merged, state.linear) if resolve_wiring else (None, 0.0)
    if gain > 0:
        log = rewired(log, model.channels, wiring)
        task = replace(task, log=log, noise=noise_of(log, model, apart))
        state = task.solve(task.summary(), state.holdout)
    errors = task.errors(state, None)
    keep = None
    if task.suspicious(state, errors) if loss == "auto" else loss != "none":
        state, keep, said = task.without_outliers(state, loss)
        errors = task.errors(state, keep) if keep else errors
        notes += said
    task.check(state)
    result = _result(
        task,
        state,
        errors,
        tuple(notes),
        wiring if gain > 0 else mounted.wiring,
        loss,
        perf_counter() - began,
    )
    return replace(result, keep=keep, source=log, likelihood=state.fitted, determination=state.found)


def _by_passes(
    log: Log,
    model: Model,
    first: Fit | None,
    apart: tuple[int, ...],
    notes: Sequence[str],
    solver: str,
    loss: str,
    seed: int,
    start: np.ndarray | None,
    say: Progress,
    began: float,
) -> Fit:
    """Fit a model without run summaries, from `first`: the fit of what it is without its effects."""
    begin, keep, wiring = model.nominal, None, None
    if first is not None:
        log, keep, wiring = first.source or log, first.keep, first.wiring
        known = dict(zip(first.model.names, first.values.tolist(), strict=True))
        begin = model.vector({n: v for n, v in known.items() if n in model.names})
        zeros = _zero_notes(first.model, tuple(first.zeros), np.array(list(first.zeros.values())))
        notes = [note for note in first.notes if note not in zeros]
    noise = noise_of(log, model, apart)
    if first is not None:
        noise = noise.merged(first.noise)
    task = _Task(log, model, noise, solver, seed, say, start)
    found = optimum(log, model, task.sigmas, begin if start is None else start, apart, keep, say)
    state = State(found.everything, found.fitted, found.determination, found.search, apart)
    errors = task.errors(state, keep)
    seconds = perf_counter() - began
    result = _result(task, state, errors, tuple(notes), wiring, loss, seconds)
    return replace(result, keep=keep, source=log, likelihood=state.fitted, determination=state.found)


@dataclass(frozen=True, eq=False)
class State:
    """A solved fit: costs of all and of the fitted runs, what is determined, and the optimum."""

    everything: Cost
    fitted: Cost
    determination: Determination
    search: Search
    holdout: tuple[int, ...]

    @property
    def p(self) -> np.ndarray:
        """The optimum, shape (n,)."""
        return self.search.p

    @cached_property
    def found(self) -> Determination:
        """What the fitted runs determine at the optimum, for what was held on the way there."""
        return replace(determine(self.fitted, self.p), held=self.determination.held)

    def zeros(self) -> dict[int, np.ndarray]:
        """Zero displacements of every run, held-out ones included."""
        return dict(zip(self.everything.summary.runs, self.everything.at(self.p).zeros, strict=True))


@dataclass(frozen=True, eq=False)
class Started(State):
    """A solved fit of run summaries, with what it was started and is checked with."""

    linear: start.LinearFit
    merged: Cost
    closed_form: np.ndarray


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same while a fit goes round: log, model, noise, solver."""

    log: Log
    model: Model
    noise: Noise
    solver: str
    seed: int
    say: Progress
    begin: np.ndarray | None

    @property
    def sigmas(self) -> dict[str, float]:
        return {c: s.value for c, s in self.noise.sigmas.items()}

    def counting(self, what: str) -> Callable[[int], None]:
        """Return a progress callback that says which share of the log is done."""
        total = self.log.rows
        self.say(what)
        return lambda rows: self.say(f"{what}, {100 * rows // total} % of {total} samples")

    def summary(self, weigh: Weigh | None = None) -> Summary:
        """Return the run summaries of the log."""
        return summarise(self.log, self.model, weigh, self.counting("summarising runs"))

    def solve(self, summary: Summary, holdout: tuple[int, ...], solver: str | None = None) -> Started:
        """Find the optimum of one set of summaries."""
        used = [run for run in summary.runs if run not in holdout]
        everything = cost_of(summary, self.sigmas)
        fitted = everything if len(used) == len(summary.runs) else cost_of(summary.select(used), self.sigmas)
        merged = cost_of(fitted.summary.merged(), self.sigmas)
        linear = start.linear_fit(merged)
        closed_form = start.closed_form(merged, linear)
        first = np.clip(closed_form if self.begin is None else self.begin, *self.model.bounds)
        determination = determine(fitted, first)
        held = list(determination.held)
        first[held] = np.clip(self.model.nominal, *self.model.bounds)[held]
        solver = solver or self.solver
        self.say(f"solving with {solver}")
        found = search(fitted, merged, first, determination, solver=solver, seed=self.seed)
        found = replace(found, p=nearest_turn(self.model, found.p))
        return Started(everything, fitted, determination, found, holdout, linear, merged, closed_form)

    def errors(self, state: State, keep: Weigh | None) -> Errors:
        versions = [(designed(self.model, state.p), {}), (state.p, state.zeros())]
        variance = state.fitted.reading_variance
        before, after = error_tables(
            self.log, self.model, versions, variance, keep, self.counting("tabulating errors"), self.sigmas
        )
        return Errors(before, after, state.holdout)

    def suspicious(self, state: State, errors: Errors) -> bool:
        floor = np.array(list(uncertainty.noise_floor(state.fitted, state.p).values()))
        return bool(np.any(errors.fitted.peak.max(axis=0) > SUSPECT * floor))

    def without_outliers(self, state: Started, loss: str) -> tuple[Started, Weigh | None, list[str]]:
        """Take outliers out, refit, until the same samples are left."""
        total, before, whole = float(state.everything.summary.counts.sum()), -1.0, state
        columns = (*self.model.references, *self.model.channels)
        suspects = remembered(outliers.column_spikes(columns), self.log.rows, columns)
        weigh = suspects
        for _ in range(ROUNDS):
            summary = self.summary(weigh)
            left = float(summary.counts.sum())
            if left < total:
                self.say(f"refitting without outliers ({100 * (1 - left / total):.2g} % of the weight)")
                state = self.solve(summary, state.holdout, solver="direct")
            self.check(state)
            if abs(left - before) <= 1e-6 * total:
                break
            before, weigh = left, self.weigh(state, loss, suspects)
        if left == total:
            return whole, None, []
        state = self.solve(summary, state.holdout)
        gone = total - left
        said = (
            f"{gone:.0f} of {total:.0f} samples ({100 * gone / total:.2g} %) are isolated spikes and were "
            "left out of fit and error tables (--loss none keeps them)."
            if loss != "tukey"
            else f"Tukey's biweight took {100 * gone / total:.2g} % of the weight."
        )
        return state, weigh, [said]

    def weigh(self, state: State, loss: str, suspects: Weigh) -> Weigh:
        """Return what takes outliers out, judged by the residuals of the fit so far; each block once."""
        residual = outliers.residuals(self.model, state.p, state.zeros())
        covariance = state.fitted.at(state.p).covariance.mean(axis=0)
        if loss == "tukey":
            weigh = outliers.tukey(residual, covariance)
        else:
            weigh = outliers.reject_spikes(residual, covariance, suspects)
        return remembered(weigh, self.log.rows, columns_of(self.model))

    def check(self, state: Started) -> None:
        """Refuse a reference that does not belong, and channels that no value in the bounds explains."""
        start.check_reference(self.model, state.linear.unexplained, self.log.name)
        lower, upper = self.model.bounds
        slack = 0.05 * state.determination.scale
        inside = (lower - slack <= state.closed_form) & (state.closed_form <= upper + slack)
        if not inside.all():
            check_wiring(state.merged, state.linear, self.log.name)


# -- pieces ----------------------------------------------------------------------------------------------


def _choice(name: str, known: Sequence[str], what: str) -> None:
    if name not in known:
        raise InputError(
            f"Input {what} must be one of {', '.join(known)}; instead received {name!r}"
            f"{nearest(name, list(known))}."
        )


def noise_of(log: Log, model: Model | None, apart: Sequence[int] = ()) -> Noise:
    """Return the noise of every column a model uses (all columns without one): given, else estimated.

    Runs in `apart` (held out) take no part in the estimate.
    """
    columns = logged_columns(model) if model else tuple(c for c in log.columns if c not in ("run", "t_s"))
    columns = tuple(c for c in columns if c != "t_s")
    log = continuous(log, model) if model else log
    missing = [c for c in columns if c not in log.noise]
    used = without(log, Drop(runs=frozenset(apart))) if missing and apart else log
    noise = log.noise.merged(estimate_noise(used, missing)) if missing else log.noise
    sigmas = {c: noise[c] for c in columns}
    for c in model.channels if model else ():
        sigmas[c] = replace(sigmas[c], value=max(sigmas[c].value, LEAST_SIGMA))
    return Noise(sigmas)


def _apart(log: Log, holdout: Sequence[int]) -> tuple[int, ...]:
    """Held-out runs, all of them in the log and not all of the log."""
    unknown = [run for run in holdout if run not in log.runs]
    if unknown:
        raise InputError(f"Held-out run {unknown[0]} is not in the log; its runs are {_runs(log.runs)}.")
    if holdout and set(log.runs) <= set(holdout):
        raise InputError("Every run is held out; leave at least one to fit.")
    return tuple(holdout)


def _runs(runs: Sequence[int]) -> str:
    return ", ".join(map(str, runs)) if len(runs) <= 8 else f"{runs[0]}, {runs[1]}, ... {runs[-1]}"


def _result(
    task: _Task,
    state: State,
    errors: Errors,
    notes: tuple[str, ...],
    wiring: Any,
    loss: str,
    seconds: float,
) -> Fit:
    model, found = task.model, state.found
    estimate = uncertainty.estimate(state.fitted, state.p, found)
    gain = np.array([model.zero_scale(state.p, s) for s in state.everything.summary.first_state])
    zeros = state.everything.at(state.p).zeros
    delta = zeros * gain if zeros.shape[1] else zeros
    return Fit(
        model=model,
        values=state.p,
        std=estimate.std,
        determined=estimate.determined,
        covariance=estimate.covariance,
        covariance_method=estimate.method,
        covariance_reason=estimate.reason,
        held=tuple(model.names[k] for k in found.held),
        structural=found.structural,
        at_bound=estimate.at_bound,
        combinations=estimate.combinations,
        zeros=dict(zip(state.everything.summary.runs, delta, strict=True)),
        noise=task.noise,
        noise_floor=uncertainty.noise_floor(state.fitted, state.p),
        status=state.search.status,
        message=state.search.message,
        solver={
            "name": task.solver,
            "loss": loss,
            "cost": state.search.cost,
            "cost_per_degree_of_freedom": estimate.cost_per_dof,
            "evaluations": state.search.evaluations,
            "starts": state.search.starts,
            "share_at_optimum": state.search.share,
            "seed": task.seed,
        },
        log={
            "path": None if task.log.path is None else str(task.log.path),
            "sha256": None,
            "rows": task.log.rows,
            "runs": len(state.everything.summary.runs),
            "holdout": list(state.holdout),
            "span": {column: list(ends) for column, ends in errors.fitted.span.items()},
        },
        seconds=seconds,
        notes=(
            *notes,
            *_zero_notes(model, state.everything.summary.runs, delta),
            *home_notes(task.log, dict(zip(state.everything.summary.runs, delta, strict=True))),
        ),
        errors=errors,
        undetermined_by_log=estimate.undetermined_by_log,
        wiring=wiring,
        versions=dict(_versions()),
        error_rows=errors.rows(),
    )


def _zero_notes(model: Model, runs: Sequence[int], delta: np.ndarray) -> tuple[str, ...]:
    """Zero deviations beyond their bounds are reported, not clipped: clipping would bend the parameters."""
    out = []
    for k, zero in enumerate(model.zeros):
        beyond = [r for r, d in zip(runs, delta[:, k], strict=True) if not zero.lower <= d <= zero.upper]
        if beyond:
            factor, unit = (1e6, "um") if zero.unit == "m" else (float(np.degrees(1.0)), "deg")
            low, high, worst = (factor * v for v in (zero.lower, zero.upper, np.abs(delta[:, k]).max()))
            out.append(
                f"Zero deviation {zero.name} is beyond {low:.3g} to {high:.3g} {unit} in {len(beyond)} runs "
                f"(run {beyond[0]} first, {worst:.3g} {unit} at most): look at the reset."
            )
    return tuple(out)


@cache
def _versions() -> dict[str, str]:
    packages = ("hallsym", "casadi", "numpy", "scipy")
    found = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return {"python": platform.python_version(), **found}
