"""What is said: the Diagnosis, put together from what the search found."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.calibration import Fit, added_effects
from hallsym.diagnosis.errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.faults import TAILS, Fault, faults, wiring_p, wirings, without_tail
from hallsym.diagnosis.holding import held, holding
from hallsym.diagnosis.kinds import kind_of
from hallsym.diagnosis.price import price
from hallsym.diagnosis.ranking import Exact, by_name, distance
from hallsym.diagnosis.record import Diagnosis, Estimate, FoundEffect, Separation
from hallsym.diagnosis.refit import refit
from hallsym.diagnosis.search import Found, Search
from hallsym.diagnosis.separate import separation
from hallsym.diagnosis.shape import unexplained
from hallsym.diagnosis.size import sizes
from hallsym.diagnosis.structure import structure
from hallsym.diagnosis.survey import survey
from hallsym.diagnosis.tangent import Base
from hallsym.diagnosis.verdict import ALLOWANCE, UNSTRUCTURED, remains, shaped, slow_share
from hallsym.diagnosis.waves import waves
from hallsym.diagnosis.where import Located, both, located
from hallsym.families.recipes import FAULTS
from hallsym.log import Log
from hallsym.model import Model
from hallsym.wiring import Wiring

APART = 25.0
"""Squared distance of two fits at which they are told apart, in variances of a slow average: 5 sigma."""
CLOSED = 0.9
"""Part of the excess above the floor that named effects must close where much is left.

Of a gap of twice the floor a tenth of the excess is 14 % above the floor: what is left is then a gap of its
own, and the verdict says so."""
EITHER = ("sign_inversion", "channel_swap")
"""Faults of the wiring that an angle read from two channels cannot tell apart."""
REASON = 20.0
"""Difference of BIC from which on parameters that are not needed tell an effect from a plainer one."""
SMALL = 0.01
"""Significance, corrected for the catalogue, of a smaller finding."""
SMALLEST = 0.1
"""Part of the threshold from which on a smaller finding is listed; with many samples anything is significant,
such as the noise of the reference that its rates and the residual share."""


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
    start, rows = search.start.base, log.rows
    plain = replace(start, keep=None)
    before = _before(plain, log, apart, rows, result)
    weak = held(search, before, apart, rows)
    now = search.now.base
    final = survey(replace(now, keep=None), frozenset(search.runs))
    kept = survey(now, frozenset(search.runs)) if now.keep else final
    inflation = kept.inflation
    after = block_errors(replace(now, keep=None), apart, rows, None)
    floor, noted = dict(result.noise_floor), []
    spoiled = [f for f in faults(now, final, search.tested) if _cures(f) >= level]
    chip = sum(f.power for f in spoiled if f.name == "cordic_steps")  # an error of each angle, no noise
    least = after.metric * float(np.sqrt(max(1 - chip, 1e-6)))
    held_gap = least * (1 + UNSTRUCTURED) < search.floor.metric
    if not search.floor.stated and (search.found or chip) and held_gap:
        noted.append(_noise_held_gap(search.floor.metric / least))
        floor = {c: v * least / search.floor.metric for c, v in floor.items()}
        search.floor = replace(search.floor, metric=least)
    floor_metric = search.floor.metric
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
    effects += [_fault_record(f, scale, before, after, floor_metric, search.tested) for f in spoiled]
    if wiring and _miswired(result.model, wiring):
        effects.insert(0, _wiring_record(start, log, wiring, search, before, left, floor_metric))
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
    ranked = _ranked(effects, groups, search, verdict, inflation) if verdict != "no gap" else []
    smaller = weak + [s for s in _smaller(search) if s["name"] not in {w["name"] for w in weak}]
    if verdict == "no gap":
        smaller = [
            {"name": e.name, "shrinkage": e.shrinkage, "p_value": e.p_value} for e in effects
        ] + smaller
    share = left / cured.metric
    gap_after = {
        k: {c: v * (share if k == "rmse" else 1.0) for c, v in row.items()} for k, row in cured.gap().items()
    }
    if verdict == "no gap":
        if before.metric > search.floor.high(level):
            noted.append(_shapeless(before.metric / floor_metric, search.floor.stated))
        gap_after, left, effects = before.gap(), before.metric, []
    low, high = interval(before, after)
    gap = _gap(search, plain, log, spoiled, final.variance, before.metric > floor_metric * (1 + ALLOWANCE))
    remainder = None
    if verdict == "unexplained":
        remainder = gap if now is start else located(now, log.runs, search.scores_at(now))
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
        shares=gap.shares,
        size=_size(search, plain, log, gap, before, result, rows),
        remaining=remainder.statements if remainder else (),
        unexplained=unexplained(remainder, 1 - _closed(before.metric, left, floor_metric))
        if remainder
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
        waves=waves(kind_of(start.model).waves, start, now if effects else None),
        next_step=_next_step(
            result, effects, search, apart, bool(wiring and _miswired(result.model, wiring))
        ),
    )


def _gap(
    search: Search, plain: Base, log: Log, spoiled: Sequence[Fault], variance: float, above: bool
) -> Located:
    """Where the gap lies; faults of samples by their power over all of the excess."""
    if not above:
        return Located((), (), *both(plain, log.runs))
    return located(plain, log.runs, search.scores_at(search.start.base), spoiled, variance)


def _size(
    search: Search, plain: Base, log: Log, gap: Located, before: BlockErrors, result: Fit, rows: int
) -> dict[str, Any]:
    """How large the gap is, on the readings as they were wired."""
    fitted, held = gap.fitted, gap.held
    if result.wiring is not None and _miswired(result.model, result.wiring):
        plain = replace(plain, log=log)
        fitted, held = both(plain, log.runs)
    errors = {"fitted": block_errors(plain, search.runs, rows, None), "held_out": before}
    return sizes({"fitted": fitted, "held_out": held}, errors, result.noise_floor)


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
    out = []
    N = float(search.now.tangents.count[search.now.fitted].sum()) * len(search.start.base.model.channels)
    noise = max(search.now.cost / N, 1e-12)
    spread = np.sqrt(np.maximum(np.diag(search.now.covariance()), 0.0) * noise * inflation)
    stuck = search.now.at_bound()
    unseen = search.now.unseen()
    for each in holding(search, before, after, apart, rows):
        found, without, errors = each.found, each.without, each.errors
        score = found.exact.score
        new = [n for n in score.model.names if n not in without.base.model.names]
        model = search.now.base.model
        index = {n: model.names.index(n) for n in new if n in model.names}
        values = {
            n: Estimate(
                float(search.now.base.p[j]),
                None if j in stuck or j in unseen else float(spread[j]),
                model.parameters[j].unit,
            )
            for n, j in index.items()
        }
        ended = tuple(n for n, j in index.items() if j in stuck)
        blind = [n for n, j in index.items() if j in unseen]
        excess = max(before.metric**2 - floor**2, 1e-300)
        out.append(
            FoundEffect(
                name=score.effect.name,
                link=score.effect.link,
                variant=score.variant.label,
                parameters=values,
                p_value=each.p_value,
                shrinkage=1 - after.metric / errors.metric,
                interval=interval(errors, after),
                share=float(np.clip((errors.metric**2 - after.metric**2) / excess, 0.0, 1.0)),
                cost=price(without.base.model, model, search.now.base.p),
                text=score.variant.text,
                at_bound=ended,
                note=" ".join([_stuck(ended)] * bool(ended) + [_blind(blind)] * bool(blind)),
            )
        )
    return out


def _stuck(names: Sequence[str]) -> str:
    """What to say of parameters that ended at a bound."""
    ended = "its bound" if len(names) == 1 else "their bounds"
    return (
        f"{', '.join(names)} ended at {ended}: the data ask for more than is allowed; there is no interval, "
        "and those of the others hold only with it there. Either the bound is wrong for this machine, or "
        "another effect does part of the work."
    )


def _blind(names: Sequence[str]) -> str:
    """What to say of parameters that no sample depends on."""
    return f"No sample of this log depends on {', '.join(names)}: held at the nominal value."


def _noise_held_gap(times: float) -> str:
    """What to say of a noise floor that was estimated too high."""
    return (
        f"The noise was estimated {times:.3g} x as large as what is left: a pattern from sample to sample "
        "was counted as noise. What is left is taken as the floor; state the noise (--noise) where known."
    )


def _fault_record(
    fault: Fault, scale: float, before: BlockErrors, after: BlockErrors, floor: float, tested: int
) -> FoundEffect:
    excess = max(before.metric**2 - floor**2, 1e-300)
    share = float(np.clip((1 - scale**2) * after.metric**2 / excess, 0.0, 1.0))
    return FoundEffect(
        fault.name, fault.link, fault.text, fault.parameters,
        min(1.0, fault.p_value * tested), 1 - scale,
        (1 - scale, 1 - scale), share, "no parameter: a repair, not a model", note=_repair(fault.name),
    )  # fmt: skip


def _repair(name: str) -> str:
    return f"{name} {FAULTS[name]}"


def _next_step(
    result: Fit, effects: Sequence[FoundEffect], search: Search, apart: tuple[int, ...], wired: bool
) -> tuple[str, ...]:
    """What `hallsym fit LOG` takes to fit the model with the effects that were found, in their order."""
    named = {e.name for e in effects if e.text}
    texts = [f.exact.score.variant.text for f in search.found if f.exact.score.effect.name in named]
    if not texts:
        return ()
    words = ["--model", result.model.name]
    for text in (*added_effects(result.model), *texts):
        words += ["--effect", text]
    return (*words, "--holdout", ",".join(map(str, apart)), *(["--resolve-wiring"] if wired else []))


def _miswired(model: Model, wiring: Wiring) -> bool:
    if len(model.channels) == 1:
        return False  # a direction, not a wire
    return any(source != c or sign < 0 for c, (source, sign) in zip(model.channels, wiring, strict=True))


def _wiring_record(
    base: Base, log: Log, wiring: Wiring, search: Search, before: BlockErrors, left: float, floor: float
) -> FoundEffect:
    model = base.model
    swapped = [c for c, (source, _) in zip(model.channels, wiring, strict=True) if source != c]
    flipped = [source for source, sign in wiring if sign < 0]
    what = f"{' and '.join(swapped)} exchanged" if swapped else f"{' and '.join(flipped)} inverted"
    drop = 1 - left / before.metric
    p = min(1.0, wiring_p(base, log, search.runs) * search.tested * wirings(len(model.channels)))
    return FoundEffect(
        "channel_swap" if swapped else "sign_inversion", "electronics", what, {}, p, drop, (drop, drop),
        _closed(before.metric, left, floor), "no parameter: the wiring is put right",
        note=_repair("channel_swap" if swapped else "sign_inversion"),
    )  # fmt: skip


def _groups(search: Search, inflation: float) -> tuple[list[tuple[str, ...]], list[Separation]]:
    """Effects that this log cannot tell apart: refits that leave the same residual."""
    groups, separate = [], []
    for found in search.found:
        one = found.exact
        limit = _limit(one, inflation)
        rivals = _standing(found, inflation)
        if kind_of(one.fit.base.model).pairs:  # parameters for which the log gives no reason make no rival
            rivals = [r for r in rivals if r.bic - one.bic < REASON]
        close = [(r, distance(one.fit, r.fit)) for r in rivals]
        close = [(r, d) for r, d in close if d < limit][:3]
        if not close:
            continue
        names = (one.score.effect.name, *(r.score.effect.name for r, _ in close))
        groups.append(names)
        least = min(d for _, d in close)
        members = (one, *(r for r, _ in close))
        records = dict.fromkeys(way for e in members for way in e.score.effect.record.split("; or "))
        separate.append(
            separation(
                names, [one.fit, *(r.fit for r, _ in close)], least, limit / APART, "; or ".join(records)
            )
        )
    return groups, separate


def _limit(one: Exact, inflation: float) -> float:
    """Squares by which two fits must differ to be told apart."""
    N = float(one.fit.tangents.count[one.fit.fitted].sum()) * len(one.fit.base.model.channels)
    return APART * max(one.fit.cost / N, 1e-12) * inflation


def _standing(found: Found, inflation: float) -> list[Exact]:
    """Effects that the log does not exclude in the place of the one that was found."""
    limit = _limit(found.exact, inflation)
    return [r for r in found.rivals if r.fit.cost - found.exact.fit.cost < limit]


def _ranked(
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    search: Search,
    verdict: str,
    inflation: float,
) -> list[str]:
    """Names that carry evidence: the effects by share, what is the same on this log, what is not excluded.

    An effect that does not lower the gap on the held-out runs has none.
    """
    rivals = [
        r.score.effect.name for f in search.found for r in _standing(f, inflation) if verdict == "explained"
    ]
    grouped = [name for group in groups for name in group]
    return list(dict.fromkeys([*(e.name for e in effects if e.share > 0), *grouped, *rivals]))


def _smaller(search: Search) -> list[dict[str, Any]]:
    """Effects that are significant beside what was found, and lower the gap by less than the threshold."""
    out, tested = [], search.tested
    names = {f.exact.score.effect.name for f in search.found}
    for score in by_name(search.last):
        p = score.corrected(tested)
        # what is worth more was judged, and not taken
        small = SMALLEST * search.level <= 1 - score.ratio < search.level
        if p < SMALL and small and score.effect.name not in names:
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
