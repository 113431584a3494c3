"""Records of a sorting bench: readings of sensors in known fields, with a reference sensor."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.errors import InputError, few, nearest
from hallsym.log import Foreign, Log, read_log
from hallsym.units import Array, si_unit

SENSOR = "sensor"
"""Column of the names of the sensors."""
WIDE = re.compile(r"(reading|field|reference)_(\d+)_([a-z_]+)")


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings (rows,), in the order of recording; a missing number is nan.

    `sensor`, `measurement`: index of the sensor in `ids`, and of its measurement (an insertion into the
    socket) in the whole record. `field` [T], `value` and `reference` (the reference sensor's reading in the
    same field) in `unit`, `time` [s], or the order of the rows.
    """

    ids: tuple[str, ...]
    sensor: Array
    measurement: Array
    field: Array
    value: Array
    reference: Array | None
    time: Array
    unit: str
    where: str
    notes: tuple[str, ...] = ()
    """Notes on the file."""

    @property
    def gain_unit(self) -> str:
        """Unit of a gain: reading over field."""
        return "1" if self.unit == "t" else f"{self.unit.upper() if self.unit == 'v' else self.unit}/T"


def read_readings(
    path: Any,
    *,
    columns: Mapping[str, str | Foreign] | None = None,
    fields: Sequence[float] = (),
    **options: Any,
) -> Readings:
    """Read the table of a sorting bench: whatever `read_log` reads, a dict of arrays or a data frame too.

    One row a reading: `sensor, field_t, reading_v[, reference_v, t_s]`; or one row a measurement: `sensor,
    field_0_t, reading_0_v, reference_0_v, field_1_t, ...`. `fields` [T] stand in place of field columns.
    `columns` maps our names to the file's; `options` are those of `read_log`.
    """
    wanted = dict(columns or {})
    named = wanted.pop(SENSOR, SENSOR)
    name = named if isinstance(named, str) else named.name
    log = read_log(path, columns=wanted, **options)
    source = log.table.source
    if name not in source.names:
        raise InputError(
            f"{log.name} has no column '{name}' that names the sensor{nearest(name, list(source.names))}; it"
            f" has {few(source.names, 20)}; map it with --column {SENSOR}=ITS_NAME."
        )
    return replace(_arranged(log, source.labels(name), fields), notes=source.notes)


def _arranged(log: Log, labels: Sequence[str], fields: Sequence[float]) -> Readings:
    if not labels:
        raise InputError(f"{log.name} holds no rows; it must hold the readings of the sensors.")
    for row, name in enumerate(labels):
        if not name:
            raise InputError(f"Row {row + 1} of {log.name} names no sensor; give every row its sensor.")
    known: dict[str, int] = {}
    sensor = np.array([known.setdefault(name, len(known)) for name in labels])
    wide = [m for c in log.columns if (m := WIDE.fullmatch(c)) and m[1] == "reading"]
    levels = sorted({int(m[2]) for m in wide})
    if fields and len(fields) != len(levels):
        raise InputError(
            f"{log.name} has {len(levels)} readings a row (reading_0_v, reading_1_v, ...), but {len(fields)}"
            " fields are stated; state one each."
        )
    stems = [f"_{k}" for k in levels] or [""]
    reading = [_only(log, f"reading{stem}") for stem in stems]
    unit = si_unit(reading[0])
    if len({si_unit(c) for c in reading}) > 1:
        raise InputError(f"The readings of {log.name} must have one unit; it has {', '.join(reading)}.")
    field = [np.full(log.rows, b) for b in fields] or [
        log.array(_only(log, f"field{stem}", "t")) for stem in stems
    ]
    beside = [_only(log, f"reference{stem}", unit, needed=False) for stem in stems]
    if any(beside) and not all(beside):
        raise InputError(
            f"{log.name} has {', '.join(filter(None, beside))}; give the reference for each reading."
        )
    time = log.array("t_s") if "t_s" in log.columns else np.arange(log.rows, dtype=float)
    if not np.isfinite(time).all():
        row = int(np.flatnonzero(~np.isfinite(time))[0]) + 1
        raise InputError(
            f"Column t_s of {log.name} must hold the time of every reading; row {row} has none. Without the"
            " column the order of the rows stands for it."
        )

    def flat(columns: Sequence[Array]) -> Array:
        return np.stack(columns, axis=1).ravel()

    return Readings(
        tuple(known),
        np.repeat(sensor, len(stems)),
        np.repeat(np.arange(log.rows), len(stems)) if levels else _measurements(sensor, field[0]),
        flat(field),
        flat([log.array(c) for c in reading]),
        flat([log.array(c) for c in beside]) if all(beside) else None,
        np.repeat(time, len(stems)),
        unit,
        log.name,
    )


def _only(log: Log, stem: str, si: str = "", *, needed: bool = True) -> Any:
    """The column of a stem, in `si` where that is stated; None where there is none and none is needed."""
    found = [c for c in log.columns if re.fullmatch(rf"{stem}_[a-z]+", c) and si_unit(c)]
    wanted = f"{stem}_{si or 'v'}"
    if len(found) > 1 or (found and si and si_unit(found[0]) != si):
        raise InputError(f"{log.name} must have one column such as {wanted}; it has {', '.join(found)}.")
    if not found and needed:
        raise InputError(
            f"{log.name} has no column {wanted}; it has {few(log.table.source.names, 20)}; map it with"
            f" --column {wanted}=ITS_NAME, where the ending is its unit."
        )
    return found[0] if found else None


def _measurements(sensor: Array, field: Array) -> Array:
    """Index of the measurement of each row; a field that comes back begins a new one of that sensor."""
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
