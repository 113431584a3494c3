"""What has to be said of a log of Halbach arrays before it is fitted: travel, sensors under the arrays."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hallsym.families.halbach.finite import MARGIN, missing
from hallsym.families.halbach.layout import Array, Sensor, arrays, sensors
from hallsym.log import Fault
from hallsym.model import Inspection, Model, on_arrays

SAMPLES = 4000
"""Samples of a log that are looked at, evenly over all runs; of six coordinates a tenth."""
LEAST_TRAVEL = 0.25
"""Travel, in wavelengths, that a fit needs: less hardly separates amplitude and phase of a harmonic."""
WHOLE = 0.99
"""Travel, in wavelengths, from which on the wavelength of the magnets shows by itself: a whole one, of which
the last sample and the reference's noise may take a little."""
COVERED = 0.5
"""Share of the samples in which the array must be over a channel, where the model takes it for endless."""
LEAST_SEEN = 2
"""Sensors that an array must have under it at every pose of six coordinates: for a phase and an amplitude."""

LEFT_OUT = 1e-4
"""Share of the field that ends take at some sensor, above which it is said: .06 mV of .6 V, three times the
uncertainty of an offset of a usual log (1 mV of noise, some thousand samples)."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Claim what the arrays of a layout cannot have logged of the pose; note what the log cannot tell."""
    known, planar = arrays(model.layout), len(model.references) > 2
    pick = np.unique(np.linspace(0, log.rows - 1, SAMPLES // 10 if planar else SAMPLES).astype(int))
    pose = np.array([log.array(c)[pick] for c in model.references])
    odd: list[str] = [*(_under_arrays if planar else _covered)(model, known, pose, log.name)]
    beyond = bool(odd)
    if fitted:
        along = model.references[: 2 if planar else 1]
        odd += _travel(along, pose, next(iter(known.values())).wavelength_m, log.name)
    if any(array.ends for array in known.values()):
        odd += _of_ends(model, known, pose, log.name)
    elif not beyond and "array_edges" not in model.effects:
        odd += _left_out(model, known, pose, planar)
    return Inspection(tuple(odd))


def _travel(columns: Sequence[str], pose: np.ndarray, wave: float, name: str) -> Iterator[str]:
    """Claim that the travel, in the shortest of the first coordinates, tells no wave; note a short one."""
    travel = {c: float(np.ptp(along)) for c, along in zip(columns, pose, strict=False)}
    shortest = min(travel, key=lambda c: travel[c])
    if travel[shortest] < LEAST_TRAVEL * wave:
        text = (
            f"Column {shortest} of {name} covers {1e3 * travel[shortest]:.3g} mm, "
            f"{travel[shortest] / wave:.2f} of a wavelength ({1e3 * wave:g} mm); amplitude and phase need a "
            "quarter at least, and gains, offsets and places a whole one."
        )
        yield Fault(text, "short_travel", (shortest,))
    elif travel[shortest] < WHOLE * wave:
        yield (
            f"The travel of {1e3 * travel[shortest]:.3g} mm in {shortest} stays within one wavelength "
            f"({1e3 * wave:g} mm): gains, places and the wavelength share what they explain; record a longer "
            "one."
        )


def _covered(model: Model, known: dict[str, Array], pose: np.ndarray, name: str) -> Iterator[Fault]:
    """Claim sensors that the array hardly is over, unless the model knows the ends of the array."""
    (array,) = known.values()
    if array.ends:
        return
    places = np.array([s.middle[0] for s in sensors(model.layout)])
    share = np.mean(np.abs(places[:, None] - pose[0]) < array.length_m / 2, axis=1)
    least = int(np.argmin(share))
    if share[least] < COVERED and "edges" not in model.names:
        sensor = sensors(model.layout)[least]
        yield Fault(
            f"Channel {sensor.channel} of {name}, at {1e3 * sensor.middle[0]:.4g} mm, is outside the field "
            f"in {100 * (1 - share[least]):.0f} % of the samples, beyond the ends of an array of "
            f"{1e3 * array.length_m:g} mm; check zero and unit of the reference, fit with --effect "
            "array_edges, correct 'periods' (length_m), or leave it out.",
            "beyond",
            (sensor.channel,),
        )


def _of_ends(model: Model, known: dict[str, Array], pose: np.ndarray, name: str) -> Iterator[str]:
    """Claim places where a model does not know the ends of its array; note ends that the log hardly tells."""
    for array in known.values():
        # of six coordinates the travel is that of the sensors in the mover
        seen = pose if len(pose) == 2 else pose[:3] * [[-1], [-1], [1]]
        box, room = array.box(len(seen) - 1), MARGIN * array.wavelength_m
        over = np.maximum(box[:, :1] - seen, seen - box[:, 1:]).max(axis=1)
        if over.max() > room:
            text = (
                f"The mover of {name} goes {1e3 * over.max():.3g} mm beyond the travel over which the model "
                f"knows what the ends of array {array.name} take; fit this log by itself."
            )
            yield Fault(text, "beyond", tuple(model.references[k] for k in np.flatnonzero(over > room)))
        if array.rival:
            yield (
                f"Which magnet is in the middle of array {array.name}, {array.middle_magnet} or "
                f"{array.other.middle_magnet} (half magnets from the one that points to the sensors), the "
                "readings hardly tell: offsets are less certain than with 'middle_magnet' stated."
            )


def _left_out(model: Model, known: dict[str, Array], pose: np.ndarray, planar: bool) -> Iterator[str]:
    """Note how much of the field the ends of the arrays take, where a model takes them for endless."""
    largest, where = 0.0, next(iter(known.values()))
    ends = {name: on_arrays(missing(array)) for name, array in known.items()}
    for sensor in sensors(model.layout):
        array = known[sensor.array] if planar else where
        if planar:
            seen = in_mover(sensor, array, pose).mean(axis=0)
            u, gap = seen[0], -seen[2]
        else:
            u, gap = sensor.middle[0] - pose[0], pose[1]
        taken = np.hypot(*ends[array.name]([u], [gap]))
        with np.errstate(over="ignore"):  # a gap in another unit is for the fit to tell
            share = float((taken * np.exp(array.wavenumber * (gap - array.level_m)))[0].max())
        if share > largest:
            largest, where = share, array
    if LEFT_OUT < largest < np.inf:
        yield (
            f"The ends of array {where.name} ({1e3 * where.length_m:g} mm long) change readings by up to "
            f"{100 * largest:.2g} % of the field, which the model leaves out: gains and offsets may be off "
            "by up to that, beyond their stated uncertainties; --effect array_edges takes most of it in."
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


def _under_arrays(model: Model, known: dict[str, Array], pose: np.ndarray, name: str) -> Iterator[Fault]:
    """Claim poses at which a sensor has left its array: the mover is beyond the grid.

    A model that knows the ends of the arrays tells the field of sensors beyond them too: there each array
    must see as many as phase and height need.
    """
    all_sensors, ended = sensors(model.layout), "edges" in model.names
    places = [in_mover(s, known[s.array], pose) for s in all_sensors]
    for array in known.values() if ended else ():
        own = [at for s, at in zip(all_sensors, places, strict=True) if s.array == array.name]
        least = int(np.min(sum(np.abs(at[:, 0].mean(axis=0)) <= array.length_m / 2 for at in own)))
        if least < LEAST_SEEN:
            text = (
                f"The mover of {name} goes so far that array {array.name} ({1e3 * array.length_m:g} mm long) "
                f"has {least} of its {len(own)} sensors under it, where phase and height need {LEAST_SEEN}; "
                "check zero and unit of the reference, or leave out those poses."
            )
            yield Fault(text, "beyond")
    for sensor, at in zip(all_sensors, places, strict=True):
        array = known[sensor.array]
        reach = np.inf if ended else array.length_m / 2
        beyond = np.array([np.abs(at[:, 0]) - reach, np.abs(at[:, 1]) - array.width_m / 2]).max()
        if beyond > 0:
            text = (
                f"The mover of {name} goes {1e3 * beyond:.3g} mm beyond sensor {sensor.channel}, which array "
                f"{array.name} ({1e3 * array.length_m:g} x {1e3 * array.width_m:g} mm) then does not cover; "
                "check zero and unit of the reference, leave out those poses, or the sensor."
            )
            yield Fault(text, "beyond", (sensor.channel,))
            return


def implausible(fit: Any) -> Iterator[Fault]:
    """Yield the claim that a gap ends below zero: its zero is that of another place."""
    low = min(fit.log.span.get("z_ref_m", (0.0,)))
    if low < 0:
        yield Fault(
            f"z_ref_m goes down to {1e3 * low:.3g} mm, and a gap between array and sensors cannot be below "
            "0: it counts from another place, and amplitudes are those of another gap; put it right with "
            "--correct 'zero_moved z_ref_m METRES'.",
            "gap", ("z_ref_m",),
        )  # fmt: skip
