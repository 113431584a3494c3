"""The verdict, decided in one place from what the holdout runs say."""

from typing import Literal

import numpy as np

from hallsym.diagnosis.gap import remains
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation

Verdict = Literal["no gap", "explained", "unexplained"]


def decide(setup: Setup, found: Validation) -> Verdict:
    """Return "explained" if what is named closes the gap, "no gap" if nothing is named and nothing is left.

    What is named must lower the gap by the threshold, and be certain by a score or hold on all judging runs.
    A residual that is a gap by itself (`gap.remains`) makes the verdict "unexplained", unless what is named
    closes nearly all of the excess above the noise floor.
    """
    judged, certain = found.judged, setup.policy.certain
    held = judged is None or judged.holds or min(e.p_value for e in found.effects) < certain
    named = found.named and held and 1 - found.metric / found.before.metric >= setup.threshold
    base, metric = (found.base, found.metric) if named else (found.start.base, found.before.metric)
    rest = found.rest if base is found.end else lack_of_fit(base, setup.runs)
    gap = remains(rest, found.slow, metric, found.floor, setup.threshold, setup.policy)
    if not named:
        return "unexplained" if gap else "no gap"
    share = closed(found.before.metric, found.metric, found.floor.metric)
    return "unexplained" if gap and share < setup.policy.closes else "explained"


def closed(before: float, after: float, floor: float) -> float:
    """Return the share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0
