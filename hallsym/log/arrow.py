"""Arrow's columns as arrays, and tables of other libraries that speak Arrow."""

from __future__ import annotations

from typing import Any

import numpy as np

from hallsym.log.extras import load
from hallsym.units import Array

_FLOATS = {"double": "float64", "float": "float32", "halffloat": "float16"}


def is_numeric(kind: Any) -> bool:
    """Say whether an Arrow type is one of numbers; booleans are none."""
    types = load("pyarrow").types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def array_of(column: Any) -> Array:
    """Return a column of numbers, an Arrow array or several chunks of one, of shape (rows,); missing is nan.

    Its buffers are taken as they are: Arrow's own conversion imports pandas wherever that is installed.
    """
    if hasattr(column, "chunks"):
        parts = [array_of(chunk) for chunk in column.chunks]
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.empty(0)])
    arrow = load("pyarrow")
    if arrow.types.is_decimal(column.type) or column.null_count:
        column = column.cast(arrow.float64(), safe=False)
    if column.null_count:
        column = load("pyarrow.compute").fill_null(column, float("nan"))
    kind = np.dtype(_FLOATS.get(str(column.type), str(column.type)))
    if not len(column):
        return np.empty(0, kind)
    data = np.frombuffer(column.buffers()[1], kind)
    return data[column.offset : column.offset + len(column)]
