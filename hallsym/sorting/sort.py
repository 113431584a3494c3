"""Sort sensors by gain, from their readings in known fields beside a reference sensor."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, counted, nearest
from hallsym.sorting.bench import Measured, measured
from hallsym.sorting.certainty import Certainty, certainty
from hallsym.sorting.drift import Smooth, smooth
from hallsym.sorting.readings import Readings, read_readings, readings_from
from hallsym.sorting.result import METHODS, Drift, Repeats, Sorting
from hallsym.sorting.seating import (
    FACTOR,
    Reasons,
    Refusal,
    Scatter,
    refuse_by_reference,
    refuse_conflicting,
    refuse_readings,
    refuse_strangers,
    repeatability,
)
from hallsym.units import Array

WIDTH = 0.005
"""Width of a bin, relative: .5 % (Maguire, section 5.7)."""
ENOUGH_REPEATS = 20
"""Fewest repeated sensors that may choose another way to take the drift out than the smoothed reference."""
CHANCE = 2.58
"""Standard errors by which another way must be better: 1 %."""


def sort_sensors(
    readings: Readings | str | Path | Mapping[str, Any],
    *,
    width: float = WIDTH,
    nominal: float | None = None,
    repeatability: float | None = None,
    drift: str = "auto",
    fields: Sequence[float] = (),
) -> Sorting:
    """Return gains with uncertainty, bins of `width` (relative) and the sensors that were refused.

    `readings`: a record of `read_readings`, the path of one, or a dict of arrays or data frame with its
    columns. `nominal`: the gain in the middle of bin 0 (default: the median). `repeatability`: of one
    measurement, relative (1 sigma), where no sensor was measured twice or it is known better. `drift`:
    "smooth", "ratio", "none", or "auto": the smoothed reference, unless repeats show that another is better.
    `fields` [T]: of reading_0, reading_1, ... where the table does not hold them.

    Raises `InputError` where the fields are equal, the reference is missing, no sensor is left, or bins are
    no wider than the uncertainty of a gain.
    """
    started = time.perf_counter()
    _check(width, nominal, repeatability, drift)
    if isinstance(readings, str | Path):
        readings = read_readings(readings, fields=fields)
    elif not isinstance(readings, Readings):
        readings = readings_from(readings, fields)
    m = measured(readings)
    reasons = Reasons()
    refuse_readings(m, reasons)
    _check_sign(m, reasons, readings)
    found = _drift(m, reasons, readings, drift)
    gain = m.gain / found.value
    good = reasons.good(len(gain))
    with np.errstate(divide="ignore", invalid="ignore"):
        refuse_strangers(gain / np.median(gain[good]), m.offset / np.median(gain[good]), reasons)
    scatter = _repeatability(m, gain, reasons, repeatability, found.noise)
    return _result(readings, m, gain, reasons, found, scatter, width, nominal, started)


def _check(width: float, nominal: float | None, scatter: float | None, drift: str) -> None:
    if not 0 < width < 1:
        raise InputError(
            "The width of a bin must be above 0 and below 100 % of the gain; instead received"
            f" {100 * width:g} %."
        )
    for value, what in ((nominal, "The nominal gain"), (scatter, "The repeatability")):
        if value is not None and not 0 < value < np.inf:
            raise InputError(f"{what} must be a positive number; instead received {value!r}.")
    if drift not in ("auto", *METHODS):
        raise InputError(
            f"Drift must be auto, {', '.join(METHODS)}; instead received"
            f" {drift!r}{nearest(drift, list(METHODS))}."
        )


def _check_sign(m: Measured, reasons: Reasons, readings: Readings) -> None:
    good = reasons.good(len(m.gain))
    if not good.any():
        raise InputError(
            f"No sensor of {readings.where} can be sorted: {_first(m, reasons, readings)}; a gain needs two "
            "readings in fields that differ."
        )
    if np.median(m.gain[good]) < 0:
        raise InputError(
            f"The readings of {readings.where} fall as the field grows (median gain"
            f" {np.median(m.gain[good]):.3g} {readings.gain_unit}); state the fields, or the readings, with"
            " the other sign."
        )


def _first(m: Measured, reasons: Reasons, readings: Readings) -> str:
    at, reason = next(iter(reasons.items()))
    return f"of {readings.ids[m.sensor[at]]} {reason}"


# -- drift -------------------------------------------------------------------------------------------------


def _drift(m: Measured, reasons: Reasons, readings: Readings, wanted: str) -> Drift:
    """Take the drift out in the way that is wanted, or that repeated sensors show to be best."""
    nothing = np.ones(len(m.gain))
    if m.relative is None:
        if wanted != "none":
            raise InputError(
                f"{readings.where} has no reference sensor (reference_{readings.unit}), so a drift of the"
                " bench would be taken for gain; map it with --column, or accept that with --drift none."
            )
        return Drift("none", m.time, None, nothing, 0.0, 0.0, {}, None, readings.timed)
    line = smooth(m.relative, m.time)
    if not line.bad.all():
        refuse_by_reference(m, line, reasons)
    ways = {
        "smooth": line.value,
        "ratio": np.where(np.isfinite(m.relative), m.relative, line.value),
        "none": nothing,
    }
    good = reasons.good(len(m.gain))
    scatter, pairs = {}, _pairs(m.sensor, good)
    if len(pairs):
        changes = {way: _changes(m.gain / value, pairs) for way, value in ways.items()}
        scatter = {
            way: float(np.sqrt(_trimmed(d, changes["smooth"]).mean() / 2)) for way, d in changes.items()
        }
        method = _best(changes) if wanted == "auto" else wanted
    else:
        method = "smooth" if wanted == "auto" else wanted
    return Drift(
        method,
        m.time,
        m.relative,
        ways[method],
        line.noise,
        line.step,
        scatter,
        _per_kelvin(m, line),
        readings.timed,
    )


def _pairs(sensor: Array, good: Array) -> Array:
    """First and second good measurement of each sensor that has two, (r, 2)."""
    at = np.flatnonzero(good)
    order = at[np.argsort(sensor[at], kind="stable")]
    first = np.r_[True, np.diff(sensor[order]) != 0] if len(order) else np.zeros(0, bool)
    starts = np.flatnonzero(first)
    starts = starts[(starts + 1 < len(order))]
    starts = starts[~first[starts + 1]] if len(starts) else starts
    return np.stack([order[starts], order[starts + 1]], axis=1)


def _changes(gain: Array, pairs: Array) -> Array:
    first, second = gain[pairs[:, 0]], gain[pairs[:, 1]]
    return np.asarray(2 * (second - first) / (second + first))


def _trimmed(changes: Array, by: Array) -> Array:
    """Squared changes without the gross ones, which another check refuses."""
    usual = np.median(np.abs(by))
    kept = np.abs(by) <= 6 * usual if usual > 0 else np.ones(len(by), bool)
    return np.asarray(changes[kept] ** 2)


def _best(changes: Mapping[str, Array]) -> str:
    """The smoothed reference, unless the squared changes of another way are clearly smaller."""
    best = "smooth"
    for way in ("ratio", "none"):
        fewer = _trimmed(changes[best], changes["smooth"]) - _trimmed(changes[way], changes["smooth"])
        if len(fewer) >= ENOUGH_REPEATS and fewer.mean() > CHANCE * fewer.std(ddof=1) / np.sqrt(len(fewer)):
            best = way
    return best


def _per_kelvin(m: Measured, line: Smooth) -> tuple[float, float] | None:
    """Slope of the reference's gain over the temperature [1/K], with its standard uncertainty."""
    if m.temperature is None or m.relative is None:
        return None
    use = ~line.bad & np.isfinite(m.temperature)
    t = m.temperature[use] - m.temperature[use].mean() if use.any() else np.zeros(0)
    if len(t) < 3 or not (t @ t) > 0:
        return None
    y = m.relative[use] - m.relative[use].mean()
    slope = float(t @ y / (t @ t))
    return slope, float(np.sqrt(np.sum((y - slope * t) ** 2) / (len(t) - 2) / (t @ t)))


# -- sensors -----------------------------------------------------------------------------------------------


def _repeatability(
    m: Measured, gain: Array, reasons: Reasons, stated: float | None, noise: float
) -> Scatter | None:
    with np.errstate(invalid="ignore"):
        found = repeatability(m.sensor, gain, reasons, stated)
    if usual := found.std if found else noise:
        refuse_conflicting(m, usual, reasons)
    return found


def _result(
    readings: Readings,
    m: Measured,
    gain: Array,
    reasons: Reasons,
    drift: Drift,
    scatter: Scatter | None,
    width: float,
    nominal: float | None,
    started: float,
) -> Sorting:
    at = np.flatnonzero(reasons.good(len(gain)))
    count = np.bincount(m.sensor[at], minlength=len(readings.ids))
    kept = np.flatnonzero(count)
    if not len(kept):
        raise InputError(f"Every sensor of {readings.where} was refused: {_first(m, reasons, readings)}.")

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(m.sensor[at], values[at], len(readings.ids))[kept] / count[kept])

    gains = mean(gain)
    middle = float(np.median(gains)) if nominal is None else nominal
    known = certainty(m, gains, at, count[kept], scatter, drift)
    if not 1 / FACTOR < middle / float(np.median(gains)) < FACTOR:
        raise InputError(
            f"The nominal gain must be near those of the sensors; instead received {middle:g} where their "
            f"median is {np.median(gains):.4g} {readings.gain_unit}."
        )
    _check_width(width, float(np.median(known.gain)) / middle)
    return Sorting(
        tuple(readings.ids[k] for k in kept),
        gains,
        mean(m.offset),
        known.gain,
        known.offset,
        known.dof,
        middle,
        readings.gain_unit,
        readings.unit,
        count[kept],
        width,
        drift,
        _repeats(m, gain / middle, at, scatter),
        _refusals(readings, m, reasons, count),
        tuple(_notes(readings, scatter, known, drift, gains / middle)),
        readings.where,
        time.perf_counter() - started,
    )


def _check_width(width: float, std: float) -> None:
    if width <= std:
        raise InputError(
            f"Bins of {100 * width:.3g} % are no wider than the standard uncertainty of a gain,"
            f" {100 * std:.2g} %: most sensors would be in a wrong one; choose --bin {100 * 4 * std:.2g} or"
            " wider, or measure each sensor more often."
        )


def _repeats(m: Measured, relative: Array, at: Array, scatter: Scatter | None) -> Repeats | None:
    good = np.zeros(len(relative), bool)
    good[at] = True
    pairs = _pairs(m.sensor, good)
    if scatter is None or not len(pairs):
        return None
    return Repeats(scatter, relative[pairs[:, 0]], relative[pairs[:, 1]])


def _refusals(readings: Readings, m: Measured, reasons: Reasons, count: Array) -> tuple[Refusal, ...]:
    """One entry a refused sensor, and one a measurement that does not count of a sensor that does."""
    found: dict[tuple[int, str], Refusal] = {}
    whole: set[int] = set()
    for at in sorted(reasons):
        sensor = int(m.sensor[at])
        if count[sensor]:
            found[sensor, reasons[at]] = Refusal(readings.ids[sensor], reasons[at], whole=False)
        elif sensor not in whole:
            whole.add(sensor)
            found[sensor, ""] = Refusal(readings.ids[sensor], reasons[at])
    return tuple(found.values())


def _notes(
    readings: Readings, scatter: Scatter | None, known: Certainty, drift: Drift, relative: Array
) -> Iterator[str]:
    yield from readings.notes
    if scatter is None:
        told = (
            f"{known.instead}, stands for it"
            if known.instead
            else "gains have no uncertainty and no sensor is called wrong"
        )
        yield (
            f"no sensor was measured twice, so the repeatability is not known: {told}; state it with"
            " --repeatability, or measure 20 sensors again."
        )
    elif scatter.sensors and scatter.dof < ENOUGH_REPEATS:
        yield (
            f"the repeatability is known from {counted(scatter.sensors, 'sensor')} only, which the"
            " probabilities allow for."
        )
    if drift.read is None:
        yield "no drift was taken out: there is no reference sensor."
    if not readings.paired:
        yield (
            "the reference sensor was read once a measurement; its offset is taken as small beside its"
            " reading."
        )
    if not readings.timed and drift.read is not None:
        yield "no column t_s: drift is smoothed over the order of the measurements."
    if len(relative) > 1 and np.ptp(relative) == 0:
        yield "all gains are equal."
