"""One fit as it goes round: solve, tabulate errors, take outliers out, refuse what is wrong."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hallsym.estimation import outliers, start
from hallsym.estimation.calibration import Errors, Fit
from hallsym.estimation.channel_assignment import Wiring, check_wiring, find_wiring, rewired
from hallsym.estimation.covariance import noise_floor
from hallsym.estimation.decoding import columns_of, error_tables, logged_columns
from hallsym.estimation.gauss_newton import optimum
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.optimum import Solution, search
from hallsym.estimation.run_statistics import RunStatistics, summarise
from hallsym.log import Log, Noise, estimate_noise
from hallsym.log.batches import Weigh, remembered
from hallsym.log.drop import Drop, without
from hallsym.log.phase import continuous, designed, nearest_turn
from hallsym.model import Model

Progress = Callable[[str], None]
LEAST_SIGMA = 1e-13
"""Standard deviation [m] given to a reading that shows no noise at all (a noise-free simulation)."""
SUSPECT = 6.5
"""Peak error in noise floors above which outliers are looked for."""
ROUNDS = 12
"""Of taking outliers out and fitting again, at most."""


def noise_of(log: Log, model: Model | None, holdout: Sequence[int] = ()) -> Noise:
    """Return the noise of every column a model uses (all columns without one): given, else estimated.

    Runs in `holdout` take no part in the estimate.
    """
    columns = logged_columns(model) if model else tuple(c for c in log.columns if c not in ("run", "t_s"))
    columns = tuple(c for c in columns if c != "t_s")
    log = continuous(log, model) if model else log
    missing = [c for c in columns if c not in log.noise]
    used = without(log, Drop(runs=frozenset(holdout))) if missing and holdout else log
    noise = log.noise.merged(estimate_noise(used, missing)) if missing else log.noise
    sigmas = {c: noise[c] for c in columns}
    for c in model.channels if model else ():
        sigmas[c] = replace(sigmas[c], value=max(sigmas[c].value, LEAST_SIGMA))
    return Noise(sigmas)


@dataclass(frozen=True, eq=False)
class Started(Solution):
    """A solved fit of run statistics, with what it was started and is checked with."""

    linear: start.LinearFit
    merged: Cost
    closed_form: np.ndarray


@dataclass(frozen=True, eq=False)
class Solved:
    """How a task ended.

    `keep`: weights that took outliers out. `wiring`: None where the channels are in order.
    """

    task: "Task"
    solution: Solution
    errors: Errors
    keep: Weigh | None = None
    wiring: Wiring | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Task:
    """What stays the same while a fit goes round.

    `holdout`: runs that take no part. `begin`: (n,) values to begin from, None for the closed form.
    `known_noise`: of columns that the log neither states nor shows.
    """

    log: Log
    model: Model
    holdout: tuple[int, ...]
    solver: str
    loss: str
    seed: int
    say: Progress
    begin: np.ndarray | None
    known_noise: Noise = field(default_factory=Noise)

    @cached_property
    def noise(self) -> Noise:
        """Noise by column, with its source."""
        return noise_of(self.log, self.model, self.holdout).merged(self.known_noise)

    def by_statistics(self, resolve_wiring: bool) -> Solved:
        """Fit run statistics, which hold all that the cost can ask of the log."""
        task, state = self, self.solve(self.summary())
        wiring, gain = find_wiring(state.merged, state.linear) if resolve_wiring else (None, 0.0)
        if gain > 0:
            task = replace(self, log=rewired(self.log, self.model.channels, wiring))
            state = task.solve(task.summary())
        errors, keep, notes = task.errors(state, None), None, tuple[str, ...]()
        if task.suspicious(state, errors) if self.loss == "auto" else self.loss != "none":
            state, keep, notes = task.without_outliers(state)
            errors = task.errors(state, keep) if keep else errors
        task.check(state)
        return Solved(task, state, errors, keep, wiring if gain > 0 else None, notes)

    def by_passes(self, first: Fit | None) -> Solved:
        """Fit a model without run statistics, from `first`: the fit of what it is without its effects."""
        task, keep, begin = self, None, self.model.nominal
        if self.model.guess is not None and first is None:
            begin = self.model.vector(self.model.guess(self.model, self.log))
        if first is not None:
            task, keep = replace(self, log=first.source or self.log, known_noise=first.noise), first.keep
            known = first.model.named(first.values)
            begin = self.model.vector({n: v for n, v in known.items() if n in self.model.names})
        begin = begin if self.begin is None else self.begin
        state = optimum(task.log, task.model, task.noise.std, begin, task.holdout, keep, task.say)
        return Solved(task, state, task.errors(state, keep), keep, first.wiring if first else None)

    def counting(self, what: str) -> Callable[[int], None]:
        """Return a progress callback that says which share of the log is done."""
        total = self.log.rows
        self.say(what)
        return lambda rows: self.say(f"{what}, {100 * rows // total} % of {total} samples")

    def summary(self, weigh: Weigh | None = None) -> RunStatistics:
        """Return the run statistics of the log."""
        return summarise(self.log, self.model, weigh, self.counting("summarising runs"))

    def solve(self, summary: RunStatistics, solver: str | None = None) -> Started:
        """Find the optimum of one set of run statistics."""
        everything = cost_of(summary, self.noise.std)
        fitted = everything.without(self.holdout)
        merged = cost_of(fitted.summary.merged(), self.noise.std)
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
        return Started(everything, fitted, determination, found, linear, merged, closed_form)

    def errors(self, state: Solution, keep: Weigh | None) -> Errors:
        """Return the errors before and after; `keep`: weight of each sample."""
        versions = [(designed(self.model, state.p), {}), (state.p, state.zeros())]
        variance = state.fitted.reading_variance
        before, after = error_tables(
            self.log, self.model, versions, variance, keep, self.counting("tabulating errors"), self.noise.std
        )
        return Errors(before, after, self.holdout)

    def suspicious(self, state: Solution, errors: Errors) -> bool:
        """Return whether some error is too large for the noise floor."""
        floor = np.array(list(noise_floor(state.fitted, state.p).values()))
        return bool(np.any(errors.fitted.peak.max(axis=0) > SUSPECT * floor))

    def without_outliers(self, state: Started) -> tuple[Started, Weigh | None, tuple[str, ...]]:
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
                state = self.solve(summary, solver="direct")
            self.check(state)
            if abs(left - before) <= 1e-6 * total:
                break
            before, weigh = left, self.weigh(state, suspects)
        if left == total:
            return whole, None, ()
        state = self.solve(summary)
        gone = total - left
        said = (
            f"{gone:.0f} of {total:.0f} samples ({100 * gone / total:.2g} %) are isolated spikes and were "
            "left out of fit and error tables (--loss none keeps them)."
            if self.loss != "tukey"
            else f"Tukey's biweight took {100 * gone / total:.2g} % of the weight."
        )
        return state, weigh, (said,)

    def weigh(self, state: Solution, suspects: Weigh) -> Weigh:
        """Return what takes outliers out, judged by the residuals of the fit so far; each block once."""
        residual = outliers.residuals(self.model, state.p, state.zeros())
        covariance = state.fitted.at(state.p).covariance.mean(axis=0)
        if self.loss == "tukey":
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
