"""Calibrations of magnet arrays over sensors, to generate C from, by hallsym's own field.

`planar`: four arrays over fixed patches of sums. `grid`: over many single sensors. `rows`: over rows of sums
that are longer than they are. `travel`: one array along a longer board.
"""

import numpy as np
from msgspec import structs
from waves import LENGTH, THIRD, calibrated

from hallsym.families import effects
from hallsym.families.halbach import planar as movers
from hallsym.families.halbach.effects import ends
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


def spot(array, along, across):
    """Place of a sensor so far along an array and across it from its centre [m]."""
    moved = (along, across) if array.axis == 0 else (across, along)
    return tuple(float(c + m) for c, m in zip(array.centre, moved, strict=True))


def spread(count, pitch=THIRD):
    """Places of so many at a pitch, about 0."""
    return (np.arange(count) - (count - 1) / 2) * pitch


def planar(count=6, gaps=(0.0045, 0.0085), travel=0.0145, tilt=0.01, across=6, without=""):
    """Four arrays over `count` sums of `across` sensors side by side each: gains of 1 %, offsets of 2 mV.

    `without`: the array that is left out.
    """
    found = {name: a for name, a in arrays(movers.pinwheel()).items() if name != without}
    sums = [
        Sensor(f"{a.name.lower()}_{k}_v", tuple(spot(a, at, side) for side in spread(across)), a.name)
        for a in found.values() for k, at in enumerate(spread(count))
    ]  # fmt: skip
    model = movers.halbach_planar((*sums, *found.values()))
    for name in ("gain_mismatch", "offset_error"):
        model = effects(model.family)[name](model)
    rng, values = np.random.default_rng(4), {"a1": 1.25 / across, "a5": -0.0048 / across}
    for p in model.parameters[7:]:
        values[p.name] = p.nominal + (0.01 if p.unit == "1" else 2e-3) * rng.standard_normal()
    return over(calibrated(model, values, gaps=gaps), gaps, travel, travel, tilt)


def grid(along, across):
    """Single sensors along and across each of the four arrays."""
    found = arrays(movers.pinwheel())
    spots = [(a, spot(a, i, j)) for a in found.values() for i in spread(along) for j in spread(across)]
    single = [Sensor(f"hall_{k}_0_v", (at,), a.name) for k, (a, at) in enumerate(spots)]
    fit = calibrated(
        movers.halbach_planar((*single, *found.values())), {"a1": 0.62, "a5": -6e-4, "rx0": 1e-3}
    )
    return over(fit, (0.0045, 0.0085), 0.0125, 0.0125, 0.005)


def row_layout(length=3 * LENGTH):
    """Four arrays of three periods, each over a row of six sums at 20 mm: 100 mm, of which 90 are covered."""
    centres = {"X1": (-0.06, 0.07), "X2": (0.06, -0.07), "Y1": (0.07, 0.06), "Y2": (-0.07, -0.06)}
    found = [Array(n, LENGTH, n[0].lower(), c, length, 0.12, LENGTH / 4) for n, c in centres.items()]
    sums = [
        Sensor(f"{a.name.lower()}_{k}_v", tuple(spot(a, at, side) for side in spread(3)), a.name)
        for a in found for k, at in enumerate(spread(6, 0.02))
    ]  # fmt: skip
    return (*sums, *found)


def rows(length=3 * LENGTH, reach=ROWS_REACH):
    values = {"a1": 0.62, "a5": -6e-4, "edges": 1.0, "rx0": 1e-3, "ry0": -2e-3, "rz0": 5e-4, "x0": 1e-3}
    fit = calibrated(
        ends.planar_array_edges(movers.halbach_planar(row_layout(length))), values, gaps=(0.004, 0.007)
    )
    return over(fit, (0.004, 0.007), reach, reach, 0.005)


def travel(count=18, reach=REACH):
    """A board of 18 columns at 10 mm, an array of three periods, a third of it over no sensor at the ends."""
    values = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4, "edges": 1.0}
    places = [(j - (count - 1) / 2) * 0.01 for j in range(count)]
    model = ends.array_edges(halbach(columns(places, length_m=0.09)))
    return over(calibrated(model, values, gaps=(0.004, 0.007), sigma=1e-3), (0.004, 0.007), reach)


BOARDS = {
    "closed form of 12 sums": (lambda: planar(**LEVEL), 1e-4),
    "12 sums": (lambda: planar(**LEVEL), 5e-6),
    "24 sums": (lambda: planar(**TILTED), 1e-6),
    "many periods": (lambda: planar(**{**LEVEL, "travel": 0.06}), 5e-6),
    "another level": (level, 2e-6),
    "tilted 24 sums": (lambda: planar(6, (0.0065, 0.0085), 0.0135, 0.003, 3), 5e-6),
    "grid of 24": (lambda: grid(6, 1), 2e-5),
    "grid of 48": (lambda: grid(6, 2), 2e-5),
    "rows": (rows, 5e-6),
    "travel": (travel, None),
}
"""Calibration, and the accuracy of its C."""
