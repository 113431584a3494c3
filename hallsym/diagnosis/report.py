"""What is said: the Diagnosis, put together from what the search found."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.calibration import Fit
from hallsym.diagnosis.alike import groups_of, ranked_names, smaller_findings
from hallsym.diagnosis.errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.faults import TAILS, Fault, faults, without_tail
from hallsym.diagnosis.found import (
    EITHER,
    closed,
    cures,
    fault_record,
    found_effects,
    miswired,
    wiring_record,
)
from hallsym.diagnosis.holding import held
from hallsym.diagnosis.kinds import kind_of
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.refit import refit
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.sentences import next_step, noise_held_gap, sentence, shapeless
from hallsym.diagnosis.shape import unexplained
from hallsym.diagnosis.size import sizes
from hallsym.diagnosis.structure import structure
from hallsym.diagnosis.survey import survey
from hallsym.diagnosis.tangent import Base
from hallsym.diagnosis.verdict import ALLOWANCE, UNSTRUCTURED, remains, shaped, slow_share
from hallsym.diagnosis.waves import waves
from hallsym.diagnosis.where import Located, both, located
from hallsym.diagnosis.words import gap_unit
from hallsym.log import Log
from hallsym.wiring import Wiring

CLOSED = 0.9
"""Part of the excess above the floor that named effects must close where much is left.

Of a gap of twice the floor a tenth of the excess is 14 % above the floor: what is left is then a gap of its
own, and the verdict says so."""


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
    spoiled = [f for f in faults(now, final, search.tested) if cures(f) >= level]
    chip = sum(f.power for f in spoiled if f.name == "cordic_steps")  # an error of each angle, no noise
    least = after.metric * float(np.sqrt(max(1 - chip, 1e-6)))
    held_gap = least * (1 + UNSTRUCTURED) < search.floor.metric
    if not search.floor.stated and (search.found or chip) and held_gap:
        noted.append(noise_held_gap(search.floor.metric / least))
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
    effects = found_effects(search, before, after, floor_metric, inflation, apart, rows)
    effects += [fault_record(f, scale, before, after, floor_metric, search.tested) for f in spoiled]
    if wiring and miswired(result.model, wiring):
        effects.insert(0, wiring_record(start, log, wiring, search, before, left, floor_metric))
    effects.sort(key=lambda e: -e.share)
    drop = 1 - left / before.metric
    named = bool(effects) and drop >= level
    if (now if named else start) is not search_end:
        rest = structure(now if named else start, search.runs)
    slow = slow_share(kept.variance, kept.fast)
    open_ = remains(rest, slow, left if named else before.metric, search.floor, level)
    verdict = _verdict(named, open_, closed(before.metric, left, floor_metric))
    groups, separate = groups_of(search, inflation) if verdict != "no gap" else ([], [])
    if effects and effects[0].name in EITHER and len(result.model.pose) == 1:
        groups.insert(0, EITHER)  # either turns the angle round, and its zero is free
    ranked = ranked_names(effects, groups, search, verdict, inflation) if verdict != "no gap" else []
    smaller = weak + [s for s in smaller_findings(search) if s["name"] not in {w["name"] for w in weak}]
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
            noted.append(shapeless(before.metric / floor_metric, search.floor.stated))
        gap_after, left, effects = before.gap(), before.metric, []
    low, high = interval(before, after)
    gap = _gap(search, plain, log, spoiled, final.variance, before.metric > floor_metric * (1 + ALLOWANCE))
    remainder = None
    if verdict == "unexplained":
        remainder = gap if now is start else located(now, log.runs, search.scores_at(now))
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(
            verdict, effects, groups, before.metric, left, floor_metric, gap_unit(result.model.pose)
        ),
        noise_floor={**floor, "source": _source(result)},
        gap_before=before.gap(),
        gap_after=gap_after,
        metric={"before": before.metric, "after": left, "floor": floor_metric},
        shrinkage={
            "value": 1 - left / before.metric,
            "interval": [low, high] if verdict != "no gap" else [0.0, 0.0],
            "share_closed": closed(before.metric, left, floor_metric),
            "parameters_added": len(now.p) - len(start.p) if verdict != "no gap" else 0,
        },
        ranked=tuple(ranked),
        groups=tuple(groups),
        effects=tuple(effects),
        where=gap.statements,
        shares=gap.shares,
        size=_size(search, plain, log, gap, before, result, rows),
        remaining=remainder.statements if remainder else (),
        unexplained=unexplained(remainder, 1 - closed(before.metric, left, floor_metric))
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
        next_step=next_step(result, effects, search, apart, bool(wiring and miswired(result.model, wiring))),
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
    if result.wiring is not None and miswired(result.model, result.wiring):
        plain = replace(plain, log=log)
        fitted, held = both(plain, log.runs)
    errors = {"fitted": block_errors(plain, search.runs, rows, None), "held_out": before}
    return sizes({"fitted": fitted, "held_out": held}, errors, result.noise_floor)


def _before(plain: Base, log: Log, apart: tuple[int, ...], rows: int, result: Fit) -> BlockErrors:
    """Errors of the model as it was, on the readings as they were wired."""
    if result.wiring is not None and miswired(result.model, result.wiring):
        plain = replace(plain, log=log)
    return block_errors(plain, apart, rows, None)


def _verdict(named: bool, remains: bool, closed: float) -> str:
    if not named:
        return "unexplained" if remains else "no gap"
    return "unexplained" if remains and closed < CLOSED else "explained"


def _source(result: Fit) -> str:
    sources = {s.source for s in result.noise.sigmas.values()}
    return (
        "stated"
        if sources == {"given"}
        else "estimated"
        if sources == {"estimated"}
        else "stated and estimated"
    )
