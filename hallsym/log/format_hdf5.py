"""HDF5 logs through h5py (an extra): one dataset per column at the root or in groups, or a group per run."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.pace import pace_in
from hallsym.log.table import Source, load
from hallsym.log.vectors import Stored, arranged, unit_in, unpacked_by, words_of

_KINDS = {b"char": np.dtype(object), b"cell": np.dtype(object), b"logical": np.dtype(bool)}
"""Types that MATLAB stores as numbers."""


def open_hdf5(path: Path, clock: str | None = None, kind: str = "HDF5", by: str = "/") -> Source:
    """Open an HDF5 file; `clock`: as `GroupedSource` reads it; `by`: what stands between parts of a name."""
    left_out: dict[str, str] = {}
    opened = partial(load("h5py").File, path, "r")
    with opened() as file:
        arrays = {
            name: Stored(
                node.shape, _KINDS.get(node.attrs.get("MATLAB_class", b""), node.dtype),
                partial(_found, node.name), unit_in(node.attrs), pace_in(_stated(node)), _fault(node),
                tuple(words for value in node.attrs.values() if (words := words_of(value))),
                unpacked_by(node.attrs),
            )
            for name, node in _datasets(file, left_out, by).items()
            if node.shape is not None
        }  # fmt: skip
    return arranged(quoted(path), kind, arrays, left_out, by, clock, opened)


def _stated(node: Any) -> dict[str, Any]:
    """Return the attributes of a dataset and of the groups that hold it."""
    above = _stated(node.parent) if node.name != "/" else {}
    return {**above, **node.attrs}


def _found(name: str, file: Any, field: str) -> Any:
    return file[name].fields(field) if field else file[name]


def _datasets(file: Any, left_out: dict[str, str], by: str) -> dict[str, Any]:
    """Return the datasets of a file by their path, and say which links lead to none.

    Soft links to datasets are followed; those to groups are other names for what is found anyway.
    """
    h5py = load("h5py")
    found: dict[str, Any] = {}

    def visit(name: str, link: Any) -> None:
        if "/#" in f"/{name}":
            return
        away = isinstance(link, h5py.ExternalLink)
        node = None if away else file.get(name)
        if node is None:
            left_out[name.rpartition("/")[2]] = f"it is a link to {'another file' if away else 'nothing'}"
        elif isinstance(node, h5py.Dataset):
            found[name.replace("/", by)] = node

    file.visititems_links(visit)
    return found


def _fault(node: Any) -> str:
    """Say how many blocks of a dataset were not written; "" where all were."""
    if node.chunks:
        need = math.prod(-(-n // c) for n, c in zip(node.shape, node.chunks, strict=True))
        have = node.id.get_num_chunks()
    else:
        need, have = int(node.size > 0), int(node.id.get_storage_size() > 0)
    if have < need and not node.external:
        return f"of its {need} blocks only {have} were written, so the recording broke off"
    return ""
