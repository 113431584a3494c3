"""What is said: the Diagnosis, put together from what the search found."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.calibration import Fit
from hallsym.diagnosis.errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.faults import TAILS, Fault, faults, without_tail
from hallsym.diagnosis.kinds import kind_of
from hallsym.diagnosis.price import price
from hallsym.diagnosis.ranking import by_name, distance
from hallsym.diagnosis.record import Diagnosis, Estimate, FoundEffect, Separation
from hallsym.diagnosis.refit import refit
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.separate import separation
from hallsym.diagnosis.shape import unexplained
from hallsym.diagnosis.structure import structure
from hallsym.diagnosis.survey import survey
from hallsym.diagnosis.tangent import Base
from hallsym.diagnosis.verdict import ALLOWANCE, remains, shaped, slow_share
from hallsym.diagnosis.where import NOTHING, located
from hallsym.log import Log
from hallsym.model import Model
from hallsym.wiring import Wiring

APART = 25.0
"""Whitened squared distance, over the residual's variance, from which on two fits can be told apart."""
CLOSED = 0.9
"""Part of the excess above the floor that named effects must close where much is left."""
CLOSE_SECOND = 0.9
"""Part of what the best explains from which on another effect is listed behind it."""
EITHER = ("sign_inversion", "channel_swap")
"""Faults of the wiring that an angle read from two channels cannot tell apart."""
REASON = 20.0
"""Difference of BIC from which on parameters that are not needed tell an effect from a plainer one."""
SMALL = 0.01
"""Significance, corrected for the catalogue, of a smaller finding."""


def report(
    search: Search,
    log: Log,
    result: Fit,
    apart: tuple[int, ...],
    wiring: Wiring | None,
    level: float,
    seconds: float,
) -> Diagnosis:
    """Judge what `search` found on the held-out runs `apart` and say it; `level` is the threshold."""
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
    floor_metric = search.floor.metric
    spoiled = [f for f in faults(now, final) if _cures(f) >= level]
    if after.metric <= floor_metric * (1 + ALLOWANCE):
        spoiled = []
    search_end, rest = now, structure(now, search.runs)
    if shaped(rest, level):  # what has a shape is no scatter, and may look like late samples here and there
        least = max(rest.lines, *(s.drop for s in rest.shapes))
        spoiled = [
            f for f in spoiled if f.name != "clock_jitter" and 1 - np.sqrt(max(1 - f.power, 0.0)) >= least
        ]
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
    named = bool(effects) and drop >= level
    if (now if named else start) is not search_end:
        rest = structure(now if named else start, search.runs)
    slow = slow_share(kept.variance, kept.fast)
    open_ = remains(rest, slow, left if named else before.metric, search.floor, level)
    verdict = _verdict(named, open_, _closed(before.metric, left, floor_metric))
    groups, separate = _groups(search, inflation) if verdict != "no gap" else ([], [])
    if effects and effects[0].name in EITHER and len(result.model.pose) == 1:
        groups.insert(0, EITHER)  # either turns the angle round, and its zero is free
    ranked = _ranked(effects, groups, search, verdict) if verdict != "no gap" else []
    smaller = _smaller(search)
    if verdict == "no gap":
        smaller = [
            {"name": e.name, "shrinkage": e.shrinkage, "p_value": e.p_value} for e in effects
        ] + smaller
    share = left / cured.metric
    gap_after = {
        k: {c: v * (share if k == "rmse" else 1.0) for c, v in row.items()} for k, row in cured.gap().items()
    }
    noted = []
    if verdict == "no gap":
        if before.metric > search.floor.high(level):
            noted.append(_shapeless(before.metric / floor_metric, search.floor.stated))
        gap_after, left, effects = before.gap(), before.metric, []
    low, high = interval(before, after)
    gap = located(plain, log.runs) if before.metric > floor_metric * (1 + ALLOWANCE) else NOTHING
    remainder = NOTHING
    if verdict == "unexplained":
        remainder = gap if now is start else located(now, log.runs)
    return Diagnosis(
        verdict=verdict,
        sentence=_sentence(
            verdict, effects, groups, before.metric, left, floor_metric, unit_of(result.model)
        ),
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
        where=gap.statements,
        remaining=remainder.statements,
        unexplained=unexplained(remainder, 1 - _closed(before.metric, left, floor_metric))
        if verdict == "unexplained"
        else {},
        separate_by=tuple(separate),
        validation_runs=apart,
        not_testable=search.not_testable,
        smaller_findings=tuple(smaller),
        threshold=level,
        model=result.model.name,
        log={**result.log, "runs_fitted": len(search.runs)},
        notes=tuple(dict.fromkeys((*result.notes, *noted))),
        seconds=seconds,
        versions=dict(result.versions),
    )


def _before(plain: Base, log: Log, apart: tuple[int, ...], rows: int, result: Fit) -> BlockErrors:
    """Errors of the model as it was, on the readings as they were wired."""
    if result.wiring is not None and _miswired(result.model, result.wiring):
        plain = replace(plain, log=log)
    return block_errors(plain, apart, rows, None)


def _verdict(named: bool, remains: bool, closed: float) -> str:
    if not named:
        return "unexplained" if remains else "no gap"
    return "unexplained" if remains and closed < CLOSED else "explained"


def _closed(before: float, after: float, floor: float) -> float:
    """Share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0


def _effects(
    search: Search,
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
        p = score.corrected(tested)
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
                p_value=p,
                shrinkage=1 - after.metric / errors.metric,
                interval=interval(errors, after),
                share=float(np.clip((errors.metric**2 - after.metric**2) / excess, 0.0, 1.0)),
                cost=price(without.base.model, model),
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
    if len(model.channels) == 1:
        return False  # a direction, not a wire
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


def _groups(search: Search, inflation: float) -> tuple[list[tuple[str, ...]], list[Separation]]:
    """Effects that this log cannot tell apart: refits that leave the same residual."""
    groups, separate = [], []
    for found in search.found:
        one = found.exact
        N = float(one.fit.tangents.count[one.fit.fitted].sum()) * len(one.fit.base.model.channels)
        limit = APART * max(one.fit.cost / N, 1e-12) * inflation
        rivals = found.rivals
        if kind_of(
            one.fit.base.model
        ).pairs:  # more parameters, for which the log gives no reason, are no rival
            rivals = [r for r in rivals if r.bic - one.bic < REASON]
        close = [(r, distance(one.fit, r.fit)) for r in rivals if r.fit.cost - one.fit.cost < limit]
        close = [(r, d) for r, d in close if d < limit][:3]
        if not close:
            continue
        names = (one.score.effect.name, *(r.score.effect.name for r, _ in close))
        groups.append(names)
        least = min(d for _, d in close)
        records = dict.fromkeys(e.score.effect.record for e in (one, *(r for r, _ in close)))
        separate.append(
            separation(
                names, [one.fit, *(r.fit for r, _ in close)], least, limit / APART, "; or ".join(records)
            )
        )
    return groups, separate


def _ranked(
    effects: Sequence[FoundEffect], groups: Sequence[tuple[str, ...]], search: Search, verdict: str
) -> list[str]:
    """Names that carry evidence: the effects by share, what is the same on this log, what came close."""
    rivals = [
        r.score.effect.name
        for f in search.found
        for r in f.rivals
        if verdict == "explained" and r.score.gain >= CLOSE_SECOND * f.exact.score.gain
    ]
    grouped = [name for group in groups for name in group]
    return list(dict.fromkeys([*(e.name for e in effects), *grouped, *rivals]))


def _smaller(search: Search) -> list[dict[str, Any]]:
    """Effects that are significant beside what was found, and lower the gap by less than the threshold."""
    out, tested = [], len(search.catalogue)
    names = {f.exact.score.effect.name for f in search.found}
    for score in by_name(search.last):
        p = score.corrected(tested)
        if p < SMALL and score.ratio < 1.0 and score.effect.name not in names:
            out.append({"name": score.effect.name, "shrinkage": 1 - score.ratio, "p_value": p})
    return out


def unit_of(model: Model) -> tuple[float, str]:
    """Return factor and unit in which a person reads the gap metric."""
    return (1e6, "um") if any(c.endswith("_m") for c in model.pose) else (180 / np.pi, "deg")


def _sentence(
    verdict: str,
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    before: float,
    left: float,
    floor: float,
    unit: tuple[float, str],
) -> str:
    size, name = unit
    times = before / max(floor, 1e-300)
    said = f"The gap on the held-out runs is {size * before:.3g} {name}, {times:.3g} x the noise floor"
    if verdict == "no gap":
        what = "is what noise leaves" if before <= floor * (1 + ALLOWANCE) else "holds no gap worth reporting"
        noise = f"{size * floor:.3g} {name}"
        return f"No gap: {size * before:.3g} {name} on the held-out runs {what} (noise: {noise})."
    if not effects:
        return f"{said}; no known effect explains it."
    named = " and ".join(next((" or ".join(g) for g in groups if e.name in g), e.name) for e in effects)
    rest = "" if verdict == "explained" else ", and the rest has no known cause"
    return f"{said}; {named} brings it to {size * left:.3g} {name}{rest}."


def _cures(fault: Fault) -> float:
    """Decrease of the metric without a fault."""
    return 1 - float(np.sqrt(max(1 - fault.power, 0.0)))


def _shapeless(times: float, stated: bool) -> str:
    """What to say of noise that is more than it is said to be."""
    return (
        f"What is left is {times:.3g} x the {'stated' if stated else 'estimated'} noise and follows nothing "
        "that the log holds: the noise is larger, or more correlated in time, than that."
    )


def _source(result: Fit) -> str:
    sources = {s.source for s in result.noise.sigmas.values()}
    return (
        "stated"
        if sources == {"given"}
        else "estimated"
        if sources == {"estimated"}
        else "stated and estimated"
    )
