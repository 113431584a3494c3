"""From readings to measurements: the line through each measurement's readings, and that of the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError
from hallsym.sorting.readings import Readings
from hallsym.units import Array


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements (m,) in the order of time: one insertion of one sensor each.

    `gain` [unit / T] and `offset` [unit] of the line through its readings, `off_line` the largest residual
    from it [unit] where there are more than two readings (else 0), `levels` the number of different fields,
    `square` [unit^2] the sum of squared residuals and `spare` their degrees of freedom, `gain_root` [1 / T]
    and `offset_root` what the scatter of a reading is multiplied by to give that of gain and offset,
    `relative` the reference sensor's gain over its median (nan: not read; None: there is no reference).
    """

    sensor: Array
    gain: Array
    offset: Array
    off_line: Array
    levels: Array
    span: Array
    square: Array
    spare: Array
    gain_root: Array
    offset_root: Array
    relative: Array | None
    time: Array
    temperature: Array | None


def measured(readings: Readings) -> Measured:
    """Return the measurements of a record. Raises `InputError` where all fields are equal."""
    fields = readings.field[np.isfinite(readings.field)]
    if not len(fields) or fields.min() == fields.max():
        known = f"all are {fields[0] * 1e3:g} mT" if len(fields) else "none is stated"
        raise InputError(
            f"The fields of {readings.where} must differ, for a gain is the change of a reading between two"
            f" known fields; {known}."
        )
    if not np.isfinite(readings.time).all():
        row = int(np.flatnonzero(~np.isfinite(readings.time))[0]) + 1
        raise InputError(
            f"Column t_s of {readings.where} must hold the time of every reading; reading {row} has none. "
            "Without the column the order of the rows stands for it."
        )
    line = _lines(readings, readings.value)
    count = len(line.gain)
    sensor, time = np.zeros(count, int), np.zeros(count)
    sensor[readings.repeat] = readings.sensor
    np.maximum.at(time := np.full(count, -np.inf), readings.repeat, readings.time)
    order = np.argsort(time, kind="stable")
    relative, warm = _relative(readings), _mean(readings, readings.temperature)
    return Measured(
        sensor[order],
        line.gain[order],
        line.offset[order],
        line.off[order],
        line.levels[order],
        line.span[order],
        line.square[order],
        line.spare[order],
        line.gain_root[order],
        line.offset_root[order],
        None if relative is None else relative[order],
        time[order],
        None if warm is None else warm[order],
    )


@dataclass(frozen=True, eq=False)
class _Lines:
    gain: Array
    offset: Array
    off: Array
    levels: Array
    span: Array
    square: Array
    spare: Array
    gain_root: Array
    offset_root: Array


def _lines(readings: Readings, values: Array) -> _Lines:
    """Least-squares lines through the readings of each measurement; nan with fewer than two fields."""
    count = int(readings.repeat.max()) + 1
    use = np.isfinite(values) & np.isfinite(readings.field)
    at, b, v = readings.repeat[use], readings.field[use], values[use]

    def total(x: Array) -> Array:
        return np.bincount(at, x, count)

    n = np.maximum(total(np.ones(len(at))), 1.0)
    mean_b, mean_v = total(b) / n, total(v) / n
    db, dv = b - mean_b[at], v - mean_v[at]
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, at, b)
    np.maximum.at(high, at, b)
    span = np.where(high > low, high - low, 0.0)
    levels = _levels(at, b, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.where(levels > 1, total(db * dv) / total(db * db), np.nan)
        roots = 1 / np.sqrt(total(db * db)), np.sqrt(1 / n + mean_b**2 / total(db * db))
    rest = np.nan_to_num(dv - gain[at] * db)
    off = np.zeros(count)
    np.maximum.at(off, at, np.abs(rest))
    some = n > 2
    square, spare = np.where(some, total(rest * rest), 0.0), np.where(some, n - 2, 0.0)
    return _Lines(gain, mean_v - gain * mean_b, np.where(some, off, 0.0), levels, span, square, spare, *roots)


def _levels(at: Array, field: Array, count: int) -> Array:
    pairs = np.unique(np.stack([at.astype(float), field]), axis=1)
    return np.bincount(pairs[0].astype(int), minlength=count)


def _relative(readings: Readings) -> Array | None:
    """Gain of the reference sensor in each measurement over its median, or its reading if read once."""
    if readings.reference is None:
        return None
    gain = (
        _lines(readings, readings.reference).gain if readings.paired else _mean(readings, readings.reference)
    )
    assert gain is not None
    finite = gain[np.isfinite(gain)]
    middle = float(np.median(finite)) if len(finite) else 0.0
    if middle == 0:
        raise InputError(
            f"The reference sensor of {readings.where} must follow the field; its readings "
            f"{'do not change with it' if len(finite) else 'are missing'}: check its column and its wiring."
        )
    return np.asarray(gain / middle)


def _mean(readings: Readings, values: Array | None) -> Array | None:
    """Mean of a column over the readings of each measurement; nan where there is none."""
    if values is None:
        return None
    count, use = int(readings.repeat.max()) + 1, np.isfinite(values)
    n = np.bincount(readings.repeat[use], minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.bincount(readings.repeat[use], values[use], count) / n)
