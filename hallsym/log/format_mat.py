"""Arrays of MATLAB (v5 through scipy, v7.3 through h5py) and NumPy: at the top or in (nested) structs."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.format_hdf5 import open_hdf5
from hallsym.log.table import Source
from hallsym.log.vectors import Vector, arranged, columns_of
from hallsym.units import Array


def open_mat(path: Path, clock: str | None = None) -> Source:
    """Open a MATLAB file of either kind; `clock`: as `GroupedSource` reads it."""
    from scipy.io import loadmat, whosmat

    if _is_v73(path):
        return open_hdf5(path, clock, "MATLAB", ".")
    _check_compressed(path)
    logical = {name for name, _, kind in whosmat(path) if kind == "logical"}
    content = loadmat(path, simplify_cells=True)
    arrays = {k: np.asarray(v) for k, v in _flatten({k: v for k, v in content.items() if k[:2] != "__"}, "")}
    return in_memory(path, "MATLAB", arrays, clock, logical)


def open_npz(path: Path, clock: str | None = None) -> Source:
    """Open arrays that numpy saved (.npz); `clock`: as `GroupedSource` reads it."""
    with np.load(path, allow_pickle=False) as content:
        return in_memory(path, "NumPy", {name: content[name] for name in content.files}, clock)


def in_memory(
    path: Path, kind: str, arrays: Mapping[str, Array], clock: str | None, logical: Collection[str] = ()
) -> Source:
    """Return the table of arrays by name, `logical` of which hold booleans."""
    vectors: dict[str, Vector] = {}
    left_out: dict[str, str] = {}
    for name, array in arrays.items():
        for field in array.dtype.names or ("",):
            part = array[field] if field else array
            found, why = columns_of(
                f"{name}.{field}" if field else name,
                part.shape,
                "b" if name in logical else part.dtype.kind,
                lambda _, index, part=part: part[index],
            )
            vectors |= found
            left_out |= {name.rpartition(".")[2]: why} if why else {}
    return arranged(quoted(path), kind, vectors, left_out, ".", clock)


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


def _flatten(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield what nested structs hold by path; the structs of an array are numbered from 1, as in MATLAB."""
    if isinstance(value, list | np.ndarray) and len(value) and isinstance(value[0], dict):
        value = {f"{path}{k}": item for k, item in enumerate(value, start=1)}
        path = path.rpartition(".")[0]
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flatten(item, f"{path}.{key}" if path else key)
    else:
        yield path, value
