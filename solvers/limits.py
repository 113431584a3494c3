"""Limits that a point must keep beside its bounds, for methods that only compare costs.

`discarding` is what Meng et al. do, Sensors 2014, 14, 13980, doi:10.3390/s140813980, (11): a particle whose
error leaves `|P - measured| <= dE` is thrown away. Where dE is near the noise no particle of the first swarm
keeps it, all are equal, and the search is blind. `ranking` compares as Deb does, Comput. Methods Appl. Mech.
Eng. 186 (2000) 311, doi:10.1016/S0045-7825(99)00389-8: what keeps the limits goes before what breaks them,
among the first the lower cost wins, among the others the smaller violation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solvers.problem import FloatArray, Problem, misuse

Violation = Callable[[FloatArray], FloatArray]
"""By how much each row of `(n, dim)` breaks the limits, `(n,)`; 0 or less where it keeps them."""


def discarding(problem: Problem, violation: Violation) -> Problem:
    """Return the problem with an infinite cost wherever the limits are broken."""

    def cost(x: FloatArray) -> FloatArray:
        return np.where(_broken(violation, x) > 0.0, np.inf, problem.cost(x))

    return _without_derivatives(problem, cost)


def ranking(problem: Problem, violation: Violation, worst: float) -> Problem:
    """Return the problem with cost `worst` plus the violation wherever the limits are broken.

    worst: a cost that no point which keeps the limits exceeds; one that does counts as `worst`.
    """
    if not np.isfinite(worst):
        raise misuse("worst", "ranking", "finite", worst)

    def cost(x: FloatArray) -> FloatArray:
        broken = _broken(violation, x)
        return np.where(broken > 0.0, worst + broken, np.minimum(problem.cost(x), worst))

    return _without_derivatives(problem, cost)


def _broken(violation: Violation, x: FloatArray) -> FloatArray:
    broken = np.asarray(violation(x), dtype=float)
    if broken.shape != (len(x),):
        raise misuse("violation", "limits", f"a function that returns shape ({len(x)},)", broken.shape)
    return np.where(np.isnan(broken), np.inf, broken)


def _without_derivatives(problem: Problem, cost: Callable[[FloatArray], FloatArray]) -> Problem:
    """The derivatives would describe another function."""
    return replace(problem, cost=cost, derivatives=None, expression=None)
