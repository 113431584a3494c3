"""Libraries that are loaded on first use; extras are asked for by name where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from hallsym.errors import InputError

_EXTRAS = {
    "h5py": ("hdf5", "HDF5 (and MATLAB v7.3)", "h5py"),
    "python_calamine": ("xlsx", "Workbook", "python-calamine"),
    "nptdms": ("tdms", "TDMS", "npTDMS"),
    "asammdf": ("mdf", "MDF", "asammdf"),
    "mcap": ("mcap", "MCAP", "mcap"),
    "mcap_ros2": ("mcap", "MCAP", "mcap-ros2-support"),
}
"""Module -> the extra it comes with, the files it reads, the name of its package."""


def load(module: str) -> Any:
    """Import a library; where an extra is not installed, say what to install."""
    name = module.partition(".")[0]
    if name not in _EXTRAS:
        return importlib.import_module(module)
    extra, kind, package = _EXTRAS[name]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"{kind} files need {package}, which is not installed; run: pip install 'hallsym[{extra}]'."
        ) from error
