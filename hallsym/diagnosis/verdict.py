"""Is what is left still a gap? Lack of fit decides, and the noise floor as far as it is known."""

from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.features import Key
from hallsym.diagnosis.lack_of_fit import LackOfFit

SURE = 0.01
"""Significance, corrected for all that was tried, from which on an effect or a fault is certain."""
ALLOWANCE = 0.03
"""How well a stated noise floor is known: what is left may be this much above it, beyond the threshold.

A deviation taken from n samples is known to 1 / sqrt(2 n): 3 % is that of 560 samples at rest, about what a
data sheet or a short recording gives. What a fit leaves may also be that much larger where it is judged
on other runs."""
UNSTRUCTURED = 0.15
"""Excess above a stated floor that may be plain noise stated too small, when nothing in it has a shape.

A choice, no theory: noise in motion is commonly stated from a recording at rest, and is larger. Above it, an
excess without a shape is called a gap."""
CERTAIN = 0.05
"""Significance, corrected for all shapes, from which on a shape alone is a gap: the false alarms per log."""
LIKELY = 0.02
"""Significance, of one shape, that an excess above the stated floor has: the excess is evidence too."""
USED_UP = 0.6
"""Part of the structure that holds it which an effect must use up.

An effect that is the cause uses up all but chance. One that only resembles it takes the part in which their
shapes agree: of shapes whose squared correlation is below this nothing is mistaken. Between the two, set on
simulated machines with effects that no catalogue lists."""
HOLDS = 0.7
"""Part of an effect's gain that a structure must lose with it to hold it: below it the effect lies elsewhere.

A generic shape of limited resolution does not hold all of an effect; set on simulated machines."""


@dataclass(frozen=True)
class Floor:
    """The gap metric that noise leaves [m], and whether it was stated by the user or only estimated."""

    metric: float
    stated: bool

    def high(self, level: float) -> float:
        """Return the metric up to which nothing above the floor is worth reporting."""
        return self.metric * (1 + ALLOWANCE) / (1 - level)


def shaped(found: LackOfFit, level: float) -> bool:
    """Return whether the remainder has a shape, or lines, that are worth the threshold by themselves."""
    need = 1 - (1 - level) / (1 + ALLOWANCE)
    best = found.best(CERTAIN)
    return found.lines >= need or (best is not None and best.drop >= need)


def remains(found: LackOfFit, slow: float, metric: float, floor: Floor, level: float) -> bool:
    """Return whether a remainder of size `metric` is a gap although no effect is named for it.

    `slow`: decrease of the metric without what neighbouring samples have in common. A shape that predicts
    other runs is a gap by itself once it is worth the threshold. Noise may be correlated and may be stated
    wrongly: what has no shape is a gap only when it is far above a floor that was stated.
    """
    if shaped(found, level):
        return True
    if not floor.stated or metric <= floor.high(level):
        return False
    likely = any(s.p_value < LIKELY and s.drop >= level / 2 for s in found.shapes)
    return likely or found.lines >= level / 2 or slow >= level or metric > floor.metric * (1 + UNSTRUCTURED)


def used_up(before: LackOfFit, metric_before: float, after: LackOfFit, metric_after: float) -> float:
    """Return the least part of a structure that is gone with an effect, over all that hold what it explains.

    An effect that is the cause leaves nothing of the shapes it is in; one that merely resembles the cause
    takes a part of a shape and leaves the rest in the same coordinate. 1 where no shape holds the effect.
    """
    power, left = _powers(before, metric_before), _powers(after, metric_after)
    gain = max(metric_before**2 - metric_after**2, 1e-300)
    holding = [by for by in power if power[by] > 0 and power[by] - left.get(by, 0.0) >= HOLDS * gain]
    return min((1 - left.get(by, 0.0) / power[by] for by in holding), default=1.0)


def slow_share(variance: float, fast: float) -> float:
    """Return the decrease of the metric without what neighbouring samples have in common."""
    return 1 - float(np.sqrt(min(1.0, fast / max(variance, 1e-12))))


def _powers(found: LackOfFit, metric: float) -> dict[str, float]:
    """Squares [m^2] that each kind of shape explains; curves over several coordinates of a kind add up."""
    best: dict[Key, float] = {Key("lines"): _power(found.lines, metric)}
    for shape in found.shapes:  # best first: the finest curve that pays
        best.setdefault(shape.key, _power(shape.drop, metric))
    kinds: dict[str, float] = {}
    for key, power in best.items():
        kinds[key.kind] = kinds.get(key.kind, 0.0) + power
    return kinds


def _power(drop: float, metric: float) -> float:
    return (1 - (1 - drop) ** 2) * metric**2
