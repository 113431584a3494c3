"""Effects of the ends of a Halbach array: its field fades near them, also where sensors are chosen anew."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach import links
from hallsym.families.halbach.effects.magnets import HALF_TURN, HEIGHT, LONGER
from hallsym.families.halbach.finite import missing
from hallsym.families.halbach.layout import Array, Layout, sensors
from hallsym.families.halbach.models import array_of
from hallsym.families.halbach.planar import ended
from hallsym.families.mechanisms import P
from hallsym.model import Model, Parameter, Signals, effect
from hallsym.model.arguments import one_of


def nearest(array: Array, u: ca.SX, elements: int = 1) -> ca.SX:
    """Return the place from the middle [m] of the sensor that reads for one at u.

    Of the sensors at whole wavelengths from it, a channel of several elements takes as many, those within
    as many half wavelengths on both sides of the middle.
    """
    window = elements * array.wavelength_m
    return u - window * ca.floor(u / window + 0.5)


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


MOST = 20.0
"""Bounds: what an array of a third of the stated length takes from the field in the middle, and more."""
ORDER = 2
"""Of the pattern per wavelength that sensors chosen anew make of the ends. The first is the array's own; the
third is common to sensors a third apart, and moves no position."""


@effect(link="field", waves=(3, 1), separate=(HEIGHT, LONGER))
def array_edges(
    model: Model,
    reads: str = one_of(
        {
            "fixed": "fixed sensors",
            "nearest": "those next to the middle",
            "unknown": "an unknown choice of sensors",
        },
        "which sensors a channel reads: always its own, of those a wavelength apart the ones next to the "
        "middle, or an unknown choice of them",
        when=lambda reads, model, facts: reads != "nearest" or not array_of(model.layout).ends,
    ),
) -> Model:
    """The array has ends, near which its field fades; sensors chosen anew as it travels see them in turn.

    `edges` is 1 for the array that the layout states, negative where it is half a wavelength longer; of a
    model that has the ends already it is the share by which they are stronger. Of an unknown choice, and so
    of ends of unknown shape, the wave that moves a position is fitted: it repeats every wavelength and does
    not fade with the gap as a harmonic of the magnets does. With fixed sensors on a board that is longer than
    the array by a wavelength, x is decoded over all periods, with no reference.
    """
    if reads == "unknown":
        return _unknown(model)
    if array_of(model.layout).ends:
        return stronger(model, reads)

    def step(s: Signals, p: P) -> None:
        added = []
        for k in range(len(sensors(model.layout))):
            pairs = _missing_at(s, model, k, reads)
            added.append(sum(p["a1"] * c + p["b1"] * q for c, q in pairs) / len(pairs))
        s["field"] = s["field"] + p["edges"] * ca.vertcat(*added)

    wide = _with_edges(model, step, "share of what the ends of the stated array take")
    if reads == "nearest" or not resolves(array_of(model.layout), model.layout):
        return wide
    return replace(
        wide,
        begin=lambda v, p: begin(v, p, array_of(model.layout), model.layout),
        period={}, absolute=(), onward=None,
    )  # fmt: skip


def stronger(model: Model, reads: str = "fixed") -> Model:
    """The ends are stronger than those of the stated arrays by a share, `edges`."""
    if reads != "fixed":
        raise InputError(
            f"Model {model.name} has the ends of its arrays under fixed sensors; for those next to the "
            "middle state ends = false in the table of the array."
        )

    def step(s: Signals, p: P) -> None:
        s["field"] = s["field"] + p["edges"] * s["ends"]

    return _with_edges(model, step, "share by which ends are stronger than those stated")


def _missing_at(s: Signals, model: Model, k: int, reads: str) -> list[tuple[ca.SX, ca.SX]]:
    """Vertical field at each element of channel k; of the columns alone where nothing moves the sensor."""
    array, places = array_of(model.layout), [x for x, _ in sensors(model.layout)[k].positions]
    moved, (dx, _, dz) = s["moved"][k], s["placed"][k]
    still = all(v.is_zero() for v in (dx, dz, moved["x_m"], moved["z_m"]))
    out = []
    for seen, x in zip(s.functions["seen"](s, k), places, strict=True):
        u, gap = (s["turn"] * (x - s["x_m"]), s["z_m"]) if still else (seen.u, seen.height)
        if reads == "nearest":
            u = nearest(array, u, len(places))
        straight, quarter = missing(array)(u, gap)
        if still:
            named = f"ends at {x:g} m ({reads} of {len(places)}, {s['turn']})"
            straight, quarter = s.derive(f"{named}, cos", straight), s.derive(f"{named}, sin", quarter)
        out.append((straight, quarter))
    return out


def _unknown(model: Model) -> Model:
    """The wave of `ORDER` per wavelength, whatever the gap."""
    q, seen = ORDER * array_of(model.layout).wavenumber, sensors(model.layout)

    def step(s: Signals, p: P) -> None:
        cos, sin = (s.derive(f"{f.__name__} {ORDER}kx", f(q * s["x_m"])) for f in (ca.cos, ca.sin))
        added = []
        for k, sensor in enumerate(seen):
            shift = s["moved"][k]["x_m"] - s["placed"][k][0]
            waves = [links.rotated((cos, sin), q * (shift - x)) for x, _ in sensor.positions]
            odd = s["turn"] * p["ends_sin"]
            added.append(sum(p["ends_cos"] * c + odd * v for c, v in waves) / len(waves))
        s["field"] = s["field"] + ca.vertcat(*added)

    new = [Parameter(f"ends_{f}", 0.0, -10.0, 10.0, "V", f"{f} of two waves per wavelength, at any gap")
           for f in ("cos", "sin")]  # fmt: skip
    return model.with_step("field", step, effect="array_edges", parameters=tuple(new))


@effect(link="field", name="array_edges", separate=(LONGER, HALF_TURN))
def planar_array_edges(model: Model) -> Model:
    """The arrays have ends along their period, near which their field fades and reaches beyond.

    `edges` is 1 for arrays as long as the layout states, and wide; with it sensors may lie beyond the
    ends along the period, as long as two or more of each array are under it. Of a model that has the ends
    already it is the share by which they are stronger.
    """
    if ended(model.layout):
        return stronger(model)

    def taken(e: links.Seen) -> ca.SX:  # along the axis of an element, of an amplitude of 1
        vertical, horizontal = missing(e.array)(e.u, e.height)
        return e.up * vertical + e.along * horizontal

    def step(s: Signals, p: P) -> None:
        each = [s.functions["seen"](s, k) for k in range(len(model.channels))]
        added = [sum(map(taken, seen), ca.SX(0)) / len(seen) for seen in each]
        s["field"] = s["field"] + p["edges"] * p["a1"] * ca.vertcat(*added)

    return _with_edges(model, step, "share of what the ends of the stated arrays take")


def _with_edges(model: Model, step: Callable[[Signals, P], None], meaning: str) -> Model:
    new = Parameter("edges", 0.0, -MOST, MOST, "1", meaning)
    return model.with_step("field", step, effect="array_edges", parameters=(new,))
