"""Selection: a greedy search that screens the catalogue, refits promising effects and keeps the best."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.faults import faults
from hallsym.diagnosis.normal_equations import entries, slopes_of
from hallsym.diagnosis.p_values import memory
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Significance
from hallsym.diagnosis.refit import Refitted, refit, with_effects, with_model
from hallsym.diagnosis.residuals import NIL, Base
from hallsym.diagnosis.scores import Score, Screen, by_name, candidates
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.survey import Survey, memory_of_recording, spectrum_peak, survey
from hallsym.model import Effect, Facts


@dataclass(frozen=True, eq=False)
class Exact:
    """An effect refitted exactly; of a selected one, `rivals`: the others that were refitted in its place."""

    score: Score
    fit: Refitted
    bic: float
    rivals: tuple["Exact", ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.score.effect.name


def refitted(
    base: Base,
    screen: Screen,
    runs: Sequence[int],
    worth: Callable[[Score], bool],
    stands: Callable[["Exact"], bool] = lambda _: True,
    over: Callable[[], bool] = lambda: False,
) -> list["Exact"]:
    """Refit the promising effects exactly and return them, best first; none if none is `worth` it.

    Promising are those that explain nearly as much as the best one that is worth it, with a cross-validated
    decrease of the gap. An effect whose refit does not `stand`, or that reaches no plausible parameters from
    any start, is left out. There are no further refits once the search is `over`; at most
    `Policy.most_refits` effects are refitted, each from at most `Policy.starts` starts. Refits of the screen
    are reused.
    """
    policy, scored = base.policy, screen.scores
    # an effect goes by the best of its variants that are worth it: one with more numbers may be less certain
    named = [s for s in by_name(sorted(scored, key=lambda s: not worth(s))) if not s.absorbed]
    least = policy.half * max((s.gain for s in named if worth(s)), default=np.inf)
    out: list[Exact] = []
    for first in [s for s in named if s.gain >= least and s.ratio < 1][: policy.most_refits]:
        if over():
            break
        again = [s for s in scored if s.effect is first.effect and s.gain >= policy.half * first.gain]
        starts = again[: policy.starts] if first.variant.tried > 1 else [first]
        least_cost = min((e.fit.cost for e in out), default=np.inf)
        known = screen.refits
        fits = [known.get(s.model) or refit(with_model(base, s.model), runs, least_cost) for s in starts]
        found = [Exact(s, fit, fit.bic(s.size)) for s, fit in zip(starts, fits, strict=True)]
        possible = [e for e in found if e.score.effect.possible(e.fit.base.values)]
        least_bic = min((e.bic for e in possible), default=np.inf)  # starts may end at one optimum
        best = next((e for e in possible if e.bic <= least_bic + NIL * e.fit.readings), None)
        if best is not None and stands(best):
            out.append(best)
    return ordered(out, scored) if any(worth(e.score) for e in out) else []


# -- the order ---------------------------------------------------------------------------------------------


def ordered(exact: Sequence[Exact], scored: Sequence[Score]) -> list[Exact]:
    """Order one or more exact refits by BIC; first a smaller effect if it explains nearly as much.

    Real machines have small imperfections of every kind. Many parameters absorb some of them, which with
    enough samples is significant but no evidence. The best effect stays first if it has a variant with as few
    parameters that explains as much. Of two effects that fit equally well on this log, the one with fewer
    searched numbers goes first, then the one that is first in the catalogue.
    """
    best, *_ = exact = sorted(exact, key=lambda e: e.bic)
    simpler = [e for e in exact[1:] if _simpler(e, best, scored)]
    if simpler:
        return _first(min(simpler, key=lambda e: (e.score.size, e.bic)), exact)
    same = [best, *(e for e in exact[1:] if _same(best, e))]
    return _first(min(same, key=lambda e: (e.score.variant.tried, e.score.place)), exact)


REFERENCE = "reference"
"""Link of the effects that say that the reference is wrong, and not the machine."""


def _simpler(e: Exact, best: Exact, scored: Sequence[Score]) -> bool:
    policy = best.fit.base.policy
    return (
        e.score.size < best.score.size
        and e.bic - best.bic <= policy.negligible * best.score.gain
        and e.fit.metric <= best.fit.metric * (1 + policy.negligible)
        and not any(
            s.effect is best.score.effect
            and s.size <= e.score.size
            and s.gain >= (1 - policy.negligible) * e.score.gain
            and s.bic <= e.score.bic + policy.as_good
            for s in scored
        )
    )


def _same(a: Exact, b: Exact) -> bool:
    """Return whether two effects of one size have the same cost, to less than the noise of one reading."""
    return a.score.size == b.score.size and abs(b.fit.cost - a.fit.cost) * a.fit.readings <= a.fit.cost


def plain_pairs_first(
    exact: list[Exact],
    catalogue: Sequence[Effect],
    runs: Sequence[int],
    facts: Facts,
    over: Callable[[], bool] = lambda: False,
) -> list[Exact]:
    """Put a plain effect first if it and a second explain as much as the flexible best one, by BIC.

    An effect with many parameters may absorb small imperfections and so explain more than the plain cause.
    Then the plain cause and one of the imperfections together explain as much with no more parameters, and
    the flexible effect with a second one explains hardly more than these two. This screens the catalogue at
    most `Policy.most_refits` times, and not once the search is `over`.
    """
    if not exact:
        return exact
    best, half = exact[0], exact[0].fit.base.policy.half
    smaller = [e for e in exact[1:] if e.score.size < best.score.size]
    plain = [e for e in smaller if e.score.gain >= half * best.score.gain]
    found: list[tuple[float, Exact, float]] = []
    for e in plain:
        if over():
            return exact
        second = _second(e, catalogue, runs, facts)
        if second is None or second.size + e.score.size > best.score.size:
            continue
        both = second.bic + e.score.size * float(np.log(max(e.fit.readings, 2.0)))
        if both <= best.bic + NIL * e.fit.readings:  # as much, whatever the rounding
            found.append((both, e, e.fit.cost - second.gain))
    if not found:
        return exact
    _, first, left = min(found, key=lambda f: f[0])
    second = _second(best, catalogue, runs, facts)
    if second is not None and best.fit.cost - second.gain < half * left:
        return exact
    return _first(first, exact)


def _second(e: Exact, catalogue: Sequence[Effect], runs: Sequence[int], facts: Facts) -> Score | None:
    """Return the best second effect beside one, by its score."""
    tried, _ = candidates(e.fit.base, catalogue, facts)
    scores = Screen(e.fit.base, tried, runs, tested=False).scores
    return next((s for s in scores if not s.absorbed), None)


def _first(first: Exact, exact: Sequence[Exact]) -> list[Exact]:
    return [first, *(e for e in exact if e is not first)]


def cancels(fit: Refitted, names: Sequence[str]) -> bool:
    """Return whether parameters of the same readings and unit cancel each other.

    Then all of them together make less than half of the error that one alone makes, such as a cubic and a
    quintic term. Parameters without effect while the others are 0, such as an unreached rail, have no size.
    """
    model = fit.base.model
    (slope,) = slopes_of(replace(model, steps=()), [(model, names)])
    units = {q.name: q.unit for q in model.parameters}
    same: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    channel, column = entries(slope)
    for k, name in enumerate(names):
        moved_readings = tuple(channel[column == k].tolist())
        if moved_readings:
            same.setdefault((units[name], moved_readings), []).append(name)
    return any(
        fit.base.policy.half * max(_alone(fit, [n]) for n in group) > _alone(fit, group)
        for group in same.values()
        if len(group) > 1
    )


def _alone(fit: Refitted, names: Sequence[str]) -> float:
    """The errors that some parameters of a fit make by themselves."""
    base = fit.base
    these = np.isin(base.model.names, names)
    return moved(fit, np.where(these, base.p - base.model.nominal, 0.0))


def moved(fit: Refitted, by: np.ndarray) -> float:
    """Return the gap metric, to first order, of moving the parameters (n,) of `fit` by this much.

    Offsets of periodic coordinates follow as far as they lower the metric: they belong to the mounting.
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


def select(setup: Setup) -> "Selection":
    """Add effects while they lower the gap metric by the threshold; then test each against the catalogue.

    Where an effect is replaced, the catalogue is tested again on the new residual.
    """
    start = refit(setup.base, setup.runs)
    search = Selection(setup, start, start, {(): start})
    search.grow()
    if search.reconsider():
        search.grow()
    if setup.base.sliced:
        search.confirm()
    elif search.last is None:
        search.last = [] if search.over(more=True) else search.screen(search.fit)[0].scores
    return search


@dataclass(eq=False)
class Selection:
    """The greedy search on the fitted runs, and the selected effects.

    `start`: the fit without effects; `fit`: with all `effects`. `refits`: fits with some of the effects.
    `not_testable`: effect -> why this log cannot show it. `screened`: every screening; `last`: scores of the
    one beside all effects, None before it.
    """

    setup: Setup
    start: Refitted
    fit: Refitted
    refits: dict[tuple[Exact, ...], Refitted]
    effects: list[Exact] = field(default_factory=list)
    not_testable: dict[str, str] = field(default_factory=dict)
    screened: list[Screen] = field(default_factory=list)
    last: list[Score] | None = None
    of_values: float = 0.0
    """Share of the gap due to the values of the readings, such as steps: no effect can remove it."""
    cut_short: bool = False
    """Whether the budget ended the search before it was done."""
    longest: float = 0.0
    """Seconds that the longest screening took."""
    searched: "Selection | None" = None
    """The search on the part of a long log that found the effects."""

    def over(self, more: bool = False) -> bool:
        """Return whether the search has used up its budget; asked where there is more to do.

        `more`: whether that is one more screening, which takes as long as the longest one so far.
        """
        self.cut_short |= self.setup.over(self.longest if more else 0.0)
        return self.cut_short

    @property
    def stopped(self) -> str:
        """A sentence on effects left out for the budget; empty if none was."""
        if not self.cut_short:
            return ""
        tested, known = {s.effect.name for each in self.screened for s in each.scores}, self.setup.catalogue
        return (
            f"The search stopped for its budget of {self.setup.budget:g} s: {len(tested)} of {len(known)} "
            "effects were tested, and not all that was promising was fitted."
        )

    @property
    def runs(self) -> list[int]:
        """The fitted runs."""
        return self.setup.runs

    @property
    def significance(self) -> Significance:
        """Significance of any effect at all: of one recording, with the others in place."""
        first = [s.significance for s in self.screened if s.base.model is self.start.base.model][-1]
        confirmed = self.effects if self.setup.base.sliced else []
        return replace(first, p_value=min((e.score.p_value for e in confirmed), default=first.p_value))

    @property
    def policy(self) -> Policy:
        """The thresholds."""
        return self.setup.policy

    def grow(self) -> None:
        """Add effects while they lower the gap metric by the threshold, at most `Family.most_effects`."""
        self.last = None
        while (count := len(self.effects)) < self.setup.base.model.family.most_effects:
            if count and not self.needed():
                break
            if self.screened and self.over(more=True):
                self.last = []
                break
            worth = partial(self.worth, beside=count)
            exact = self.step(self.fit, worth)
            if not exact or not worth(exact[0].score):
                self.last = self.screened[-1].scores
                break
            self.effects.append(replace(exact[0], rivals=tuple(exact[1:])))
            self.fit = exact[0].fit

    def worth(self, score: Score, beside: int) -> bool:
        """Return whether an effect is significant and lowers the gap enough, and is needed `beside` others.

        A first effect that is certain is selected above half the threshold: it may be worth more on the
        holdout runs, which decide.
        """
        policy, certain = self.policy, score.p_value < self.policy.certain
        level = self.setup.threshold * (policy.half if certain and not beside else 1.0)
        return score.p_value < policy.false_alarm and max(score.ratio, np.sqrt(self.of_values)) <= 1 - level

    def needed(self) -> bool:
        """Return whether the residual may hold another effect: it exceeds the floor, or that is unknown."""
        floor = self.setup.floor_fitted
        unknown = floor.uncertain > 1 + self.policy.negligible
        return unknown or self.fit.metric > floor.metric * (1 + self.policy.negligible)

    def step(self, at: Refitted, worth: Callable[[Score], bool] = lambda _: True) -> list[Exact]:
        """Screen the catalogue at `at`; return exact refits, best first, if any effect is `worth` it."""
        screen, facts = self.screen(at)
        exact = refitted(at.base, screen, self.runs, worth, lambda e: self.stands(e, at), self.over)
        screen.refits.clear()  # their residuals are as large as the log
        if self.setup.base.model.family.pairs:
            exact = plain_pairs_first(exact, self.setup.catalogue, self.runs, facts, self.over)
        return exact

    def screen(self, at: Refitted, remembers: float | None = None) -> tuple[Screen, Facts]:
        """Screen the catalogue at `at`, for noise of this correlation length in samples; None: estimated."""
        count = len(at.base.model.effects) - len(self.start.base.model.effects)
        beside, began = f" beside {count}" if count else "", self.setup.elapsed
        self.setup.say(f"testing {len(self.setup.catalogue)} effects{beside}")
        found = survey(at.base, self.runs)
        facts = facts_of(at.base, found)
        of_kind = faults(at.base, found, self.setup.tested)
        self.of_values = sum(f.power for f in of_kind if f.record.of_values)
        tried, trouble = candidates(at.base, self.setup.catalogue, facts)
        screen = Screen(at.base, tried, self.runs)
        self.weigh(screen, found, remembers)
        self.screened.append(screen)
        self.longest = max(self.longest, self.setup.elapsed - began)
        self.not_testable |= trouble
        not_finite = "its readings are not finite on this log"
        self.not_testable |= {tried[key].effect.name: not_finite for key in screen.spoiled}
        if at is self.start:
            absorbed = "the model's own parameters absorb it on this log"
            self.not_testable |= {s.effect.name: absorbed for s in by_name(screen.scores) if s.absorbed}
        return screen, facts

    def weigh(self, screen: Screen, found: Survey, remembers: float | None) -> None:
        """Compute the p-values of a screen for the residual noise with the best effect.

        A slow effect makes a residual that is correlated over its duration, a fast one looks like noise. So
        the residual of the best effect shows whether stretches depend on each other, whether the noise is
        louder than stated, and how much of it a column may collect, where it was stated.
        """
        base, autocorrelation, peak, louder = screen.base, found.autocorrelation, np.inf, found.fast
        lasting = screen.lasting >= self.policy.memories * memory(autocorrelation, self.policy)
        whole = screen.length is None or base.sliced or lasting
        offsets = (
            len(base.model.offsets) > 0
        )  # without them noise slower than a run is in no spectrum of a run
        loud = louder > (1 + self.policy.negligible) ** 2
        if screen.scores and (offsets or base.joined or loud or not whole):
            model = screen.scores[0].model
            left = screen.refits[model] = refit(with_model(base, model), self.runs)
            seen = survey(left.base, self.runs)
            louder = seen.fast
            if not whole:
                autocorrelation = min(
                    autocorrelation, seen.autocorrelation, key=lambda c: memory(c, self.policy)
                )
            peak = spectrum_peak(left.base, self.runs) if offsets else np.inf
            if base.joined and not base.sliced:
                remembers = memory_of_recording(left.base, frozenset(self.runs))
        screen.weigh(autocorrelation, remembers, peak, louder)

    def stands(self, exact: Exact, at: Refitted) -> bool:
        """Return whether a refit keeps the decrease of its score, and its parameters do not cancel.

        It must keep half of the threshold, and lower BIC.
        """
        lower = exact.fit.metric <= at.metric * (1 - self.policy.half * self.setup.threshold)
        known = at.base.model.names
        new = [n for n in exact.fit.base.model.names if n not in known]
        keeps = lower and exact.bic < at.bic(0)
        return keeps and not cancels(exact.fit, new)

    def reconsider(self) -> bool:
        """Test each effect but the last, which was, with the others in place; return whether one is replaced.

        So the rivals of each, with which it may be confusable, are refitted with the others in place too.
        """
        before = [e.name for e in self.effects]
        for k, effect in enumerate(self.effects[:-1]):
            if self.over(more=True):
                break
            if exact := self.step(self.without(effect)):
                self.effects[k] = replace(exact[0], rivals=tuple(exact[1:]))
                self.fit = exact[0].fit
        return [e.name for e in self.effects] != before

    def confirm(self) -> None:
        """For slices of one recording, test the effects again by the autocorrelation of the final residual.

        While effects are missing, the residual is correlated over their duration: slices count as
        independent. In the end the dependence between slices counts; effects must be significant with it.
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

    def on_all(self, setup: Setup) -> "Selection":
        """Return a search on a part of a log with its fit made on all samples; itself where it had them all.

        Rivals of an effect stay fitted to the part, and are compared there: on millions of samples the noise
        of a computed rate separates effects that no recording of this motion does.
        """
        if self.setup is setup:
            return self
        setup.say(f"fitting to all {setup.base.log.rows} samples")
        self.refits[tuple(self.effects)] = self.fit
        start = refit(setup.base, self.runs)
        whole = replace(self, setup=setup, start=start, refits={(): start}, searched=self)
        whole.fit = whole.fitted(tuple(self.effects))
        return whole

    def drop(self, *effects: Exact) -> None:
        """Continue without some effects."""
        self.fit = self.without(*effects)
        self.effects = [e for e in self.effects if e not in effects]

    def without(self, *left_out: Exact) -> Refitted:
        """Return the fit with all effects but some."""
        return self.fitted(tuple(e for e in self.effects if e not in left_out))

    def fitted(self, key: tuple[Exact, ...]) -> Refitted:
        """Return the fit with these effects; on a long log it begins at that on the part."""
        if key not in self.refits:
            if self.searched:
                log, keep = self.start.base.log, self.start.base.keep
                base = replace(self.searched.fitted(key).base, log=log, keep=keep)
            else:
                values = {name: v for e in key for name, v in e.fit.base.values.items()}
                base = with_effects(self.start.base, (e.score.variant for e in key), values)
            self.refits[key] = refit(base, self.runs)
        return self.refits[key]

    @property
    def others(self) -> list[Refitted]:
        """Alternatives that some runs might have selected: one effect left out, or another in its place."""
        out: list[Refitted] = []
        for e in self.effects:
            out.append(self.without(e))
            rest = {other.name for other in self.effects} - {e.name}
            out += [r.fit for r in e.rivals if rest <= set(r.fit.base.model.effects)]
        return [fit for fit in out if fit.base.log is self.fit.base.log]

    def screened_at(self, base: Base) -> Screen | None:
        """Return the last screening of the catalogue at a fit; None where there was none."""
        return next((s for s in reversed(self.screened) if s.base.model is base.model), None)
