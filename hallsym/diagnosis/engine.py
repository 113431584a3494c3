"""`diagnose`: where the gap is, which effect makes it, and how far it shrinks once that effect is added.

The base model is fitted on the fit runs. Effects are then added greedily: one pass scores the catalogue, the
promising ones are refitted exactly, the best is kept if it lowers the gap metric enough in cross-validation
within the fit runs. Only the final set is judged, once, on the held-out runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from hallsym import fitting
from hallsym.calibration import Fit
from hallsym.cost import cost_of
from hallsym.decoding import columns_of
from hallsym.diagnosis.chance import chance, statistic_at
from hallsym.diagnosis.effect import Effect, Facts
from hallsym.diagnosis.errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.faults import TAILS, Fault, faults, without_tail
from hallsym.diagnosis.ranking import Exact, Score, by_name, candidates, distance, refitted, scores
from hallsym.diagnosis.record import Diagnosis, Estimate, FoundEffect, Separation
from hallsym.diagnosis.refit import Refitted, refit
from hallsym.diagnosis.slips import instants
from hallsym.diagnosis.stage_catalogue import CATALOGUE
from hallsym.diagnosis.survey import Survey, survey
from hallsym.diagnosis.tangent import Base
from hallsym.diagnosis.where import where
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.log import Log, clean_log
from hallsym.model import Model
from hallsym.summary import summarise
from hallsym.wiring import Wiring, rewired

THRESHOLD = 0.05
"""Relative decrease of the gap metric from which on a gap is worth reporting."""
MOST = 3
"""Effects that are added at most."""
TYPICAL_INFLATION = 2.0
"""Assumed while searching; the effects that are found are judged by what the final residual shows."""
APART = 25.0
"""Whitened squared distance, over the residual's variance, from which on two fits can be told apart."""
ALLOWANCE = 0.03
"""How well the noise floor is known: what is left may be this much above it, beyond the threshold."""
CLOSED = 0.9
"""Part of the excess above the floor that named effects must close where much is left."""
SMALL = 0.01
"""Significance, corrected for the catalogue, of a smaller finding."""
HOLD_EVERY = 5


def diagnose(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Diagnose the gap between `model` and the machine that recorded `log`.

    `model`: a name, a Model, or a Fit whose model is taken; the log's own base model by default. `holdout`:
    runs to judge on; the log's own, else every fifth. `effects`: the user's own, beside the catalogue.
    `threshold`: relative decrease of the gap metric that counts; the log's own, else 5 %.

    Raises `InputError` for a log that the model cannot have produced or with too few runs to hold any out.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    apart = _holdout(log, holdout)
    level = _threshold(log, threshold)
    say("fitting the model")
    log, result = _fitted(log, model, apart, drop_bad, say)
    if result.model.family != "stage":
        raise InputError(
            f"Model {result.model.name} has no catalogue of effects yet; only stage models have."
        )
    wiring = result.wiring
    base = base_of(log, result)
    runs = [r for r in base.log.runs if r not in apart]
    search = _Search(base, runs, (*CATALOGUE, *effects), level, say)
    search.run()
    return _report(search, log, result, apart, wiring, level, perf_counter() - began)


def _fitted(
    log: Log,
    model: str | Model | Fit | None,
    apart: tuple[int, ...],
    drop_bad: bool,
    say: Callable[[str], None],
) -> tuple[Log, Fit]:
    """Fit the model; samples that no fit can use are left out, which is then noted."""
    if isinstance(model, Fit):
        model = model.model
    if not isinstance(model, Model):
        model = build(model or log.meta.base_model or "stage31", meta=log.meta)

    def fitted(source: Log) -> Fit:
        return fitting.fit(
            source, model, solver="direct", holdout=apart, resolve_wiring=True, on_progress=say
        )

    if not drop_bad:
        try:
            return log, fitted(log)
        except InputError as error:
            refused = error
    cleaned = clean_log(log, columns_of(model))
    if not drop_bad and cleaned.rows == log.rows:
        raise refused
    result = fitted(cleaned)
    return cleaned, replace(result, notes=(*cleaned.notes, *result.notes))


def base_of(log: Log, result: Fit) -> Base:
    """Return a fit as the point at which tangents are taken."""
    wired = rewired(log, result.model.channels, result.wiring)
    sigma = {c: s.value for c, s in result.noise.sigmas.items()}
    cost = cost_of(summarise(wired, result.model, result.keep), sigma)
    point = cost.at(result.values)
    return Base(
        log=wired,
        model=result.model,
        p=np.array(result.values, dtype=float),
        zeros=dict(zip(cost.summary.runs, point.zeros, strict=True)),
        covariance=point.covariance.mean(axis=0),
        free=tuple(k for k, n in enumerate(result.model.names) if n not in result.held),
        length_m=log.meta.gap_length_scale_m or 0.35,
        apart=frozenset(result.log["holdout"]),
        sigma=sigma,
        keep=result.keep,
    )


def facts_of(base: Base, found: Survey) -> Facts:
    """Return what effects may know of the log; numbers searched for in the residual of `base`."""
    model, log = base.model, base.log
    temperature = _mean(log, "temperature_degc") if "temperature_degc" in log.columns else None
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        step_s=found.step_s,
        columns=log.columns,
        temperature=temperature,
        extremes=_extremes(log, model),
        lines_hz=found.lines_hz,
        # before or after: a held-out run says it of itself, like its zero deviation
        instants=instants(base, log.runs, log.rows),
        gains=tuple(float(base.p[model.names.index(f"eta_{p.label}")]) for p in model.layout),
    )


def _mean(log: Log, column: str) -> float:
    sums = [(b.data[column].sum(), len(b.data[column])) for b in log.blocks((column,))]
    return float(sum(s for s, _ in sums) / sum(n for _, n in sums))


def _extremes(log: Log, model: Model) -> np.ndarray:
    """Quantiles of a sample of the readings, high and low in turn: rails that are tried."""
    parts = [np.array([b.data[c] for c in model.channels])[:, :: max(1, log.rows // 50_000)]
             for b in log.blocks(model.channels)]  # fmt: skip
    values = np.hstack(parts)
    return np.vstack([np.quantile(values, [a, 1 - a], axis=1) for a in (0.998, 0.99, 0.97, 0.93)])


@dataclass(eq=False)
class Found:
    """An effect in the set: how it was fitted when it came in, and what else came close."""

    exact: Exact
    rivals: list[Exact] = field(default_factory=list)


class _Search:
    """The greedy search; after `run`, what it found."""

    def __init__(
        self,
        base: Base,
        runs: list[int],
        catalogue: Sequence[Effect],
        level: float,
        say: Callable[[str], None],
    ) -> None:
        self.runs, self.catalogue, self.level, self.say = runs, tuple(catalogue), level, say
        self.start = refit(base, runs)
        self.now = self.start
        self.found: list[Found] = []
        self.not_testable: dict[str, str] = {}
        self.last: list[Score] = []
        self.survey = Survey()

    def run(self) -> None:
        for count in range(MOST + 1):
            self.say(f"testing {len(self.catalogue)} effects" + (f" beside {count}" if count else ""))
            exact, ranked = self.step(self.now)
            self.last = ranked
            if count == MOST or not exact or exact[0].score.ratio > 1 - self.level:
                break
            self.found.append(Found(exact[0], exact[1:]))
            self.now = exact[0].fit
        if len(self.found) > 1:
            self.reconsider()

    def step(self, at: Refitted) -> tuple[list[Exact], list[Score]]:
        """Score the catalogue at `at` and refit what is promising."""
        self.survey = survey(at.base, frozenset(self.runs))
        facts = facts_of(at.base, self.survey)
        tried, trouble = candidates(at.base, self.catalogue, facts)
        self.not_testable |= {t.name: t.reason for t in trouble}
        ranked, t = scores(at.base, tried, self.runs, TYPICAL_INFLATION)
        for key in t.spoiled:
            self.not_testable[key.split("|")[0]] = "its readings are not finite on this log"
        for score in by_name(ranked):
            if score.absorbed:
                self.not_testable[score.effect.name] = "the model's own parameters absorb it on this log"
        return refitted(at.base, ranked, self.runs, facts, TYPICAL_INFLATION), ranked

    def reconsider(self) -> None:
        """Ask of each effect again, with the others in place, which one it should be."""
        for k in range(len(self.found)):
            others = [f.exact for j, f in enumerate(self.found) if j != k]
            without = self.rebuilt(others)
            exact, _ = self.step(without)
            if not exact:
                continue
            self.found[k] = Found(exact[0], exact[1:])
            self.now = exact[0].fit

    def rebuilt(self, exact: Sequence[Exact]) -> Refitted:
        """Fit the base model with some of the effects."""
        base = self.start.base
        for e in exact:
            base = _with_effect(base, e)
        return refit(base, self.runs)


def _with_effect(base: Base, exact: Exact) -> Base:
    from hallsym.diagnosis.refit import with_model

    wide = with_model(base, exact.score.variant.make(base.model))
    known = dict(zip(exact.fit.base.model.names, exact.fit.base.p, strict=True))
    p = np.array([known.get(n, v) for n, v in zip(wide.model.names, wide.p, strict=True)])
    return replace(wide, p=p)


# -- what is said ------------------------------------------------------------------------------------------


def _report(
    search: _Search,
    log: Log,
    result: Fit,
    apart: tuple[int, ...],
    wiring: Wiring | None,
    level: float,
    seconds: float,
) -> Diagnosis:
    start, now, rows = search.start.base, search.now.base, log.rows
    plain = replace(start, keep=None)
    final = survey(replace(now, keep=None), frozenset(search.runs))
    kept = survey(now, frozenset(search.runs)) if now.keep else final
    inflation = kept.inflation
    before, after = (
        _before(plain, log, apart, rows, result),
        block_errors(replace(now, keep=None), apart, rows, None),
    )
    floor = dict(result.noise_floor)
    floor_metric = float(
        np.sqrt(sum((start.length_m * v if c.startswith("r") else v) ** 2 for c, v in floor.items()))
    )
    spoiled = [f for f in faults(now, final) if 1 - np.sqrt(max(1 - f.power, 0.0)) >= level]
    if after.metric <= floor_metric * (1 + ALLOWANCE):
        spoiled = []
    cured = after
    if any(f.name in TAILS for f in spoiled):
        now = replace(now, keep=without_tail(now))
        search.now = refit(now, search.runs)
        now = search.now.base
        cured = block_errors(now, apart, rows, now.keep)
    smooth = [f for f in spoiled if f.name not in TAILS]
    left = cured.metric * float(np.sqrt(max(1 - sum(f.power for f in smooth), 1e-6)))
    left = max(left, min(floor_metric, cured.metric))
    scale = left / after.metric
    effects = _effects(search, before, after, floor_metric, inflation, apart, rows)
    effects += [_fault_record(f, scale, before, after, floor_metric) for f in spoiled]
    if wiring and _miswired(result.model, wiring):
        effects.insert(0, _wiring_record(result.model, wiring, before, left, floor_metric))
    effects.sort(key=lambda e: -e.share)
    drop = 1 - left / before.metric
    verdict = _verdict(bool(effects), drop, before.metric, left, floor_metric, level)
    groups, separate = _groups(search, inflation) if verdict != "no gap" else ([], [])
    ranked = _ranked(effects, groups, search) if verdict != "no gap" else []
    smaller = _smaller(search, inflation)
    if verdict == "no gap":
        smaller = [
            {"name": e.name, "shrinkage": e.shrinkage, "p_value": e.p_value} for e in effects
        ] + smaller
    rest = left / cured.metric
    gap_after = {
        k: {c: v * (rest if k == "rmse" else 1.0) for c, v in row.items()} for k, row in cured.gap().items()
    }
    if verdict == "no gap":
        gap_after, left, effects = before.gap(), before.metric, []
    low, high = interval(before, after)
    everywhere = list(log.runs)
    return Diagnosis(
        verdict=verdict,
        sentence=_sentence(verdict, effects, groups, before.metric, left, floor_metric),
        noise_floor={**floor, "source": _source(result)},
        gap_before=before.gap(),
        gap_after=gap_after,
        metric={"before": before.metric, "after": left, "floor": floor_metric},
        shrinkage={
            "value": 1 - left / before.metric,
            "interval": [low, high] if verdict != "no gap" else [0.0, 0.0],
            "share_closed": _closed(before.metric, left, floor_metric),
            "parameters_added": len(now.p) - len(start.p) if verdict != "no gap" else 0,
        },
        ranked=tuple(ranked),
        groups=tuple(groups),
        effects=tuple(effects),
        where=where(plain, everywhere, inflation) if before.metric > floor_metric * (1 + ALLOWANCE) else (),
        remaining=where(now, everywhere, inflation) if verdict == "unexplained" else (),
        separate_by=tuple(separate),
        validation_runs=apart,
        not_testable=search.not_testable,
        smaller_findings=tuple(smaller),
        threshold=level,
        model=result.model.name,
        log={**result.log, "runs_fitted": len(search.runs)},
        notes=tuple(dict.fromkeys(result.notes)),
        seconds=seconds,
        versions=dict(result.versions),
    )


def _before(plain: Base, log: Log, apart: tuple[int, ...], rows: int, result: Fit) -> BlockErrors:
    """Errors of the model as it was, on the readings as they were wired."""
    if result.wiring is not None and _miswired(result.model, result.wiring):
        plain = replace(plain, log=log)
    return block_errors(plain, apart, rows, None)


def _verdict(named: bool, drop: float, before: float, left: float, floor: float, level: float) -> str:
    high = floor * (1 + ALLOWANCE) / (1 - level)
    named = named and drop >= level
    if not named:
        return "unexplained" if before > high else "no gap"
    return "explained" if left <= high or _closed(before, left, floor) >= CLOSED else "unexplained"


def _closed(before: float, after: float, floor: float) -> float:
    """Share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0


def _effects(
    search: _Search,
    before: BlockErrors,
    after: BlockErrors,
    floor: float,
    inflation: float,
    apart: tuple[int, ...],
    rows: int,
) -> list[FoundEffect]:
    out, tested = [], len(search.catalogue)
    N = float(search.now.tangents.count[search.now.fitted].sum()) * len(search.start.base.model.channels)
    noise = max(search.now.cost / N, 1e-12)
    spread = np.sqrt(np.maximum(np.diag(search.now.covariance()), 0.0) * noise * inflation)
    for k, found in enumerate(search.found):
        others = [f.exact for j, f in enumerate(search.found) if j != k]
        without = search.rebuilt(others) if others else search.start
        errors = block_errors(replace(without.base, keep=None), apart, rows, None) if others else before
        score = found.exact.score
        gain = max(without.cost - search.now.cost, 0.0)
        p = chance(gain / (noise * inflation), score.size)
        new = [n for n in score.model.names if n not in without.base.model.names]
        model = search.now.base.model
        values = {
            n: Estimate(
                float(search.now.base.p[model.names.index(n)]),
                float(spread[model.names.index(n)]),
                model.parameters[model.names.index(n)].unit,
            )
            for n in new
            if n in model.names
        }
        excess = max(before.metric**2 - floor**2, 1e-300)
        out.append(
            FoundEffect(
                name=score.effect.name,
                link=score.effect.link,
                variant=score.variant.label,
                parameters=values,
                p_value=min(1.0, p * tested),
                shrinkage=1 - after.metric / errors.metric,
                interval=interval(errors, after),
                share=float(np.clip((errors.metric**2 - after.metric**2) / excess, 0.0, 1.0)),
                cost=f"{len(values)} parameters; {score.effect.runtime}",
            )
        )
    return out


def _fault_record(
    fault: Fault, scale: float, before: BlockErrors, after: BlockErrors, floor: float
) -> FoundEffect:
    excess = max(before.metric**2 - floor**2, 1e-300)
    share = float(np.clip((1 - scale**2) * after.metric**2 / excess, 0.0, 1.0))
    return FoundEffect(
        fault.name, fault.link, fault.text, fault.parameters, fault.p_value, 1 - scale,
        (1 - scale, 1 - scale), share, "no parameter: a repair, not a model",
    )  # fmt: skip


def _miswired(model: Model, wiring: Wiring) -> bool:
    return any(source != c or sign < 0 for c, (source, sign) in zip(model.channels, wiring, strict=True))


def _wiring_record(
    model: Model, wiring: Wiring, before: BlockErrors, left: float, floor: float
) -> FoundEffect:
    swapped = [c for c, (source, _) in zip(model.channels, wiring, strict=True) if source != c]
    flipped = [source for source, sign in wiring if sign < 0]
    what = f"{' and '.join(swapped)} exchanged" if swapped else f"{' and '.join(flipped)} inverted"
    drop = 1 - left / before.metric
    return FoundEffect(
        "channel_swap" if swapped else "sign_inversion", "electronics", what, {}, 0.0, drop, (drop, drop),
        _closed(before.metric, left, floor), "no parameter: the wiring is put right",
    )  # fmt: skip


def _groups(search: _Search, inflation: float) -> tuple[list[tuple[str, ...]], list[Separation]]:
    """Effects that this log cannot tell apart: refits that leave the same residual."""
    groups, separate = [], []
    for found in search.found:
        one = found.exact
        N = float(one.fit.tangents.count[one.fit.fitted].sum()) * len(one.fit.base.model.channels)
        limit = APART * max(one.fit.cost / N, 1e-12) * inflation
        close = [(r, distance(one.fit, r.fit)) for r in found.rivals if r.fit.cost - one.fit.cost < limit]
        close = [(r, d) for r, d in close if d < limit][:3]
        if not close:
            continue
        names = (one.score.effect.name, *(r.score.effect.name for r, _ in close))
        groups.append(names)
        least = min(d for _, d in close)
        records = dict.fromkeys(e.score.effect.record for e in (one, *(r for r, _ in close)))
        separate.append(
            Separation(names, "; or ".join(records), least, limit, float((limit / max(least, 1e-12)) ** 0.5))
        )
    return groups, separate


def _ranked(effects: Sequence[FoundEffect], groups: Sequence[tuple[str, ...]], search: _Search) -> list[str]:
    """Names that carry evidence: the effects by share, what is the same on this log, what came close."""
    rivals = [r.score.effect.name for f in search.found for r in f.rivals]
    grouped = [name for group in groups for name in group]
    return list(dict.fromkeys([*(e.name for e in effects), *grouped, *rivals]))


def _smaller(search: _Search, inflation: float) -> list[dict[str, Any]]:
    """Effects that are significant beside what was found, and lower the gap by less than the threshold."""
    out, tested = [], len(search.catalogue)
    names = {f.exact.score.effect.name for f in search.found}
    for score in by_name(search.last):
        statistic = statistic_at(max(score.p_value, 1e-300), score.size) * TYPICAL_INFLATION / inflation
        p = min(1.0, chance(statistic, score.size) * tested)
        if p < SMALL and score.ratio < 1.0 and score.effect.name not in names:
            out.append({"name": score.effect.name, "shrinkage": 1 - score.ratio, "p_value": p})
    return out


def _sentence(
    verdict: str,
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    before: float,
    left: float,
    floor: float,
) -> str:
    times = before / max(floor, 1e-300)
    said = f"The gap on the held-out runs is {1e6 * before:.3g} um, {times:.3g} x the noise floor"
    if verdict == "no gap":
        return (
            f"No gap: {1e6 * before:.3g} um on the held-out runs is what noise leaves ({1e6 * floor:.3g} um)."
        )
    if not effects:
        return f"{said}; no known effect explains it."
    named = " and ".join(next((" or ".join(g) for g in groups if e.name in g), e.name) for e in effects)
    rest = "" if verdict == "explained" else ", and the rest has no known cause"
    return f"{said}; {named} brings it to {1e6 * left:.3g} um{rest}."


def _source(result: Fit) -> str:
    sources = {s.source for s in result.noise.sigmas.values()}
    return (
        "stated"
        if sources == {"given"}
        else "estimated"
        if sources == {"estimated"}
        else "stated and estimated"
    )


def _holdout(log: Log, holdout: Sequence[int] | None) -> tuple[int, ...]:
    """Held-out runs: as asked, the log's own, else every fifth."""
    if holdout is None:
        holdout = log.meta.holdout or log.runs[HOLD_EVERY // 2 :: HOLD_EVERY]
    if len(log.runs) < 3 or len(log.runs) - len(set(holdout)) < 2 or not holdout:
        raise InputError(
            f"{log.name} has {len(log.runs)} runs, too few to hold any out and still choose an effect on the "
            "others (2 to fit and 1 to judge on at least); record more runs or split a long one."
        )
    return tuple(holdout)


def _threshold(log: Log, threshold: float | None) -> float:
    level = threshold if threshold is not None else (log.meta.gap_threshold_rel or THRESHOLD)
    if not 0 < level < 1:
        raise InputError(f"Input threshold of diagnose must be between 0 and 1; instead received {level:g}.")
    return float(level)
