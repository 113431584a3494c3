"""Selection: a greedy search that screens the catalogue, refits what is promising and keeps the best."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hallsym.diagnosis.derivatives import slope_of
from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.faults import faults
from hallsym.diagnosis.gap import remains, slow_share, used_up
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.ranking import Exact, plain_pairs_first, refitted
from hallsym.diagnosis.record import Significance
from hallsym.diagnosis.refit import Refitted, refit, with_effects, with_model
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, Screen, by_name, candidates
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.shrinkage import Judged, Nested, foreseen
from hallsym.diagnosis.sign_flips import MEMORIES, memory
from hallsym.diagnosis.survey import memory_of_recording, survey
from hallsym.log.phase import designed
from hallsym.model import Facts


def cancelled(
    fit: Refitted, beside: Refitted, start: Refitted, owner: Mapping[str, str], kept: float
) -> bool:
    """Return whether what `fit` has beyond the fit `beside` is undone by other parameters, or undoes others.

    `start`: the fit without any effect, whose parameters say what the machine deviates from its design by.
    `owner`: parameter -> the effect that it belongs to. `kept`: the least part of what an effect alone moves
    the pose by, that this deviation must be, or its former size and the gap that goes beside another effect.
    """
    own, known = start.base.model.names, beside.base.model.names
    new = [n for n in fit.base.model.names if n not in known]
    if cancels(fit, new, kept):
        return True
    whole = moved(start, start.base.p - designed(start.base.model, start.base.p))
    if kept * _alone(fit, new) > np.hypot(whole, start.metric):
        return True
    lower = np.sqrt(max(beside.metric**2 - fit.metric**2, 0.0))
    groups: dict[str, list[str]] = {}
    for n in known:
        if n not in own:
            groups.setdefault(owner.get(n, n), []).append(n)
    return any(kept * _alone(fit, g) > np.hypot(_alone(beside, g), lower) for g in groups.values())


def cancels(fit: Refitted, names: Sequence[str], kept: float) -> bool:
    """Return whether parameters of the same readings undo each other.

    Then all of them make less than `kept` of what one alone makes, such as a cubic and a quintic term.
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
        kept * max(_alone(fit, [n]) for n in group) > _alone(fit, group)
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
    O = fit.decoded[units].sum(axis=0)[: len(step), : len(step)]
    mounting = np.array([model.names[k] in model.period for k in free], dtype=bool)
    if mounting.any():
        follow = np.linalg.lstsq(O[np.ix_(mounting, mounting)], O[mounting] @ step, rcond=None)[0]
        step = step.copy()
        step[mounting] -= follow
    return float(np.sqrt(max(step @ O @ step, 0.0) / max(fit.tangents.count[units].sum(), 1.0)))


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


def select(setup: Setup) -> "Selection":
    """Add effects while they lower the gap metric by the threshold; then hold each against the catalogue.

    Where an effect is replaced, the catalogue is tested again on the new residual.
    """
    start = refit(setup.base, setup.runs)
    search = Selection(setup, start, start, Nested(setup.runs, setup.policy), {(): start})
    search.grow()
    if search.effects:
        search.prune()
    if len(search.effects) > 1 and search.reconsider():
        search.grow()
    if setup.base.sliced:
        search.confirm()
    search.hold()
    return search


@dataclass(eq=False)
class Selection:
    """The greedy search on the fitted runs, and what it selected.

    `start`: the fit without effects; `fit`: with all `effects`. `nested`: the search without each group of
    runs. `refits`: fits with some of the effects. `dropped`: effects that runs other than they were fitted to
    do not hold. `not_testable`: effect -> why this log cannot show it. `screened`: every screening; `last`:
    scores of the one that found no further effect. `owner`: parameter -> its effect. `of_values`: share of
    the gap that the values of the readings make.
    """

    setup: Setup
    start: Refitted
    fit: Refitted
    nested: Nested
    refits: dict[tuple[Exact, ...], Refitted]
    effects: list[Exact] = field(default_factory=list)
    dropped: list[Exact] = field(default_factory=list)
    not_testable: dict[str, str] = field(default_factory=dict)
    screened: list[Screened] = field(default_factory=list)
    last: list[Score] = field(default_factory=list)
    owner: dict[str, str] = field(default_factory=dict)
    of_values: float = 0.0

    @property
    def runs(self) -> list[int]:
        """The fitted runs."""
        return self.setup.runs

    @property
    def significance(self) -> Significance:
        """That any effect is there: of one recording, with the others in place."""
        first = [s.significance for s in self.screened if s.at is self.start][-1]
        confirmed = self.effects if self.setup.base.sliced else []
        return replace(first, p_value=min((e.score.p_value for e in confirmed), default=first.p_value))

    @property
    def policy(self) -> Policy:
        """The thresholds."""
        return self.setup.policy

    def grow(self) -> None:
        """Add effects while they lower the gap metric by the threshold."""
        for count in range(len(self.effects), self.setup.base.model.family.most_effects + 1):
            beside = f" beside {count}" if count else ""
            self.setup.say(f"testing {len(self.setup.catalogue)} effects{beside}")
            worth = partial(self.worth, beside=count)
            exact, screen = self.step(self.fit, worth)
            self.last = self.screened[-1].scores
            if not exact or not worth(exact[0].score):
                if self.effects and self.needed():
                    self.nested.step(screen, None, self.setup.threshold)
                break
            level = self.setup.threshold * (1.0 if count else self.policy.half)
            self.nested.step(screen, exact[0].name, level)
            del screen
            self.effects.append(_selected(exact, self.fit))
            self.fit = exact[0].fit

    def worth(self, score: Score, beside: int) -> bool:
        """Return whether an effect is no chance and lowers the gap enough, and `beside` others is needed.

        One that leaves more than half of what others left must be certain. A first effect that is certain is
        taken up from half the threshold on: it may be worth more on the holdout runs, which decide. What the
        values of the readings make of the gap, as steps do, no effect can take away: it would only follow
        their error.
        """
        policy, certain = self.policy, score.p_value < self.policy.certain
        if beside == self.setup.base.model.family.most_effects or (beside and not self.needed()):
            return False
        likely = score.p_value < policy.false_alarm and (not beside or score.ratio <= policy.half)
        level = self.setup.threshold * (policy.half if certain and not beside else 1.0)
        return (certain or likely) and max(score.ratio, np.sqrt(self.of_values)) <= 1 - level

    def needed(self) -> bool:
        """Return whether what is left may hold another effect: it is above the floor, or that is unknown."""
        floor = self.setup.floor
        return not floor.stated or self.fit.metric > floor.metric * (1 + self.policy.negligible)

    def step(
        self, at: Refitted, worth: Callable[[Score], bool] = lambda _: True
    ) -> tuple[list[Exact], Screen]:
        """Screen the catalogue at `at`; return exact refits, best first, if any effect is `worth` it."""
        screen, facts = self.screen(at)
        exact = refitted(
            at.base, screen.scores, self.runs, facts, worth, lambda e: self.stands(e, at), self.policy
        )
        if self.setup.base.model.family.pairs:
            exact = plain_pairs_first(exact, self.setup.catalogue, self.runs, facts, self.policy)
        return exact, screen

    def screen(self, at: Refitted, remembers: float | None = None) -> tuple[Screen, Facts]:
        """Screen the catalogue at `at`, for noise that forgets after so many samples; None: as it seems."""
        found = survey(at.base, self.runs)
        facts = facts_of(at.base, found)
        told = faults(at.base, found, self.setup.tested)
        self.of_values = sum(f.power for f in told if f.record.of_values)
        tried, trouble = candidates(at.base, self.setup.catalogue, facts)
        screen = Screen(
            at.base, tried, self.runs, self.policy.inflation, colour=found.colour, remembers=remembers
        )
        colour = self.remembered(screen, found.colour)
        ranked = screen.scores
        self.screened.append(Screened(at, ranked, screen.significance, screen.top, colour))
        self.not_testable |= trouble
        not_finite = "its readings are not finite on this log"
        self.not_testable |= {tried[key].effect.name: not_finite for key in screen.spoiled}
        if at is self.start:
            absorbed = "the model's own parameters absorb it on this log"
            self.not_testable |= {s.effect.name: absorbed for s in by_name(ranked) if s.absorbed}
        for c in tried.values():
            self.owner |= dict.fromkeys(c.new, c.effect.name)
        return screen, facts

    def remembered(self, screen: Screen, colour: np.ndarray) -> np.ndarray:
        """Weigh a screen by the memory of the noise; return the autocorrelation that it was weighed by.

        A slow effect makes a residual that remembers as long as it lasts. Where stretches seem to depend on
        each other, what the best effect leaves tells whether the noise does.
        """
        whole = screen.length is None or screen.base.sliced
        if whole or screen.lasting >= MEMORIES * memory(colour) or not screen.scores:
            return colour
        left = refit(with_model(screen.base, screen.scores[0].model), self.runs)
        beside = survey(left.base, self.runs).colour
        if memory(beside) >= memory(colour):
            return colour
        screen.weigh(beside)
        return beside

    def stands(self, exact: Exact, at: Refitted) -> bool:
        """Return whether a refit keeps what its score promised, and other parameters do not undo it.

        It must keep half of the threshold, and lower BIC.
        """
        lower = exact.fit.metric <= at.metric * (1 - self.policy.half * self.setup.threshold)
        keeps = lower and exact.bic < at.bic(0, self.policy.inflation)
        return keeps and not cancelled(exact.fit, at, self.start, self.owner, self.policy.half)

    def prune(self) -> None:
        """Where a gap remains, drop effects that only resemble its cause: they leave its shape behind."""
        rest = lack_of_fit(self.fit.base, self.runs)
        seen = survey(self.fit.base, self.runs)
        gap, slow = self.fit.metric, slow_share(seen.variance, seen.fast)
        if not remains(rest, slow, gap, self.setup.floor, self.setup.threshold, self.policy):
            return
        resembling = []
        for effect in self.effects:
            without = self.without(effect)
            before = lack_of_fit(without.base, self.runs)
            if used_up(before, without.metric, rest, gap, self.policy) < self.policy.half:
                resembling.append(effect)
        if resembling:
            self.drop(*resembling)
            if self.effects:
                self.prune()

    def reconsider(self) -> bool:
        """Hold each effect against the catalogue, the others in place; return whether any was replaced."""
        before, replaced = [f.name for f in self.effects], False
        for k, effect in enumerate(self.effects):
            if k + 1 == len(before) and not replaced:
                break  # the last was chosen with the others in place
            without = self.without(effect)
            exact, _ = self.step(without)
            if exact:
                self.effects[k] = _selected(exact, without)
                self.fit = exact[0].fit
                replaced |= exact[0].name != effect.name
        return [f.name for f in self.effects] != before

    def confirm(self) -> None:
        """Of slices of one recording, test the effects again by the memory of what all of them leave.

        While effects are missing what is left remembers as long as they last: slices count as independent.
        In the end those that are not depend on each other; if no effect is there beyond chance then, none is.
        """
        remembers = memory_of_recording(self.fit.base, frozenset(self.runs))
        tested: list[Exact] = []
        for effect in self.effects:
            screen, _ = self.screen(self.without(effect), remembers)
            own = (s.p_value for s in screen.scores if s.effect.name == effect.name)
            tested.append(replace(effect, score=replace(effect.score, p_value=min(own, default=1.0))))
        if min((e.score.p_value for e in tested), default=1.0) < self.policy.false_alarm:
            self.effects = tested
        else:
            self.drop(*self.effects)
        self.last = self.screen(self.fit, remembers)[0].scores

    def hold(self) -> None:
        """Drop effects that do not lower the gap of runs that they were not fitted to, the weakest first.

        Of two that resemble each other either may be dispensable and one be needed.
        """
        while self.effects:
            after, weak = self.judges(self.fit), []
            for effect in self.effects:
                judged = Judged.of(self.judges(self.without(effect)), after, self.policy)
                certain = effect.score.p_value < self.policy.certain
                if not judged.holds and not (certain and judged.value > 0):
                    weak.append((judged.value, effect))
            if not weak:
                return
            value, weakest = min(weak, key=lambda w: w[0])
            if value > 0:
                self.dropped.append(weakest)
            self.drop(weakest)

    def judges(self, fit: Refitted) -> dict[tuple[int, ...], float]:
        """Return the squares of the fitted runs, each as the others foresee them."""
        known = set(self.runs)
        return {r: v for r, v in foreseen(fit, self.nested.groups).items() if known.issuperset(r)}

    def drop(self, *effects: Exact) -> None:
        """Go on without some effects."""
        self.fit = self.without(*effects)
        self.effects = [e for e in self.effects if e not in effects]

    def without(self, *left_out: Exact) -> Refitted:
        """Return the fit with all effects but some."""
        key = tuple(e for e in self.effects if e not in left_out)
        if key not in self.refits:
            values = {name: v for e in key for name, v in e.fit.base.values.items()}
            base = with_effects(self.start.base, (e.score.variant for e in key), values)
            self.refits[key] = refit(base, self.runs)
        return self.refits[key]

    def screened_at(self, base: Base) -> Screened | None:
        """Return the last screening of the catalogue at a fit; None where there was none."""
        return next((s for s in reversed(self.screened) if s.at.base is base), None)


def _selected(exact: Sequence[Exact], without: Refitted) -> Exact:
    """Return the first of the effects that were refitted for a place, with the others as its rivals."""
    return replace(exact[0], squares_before=without.cost, rivals=tuple(exact[1:]))
