"""Bins of gain: the bin of a sensor, the probability that it is wrong, and of a change when repeated.

A bin of width w holds gains within +- w / 2 of its centre 1 + k w, relative to the nominal gain.
"""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr
from scipy.stats import norm

from hallsym.errors import require
from hallsym.units import Array

LOT = 30
"""Fewest sensors whose spread is used as prior."""


def bins_of(relative: Array, width: float) -> Array:
    """Return the bin (n,) of each relative gain (1 is nominal): 0 is the nominal one.

    >>> bins_of(np.array([0.9974, 1.0024, 1.0026]), 0.005).tolist()
    [-1, 0, 1]
    """
    return np.floor((np.asarray(relative) - 1.0) / width + 0.5).astype(int)


def wrong_probability(relative: Array, std: Array, dof: float, width: float) -> Array:
    """Return the probability (n,) that the true gain lies outside the bin that the measured one chose.

    `std` (n,) relative, of `dof` degrees of freedom. Before the measurement gains are taken as normal with
    the robust mean and spread of all; this matters where the spread is not far above `std`, as when a sorted
    bin is measured again. Fewer than `LOT` sensors have no such prior.
    """
    k = bins_of(relative, width)
    middle = float(np.median(relative))
    spread = float(1.4826 * np.median(np.abs(relative - middle)))
    before = max(spread**2 - float(np.median(std)) ** 2, 0.0) if len(std) >= LOT else np.inf
    weight = 1 / (1 + std**2 / before) if before > 0 else np.where(std > 0, 0.0, 1.0)
    centre = middle + weight * (relative - middle)
    scale = np.maximum(std * np.sqrt(weight), np.finfo(float).tiny)
    low = 1.0 + (k - 0.5) * width
    below, above = (low - centre) / scale, (low + width - centre) / scale
    return np.asarray(1.0 - (stdtr(dof, above) - stdtr(dof, below)))


def change_probability(change: int, width: float, drift: float, std: float) -> float:
    """Return the probability that a sensor of one bin is found `change` bins higher when measured again.

    Gains lie evenly within the first bin; the second measurement differs from the first by `drift` on
    average and by `std` (1 sigma) at random, all relative. With H(x) the integral of the normal distribution
    function, w P = H((k + 1) w - d) - 2 H(k w - d) + H((k - 1) w - d).

    >>> [round(799 * change_probability(k, 0.5, -0.049, 0.157), 1) for k in (-2, -1, 0, 1)]
    [0.1, 143.8, 589.3, 65.7]
    """
    require(width > 0 and std > 0, "Width of a bin and standard deviation", "above 0", (width, std))
    z = (width * np.array([change + 1, change, change - 1]) - drift) / std
    integral = std * (z * norm.cdf(z) + norm.pdf(z))
    return float(max((integral[0] - 2 * integral[1] + integral[2]) / width, 0.0))
