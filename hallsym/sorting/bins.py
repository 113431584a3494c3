"""Bins of gain: which one a sensor belongs to, with what probability it is wrong, what repeats do.

A bin of width w holds gains within +- w / 2 of its centre 1 + k w, relative to the nominal gain.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import minimize
from scipy.special import stdtr
from scipy.stats import norm

from hallsym.errors import InputError
from hallsym.units import Array

LOT = 30
"""Fewest sensors whose own spread says what gains there are."""


def bins_of(relative: Array, width: float) -> Array:
    """Return the bin (n,) of each relative gain (1 is nominal): 0 is the nominal one.

    >>> bins_of(np.array([0.9974, 1.0024, 1.0026]), 0.005).tolist()
    [-1, 0, 1]
    """
    return np.floor((np.asarray(relative) - 1.0) / width + 0.5).astype(int)


def wrong_probability(relative: Array, std: Array, dof: float, width: float) -> Array:
    """Return the probability (n,) that the true gain lies outside the bin that the measured one chose.

    `std` (n,) relative, of `dof` degrees of freedom. Before the measurement gains are taken as normal with
    the robust mean and spread of all; where that spread is far above `std`, as in an unsorted lot, this
    changes nothing; where a sorted bin is measured again, it does. Fewer than `LOT` sensors tell no spread.
    """
    k = bins_of(relative, width)
    middle = float(np.median(relative))
    spread = float(1.4826 * np.median(np.abs(relative - middle)))
    before = max(spread**2 - float(np.median(std)) ** 2, 0.0) if len(std) >= LOT else np.inf
    weight = 1 / (1 + std**2 / before) if before > 0 else np.where(std > 0, 0.0, 1.0)
    centre, scale = middle + weight * (relative - middle), std * np.sqrt(weight)
    low = 1.0 + (k - 0.5) * width
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(scale > 0, (low - centre) / scale, np.where(centre >= low, -np.inf, np.inf))
        above = np.where(
            scale > 0, (low + width - centre) / scale, np.where(centre < low + width, np.inf, -np.inf)
        )
    return np.asarray(1.0 - (_t(above, dof) - _t(below, dof)))


def _t(z: Array, dof: float) -> Array:
    return np.asarray(stdtr(dof, z) if np.isfinite(dof) else norm.cdf(z))


def change_probability(change: int, width: float, drift: float, std: float) -> float:
    """Return the probability that a sensor of one bin is found `change` bins higher when measured again.

    Gains lie evenly within the first bin; the second measurement differs from the first by `drift` on
    average and by `std` (1 sigma) at random, all relative. With H(x) the integral of the normal distribution
    function, w P = H((k + 1) w - d) - 2 H(k w - d) + H((k - 1) w - d).

    >>> [round(799 * change_probability(k, 0.5, -0.049, 0.157), 1) for k in (-2, -1, 0, 1)]
    [0.1, 143.8, 589.3, 65.7]
    """
    if not (width > 0 and std > 0):
        raise InputError(
            f"Width of a bin and standard deviation must be above 0; instead received {width:g}, {std:g}."
        )
    z = (width * np.array([change + 1, change, change - 1]) - drift) / std
    integral = std * (z * norm.cdf(z) + norm.pdf(z))
    return float(max((integral[0] - 2 * integral[1] + integral[2]) / width, 0.0))


def fit_changes(counts: Mapping[int, int], width: float) -> tuple[float, float]:
    """Return drift and standard deviation of greatest likelihood behind counts of changes of bin.

    `counts`: number of sensors by change in bins, such as {-2: 1, -1: 144, 0: 588, 1: 66}.
    """
    known = {k: n for k, n in counts.items() if n}
    if sum(n > 0 for n in known.values()) < 3:
        raise InputError(
            "Counts of changed bins must have three changes that occur, such as -1, 0 and 1, to give a"
            " drift and a scatter."
        )

    def cost(x: Array) -> float:
        chances = [change_probability(k, 1.0, x[0], float(np.exp(x[1]))) for k in known]
        return -float(sum(n * np.log(max(p, 1e-300)) for n, p in zip(known.values(), chances, strict=True)))

    start = sum(k * n for k, n in known.items()) / sum(known.values())
    found = minimize(cost, [start, np.log(0.3)], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    return float(found.x[0] * width), float(np.exp(found.x[1]) * width)
