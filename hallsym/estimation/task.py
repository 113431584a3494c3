"""One fit as it goes round: solve summaries, tabulate errors, take outliers out, refuse what is wrong."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hallsym.estimation import covariance as uncertainty
from hallsym.estimation import outliers, start
from hallsym.estimation.calibration import Errors
from hallsym.estimation.channel_assignment import check_wiring
from hallsym.estimation.decoding import columns_of, error_tables
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.optimum import Solution, search
from hallsym.estimation.run_statistics import Summary, summarise
from hallsym.log import Log, Noise
from hallsym.log.batches import Weigh, remembered
from hallsym.log.phase import designed, nearest_turn
from hallsym.model import Model

Progress = Callable[[str], None]
SUSPECT = 6.5
"""Peak error in noise floors above which outliers are looked for."""
ROUNDS = 12
"""Of taking outliers out and fitting again, at most."""


@dataclass(frozen=True, eq=False)
class Started(Solution):
    """A solved fit of run summaries, with what it was started and is checked with."""

    linear: start.LinearFit
    merged: Cost
    closed_form: np.ndarray


@dataclass(frozen=True, eq=False)
class Task:
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
        """Noise by column."""
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

    def errors(self, state: Solution, keep: Weigh | None) -> Errors:
        """Return the errors before and after; `keep`: weight of each sample."""
        versions = [(designed(self.model, state.p), {}), (state.p, state.zeros())]
        variance = state.fitted.reading_variance
        before, after = error_tables(
            self.log, self.model, versions, variance, keep, self.counting("tabulating errors"), self.sigmas
        )
        return Errors(before, after, state.holdout)

    def suspicious(self, state: Solution, errors: Errors) -> bool:
        """Return whether some error is too large for the noise floor."""
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

    def weigh(self, state: Solution, loss: str, suspects: Weigh) -> Weigh:
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
