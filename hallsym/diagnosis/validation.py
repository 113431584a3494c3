"""Validation: which effects hold on the holdout runs, how far the gap shrinks, the residual.

The shrinkage comes from nested cross-validation. Groups of runs are left out in turn. Without each, every
effect competes again with its rivals, the others in place, and with no effect: BIC on the other runs decides.
The chosen model is moved to the minimum of the other runs by one Gauss-Newton step, and evaluated on the
group. The holdout runs are a group that was left out from the beginning. So every run is evaluated with
models that were neither fitted nor chosen on it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.special import ndtri, stdtrit

from hallsym.diagnosis.curves import LackOfFit, lack_of_fit
from hallsym.diagnosis.decoded_errors import DecodedErrors, decoded_errors
from hallsym.diagnosis.faults import Fault, faults, without_tail
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import LARGER
from hallsym.diagnosis.refit import Refitted, inside_bounds, refit
from hallsym.diagnosis.residuals import FOLDS, Base
from hallsym.diagnosis.scores import bic
from hallsym.diagnosis.selection import REFERENCE, Exact, Selection
from hallsym.diagnosis.setup import Floor, Setup, point_on
from hallsym.diagnosis.survey import Survey, survey
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, ResidualNoise, goodness_of, limit_of

Squares = Mapping[tuple[int, ...], float]
"""Squared decoded errors of each judging run (or of neighbouring runs of a log of very many)."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Squared decoded errors of the judging runs, `before` and `after`, (runs,) each.

    Whole runs are the units, since errors within a run may be correlated.
    """

    before: np.ndarray
    after: np.ndarray
    policy: Policy

    @classmethod
    def of(cls, before: Squares, after: Squares, policy: Policy) -> "Judged":
        """Return two models on the runs that both judge; below `Policy.fewest` there is no interval."""
        runs = [run for run in before if run in after]
        return cls(np.array([before[r] for r in runs]), np.array([after[r] for r in runs]), policy)

    @property
    def value(self) -> float:
        """The shrinkage, 1 - after / before."""
        return 1 - float(np.sqrt(self.after.sum() / max(self.before.sum(), 1e-300)))

    def interval(self, scale: float = 1.0) -> tuple[float, float] | None:
        """Return the 95 % interval of the shrinkage on a new recording of as many runs; None of too few.

        A new recording has these runs in other proportions: if each one improved, any mixture does.
        `scale`: the gap with other repairs over that without them.
        """
        n, outside = len(self.before), self.policy.false_alarm
        if n < self.policy.fewest:
            return None
        mixtures = _mixtures(n, outside)
        ratio = np.sqrt((mixtures @ self.after) / np.maximum(mixtures @ self.before, 1e-300))
        low, high = 1 - scale * np.quantile(ratio, [1 - outside / 2, outside / 2])
        return float(low), float(high)


@lru_cache(maxsize=16)
def _mixtures(n: int, outside: float) -> np.ndarray:
    """Return weights (4000, n) of `n` runs in a new recording: a Bayesian bootstrap (Rubin, 1981).

    100 draws lie beyond each end of a 95 % interval. The concentration gives a mean the variance of Student's
    interval for the difference of two recordings.
    """
    wider = float(stdtrit(n - 1, 1 - outside / 2) / ndtri(1 - outside / 2))
    concentration = ((n - 1) / (2 * wider**2) - 1) / n  # below 6 runs none is so wide: nearly one run alone
    return np.random.default_rng(0).dirichlet(np.full(n, max(concentration, 0.01)), 4000)


def groups_of(runs: Sequence[int]) -> list[frozenset[int]]:
    """Return the groups of the fitted runs that are left out in turn."""
    return [frozenset(runs[k::FOLDS]) for k in range(min(FOLDS, len(runs)))]


def cross_validated(
    fit: Refitted, groups: Sequence[frozenset[int]], others: Sequence[Refitted] = ()
) -> dict[tuple[int, ...], float]:
    """Return the cross-validated (leave-one-group-out) squared decoded errors of each run.

    A fitted run is evaluated with the fit moved to the minimum without its group, or with that of the
    `others` whose BIC on the runs without the group is lower by more than a tie; holdout runs, with `fit`.
    """
    t = fit.tangents
    fitted = set(fit.fitted.tolist())
    out = {t.runs[u]: float(fit.output[u]) for u in range(len(t.runs)) if u not in fitted}
    for group in groups:
        moved = [(*_without(one, group), one) for one in (fit, *others)]
        best = min(moved, key=lambda m: m[0])
        _, v, one = moved[0] if moved[0][0] - best[0] < fit.base.policy.as_good else best
        tested = [u for u in one.fitted if not group.isdisjoint(one.tangents.runs[u])]
        out |= {one.tangents.runs[u]: float(v @ one.decoded[u] @ v) for u in tested}
    return out


def _without(fit: Refitted, group: frozenset[int]) -> tuple[float, np.ndarray]:
    """Return BIC and direction (c,) of a fit moved to the minimum of the runs that are not in a group."""
    t = fit.tangents
    rest = [u for u in fit.fitted if group.isdisjoint(t.runs[u])]
    M = t.likelihood[rest].sum(axis=0)
    v = np.append(-inside_bounds(fit.base, M), 1.0)
    readings = float(t.count[rest].sum()) * len(fit.base.model.channels)
    return float(bic(v @ M @ v, readings, len(fit.base.free), readings)), v


@dataclass(frozen=True, eq=False)
class Validated:
    """A selected effect, with the fit `without` it and the `errors` of that fit on the holdout runs.

    `judged`: all effects against those without it, cross-validated.
    """

    exact: Exact
    without: Refitted
    errors: DecodedErrors
    judged: Judged

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.exact.name

    @property
    def blames(self) -> bool:
        """Whether it says that the reference is wrong, and not the machine."""
        return self.exact.score.effect.link == REFERENCE


@dataclass(frozen=True, eq=False)
class Validation:
    """The effects that hold on the holdout runs, and the residual with them.

    `start`: the fit without effects; `end`: the model with the effects that hold; `fit`: the same, fitted
    without the samples that are faults by themselves.
    Errors on the holdout runs: `before` without effects, `after` with them, `cured` also without faulty
    samples; `metric`: the gap without any fault of samples [m or rad]. `rest`: the structure of the residual
    of `end`. `variance`: of the fitted samples' whitened residual; `inflation`: variance of a slow average
    over that of white noise; `error`: relative standard error of the gap of the holdout runs, for noise of
    this autocorrelation.
    """

    start: Refitted
    end: Base
    fit: Refitted
    effects: tuple[Validated, ...]
    judged: Judged | None
    before: DecodedErrors
    after: DecodedErrors
    cured: DecodedErrors
    metric: float
    rest: LackOfFit
    floor: Floor
    faults: tuple[Fault, ...]
    miswired: bool
    variance: float
    inflation: float
    error: float

    @property
    def base(self) -> Base:
        """The model with the effects that hold, fitted without faulty samples."""
        return self.fit.base

    @property
    def counted(self) -> Base:
        """The same on the samples that the gap counts: all but faulty ones."""
        return self.base if self.cured is not self.after else self.base.on_all

    @property
    def named(self) -> bool:
        """Whether anything is named: an effect, a fault of samples, or a wrong channel assignment."""
        return bool(self.effects or self.faults or self.miswired)


def validate(setup: Setup, selection: Selection) -> Validation:
    """Evaluate on the holdout runs the effects that were selected on the others.

    Faulty samples are left out, and the model is refitted without them.
    """
    before = decoded_errors(setup.as_logged(selection.start.base), setup.holdout)
    effects = _holding(setup, selection, before)
    unchanged = not effects and not setup.miswired
    fit, runs = selection.fit, frozenset(setup.runs)
    after = before if unchanged else decoded_errors(fit.base.on_all, setup.holdout)
    end = fit.base
    whole = survey(end.on_all, runs)
    kept = survey(end, runs) if end.keep else whole
    found = [f for f in faults(end, whole, setup.tested) if cures(f) >= setup.threshold]
    rest = lack_of_fit(end, setup.runs)
    if shaped(setup, rest):  # which may look like late samples here and there
        least = max([rest.tones, *(s.drop for s in rest.shapes)])
        found = [f for f in found if f.name != "clock_jitter" and cures(f) >= least]
    cured = after
    if any(f.record.rare for f in found):
        fit = refit(replace(end, keep=without_tail(end)), setup.runs)
        cured = decoded_errors(fit.base, setup.holdout, fit.base.keep)
    smooth = sum(f.power for f in found if not f.record.rare)
    metric = cured.metric * float(np.sqrt(max(1 - smooth, 1e-6)))
    return Validation(
        start=selection.start,
        end=end,
        fit=fit,
        effects=effects,
        judged=_judged(setup, selection, selection.start) if effects else None,
        before=before,
        after=after,
        cured=cured,
        metric=max(metric, min(setup.floor.least, cured.metric)),
        rest=rest,
        floor=setup.floor,
        faults=tuple(found),
        miswired=setup.miswired is not None,
        variance=whole.variance,
        inflation=kept.inflation,
        error=_error(kept, after.count * len(setup.fit.model.pose)),
    )


def _error(left: Survey, values: float) -> float:
    """Return the relative standard error of an rms of so many values, for noise like the residual.

    Autocorrelation and heavy tails raise it.
    """
    alone = 1 + 2 * (left.autocorrelation[1:] ** 2).sum()
    return float(np.sqrt((max(left.kurtosis, 3.0) - 1) * alone / (4 * max(values, 1.0))))


# -- effects -------------------------------------------------------------------------------------------------


def _holding(setup: Setup, selection: Selection, before: DecodedErrors) -> tuple[Validated, ...]:
    """Return the effects that hold; one whose interval of the shrinkage holds zero is dropped.

    One that is significant by the spectrum of the noise stays: if one run carries it, no other predicts it.
    An effect that blames the reference does not, and is dropped too where it is `unfounded`.
    """
    while True:
        effects = tuple(_validated(setup, selection, e, before) for e in selection.effects)
        blame = [e for e in effects if e.blames]
        shown = [e for e in effects if e.exact.score.p_by_noise >= setup.policy.false_alarm or e in blame]
        weak = [(i[0], e.name) for e in shown if (i := e.judged.interval()) and i[0] <= 0]
        if blame and not weak:
            after = decoded_errors(selection.fit.base.on_all, setup.holdout).metric
            sizes = [(e.errors.metric, e.name) for e in blame]
            weak = [e for e in sizes if unfounded(e[0], after, setup.floor.metric, setup.policy)]
        if not weak:
            return effects
        selection.drop(*(e.exact for e in shown if e.name == min(weak)[1]))


def unfounded(without: float, after: float, floor: float, policy: Policy) -> bool:
    """Return whether the error that an effect takes away is no larger than the error that it leaves.

    Errors as gap metric. What the model of the machine leaves open may look like an error of the reference,
    as far as it is as large: then the reference is not to blame.
    """
    return without**2 - after**2 <= policy.half * (without**2 - floor**2)


def _validated(setup: Setup, selection: Selection, effect: Exact, before: DecodedErrors) -> Validated:
    """Return an effect beside the fit without it."""
    without, alone = selection.without(effect), len(selection.effects) == 1
    errors = before if alone else decoded_errors(without.base.on_all, setup.holdout)
    return Validated(effect, without, errors, _judged(setup, selection, without))


def _judged(setup: Setup, selection: Selection, without: Refitted) -> Judged:
    """Return all effects against the fit `without` some, cross-validated."""
    groups = groups_of(setup.runs)
    after = cross_validated(selection.fit, groups, selection.others)
    return Judged.of(cross_validated(without, groups), after, setup.policy)


# -- faults of samples and the noise floor -----------------------------------------------------------------


def cures(fault: Fault) -> float:
    """Return the decrease of the metric by removing a fault."""
    return 1 - float(np.sqrt(max(1 - fault.power, 0.0)))


# -- the verdict ---------------------------------------------------------------------------------------------


def shaped(setup: Setup, rest: LackOfFit) -> bool:
    """Return whether a residual has a shape, or tones, that are worth the threshold by themselves."""
    need = 1 - (1 - setup.threshold) / (1 + setup.policy.negligible)
    best = rest.best(setup.policy.false_alarm)
    return rest.tones >= need or (best is not None and best.drop >= need)


def remains(setup: Setup, found: Validation, rest: LackOfFit, metric: float) -> bool:
    """Return whether a residual of size `metric` is a gap although no effect is named for it.

    A shape that predicts other runs and is worth the threshold is a gap by itself. A residual without a shape
    is a gap if it significantly exceeds the upper limit of the floor.
    """
    if shaped(setup, rest):
        return True
    metric /= 1 + float(ndtri(1 - setup.policy.false_alarm / 2)) * found.error
    return metric > found.floor.metric * limit_of(found.floor.uncertain, setup.threshold)


Verdict = Literal["no gap", "explained", "unexplained", "noise larger than stated"]
QUIET = ("no gap", LARGER)
"""Verdicts that name no effect."""


def decide(setup: Setup, found: Validation, noise: ResidualNoise | None = None) -> Verdict:
    """Return "explained" if the named causes close the gap, "no gap" if there is neither cause nor gap.

    Named causes must lower the gap by the threshold, or lower it and explain a run that differs from most
    others: an error within a fitted run shows on no other. A residual that is a gap by itself (`remains`)
    makes the verdict "unexplained", unless the causes close nearly all of the excess and what they leave is
    less than the noise (estimates from few runs are off), or the excess is `noise` (of the model with the
    found effects): then nothing remains to explain, and without a cause the noise is larger than stated.
    """
    before, after = found.before.metric, found.metric
    named, amiss = found.named and 1 - after / before >= setup.threshold, False
    if not named:
        start = goodness_on_all(setup, found.start.base)
        end = start if found.end is found.start.base else goodness_on_all(setup, found.end)
        named = found.named and after < before and start.odd_run and not end.material
        amiss = not named and (start.odd_run or end.material)
    base, metric = (found.base, after) if named else (found.start.base, before)
    rest = found.rest if base is found.end else lack_of_fit(base, setup.runs)
    loud = noise is not None and all_noise(setup, found, rest, metric, noise)
    gap = not loud and (amiss or remains(setup, found, rest, metric))
    if named:
        floor, policy = found.floor.metric, setup.policy
        most = closed(before, after, floor) >= 1 - policy.minor
        small = after**2 - floor**2 <= policy.half * floor**2
        return "explained" if not gap or (most and small) else "unexplained"
    return "unexplained" if gap else LARGER if loud else "no gap"


def goodness_on_all(setup: Setup, base: Base) -> GoodnessOfFit:
    """Return the goodness of fit of `base`, found effects included, on fitted and holdout runs together.

    An effect that changes the fit of some runs may be small on the holdout runs; redundant readings may have
    a residual that moves no pose, caused by an effect below the threshold; and one run may disagree with all
    others, in either set.
    """
    uncertain = setup.fit.goodness.uncertain if setup.fit.goodness else 1.0
    found = goodness_of(point_on(base, base.log.runs), len(base.free))
    return found.judged(uncertain, setup.threshold)


def all_noise(setup: Setup, found: Validation, rest: LackOfFit, metric: float, noise: ResidualNoise) -> bool:
    """Return whether the excess of `metric` above the stated floor is worth reporting, and is noise.

    No function of the motion, the state and time may predict the threshold.
    """
    floor, base = found.floor, found.base.part
    stated = any(s.source == "given" for s in setup.fit.noise.sigmas.values())
    if not stated or shaped(setup, rest):
        return False
    here = base.log.columns
    state = [float(np.mean(base.log.array(c))) if c in here else 0.0 for c in base.model.state]
    in_pose = noise.in_pose(base.model, base.p, state, base.covariance, base.pose_weights)
    return noise.makes(metric / floor.metric, in_pose, floor.uncertain, setup.threshold)


def closed(before: float, after: float, floor: float) -> float:
    """Return the share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0
