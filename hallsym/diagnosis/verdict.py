"""The verdict, decided in one place from what the holdout runs say."""

from collections.abc import Collection
from dataclasses import replace
from typing import Literal

import numpy as np

from hallsym.diagnosis.change_points import change_points
from hallsym.diagnosis.decoded_errors import decoded_errors
from hallsym.diagnosis.gap import remains, shaped, worth_reporting
from hallsym.diagnosis.lack_of_fit import LackOfFit, lack_of_fit
from hallsym.diagnosis.noise import LARGER, in_outputs
from hallsym.diagnosis.record import NoiseFinding
from hallsym.diagnosis.residual_table import both
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation

Verdict = Literal[
    "no gap", "explained", "behaves like", "partly explained", "unexplained", "noise larger than stated"
]
QUIET = ("no gap", LARGER)
"""Verdicts that name no effect."""
WITH_REST = ("partly explained", "unexplained")
"""Verdicts that leave a gap without a cause."""


def decide(
    setup: Setup, found: Validation, resembled: Collection[str] = (), noise: NoiseFinding | None = None
) -> Verdict:
    """Return "explained" if what is named closes the gap, "no gap" if nothing is named and nothing is left.

    `resembled`: effects that a flexible alternative beats. Where the effect that closes most of the gap is
    one of them, or its parameters ended at their bounds, the machine behaves like it, and the cause is not
    known.

    What is named must lower the gap by the threshold, and be certain by a score or hold on all judging runs.
    A residual that is a gap by itself (`gap.remains`) makes the verdict "unexplained", unless what is named
    closes nearly all of the excess above the noise floor, or the excess is `noise` (of the model with what
    was found): then nothing is left to explain, and without a name the noise is larger than stated. The gap
    is partly explained where what is named closes most of the excess and what is left has a shape, or is a
    step within a holdout run: such a run does not judge the effects.
    """
    judged, certain = found.judged, setup.policy.certain
    held = judged is None or judged.holds or min(e.p_value for e in found.effects) < certain
    before, after, stepped = found.before.metric, found.metric, False
    if found.effects and closed(before, after, found.floor.metric) < 1 - setup.policy.minor:
        before, after, stepped = _without_steps(setup, found)
    named = found.named and held and 1 - after / before >= setup.threshold
    base, metric = (found.base, found.metric) if named else (found.start.base, found.before.metric)
    rest = found.rest if base is found.end else lack_of_fit(base, setup.runs)
    gap = remains(rest, found.slow, metric, found.floor, setup.threshold, setup.policy, found.error)
    loud = noise is not None and all_noise(setup, found, rest, metric, noise)
    gap = gap and not loud
    if not named:
        return "unexplained" if gap else LARGER if loud else "no gap"
    share = closed(before, after, found.floor.metric)
    main = max(found.effects, key=lambda h: h.errors.metric, default=None)
    ended = {found.base.model.names[k] for k in found.fit.at_bound()}
    only_like = main is not None and (main.name in resembled or bool(ended & set(main.added)))
    if gap and (stepped or share < 1 - setup.policy.minor):
        structured = stepped or shaped(rest, setup.threshold, setup.policy)
        most = share >= setup.policy.half and structured and not only_like
        return "partly explained" if most else "unexplained"
    return "behaves like" if only_like else "explained"


def _without_steps(setup: Setup, found: Validation) -> tuple[float, float, bool]:
    """Return the gap before and after on the holdout runs that hold no certain step, and whether any does."""
    holdout = set(setup.holdout)
    tables = [t for t in both(found.end, (*setup.runs, *setup.holdout)) if t is not None]
    steps = {s.run for s in change_points(*tables) if s.p_value < setup.policy.certain}
    clean = sorted(holdout - steps)
    if not clean or not holdout & steps:
        return found.before.metric, found.metric, False
    bases = setup.as_logged(found.start.base), found.base.on_all
    before, after = (decoded_errors(b, clean).metric for b in bases)
    return before, after, True


def all_noise(setup: Setup, found: Validation, rest: LackOfFit, metric: float, noise: NoiseFinding) -> bool:
    """Return whether what `metric` has above the stated floor is worth reporting, and noise explains it.

    No function of the motion, the state and time may predict half of the threshold; nor may waves or steps
    between levels be in it. Where differences of neighbouring samples have the stated noise in full, within
    what a floor is known to, noise that is correlated is something on top of it.
    """
    floor, policy, threshold = found.floor, setup.policy, setup.threshold
    if not (floor.stated and noise.larger) or noise.bounded:
        return False
    if metric <= worth_reporting(floor, threshold, policy) or shaped(rest, threshold, policy):
        return False
    half = policy.half * threshold
    if rest.tones >= half or any(s.p_value < policy.false_alarm and s.drop >= half for s in rest.shapes):
        return False
    slow_on_top = not noise.white and abs(found.fast - 1.0) < policy.negligible
    known = replace(floor, metric=floor.metric * in_outputs(found.base, noise))
    return not slow_on_top and metric <= worth_reporting(known, threshold, policy)


def closed(before: float, after: float, floor: float) -> float:
    """Return the share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0
