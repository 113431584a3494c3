"""Effects that other parameters undo: each would make more than the machine deviates by altogether.

An effect of a kind with the model's own parameters, or with effects found before, can grow without end as
long as the others cancel it; the small difference that is left then fits anything.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hallsym.diagnosis.refit import Refitted
from hallsym.log.phase import designed


def cancelled(
    fit: Refitted, beside: Refitted, start: Refitted, owner: Mapping[str, str], over: float
) -> bool:
    """Return whether what `fit` has beyond the fit `beside` is undone by other parameters, or undoes others.

    `start`: the fit without any effect, whose parameters say what the machine deviates from its design by.
    `owner`: parameter -> the effect that it belongs to. `over`: times that deviation by which an effect alone
    may move the pose, and times its former size and the gap that goes by which it may grow beside another.
    """
    own, known = start.base.model.names, beside.base.model.names
    new = [n for n in fit.base.model.names if n not in known]
    whole = moved(start, start.base.p - designed(start.base.model, start.base.p))
    if _alone(fit, new) > over * np.hypot(whole, start.gap(start.fitted)):
        return True
    lower = np.sqrt(max(beside.gap(beside.fitted) ** 2 - fit.gap(fit.fitted) ** 2, 0.0))
    groups: dict[str, list[str]] = {}
    for n in known:
        if n not in own:
            groups.setdefault(owner.get(n, n), []).append(n)
    return any(_alone(fit, g) > over * np.hypot(_alone(beside, g), lower) for g in groups.values())


def _alone(fit: Refitted, names: Sequence[str]) -> float:
    """What some parameters of a fit make by themselves."""
    base = fit.base
    these = np.isin(base.model.names, names)
    return moved(fit, np.where(these, base.p - base.model.nominal, 0.0))


def moved(fit: Refitted, by: np.ndarray) -> float:
    """Return the gap metric, to first order, of moving the parameters (n,) of `fit` by this much."""
    units = fit.fitted
    step = by[list(fit.base.free)]
    O = fit.tangents.output[units].sum(axis=0)[: len(step), : len(step)]
    return float(np.sqrt(max(step @ O @ step, 0.0) / max(fit.tangents.count[units].sum(), 1.0)))
