"""Claims on the values of a fit: parameters at their bounds, values outside the family's plausible range."""

from collections.abc import Iterator
from fnmatch import fnmatchcase

import numpy as np

from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import logged_columns
from hallsym.families import plain
from hallsym.log import Fault
from hallsym.log.quality.values import repeated

PRESSED = 5.0
"""Standard uncertainties by which the score must press a parameter against its bound: once in 10^6 by
chance."""
FAR = 0.25
"""Part of the width of its bounds that a parameter would go beyond them although fixed ones could compensate:
a position or an angle that is not at its nominal value moves others by less."""
ALONE = 1e-6
"""Part of a parameter's information that must remain with the fixed parameters free."""


def implausible(fit: Fit) -> list[Fault]:
    """Return claims on implausible values, and on columns at a lower rate where they leave an excess."""
    amiss = fit.goodness and fit.goodness.sentence
    slow = repeated(fit.source, logged_columns(fit.model)) if fit.source and amiss else ()
    return [*slow, *_at_bounds(fit), *fit.model.family.implausible(fit)]


def stated(fit: Fit) -> bool:
    """Return whether the log or the user states where the sensors of the machine are."""
    meta, family = fit.source.meta if fit.source else None, fit.model.family
    if meta is None or meta.probes is not None or any(table in meta.raw for table in family.tables):
        return True
    usual = [m for m in family.models if getattr(m, "__name__", "") == plain(fit.model).name]
    return not usual or usual[0]().layout != fit.model.layout


def _at_bounds(fit: Fit) -> Iterator[Fault]:
    """Yield one claim for each of the family's groups of parameters that the log presses against bounds."""
    left = pressed(fit)
    for claim, pattern, text in (*fit.model.family.at_bounds, ("bounds", "*", OTHERS)):
        group = [name for name in left if fnmatchcase(name, pattern)]
        left = [name for name in left if name not in group]
        if group:
            values = ", ".join(f"{name} = {fit.value(name):.4g}" for name in group)
            yield Fault(f"{values}: {text}.", claim)


OTHERS = (
    "at the bounds of the plausible range, so other parameters compensate for it; widen the bounds "
    "(--machine FILE) if it can, or look for what is wrong with the recording"
)


def pressed(fit: Fit) -> list[str]:
    """Return the parameters at a bound that would go beyond it, all others re-optimised.

    By a score test of the fit's cost, its information scaled by the residual. A parameter that fixed ones can
    compensate must go far beyond.
    """
    if fit.likelihood is None or not fit.at_bound:
        return []
    names = fit.model.names
    point = fit.likelihood.at(fit.values)
    score = 0.5 * (fit.likelihood.weights @ point.run_gradients)
    information = point.total_information()
    ends = [names.index(n) for n in fit.at_bound]
    fixed = [names.index(n) for n in fit.fixed]
    free = [k for k in np.flatnonzero(fit.determined).tolist() if k not in ends]
    scale = max(fit.solver.cost_per_degree_of_freedom, 1.0)
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    whitened = information / np.outer(size, size)

    def own(k: int, others: list[int]) -> float:
        across = whitened[k, others]
        return float(1.0 - across @ np.linalg.lstsq(whitened[np.ix_(others, others)], across)[0])

    out = []
    for k in ends:
        curvature = own(k, free) * size[k] ** 2
        if curvature <= 0 or score[k] ** 2 <= PRESSED**2 * scale * curvature:
            continue
        far = abs(score[k]) / curvature > FAR * fit.model.parameters[k].width
        if far or own(k, [*free, *fixed]) > ALONE:
            out.append(names[k])
    return out
