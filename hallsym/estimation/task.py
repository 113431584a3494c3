"""One fit as it goes round: solve, tabulate errors, take outliers out, refuse what is wrong."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import outliers, start
from hallsym.estimation.calibration import Errors, Fit
from hallsym.estimation.decoding import error_tables, knows_rails, logged_columns, nominal_variance
from hallsym.estimation.gauss_newton import DROP, optimum
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, goodness_of, noise_floor, uncertain
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.optimum import Solution
from hallsym.estimation.plausible import Judgement, Wiring, as_read, judge, rewired, wiring_of
from hallsym.estimation.residual_noise import noise_followed
from hallsym.estimation.run_statistics import RunStatistics, summarise
from hallsym.families import adapted, build, default_model
from hallsym.log import Log, Noise, estimate_noise, usable
from hallsym.log.batches import Weigh
from hallsym.log.core import Drop, without
from hallsym.log.phase import continuous, designed
from hallsym.model import Inspection, Model
from hallsym.terminal import Step


def model_of(
    log: Log,
    model: str | Model | None,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
) -> Model:
    """Return the model that is fitted to a log; arguments as for `fit`."""
    if isinstance(model, Model):
        return adapted(model, tuple(effects), parameters or {}, own)
    name = model or default_model(log.meta)
    return build(name, meta=log.meta, added=tuple(effects), parameters=parameters, own=own)


def prepared(log: Log, model: Model, *, drop_bad: bool) -> tuple[Log, tuple[str, ...], Inspection]:
    """Return a log that was checked, as its model reads it, what there is to say, and how it is mounted.

    `drop_bad`: leave out bad samples. Raises `InputError` for logs that cannot be fitted.
    """
    log, notes = usable(log, logged_columns(model), drop_bad=drop_bad, rails=not knows_rails(model))
    mounted = model.inspect(model, log) if model.inspect else Inspection()
    notes = [*notes, *mounted.notes]
    return as_read(log, model, mounted.wiring), tuple(notes), mounted


def held_out(log: Log, holdout: Sequence[int]) -> tuple[int, ...]:
    """Return held-out runs, all of them in the log and not all of the log. Raises `InputError` for others."""
    runs = log.runs
    if unknown := [run for run in holdout if run not in runs]:
        known = ", ".join(map(str, runs)) if len(runs) <= 8 else f"{runs[0]}, {runs[1]}, ... {runs[-1]}"
        raise InputError(f"Held-out run {unknown[0]} is not in the log; its runs are {known}.")
    if holdout and set(log.runs) <= set(holdout):
        raise InputError("Every run is held out; leave at least one to fit.")
    return tuple(holdout)


Progress = Callable[[str], None]
LEAST_SIGMA = 1e-13
"""Standard deviation [m] given to a reading that shows no noise at all (a noise-free simulation)."""
SUSPECT = 6.5
"""Peak error in noise floors above which outliers are looked for."""
BEGIN = (2 / 3, 1 / 3)
"""Where a parameter begins that did nothing at its nominal value: parts of the way to its upper bound. Two
thirds of a share of up to 1.5 is all of it."""
SPIKY = 1e-3
"""Share of samples that are spikes from which on slopes are judged after the fit, without them."""
QUICKLY_KNOWN = 1.06
"""Residual over a noise that was estimated quickly from which on a log is looked at in full: three times its
1.2 %, and up to 3 % by which the least of several estimates is below their mean."""


def noise_of(log: Log, model: Model | None, holdout: Sequence[int] = (), *, quick: bool = False) -> Noise:
    """Return the noise of every column a model uses (all columns without one): given, else estimated.

    Runs in `holdout` take no part in the estimate.
    """
    columns = logged_columns(model) if model else tuple(c for c in log.columns if c not in ("run", "t_s"))
    columns = tuple(c for c in columns if c != "t_s")
    log = continuous(log, model) if model else log
    missing = [c for c in columns if c not in log.noise]
    used = without(log, Drop(runs=frozenset(holdout))) if missing and holdout else log
    noise = log.noise.merged(estimate_noise(used, missing, quick=quick)) if missing else log.noise
    sigmas = {c: noise[c] for c in columns}
    for c in model.channels if model else ():
        sigmas[c] = replace(sigmas[c], value=max(sigmas[c].value, LEAST_SIGMA))
    return Noise(sigmas)


@dataclass(frozen=True, eq=False)
class Asked:
    """How a fit was asked for; see `fit`."""

    solver: str = "direct"
    holdout: Sequence[int] | None = None
    loss: str = "none"
    resolve_wiring: bool = False
    drop_bad: bool = False
    seed: int = 0
    start: np.ndarray | None = None
    quick: bool = False
    say: Progress = lambda _: None


@dataclass(frozen=True, eq=False)
class Begun:
    """The costs of all runs, of the fitted ones and of these merged, and the linear fit of the last."""

    everything: Cost
    fitted: Cost
    merged: Cost
    linear: start.LinearFit

    @property
    def samples(self) -> float:
        """How many samples count."""
        return float(self.everything.summary.counts.sum())


@dataclass(eq=False)
class Opened:
    """A log that takes part: its costs so far, what was judged by them, taken out, and is to be said.

    `given`, `found`: the log and its judgement before channels were put in order.
    """

    task: "Task"
    begun: Begun
    judged: Judgement
    given: Log
    found: Judgement
    wiring: Wiring | None
    mounted: Wiring | None = None
    notes: tuple[str, ...] = ()
    keep: Weigh | None = None

    def solved(self, solution: Solution, errors: Errors | None) -> "Solved":
        """Return how it ended."""
        return Solved(self.task, solution, errors, self.keep, self.wiring, self.mounted, self.notes)


@dataclass(frozen=True, eq=False)
class Solved:
    """How the fit of a log ended.

    `errors`: None where nothing was amiss and nobody asked. `keep`: weights that took outliers out.
    `wiring`: None where the channels are in order; `mounted`: that which an inspection found before.
    """

    task: "Task"
    solution: Solution
    errors: Errors | None
    keep: Weigh | None = None
    wiring: Wiring | None = None
    mounted: Wiring | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Task:
    """What stays the same while the fit of a log goes round.

    `holdout`: runs that take no part. `known_noise`: of columns that the log neither states nor shows.
    `centre`: of the features, where other logs are fitted with this one; else the log's own.
    """

    log: Log
    model: Model
    holdout: tuple[int, ...]
    asked: Asked
    known_noise: Noise = field(default_factory=Noise)
    centre: np.ndarray | None = None

    @cached_property
    def noise(self) -> Noise:
        """Noise by column, with its source."""
        return noise_of(self.log, self.model, self.holdout, quick=self.asked.quick).merged(self.known_noise)

    def opened(self) -> Opened:
        """Return the costs of the log, judged, with its channels put in order where that is asked for."""
        task, begun = self, self.begin(self.summary())
        judged = found = self.judged(begun)
        wiring = wiring_of(judged.whole) if self.asked.resolve_wiring else None
        if wiring is not None:
            task = replace(self, log=rewired(self.log, self.model.channels, wiring))
            begun = task.begin(task.summary())
            judged = task.judged(begun).resolved(judged)
        judged.refuse()
        return Opened(task, begun, judged, self.log, found, wiring)

    def by_passes(self, first: Fit | None, notes: tuple[str, ...], mounted: Wiring | None) -> Solved:
        """Fit a model without run statistics, from `first`: the fit of what it is without its effects."""
        task, keep, begin = self, None, self.model.nominal
        if self.model.guess is not None and first is None:
            begin = self.model.vector(self.model.guess(self.model, self.log))
        if first is not None:
            log = rewired(self.log, self.model.channels, first.wiring)
            task = replace(self, log=log, known_noise=first.noise)
            # the corners that a rail cuts look like spikes to a model that knows of none
            keep = None if knows_rails(self.model) else first.keep
            known = first.model.named(first.values)
            begin = self.model.vector({n: v for n, v in known.items() if n in self.model.names})
        begin = begin if self.asked.start is None else self.asked.start
        state = task.passes(begin, keep)
        if first is not None:
            state = task.elsewhere(state, first.model.names, keep)
        if (noise := noise_followed(task.log, state.point, task.noise, keep)) is not None:
            task = replace(task, log=replace(task.log, noise=noise))
            state = task.passes(state.p, keep)
        wiring = first.wiring if first else None
        return Solved(task, state, task.errors(state, keep), keep, wiring, mounted, notes)

    def passes(self, begin: np.ndarray, keep: Weigh | None) -> Solution:
        """Return the optimum that passes over the log reach from `begin` (n,)."""
        return optimum(self.log, self.model, self.noise.std, begin, self.holdout, keep, self.asked.say)

    def elsewhere(self, state: Solution, known: Sequence[str], keep: Weigh | None) -> Solution:
        """Return a better optimum that begins where parameters of effects that seemed to do nothing act.

        A rail that the model does not reach is not felt: what it cuts has no slope where nothing is cut.
        `known`: parameters of the model without its effects.
        """
        lower, upper = self.model.bounds
        free = [
            k for k in state.determination.held if self.model.names[k] not in known and lower[k] < upper[k]
        ]
        for share in BEGIN if free else ():
            begin = state.p.copy()
            begin[free] = self.model.nominal[free] + share * (upper - self.model.nominal)[free]
            other = self.passes(begin, keep)
            if other.search.cost < state.search.cost - DROP * abs(state.search.cost):
                return other
        return state

    def in_order(self, state: Solution) -> bool:
        """Return whether the run statistics show that no run leaves more than noise in any channel.

        What they do not show is too small to matter: an isolated spike of s sigma among the n samples of a
        run raises the mean square of its channel by s^2 / n, and is found where that is more than chance.
        Where noise was estimated, that is beside the noise that all runs leave, which knows it better.
        """
        told = self.goodness(state)
        left = told.cost_per_degree_of_freedom**0.5 if told.noise_estimated else 1.0
        return (
            told.sentence is None
            and 1 / QUICKLY_KNOWN <= left <= QUICKLY_KNOWN
            and told.worst_least <= max(left, 1.0)
        )

    def goodness(self, state: Solution) -> GoodnessOfFit:
        """Return what a fit leaves, in multiples of the noise."""
        fit = goodness_of(state.point, len(state.p) - len(state.determination.held))
        known = uncertain(state.point, self.noise, self.log.meta.gap_length_scale_m)
        return fit.judged(known, self.log.meta.gap_threshold_rel)

    def counting(self, what: str) -> Callable[[int], None]:
        """Return a progress callback that says which share of the log is done."""
        total = self.log.rows
        self.asked.say(what)
        return lambda rows: self.asked.say(
            Step(f"{what}, {100 * rows // total} % of {total} samples", rows / total)
        )

    def summary(self, weigh: Weigh | None = None) -> RunStatistics:
        """Return the run statistics of the log."""
        return summarise(self.log, self.model, weigh, self.counting("summarising runs"), self.centre)

    def begin(self, summary: RunStatistics) -> Begun:
        """Return what linear least squares says of one set of run statistics."""
        everything = cost_of(summary, self.noise.std)
        fitted = everything.without(self.holdout)
        merged = cost_of(fitted.summary.merged(), self.noise.std)
        return Begun(everything, fitted, merged, start.linear_fit(merged))

    def judged(self, begun: Begun) -> Judgement:
        """Judge units, signs and runs before the fit; spikes bend slopes: where there are any, after it."""
        found = self.judge(begun)
        if not found.findings:
            return found
        columns = (*self.model.references, *self.model.channels)
        again = self.begin(self.summary(outliers.column_spikes(columns)))
        if again.samples >= (1 - SPIKY) * begun.samples:
            return found
        return self.judge(again) if self.asked.loss == "none" else Judgement(spiky=True)

    def judge(self, begun: Begun) -> Judgement:
        """Judge units, signs and runs by what linear least squares says."""
        return judge(self.log, begun.everything, begun.merged, begun.linear, self.holdout)

    def errors(self, state: Solution, keep: Weigh | None) -> Errors:
        """Return the errors before and after; `keep`: weight of each sample."""
        versions = [(designed(self.model, state.p), {}), (state.p, state.zeros())]
        variance = state.fitted.reading_variance
        variance = np.array([nominal_variance(self.model, variance), variance])
        say = self.counting("tabulating errors")
        try:
            before, after = error_tables(self.log, self.model, versions, variance, keep, say, self.noise.std)
        except InputError as error:
            said = self.goodness(state).sentence
            raise InputError(f"{said.partition('; next')[0]}; {error}" if said else error) from error
        return Errors(before, after, self.holdout)

    def suspicious(self, state: Solution, errors: Errors) -> bool:
        """Return whether some error is too large for the noise floor."""
        floor = np.array(list(noise_floor(state.point).values()))
        return bool(np.any(errors.fitted.peak.max(axis=0) > SUSPECT * floor))

    def weigh(self, state: Solution, suspects: Weigh) -> outliers.Filter:
        """Return what takes outliers out, judged by the residuals of the fit so far."""
        residual = outliers.residuals(self.model, state.p, state.zeros())
        covariance = state.point.covariance.mean(axis=0)
        if self.asked.loss == "tukey":
            return outliers.tukey(residual, covariance)
        return outliers.reject_spikes(residual, covariance, suspects, self.model.channels)
