"""Damage that files suffer: bytes, text, JSON data and columns, each kind a function of a seeded generator.

A mutation takes good content and a generator and returns the damaged content.
"""

from __future__ import annotations

import copy
import io
import json
import math
import random
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Random = random.Random

# -- bytes -----------------------------------------------------------------------------------------------


def flip_bit(data: bytes, rng: Random) -> bytes:
    k = rng.randrange(len(data))
    return data[:k] + bytes([data[k] ^ (1 << rng.randrange(8))]) + data[k + 1 :]


def flip_bytes(data: bytes, rng: Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 2, 8, 64))):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def truncate(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data))]


def cut_end(data: bytes, rng: Random) -> bytes:
    return data[: -rng.randint(1, min(40, len(data)))]


def zero_block(data: bytes, rng: Random) -> bytes:
    k, n = rng.randrange(len(data)), rng.choice((1, 16, 512, 4096))
    return data[:k] + bytes(min(n, len(data) - k)) + data[k + n :]


def delete_block(data: bytes, rng: Random) -> bytes:
    k = rng.randrange(len(data))
    return data[:k] + data[k + rng.choice((1, 7, 100, 3000)) :]


def repeat_block(data: bytes, rng: Random) -> bytes:
    k, n = rng.randrange(len(data)), rng.choice((1, 7, 100, 3000))
    return data[: k + n] + data[k:]


def garbage_block(data: bytes, rng: Random) -> bytes:
    k, n = rng.randrange(len(data)), rng.choice((4, 64, 1024))
    return data[:k] + rng.randbytes(n) + data[k + n :]


def huge_number(data: bytes, rng: Random) -> bytes:
    """A length or a count that became absurd: eight bytes of 1 bits, or of the sign."""
    k = rng.randrange(max(1, len(data) - 8))
    number = rng.choice((b"\xff" * 8, b"\xff" * 7 + b"\x7f", b"\xff\xff\xff\x7f", b"\0\0\0\x80"))
    return data[:k] + number + data[k + len(number) :]


BYTES: tuple[Callable[[bytes, Random], bytes], ...] = (
    flip_bit, flip_bytes, truncate, cut_end, zero_block, delete_block, repeat_block, garbage_block,
    huge_number,
)  # fmt: skip

# -- text ------------------------------------------------------------------------------------------------

TOKENS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e999", "1e-320", "-1", "0", "x", "", "1" * 400, "9" * 5000,
    "true", "1,5", "\x00", "\x1b[31m", "\x9b2J", "\u202e", "\ufeff", "'", '"', "[", "{", "[[", "1e-12",
    "9007199254740993", "\u0663", "0x10", "_",
)  # fmt: skip


def text_token(data: bytes, rng: Random) -> bytes:
    """A cell, value or word becomes another one."""
    text = data.decode("utf-8", "replace")
    ends = [k for k, c in enumerate(text) if c in ",\n=[]{} :"]
    if len(ends) < 2:
        return data
    k = rng.randrange(len(ends) - 1)
    return (text[: ends[k] + 1] + rng.choice(TOKENS) + text[ends[k + 1] :]).encode("utf-8", "replace")


def text_line(data: bytes, rng: Random) -> bytes:
    """A line is lost, doubled, moved, or torn."""
    lines = data.split(b"\n")
    k, how = rng.randrange(len(lines)), rng.randrange(4)
    if how == 0:
        del lines[k]
    elif how == 1:
        lines.insert(k, lines[k])
    elif how == 2:
        lines.insert(rng.randrange(len(lines)), lines.pop(k))
    else:
        lines[k] = lines[k][: rng.randrange(len(lines[k]) + 1)]
    return b"\n".join(lines)


def text_delimiter(data: bytes, rng: Random) -> bytes:
    """A delimiter is lost, doubled or another one, here or everywhere."""
    marks = [k for k, c in enumerate(data) if c in b",;=[]{}:\n"]
    if not marks:
        return data
    k = rng.choice(marks)
    new = rng.choice((b"", data[k : k + 1] * 2, b";", b"\t", b"\r", b"\n"))
    if rng.random() < 0.1:
        return data.replace(data[k : k + 1], new)
    return data[:k] + new + data[k + 1 :]


def text_coding(data: bytes, rng: Random) -> bytes:
    """Another coding, or bytes that are no text."""
    text = data.decode("utf-8", "replace")
    how = rng.randrange(5)
    if how == 0:
        return text.encode("utf-16")
    if how == 1:
        return data.replace(b"\n", b"\r\n")
    if how == 2:
        return b"\xef\xbb\xbf" + data
    k = rng.randrange(len(data))
    return data[:k] + (b"\xff\xfe" if how == 3 else b"\x00" * 50) + data[k:]


TEXT = (text_token, text_line, text_delimiter, text_coding, flip_bit, truncate, cut_end, delete_block)

# -- TOML ------------------------------------------------------------------------------------------------

VALUES = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "1e-320", "1e-12", '"text"', '""', "true", "[]", "[[1]]", "{}",
    "{a = 1}", "1" * 400, "1979-05-27", "[1, 'a']", "[nan]", "[" * 400 + "]" * 400, "9223372036854775808",
)  # fmt: skip


def toml_value(data: bytes, rng: Random) -> bytes:
    """The value of a key is of another type or size."""
    lines = data.decode().split("\n")
    keys = [k for k, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    k = rng.choice(keys)
    lines[k] = f"{lines[k].partition('=')[0]}= {rng.choice(VALUES)}"
    return "\n".join(lines).encode()


def toml_key(data: bytes, rng: Random) -> bytes:
    """A key or a table is misspelt, or given twice."""
    lines = data.decode().split("\n")
    k = rng.choice([k for k, line in enumerate(lines) if "=" in line or line.startswith("[")])
    name = lines[k].partition("=")[0]
    at = rng.randrange(max(1, len(name.rstrip())))
    if rng.random() < 0.7:
        lines[k] = lines[k][:at] + rng.choice("qx_7.") + lines[k][at + rng.randrange(2) :]
    else:
        lines.insert(k, lines[k])
    return "\n".join(lines).encode()


TOML = (toml_value, toml_value, toml_key, *TEXT)

# -- JSON ------------------------------------------------------------------------------------------------

JSON_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1.5, 1e308, -1e308, math.nan, math.inf, 10**400, 2**63, "text", "",
    [], [[]], {}, {"a": 1}, [1, "a"], "\x1b[31m\n", "\x9b2J\u202e\x7f", "x" * 10000,
)  # fmt: skip


def _places(data: Any, path: tuple = ()) -> list[tuple]:
    """Every place of nested data, at most some of each list."""
    found = [path] if path else []
    if isinstance(data, dict):
        for key, value in data.items():
            found += _places(value, (*path, key))
    elif isinstance(data, list):
        for k, value in enumerate(data[:3]):
            found += _places(value, (*path, k))
    return found


def _holder(data: Any, path: tuple) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data


def json_value(data: bytes, rng: Random) -> bytes:
    """One value is of another type or size."""
    raw = json.loads(data)
    path = rng.choice(_places(raw))
    _holder(raw, path)[path[-1]] = copy.deepcopy(rng.choice(JSON_VALUES))
    return json.dumps(raw).encode()


def json_key(data: bytes, rng: Random) -> bytes:
    """A key is lost, misspelt, or one too many; an entry of a list is lost or doubled."""
    raw = json.loads(data)
    path = rng.choice(_places(raw))
    holder, key = _holder(raw, path), path[-1]
    value = holder.pop(key)
    if isinstance(holder, list):
        if rng.random() < 0.5:
            holder[key:key] = [value, value]
    elif rng.random() < 0.6:
        at = rng.randrange(len(key)) if key else 0
        holder[key[:at] + rng.choice("qx_7") + key[at + rng.randrange(2) :]] = value
    return json.dumps(raw).encode()


def json_depth(data: bytes, rng: Random) -> bytes:
    """A value is nested deeply."""
    raw = json.loads(data)
    path = rng.choice(_places(raw))
    _holder(raw, path)[path[-1]] = "HERE"
    deep = rng.choice((50, 500, 20000))
    left, right = rng.choice((("[", "]"), ('{"a":', "}")))
    return json.dumps(raw).replace('"HERE"', left * deep + "1" + right * deep, 1).encode()


JSON = (json_value, json_value, json_key, json_key, json_depth, *TEXT)

# -- columns ---------------------------------------------------------------------------------------------

Columns = Mapping[str, np.ndarray]


def columns_values(columns: Columns, rng: Random) -> dict[str, np.ndarray]:
    """Values of a column are NaN, infinite, huge, negative, or all of them."""
    out = {name: values.copy() for name, values in columns.items()}
    name = rng.choice(list(out))
    values = out[name].astype(float)
    value = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1e308, 1e100, 5e-324, -1.0, 2.0**53 + 2))
    where = slice(None) if rng.random() < 0.3 else rng.randrange(len(values))
    values[where] = value
    out[name] = values
    return out


def columns_type(columns: Columns, rng: Random) -> dict[str, np.ndarray]:
    """A column is of another type."""
    out = dict(columns)
    name = rng.choice(list(out))
    kind = rng.choice(("bool", "u8", "f4", "i1", "S4", "c16", "i8"))
    with np.errstate(all="ignore"):
        out[name] = out[name].astype(kind)
    if kind == "u8" and rng.random() < 0.5:
        out[name] = out[name] + np.uint64(2**63)
    return out


def columns_names(columns: Columns, rng: Random) -> dict[str, np.ndarray]:
    """A column is missing, renamed, or has a strange name."""
    name = rng.choice(list(columns))
    new = rng.choice(
        ("", name.upper(), f"{name}x", f"{name[:-1]}mm", "a\nb_m", "\x1b[2J_m", "é_m", "x" * 400 + "_m")
    )
    if rng.random() < 0.3:
        return {k: v for k, v in columns.items() if k != name}
    return {(new if k == name else k): v for k, v in columns.items()}


def columns_length(columns: Columns, rng: Random) -> dict[str, np.ndarray]:
    """A column, or all, are shorter; or of two dimensions."""
    out = dict(columns)
    name, n = rng.choice(list(out)), len(next(iter(out.values())))
    how = rng.randrange(3)
    if how == 0:
        out[name] = out[name][: rng.randrange(n)]
    elif how == 1:
        few = rng.choice((0, 1, 2, 9))
        return {k: v[:few] for k, v in out.items()}
    else:
        out[name] = np.stack([out[name], out[name]])
    return out


COLUMNS = (columns_values, columns_values, columns_type, columns_names, columns_length)


def with_columns(
    write: Callable[[Columns, io.BytesIO], None], columns: Columns, rng: Random
) -> tuple[str, bytes]:
    """Return the name of a mutation of columns and the file that holds what came out of it."""
    mutation = rng.choice(COLUMNS)
    stream = io.BytesIO()
    write(mutation(columns, rng), stream)
    return mutation.__name__, stream.getvalue()
