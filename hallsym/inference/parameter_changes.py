"""Parameters of one sensor from two recordings: which of them changed.

The recordings share no noise, so that their estimates are independent.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, stdtr


@dataclass(frozen=True)
class Estimate:
    """A parameter: value and standard uncertainty in SI; None where there is none to give."""

    value: float
    std: float | None
    unit: str


@dataclass(frozen=True)
class ParameterChange:
    """A parameter in SI: values and standard uncertainties, `p_value` of no change (None: no uncertainty).

    `significant`: corrected for the number of parameters compared; None where it cannot be told.
    """

    name: str
    unit: str
    before: float
    before_std: float | None
    after: float
    after_std: float | None
    p_value: float | None
    significant: bool | None


Freedom = Mapping[str, float]
"""Parameter -> degrees of freedom of its standard uncertainty; infinite where it is not named."""


def changes(
    one: Mapping[str, Estimate],
    two: Mapping[str, Estimate],
    limit: float,
    freedom: tuple[Freedom, Freedom] = ({}, {}),
) -> tuple[ParameterChange, ...]:
    """Compare parameters by name, those that both have; significant is a p-value below `limit`.

    The difference over its standard uncertainty follows Student's t with the degrees of freedom after Welch
    and Satterthwaite (Biometrics Bulletin 2 (1946) 110, doi:10.2307/3002019) where `freedom` is finite.
    """
    out = []
    for name in (n for n in one if n in two):
        a, b = one[name], two[name]
        p = None
        if a.std is not None and b.std is not None and np.hypot(a.std, b.std) > 0:
            distance = abs(b.value - a.value) / np.hypot(a.std, b.std)
            dof = welch((a.std, b.std), (freedom[0].get(name, np.inf), freedom[1].get(name, np.inf)))
            p = float(2 * stdtr(dof, -distance) if np.isfinite(dof) else erfc(distance / np.sqrt(2)))
        significant = None if p is None else p < limit
        out.append(ParameterChange(name, a.unit, a.value, a.std, b.value, b.std, p, significant))
    return tuple(out)


def welch(stds: tuple[float, float], dofs: tuple[float, float]) -> float:
    """Return the degrees of freedom of the root of two summed variances."""
    share = sum(std**4 / dof for std, dof in zip(stds, dofs, strict=True))
    return float(np.hypot(*stds) ** 4 / share) if share > 0 else float("inf")
