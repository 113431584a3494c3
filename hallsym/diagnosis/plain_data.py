"""Records as plain JSON data, and back."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
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


def typed(kind: Any, value: Any) -> Any:
    """Return plain JSON data as the annotated type `kind`: a record, a tuple, a dictionary, or a value.

    A number that `plain` wrote as None is nan again.
    """
    origin, args = get_origin(kind), get_args(kind)
    if value is None:
        if origin is tuple and ... not in args:
            return tuple(typed(arg, None) for arg in args)
        return math.nan if kind is float else None
    if origin in (Union, UnionType):
        return typed(args[0], value)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{f.name: typed(hints[f.name], value[f.name]) for f in fields(kind) if f.name in value})
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise TypeError(f"{value!r} is no list")
        return tuple(typed(args[0], v) for v in value)
    if origin is dict:
        return {k: typed(args[1], v) for k, v in value.items()}
    return _value(kind, value)


def _value(kind: Any, value: Any) -> Any:
    """Return a plain value that is of the type `kind`; raises `TypeError` for another one."""
    wanted: Any = {float: (int, float), int: int, str: str, bool: bool}.get(kind)
    if wanted and (not isinstance(value, wanted) or (isinstance(value, bool) and kind is not bool)):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value
