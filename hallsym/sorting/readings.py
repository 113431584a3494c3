"""What a sorting bench recorded: readings of sensors in known fields, a reference sensor beside them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.log import Log, read_log
from hallsym.log.columns import listed
from hallsym.log.table import label
from hallsym.units import Array, si_unit

SENSOR, REPEAT = "sensor", "repeat"
"""Columns of names: the sensor, and which measurement of it a row belongs to."""
NAMES = (SENSOR, REPEAT)
LONG = re.compile(r"(reading|field|reference)_([a-z_]+)")
WIDE = re.compile(r"(reading|field|reference)_(\d+)_([a-z_]+)")


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings (rows,), in the order of recording; a missing number is nan.

    `sensor`, `repeat`: index of the sensor in `ids`, and of its measurement (an insertion into the socket) in
    the whole record. `field` [T], `value` and `reference` (the reference sensor's reading beside it) in
    `unit`, `time` [s] or the order of the measurements, `temperature` [degC]. `paired`: whether the reference
    was read in every field and not once a measurement.
    """

    ids: tuple[str, ...]
    sensor: Array
    repeat: Array
    field: Array
    value: Array
    reference: Array | None
    time: Array
    temperature: Array | None
    unit: str
    where: str
    timed: bool = False
    paired: bool = True
    notes: tuple[str, ...] = ()
    """What has to be said about the file."""

    @property
    def gain_unit(self) -> str:
        """Unit of a gain: reading over field."""
        return "1" if self.unit == "t" else f"{self.unit.upper() if self.unit == 'v' else self.unit}/T"


def read_readings(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    fields: Sequence[float] = (),
    **options: Any,
) -> Readings:
    """Read the table of a sorting bench, in any format that `read_log` reads.

    One row a reading: `sensor, field_t, reading_v, reference_v[, repeat, t_s, temperature_degc]`; or one row
    a measurement: `sensor, field_0_t, reading_0_v, reference_0_v, field_1_t, ...`. `fields` [T] stand in
    place of field columns. `columns` maps our names to the file's; `options` are those of `read_log`.
    """
    wanted = dict(columns or {})
    names = {ours: wanted.pop(ours, ours) for ours in NAMES}
    log = read_log(path, columns=wanted, **options)
    source = log.table.source
    for ours, theirs in names.items():
        if theirs not in source.names and (ours == SENSOR or theirs != ours):
            raise InputError(
                f"{log.name} has no column '{theirs}' that names the"
                f" sensor{nearest(theirs, list(source.names))}; it has {listed(source.names)}; map it with"
                f" --column {ours}=ITS_NAME."
            )
    labels = {ours: source.labels(theirs) for ours, theirs in names.items() if theirs in source.names}
    return replace(_arranged(log, labels, fields), notes=source.notes)


def readings_from(table: Any, fields: Sequence[float] = (), name: str = "The table") -> Readings:
    """Return the readings of a dict of arrays or a data frame with the columns of `read_readings`."""
    columns = {str(c): np.asarray(table[c]) for c in (table if isinstance(table, Mapping) else table.columns)}
    if SENSOR not in columns:
        raise InputError(
            f"{name} must have a column 'sensor' with the name of each sensor; it has {', '.join(columns)}."
        )
    labels = {c: [label(v) for v in columns.pop(c).tolist()] for c in NAMES if c in columns}
    return _arranged(Log.from_arrays(columns, name=name), labels, fields)


def _arranged(log: Log, labels: Mapping[str, list[str]], fields: Sequence[float]) -> Readings:
    ids = labels[SENSOR]
    if not ids:
        raise InputError(f"{log.name} holds no rows; it must hold the readings of the sensors.")
    for row, name in enumerate(ids):
        if not name:
            raise InputError(f"Row {row + 1} of {log.name} names no sensor; give every row its sensor.")
    columns = [c for c in log.columns if WIDE.fullmatch(c)]
    if any(c.startswith("reading_") for c in columns):
        return _wide(log, labels, fields, columns)
    return _long(log, labels, fields)


def _long(log: Log, labels: Mapping[str, list[str]], fields: Sequence[float]) -> Readings:
    if fields:
        raise InputError(
            f"Stated fields belong to a table with reading_0_v, reading_1_v, ... in a row; {log.name} has"
            " one reading a row, so it needs a column such as field_mt."
        )
    reading, field = _only(log, "reading"), _only(log, "field", "t")
    reference = _only(log, "reference", si_unit(reading), needed=False)
    values = log.array(field)
    sensor, ids = _indices(labels[SENSOR])
    repeat = _measurements(sensor, values, labels.get(REPEAT))
    timed = "t_s" in log.columns
    order = _order(repeat)
    return Readings(
        ids,
        sensor,
        repeat,
        values,
        log.array(reading),
        None if reference is None else log.array(reference),
        log.array("t_s") if timed else order.astype(float),
        log.array("temperature_degc") if "temperature_degc" in log.columns else None,
        si_unit(reading),
        log.name,
        timed,
    )


def _wide(
    log: Log, labels: Mapping[str, list[str]], fields: Sequence[float], columns: Sequence[str]
) -> Readings:
    levels = sorted({int(m[2]) for c in columns if (m := WIDE.fullmatch(c)) and m[1] == "reading"})
    reading = [_only(log, f"reading_{k}") for k in levels]
    unit = si_unit(reading[0])
    if len({si_unit(c) for c in reading}) > 1:
        raise InputError(f"The readings of {log.name} must have one unit; it has {', '.join(reading)}.")
    if fields and len(fields) != len(levels):
        raise InputError(
            f"{log.name} has {len(levels)} readings a row, but {len(fields)} fields are stated; state one"
            " each."
        )
    rows, sensor, ids = log.rows, *_indices(labels[SENSOR])
    known = [np.full(rows, b) for b in fields] or [log.array(_only(log, f"field_{k}", "t")) for k in levels]
    beside = [_only(log, f"reference_{k}", unit, needed=False) for k in levels]
    once = _only(log, "reference", unit, needed=False)
    reference = None
    if all(beside):
        reference = np.stack([log.array(c) for c in beside if c], axis=1).ravel()
    elif any(beside):
        raise InputError(
            f"{log.name} has {', '.join(filter(None, beside))}; give the reference for each reading, or"
            f" reference_{unit}."
        )
    elif once:
        reference = np.repeat(log.array(once), len(levels))
    timed, spread = "t_s" in log.columns, lambda values: np.repeat(values, len(levels))
    return Readings(
        ids,
        spread(sensor),
        spread(np.arange(rows)),
        np.stack(known, axis=1).ravel(),
        np.stack([log.array(c) for c in reading], axis=1).ravel(),
        reference,
        spread(log.array("t_s") if timed else np.arange(rows, dtype=float)),
        spread(log.array("temperature_degc")) if "temperature_degc" in log.columns else None,
        unit,
        log.name,
        timed,
        all(beside),
    )


def _only(log: Log, stem: str, si: str = "", *, needed: bool = True) -> Any:
    """The column of a stem, in `si` where that is stated; None where there is none and none is needed."""
    found = [c for c in log.columns if re.fullmatch(rf"{stem}_[a-z]+", c) and si_unit(c)]
    if len(found) > 1 or (found and si and si_unit(found[0]) != si):
        raise InputError(
            f"{log.name} must have one column"
            f" {stem}_{si or 'v'}{' in the unit of the readings' if si != 't' and si else ''}; it has"
            f" {', '.join(found)}."
        )
    if not found and needed:
        raise InputError(
            f"{log.name} has no column {stem}_{si or 'v'}; it has {listed(log.table.source.names)}; map it"
            f" with --column {stem}_{'mt' if si == 't' else si or 'v'}=ITS_NAME, where the ending is its"
            " unit."
        )
    return found[0] if found else None


def _indices(labels: Sequence[str]) -> tuple[Array, tuple[str, ...]]:
    """Index of each label, and the labels in the order in which they first appear."""
    known: dict[str, int] = {}
    return np.array([known.setdefault(name, len(known)) for name in labels]), tuple(known)


def _measurements(sensor: Array, field: Array, labels: Sequence[str] | None) -> Array:
    """Index of the measurement of each row: as labelled, else a new one where a field comes back."""
    if labels is not None:
        return _indices([f"{s} {name}" for s, name in zip(sensor.tolist(), labels, strict=True)])[0]
    current: dict[int, int] = {}
    seen: dict[int, list[float]] = {}
    out, count = np.empty(len(sensor), int), 0
    for row, (s, b) in enumerate(zip(sensor.tolist(), field.tolist(), strict=True)):
        before = seen.get(s)
        if before is None or (b in before and b != before[-1]):
            current[s], seen[s], count = count, [b], count + 1
        elif b != before[-1]:
            before.append(b)
        out[row] = current[s]
    return out


def _order(repeat: Array) -> Array:
    """The place of each row's measurement in the order in which measurements end."""
    last = np.zeros(repeat.max() + 1, int)
    last[repeat] = np.arange(len(repeat))
    place = np.empty(len(last), int)
    place[np.argsort(last)] = np.arange(len(last))
    return place[repeat]
