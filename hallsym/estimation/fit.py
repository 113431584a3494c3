"""Fit a model to a log: run statistics, starts, global search, refinement, uncertainty, error tables.

The path is the same for every family: one pass over the log gives run statistics; a closed form and SHTLBO
give starting points; Newton's method or IPOPT refines them inside the bounds; a second pass tabulates the
errors of the fit, and a third, when they are asked for, those of nominal parameters.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest, uncomputable
from hallsym.estimation import outliers
from hallsym.estimation.calibration import Claim, Fit
from hallsym.estimation.claims import claims_of, described, mistakes_of
from hallsym.estimation.decoding import Errors, columns_of
from hallsym.estimation.factors import exact, joined
from hallsym.estimation.goodness_of_fit import noise_followed
from hallsym.estimation.likelihood import Cost, Sharing, cost_of, joint_cost, numbered, run_numbers
from hallsym.estimation.optimum import SOLVERS, Solution, closed_form, linear_fit, searched, unrelated
from hallsym.estimation.several import check_gains, check_same, labels, restricted, several_fit
from hallsym.estimation.task import (
    SPIKES,
    Asked,
    Begun,
    LogFit,
    Progress,
    Task,
    checked,
    implausible,
    model_of,
    opened,
    result_of,
    silent,
    stated,
    zero_notes,
)
from hallsym.families import plain
from hallsym.families.recording import corrected, read_correction
from hallsym.log import LAYOUT, STUCK, UNRELATED, Fault, Log, as_log
from hallsym.log.batches import Weigh, batches, remembered
from hallsym.log.phase import continuous, nearest_turn
from hallsym.model import Model

LOSSES = ("auto", "none", "reject")


def fit(
    log: Any,
    model: str | Model | None = None,
    *,
    solver: str = "hybrid",
    holdout: Sequence[int] | None = None,
    loss: str = "auto",
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    effects: Sequence[str] = (),
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    corrections: Sequence[str] = (),
    accept: Sequence[str] = (),
    drop_bad: bool = False,
    noise: Mapping[str, float] | None = None,
    seed: int = 0,
    start: np.ndarray | None = None,
    per_log: Sequence[str] = (),
    holdout_logs: Sequence[Any] = (),
    quick: bool = False,
    on_progress: Progress | None = None,
) -> Fit:
    """Calibrate `model` on `log` and return values, uncertainties and errors.

    `log`: a `Log`, the path of one, a dict of arrays, or a data frame of any library that speaks Arrow
    (pandas, polars, pyarrow, DuckDB). Its columns end with their unit, `x_ref_um`, or state it,
    `x_ref [um]`; SI inside. Of the stage they are

        run                               a whole number that a reset or a break ends
        t_s                               time
        hall_a_m, hall_b_m, hall_c_m      readings, as the displacement that each probe claims
        z_m, rx_rad, ry_rad               vertical pose
        x_ref_m, y_ref_m, rz_ref_rad      the reference

    of an encoder `v_sin_v, v_cos_v` or `angle_rad` (`angle_count`) beside `angle_ref_rad`; `hallsym info
    MODEL` lists those of any model. Names that are other ones are mapped by `hallsym.read_log(log,
    columns={"hall_a_um": "HallA"})`.

    Returns a `Fit`: `values`, `std` (n,) in the order of `model.names`; `value(name)`;
    `covariance` (n, n); `errors.rows()` with rmse and peak of the decoded pose, before and after, on fitted
    and holdout runs; `goodness`; `notes`. `summary()` is what the command prints, `to_dataframe()` the
    parameters, `plot()` a picture, `save(path)` the calibration.

    >>> import hallsym
    >>> fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
    >>> f"{1e6 * fit.errors.rows()['fitted']['rmse']['x_m']:.2f} um"
    '1.36 um'

    `model`: a name or a Model; the log's own `base_model`, else what its columns suggest. `solver`: "hybrid"
    (SHTLBO and a closed form, refined), "direct" (closed form alone) or a global method for the
    hybrid; Newton's method ends all, or IPOPT where that does not converge.
    `holdout`: runs that take no part in the fit; the log's own by default. Their zero deviations are
    estimated from themselves. `loss`: "auto" takes out isolated spikes if there are any and says so, "reject"
    always looks for them, "none" is plain least squares.
    `parameters`: changed nominal values and bounds. `effects`: effects to add, by name, with their numbers or
    without (`hysteresis:half_width_m=6e-05`; `hallsym.diagnosis.choose.model_on` finds them on a log). `own`:
    the user's effects by name. `start`: (n,) values to begin from instead of the closed form.

    `noise`: 1 sigma by column in SI, `{"hall_m": 5e-7}` of each `hall_*_m`; it wins over what the log states.
    `corrections`: mistakes of the recording to undo, as a claim states them (`"sign x_ref_m"`; `hallsym info
    corrections` lists the forms). `accept`: names of claims to overrule, which become notes; samples that
    such a claim would leave out stay. "all": every claim, and no search for mistakes.

    `quick`: one pass over a log whose run statistics show nothing amiss, without error tables (`errors` is
    None), the lower bound of the cost and a test of the autocorrelation of the noise; any other log is fitted
    as without it.

    `log` may be a list of logs of one device, each with its runs and its noise: they share all parameters but
    those named in `per_log` (`"eta_A"`, or a pattern such as `"eta_*"`), of which each log has its own.
    `holdout_logs`: logs that take no part. `fit.by_log` are then the fits log by log, `fit.joint` the
    parameters of all logs with their covariance; `values` are those of the last log.

    A model without run statistics (memory, rates, a term of higher order in the offsets) is fitted from the
    optimum of the model without its effects by Gauss-Newton steps, one pass over the log each.

    Raises `InputError` for a log that does not suit the model.
    """
    began, say = perf_counter(), on_progress or silent
    for what, word, known in (("solver", solver, SOLVERS), ("loss", loss, LOSSES)):
        if word not in known:
            raise InputError(
                f"Input {what} must be one of {', '.join(known)}; instead received {word!r}"
                f"{nearest(word, list(known))}."
            )
    if seed < 0:
        raise InputError(f"Input seed must be 0 or more; instead received {seed}.")
    if holdout is not None and (isinstance(holdout, str) or not np.iterable(holdout)):
        raise InputError(f"Input holdout must be a list of runs, as [2, 7]; instead received {holdout!r}.")
    effects, corrections, accept, per_log = (  # one word is a list of one
        (words,) if isinstance(words, str) else words for words in (effects, corrections, accept, per_log)
    )
    alone = not (isinstance(log, list | tuple) or len(holdout_logs) or len(per_log))
    logs = [as_log(one, noise=noise) for one in (log if isinstance(log, list | tuple) else [log])]
    if not logs:
        raise InputError("There is no log to fit; give one at least.")
    judged = [as_log(one, noise=noise) for one in holdout_logs]
    undone = tuple(map(read_correction, corrections))
    models = [  # a machine without a stated gap or travel takes those of the log without its mistakes
        model_of(corrected(one, undone), model, effects, parameters, own) for one in (*logs, *judged)
    ]
    asked = Asked(
        solver, holdout, loss, undone, drop_bad, seed, start,
        quick and alone, tuple(accept), say,
    )  # fmt: skip
    if alone:
        return _recording(logs[0], models[0], asked, began)
    several = fit_several(logs, judged, models, per_log, asked, alone=False, began=began)[0]
    return _claimed(several, (), asked)


ALL = "all"
"""Accepts every claim: no search for mistakes."""


def _recording(log: Log, model: Model, asked: Asked, began: float) -> Fit:
    """Fit one log and judge its recording.

    Raises `InputError` where nothing can be fitted, with the mistake that explains it if one does.
    """
    try:
        result, given = _fit_one(log, model, asked, began)
    except InputError as error:
        if ALL in asked.accept:
            raise
        given = corrected(log, asked.corrections)
        good, notes = checked(log, model, asked, asked.corrections)
        notes += model.inspect(model, good).notes if model.inspect else ()
        odd = [_claim(note) for note in notes if isinstance(note, Fault)]
        asked.say("looking for a mistake of the recording")  # the samples themselves can be read
        found = [c for c in mistakes_of(given, model) or odd if c.name not in asked.accept]
        if found:
            raise InputError(found[0].text, found) from error
        raise
    if ALL in asked.accept:
        return _claimed(result, (), asked)
    faults = [n for n in result.notes if isinstance(n, Fault) and n.runs]
    doubted = {n.name for n in faults if n.correction is None or not described(result)}
    if doubted:  # a fault that leaves samples out may be part of a larger one: fit all samples
        whole, _ = checked(log, model, asked, result.corrections, tuple(doubted))
        mistakes = mistakes_of(whole, model)
        known = all(n.correction for n in faults)  # what left samples out
        if known and not any(one.explains for one in mistakes):
            mistakes = claims_of(result, given)
        return _claimed(result, mistakes, asked)
    return _claimed(result, claims_of(result, given), asked)


WHOLLY = 0.99
"""Share of the excess that a mistake must explain so that an assumed layout is not in doubt."""


def _claimed(result: Fit, mistakes: Sequence[Claim], asked: Asked) -> Fit:
    """Return a fit with its claims: `mistakes` that explain its residual, and anomalies of the recording.

    Implausible values and a reference of another recording are claims where no mistake explains them. An
    assumed layout is doubted first. Claims that the user accepts are notes.
    """
    odd = [note for note in result.notes if isinstance(note, Fault)]
    notes = [str(note) if note in odd else note for note in result.notes]
    if ALL in asked.accept:
        return result.changed(notes=tuple(notes))
    values = implausible(result)
    assumed = values if {one.name for one in values} == {LAYOUT} and not stated(result) else []
    if any(one.correction for one in mistakes):
        odd = [one for one in odd if one.name != UNRELATED]
    else:
        dead = {c for one in odd if one.name == STUCK and not one.runs for c in one.columns}
        odd += [one for one in values if one not in assumed and not dead & {*one.columns}]
    odd = [one for one in odd if not any(_covers(mistake, one) for mistake in mistakes)]
    assumed = [] if any((one.explains or 0.0) > WHOLLY for one in mistakes) else assumed
    found = [*map(_claim, assumed), *mistakes, *map(_claim, odd)]
    notes = [note for note in notes if note not in odd]
    return result.changed(
        claims=tuple(one for one in found if one.name not in asked.accept),
        notes=(*notes, *(one.text for one in found if one.name in asked.accept)),
    )


def _covers(mistake: Claim, fault: Fault) -> bool:
    """Return whether a mistake that can be undone is where a fault is."""
    everywhere = not mistake.runs or (bool(fault.runs) and {*fault.runs} <= {*mistake.runs})
    columns = {*fault.columns} <= {*mistake.columns}
    return mistake.correction is not None and bool(fault.columns) and columns and everywhere


def _claim(fault: Fault) -> Claim:
    return Claim(fault.name, str(fault), fault.columns, fault.runs, fault.correction)


@contextmanager
def _computing() -> Iterator[None]:
    """Refuse numbers that end the linear algebra."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise uncomputable(error) from error


@_computing()
def _fit_one(log: Log, model: Model, asked: Asked, began: float) -> tuple[Fit, Log]:
    """Fit one log; return also the log as it was logged, without its bad samples."""
    if exact(model):
        result, given = fit_several([log], [], [model], (), asked, alone=True, began=began)
        return result, given or log
    asked.say("checking the log")
    one = opened(log, model, asked)
    first = None
    if exact(base := plain(model)):
        plainly = replace(
            asked, holdout=one.task.holdout, corrections=(), drop_bad=False, start=None, quick=False
        )
        first = _fit_one(one.task.log, base, plainly, began)[0]
        offsets = zero_notes(first.model, tuple(first.offsets), np.array(list(first.offsets.values())))
        own = (*offsets, *one.task.log.notes)
        one.notes += tuple(n for n in first.notes if n not in own and not n.endswith(SPIKES))
    one.notes = tuple(dict.fromkeys(one.notes))
    one.task, one.solution, one.keep = one.task.by_passes(first)
    one.errors = one.task.errors(one.solution, one.keep)
    return result_of(one, began), one.given


ROUNDS = 12
"""Most rounds of rejecting outliers and refitting."""


@_computing()
def fit_several(
    logs: Sequence[Log],
    holdout_logs: Sequence[Log],
    models: Sequence[Model],
    per_log: Sequence[str],
    asked: Asked,
    *,
    alone: bool,
    began: float,
) -> tuple[Fit, Log | None]:
    """Return the fit of several logs, or of one `alone` with its log as it was logged.

    `models`: of logs and holdout logs, in order.
    """
    every, model = [*logs, *holdout_logs], models[0]
    if not alone:
        check_same(every, models)
    if not exact(model):
        raise InputError(
            f"Model {model.name} with {', '.join(model.effects)} has no run statistics, so several "
            "logs cannot be fitted together with it; fit them without the effects, or one at a time."
        )
    names = ("",) if alone else labels(every)
    own = _own_parameters(model, per_log, len(logs), bool(holdout_logs))
    members = _opened(every, model, len(logs), asked)
    if not alone:
        check_gains(every, model, [one.begun for one in members])
    members, others = members[: len(logs)], members[len(logs) :]
    together = _Together(members, Sharing.of(model, own, names[: len(logs)]), asked)
    solution, errors = together.optimum()
    for g, one in enumerate(members):
        _end(one, together.of_log(solution, g), errors[g] if errors else None)
    if alone:
        return result_of(members[0], began), members[0].given
    for one in others:  # decoded with the parameters of the others; all of its runs are holdout
        everything, known = one.begun.everything, members[-1].solution
        state = Solution(everything, everything, known.determination, known.search)
        _end(one, state, replace(one.task.errors(state, None), holdout=everything.summary.runs))
    return several_fit(together.sharing, solution, members, others, names, together.numbers, began), None


def _end(one: LogFit, solution: Solution, errors: Errors | None) -> None:
    """Keep how the fit of a log ended, and say where its reference is of another recording."""
    one.solution, one.errors = solution, errors
    if not any(isinstance(note, Fault) and note.name == UNRELATED for note in one.notes):  # or its family did
        one.notes += unrelated(one.task.model, one.begun.linear.unexplained, one.task.log.name)


def _own_parameters(model: Model, per_log: Sequence[str], logs: int, holdout: bool) -> tuple[str, ...]:
    """Return the parameters that each log has of its own, by names and patterns."""
    found: list[str] = []
    for pattern in per_log:
        named = [name for name in model.names if fnmatchcase(name, pattern)]
        if not named:
            raise InputError(
                f"Model {model.name} has no parameter {pattern!r}{nearest(pattern, list(model.names))}; "
                f"each log can have its own of {', '.join(model.names)}."
            )
        found += [name for name in named if name not in found]
    if found and logs < 2:
        raise InputError("Parameters per log need two logs at least; give another log, or leave them out.")
    if found and holdout:
        raise InputError(
            f"A holdout log cannot have a {found[0]} of its own, since nothing of it is fitted; leave "
            "per-log parameters or holdout logs out, or hold out some runs of that log."
        )
    return tuple(found)


def _opened(logs: Sequence[Log], model: Model, fitted: int, asked: Asked) -> list[LogFit]:
    """Return every log checked, summarised about the centre of the first, and judged."""
    out: list[LogFit] = []
    centre: np.ndarray | None = None
    if fitted > 1 and asked.holdout:
        known = {run for log in logs[:fitted] for run in log.runs}
        if lost := [run for run in asked.holdout if run not in known]:
            raise InputError(f"Holdout run {lost[0]} is in none of the {fitted} logs.")
    for k, log in enumerate(logs):
        asked.say(f"checking {log.name}")
        one = opened(log, model, asked, several=fitted > 1, judged=k >= fitted, centre=centre)
        one.begun = one.task.begin(one.task.summary())
        centre = one.begun.everything.summary.centre
        out.append(one)
    return out


class _Together:
    """The logs that are fitted, and their common optimum."""

    def __init__(self, logs: list[LogFit], sharing: Sharing, asked: Asked) -> None:
        self.logs, self.sharing, self.asked = logs, sharing, asked
        self.numbers = run_numbers([one.begun.everything.summary.runs for one in logs])

    def optimum(self) -> tuple[Solution, list[Errors] | None]:
        """Return the optimum without outliers, for the noise that each log shows, and errors by log.

        No errors where a quick fit of one log shows nothing amiss.
        """
        state = self.solve(self.asked.solver)
        if self.asked.quick and self.logs[0].task.in_order(state):
            return state, None
        errors = self.errors(state)
        whole, state = state, self._without_outliers(state, errors)
        state = self._with_noise_left(state)
        return state, errors if state is whole else self.errors(state)

    def solve(self, solver: str, begin_at: np.ndarray | None = None) -> Solution:
        """Minimise the sum of the costs as they are."""
        everything = self._sum([one.begun.everything for one in self.logs], self.numbers)
        fitted = self._sum([one.begun.fitted for one in self.logs], self.numbers)
        merged = self._sum([one.begun.merged for one in self.logs], [{0: g} for g in range(len(self.logs))])
        begin = self._first() if begin_at is None else begin_at
        self.asked.say(f"solving with {solver}")
        found, best = searched(fitted, merged, begin, solver=solver, seed=self.asked.seed)
        best = replace(best, p=nearest_turn(self.sharing.joint, best.p))
        return Solution(everything, fitted, found, best)

    def _sum(self, costs: list[Cost], numbers: Sequence[dict[int, int]]) -> Cost:
        return costs[0] if len(costs) == 1 else joint_cost(self.sharing, costs, numbers)

    def _first(self) -> np.ndarray:
        """Return where the search begins: the closed form of all runs, of own parameters that of each log."""
        if self.asked.start is not None:
            every = [np.asarray(self.asked.start, dtype=float)] * len(self.logs)
        elif len(self.logs) == 1:
            every = [closed_form(self.logs[0].begun.merged, self.logs[0].begun.linear)]
        else:
            parts = [numbered(one.begun.fitted.summary, known)
                     for one, known in zip(self.logs, self.numbers, strict=True)]  # fmt: skip
            pooled = cost_of(joined(parts).merged(), self.logs[0].task.noise.std)
            shared = closed_form(pooled, linear_fit(pooled))
            of_own = np.isin(self.sharing.model.names, self.sharing.own)
            every = [
                np.where(of_own, closed_form(one.begun.merged, one.begun.linear), shared)
                if of_own.any() else shared
                for one in self.logs
            ]  # fmt: skip
        first = np.zeros(len(self.sharing.joint.names))
        for chosen, values in zip(self.sharing.chosen, every, strict=True):
            first[chosen] = values
        return first

    def of_log(self, state: Solution, g: int) -> Solution:
        """Return the optimum as one log sees it: its runs, its parameters."""
        if len(self.logs) == 1:
            return state
        everything, fitted = state.everything.shares[g][0], state.fitted.shares[g][0]
        return Solution(
            everything, fitted, restricted(state.determination, self.sharing, g),
            replace(state.search, p=self.sharing.of_log(g, state.p)),
        )  # fmt: skip

    def errors(self, state: Solution) -> list[Errors]:
        """Return the error tables of every log."""
        return [one.task.errors(self.of_log(state, g), one.keep) for g, one in enumerate(self.logs)]

    def _suspicious(self, state: Solution, errors: Sequence[Errors]) -> list[int]:
        """Return the logs in which outliers are looked for."""
        if self.asked.loss != "auto":
            return [] if self.asked.loss == "none" else list(range(len(self.logs)))
        return [g for g, own in enumerate(errors)
                if self.logs[g].task.suspicious(self.of_log(state, g), own)]  # fmt: skip

    def _without_outliers(self, state: Solution, errors: Sequence[Errors]) -> Solution:
        """Take outliers out of the logs that show any and fit again, until the same samples are left."""
        if not (loud := self._suspicious(state, errors)):
            return state
        whole, tasks = state, {g: self.logs[g].task for g in loud}
        clean = {g: self.logs[g].begun for g in loud}
        total, before = sum(begun.samples for begun in clean.values()), -1.0
        columns = (*self.sharing.model.references, *self.sharing.model.channels)
        rules = {g: outliers.column_spikes(columns) for g in loud}
        weigh = suspects = {g: remembered(rules[g], tasks[g].log.rows, columns) for g in loud}
        for left_over in reversed(range(ROUNDS)):
            for g in loud:
                self.logs[g].begun = _weighed(tasks[g], weigh[g], clean[g])
            left = sum(self.logs[g].begun.samples for g in loud)
            if left < total:
                self.asked.say(
                    f"refitting without outliers ({100 * (1 - left / total):.2g} % of the samples)"
                )
                state = self.solve("direct")
            if abs(left - before) <= 1e-6 * total or not left_over:
                break
            before = left
            rules = {g: tasks[g].weigh(self.of_log(state, g), suspects[g]) for g in loud}
            weigh = {g: remembered(rules[g], tasks[g].log.rows, columns_of(tasks[g].model)) for g in loud}
        for g, begun in clean.items():
            one, wrong_for = self.logs[g], rules[g].wrong_for
            if one.begun.samples < begun.samples:
                one.keep = weigh[g]
            else:
                one.begun = begun
            if wrong_for:
                many = (
                    f"{100 * outliers.MADE_FOR:.0f} % of {' and '.join(sorted(wrong_for, key=columns.index))}"
                )
                one.notes += (
                    f"More than {many} seem spikes, which steps, corners and rounding do too: none of them "
                    "was left out for that.",
                )
        return self.solve(self.asked.solver) if left < total else whole

    def _with_noise_left(self, state: Solution) -> Solution:
        """Return the optimum with the noise of its residual where noise was estimated.

        The best point of a search that the user stopped is no optimum, and stays what it is.
        """
        if state.search.status == "interrupted":
            return state
        changed = False
        for g, one in enumerate(self.logs):
            noise = noise_followed(one.task.log, self.of_log(state, g).point, one.task.noise, one.keep)
            if noise is not None:
                one.task = replace(one.task, log=replace(one.task.log, noise=noise))
                one.begun = one.task.begin(one.begun.everything.summary)
                changed = True
        return self.solve("direct", state.p) if changed else state


def _weighed(task: Task, weigh: Weigh, clean: Begun) -> Begun:
    """Return the costs of a log with weights; those without, if no sample lost any."""
    whole = batches(continuous(task.log, task.model), columns_of(task.model))
    lost = any((np.asarray(b.weights(weigh)) < 1).any() for b in whole)  # most logs have no spike
    return task.begin(task.summary(weigh)) if lost else clean
