"""Where an array is on a board longer than itself: which sensors see it resolves the period.

The sensors are weighted smoothly by their distance from the ends of the array, so that no result steps where
the array leaves one sensor and comes over the next.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import Array, Layout, sensors

SEES = 1 / 3
"""Share of the energy-weighted mean energy above which a sensor counts as under the array: half of what the
sensors under it have on average, a squared cosine having 1/2 on average and 3/4 weighted by itself."""


def board(layout: Layout) -> np.ndarray:
    """Return the place of each channel along the array [m]."""
    return np.array([sensor.middle[0] for sensor in sensors(layout)])


def resolves(array: Array, layout: Layout) -> bool:
    """Return whether the board is longer than the array by a wavelength, so that some sensor is not under it.

    A shorter one sees the same at places a wavelength apart, but for the field of the ends.
    """
    return bool(np.ptp(board(layout)) >= array.length_m + array.wavelength_m)


def seen(array: Array, away: ca.SX) -> ca.SX:
    """Return the weight of a sensor `away` [m] from the middle: 1 under the array, 0 beyond it, smooth."""
    depth = (array.length_m / 2 - ca.fabs(away)) / (array.wavelength_m / 2)
    inside = ca.fmin(ca.fmax(depth, 0), 1)
    return inside**2 * (3 - 2 * inside)


def begin(v: ca.SX, p: Mapping[str, ca.SX], array: Array, layout: Layout) -> ca.SX:
    """Return x and z from the readings alone: phase, then the period that the sensors see, then the gap.

    Of the places that have the phase of the first harmonic, the one is taken under which the sensors see
    most and beyond which they see least.
    """
    q, places = array.wavenumber, board(layout)
    read = ca.vertsplit(v)
    size = 2 / len(places)
    re, im = (size * sum((r * float(f(q * x)) for r, x in zip(read, places, strict=True)), ca.SX(0))
              for f in (np.cos, np.sin))  # fmt: skip
    x = _resolved(array, places, read, _phase(p, re, im) / q)
    weights = [seen(array, place - x) + NEVER for place in places]
    re, im = _weighted(array, places, read, weights)
    phase = _phase(p, re, im) / q
    x = phase + array.wavelength_m * ca.floor((x - phase) / array.wavelength_m + 0.5)
    fade = ca.log((re**2 + im**2) / (p["a1"] ** 2 + p["b1"] ** 2)) / 2
    return ca.vertcat(x, array.level_m - fade / q)


NEVER = 1e-6
"""Weight of a sensor beyond the array: where none is under it the sums still have a solution."""


def _phase(p: Mapping[str, ca.SX], re: ca.SX, im: ca.SX) -> ca.SX:
    """Return k x from Z = (a1 - i b1) exp(i k x - ...), re + i im."""
    return ca.atan2(im * p["a1"] + re * p["b1"], re * p["a1"] - im * p["b1"])


def _resolved(array: Array, places: np.ndarray, read: list[ca.SX], x: ca.SX) -> ca.SX:
    energy = [r**2 for r in read]
    least = SEES * sum(e**2 for e in energy) / (sum(energy) + 1e-30)
    reach = array.length_m / 2
    first, last = (int(np.floor(end / array.wavelength_m)) for end in (places.min() - reach,
                                                                      places.max() + reach))  # fmt: skip
    best, found = ca.SX(-np.inf), x
    for period in range(first, last + 2):
        here = x + period * array.wavelength_m
        score = sum(seen(array, at - here) * (e - least) for at, e in zip(places, energy, strict=True))
        better = score > best
        best, found = ca.if_else(better, score, best), ca.if_else(better, here, found)
    return found


def _weighted(
    array: Array, places: np.ndarray, read: list[ca.SX], weights: list[ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return real and imaginary part of Z with v_j = Re(Z exp(-i k x_j)), weighted least squares."""
    rows = [(float(np.cos(array.wavenumber * x)), float(np.sin(array.wavenumber * x))) for x in places]
    cc, cs, ss, cv, sv = (ca.SX(0) for _ in range(5))
    for (c, s), r, w in zip(rows, read, weights, strict=True):
        cc, cs, ss, cv, sv = cc + w * c * c, cs + w * c * s, ss + w * s * s, cv + w * c * r, sv + w * s * r
    det = cc * ss - cs**2
    return (ss * cv - cs * sv) / det, (cc * sv - cs * cv) / det
