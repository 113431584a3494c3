"""What has to be said of a log of four Halbach arrays before it is fitted: travel, wavelength, sensors."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach.checks import FOLLOWS, LEAST_STROKE, OFF, SILENT, TRIED, WHOLE
from hallsym.families.halbach.layout import Array, Sensor, arrays, sensors
from hallsym.model import Inspection, Model

SAMPLES = 400
"""Samples of a log that are looked at, evenly over all runs."""
LEAST_SEEN = 2
"""Sensors that an array must have under it at every pose: for a phase and an amplitude."""
SURE = 4.0
"""Times less of the variation that the nominal wavelength must leave over than another does, not to be it."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Refuse a log that the arrays of a layout cannot have made; note what it cannot tell.

    Raises `InputError` for a travel that is too short, a mover beyond the sensors, a channel that sees no
    field, and another wavelength.
    """
    log.table.require((*model.references, *model.channels))
    pick = np.unique(np.linspace(0, log.rows - 1, SAMPLES).astype(int))
    pose = np.array([log.array(c)[pick] for c in model.references])
    v = np.array([log.array(c)[pick] for c in model.channels])
    good = np.isfinite(pose).all(axis=0) & np.isfinite(v).all(axis=0)
    if good.sum() < 10:
        return Inspection()
    pose, v = pose[:, good], v[:, good]
    known = arrays(model.layout)
    places = [in_mover(s, known[s.array], pose) for s in sensors(model.layout)]
    _inside(model, known, places, log.name)
    if not fitted:
        return Inspection()
    wave = next(iter(known.values())).wavelength_m
    travel = {c: float(np.ptp(pose[i])) for i, c in enumerate(model.references[:2])}
    shortest = min(travel, key=lambda c: travel[c])
    if travel[shortest] < LEAST_STROKE * wave:
        raise InputError(
            f"Column {shortest} of {log.name} covers {1e3 * travel[shortest]:.3g} mm, "
            f"{travel[shortest] / wave:.2f} of a wavelength ({1e3 * wave:g} mm); amplitude and phase need a "
            "quarter at least, and gains, offsets and places a whole one."
        )
    share, size = explained(places, v, 2 * np.pi / wave)
    silent = size < SILENT * np.median(size)
    if silent.any():
        name = model.channels[int(np.flatnonzero(silent)[0])]
        raise InputError(
            f"Channel {name} of {log.name} hardly sees the "
            f"field (its amplitude is under {100 * SILENT:.0f} % of the others'): it lies outside its "
            "array, or is not connected; leave it out of the layout."
        )
    _wavelength(places, v, wave, float(np.median(share)), log.name)
    if travel[shortest] >= WHOLE * wave:
        return Inspection()
    return Inspection(
        (
            f"The travel of {1e3 * travel[shortest]:.3g} mm in {shortest} stays within one wavelength "
            f"({1e3 * wave:g} mm): gains, places and the wavelength share what they explain; record a longer "
            "one.",
        )
    )


def in_mover(sensor: Sensor, array: Array, pose: np.ndarray) -> np.ndarray:
    """Return the sensors of a channel from the centre of their array, (elements, 3, samples) [m].

    Along it, across it and up, in mover axes for small angles; `pose`: (6, samples).
    """
    x, y, z, rx, ry, rz = pose
    places = np.array(sensor.positions)
    dx, dy = places[:, :1] - x, places[:, 1:] - y
    m = np.array([dx + rz * dy + ry * z, dy - rz * dx - rx * z])
    m -= np.array(array.centre)[:, None, None]
    return np.array([m[array.axis], m[1 - array.axis], -z + ry * dx - rx * dy]).swapaxes(0, 1)


def _inside(model: Model, known: dict[str, Array], places: Sequence[np.ndarray], name: str) -> None:
    """Refuse poses at which a sensor has left its array: the mover is beyond the grid.

    A model that knows the ends of the arrays tells the field of sensors beyond them too: there each array
    must see as many as phase and height need.
    """
    if "edges" in model.names:
        _seen(model, known, places, name)
    for sensor, at in zip(sensors(model.layout), places, strict=True):
        array = known[sensor.array]
        reach = np.inf if "edges" in model.names else array.length_m / 2
        beyond = np.array([np.abs(at[:, 0]) - reach, np.abs(at[:, 1]) - array.width_m / 2]).max()
        if beyond > 0:
            size = f"{1e3 * array.length_m:g} x {1e3 * array.width_m:g} mm"
            raise InputError(
                f"The mover of {name} goes {1e3 * beyond:.3g} mm beyond sensor {sensor.channel}, "
                f"which array {array.name} ({size}) then no longer "
                "covers; check zero and unit of the reference, leave out those poses, or the sensor."
            )


def _seen(model: Model, known: dict[str, Array], places: Sequence[np.ndarray], name: str) -> None:
    """Refuse poses at which an array has fewer sensors under it than phase and height need."""
    for array in known.values():
        own = [at for s, at in zip(sensors(model.layout), places, strict=True) if s.array == array.name]
        under = sum(np.abs(at[:, 0].mean(axis=0)) <= array.length_m / 2 for at in own)
        if np.min(under) < LEAST_SEEN:
            raise InputError(
                f"The mover of {name} goes so far that array {array.name} ({1e3 * array.length_m:g} mm long) "
                f"has {int(np.min(under))} of its {len(own)} sensors under it, where phase and height need "
                f"{LEAST_SEEN}; check zero and unit of the reference, or leave out those poses."
            )


def explained(places: Sequence[np.ndarray], v: np.ndarray, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of each channel's variation that a first harmonic of wavenumber k explains, and its size."""
    share, size = np.empty(len(v)), np.empty(len(v))
    for j, at in enumerate(places):
        fade = np.exp(k * (at[:, 2] - at[:, 2].mean()))
        basis = [np.ones(v.shape[1]), *((fade * f(k * at[:, 0])).mean(axis=0) for f in (np.cos, np.sin))]
        A = np.array(basis).T
        found, *_ = np.linalg.lstsq(A, v[j], rcond=None)
        share[j] = 1 - np.var(v[j] - A @ found) / max(np.var(v[j]), 1e-300)
        size[j] = np.hypot(*found[1:])
    return share, size


def _wavelength(places: Sequence[np.ndarray], v: np.ndarray, wave: float, share: float, name: str) -> None:
    """Refuse readings that repeat at another wavelength, or at none."""
    if share > 1 - OFF:
        return
    shares = [float(np.median(explained(places, v, 2 * np.pi / (w * wave))[0])) for w in TRIED]
    best = int(np.argmax(shares))
    found = float(TRIED[best]) * wave
    if shares[best] < FOLLOWS:
        raise InputError(
            f"The readings of {name} do not follow its reference with any period from {1e3 * wave / 2:g} to "
            f"{2e3 * wave:g} mm; check that columns and clock belong together, and the unit of the reference."
        )
    if (1 - share) > SURE * (1 - shares[best]) and abs(found / wave - 1) > OFF:
        raise InputError(
            f"The field in {name} repeats every {1e3 * found:.3g} mm, but the layout states a wavelength of "
            f"{1e3 * wave:g} mm; correct lambda_m in meta.json (wavelength_m in a machine file), or the unit "
            "of the reference."
        )
