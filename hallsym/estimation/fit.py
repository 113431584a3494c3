"""Fit a model to a log: summaries, starts, global search, refinement, uncertainty, error tables.

The path is the same for every family: one pass over the log gives run summaries; a closed form and SHTLBO
give starting points; IPOPT refines them inside the bounds; a second pass tabulates errors.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.estimation.channel_assignment import as_read, find_wiring, rewired
from hallsym.estimation.decoding import logged_columns
from hallsym.estimation.gauss_newton import optimum
from hallsym.estimation.linearised import exact
from hallsym.estimation.optimum import SOLVERS, refit
from hallsym.estimation.result import result_of, zero_notes
from hallsym.estimation.task import Progress, Task
from hallsym.families import adapted, build, default_model, plain
from hallsym.log import Log, Noise, check_log, clean_log, estimate_noise
from hallsym.log.drop import Drop, without
from hallsym.log.phase import continuous
from hallsym.model import Inspection, Model

__all__ = ["LOSSES", "SOLVERS", "fit", "noise_of", "refit"]

LOSSES = ("auto", "none", "reject", "tukey")
LEAST_SIGMA = 1e-13
"""Standard deviation [m] given to a reading that shows no noise at all (a noise-free simulation)."""


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
    task = Task(log, model, noise_of(log, model, apart), solver, seed, say, start)
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
    result = result_of(
        task,
        state,
        errors,
        tuple(notes),
        wiring if gain > 0 else mounted.wiring,
        loss,
        perf_counter() - began,
    )
    return replace(result, keep=keep, source=log, likelihood=state.fitted, determination=state.determined)


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
        zeros = zero_notes(first.model, tuple(first.zeros), np.array(list(first.zeros.values())))
        notes = [note for note in first.notes if note not in zeros]
    noise = noise_of(log, model, apart)
    if first is not None:
        noise = noise.merged(first.noise)
    task = Task(log, model, noise, solver, seed, say, start)
    state = optimum(log, model, task.sigmas, begin if start is None else start, apart, keep, say)
    errors = task.errors(state, keep)
    seconds = perf_counter() - began
    result = result_of(task, state, errors, tuple(notes), wiring, loss, seconds)
    return replace(result, keep=keep, source=log, likelihood=state.fitted, determination=state.determined)


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
