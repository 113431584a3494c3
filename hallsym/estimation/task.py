"""The iterations of one fit: solve, tabulate errors, reject outliers, check the log and the values found."""

import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, cached_property
from importlib import metadata
from time import perf_counter

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import outliers
from hallsym.estimation.calibration import (
    Fit,
    GaugeRecord,
    LogRecord,
    LowerBound,
    SolverRecord,
    calibrated,
)
from hallsym.estimation.covariance import Samples, Uncertainty, uncertainty
from hallsym.estimation.decoding import (
    Errors,
    ErrorTable,
    error_tables,
    logged_columns,
    nominal_variance,
    residuals,
)
from hallsym.estimation.factors import RunStatistics, exact, pseudo_inverse, summarise, unit_scale
from hallsym.estimation.goodness_of_fit import (
    WORTH_REPORTING,
    GoodnessOfFit,
    diagnose_command,
    goodness_of,
    limit_of,
    noise_followed,
    uncertain,
    with_noise,
)
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Cost, Point, cost_near, cost_of, deviations_of
from hallsym.estimation.optimum import DROP, LinearFit, Solution, linear_fit, optimum
from hallsym.families import adapted, added_effects, build, default_model, plain
from hallsym.families.recording import Correction, corrected
from hallsym.log import Fault, Log, Noise, estimate_noise, usable
from hallsym.log.batches import Weigh, remembered
from hallsym.log.core import Drop, without
from hallsym.log.phase import at_rest, continuous, designed, home_notes
from hallsym.log.quality.values import repeated
from hallsym.model import Inspection, Model
from hallsym.output import Step


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
    return build(name, meta=log.described, added=tuple(effects), parameters=parameters, own=own)


def checked(
    log: Log, model: Model, asked: "Asked", corrections: Sequence[Correction], accept: Sequence[str] = ()
) -> tuple[Log, list[str]]:
    """Return a log without its mistakes and bad samples, and notes on it.

    `accept`: claims beside those that the user accepts, whose samples stay.
    """
    return usable(
        at_rest(corrected(log, corrections), model), logged_columns(model), drop_bad=asked.drop_bad,
        accept=(*asked.accept, *accept),
    )  # fmt: skip


def held_out(log: Log, holdout: Sequence[int]) -> tuple[int, ...]:
    """Return holdout runs, all of them in the log and not all of the log. Raises `InputError` for others."""
    if not holdout:
        return ()
    runs = log.runs
    if unknown := [run for run in holdout if run not in runs]:
        known = ", ".join(map(str, runs)) if len(runs) <= 8 else f"{runs[0]}, {runs[1]}, ... {runs[-1]}"
        raise InputError(f"Holdout run {unknown[0]} is not in the log; its runs are {known}.")
    if set(runs) <= set(holdout):
        raise InputError("All runs are holdout runs; leave at least one to fit.")
    return tuple(holdout)


Progress = Callable[[str], None]


def silent(_: str) -> None:
    """Report no progress."""


LEAST_SIGMA = 1e-13
"""Standard deviation [m] given to a reading that shows no noise at all (a noise-free simulation)."""
SUSPECT = 6.5
"""Peak error in noise floors above which outliers are looked for."""
BEGIN = (2 / 3, 1 / 3)
"""Starts of a parameter without effect at its nominal value: parts of the way to its upper bound. Two thirds
of a share of up to 1.5 is all of it."""
QUICKLY_KNOWN = 1.06
"""Residual over estimated noise above which a log is examined in full: three times its 1.2 %, and up to 3 %
by which the least of several estimates is below their mean."""


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
class Asked:
    """The arguments of a fit; see `fit`."""

    solver: str = "direct"
    holdout: Sequence[int] | None = None
    loss: str = "none"
    corrections: tuple[Correction, ...] = ()
    drop_bad: bool = False
    seed: int = 0
    start: np.ndarray | None = None
    quick: bool = False
    accept: tuple[str, ...] = ()
    """Names of claims whose samples stay."""
    say: Progress = silent


@dataclass(frozen=True, eq=False)
class Begun:
    """The costs of all runs, of the fitted ones and of these merged, and the linear fit of the last."""

    everything: Cost
    fitted: Cost
    merged: Cost
    linear: LinearFit

    @property
    def samples(self) -> float:
        """How many samples count."""
        return float(self.everything.summary.counts.sum())


@dataclass(frozen=True, eq=False)
class Task:
    """The constants of the iterations of a fit.

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
        return noise_of(self.log, self.model, self.holdout).merged(self.known_noise)

    def by_passes(self, first: Fit | None) -> "tuple[Task, Solution, Weigh | None]":
        """Fit a model without run statistics, from `first`: the fit of the model without its effects.

        Returns also the task with the residual noise, and the weights that `first` gave but for samples that
        the whole model describes: these are no spikes, as the corners that a rail cuts.
        """
        task, keep, begin = self, None, self.model.nominal
        if self.model.guess is not None and first is None:
            begin = self.model.vector(self.model.guess(self.model, self.log))
        if first is not None:
            task, keep = replace(self, known_noise=first.noise), first.keep
            known = first.model.named(first.values)
            begin = self.model.vector({n: v for n, v in known.items() if n in self.model.names})
        begin = begin if self.asked.start is None else self.asked.start
        state = task.passes(begin, keep)
        if first is not None:
            state = task.elsewhere(state, first.model.names, keep)
        if (noise := noise_followed(task.log, state.point, task.noise, keep)) is not None:
            task = replace(task, log=replace(task.log, noise=noise))
            state = task.passes(state.p, keep)
        if first is not None and keep is not None:
            keep = task.undescribed(state, keep)
            state = task.passes(state.p, keep)
        return task, state, keep

    def passes(self, begin: np.ndarray, keep: Weigh | None) -> Solution:
        """Return the optimum that passes over the log reach from `begin` (n,)."""
        return optimum(self.log, self.model, self.noise.std, begin, self.holdout, keep, self.asked.say)

    def undescribed(self, state: Solution, keep: Weigh) -> Weigh:
        """Return weights that leave out those samples of `keep` that are spikes of this residual too."""
        rows, measured = self.log.rows, (*self.model.references, *self.model.channels)
        rule = self.weigh(state, remembered(outliers.column_spikes(measured), rows, measured))
        return remembered(lambda block: np.maximum(keep(block), rule(block)), rows, measured)

    def elsewhere(self, state: Solution, known: Sequence[str], keep: Weigh | None) -> Solution:
        """Return a better optimum from starts at which parameters without effect at the optimum act.

        A rail that the model does not reach has no slope.
        `known`: parameters of the model without its effects.
        """
        lower, upper = self.model.bounds
        free = [
            k for k in state.determination.fixed if self.model.names[k] not in known and lower[k] < upper[k]
        ]
        for share in BEGIN if free else ():
            begin = state.p.copy()
            begin[free] = self.model.nominal[free] + share * (upper - self.model.nominal)[free]
            other = self.passes(begin, keep)
            if other.search.cost < state.search.cost - DROP * abs(state.search.cost):
                return other
        return state

    def in_order(self, state: Solution) -> bool:
        """Return whether the run statistics show that no run has more than noise in any channel.

        They miss only small faults: an isolated spike of s sigma among the n samples of a run raises the mean
        square of its channel by s^2 / n, and is found where that is significant. Estimated noise is replaced
        by the residual noise of all runs, which is more accurate.
        """
        seen = self.goodness(state)
        left = seen.cost_per_degree_of_freedom**0.5 if seen.noise_estimated else 1.0
        return (
            seen.sentence is None
            and 1 / QUICKLY_KNOWN <= left <= QUICKLY_KNOWN
            and seen.worst_least <= max(left, 1.0)
        )

    def goodness(self, state: Solution) -> GoodnessOfFit:
        """Return the goodness of fit."""
        fit = goodness_of(state.point, len(state.p) - len(state.determination.not_free))
        known = uncertain(state.point, self.noise, self.log.meta.gap_length_scale_m)
        return fit.judged(known, self.log.meta.gap_threshold_rel)

    def counting(self, what: str) -> Callable[[int], None] | None:
        """Return a progress callback for the share of the log that is done; None without a listener."""
        if self.asked.say is silent:
            return None
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
        return Begun(everything, fitted, merged, linear_fit(merged))

    def errors(self, state: Solution, keep: Weigh | None) -> Errors:
        """Return the errors before and after; `keep`: weight of each sample."""
        versions = [(state.p, state.offsets()), (designed(self.model, state.p), {})]
        variance = state.fitted.reading_variance
        variances = np.array([variance, nominal_variance(self.model, variance)])

        def tables(which: slice, say: Callable[[int], None] | None = None) -> list[ErrorTable]:
            return error_tables(
                self.log, self.model, versions[which], variances[which], keep, say, self.noise.std,
                computed_at=state.p,
            )  # fmt: skip

        try:  # in memory a further pass costs no more; else a file is read again
            at_once = slice(1 if self.log.table.in_memory else 2)
            fitted, *nominal = tables(at_once, self.counting("tabulating errors"))
        except InputError as error:
            said = self.goodness(state).sentence
            raise InputError(f"{said.partition('; next')[0]}; {error}" if said else error) from error
        return Errors(fitted, self.holdout, lambda: (nominal or tables(slice(1, 2)))[0])

    def suspicious(self, state: Solution, errors: Errors) -> bool:
        """Return whether some error is too large for the noise floor."""
        floor = np.array(list(state.noise_floor.values()))
        return bool(np.any(errors.fitted.peak.max(axis=0) > SUSPECT * floor))

    def weigh(self, state: Solution, suspects: Weigh) -> outliers.Filter:
        """Return weights that reject outliers by the residuals of the fit so far."""
        residual = residuals(self.model, state.p, state.offsets())
        covariance = state.point.covariance.mean(axis=0)
        return outliers.reject_spikes(residual, covariance, suspects, self.model.channels)


def without_spikes(fit: Fit, log: Log) -> outliers.Filter:
    """Return weights that leave out isolated spikes of the fit's residual on a log."""
    model, cost = fit.model, cost_near(log, fit.model, fit.values, fit.noise.std)
    seen, none = cost.summary, np.zeros(len(model.offsets))
    read = np.array([fit.offsets.get(run, none) for run in seen.runs])
    offsets = dict(zip(seen.runs, read / model.zero_scale(fit.values, seen.first_state), strict=True))
    suspects = outliers.column_spikes((*model.references, *model.channels))
    covariance = cost.at(fit.values).covariance.mean(axis=0)
    return outliers.reject_spikes(residuals(model, fit.values, offsets), covariance, suspects, model.channels)


@dataclass(eq=False)
class LogFit:
    """The fit of one log during its iterations, and its result.

    `given`: the log as it was logged, without the mistakes `corrections`: those that were asked for, and the
    sign of a sensor that is mounted the other way round. `keep`: weights that reject outliers. `begun`: its
    costs so far, of a model with run statistics. `errors`: None for a quick fit without faults.
    """

    task: Task
    given: Log
    corrections: tuple[Correction, ...]
    notes: tuple[str, ...]
    keep: Weigh | None = None
    begun: Begun = field(init=False)
    solution: Solution = field(init=False)
    errors: Errors | None = None

    @property
    def samples(self) -> Samples:
        """The samples that were fitted."""
        return Samples(self.task.log, self.task.noise.std, self.keep)


def opened(
    log: Log,
    model: Model,
    asked: Asked,
    *,
    several: bool = False,
    judged: bool = False,
    centre: np.ndarray | None = None,
) -> LogFit:
    """Check a log, without its mistakes, before it is fitted. Raises `InputError` for one that cannot be.

    `several`: with others, so that holdout runs may be theirs. `judged`: it takes no part in the fit.
    """
    good, notes = checked(log, model, asked, asked.corrections)
    mounted = model.inspect(model, good) if model.inspect else Inspection()
    reversal = (Correction("sign", mounted.inverted),) if mounted.inverted else ()
    given = corrected(good, reversal)
    read = continuous(given, model)
    holdout = log.meta.holdout if asked.holdout is None else tuple(asked.holdout)
    holdout = tuple(r for r in holdout if r in read.runs) if several else holdout
    task = Task(read, model, () if judged else held_out(read, holdout), asked, centre=centre)
    return LogFit(task, given, (*asked.corrections, *reversal), (*notes, *mounted.notes))


COLLINEAR = 1e-8
"""Eigenvalue, over the largest, below which features repeat each other: to four digits, beyond which the sum
of squares that they explain is rounding."""


def lower_bound(point: Point, estimated: int) -> LowerBound | None:
    """Return the lower bound of the cost for the optimum at `point`, where `estimated` parameters were free.

    Offsets of a run that multiply a changing state are free here too. None where there are as many free
    coefficients as readings.
    """
    cost, summary, z = point.cost, point.cost.summary, point.cost.summary.features.n_zero
    K, left, products = len(cost.reading_variance), point.squares, point.feature_products
    grams, squares, rank = cost.grams, left, 0
    if z:
        inner = pseudo_inverse(grams[:, :z, :z], COLLINEAR)
        rank = int(np.round(np.einsum("rij,rji->r", inner, grams[:, :z, :z])) @ (cost.weights > 0))
        across = inner @ np.concatenate([grams[:, :z, z:], products[:, :z]], axis=2)
        squares = squares - np.swapaxes(products[:, :z], 1, 2) @ across[:, :, -K:]
        products = products[:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, -K:]
        grams = grams[:, z:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, :-K]
    W = point.W * cost.weights[:, None, None]
    f = grams.shape[-1]
    H = np.tensordot(W, grams, axes=(0, 0)).transpose(0, 2, 1, 3).reshape(K * f, K * f)
    g = np.swapaxes(products @ W, 1, 2).sum(axis=0).ravel()
    unit = unit_scale(H)
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    some = values > COLLINEAR * values.max(initial=0.0)
    gains = np.square((unit * g) @ vectors[:, some]) / values[some]
    bound, free = float(np.einsum("rij,rji->", W, squares) - gains.sum()), int(some.sum())
    readings = float(cost.weights @ summary.counts) * K
    offsets = len(summary.model.offsets) * int(np.sum(cost.weights > 0))
    over = readings - rank * K - free
    if over < 1 or not bound > 0:
        return None
    expected = max((readings - estimated - offsets) / over, 1.0)
    ratio = max(point.value / bound, 1.0)
    near = ratio <= expected * limit_of(1.0, WORTH_REPORTING) ** 2
    return LowerBound(bound, ratio, expected, free, near)


def result_of(solved: LogFit, began: float) -> Fit:
    """Return the fit that is handed out; `began`: when, by `perf_counter`."""
    state, found = solved.solution, solved.solution.determined
    point = state.point
    estimate = uncertainty(point, found, [solved.samples])
    asked = solved.errors is not None  # a quick fit without faults needs no further evidence
    bound = lower_bound(point, estimate.fitted) if asked and exact(solved.task.model) else None
    return fit_of(solved, found, estimate, bound, began)


def fit_of(
    solved: LogFit,
    found: Determination,
    estimate: Uncertainty,
    bound: LowerBound | None,
    began: float,
) -> Fit:
    """Return the fit of a solved log, with the identifiability and uncertainty of its parameters."""
    task, state, errors = solved.task, solved.solution, solved.errors
    model = task.model
    path = task.log.path
    whole = (
        path.parent if path is not None and path.is_file() and task.log.meta.raw else path
    )  # a folder with its meta.json
    command = diagnose_command(whole, model, added_effects(model))
    offsets = deviations_of(state.everywhere)
    delta = np.array(list(offsets.values()))
    return calibrated(
        model,
        state.p,
        estimate.std,
        estimate.covariance,
        method=estimate.method,
        reason=estimate.reason,
        determined=estimate.determined,
        degrees_of_freedom=estimate.degrees_of_freedom,
        fixed=tuple(model.names[k] for k in found.fixed),
        structural=found.structural,
        gauges=tuple(GaugeRecord(g.text, g.parameters, name) for g, name in found.gauges_of(model)),
        at_bound=estimate.at_bound,
        combinations=estimate.combinations,
        offsets=offsets,
        noise=task.noise,
        noise_floor=state.noise_floor,
        status=state.search.status,
        message=state.search.message,
        solver=SolverRecord(
            name=task.asked.solver,
            loss=task.asked.loss,
            cost=state.search.cost,
            cost_per_degree_of_freedom=estimate.goodness.cost_per_degree_of_freedom,
            evaluations=state.search.evaluations,
            starts=state.search.starts,
            share_at_optimum=state.search.share,
            seed=task.asked.seed,
            lower_bound=bound,
        ),
        log=LogRecord(
            path=None if task.log.path is None else str(task.log.path),
            rows=task.log.rows,
            runs=len(state.everything.summary.runs),
            holdout=tuple(task.holdout),
            span=errors.fitted.span if errors else {},
        ),
        seconds=perf_counter() - began,
        goodness=replace(
            with_noise(estimate.goodness, task.log, state.point, task.noise, solved.keep),
            next_command=command,
        ),
        notes=(
            *solved.notes,
            *(left_out(task.log.rows, state.everything) if solved.keep else ()),
            *zero_notes(model, tuple(offsets), delta),
            *(home_notes(task.log, model, offsets) if errors else ()),
        ),
        errors=errors,
        keep=solved.keep,
        source=task.log,
        likelihood=state.fitted,
        determination=found,
        undetermined_by_log=estimate.undetermined_by_log,
        corrections=solved.corrections,
        reversed=bool(solved.corrections) and not task.asked.corrections,
        columns=dict(task.log.table.mapping),
        read_with=dict(task.log.table.source.read_with),
        versions=dict(versions_used()),
        error_rows=errors or {},
    )


SPIKES = "isolated spikes and were left out of fit and error tables (--loss none keeps them)."


def left_out(rows: int, everything: Cost) -> tuple[str, ...]:
    """Return a note on the samples of `rows` that a fit left out."""
    gone = round(rows - float(everything.summary.counts.sum()))
    return (f"{gone} of {rows} samples ({100 * gone / rows:.2g} %) are {SPIKES}",) if gone else ()


def zero_notes(model: Model, runs: Sequence[int], delta: np.ndarray) -> tuple[str, ...]:
    """Zero deviations beyond their bounds are reported, not clipped: clipping would bend the parameters."""
    out = []
    for k, zero in enumerate(model.offsets):
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
def versions_used() -> dict[str, str]:
    """Return the versions of what computed a result."""
    packages = ("hallsym", "casadi", "numpy", "scipy")
    found = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return {"python": platform.python_version(), **found}


# -- claims on the values of a fit -----------------------------------------------------------------------


PRESSED = 5.0
"""Standard uncertainties by which the score must press a parameter against its bound: once in 10^6 by
chance."""
FAR = 0.25
"""Part of the width of its bounds that a parameter would go beyond them although fixed ones could compensate:
a position or an angle that is not at its nominal value moves others by less."""
ALONE = 1e-6
"""Part of a parameter's information that must remain with the fixed parameters free."""


def implausible(fit: Fit) -> list[Fault]:
    """Return claims on implausible values, and on columns at a lower rate where they leave an excess."""
    amiss = fit.goodness and fit.goodness.sentence
    slow = repeated(fit.source, logged_columns(fit.model)) if fit.source and amiss else ()
    return [*slow, *_at_bounds(fit), *fit.model.family.implausible(fit)]


def stated(fit: Fit) -> bool:
    """Return whether the log or the user states where the sensors of the machine are."""
    meta, family = fit.source.meta if fit.source else None, fit.model.family
    if meta is None or meta.probes is not None or any(table in meta.raw for table in family.tables):
        return True
    usual = [m for m in family.models if getattr(m, "__name__", "") == plain(fit.model).name]
    return not usual or usual[0]().layout != fit.model.layout


def _at_bounds(fit: Fit) -> Iterator[Fault]:
    """Yield one claim for each of the family's groups of parameters that the log presses against bounds."""
    left = pressed(fit)
    for claim, pattern, text in (*fit.model.family.at_bounds, ("bounds", "*", OTHERS)):
        group = [name for name in left if fnmatchcase(name, pattern)]
        left = [name for name in left if name not in group]
        if group:
            values = ", ".join(f"{name} = {fit.value(name):.4g}" for name in group)
            yield Fault(f"{values}: {text}.", claim)


OTHERS = (
    "at the bounds of the plausible range, so other parameters compensate for it; widen the bounds "
    "(--machine FILE) if it can, or look for what is wrong with the recording"
)


def pressed(fit: Fit) -> list[str]:
    """Return the parameters at a bound that would go beyond it, all others re-optimised.

    By a score test of the fit's cost, its information scaled by the residual. A parameter that fixed ones can
    compensate must go far beyond.
    """
    if fit.likelihood is None or not fit.at_bound:
        return []
    names = fit.model.names
    point = fit.likelihood.at(fit.values)
    score = 0.5 * (fit.likelihood.weights @ point.run_gradients)
    information = point.total_information()
    ends = [names.index(n) for n in fit.at_bound]
    fixed = [names.index(n) for n in fit.not_free]
    free = [k for k in np.flatnonzero(fit.determined).tolist() if k not in (*ends, *fixed)]
    scale = max(fit.solver.cost_per_degree_of_freedom, 1.0)
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    whitened = information / np.outer(size, size)

    def own(k: int, others: list[int]) -> float:
        across = whitened[k, others]
        return float(1.0 - across @ np.linalg.lstsq(whitened[np.ix_(others, others)], across)[0])

    out = []
    for k in ends:
        curvature = own(k, free) * size[k] ** 2
        if curvature <= 0 or score[k] ** 2 <= PRESSED**2 * scale * curvature:
            continue
        far = abs(score[k]) / curvature > FAR * fit.model.parameters[k].width
        if far or own(k, [*free, *fixed]) > ALONE:
            out.append(names[k])
    return out
