"""Tables in memory as logs: data frames of any library that speaks Arrow, arrays by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.arrow import (
    TIME,
    Moments,
    array_of,
    first_tick,
    is_numeric,
    is_time,
    only_time,
    said_of_times,
)
from hallsym.log.extras import load
from hallsym.log.table import Arrays
from hallsym.log.text.units import split_header
from hallsym.units import Array


def is_table(data: Any) -> bool:
    """Say whether something is a table in memory and not the name of a file."""
    return isinstance(data, Mapping) or hasattr(data, "__arrow_c_stream__")


def source_of(data: Any, where: str) -> Arrays:
    """Return the columns of numbers of a table: a dict of arrays, or what has `__arrow_c_stream__`.

    A name may state its unit as in a file: `x_ref_um`, `x_ref [um]`. Columns of other things are left out.
    """
    columns, left_out, times = (_of_mapping if isinstance(data, Mapping) else _of_arrow)(data, where)
    parts = {name: split_header(name) for name in columns}
    names = list(columns)
    at = only_time(names, [names.index(name) for name in times])
    if at is not None and names[at] != f"{TIME}_s":
        parts[names[at]] = (TIME, "s")
    stems = Counter(stem for stem, _ in parts.values())
    short = {name: stem if stems[stem] == 1 else name for name, (stem, _) in parts.items()}
    source = Arrays({short[name]: values for name, values in columns.items()})
    source.units = {short[name]: unit for name, (_, unit) in parts.items() if unit}
    source.aliases = {name: short[name] for name in columns if short[name] != name}
    source.left_out = left_out
    source.notes = tuple(said_of_times(name, where, "times") for name in times)
    return source


Columns = tuple[dict[str, Array], dict[str, str], list[str]]
"""Columns, why others are left out, and which of the columns hold times."""


def _of_mapping(data: Mapping[Any, Any], where: str) -> Columns:
    columns: dict[str, Array] = {}
    left_out: dict[str, str] = {}
    times: list[str] = []
    for name, given in data.items():
        values = np.asarray(given)
        if values.dtype.kind in "mM" and values.ndim == 1:
            values = _seconds(load("pyarrow").array(values.astype(f"{values.dtype.kind}8[ns]")))
            times.append(str(name))
        if values.dtype.kind not in "fiu":
            left_out[str(name)] = "it holds no numbers"
            continue
        first = next(iter(columns.values()), values)
        if values.ndim != 1 or len(values) != len(first):
            raise InputError(
                f"Column {name} of {where} must be a vector as long as the others; it is {values.shape}."
            )
        columns[str(name)] = values
    return columns, left_out, times


def _seconds(column: Any) -> Array:
    return Moments(column.type, first_tick(column))(column)


def _of_arrow(data: Any, where: str) -> Columns:
    arrow = load("pyarrow")
    try:
        table = arrow.RecordBatchReader.from_stream(data).read_all()
    except (arrow.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"{where} must be a table of columns; it is none ({error}).") from error
    times = [field.name for field in table.schema if is_time(field.type)]
    numeric = {field.name: is_numeric(field.type) or is_time(field.type) for field in table.schema}
    if len(numeric) < len(table.schema):
        raise InputError(f"Columns of {where} must have different names; one is there twice.")
    columns = {
        name: (_seconds if name in times else array_of)(table.column(name))
        for name, holds in numeric.items()
        if holds
    }
    return columns, {name: "it holds no numbers" for name, holds in numeric.items() if not holds}, times
