"""HDF5 logs through h5py (an extra): one dataset per column at the root or in a group, or a group per run."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN
from hallsym.log.table import IN_MEMORY_ROWS, Source, load
from hallsym.units import Array

Lengths = dict[str, int]


class Hdf5Source(Source):
    """Vectors of one HDF5 file; a row (1, n) or column (n, 1) matrix, as MATLAB stores it, is a vector.

    `parts` holds one entry per run group, `(run id or None, {column: dataset})`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._opened() as file:
            lengths, unusable = _vectors(file)
        self._groups, left_out, self.aliases = _arrange(lengths)
        self.left_out = {**left_out, **{name.rpartition("/")[2]: why for name, why in unusable.items()}}
        self.rows = sum(lengths[next(iter(columns.values()))] for _, columns in self._groups)
        found = list(self._groups[0][1]) if self._groups else []
        self.names = (RUN, *found) if self._groups and self._groups[0][0] is not None else tuple(found)
        self.small = self.rows <= IN_MEMORY_ROWS

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most `size` rows."""
        with self._opened() as file:
            for run, columns in self._groups:
                sets = {name: file[columns[name]] for name in names if name in columns}
                total = max(next(iter(file[d] for d in columns.values())).shape)
                for lo in range(0, total, size):
                    hi = min(lo + size, total)
                    chunk = {name: _slice(dataset, lo, hi) for name, dataset in sets.items()}
                    yield {name: chunk[name] if name in chunk else np.full(hi - lo, run) for name in names}

    def _opened(self) -> Any:
        return load("h5py").File(self.path, "r")


def _vectors(file: Any) -> tuple[Lengths, dict[str, str]]:
    """Return the length of every numeric vector, by its path in the file, and why others cannot be used.

    Soft links to datasets are followed; those to groups are other names for what is found anyway.
    """
    h5py = load("h5py")
    found: Lengths = {}
    unusable: dict[str, str] = {}
    seen: set[Any] = set()  # groups: a hard link may lead back to one that holds it

    def walk(group: Any, path: str) -> None:
        seen.add(group)
        for key in group:
            name = f"{path}{key}"
            link, node = group.get(key, getlink=True), group.get(key)
            if key.startswith("#"):
                continue
            if isinstance(link, h5py.ExternalLink) or node is None:
                where = "another file" if isinstance(link, h5py.ExternalLink) else "nothing"
                unusable[name] = f"it is a link to {where}"
            elif isinstance(node, h5py.Group):
                if isinstance(link, h5py.HardLink) and node not in seen:
                    walk(node, f"{name}/")
            elif isinstance(node, h5py.Dataset):
                length, why = _judge(node)
                found.update({name: length} if length is not None and not why else {})
                unusable.update({name: why} if why else {})

    walk(file, "")
    return found, unusable


def _judge(node: Any) -> tuple[int | None, str]:
    """Return the length of a dataset that is a vector, None for another one, and why it cannot be used."""
    shape, kind = node.shape, node.dtype.kind
    if shape is None or node.attrs.get("MATLAB_class", b"") in (b"char", b"cell") or kind not in "fiub":
        return None, ""
    if not (len(shape) == 1 or (len(shape) == 2 and 1 in shape)):
        return None, ""
    if kind == "b" or node.attrs.get("MATLAB_class", b"") == b"logical":
        return max(shape), "it holds booleans, not numbers"
    if node.chunks:
        need = math.prod(-(-n // c) for n, c in zip(shape, node.chunks, strict=True))
        have = node.id.get_num_chunks()
    else:
        need, have = int(node.size > 0), int(node.id.get_storage_size() > 0)
    if have < need and not node.external:
        return max(shape), f"of its {need} blocks only {have} were written, so the recording broke off"
    return max(shape), ""


Part = tuple[int | None, dict[str, str]]


def _arrange(lengths: Lengths) -> tuple[list[Part], dict[str, str], dict[str, str]]:
    groups: dict[str, dict[str, str]] = {}
    for path in lengths:
        group, _, column = path.rpartition("/")
        groups.setdefault(group, {})[column] = path
    numbers = {group: re.search(r"(\d+)$", group) for group in groups}
    same = len({tuple(sorted(columns)) for columns in groups.values()}) == 1
    if len(groups) > 1 and same and all(numbers.values()):
        for group, columns in groups.items():
            sizes = {lengths[path] for path in columns.values()}
            if len(sizes) > 1:
                raise InputError(
                    f"Columns of group '{group}' must be equally long; they have "
                    f"{' and '.join(map(str, sorted(sizes)))} values: the recording of this run broke off."
                )
        ordered = sorted((int(match[1]), groups[group]) for group, match in numbers.items() if match)
        return [(run, columns) for run, columns in ordered], {}, {}
    columns, left_out, aliases = name_vectors(lengths, "/")
    return ([(None, columns)] if columns else []), left_out, aliases


def name_vectors(lengths: Lengths, separator: str) -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Name nested vectors by their last part where that is unique, and keep those of the usual length.

    Returns (name -> path, name -> why it was left out, path -> name).
    """
    ends = Counter(path.rpartition(separator)[2] for path in lengths)
    names = {p: p.rpartition(separator)[2] if ends[p.rpartition(separator)[2]] == 1 else p for p in lengths}
    sizes = Counter(size for size in lengths.values() if size > 1)
    usual = max(sizes, key=lambda size: (sizes[size], size)) if sizes else 1
    kept = {names[path]: path for path, size in lengths.items() if size == usual}
    left = {
        names[p]: f"it has {n} values where the others have {usual}" for p, n in lengths.items() if n != usual
    }
    return kept, left, {path: name for path, name in names.items() if path != name}


def _slice(dataset: Any, lo: int, hi: int) -> Array:
    if len(dataset.shape) == 1:
        return np.asarray(dataset[lo:hi])
    return np.asarray(dataset[0, lo:hi] if dataset.shape[0] == 1 else dataset[lo:hi, 0])
