"""Selection: a greedy search that screens the catalogue, refits what is promising and keeps the best."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hallsym.diagnosis.derivatives import slope_of
from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.faults import OF_VALUES, faults
from hallsym.diagnosis.gap import remains, slow_share, used_up
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.ranking import Exact, bic_of, plain_pairs_first, refitted
from hallsym.diagnosis.record import Significance
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, Screen, by_name, candidates
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.shrinkage import Judged, Nested, Squares, foreseen
from hallsym.diagnosis.survey import survey
from hallsym.log.phase import designed


def cancelled(
    fit: Refitted, beside: Refitted, start: Refitted, owner: Mapping[str, str], over: float
) -> bool:
    """Return whether what `fit` has beyond the fit `beside` is undone by other parameters, or undoes others.

    `start`: the fit without any effect, whose parameters say what the machine deviates from its design by.
    `owner`: parameter -> the effect that it belongs to. `over`: times that deviation by which an effect alone
    may move the pose, and times its former size and the gap that goes by which it may grow beside another.
    """
    own, known = start.base.model.names, beside.base.model.names
    new = [n for n in fit.base.model.names if n not in known]
    if cancels(fit, new, over):
        return True
    whole = moved(start, start.base.p - designed(start.base.model, start.base.p))
    if _alone(fit, new) > over * np.hypot(whole, start.gap(start.fitted)):
        return True
    lower = np.sqrt(max(beside.gap(beside.fitted) ** 2 - fit.gap(fit.fitted) ** 2, 0.0))
    groups: dict[str, list[str]] = {}
    for n in known:
        if n not in own:
            groups.setdefault(owner.get(n, n), []).append(n)
    return any(_alone(fit, g) > over * np.hypot(_alone(beside, g), lower) for g in groups.values())


def cancels(fit: Refitted, names: Sequence[str], over: float) -> bool:
    """Return whether parameters of the same readings undo each other.

    Then one alone makes more than `over` times what all of them make, such as a cubic and a quintic term.
    Parameters that do nothing where the others are nil, such as a rail of what is not clipped, have no size.
    """
    model, p = fit.base.model, fit.base.p.copy()
    at = [model.names.index(n) for n in names]
    p[at] = model.nominal[at]
    slope = slope_of(model, p, names)
    same: dict[tuple[int, ...], list[str]] = {}
    for k, name in enumerate(names):
        moved_readings = tuple(slope.channel[slope.column == k].tolist())
        if moved_readings:
            same.setdefault(moved_readings, []).append(name)
    return any(
        max(_alone(fit, [n]) for n in group) > over * _alone(fit, group)
        for group in same.values()
        if len(group) > 1
    )


def _alone(fit: Refitted, names: Sequence[str]) -> float:
    """What some parameters of a fit make by themselves."""
    base = fit.base
    these = np.isin(base.model.names, names)
    return moved(fit, np.where(these, base.p - base.model.nominal, 0.0))


def moved(fit: Refitted, by: np.ndarray) -> float:
    """Return the gap metric, to first order, of moving the parameters (n,) of `fit` by this much.

    What repeats follows as far as it lowers the metric: a zero is mounting, and another one undoes no cause.
    """
    units, model = fit.fitted, fit.base.model
    free = list(fit.base.free)
    step = by[free]
    O = fit.tangents.output[units].sum(axis=0)[: len(step), : len(step)]
    mounting = np.array([model.names[k] in model.period for k in free], dtype=bool)
    if mounting.any():
        follow = np.linalg.lstsq(O[np.ix_(mounting, mounting)], O[mounting] @ step, rcond=None)[0]
        step = step.copy()
        step[mounting] -= follow
    return float(np.sqrt(max(step @ O @ step, 0.0) / max(fit.tangents.count[units].sum(), 1.0)))


@dataclass(frozen=True, eq=False)
class Selected:
    """An effect of the set: its exact refit, and `rivals`, the other effects that were refitted for its
    place.

    `squares_before`: whitened squares that were left without it.
    """

    exact: Exact
    rivals: tuple[Exact, ...]
    squares_before: float

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.exact.score.effect.name

    @property
    def first_order(self) -> float:
        """Whitened squares that the effect leaves to first order, by its score."""
        return self.squares_before - self.exact.score.gain


@dataclass(frozen=True, eq=False)
class Screened:
    """The scores of the catalogue beside the model and effects of `at`, best first.

    `significance`: that any of the catalogue is there; `top`: its largest statistic with each draw of signs.
    `colour`: autocorrelation of the residual.
    """

    at: Refitted
    scores: list[Score]
    significance: Significance
    top: np.ndarray | None
    colour: np.ndarray


@dataclass(frozen=True, eq=False)
class Selection:
    """What the search selected on the fitted runs.

    `start`: the fit without effects; `fit`: with all `effects`. `not_testable`: effect -> why this log cannot
    show it. `screened`: every screening; `last`: scores of the one that found no further effect. `nested`:
    the search without each group of runs. `dropped`: effects that runs other than they were fitted to do not
    hold.
    """

    start: Refitted
    fit: Refitted
    effects: tuple[Selected, ...]
    not_testable: dict[str, str]
    screened: tuple[Screened, ...]
    last: list[Score]
    runs: list[int]
    nested: Nested
    dropped: tuple[Selected, ...] = ()
    refits: dict[tuple[Exact, ...], Refitted] = field(default_factory=dict)

    def without(self, effect: Selected) -> Refitted:
        """Return the fit with all effects but one."""
        others = [e.exact for e in self.effects if e is not effect]
        return refit_with(self.start, others, self.runs, self.refits)

    def screened_at(self, base: Base) -> Screened | None:
        """Return the screening of the catalogue at a fit; None where there was none."""
        return next((s for s in self.screened if s.at.base is base), None)


def refit_with(
    start: Refitted, exact: Sequence[Exact], runs: Sequence[int], known: dict[tuple[Exact, ...], Refitted]
) -> Refitted:
    """Fit the model of `start` with some effects; `known` holds the refits made so far."""
    if not exact:
        return start
    key = tuple(exact)
    if key not in known:
        base = start.base
        for e in exact:
            base = _with_effect(base, e)
        known[key] = refit(base, runs)
    return known[key]


def _with_effect(base: Base, exact: Exact) -> Base:
    wide = with_model(base, exact.score.variant.make(base.model))
    known = dict(zip(exact.fit.base.model.names, exact.fit.base.p, strict=True))
    p = np.array([known.get(n, v) for n, v in zip(wide.model.names, wide.p, strict=True)])
    return replace(wide, p=p)


def select(setup: Setup) -> Selection:
    """Add effects while they lower the gap metric by the threshold; then hold each against the catalogue.

    Where an effect is replaced, the catalogue is tested again on the new residual.
    """
    search = _Search(setup)
    search.grow()
    if search.found:
        search.prune()
    if len(search.found) > 1 and search.reconsider():
        search.grow()
    search.hold()
    return Selection(
        start=search.start,
        fit=search.now,
        effects=tuple(search.found),
        not_testable=search.not_testable,
        screened=tuple(search.screened),
        last=search.last,
        runs=setup.runs,
        nested=search.nested,
        dropped=tuple(search.dropped),
        refits=search.refits,
    )


class _Search:
    """The state of the greedy search."""

    def __init__(self, setup: Setup) -> None:
        self.setup, self.runs, self.policy = setup, setup.runs, setup.policy
        self.start = refit(setup.base, setup.runs)
        self.now = self.start
        self.found: list[Selected] = []
        self.not_testable: dict[str, str] = {}
        self.screened: list[Screened] = []
        self.owner: dict[str, str] = {}
        self.refits: dict[tuple[Exact, ...], Refitted] = {}
        self.last: list[Score] = []
        self.of_values = 0.0
        self.dropped: list[Selected] = []
        self.nested = Nested(setup.runs, setup.policy)

    def grow(self) -> None:
        """Add effects while they lower the gap metric by the threshold."""
        for count in range(len(self.found), self.setup.base.model.family.most_effects + 1):
            beside = f" beside {count}" if count else ""
            self.setup.say(f"testing {len(self.setup.catalogue)} effects{beside}")
            worth = partial(self.worth, beside=count)
            exact, screen = self.step(self.now, worth)
            self.last = self.screened[-1].scores
            if not exact or not worth(exact[0].score):
                if self.found and self.needed():
                    self.nested.step(screen, None, self.setup.threshold)
                break
            level = self.setup.threshold * (1.0 if count else self.policy.half)
            self.nested.step(screen, exact[0].score.effect.name, level)
            del screen
            self.found.append(Selected(exact[0], tuple(exact[1:]), self.now.cost))
            self.now = exact[0].fit

    def worth(self, score: Score, beside: int) -> bool:
        """Return whether an effect lowers the gap enough; one `beside` others must be needed and certain.

        A first effect that is certain is taken up from half the threshold on: it may be worth more on the
        holdout runs, which decide. What the values of the readings make of the gap, as steps do, no effect
        can take away: it would only follow their error.
        """
        if beside == self.setup.base.model.family.most_effects:
            return False
        certain = score.p_value < self.policy.certain
        level = self.setup.threshold * (self.policy.half if certain and not beside else 1.0)
        needed = not beside or (certain and self.needed())
        return needed and max(score.ratio, np.sqrt(self.of_values)) <= 1 - level

    def needed(self) -> bool:
        """Return whether what is left may hold another effect: it is above the floor, or that is unknown."""
        floor = self.setup.floor
        return not floor.stated or _gap(self.now) > floor.metric * (1 + self.policy.floor_known)

    def step(
        self, at: Refitted, worth: Callable[[Score], bool] = lambda _: True
    ) -> tuple[list[Exact], Screen]:
        """Screen the catalogue at `at`; return exact refits, best first, if any effect is `worth` it."""
        found = survey(at.base, self.runs)
        facts = facts_of(at.base, found)
        told = faults(at.base, found, self.setup.tested)
        self.of_values = sum(f.power for f in told if f.name in OF_VALUES)
        tried, trouble = candidates(at.base, self.setup.catalogue, facts)
        screen = Screen(at.base, tried, self.runs, self.policy.inflation, colour=found.colour)
        ranked = screen.scores
        self.screened.append(Screened(at, ranked, screen.significance, screen.top, found.colour))
        self.not_testable |= {t.name: t.reason for t in trouble}
        not_finite = "its readings are not finite on this log"
        self.not_testable |= {tried[key].effect.name: not_finite for key in screen.spoiled}
        if at is self.start:
            absorbed = "the model's own parameters absorb it on this log"
            self.not_testable |= {s.effect.name: absorbed for s in by_name(ranked) if s.absorbed}
        for c in tried.values():
            self.owner |= dict.fromkeys(c.new, c.effect.name)
        exact = refitted(at.base, ranked, self.runs, facts, worth, lambda e: self.stands(e, at), self.policy)
        if self.setup.base.model.family.pairs:
            exact = plain_pairs_first(exact, self.setup.catalogue, self.runs, facts, self.policy)
        return exact, screen

    def stands(self, exact: Exact, at: Refitted) -> bool:
        """Return whether a refit keeps what its score promised, and other parameters do not undo it.

        It must keep half of the threshold, and lower BIC.
        """
        lower = exact.gap <= _gap(at) * (1 - self.policy.half * self.setup.threshold)
        keeps = lower and exact.bic < bic_of(at, 0, self.policy.inflation)
        return keeps and not cancelled(exact.fit, at, self.start, self.owner, self.policy.cancelling)

    def prune(self) -> None:
        """Where a gap remains, drop effects that only resemble its cause: they leave its shape behind."""
        rest = lack_of_fit(self.now.base, self.runs)
        seen = survey(self.now.base, self.runs)
        gap, slow = _gap(self.now), slow_share(seen.variance, seen.fast)
        if not remains(rest, slow, gap, self.setup.floor, self.setup.threshold, self.policy):
            return
        kept = []
        for found in self.found:
            without = self.refit(e for e in self.found if e is not found)
            before = lack_of_fit(without.base, self.runs)
            if used_up(before, _gap(without), rest, gap, self.policy) >= self.policy.used_up:
                kept.append(found)
        if len(kept) < len(self.found):
            self.found = kept
            self.now = self.refit(kept)
            if kept:
                self.prune()

    def reconsider(self) -> bool:
        """Hold each effect against the catalogue, the others in place; return whether any was replaced."""
        before = [f.name for f in self.found]
        for k, found in enumerate(self.found[:-1]):  # the last was chosen with the others in place
            without = self.refit(e for e in self.found if e is not found)
            exact, _ = self.step(without)
            if exact:
                self.found[k] = Selected(exact[0], tuple(exact[1:]), without.cost)
                self.now = exact[0].fit
        return [f.name for f in self.found] != before

    def hold(self) -> None:
        """Drop effects that do not lower the gap of runs that they were not fitted to, the weakest first.

        Of two that resemble each other either may be dispensable and one be needed.
        """
        while self.found:
            with_all = self.judges(self.now)
            judged = [
                (self.judged(self.judges(self.refit(e for e in self.found if e is not f)), with_all), f)
                for f in self.found
            ]
            weak = [(j.value, k) for k, (j, f) in enumerate(judged) if not self.held(j, f)]
            if not weak:
                return
            value, k = min(weak)
            if value > 0:
                self.dropped.append(self.found[k])
            self.found = [f for f in self.found if f is not self.found[k]]
            self.now = self.refit(self.found)

    def held(self, judged: Judged, effect: Selected) -> bool:
        """Return whether an effect lowers the gap of other runs by no chance, or is certain by its score."""
        return judged.holds or (judged.value > 0 and effect.exact.score.p_value < self.policy.certain)

    def judges(self, fit: Refitted) -> dict[tuple[int, ...], float]:
        """Return the squares of the fitted runs, each as the others foresee them."""
        known = set(self.runs)
        return {r: v for r, v in foreseen(fit, self.nested.groups).items() if known.issuperset(r)}

    def judged(self, before: Squares, after: Squares) -> Judged:
        """Return how far the gap of these runs shrinks."""
        return Judged.of(before, after, self.policy.fewest_judges)

    def refit(self, effects: Iterable[Selected]) -> Refitted:
        """Return the fit with some of the effects."""
        return refit_with(self.start, [e.exact for e in effects], self.runs, self.refits)


def _gap(fit: Refitted) -> float:
    """Gap metric on the fitted runs."""
    return fit.gap(fit.fitted)
