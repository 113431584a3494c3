"""Calibrations of magnet arrays over sensors, to generate C from.

`planar`: four arrays over fixed patches of sums, by the field's own equations (`waves.planar`). `grid`: over
many single sensors. `rows`: over rows of sums that are longer than they are. `travel`: one array along a
longer board. The last three by hallsym's own finite field.
"""

from functools import cache

from msgspec import structs
from waves import LENGTH, calibrated, calibrated_planar

import hallsym
from hallsym.families.halbach import planar as movers
from hallsym.families.halbach.effects import ends
from hallsym.families.halbach.effects.planar_ends import array_edges
from hallsym.families.halbach.layout import Array, Sensor, arrays, columns
from hallsym.families.halbach.models import halbach

LEVEL = {"count": 3, "gaps": (0.0065, 0.0085), "tilt": 0.003, "travel": 0.0135, "across": 3}
TILTED = {**LEVEL, "count": 6, "tilt": 0.01}
REACH, ROWS_REACH = 0.08, 0.03


def over(fit, gaps, x, y=None, tilt=None):
    """A calibration as of a log over these ranges, of six coordinates or of two."""
    span = {"x_ref_m": (-x, x), "z_ref_m": gaps} | ({} if y is None else {"y_ref_m": (-y, y)})
    span |= {f"r{a}_ref_rad": (-tilt, tilt) for a in "xyz" if tilt is not None}
    return fit.changed(log=structs.replace(fit.log, span=span))


def level():
    """Another attitude that the reference calls level, and a long stroke along x."""
    values = {"a1": 0.62, "a5": -0.01, "rx0": 1e-3, "ry0": -2e-3, "rz0": 5e-4, "x0": 1e-3, "y0": -5e-4}
    return over(calibrated(movers.halbach_planar(), values), LEVEL["gaps"], 0.04, LEVEL["travel"], 0.003)


def grid(along, across):
    """Single sensors along and across each of the four arrays."""
    found, made_ = arrays(movers.pinwheel()), []
    for array in found.values():
        own, other = array.axis, 1 - array.axis
        for i in range(along * across):
            at = list(array.centre)
            at[own] += (i // across - (along - 1) / 2) * array.wavelength_m / 3
            at[other] += (i % across - (across - 1) / 2) * array.wavelength_m / 3
            made_.append(Sensor(f"hall_{len(made_)}_0_v", ((at[0], at[1]),), array.name))
    model = movers.halbach_planar((*made_, *found.values()))
    fit = calibrated(model, {"a1": 0.62, "a5": -6e-4, "rx0": 1e-3}, gaps=(0.0045, 0.0085))
    return over(fit, (0.0045, 0.0085), 0.0125, 0.0125, 0.005)


def rows(length=3 * LENGTH, reach=ROWS_REACH):
    """Four arrays of three periods, each over a row of six sums at 20 mm: 100 mm, of which 90 are covered."""
    centres = {"X1": (-0.06, 0.07), "X2": (0.06, -0.07), "Y1": (0.07, 0.06), "Y2": (-0.07, -0.06)}
    found = [Array(n, LENGTH, n[0].lower(), c, length, 0.12, LENGTH / 4) for n, c in centres.items()]
    sums = []
    for array in found:
        for k in range(6):
            at = [(k - 2.5) * 0.02 * (array.axis == j) + array.centre[j] for j in (0, 1)]
            side = [(n - 1) * LENGTH / 3 for n in range(3)]
            places = [(at[0] + s * array.axis, at[1] + s * (1 - array.axis)) for s in side]
            sums.append(Sensor(f"{array.name.lower()}_{k}_v", tuple(places), array.name))
    values = {"a1": 0.62, "a5": -6e-4, "edges": 1.0, "rx0": 1e-3, "ry0": -2e-3, "rz0": 5e-4, "x0": 1e-3}
    fit = calibrated(array_edges(movers.halbach_planar((*sums, *found))), values, gaps=(0.004, 0.007))
    return over(fit, (0.004, 0.007), reach, reach, 0.005)


def travel(count=18, reach=REACH):
    """A board of 18 columns at 10 mm, an array of three periods, a third of it over no sensor at the ends."""
    values = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4, "edges": 1.0}
    places = [(j - (count - 1) / 2) * 0.01 for j in range(count)]
    model = ends.array_edges(halbach(columns(places, length_m=0.09)))
    return over(calibrated(model, values, gaps=(0.004, 0.007), sigma=1e-3), (0.004, 0.007), reach)


BOARDS = {
    "closed form of 12 sums": (lambda: calibrated_planar(**LEVEL), 1e-4),
    "12 sums": (lambda: calibrated_planar(**LEVEL), 5e-6),
    "24 sums": (lambda: calibrated_planar(**TILTED), 1e-6),
    "many periods": (lambda: calibrated_planar(**{**LEVEL, "travel": 0.06}), 5e-6),
    "another level": (level, 2e-6),
    "grid of 24": (lambda: grid(6, 1), 2e-5),
    "grid of 48": (lambda: grid(6, 2), 2e-5),
    "rows": (rows, 5e-6),
    "travel": (travel, None),
}
"""Calibration, and the accuracy of its C."""


@cache
def fit_of(name):
    return BOARDS[name][0]()


@cache
def made(name):
    return hallsym.generate(fit_of(name), accuracy=BOARDS[name][1])
