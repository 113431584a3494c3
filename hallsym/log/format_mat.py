"""Arrays of MATLAB and NetCDF (old ones through scipy, HDF5 through h5py), in structs too, and of NumPy."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.format_hdf5 import open_hdf5
from hallsym.log.table import Source
from hallsym.log.vectors import Stored, arranged, unit_in, unpacked_by
from hallsym.units import Array


def open_mat(path: Path, clock: str | None = None) -> Source:
    """Open a MATLAB file of either kind; `clock`: as `GroupedSource` reads it."""
    from scipy.io import loadmat, whosmat

    if _is_hdf5(path):
        return open_hdf5(path, clock, "MATLAB", ".")
    _check_compressed(path)
    logical = {name for name, _, kind in whosmat(path) if kind == "logical"}
    content = loadmat(path, simplify_cells=True)
    arrays = {k: np.asarray(v) for k, v in _flatten({k: v for k, v in content.items() if k[:2] != "__"}, "")}
    return _table(path, "MATLAB", arrays, clock, logical)


def open_netcdf(path: Path, clock: str | None = None) -> Source:
    """Open a NetCDF file of either kind; `clock`: as `GroupedSource` reads it."""
    from scipy.io import netcdf_file

    if _is_hdf5(path):
        return open_hdf5(path, clock, "NetCDF")
    with netcdf_file(path, mmap=False) as file:
        arrays = {
            name: Stored(
                one.shape, one.data.dtype, partial(lambda values, *_: values, one.data),
                unit_in(one._attributes), unpacked=unpacked_by(one._attributes),
            )
            for name, one in file.variables.items()
        }  # fmt: skip
    return arranged(quoted(path), "NetCDF", arrays, {}, ".", clock)


def _is_hdf5(path: Path) -> bool:
    """Say whether a file is one of HDF5; that of MATLAB has a header of 512 bytes before it."""
    with open(path, "rb") as stream:
        head = stream.read(520)
    return b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:])


def open_numpy(path: Path, clock: str | None = None) -> Source:
    """Open arrays that numpy saved (.npz, or one .npy); `clock`: as `GroupedSource` reads it."""
    content = np.load(path, allow_pickle=False)
    if isinstance(content, np.ndarray):
        return _table(path, "NumPy", {"column": content}, clock)
    with content:
        return _table(path, "NumPy", dict(content.items()), clock)


def _table(
    path: Path, kind: str, arrays: Mapping[str, Array], clock: str | None, logical: Collection[str] = ()
) -> Source:
    """Return the table of arrays by name, `logical` of which hold booleans."""

    def stored(name: str, array: Array) -> Stored:
        kind = np.dtype(bool) if name in logical else array.dtype
        return Stored(array.shape, kind, lambda _, field: array[field] if field else array)

    return arranged(quoted(path), kind, {n: stored(n, a) for n, a in arrays.items()}, {}, ".", clock)


_COMPRESSED = 15
_HEADER_BYTES = 128


def _check_compressed(path: Path) -> None:
    """Raise `zlib.error` where the checksum of a compressed variable is wrong; scipy does not look."""
    with open(path, "rb") as stream:
        layout = "<II" if stream.read(_HEADER_BYTES)[-2:] == b"IM" else ">II"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(layout, tag)
            if kind == _COMPRESSED:
                zlib.decompress(stream.read(size))
            else:
                stream.seek(size, os.SEEK_CUR)


def _flatten(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield what nested structs hold by path; the structs of an array are numbered from 1, as in MATLAB."""
    if isinstance(value, list | np.ndarray) and len(value) and isinstance(value[0], dict):
        path, _, name = path.rpartition(".")
        value = {f"{name}{k}": item for k, item in enumerate(value, start=1)}
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flatten(item, f"{path}.{key}" if path else key)
    else:
        yield path, value
