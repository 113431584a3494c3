"""Campaigns of a plant of cuboid magnets with sensors that are not sorted, and how far a fit is off them.

One array over nine sums, or four over 24: gains by 2 %, offsets by 10 mV, places by 50 um, all 1 sigma. What
no log tells is taken out of both sides: a gain, or a shift, that all sensors of an array have in common, and
an offset that all 24 sums have in common. That is the field that each array leaves under the other three.
"""

from functools import cache

import numpy as np
from halbach_plant import magnets, readings

import hallsym
from hallsym import Log, Noise
from hallsym.families.halbach import planar
from hallsym.families.halbach.layout import Array, Sensor, arrays, sensors
from hallsym.families.halbach.models import halbach
from hallsym.log import Meta

STATED = ("name", "periodic_along", "centre_m", "length_m", "width_m", "wavelength_m")
EFFECTS = ["gain_mismatch", "offset_error", "sensor_position_error"]
V_PER_T, NOISE_V = 4.0, 2e-3
REFERENCE = {"m": 5e-7, "rad": 3e-6}
"""Noise of the reference."""
SPREAD = {"gain": 0.02, "offset_error": 0.01, "d": 5e-5}


@cache
def one_array(rows=3):
    """Nine columns at a third of the wavelength, sums of so many sensors, under an array of eight periods."""
    across = [(i - (rows - 1) / 2) * 0.01 for i in range(rows)]
    made = [Sensor(f"col_{j}_v", tuple(((j - 4) * 0.01, y) for y in across)) for j in range(9)]
    return halbach((*made, Array("X", 0.03)))


def poses(model, rng, count):
    """Random poses (count, 6) within 20 (one array) or 12.5 mm, 4.5 to 7.5 mm of gap, 10 mrad."""
    six = len(model.pose) == 6
    out = np.zeros((count, 6))
    out[:, : 2 if six else 1] = (0.0125 if six else 0.02) * rng.uniform(-1, 1, (count, 2 if six else 1))
    out[:, 2] = rng.uniform(4.5e-3, 7.5e-3, count)
    out[:, 3:] = 0.01 * six * rng.uniform(-1, 1, (count, 3))
    return out


def campaign(model, seed, count=240):
    """A log of the plant in four runs, and what its sensors are off by: name of a parameter -> value."""
    rng = np.random.default_rng(seed)
    known, seen = arrays(model.layout), sensors(model.layout)
    parts = [m for a in known.values() for m in magnets(a.axis, a.centre, a.length_m, a.width_m)]
    axis = [known.get(s.array, next(iter(known.values()))).axis for s in seen]
    off = {kind: size * rng.standard_normal(len(seen)) for kind, size in SPREAD.items()}
    points = [np.array(s.positions) for s in seen]
    for place, i, d in zip(points, axis, off["d"], strict=True):
        place[:, i] += d
    at = poses(model, rng, count)
    field = readings(parts, np.concatenate(points), at)
    field = np.array([f.mean(axis=0) for f in np.split(field, np.cumsum([len(p) for p in points])[:-1])])
    v = (1 + off["gain"])[:, None] * V_PER_T * field + off["offset_error"][:, None]
    v += NOISE_V * rng.standard_normal(v.shape)
    noise = dict.fromkeys(model.channels, NOISE_V)
    noise |= {c: REFERENCE[c.rpartition("_")[2]] for c in model.references}
    columns = [at[:, k] for k in ((0, 2) if len(model.pose) == 2 else range(6))]
    data = {
        c: x + noise[c] * rng.standard_normal(count) for c, x in zip(model.references, columns, strict=True)
    }
    data |= dict(zip(model.channels, v, strict=True))
    data |= {"run": np.arange(count) * 4 // count, "t_s": 0.01 * np.arange(count)}
    true = {
        kind + (f"{'xy'[i]}_" if kind == "d" else "_") + s.label: float(off[kind][k])
        for kind in SPREAD
        for k, (s, i) in enumerate(zip(seen, axis, strict=True))
    }
    parts = [part.entry for part in model.layout]
    stated = [{k: entry[k] for k in STATED if k in entry} for entry in parts if "channel" not in entry]
    meta = Meta(probes=[e for e in parts if "channel" in e], raw={"arrays": stated})
    return Log.from_arrays(data, Noise.given(noise, tuple(data)), meta), true


def deviations(model, seed, count=240):
    """Estimates less the truth over their standard uncertainty, by name of the parameter."""
    log, true = campaign(model, seed, count)
    fit = hallsym.fit(log, model.name, effects=EFFECTS, solver="direct", loss="none")
    assert fit.status == "converged"
    out = {}
    names = list(fit.model.names)
    several = len(arrays(model.layout)) > 1
    groups: dict[tuple[str, str], list[str]] = {}
    for k, name in enumerate(true):
        sensor, kind = sensors(model.layout)[k % len(model.channels)], name.split("_")[0]
        groups.setdefault((kind, "" if kind == "offset" else sensor.array), []).append(name)
    for (kind, _), own in groups.items():
        at = [names.index(n) for n in own]
        alone = kind == "offset" and not several
        contrast = np.eye(len(own)) - (0 if alone else 1 / len(own))
        found, known = (np.array([of(n) for n in own]) for of in (fit.value, true.__getitem__))
        if kind == "gain":  # gains are told up to a factor of all
            found, known = ((1 + g) / np.mean(1 + g) for g in (found, known))
        error = contrast @ (found - known)
        std = np.sqrt(np.diag(contrast @ fit.covariance[np.ix_(at, at)] @ contrast.T))
        out |= dict(zip(own, error / std, strict=True))
    return out


def four_arrays():
    """The thesis's pinwheel: six sums of three under each array."""
    return planar.halbach_planar()
