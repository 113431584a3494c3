"""What is left with the effects that were found: above which floor, through which faults of samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.decoded_errors import BlockErrors, block_errors
from hallsym.diagnosis.faults import TAILS, Fault, faults, without_tail
from hallsym.diagnosis.found import cures
from hallsym.diagnosis.lack_of_fit import LackOfFit, lack_of_fit
from hallsym.diagnosis.refit import refit
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.sentences import noise_held_gap
from hallsym.diagnosis.survey import survey
from hallsym.diagnosis.verdict import ALLOWANCE, UNSTRUCTURED, shaped, slow_share


@dataclass(frozen=True, eq=False)
class Leftover:
    """What is left of the gap with the effects that were found.

    `found`: the model as the search left it, `rest` the structure of what it leaves; `base`: the same without
    the samples that are faults by themselves. `after` are the errors of `found` on all held-out samples,
    `cured` those of `base`; `metric` is the gap without any fault of samples [m or rad]. `floor`: noise of
    the decoded pose by coordinate. `variance`: of the fitted samples' whitened residual; `slow` the decrease
    of the metric without what neighbouring samples have in common, `inflation` what that adds to a variance.
    """

    found: Base
    rest: LackOfFit
    base: Base
    after: BlockErrors
    cured: BlockErrors
    metric: float
    floor: dict[str, float]
    faults: tuple[Fault, ...]
    variance: float
    slow: float
    inflation: float
    notes: tuple[str, ...]


def leftover(
    search: Search, apart: tuple[int, ...], rows: int, floor: Mapping[str, float], level: float
) -> Leftover:
    """Judge what `search` leaves on the runs `apart`; floor and optimum of the search follow what is found.

    A floor that was estimated from a log with the gap in it is lowered to what the effects leave. Samples
    that are a fault by themselves are taken out, and the model is refitted without them.
    """
    end, runs = search.now.base, frozenset(search.runs)
    whole = survey(replace(end, keep=None), runs)
    kept = survey(end, runs) if end.keep else whole
    after = block_errors(replace(end, keep=None), apart, rows, None)
    spoiled = [f for f in faults(end, whole, search.tested) if cures(f) >= level]
    lowered, notes = _lower_floor(search, after, floor, spoiled)
    if after.metric <= search.floor.metric * (1 + ALLOWANCE):
        spoiled = []
    rest = lack_of_fit(end, search.runs)
    spoiled = _scatter(spoiled, rest, level)
    base, cured = end, after
    if any(f.name in TAILS for f in spoiled):
        search.now = refit(replace(end, keep=without_tail(end)), search.runs)
        base = search.now.base
        cured = block_errors(base, apart, rows, base.keep)
    smooth = sum(f.power for f in spoiled if f.name not in TAILS)
    metric = cured.metric * float(np.sqrt(max(1 - smooth, 1e-6)))
    return Leftover(
        found=end,
        rest=rest,
        base=base,
        after=after,
        cured=cured,
        metric=max(metric, min(search.floor.metric, cured.metric)),
        floor=lowered,
        faults=tuple(spoiled),
        variance=whole.variance,
        slow=slow_share(kept.variance, kept.fast),
        inflation=kept.inflation,
        notes=notes,
    )


def _lower_floor(
    search: Search, after: BlockErrors, floor: Mapping[str, float], spoiled: Sequence[Fault]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Lower an estimated floor to what effects, or few steps of CORDIC, leave: it held a part of the gap."""
    chip = sum(f.power for f in spoiled if f.name == "cordic_steps")  # an error of each angle, no noise
    least = after.metric * float(np.sqrt(max(1 - chip, 1e-6)))
    before = search.floor.metric
    explained = bool(search.found or chip)
    if search.floor.stated or not explained or least * (1 + UNSTRUCTURED) >= before:
        return dict(floor), ()
    search.floor = replace(search.floor, metric=least)
    return {c: v * least / before for c, v in floor.items()}, (noise_held_gap(before / least),)


def _scatter(spoiled: Sequence[Fault], rest: LackOfFit, level: float) -> list[Fault]:
    """Return the faults that are no part of a shape, which may look like late samples here and there."""
    if not shaped(rest, level):
        return list(spoiled)
    least = max(rest.lines, *(s.drop for s in rest.shapes))
    return [f for f in spoiled if f.name != "clock_jitter" and cures(f) >= least]
