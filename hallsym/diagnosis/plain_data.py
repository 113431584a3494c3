"""Records as plain JSON data, and back: numbers that are not finite are null there."""

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints


def plain(value: Any) -> Any:
    """Return records' data as plain JSON data; what is not finite becomes None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "item"):
        return plain(value.item())
    return value


def filled(kind: Any, value: Any) -> Any:
    """Return plain JSON data with nan where `plain` wrote None for a number that the type `kind` has there.

    What is not of that type stays as it is.
    """
    origin, args = get_origin(kind), get_args(kind)
    if value is None:
        return math.nan if kind is float else None
    if origin in (Union, UnionType):
        return filled(args[0], value)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
        hints = get_type_hints(kind)
        return {k: filled(hints[k], v) if k in hints else v for k, v in value.items()}
    if origin is tuple and isinstance(value, list | tuple):
        return [filled(args[0], v) for v in value]
    if origin is dict and isinstance(value, Mapping):
        return {k: filled(args[1], v) for k, v in value.items()}
    return value.item() if hasattr(value, "item") else value
