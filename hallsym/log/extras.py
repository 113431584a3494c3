"""Libraries that are extras: loaded on first use, and asked for by name where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from hallsym.errors import InputError

_EXTRAS = {"pyarrow": ("parquet", "Parquet"), "h5py": ("hdf5", "HDF5 (and MATLAB v7.3)")}


def load(module: str) -> Any:
    """Import an extra; where it is not installed, say what to install."""
    extra, kind = _EXTRAS[module.partition(".")[0]]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"{kind} files need {module.partition('.')[0]}, which is not installed;"
            f" run: pip install 'hallsym[{extra}]'."
        ) from error


def available(module: str) -> bool:
    """Say whether an extra can be imported."""
    try:
        load(module)
    except InputError:
        return False
    return True
