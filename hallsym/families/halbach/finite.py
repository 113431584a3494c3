"""The field of a Halbach array of finite length, and what its ends take from that of an endless one."""

from functools import cache
from math import pi

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import Array

HARMONICS = (1, 5, 9)
"""Of the endless array, which its magnets less its ends make; the next is below 1e-4 of the first at 3 mm."""


def magnets_of(array: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders (n + 1,) [m] of the magnets of an array from its middle, and their numbers (n,).

    The middle magnet, number 0, points to the sensors; the last ones are cut where the array ends.
    """
    pitch, half = array.wavelength_m / array.magnets_per_period, array.length_m / 2
    inner = [b for i in range(round(half / pitch) + 1) if (b := (i + 0.5) * pitch) < half * (1 - 1e-9)]
    borders = np.array([-half, *(-b for b in reversed(inner)), *inner, half])
    return borders, np.round((borders[:-1] + borders[1:]) / 2 / pitch).astype(int)


def strength(array: Array, h: int) -> float:
    """Return the amplitude at the level of harmonic h of an array whose first harmonic is 1 there."""
    n, q = array.magnets_per_period, array.wavenumber

    def at_level(order: int) -> float:
        filled = np.sin(order * pi / n) / (order * pi / n)
        return float(filled * (1 - np.exp(-order * q * array.height)) * np.exp(-order * q * array.level_m))

    return at_level(h) / at_level(1)


def finite(array: Array, u: ca.SX, gap: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the vertical field at u [m] from the middle of the array, of its magnets and of turned ones.

    In units of the first harmonic of the endless array at its level: deep under a long array they are
    cos k u and -sin k u times exp(-k (gap - level)), with small fifth and ninth harmonics.
    """
    n, q = array.magnets_per_period, array.wavenumber
    filled = np.sin(pi / n) / (pi / n) * (1 - np.exp(-q * array.height))
    size = float(np.exp(q * array.level_m) / filled / (2 * pi))
    borders, numbers = magnets_of(array)
    corners = []
    for border in borders:
        away = u - float(border)
        low, high = (away**2 + g**2 for g in (gap, gap + array.height))
        # the difference of two angles as one: it has no step where the border passes over the sensor
        turn = -ca.atan2(away * array.height, away**2 + gap * (gap + array.height))
        corners.append((ca.log(high / low) / 2, turn))
    straight, quarter = ca.SX(0), ca.SX(0)
    for j, i in enumerate(numbers):
        re, im = (corners[j][c] - corners[j + 1][c] for c in (0, 1))
        angle = pi / 2 - 2 * pi / n * int(i)
        cos, sin = round(np.cos(angle), 15), round(np.sin(angle), 15)
        straight = straight + cos * re - sin * im
        quarter = quarter + sin * re + cos * im
    return size * straight, size * quarter


def endless(array: Array, u: ca.SX, gap: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the same as `finite` of the endless array: its harmonics."""
    q = array.wavenumber
    terms = [(strength(array, h) * ca.exp(-h * q * (gap - array.level_m)), h * q * u) for h in HARMONICS]
    cos, sin = (sum((a * f(t) for a, t in terms), ca.SX(0)) for f in (ca.cos, ca.sin))
    return cos, -sin


def missing(array: Array, u: ca.SX, gap: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return what the ends of the array take from the field of the endless one; zero far from them."""
    straight, quarter = missing_of(array)(u, gap)
    return straight, quarter


@cache
def missing_of(array: Array) -> ca.Function:
    """Return `(u, gap) -> straight, quarter` of `missing`; made once, it is called for every element."""
    u, gap = ca.SX.sym("u"), ca.SX.sym("gap")
    own, all_ = finite(array, u, gap), endless(array, u, gap)
    return ca.Function("missing", [u, gap], [own[0] - all_[0], own[1] - all_[1]])
