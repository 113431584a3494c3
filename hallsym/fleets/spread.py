"""How a parameter differs between devices, beyond what its estimates are uncertain by.

Random effects: the estimate of device i is `x_i = mu + d_i + e_i`, where d_i ~ N(0, tau^2) is the device's
and e_i ~ N(0, s_i^2) the known uncertainty of the estimate. tau maximises the restricted likelihood, that of
what the mean leaves (D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320, doi:10.2307/2286796): the likelihood
itself is greatest for a tau that is too small, by a tenth with five devices, since it takes the mean for
known. The interval of tau holds 95 % of all fleets, of three devices too: at the true tau the weighted
squares about the mean are chi-square distributed (W. Viechtbauer, Stat. Med. 26 (2007) 37,
doi:10.1002/sim.2514). tau is what tolerances and bounds of the next batch are made from: the scatter of the
estimates themselves is larger, by their uncertainty.

A device is outlying where it lies further from the others than a further device of theirs would, with a
chance of 1 % for the whole fleet: Student's t for a mean and a tau that are those of the others. What is
outlying to begin with is decided by medians, so that several such devices do not hide each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import chdtri, ndtri, stdtr

FEWEST = 3
"""Devices that a spread needs."""
CHANCE = 0.01
"""Familywise false-alarm rate of outlying devices in a fleet: 1.0 to 1.5 %, 5 to 200 devices."""
MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
MOSTLY = 0.75
"""Share of the devices that are taken to belong together unasked, those nearest the median. The fewer, the
smaller their spread beside that of all: half of five good devices make 3 % of such fleets have an outlying
one, three quarters 1 %."""
CONFIDENCE = 0.95
"""Of the interval of the standard deviation between devices."""


@dataclass(frozen=True, eq=False)
class Spread:
    """The distribution of one parameter over devices, in its SI unit.

    `mean`, `mean_std`: of the devices, with 1 sigma. `std`: tau, the standard deviation between devices;
    `interval`: 95 % of it. `typical_std`: median uncertainty of an estimate.
    `outlying`: device -> distance in its expected standard deviations.
    """

    name: str
    unit: str
    devices: int
    mean: float
    mean_std: float
    std: float
    interval: tuple[float, float]
    typical_std: float
    outlying: dict[str, float] = field(default_factory=dict)


def spread_of(
    name: str,
    unit: str,
    values: np.ndarray,
    std: np.ndarray,
    devices: Sequence[str],
    *,
    tests: int = 1,
    period: float | None = None,
) -> Spread | None:
    """Return the spread of a parameter; None where fewer than three devices determine it.

    `values`, `std`: (m,), nan where a device does not determine the parameter. `tests`: how many parameters
    are looked at together. `period`: of a parameter that repeats, taken about its circular mean.
    """
    known = np.isfinite(values) & np.isfinite(std) & (std > 0)
    if known.sum() < FEWEST:
        return None
    x, s = _about_mean(values[known], period), std[known]
    inside, score = _inside(x, s, CHANCE / (2 * len(x) * max(tests, 1)))
    mean, tau = random_effects(x[inside], s[inside])
    weight = 1.0 / (tau**2 + s[inside] ** 2)
    names = np.asarray(devices, dtype=object)[known]
    return Spread(
        name, unit, int(inside.sum()), mean, float(weight.sum() ** -0.5), tau,
        interval_of(x[inside], s[inside]), float(np.median(s)),
        {str(n): float(z) for n, z in zip(names[~inside], score[~inside], strict=True)},
    )  # fmt: skip


def random_effects(x: np.ndarray, s: np.ndarray) -> tuple[float, float]:
    """Return mean and standard deviation between devices of greatest restricted likelihood, for x (m,) +- s.

    >>> import numpy as np
    >>> mean, tau = random_effects(np.array([0.9, 1.0, 1.1]), np.array([0.2, 0.2, 0.2]))
    >>> round(mean, 3), tau  # no spread beyond the uncertainty
    (1.0, 0.0)
    """

    def loss(tau: float) -> float:
        """Return minus twice the restricted log likelihood of tau."""
        variance = tau**2 + s**2
        about = np.sum((x - _mean(x, s, tau)) ** 2 / variance + np.log(variance))
        return float(about + np.log(np.sum(1.0 / variance)))

    scale = float(np.std(x))
    if scale == 0:
        return float(x[0]), 0.0
    found = minimize_scalar(
        lambda log: loss(np.exp(log)), bounds=(np.log(1e-4 * scale), np.log(3.0 * scale)), method="bounded",
        options={"xatol": 1e-7},
    )  # fmt: skip
    tau = float(np.exp(found.x))
    tau = tau if loss(tau) < loss(0.0) else 0.0
    return _mean(x, s, tau), tau


def interval_of(x: np.ndarray, s: np.ndarray) -> tuple[float, float]:
    """Return the interval of the standard deviation between devices that holds it with `CONFIDENCE`."""
    tail, degrees = (1.0 - CONFIDENCE) / 2, len(x) - 1

    def squares(tau: float) -> float:
        return float(np.sum((x - _mean(x, s, tau)) ** 2 / (tau**2 + s**2)))

    def at(value: float) -> float:
        if squares(0.0) <= value:
            return 0.0
        high = max(float(np.std(x)), float(s.min()))
        while squares(high) > value:
            high *= 2.0
        return float(brentq(lambda tau: squares(tau) - value, 0.0, high))

    return at(float(chdtri(degrees, tail))), at(float(chdtri(degrees, 1.0 - tail)))


def _mean(x: np.ndarray, s: np.ndarray, tau: float) -> float:
    weight = 1.0 / (tau**2 + s**2)
    return float(weight @ x / weight.sum())


def _inside(x: np.ndarray, s: np.ndarray, chance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which devices (m,) belong together, and how far all are from these in standard deviations (m,).

    Those near the median begin, and three quarters of all; others join while they are no further away
    than a further device would be but once in 1 / `chance`, on either side.
    """
    middle = float(np.median(x))
    tau = float(np.sqrt(max((MAD * np.median(np.abs(x - middle))) ** 2 - np.median(s) ** 2, 0.0)))
    inside = np.abs(x - middle) <= -float(ndtri(chance)) * np.sqrt(tau**2 + s**2)
    inside |= np.argsort(np.argsort(np.abs(x - middle))) < max(FEWEST, MOSTLY * len(x))
    while True:
        away, probability = _away(x, s, inside)
        joining = ~inside & (probability >= chance)
        if not joining.any():
            return inside, away
        inside = inside | joining


def _away(x: np.ndarray, s: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how many expected standard deviations devices (m,) are away from some, and how often a
    further one of these would be as far on that side."""
    mean, tau = random_effects(x[inside], s[inside])
    weight = 1.0 / (tau**2 + s[inside] ** 2)
    variance = tau**2 + s**2
    first, second, third = (float(np.sum(weight**k)) for k in (1, 2, 3))
    # that of tau^2, by the information of the restricted likelihood; and what it is for all of a variance
    known = 0.5 * (second - 2.0 * third / first + (second / first) ** 2)
    degrees = np.maximum(2.0 * variance**2 * known, 1.0)
    score = (x - mean) / np.sqrt(variance + 1.0 / first)
    return (x - mean) / np.sqrt(variance), stdtr(degrees, -np.abs(score))


def _about_mean(x: np.ndarray, period: float | None) -> np.ndarray:
    if period is None:
        return x
    turn = 2 * np.pi / period
    middle = float(np.angle(np.exp(1j * turn * x).mean())) / turn
    return middle + (x - middle + period / 2) % period - period / 2
