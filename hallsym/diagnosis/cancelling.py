"""Effects that other parameters undo: each would make more than the machine deviates by altogether.

An effect of a kind with the model's own parameters, or with effects found before, can grow without end as
long as the others cancel it; the small difference that is left then fits anything.
"""

import numpy as np

from hallsym.diagnosis.refit import Refitted
from hallsym.model import Model
from hallsym.turning import designed

OVER = 2.0
"""Times the whole deviation of the machine from its design by which an effect alone may move the pose.

Causes that happen to oppose each other may make one of them larger than the whole, hardly twice."""


def undone(fit: Refitted, beside: Model, start: Refitted) -> bool:
    """Return whether what `fit` has beyond the model `beside` is undone by the other parameters.

    `start`: the fit without any effect, whose parameters say what the machine deviates from its design by.
    """
    base = fit.base
    new = np.array([n not in beside.names for n in base.model.names])
    alone = moved(fit, np.where(new, base.p - base.model.nominal, 0.0))
    whole = moved(start, start.base.p - designed(start.base.model, start.base.p))
    return alone > OVER * np.hypot(whole, start.gap(start.fitted))


def moved(fit: Refitted, by: np.ndarray) -> float:
    """Return the gap metric, to first order, of moving the parameters (n,) of `fit` by this much."""
    units = fit.fitted
    step = by[list(fit.base.free)]
    O = fit.tangents.output[units].sum(axis=0)[: len(step), : len(step)]
    return float(np.sqrt(max(step @ O @ step, 0.0) / max(fit.tangents.count[units].sum(), 1.0)))
