"""The field of a Halbach array of finite length and width, and what its ends take from an endless one.

Where a machine states length and width, what ends take is a polynomial of the pose for each channel
(`Ends`), fitted to the closed form of cuboids; else `missing`, in two dimensions, serves `array_edges`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product
from math import pi
from typing import Any

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import Array, Layout, Sensor, arrays, opposite, sensors
from hallsym.model import on_arrays

FITTED = (1, 5)
"""Harmonics whose amplitudes are parameters: what magnets are not ideal by shows in the fifth first."""


def orders(array: Array) -> tuple[int, ...]:
    """Return the harmonics of an endless array; of four magnets a period the next is 1e-6 of the first."""
    return tuple(1 + m * array.magnets_per_period for m in range(4))


def given(array: Array) -> tuple[int, ...]:
    """Return the harmonics that a model has in proportion to the first, as cuboid magnets make them.

    None where the layout does not state how large the array is. The last of `orders`, 5e-5 of the first at a
    tenth of a wavelength, is left out: decoding with it has no solution at some places below that.
    """
    return tuple(h for h in orders(array)[:-1] if h not in FITTED) if array.ends else ()


def magnets_of(array: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders (n + 1,) [m] of the magnets of an array from its middle, and their numbers (n,).

    Number 0 points to the sensors; the last magnets are cut where the array ends.
    """
    pitch, half = array.wavelength_m / array.magnets_per_period, array.length_m / 2
    shift, reach = array.middle_magnet / 2, int(half / pitch) + 6
    inner = (np.arange(-reach, reach + 1) + 0.5 - shift) * pitch
    borders = np.r_[-half, inner[np.abs(inner) < half * (1 - 1e-9)], half]
    return borders, np.round((borders[:-1] + borders[1:]) / 2 / pitch + shift)


def strength(array: Array, h: int) -> float:
    """Return the amplitude at the level of harmonic h of an array whose first harmonic is 1 there."""
    return filled(array, h) / filled(array, 1) * float(np.exp((1 - h) * array.wavenumber * array.level_m))


def filled(array: Array, h: int) -> float:
    """Return the amplitude of a harmonic at the face of the endless array over the remanence."""
    share = h * pi / array.magnets_per_period
    return float(np.sin(share) / share * (1 - np.exp(-h * array.wavenumber * array.height)))


def single_magnets(
    array: Array,
    u: ca.SX,
    across: ca.SX | float,
    gap: ca.SX,
    borders: Iterable[float],
    numbers: Iterable[int],
) -> list[list[tuple[ca.SX, ca.SX]]]:
    """Return the field of each of m magnets, and of the same turned by a quarter, times 2 pi.

    Away from the face and along the period, in units of the remanence, at u along and `across` from the
    middle of the array and a gap below its face [m]. `borders`: (m + 1,) from the middle [m]; `numbers`:
    (m,), 0 points to sensors. Closed form of cuboids magnetised in their plane (Furlani, Permanent
    Magnet and Electromechanical Devices, Academic Press 2001, section 4.2), of an infinite width rectangles.
    """
    faces, out = [_faces(array, float(border) - u, across, gap) for border in borders], []
    for j, i in enumerate(numbers):
        logarithm, below, beside = (faces[j][c] - faces[j + 1][c] for c in range(3))
        angle = pi / 2 - 2 * pi / array.magnets_per_period * int(i)
        cos, sin = round(np.cos(angle), 15), round(np.sin(angle), 15)
        axes = (cos, sin), (-sin, cos)
        out.append([(c * logarithm - s * below, s * logarithm - c * beside) for c, s in axes])
    return out


def _faces(array: Array, x: ca.SX, across: ca.SX | float, gap: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the logarithm and both angles of a border at x from a sensor: its lower edge less the upper one.

    Differences of angles are one angle: that has no step where the border passes over the sensor.
    """
    levels = gap, gap + array.height
    low, high = (x**2 + z**2 for z in levels)
    if not np.isfinite(array.width_m):
        turn = ca.atan2(x * array.height, x**2 + levels[0] * levels[1])
        return ca.log(high / low) / 2, turn, -turn
    ratio, below, beside = high / low, ca.SX(0), ca.SX(0)
    for side in (array.width_m / 2 - across, array.width_m / 2 + across):
        far, farther = (ca.sqrt(flat + side**2) for flat in (low, high))
        ratio *= (side + far) / (side + farther)
        a, b = levels[1] * farther, levels[0] * far
        below += ca.atan2(x * side * (a - b), a * b + (x * side) ** 2)
        a, b = levels[0] * farther, levels[1] * far
        beside += ca.atan2(x * side * (a - b), x**2 * far * farther + levels[0] * levels[1] * side**2)
    return ca.log(ratio) / 2, below / 2, beside / 2


@cache
def missing(array: Array) -> ca.Function:
    """Return `(u, gap) -> straight, quarter`, what ends take from the vertical field of the endless array.

    Of its magnets and of the same turned by a quarter, in two dimensions, in units of its first harmonic at
    its level: zero far from ends.
    """
    u, gap, q = ca.SX.sym("u"), ca.SX.sym("gap"), array.wavenumber
    flat = replace(array, middle_magnet=0, width_m=np.inf)
    parts = single_magnets(flat, u, 0.0, gap, *magnets_of(flat))
    straight, quarter = (sum((own[n][0] for own in parts), ca.SX(0)) for n in (0, 1))
    size = float(np.exp(q * array.level_m) / filled(array, 1) / (2 * pi))
    terms = [(strength(array, h) * ca.exp(-h * q * (gap - array.level_m)), h * q * u) for h in orders(array)]
    cos, sin = (sum((a * f(t) for a, t in terms), ca.SX(0)) for f in (ca.cos, ca.sin))
    return ca.Function("missing", [u, gap], [size * straight - cos, sin - size * quarter])


# -- cuboids: finite length and width --------------------------------------------------------------------


def cuboids(
    array: Array, u: np.ndarray, across: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the field of the array away from its face and along its period, (n,) each, at places (n,) [m].

    `u` along and `across` from its middle, `gap` below its face. In units of the first harmonic of the
    endless array at its level.
    """
    away, along = _whole(array)([u], [across], [gap])
    return away[0], along[0]


@cache
def _whole(array: Array) -> Callable[..., list[np.ndarray]]:
    """`(u, across, gap) -> away, along` of all magnets; made once, it is called often."""
    size = float(np.exp(array.wavenumber * array.level_m) / filled(array, 1) / (2 * pi))
    u, across, gap = at = [ca.SX.sym(n) for n in ("u", "across", "gap")]
    parts = [own for own, _ in single_magnets(array, u, across, gap, *magnets_of(array))]
    return on_arrays(ca.Function("cuboids", at, [size * sum(f, ca.SX(0)) for f in zip(*parts, strict=True)]))


def harmonics(array: Array, u: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of the endless array, without sides: its harmonics."""
    q, shift = array.wavenumber, array.middle_magnet * pi / array.magnets_per_period
    terms = [
        (strength(array, h) * np.exp(-h * q * (gap - array.level_m)), h * (q * u + shift))
        for h in orders(array)
    ]
    wave = np.sum([a * np.exp(-1j * t) for a, t in terms], axis=0)
    return wave.real, wave.imag


def beyond(array: Array) -> bool:
    """Return whether the gaps of a log are beyond numbers: its highest harmonic under- or overflows there.

    No sensor reads a field of 1e-23 of that at the level; such a gap is in another unit.
    """
    gaps = np.abs(array.box(len(array.known_m or range(4)) // 2 - 1)[-1])
    return bool(max(orders(array)) * array.wavenumber * gaps.max() > np.log(np.finfo(float).max))


LONG = 24
"""Wavelengths of an array in whose middle its ends are not seen."""
SIDES_DEGREE = 5
"""Of the polynomial in the gap of what sides make of the first harmonic."""
NOTHING = 1e-6
"""Share of the field that does not count."""


@cache
def sides(array: Array, across: tuple[float, ...], order: int = 1) -> tuple[float, ...]:
    """Return what sides add to a harmonic as a share of the first, for the mean of sensors `across` [m].

    Coefficients of a polynomial in the gap over the wavelength, lowest first; none where the array is so wide
    that they add nothing. Harmonics other than the first and third they hardly change.
    """
    count, (low, high) = 8 * SIDES_DEGREE, array.box()[1].tolist()
    places, gap = np.arange(count) * array.wavelength_m / count, np.linspace(low, high, count)
    u, z = (v.ravel() for v in np.meshgrid(places, gap))
    long = replace(array, length_m=LONG * array.wavelength_m, middle_magnet=0)
    field = np.mean([cuboids(long, u, np.full(len(u), y), z)[0] for y in across], axis=0)
    own = field.reshape(count, count) @ np.cos(order * array.wavenumber * places) * 2 / count
    share = own * np.exp(array.wavenumber * (gap - array.level_m)) - (order == 1)
    if np.abs(share).max() < NOTHING:
        return ()
    fitted = np.polynomial.polynomial.polyfit(gap / array.wavelength_m, share, SIDES_DEGREE)
    return tuple(map(float, fitted))


MOST_DEGREE = 6
"""Of the polynomials that ends are given by."""
AIM, LEAVES = 8e-6, 6e-5
"""Share of the amplitude (rms) that they are to leave: .005 mV of .6 V, a quarter of the uncertainty of an
offset of a usual log (1 mV of noise, some thousand samples); and the most that they may leave."""
AIM_PLANAR = 2e-5
"""The same of six coordinates, where readings are sums of thousands of operations."""
NARROW = 0.05
"""Gap over the wavelength below which higher harmonics than those known are in what ends take."""
MARGIN = 1 / 12
"""Wavelengths by which polynomials reach beyond the box: magnets are where the fitted phase says."""


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A share of the amplitude: sum of `c` (terms,) times `powers` (terms, n) of v - middle (n,)."""

    powers: np.ndarray
    middle: np.ndarray
    c: np.ndarray

    def __call__(self, variables: Sequence[Any]) -> Any:
        """Return the share at a place (n,), of symbols or arrays: by Horner's scheme."""
        away = [value - float(middle) for value, middle in zip(variables, self.middle, strict=True)]
        terms = {tuple(own): c for c, own in zip(self.c.tolist(), self.powers.tolist(), strict=True)}
        return 0 * variables[0] + _horner(terms, away)


def _horner(terms: Mapping[tuple[int, ...], float], variables: Sequence[Any]) -> Any:
    """Return the sum of the terms, coefficients by the powers of their variables, nested in the first."""
    if not variables:
        return terms.get((), 0.0)
    first, *others = variables
    total: Any = 0.0
    for n in range(max((own[0] for own in terms), default=0), -1, -1):
        part = _horner({own[1:]: c for own, c in terms.items() if own[0] == n}, others)
        total = total * first + part
    return total


NO_FIELD = Polynomial(np.zeros((0, 3), dtype=int), np.zeros(3), np.zeros(0))
"""Of three coordinates, no terms."""


@dataclass(frozen=True, eq=False)
class Taken:
    """What ends take at a channel, away from the face of the array and along its period.

    `across`: across it, what crossing arrays add; none of a single array.
    """

    up: Polynomial
    along: Polynomial
    across: Polynomial = NO_FIELD

    def at(self, place: np.ndarray) -> "Taken":
        """Return the same of places from another origin, `place` of the old one."""
        return Taken(*(replace(p, middle=p.middle + place) for p in (self.up, self.along, self.across)))

    @cached_property
    def seen(self) -> ca.Function:
        """`(place, along, aside) -> reading`: at a place (3,), by components of the axis of the sensor."""
        place, along, aside = ca.SX.sym("place", 3), ca.SX.sym("along"), ca.SX.sym("aside")
        up, by_along, by_aside = (p(ca.vertsplit(place)) for p in (self.up, self.along, self.across))
        return ca.Function("taken", [place, along, aside], [up + along * by_along + aside * by_aside])


Field = Callable[[np.ndarray], np.ndarray]
"""Places (n, m) -> what ends take there: away from the face, along the period, maybe across (2 or 3, m)."""
SPREAD = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Steps, in units of the box, of places that fill it evenly: powers of the root of x^4 = x + 1."""
OVER = 3
"""Places a term of a polynomial is fitted to."""
TILTED = 0.03
"""Largest tilt [rad] at which sensors see the field in the plane, of which polynomials leave as much."""


def least_degree(
    box: np.ndarray, of: Sequence[Field], most: int = MOST_DEGREE, aim: float = AIM
) -> tuple[Taken, ...] | None:
    """Return polynomials over a box (n, 2), of the least total degree that leaves `aim` of each, or the best.

    None where that leaves more than `LEAVES`.
    """
    (low, high), n = box.T, len(box)
    middle, half = (low + high) / 2, (high - low) / 2
    powers = np.array(sorted(product(range(most + 1), repeat=n), key=sum))
    powers = powers[powers.sum(axis=1) <= most]
    # from the ends of the box inwards, where polynomials err most
    t = np.cos(pi * (np.arange(1, OVER * len(powers) + 1) * SPREAD[:n, None] % 1))
    seen = np.array([f(middle[:, None] + half[:, None] * t) for f in of]).swapaxes(0, 1)
    found = []
    for component, share in zip(seen, (1.0, TILTED, TILTED), strict=False):
        tried = []
        for degree in range(1, most + 1):
            own = powers[powers.sum(axis=1) <= degree]
            design = np.prod(t[:, None] ** own.T[:, :, None], axis=0)
            c = component @ np.linalg.pinv(design)
            left = np.sqrt(np.sum((component - c @ design) ** 2, axis=1) / (t.shape[1] - len(own)))
            tried.append((max(share * left.max(initial=0.0), aim), degree, own, design, c))
            if tried[-1][0] <= aim:
                break
        left, _, own, design, c = min(tried, key=lambda one: one[:2])
        # of the field along the period, tilts show sides that are no polynomial: waves again
        if left > LEAVES and share == 1.0:
            return None
        size = np.prod(half**own, axis=1)
        kept = [_counting(row, design, aim / share / 2) for row in c]
        found.append([Polynomial(own[k], middle, (row / size)[k]) for k, row in zip(kept, c, strict=True)])
    return tuple(map(Taken, *found))


def _counting(c: np.ndarray, design: np.ndarray, leaves: float) -> np.ndarray:
    """Return the numbers of the terms without the smallest, which together are less than `leaves` (rms)."""
    size = c**2 * np.mean(design**2, axis=1)
    order = np.argsort(size)
    return np.sort(order[np.cumsum(size[order]) > leaves**2])


@cache
def along(layout: Layout, turn: int) -> tuple[Taken, ...] | None:
    """Return what the ends of the only array take at each channel, over x and gap [m].

    At an amplitude of 1, with its middle where the layout says; `turn`: -1 where the mover is turned half
    round. None where polynomials of low degree do not give it: near the ends.
    """
    (array,) = arrays(layout).values()
    margin = MARGIN * array.wavelength_m
    box = array.box() + np.array([[-margin, margin], [0, 0]])
    return least_degree(box, [_one(array, sensor, turn) for sensor in sensors(layout)])


def _one(array: Array, sensor: Sensor, turn: int) -> Field:
    """Return what ends take at a channel of x and gap: finite array less the endless one of its width."""
    across, q = across_of(array, sensor, turn), array.wavenumber
    shift = array.middle_magnet * pi / array.magnets_per_period

    def taken(at: np.ndarray) -> np.ndarray:
        x, gap = at
        total = np.zeros((2, len(x)))
        for (place, _), y in zip(sensor.positions, across, strict=True):
            u = turn * (place - x) - array.middle
            total += np.subtract(cuboids(array, u, np.full(len(x), y), gap), harmonics(array, u, gap))
            for order in (1, 3):  # the third, which models leave out, would be no polynomial
                share = np.polynomial.polynomial.polyval(
                    gap / array.wavelength_m, (*sides(array, across, order), 0.0)
                )
                wave = share * np.exp(-q * (gap - array.level_m)) * np.exp(-1j * order * (q * u + shift))
                total -= np.array([wave.real, wave.imag])
        return total / len(across)

    return taken


def across_of(array: Array, sensor: Sensor, turn: int = 1) -> tuple[float, ...]:
    """Return the places of the elements of a channel from the centre line of the array [m]."""
    return tuple(turn * y - array.centre[1] for _, y in sensor.positions)


@cache
def under(layout: Layout, turn: int) -> tuple[Taken, ...] | None:
    """Return what ends of all arrays take at each channel, over its place in its array and gap [m].

    Places are along and across the array, at an amplitude of 1. `turn`: -1 where the mover is turned half
    round, and other arrays stand over the channels. None where polynomials of low degree do not give it: near
    ends and sides.
    """
    found: dict[Sensor, Taken] = {}
    for array in arrays(layout).values():
        (i, j), box = (array.axis, 1 - array.axis), array.box(2)
        moved = np.sort(turn * box[[i, j]], axis=1) + MARGIN * array.wavelength_m * np.array([-1, 1])
        own = [s for s in sensors(layout) if over(layout, s, turn) == array]
        fields = [_all(layout, array, sensor, turn) for sensor in own]
        taken = least_degree(np.vstack([moved, box[2:]]), fields, MOST_DEGREE - 1, AIM_PLANAR)
        if taken is None:
            return None
        for sensor, one in zip(own, taken, strict=True):
            found[sensor] = one.at(np.array([*nominal(array, sensor, turn), 0.0]))
    return tuple(found[sensor] for sensor in sensors(layout))


def over(layout: Layout, sensor: Sensor, turn: int) -> Array:
    """Return the array over a sensor."""
    array = arrays(layout)[sensor.array]
    return array if turn > 0 else opposite(layout, array)


def nominal(array: Array, sensor: Sensor, turn: int) -> tuple[float, float]:
    """Return the place of a channel along and across its array, the mover level and at zero [m]."""
    at = turn * np.array(sensor.middle) - array.centre
    return float(at[array.axis]), float(at[1 - array.axis])


def _all(layout: Layout, own: Array, sensor: Sensor, turn: int) -> Field:
    """Return what ends take at a channel of its place in its array: all arrays less its own endless one."""
    places, middle = turn * np.array(sensor.positions), np.array(nominal(own, sensor, turn))
    around = places - places.mean(axis=0)

    def taken(at: np.ndarray) -> np.ndarray:
        point = np.empty((2, at.shape[1]))
        point[[own.axis, 1 - own.axis]] = at[:2] + middle[:, None]
        point += np.array(own.centre)[:, None]
        total = np.zeros((3, at.shape[1]))
        for other in arrays(layout).values():
            for dx, dy in around:
                x, y = point + np.array([[dx], [dy]]) - np.array(other.centre)[:, None]
                u, across = (x, y) if other.axis == 0 else (y, x)
                step = other.middle_magnet * other.wavelength_m / other.magnets_per_period / 2
                seen = np.array(cuboids(other, u - step, across, at[2]))
                if other == own:
                    seen -= harmonics(other, u - step, at[2])
                total[[0, 1 if other.axis == own.axis else 2]] += seen
        return total / len(around)

    return taken
