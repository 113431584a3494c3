"""Sort sensors by gain, from their readings in known fields beside a reference sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from hallsym.errors import InputError, require
from hallsym.shown import Shown
from hallsym.sorting.bins import bins_of, change_probability, wrong_probability
from hallsym.sorting.readings import Readings, read_readings
from hallsym.units import Array

WIDTH = 0.005
"""Width of a bin, relative: .5 % (Maguire, section 5.7)."""
WINDOW = 25
"""Measurements of the reference sensor whose median is the drift: their noise falls to a quarter."""
OUTLYING = 6.0
"""Medians of the change of repeated sensors, 4 sigma, beyond which a change is an outlier."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """Sensors measured again: `first` and `second` (r,) relative gains of their first two measurements."""

    first: Array
    second: Array

    @property
    def drift(self) -> float:
        """Mean change from the first to the second measurement, relative."""
        return float(np.mean(self.second - self.first))

    @property
    def std(self) -> float:
        """Standard deviation of that change; nan for one sensor."""
        return float(np.std(self.second - self.first, ddof=1)) if len(self.first) > 1 else float("nan")

    def changes(self, width: float) -> dict[int, tuple[int, float]]:
        """Return for each change in bins how many sensors made it, and how many are expected to."""
        moved = bins_of(self.second, width) - bins_of(self.first, width)
        known = np.isfinite(self.std) and self.std > 0
        return {
            k: (
                int((moved == k).sum()),
                len(moved) * change_probability(k, width, self.drift, self.std) if known else float("nan"),
            )
            for k in sorted({-1, 0, 1, *moved.tolist()})
        }


@dataclass(frozen=True, eq=False, repr=False)
class Sorting(Shown):
    """Sorted sensors, all of shape (n,), and properties of the bench.

    `gain` [`unit`] and `offset` [`reading_unit`], `std` of the gain [`unit`] of `dof` degrees of freedom
    without the common scale of the known field, `measurements` of each. `repeatability` of one measurement,
    relative (1 sigma); `drift` (m,) of the bench by measurement, relative (None: no reference sensor);
    `unsorted`: sensors without readings in two fields.
    """

    sensors: tuple[str, ...]
    gain: Array
    offset: Array
    std: Array
    dof: float
    nominal: float
    unit: str
    reading_unit: str
    measurements: Array
    width: float
    repeatability: float
    drift: Array | None
    repeats: Repeats | None
    unsorted: tuple[str, ...]
    notes: tuple[str, ...]
    source: str

    @cached_property
    def relative(self) -> Array:
        """Gain over the nominal one, (n,)."""
        return np.asarray(self.gain / self.nominal)

    @cached_property
    def bin(self) -> Array:
        """Bin of each sensor, (n,): k stands for gains within half a width of 1 + k width."""
        return bins_of(self.relative, self.width)

    @cached_property
    def wrong(self) -> Array:
        """Probability that each sensor belongs to another bin, (n,)."""
        return wrong_probability(self.relative, self.std / self.nominal, self.dof, self.width)

    @property
    def expected_wrong(self) -> tuple[float, float]:
        """Sensors expected in a wrong bin, and the standard deviation of their number.

        The number grows as the repeatability, whose relative uncertainty is 1 / sqrt(2 dof).
        """
        number = float(self.wrong.sum())
        return number, float(np.sqrt((self.wrong * (1 - self.wrong)).sum() + number**2 / (2 * self.dof)))

    @property
    def bins(self) -> dict[int, int]:
        """Number of sensors in each bin that holds any."""
        found, counts = np.unique(self.bin, return_counts=True)
        return dict(zip(found.tolist(), counts.tolist(), strict=True))

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The table of the sensors by columns."""
        columns = {
            "sensor": np.array(self.sensors), "gain": self.gain, "gain_std": self.std, "offset": self.offset,
            "relative": self.relative, "bin": self.bin, "wrong_bin_probability": self.wrong,
            "measurements": self.measurements,
        }  # fmt: skip
        return {name: values.tolist() for name, values in columns.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain data: every sensor, bins, drift, repeats."""
        columns = self.columns
        r, repeats = self.repeats, None
        if r is not None:
            changes = [
                {"bins": k, "observed": n, "expected": e if np.isfinite(e) else None}
                for k, (n, e) in r.changes(self.width).items()
            ]
            std = r.std if np.isfinite(r.std) else None
            repeats = {"sensors": len(r.first), "drift": r.drift, "std_of_change": std, "changes": changes}
        return {
            "source": self.source,
            "unit": self.unit,
            "offset_unit": self.reading_unit.replace("v", "V"),
            "nominal": self.nominal,
            "bin_width": self.width,
            "repeatability": self.repeatability,
            "degrees_of_freedom": self.dof if np.isfinite(self.dof) else None,
            "drift_span": None if self.drift is None else float(np.ptp(self.drift)),
            "sensors": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
            "bins": [{"bin": k, "centre": 1 + k * self.width, "sensors": n} for k, n in self.bins.items()],
            "expected_wrong": dict(zip(("number", "std"), self.expected_wrong, strict=True)),
            "repeats": repeats,
            "unsorted": list(self.unsorted),
            "notes": list(self.notes),
        }


def sort_sensors(
    readings: Readings | str | Path | Mapping[str, Any],
    *,
    width: float = WIDTH,
    nominal: float | None = None,
    repeatability: float | None = None,
    fields: Sequence[float] = (),
) -> Sorting:
    """Return gains with uncertainty, and bins of `width` (relative).

    `readings`: a record of `read_readings`, the path of one, or a dict of arrays or data frame with its
    columns. `nominal`: the gain in the middle of bin 0 (default: the median). `repeatability`: of one
    measurement, relative (1 sigma), where no sensor was measured twice or it is known better. `fields` [T]:
    of reading_0, reading_1, ... where the table does not hold them.

    A gain is the slope of the line through a sensor's readings over the field, divided by the drift that the
    reference sensor shows, and averaged over the sensor's measurements.

    Raises `InputError` where all fields are equal or the repeatability is unknown.
    """
    require(0 < width < 1, "The width of a bin", "a share of the gain above 0 and below 1", width)
    for value, what in ((nominal, "The nominal gain"), (repeatability, "The repeatability")):
        require(value is None or 0 < value < np.inf, what, "a positive number", value)
    if not isinstance(readings, Readings):
        readings = read_readings(readings, fields=fields)
    sensor, gain, offset = _lines(readings, readings.value)
    at, drift = np.flatnonzero(np.isfinite(gain)), None
    if not len(at):
        raise InputError(
            f"The fields of {readings.where} must differ: a gain is the change of a sensor's reading between"
            " two known fields, and no sensor was read in two."
        )
    if not 0 < (usual := float(np.median(gain[at]))) < np.inf:
        fall = "fall as the field grows: state the fields, or the readings, with the other sign"
        stay = "do not change with the field: check their column, and the fields and their unit"
        raise InputError(
            f"The readings of {readings.where} {fall if usual < 0 else stay} (median gain {usual:.3g}"
            f" {readings.gain_unit})."
        )
    if readings.reference is not None:
        drift = _drift(_lines(readings, readings.reference)[1], readings)
        gain = gain / drift
    count = np.bincount(sensor[at], minlength=len(readings.ids))
    kept = np.flatnonzero(count)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(sensor[at], values[at], len(count))[kept] / count[kept])

    gains = mean(gain)
    middle = float(np.median(gains)) if nominal is None else nominal
    again = _again(sensor, at)
    scatter, dof, notes = _scatter(sensor, gain, again, repeatability, readings)
    notes += ["no drift was taken out: there is no reference sensor."] if drift is None else []
    return Sorting(
        tuple(readings.ids[k] for k in kept),
        gains,
        mean(offset),
        scatter / np.sqrt(count[kept]) * np.abs(gains),
        dof,
        middle,
        readings.gain_unit,
        readings.unit,
        count[kept],
        width,
        scatter,
        drift,
        Repeats(*(gain[[g[:2] for g in again]].T / middle)) if again else None,
        tuple(readings.ids[k] for k in np.flatnonzero(count == 0)),
        (*readings.notes, *notes),
        readings.where,
    )


def _lines(readings: Readings, values: Array) -> tuple[Array, Array, Array]:
    """Return least-squares lines through the readings of each measurement (m,), in the order of time.

    The sensor, its gain [unit / T] (nan with fewer than two fields) and offset [unit].
    """
    count = int(readings.measurement.max()) + 1
    use = np.isfinite(values) & np.isfinite(readings.field)
    at, b, v = readings.measurement[use], readings.field[use], values[use]

    def total(x: Array) -> Array:
        return np.bincount(at, x, count)

    n = np.maximum(total(np.ones(len(at))), 1.0)
    mean_b, mean_v = total(b) / n, total(v) / n
    db, dv = b - mean_b[at], v - mean_v[at]
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, at, b)
    np.maximum.at(high, at, b)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.where(high > low, total(db * dv) / total(db * db), np.nan)
    sensor, ended = np.zeros(count, int), np.full(count, -np.inf)
    sensor[readings.measurement] = readings.sensor
    np.maximum.at(ended, readings.measurement, readings.time)
    order = np.argsort(ended, kind="stable")
    return sensor[order], gain[order], (mean_v - gain * mean_b)[order]


def _drift(gain: Array, readings: Readings) -> Array:
    """Drift of the bench (m,): running median of the reference sensor's gain over its median."""
    known = np.flatnonzero(np.isfinite(gain))
    middle = float(np.median(gain[known])) if len(known) else 0.0
    if middle == 0:
        raise InputError(
            f"The reference sensor of {readings.where} must follow the field; its readings do not: check its"
            " column and its wiring, or leave the column out."
        )
    smooth = median_filter(gain[known] / middle, WINDOW, mode="reflect")
    return np.interp(np.arange(len(gain)), known, smooth)


def _again(sensor: Array, at: Array) -> list[Array]:
    """The measurements `at` of each sensor that was measured more than once, one array a sensor."""
    order = at[np.argsort(sensor[at], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(sensor[order])) + 1)
    return [g for g in groups if len(g) > 1]


def _scatter(
    sensor: Array, gain: Array, groups: Sequence[Array], stated: float | None, readings: Readings
) -> tuple[float, float, list[str]]:
    """Repeatability of one measurement, relative (1 sigma), its degrees of freedom, and notes on it.

    The stated one; else that of sensors measured again.
    """
    if stated is not None:
        return stated, np.inf, []
    if not groups:
        raise InputError(
            f"The repeatability of a gain cannot be estimated from {readings.where}: measure some 20 sensors"
            " twice, or state it with --repeatability PERCENT."
        )
    away = [gain[g] / gain[g].mean() - 1 for g in groups]
    worst = np.array([np.abs(d).max() for d in away])
    outlying = worst > OUTLYING * np.median(worst)
    kept = [d for d, out in zip(away, outlying, strict=True) if not out]
    dof = float(sum(len(d) - 1 for d in kept))
    names = [readings.ids[sensor[g[0]]] for g, out in zip(groups, outlying, strict=True) if out]
    note = (
        f"the measurements of {', '.join(names)} differ too much to count for the repeatability:"
        f" measure {'it' if len(names) == 1 else 'them'} again."
    )
    std = float(np.sqrt(sum(float(d @ d) for d in kept) / dof))
    return std, dof, [note] if names else []
