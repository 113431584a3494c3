"""The greedy search: score the catalogue, refit what is promising, keep the best, and ask again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.change_points import MAX_SEGMENTS, instants, switched_runs
from hallsym.diagnosis.collinearity import cancelled
from hallsym.diagnosis.effect import Effect, Facts
from hallsym.diagnosis.faults import KINDS
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.plainer import plain_pairs
from hallsym.diagnosis.ranking import Exact, bic_of, refitted
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.scores import Score, by_name, candidates, scores
from hallsym.diagnosis.survey import MAINS, SEGMENT, Survey, survey
from hallsym.diagnosis.verdict import ALLOWANCE, SURE, USED_UP, Floor, remains, slow_share, used_up
from hallsym.estimation.calibration import Fit
from hallsym.estimation.channel_assignment import as_read
from hallsym.estimation.gauss_newton import cost_near
from hallsym.log import Log
from hallsym.log.batches import batches, remembered
from hallsym.model import Model

REPEATS = 4
"""Times that a channel must take its very highest or lowest value for that to be a rail.

A turning point may fall on one step of the converter two or three times."""
TYPICAL_INFLATION = 2.0
"""Variance of a slow average over that of white noise, assumed in BIC while searching, where it is unknown.

It only weighs parameters against squares; the effects that are found are judged by what the final residual
shows."""


def base_of(log: Log, result: Fit) -> Base:
    """Return a fit as the point at which tangents are taken."""
    wired = as_read(log, result.model, result.wiring)
    sigma = result.noise.std
    cost = cost_near(wired, result.model, result.values, sigma, result.keep)
    point = cost.at(result.values)
    return Base(
        log=wired,
        model=result.model,
        p=np.array(result.values, dtype=float),
        zeros=dict(zip(cost.summary.runs, point.zeros, strict=True)),
        covariance=point.covariance.mean(axis=0),
        free=tuple(k for k, n in enumerate(result.model.names) if n not in result.held),
        pose_weights=result.model.family.pose_metric.weights(result.model.pose, log.meta.gap_length_scale_m),
        apart=frozenset(result.log["holdout"]),
        sigma=sigma,
        keep=remembered(result.keep, wired.rows),
    )


def floor_of(result: Fit, weights: np.ndarray) -> Floor:
    """Return the gap metric that noise alone leaves."""
    metric = float(np.linalg.norm(weights * np.array(list(result.noise_floor.values()))))
    return Floor(metric, all(s.source == "given" for s in result.noise.sigmas.values()))


def facts_of(base: Base, found: Survey) -> Facts:
    """Return what effects may know of the log; numbers searched for in the residual of `base`."""
    model, log = base.model, base.log
    temperature = _mean(log, "temperature_degc") if "temperature_degc" in log.columns else None
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        columns=tuple(c for c in log.columns if base.timed or c != "t_s"),
        temperature=temperature,
        extremes=_extremes(log, model),
        rails=rails_of(log, model),
        lines_hz=found.lines_hz,
        lines_tried=max(1, round(sum(b - a for a, b in MAINS) * found.duration_s)),
        instants=instants(base, log.runs, log.rows),
        instants_tried=len(model.layout) * min(MAX_SEGMENTS, -(-log.rows // SEGMENT) + len(log.runs)),
        on_runs=switched_runs(base) if len(model.channels) > len(model.pose) and not model.zeros else (),
    )


def _mean(log: Log, column: str) -> float:
    sums = [(b.data[column].sum(), len(b)) for b in batches(log, (column,))]
    return float(sum(s for s, _ in sums) / sum(n for _, n in sums))


def rails_of(log: Log, model: Model) -> tuple[tuple[float, float], ...]:
    """Return the extreme values of each channel that come again and again, exactly: its rails."""
    low, high = np.full(len(model.channels), np.inf), np.full(len(model.channels), -np.inf)
    at_low, at_high = np.zeros(len(low)), np.zeros(len(low))
    for batch in batches(log, model.channels):
        values = np.array(batch.columns(model.channels))
        lowest, highest = values.min(axis=1), values.max(axis=1)
        at_low = np.where(lowest < low, 0, at_low)
        at_high = np.where(highest > high, 0, at_high)
        low, high = np.minimum(low, lowest), np.maximum(high, highest)
        at_low += (values == low[:, None]).sum(axis=1)
        at_high += (values == high[:, None]).sum(axis=1)
    return tuple(
        (a if n >= REPEATS else -np.inf, b if m >= REPEATS else np.inf)
        for a, b, n, m in zip(low.tolist(), high.tolist(), at_low, at_high, strict=True)
    )


def _extremes(log: Log, model: Model) -> np.ndarray:
    """Quantiles of a sample of the readings, high and low in turn: rails that are tried."""
    step = max(1, log.rows // 50_000)
    values = np.hstack([np.array(b.columns(model.channels))[:, ::step] for b in batches(log, model.channels)])
    return np.vstack([np.quantile(values, [a, 1 - a], axis=1) for a in (0.998, 0.99, 0.97, 0.93)])


@dataclass(eq=False)
class Found:
    """An effect in the set: how it was fitted when it came in, and what else came close.

    `before`: whitened squares that were left without it.
    """

    exact: Exact
    rivals: list[Exact] = field(default_factory=list)
    before: float = 0.0

    @property
    def first_order(self) -> float:
        """Whitened squares that the effect leaves to first order, by its score."""
        return self.before - self.exact.score.gain

    @property
    def left(self) -> float:
        """Whitened squares that it leaves once it is fitted."""
        return self.exact.fit.cost


class Search:
    """The greedy search; after `run`, what it found."""

    def __init__(
        self,
        base: Base,
        runs: list[int],
        catalogue: Sequence[Effect],
        level: float,
        floor: Floor,
        say: Callable[[str], None],
    ) -> None:
        self.floor = floor
        self.runs, self.catalogue, self.level, self.say = runs, tuple(catalogue), level, say
        self.tested = len(self.catalogue) + KINDS
        self.start = refit(base, runs)
        self.now = self.start
        self.found: list[Found] = []
        self.not_testable: dict[str, str] = {}
        self.last: list[Score] = []
        self.scored: list[tuple[Refitted, list[Score]]] = []
        self.owner: dict[str, str] = {}
        self.survey = Survey()
        self.most = base.model.family.most_effects

    def run(self) -> None:
        """Add effects while they lower the gap metric by the threshold; then ask of each again.

        Where another takes the place of one, what is left is another rest, and is asked about too.
        """
        self.grow()
        if self.found:
            self.prune()
        if len(self.found) > 1 and self.reconsider():
            self.grow()

    def grow(self) -> None:
        """Add effects while they lower the gap metric by the threshold."""
        for count in range(len(self.found), self.most + 1):
            self.say(f"testing {len(self.catalogue)} effects" + (f" beside {count}" if count else ""))
            exact, self.last = self.step(self.now, partial(self.worth, beside=count))
            if not exact or not self.worth(exact[0].score, count):
                break
            self.found.append(Found(exact[0], exact[1:], self.now.cost))
            self.now = exact[0].fit

    def scores_at(self, base: Base) -> list[Score]:
        """Return how the catalogue scored at a fit that was asked about; nothing elsewhere."""
        return next((ranked for at, ranked in self.scored if at.base is base), [])

    def worth(self, score: Score, beside: int) -> bool:
        """Return whether an effect lowers the gap enough; one `beside` others must be needed and certain.

        A first effect that is certain is taken up from half the threshold on: on the held-out runs, which
        decide, it may be worth more (a temperature that only they reach).
        """
        if beside == self.most:
            return False
        certain = score.corrected(self.tested) < SURE
        if not beside:
            return score.ratio <= 1 - self.level or (certain and score.ratio <= 1 - self.level / 2)
        needed = not self.floor.stated or self.gap(self.now) > self.floor.metric * (1 + ALLOWANCE)
        return needed and certain and score.ratio <= 1 - self.level

    def gap(self, at: Refitted) -> float:
        """Gap metric on the fitted runs."""
        return at.gap(at.fitted)

    def keeps(self, exact: Exact, at: Refitted) -> bool:
        """Return whether an exact fit keeps what its score promised: half of the threshold, at its price."""
        lower = self.gap(exact.fit) <= self.gap(at) * (1 - self.level / 2)
        return lower and exact.bic < bic_of(at, 0, TYPICAL_INFLATION)

    def prune(self) -> None:
        """Where a gap remains, drop effects that only resemble what makes it: they leave its shape behind."""
        rest = lack_of_fit(self.now.base, self.runs)
        seen = survey(self.now.base, frozenset(self.runs))
        gap = self.gap(self.now)
        if not remains(rest, slow_share(seen.variance, seen.fast), gap, self.floor, self.level):
            return
        kept = []
        for k, found in enumerate(self.found):
            others = [f.exact for j, f in enumerate(self.found) if j != k]
            without = self.rebuilt(others) if others else self.start
            before = lack_of_fit(without.base, self.runs)
            if used_up(before, self.gap(without), rest, gap) >= USED_UP:
                kept.append(found)
        if len(kept) < len(self.found):
            self.found = kept
            self.now = self.rebuilt([f.exact for f in kept]) if kept else self.start
            if kept:
                self.prune()

    def step(
        self, at: Refitted, worth: Callable[[Score], bool] = lambda _: True
    ) -> tuple[list[Exact], list[Score]]:
        """Score the catalogue at `at` and refit what is promising, if anything is `worth` it."""
        self.survey = survey(at.base, frozenset(self.runs))
        facts = facts_of(at.base, self.survey)
        tried, trouble = candidates(at.base, self.catalogue, facts)
        self.not_testable |= {t.name: t.reason for t in trouble}
        ranked, t = scores(at.base, tried, self.runs, TYPICAL_INFLATION)
        self.scored.append((at, ranked))
        for s in ranked:
            self.owner |= {n: s.effect.name for n in s.model.names if n not in at.base.model.names}
        for key in t.spoiled:
            self.not_testable[key.split("|")[0]] = "its readings are not finite on this log"
        for score in by_name(ranked):
            if score.absorbed and at is self.start:
                self.not_testable[score.effect.name] = "the model's own parameters absorb it on this log"
        exact = refitted(
            at.base, ranked, self.runs, facts, TYPICAL_INFLATION, worth,
            lambda e: self.keeps(e, at) and not cancelled(e.fit, at, self.start, self.owner),
        )  # fmt: skip
        if at.base.model.family.pairs:
            exact = plain_pairs(exact, self.catalogue, self.runs, facts, TYPICAL_INFLATION)
        return exact, ranked

    def reconsider(self) -> bool:
        """Ask of each effect again, with the others in place, which one it should be; say if any changed."""
        before = [f.exact.score.effect for f in self.found]
        for k in range(len(self.found) - 1):  # the last was chosen with the others in place
            others = [f.exact for j, f in enumerate(self.found) if j != k]
            without = self.rebuilt(others)
            exact, _ = self.step(without)
            if not exact:
                continue
            self.found[k] = Found(exact[0], exact[1:], without.cost)
            self.now = exact[0].fit
        return [f.exact.score.effect for f in self.found] != before

    def rebuilt(self, exact: Sequence[Exact]) -> Refitted:
        """Fit the base model with some of the effects."""
        base = self.start.base
        for e in exact:
            base = _with_effect(base, e)
        return refit(base, self.runs)


def _with_effect(base: Base, exact: Exact) -> Base:
    wide = with_model(base, exact.score.variant.make(base.model))
    known = dict(zip(exact.fit.base.model.names, exact.fit.base.p, strict=True))
    p = np.array([known.get(n, v) for n, v in zip(wide.model.names, wide.p, strict=True)])
    return replace(wide, p=p)
