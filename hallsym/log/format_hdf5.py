"""HDF5 logs through h5py (an extra): one dataset per column at the root or in groups, or a group per run."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.table import Source, load
from hallsym.log.vectors import Vector, arranged, columns_of, unit_in
from hallsym.units import Array


def open_hdf5(path: Path, clock: str | None = None, kind: str = "HDF5", by: str = "/") -> Source:
    """Open an HDF5 file; `clock`: as `GroupedSource` reads it; `by`: what stands between parts of a name."""
    vectors: dict[str, Vector] = {}
    left_out: dict[str, str] = {}
    opened = partial(load("h5py").File, path, "r")
    with opened() as file:
        for name, node in _datasets(file, left_out).items():
            text = {b"char", b"cell"} & {node.attrs.get("MATLAB_class", b"")}
            logical = node.attrs.get("MATLAB_class", b"") == b"logical"
            fields = node.dtype.names or ("",)
            for field in fields if node.shape is not None and not text else ():
                kind_of = (node.dtype[field] if field else node.dtype).kind
                found, why = columns_of(
                    f"{name}/{field}" if field else name,
                    node.shape,
                    "b" if logical else kind_of,
                    _reader(name, field),
                    unit_in(node.attrs),
                )
                why = why or (_broken_off(node) if found else "")
                vectors |= {} if why else found
                left_out |= {name.rpartition("/")[2]: why} if why else {}
    vectors = {name.replace("/", by): vector for name, vector in vectors.items()}
    return arranged(quoted(path), kind, vectors, left_out, by, clock, opened)


def _reader(name: str, field: str) -> Callable[[Any, Any], Array]:
    """Return what reads an index of a dataset, or of a field of it."""
    return lambda file, index: np.asarray(file[name].fields(field)[index] if field else file[name][index])


def _datasets(file: Any, left_out: dict[str, str]) -> dict[str, Any]:
    """Return the datasets of a file by their path, and say which links lead to none.

    Soft links to datasets are followed; those to groups are other names for what is found anyway.
    """
    h5py = load("h5py")
    found: dict[str, Any] = {}
    seen: set[Any] = set()  # groups: a hard link may lead back to one that holds it

    def walk(group: Any, path: str) -> None:
        seen.add(group)
        for key in group:
            link, node = group.get(key, getlink=True), group.get(key)
            if key.startswith("#"):
                continue
            if isinstance(link, h5py.ExternalLink) or node is None:
                where = "another file" if isinstance(link, h5py.ExternalLink) else "nothing"
                left_out[key] = f"it is a link to {where}"
            elif isinstance(node, h5py.Group):
                if isinstance(link, h5py.HardLink) and node not in seen:
                    walk(node, f"{path}{key}/")
            elif isinstance(node, h5py.Dataset):
                found[f"{path}{key}"] = node

    walk(file, "")
    return found


def _broken_off(node: Any) -> str:
    """Say how many blocks of a dataset were not written; "" where all were."""
    if node.chunks:
        need = math.prod(-(-n // c) for n, c in zip(node.shape, node.chunks, strict=True))
        have = node.id.get_num_chunks()
    else:
        need, have = int(node.size > 0), int(node.id.get_storage_size() > 0)
    if have < need and not node.external:
        return f"of its {need} blocks only {have} were written, so the recording broke off"
    return ""
