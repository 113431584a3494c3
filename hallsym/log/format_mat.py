"""MATLAB `.mat` logs: v5 through scipy, v7.3 through h5py. Vectors at the top or in (nested) structs."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.log.format_hdf5 import Hdf5Source, name_vectors
from hallsym.log.table import Arrays
from hallsym.units import Array


def open_mat(path: Path) -> Arrays | Hdf5Source:
    """Open a MATLAB file of either kind."""
    from scipy.io import loadmat, whosmat

    if _is_v73(path):
        return Hdf5Source(path)
    _check_compressed(path)
    logical = {name for name, _, kind in whosmat(path) if kind == "logical"}
    content = loadmat(path, simplify_cells=True)
    vectors = dict(_flatten({key: value for key, value in content.items() if not key.startswith("__")}, ""))
    names, left_out, aliases = name_vectors({key: len(values) for key, values in vectors.items()}, ".")
    source = Arrays({name: vectors[key] for name, key in names.items()})
    source.left_out, source.aliases = left_out, aliases
    for name, values in list(source.columns.items()):
        if values.dtype.kind == "b" or name in logical:
            source.left_out[name] = "it holds booleans, not numbers"
            del source.columns[name]
    source.names = tuple(source.columns)
    return source


def _is_v73(path: Path) -> bool:
    """A v7.3 file has MATLAB's text header, then HDF5's signature at byte 512; or it is plain HDF5."""
    signature = b"\x89HDF\r\n\x1a\n"
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(signature) or head[512:520] == signature


_COMPRESSED = 15
_HEADER_BYTES = 128
_AT_ONCE = 1 << 20


def _check_compressed(path: Path) -> None:
    """Raise `zlib.error` where the checksum of a compressed variable is wrong; scipy does not look."""
    with open(path, "rb") as stream:
        order = stream.read(_HEADER_BYTES)[-2:]
        layout = "<II" if order == b"IM" else ">II"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(layout, tag)
            if kind != _COMPRESSED:
                stream.seek(size, os.SEEK_CUR)
                continue
            inflate = zlib.decompressobj()
            while size > 0 and (part := stream.read(min(size, _AT_ONCE))):
                size -= len(part)
                while part:
                    inflate.decompress(part, _AT_ONCE)
                    part = inflate.unconsumed_tail
            if not inflate.eof:
                raise zlib.error("a compressed variable is cut short")


def _flatten(value: Any, path: str) -> list[tuple[str, Array]]:
    if isinstance(value, dict):
        return [
            pair for key, item in value.items() for pair in _flatten(item, f"{path}.{key}" if path else key)
        ]
    array = np.asarray(value)
    if array.dtype.kind in "fiub" and array.ndim <= 1:
        return [(path, np.atleast_1d(array))]
    return []
