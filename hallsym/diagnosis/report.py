"""What is said: the Diagnosis, put together from what the search found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from hallsym.diagnosis.alike import groups_of, ranked_names, smaller_findings
from hallsym.diagnosis.base import Base
from hallsym.diagnosis.curve_data import unexplained
from hallsym.diagnosis.decoded_errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.found import EITHER, closed, fault_record, found_effects, miswired, wiring_record
from hallsym.diagnosis.gap_size import sizes
from hallsym.diagnosis.holding import held
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.leftover import Leftover, leftover
from hallsym.diagnosis.localisation import Located, both, located
from hallsym.diagnosis.record import Diagnosis, FoundEffect, Separation
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.sentences import next_step, sentence, shapeless
from hallsym.diagnosis.verdict import ALLOWANCE, remains
from hallsym.diagnosis.waves import waves
from hallsym.diagnosis.words import gap_unit
from hallsym.estimation.calibration import Fit
from hallsym.estimation.channel_assignment import Wiring
from hallsym.log import Log

CLOSED = 0.9
"""Part of the excess above the floor that named effects must close where much is left.

Of a gap of twice the floor a tenth of the excess is 14 % above the floor: what is left is then a gap of its
own, and the verdict says so."""


@dataclass(frozen=True, eq=False)
class _Said:
    """What a diagnosis says of its effects; nothing where there is no gap."""

    effects: tuple[FoundEffect, ...]
    groups: tuple[tuple[str, ...], ...]
    ranked: tuple[str, ...]
    separate: tuple[Separation, ...]
    smaller: tuple[dict[str, Any], ...]
    gap_after: dict[str, dict[str, float]]
    after: float
    interval: tuple[float, float]
    added: int
    notes: tuple[str, ...] = ()


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
    start = search.start.base
    plain = replace(start, keep=None)
    before = _before(plain, log, apart, log.rows, result)
    weak = held(search, before, apart, log.rows)
    left = leftover(search, apart, log.rows, result.noise_floor, level)
    effects = _effects(search, log, result, wiring, apart, before, left)
    verdict = _verdict(search, effects, before, left, level)
    if verdict == "no gap":
        said = _nothing(search, effects, before, weak, level)
    else:
        said = _named(search, effects, before, left, weak, verdict)
    floor = search.floor.metric
    gap = _gap(search, plain, log, left, before.metric > floor * (1 + ALLOWANCE))
    rest = None
    if verdict == "unexplained":
        rest = gap if left.base is start else located(left.base, log.runs, search.scores_at(left.base))
    share = closed(before.metric, said.after, floor)
    pose = result.model.pose
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(
            verdict, said.effects, said.groups, before.metric, said.after, floor, gap_unit(pose)
        ),
        noise_floor={**left.floor, "source": _source(result)},
        gap_before=before.gap(),
        gap_after=said.gap_after,
        metric={"before": before.metric, "after": said.after, "floor": floor},
        shrinkage={
            "value": 1 - said.after / before.metric,
            "interval": list(said.interval),
            "share_closed": share,
            "parameters_added": said.added,
        },
        ranked=said.ranked,
        groups=said.groups,
        effects=said.effects,
        where=gap.statements,
        shares=gap.shares,
        size=_size(search, plain, log, gap, before, result, log.rows),
        remaining=rest.statements if rest else (),
        unexplained=unexplained(rest, 1 - share) if rest else {},
        separate_by=said.separate,
        validation_runs=apart,
        not_testable=search.not_testable,
        smaller_findings=said.smaller,
        threshold=level,
        model=result.model.name,
        log={**result.log, "runs_fitted": len(search.runs)},
        notes=tuple(dict.fromkeys((*result.notes, *left.notes, *said.notes))),
        seconds=seconds,
        versions=dict(result.versions),
        waves=waves(start, left.base if said.effects else None),
        next_step=next_step(
            result, said.effects, search, apart, bool(wiring and miswired(result.model, wiring))
        ),
    )


def _effects(
    search: Search,
    log: Log,
    result: Fit,
    wiring: Wiring | None,
    apart: tuple[int, ...],
    before: BlockErrors,
    left: Leftover,
) -> list[FoundEffect]:
    """Return effects of the model, faults of samples and the wiring, by their share of the excess."""
    floor, scale = search.floor.metric, left.metric / left.after.metric
    effects = found_effects(search, before, left.after, floor, left.inflation, apart, log.rows)
    effects += [fault_record(f, scale, before, left.after, floor, search.tested) for f in left.faults]
    if wiring and miswired(result.model, wiring):
        effects.insert(0, wiring_record(search.start.base, log, wiring, search, before, left.metric, floor))
    return sorted(effects, key=lambda e: -e.share)


def _verdict(
    search: Search, effects: Sequence[FoundEffect], before: BlockErrors, left: Leftover, level: float
) -> str:
    """Explained if what is named closes the gap, no gap if nothing is named and nothing remains."""
    named = bool(effects) and 1 - left.metric / before.metric >= level
    base, metric = (left.base, left.metric) if named else (search.start.base, before.metric)
    rest = left.rest if base is left.found else lack_of_fit(base, search.runs)
    open_ = remains(rest, left.slow, metric, search.floor, level)
    if not named:
        return "unexplained" if open_ else "no gap"
    share = closed(before.metric, left.metric, search.floor.metric)
    return "unexplained" if open_ and share < CLOSED else "explained"


def _named(
    search: Search,
    effects: Sequence[FoundEffect],
    before: BlockErrors,
    left: Leftover,
    weak: Sequence[dict[str, Any]],
    verdict: str,
) -> _Said:
    """Return what is said where there is a gap."""
    groups, separate = groups_of(search, left.inflation)
    if effects and effects[0].name in EITHER and len(search.start.base.model.pose) == 1:
        groups.insert(0, EITHER)  # either turns the angle round, and its zero is free
    share = left.metric / left.cured.metric
    after = left.cured.gap()
    after["rmse"] = {c: v * share for c, v in after["rmse"].items()}
    return _Said(
        effects=tuple(effects),
        groups=tuple(groups),
        ranked=tuple(ranked_names(effects, groups, search, verdict, left.inflation)),
        separate=tuple(separate),
        smaller=_smaller(search, weak),
        gap_after=after,
        after=left.metric,
        interval=interval(before, left.after),
        added=len(left.base.p) - len(search.start.base.p),
    )


def _nothing(
    search: Search,
    effects: Sequence[FoundEffect],
    before: BlockErrors,
    weak: Sequence[dict[str, Any]],
    level: float,
) -> _Said:
    """Return what is said where there is no gap: what was found is too small to be one."""
    small = [{"name": e.name, "shrinkage": e.shrinkage, "p_value": e.p_value} for e in effects]
    floor = search.floor
    above = before.metric > floor.high(level)
    return _Said(
        effects=(),
        groups=(),
        ranked=(),
        separate=(),
        smaller=(*small, *_smaller(search, weak)),
        gap_after=before.gap(),
        after=before.metric,
        interval=(0.0, 0.0),
        added=0,
        notes=(shapeless(before.metric / floor.metric, floor.stated),) if above else (),
    )


def _smaller(search: Search, weak: Sequence[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    """Return effects that do not hold on the held-out runs, and those that do little."""
    known = {w["name"] for w in weak}
    return (*weak, *(s for s in smaller_findings(search) if s["name"] not in known))


def _gap(search: Search, plain: Base, log: Log, left: Leftover, above: bool) -> Located:
    """Where the gap lies; faults of samples by their power over all of the excess."""
    if not above:
        return Located((), (), *both(plain, log.runs))
    return located(plain, log.runs, search.scores_at(search.start.base), left.faults, left.variance)


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


def _source(result: Fit) -> str:
    sources = {s.source for s in result.noise.sigmas.values()}
    return (
        "stated"
        if sources == {"given"}
        else "estimated"
        if sources == {"estimated"}
        else "stated and estimated"
    )
