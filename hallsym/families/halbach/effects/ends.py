"""Effects of the ends of a Halbach array: its field fades near them, also where sensors are chosen anew."""

from dataclasses import replace

import casadi as ca

from hallsym.families.halbach import links, travel
from hallsym.families.halbach.effects.magnets import HEIGHT, LONGER
from hallsym.families.halbach.ends import missing, nearest
from hallsym.families.halbach.layout import sensors
from hallsym.families.halbach.models import array_of
from hallsym.families.mechanisms import P
from hallsym.model import Model, Parameter, Signals, effect
from hallsym.model.arguments import one_of

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
    ),
) -> Model:
    """The array has ends, near which its field fades; sensors chosen anew as it travels see them in turn.

    `edges` is 1 for the array that the layout states, negative where it is half a wavelength longer. Of an
    unknown choice, and so of ends of unknown shape, the wave that moves a position is fitted: it repeats
    every wavelength and does not fade with the gap as a harmonic of the magnets does. With fixed sensors on
    a board that is longer than the array by a wavelength, x is decoded over all periods, with no reference.
    """
    if reads == "unknown":
        return _unknown(model)

    def step(s: Signals, p: P) -> None:
        added = []
        for k in range(len(sensors(model.layout))):
            pairs = _missing_at(s, model, k, reads)
            added.append(sum(p["a1"] * c + p["b1"] * q for c, q in pairs) / len(pairs))
        s["field"] = s["field"] + p["edges"] * ca.vertcat(*added)

    new = Parameter("edges", 0.0, -MOST, MOST, "1", "share of what the ends of the stated array take")
    wide = model.with_step("field", step, effect="array_edges", parameters=(new,))
    if reads == "nearest" or not travel.resolves(array_of(model.layout), model.layout):
        return wide
    return replace(
        wide,
        begin=lambda v, p: travel.begin(v, p, array_of(model.layout), model.layout),
        period={}, absolute=(), onward=None,
    )  # fmt: skip


def _missing_at(s: Signals, model: Model, k: int, reads: str) -> list[tuple[ca.SX, ca.SX]]:
    """Vertical field at each element of channel k; of the columns alone where nothing moves the sensor."""
    array, places = array_of(model.layout), [x for x, _ in sensors(model.layout)[k].positions]
    moved, (dx, _, dz) = s["moved"][k], s["placed"][k]
    still = all(v.is_zero() for v in (dx, dz, moved["x_m"], moved["z_m"]))
    out = []
    for seen, x in zip(s["seen"](k), places, strict=True):
        u, gap = (s["turn"] * (x - s["x_m"]), s["z_m"]) if still else (seen.u, seen.height)
        if reads == "nearest":
            u = nearest(array, u, len(places))
        straight, quarter = missing(array, u, gap)
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
            waves = [links.turned((cos, sin), q * (shift - x)) for x, _ in sensor.positions]
            odd = s["turn"] * p["ends_sin"]
            added.append(sum(p["ends_cos"] * c + odd * v for c, v in waves) / len(waves))
        s["field"] = s["field"] + ca.vertcat(*added)

    new = [Parameter(f"ends_{f}", 0.0, -10.0, 10.0, "V", f"{f} of two waves per wavelength, at any gap")
           for f in ("cos", "sin")]  # fmt: skip
    return model.with_step("field", step, effect="array_edges", parameters=tuple(new))
