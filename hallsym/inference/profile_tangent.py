"""A profile to first order, and what a straight line says of an interval without the profile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hallsym.estimation.likelihood import Cost
from hallsym.estimation.normal_equations import pseudo_inverse
from hallsym.estimation.optimum import Scaled, scaled_around
from hallsym.model.quantities import Quantity

BOUND = 1e-6
"""A parameter this near to a bound, in widths, is at it."""
ASYMMETRY, WIDTH = 0.02, 0.05
"""What a normal interval may differ from the profile's, in half-widths: between sides, and on the whole."""


@dataclass(frozen=True, eq=False)
class Tangent:
    """The profile of a quantity to first order: its value and where the optimum moves with it.

    `p`: (n,) the optimum, `cost`: F there. `direction`: (n,) dp / d quantity along the profile. `std`:
    standard uncertainty from the curvature of F alone; 0 if nothing that is free moves the quantity.
    `scaled`: the free parameters.
    """

    quantity: Quantity
    scaled: Scaled
    p: np.ndarray
    cost: float
    value: float
    std: float
    direction: np.ndarray


def tangent(cost: Cost, p: np.ndarray, quantity: Quantity, held: Sequence[int]) -> Tangent:
    """Return the first order of the profile of `quantity` at the optimum `p`; parameters at bounds stay."""
    p = np.asarray(p, dtype=float)
    scaled = scaled_around(cost.summary.model, p, held)
    f, gradient, hessian = cost.at(p).derivatives()
    value, slope = quantity.first(p)
    lower, upper = (bound[scaled.free] for bound in scaled.model.bounds)
    near = BOUND * scaled.scale
    at, pushes = p[scaled.free], gradient[scaled.free]
    pinned = ((at - lower <= near) & (pushes > 0)) | ((upper - at <= near) & (pushes < 0))
    for moving in (scaled.free[~pinned], scaled.free):
        own = hessian[np.ix_(moving, moving)]
        curved = len(moving) > 0 and bool((np.diag(own) > 0).all())
        along = pseudo_inverse(own, 1e-14) @ slope[moving] if curved else np.zeros(len(moving))
        size = float(slope[moving] @ along)
        if size > 0:
            break
    else:
        return Tangent(quantity, scaled, p, f, value, 0.0, np.zeros_like(p))
    direction = np.zeros_like(p)
    direction[moving] = along / size
    return Tangent(quantity, scaled, p, f, value, float(np.sqrt(2.0 * size)), direction)


@dataclass(frozen=True)
class Skewness:
    """What a straight line through the optimum says of an interval, without a profile.

    `lower`, `upper`: half-widths over that of the normal interval, 1 where that is right (nan outside the
    bounds). `inside`: whether the line stays inside the bounds as far as the interval's ends.
    """

    lower: float
    upper: float
    inside: bool

    @property
    def normal(self) -> bool:
        """Whether the normal interval will do: no bound near, symmetric, of the same width."""
        if not self.inside:
            return False
        mean, difference = 0.5 * (self.lower + self.upper), 0.5 * abs(self.upper - self.lower)
        return bool(abs(mean - 1.0) <= WIDTH and difference <= ASYMMETRY)


def skewness(
    cost: Cost,
    p: np.ndarray,
    quantity: Quantity,
    *,
    held: Sequence[int],
    std: float,
    level: float = 0.95,
    scale: float = 1.0,
) -> Skewness:
    """Evaluate F twice to see whether the normal interval of `quantity` will do; arguments as for `profile`.

    Along the tangent of the profile F differs from the profile only in fourth order of the distance: the
    third order, which makes an interval lopsided, is all there.
    """
    began = tangent(cost, p, quantity, held)
    lower, upper = cost.summary.model.bounds
    if not (began.std > 0 and np.isfinite(std) and std > 0):
        return Skewness(np.nan, np.nan, False)
    aim = float(np.sqrt(scipy.special.chdtri(1, 1 - level)))
    ratios = []
    for sign in (-1.0, 1.0):
        at = began.p + sign * aim * np.sqrt(scale) * began.std * began.direction
        free = began.scaled.free
        if not ((lower <= at) & (at <= upper))[free].all():
            ratios.append(np.nan)
            continue
        away = abs(quantity.first(at)[0] - began.value)
        root = np.sqrt(max(cost.at(at).value - began.cost, 0.0))
        ratios.append(float(away * np.sqrt(scale) / (root * std)) if root > 0 else np.inf)
    beyond = began.value - aim * std < quantity.lower or began.value + aim * std > quantity.upper
    return Skewness(ratios[0], ratios[1], not beyond and bool(np.isfinite(ratios).all()))
