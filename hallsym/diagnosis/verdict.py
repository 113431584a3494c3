"""The verdict, decided in one place from what the holdout runs say."""

from dataclasses import replace
from typing import Literal

import numpy as np

from hallsym.diagnosis.gap import remains, shaped, worth_reporting
from hallsym.diagnosis.lack_of_fit import lack_of_fit
from hallsym.diagnosis.noise import LARGER
from hallsym.diagnosis.record import NoiseFinding
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation

Verdict = Literal["no gap", "explained", "unexplained", "noise larger than stated"]
QUIET = ("no gap", LARGER)
"""Verdicts that name no effect."""


def decide(setup: Setup, found: Validation, noise: NoiseFinding | None = None) -> Verdict:
    """Return "explained" if what is named closes the gap, "no gap" if nothing is named and nothing is left.

    What is named must lower the gap by the threshold. A residual that is a gap by itself (`gap.remains`)
    makes the verdict "unexplained", unless what is named closes nearly all of the excess above the noise
    floor, or the excess is `noise` (of the model with what was found): then nothing is left to explain, and
    without a name the noise is larger than stated.
    """
    named = found.named and 1 - found.metric / found.before.metric >= setup.threshold
    base, metric = (found.base, found.metric) if named else (found.start.base, found.before.metric)
    rest = found.rest if base is found.end else lack_of_fit(base, setup.runs)
    gap = remains(rest, found.slow, metric, found.floor, setup.threshold, setup.policy)
    loud = noise is not None and all_noise(setup, found, metric, noise)
    if loud and not shaped(rest, setup.threshold, setup.policy):
        gap = False
    if not named:
        return "unexplained" if gap else LARGER if loud else "no gap"
    share = closed(found.before.metric, found.metric, found.floor.metric)
    return "unexplained" if gap and share < setup.policy.closes else "explained"


def all_noise(setup: Setup, found: Validation, metric: float, noise: NoiseFinding) -> bool:
    """Return whether what `metric` has above the stated floor is worth reporting, and noise explains it.

    Functions of the motion, the state and time then lower the metric by less than the threshold.
    """
    floor, policy = found.floor, setup.policy
    if not (floor.stated and noise.larger) or metric <= worth_reporting(floor, setup.threshold, policy):
        return False
    known = replace(floor, metric=floor.metric * noise.interval[1])
    return metric <= worth_reporting(known, setup.threshold, policy)


def closed(before: float, after: float, floor: float) -> float:
    """Return the share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0
