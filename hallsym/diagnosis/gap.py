"""Is what a model leaves a gap? Lack of fit decides, and the noise floor as far as it is known."""

import numpy as np
from scipy.special import ndtri

from hallsym.diagnosis.lack_of_fit import Key, LackOfFit
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.setup import Floor


def worth_reporting(floor: Floor, threshold: float, policy: Policy) -> float:
    """Return the metric up to which nothing above the floor is worth reporting."""
    return floor.metric * (1 + policy.negligible) / (1 - threshold)


def shaped(found: LackOfFit, threshold: float, policy: Policy) -> bool:
    """Return whether a residual has a shape, or tones, that are worth the threshold by themselves."""
    need = 1 - (1 - threshold) / (1 + policy.negligible)
    best = found.best(policy.false_alarm)
    return found.tones >= need or (best is not None and best.drop >= need)


def remains(
    found: LackOfFit,
    slow: float,
    metric: float,
    floor: Floor,
    threshold: float,
    policy: Policy,
    error: float = 0.0,
) -> bool:
    """Return whether a residual of size `metric` is a gap although no effect is named for it.

    `slow`: decrease of the metric without what neighbouring samples have in common. `error`: standard error
    of the metric, over itself, that noise of this memory makes. A shape that predicts other runs and is worth
    the threshold is a gap by itself. Noise may be correlated and may be stated wrongly, so a residual without
    a shape is a gap only if it is far above a stated floor, by more than chance.
    """
    if shaped(found, threshold, policy):
        return True
    metric /= 1 + float(ndtri(1 - policy.false_alarm / 2)) * error
    if not floor.stated or metric <= worth_reporting(floor, threshold, policy):
        return False
    half = policy.half * threshold
    likely = any(s.p_value < policy.certain and s.drop >= half for s in found.shapes)
    large = metric > floor.metric * (1 + policy.unstructured)
    return likely or found.tones >= half or slow >= threshold or large


def used_up(
    before: LackOfFit, metric_before: float, after: LackOfFit, metric_after: float, policy: Policy
) -> float:
    """Return the least part of a shape that is gone with an effect, over all shapes that hold the effect.

    The cause of a shape leaves nothing of it. An effect that only resembles the cause takes a part of the
    shape and leaves the rest in the same coordinate. 1 where no shape holds the effect.
    """
    power, left = _powers(before, metric_before), _powers(after, metric_after)
    gain = max(metric_before**2 - metric_after**2, 1e-300)
    holding = [by for by in power if power[by] > 0 and power[by] - left.get(by, 0.0) >= policy.mostly * gain]
    return min((1 - left.get(by, 0.0) / power[by] for by in holding), default=1.0)


def slow_share(variance: float, fast: float) -> float:
    """Return the decrease of the metric without what neighbouring samples have in common."""
    return 1 - float(np.sqrt(min(1.0, fast / max(variance, 1e-12))))


def _powers(found: LackOfFit, metric: float) -> dict[str, float]:
    """Squares [m^2] that each kind of shape explains; curves over several coordinates of a kind add up."""
    best: dict[Key, float] = {Key("tones"): _power(found.tones, metric)}
    for shape in found.shapes:  # best first: the finest curve that pays
        best.setdefault(shape.key, _power(shape.drop, metric))
    kinds: dict[str, float] = {}
    for key, power in best.items():
        kinds[key.kind] = kinds.get(key.kind, 0.0) + power
    return kinds


def _power(drop: float, metric: float) -> float:
    return (1 - (1 - drop) ** 2) * metric**2
