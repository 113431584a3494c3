"""A log in parts: a folder of Parquet files, on a disk or under a URL, read one after the other."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.files import atomic_write
from hallsym.log.columns import RUN
from hallsym.log.extras import load
from hallsym.log.format_parquet import ParquetSource
from hallsym.log.guarded import Guarded
from hallsym.log.meta import PARTS
from hallsym.log.table import IN_MEMORY_ROWS, Source
from hallsym.log.write import LogWriter
from hallsym.units import Array

SUFFIXES = (".parquet", ".pq")
FAULT, REMEDY = "must be a complete Parquet file; it is cut short or damaged", "copy it again"


class Parts(Source):
    """The columns of several files of one log, in their order; all have the same columns."""

    def __init__(self, parts: Sequence[Source], names: Sequence[str], where: str) -> None:
        """Take the parts, `names` of their files, and what messages call the whole."""
        self.parts, self.where = tuple(parts), where
        first = self.parts[0]
        self.names, self.units, self.aliases = first.names, first.units, first.aliases
        self.left_out, self.notes = first.left_out, first.notes
        for part, name in zip(self.parts, names, strict=True):
            odd = set(first.names) ^ set(part.names)
            if odd:
                column = min(odd)
                has, lacks = (names[0], name) if column in first.names else (name, names[0])
                raise InputError(
                    f"Parts of {where} must have the same columns; {lacks} has no {column}, which {has} has: "
                    "write it again, or take it out of the folder."
                )
        self.rows = sum(part.count() for part in self.parts)
        self.small = self.rows <= IN_MEMORY_ROWS

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks, part by part."""
        for part in self.parts:
            yield from part.chunks(names, size)

    def part(self, k: int) -> Source:
        """Return one part; it is read in pieces, not at once, where the whole is."""
        out = copy(self)
        out.parts, out.rows = (self.parts[k],), self.parts[k].count()
        return out

    def labels(self, name: str) -> list[str]:
        """Return a column of names, as text."""
        return [label for part in self.parts for label in part.labels(name)]


def part_files(folder: Path) -> list[Path]:
    """Return the Parquet files of a folder in their order: numbers in names count as such."""
    found = [
        p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in SUFFIXES and p.name[0] not in "._"
    ]
    return sorted(found, key=lambda p: _natural(p.name))


def open_parts(folder: Path) -> Source:
    """Return the columns of a folder of Parquet files. Raises `InputError` where a part is missing."""
    files = part_files(folder)
    _check_numbers([p.name for p in files], quoted(folder))
    origins: dict[str, int] = {}  # times of all parts count from those of the first
    sources = [Guarded(file, partial(ParquetSource, origins=origins), FAULT, REMEDY) for file in files]
    return Parts(sources, [p.name for p in files], quoted(folder))


def open_url(url: str) -> Source:
    """Return the columns of a Parquet file, or a folder of such files, under a URL that fsspec knows."""
    fsspec = load("fsspec")
    try:
        system, path = fsspec.core.url_to_fs(url)
        files = sorted((f for f in system.find(path) if f.endswith(SUFFIXES)), key=_natural)
    except (OSError, ValueError, ImportError) as error:
        raise InputError(f"Cannot read {url}: {' '.join(str(error).split())[:120]}.") from error
    if not files:
        raise InputError(f"Under {url} there must be Parquet files; there is none.")
    names = [PurePosixPath(f).name for f in files]
    _check_numbers(names, url)
    try:
        origins: dict[str, int] = {}
        sources = [ParquetSource(Path(f), partial(system.open, f, "rb"), origins) for f in files]
    except (OSError, ValueError) as error:
        raise InputError(f"A part of {url} {FAULT} ({' '.join(str(error).split())[:80]}).") from error
    return Parts(sources, names, url)


def check_count(source: Source, stated: Any) -> None:
    """Raise `InputError` where a log has fewer parts, or more, than its meta.json states."""
    if isinstance(source, Parts) and stated is not None and stated != len(source.parts):
        raise InputError(
            f"{source.where} must have {stated} parts, as its meta.json says; it has {len(source.parts)}: "
            "copy it again."
        )


def _check_numbers(names: Sequence[str], where: str) -> None:
    """Refuse a gap in the numbers of parts."""
    found = [re.match(r"part\D?(\d+)", name) for name in names]
    if not all(found):
        return
    numbers = [int(m.group(1)) for m in found if m]
    for before, after in pairwise(numbers):
        if after != before + 1:
            raise InputError(
                f"Part {before + 1} of {where} is missing: {names[numbers.index(before)]} is followed by "
                f"{names[numbers.index(after)]}; copy it again."
            )


def _natural(name: str) -> list[tuple[int, int, str]]:
    return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in re.split(r"(\d+)", name)]


class PartsWriter:
    """Write a log as a folder of Parquet files of about `rows` samples each, cut between runs.

    >>> with PartsWriter("dataset", 10_000_000) as writer:   # doctest: +SKIP
    ...     writer.append({"run": run, "t_s": t, "hall_a_um": readings})
    """

    def __init__(self, folder: str | Path, rows: int) -> None:
        """Nothing is written before the first piece."""
        self.folder, self.rows = Path(folder), rows
        self._writer: LogWriter | None = None
        self._count, self._filled, self._last = 0, 0, None

    def __enter__(self) -> PartsWriter:
        """Make the folder, which must be empty."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"Cannot write folder {quoted(self.folder)}: {error.strerror}.") from error
        if any(self.folder.iterdir()):
            raise InputError(
                f"Folder {quoted(self.folder)} must be empty to write a log in parts; name another."
            )
        return self

    def append(self, columns: Mapping[str, Array]) -> None:
        """Add samples of one run."""
        run = columns[RUN][0]
        if self._writer is not None and self._filled >= self.rows and run != self._last:
            self._close()
        if self._writer is None:
            self._writer = LogWriter(self.folder / f"part-{self._count:05d}.parquet").__enter__()
            self._count += 1
        self._writer.append(columns)
        self._filled, self._last = self._filled + len(columns[RUN]), columns[RUN][-1]

    def _close(self, kind: Any = None, error: BaseException | None = None, trace: Any = None) -> None:
        writer, self._writer, self._filled = self._writer, None, 0
        if writer is not None:
            writer.__exit__(kind, error, trace)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the last part, and state how many there are."""
        self._close(kind, error, trace)
        if error is None:
            atomic_write(self.folder / "meta.json", f'{{"{PARTS}": {self._count}}}\n')
