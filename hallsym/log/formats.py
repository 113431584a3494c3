"""The formats of a log, and a log from a file or a folder: to add one, write its file and a row here."""

from __future__ import annotations

import glob
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import structs

from hallsym.errors import InputError, few, nearest, quoted, require
from hallsym.files import reading, regular
from hallsym.log.arrow import source_of
from hallsym.log.columns import (
    RUN,
    ColumnFile,
    Foreign,
    bind,
    counts_in_turn,
    read_column_file,
    still_missing,
)
from hallsym.log.containers import open_sqlite, unpacked
from hallsym.log.core import Log
from hallsym.log.format_csv import CsvSource
from hallsym.log.format_hdf5 import open_hdf5
from hallsym.log.format_mat import open_mat, open_netcdf, open_numpy
from hallsym.log.format_mcap import open_mcap
from hallsym.log.format_mdf import open_mdf
from hallsym.log.format_parquet import open_feather, open_json, open_parquet
from hallsym.log.format_tdms import open_tdms
from hallsym.log.format_xlsx import open_workbook
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.isolated import Isolated
from hallsym.log.maker_tables import open_table
from hallsym.log.meta import Meta, Noise, check_noise_keys
from hallsym.log.parted import by_clock, by_rows, by_signal, paced, side_by_side, stamped
from hallsym.log.quality.check import clean_log
from hallsym.log.table import Source, Table, about
from hallsym.log.text.sniff import PIECE, stated_delimiter
from hallsym.units import Array, split_unit


@dataclass(frozen=True)
class Format:
    """A format's name, the suffixes that mean it, how to open it and what it is called.

    `options`: options of its reader, by the names of `read_log`. `found`: whether a folder is
    searched for it; code that lies beside logs is none.
    """

    name: str
    suffixes: tuple[str, ...]
    open: Callable[..., Source]
    kind: str
    options: tuple[str, ...] = ()
    found: bool = True


FORMATS = (
    Format("parquet", (".parquet", ".pq"), open_parquet, "Parquet"),
    Format(
        "csv", (".csv", ".txt", ".tsv", ".lvm", ".dat", ".asc"), CsvSource, "CSV", ("delimiter", "decimal")
    ),
    Format("feather", (".feather", ".arrow", ".arrows"), open_feather, "Feather"),
    Format("json", (".jsonl", ".ndjson"), open_json, "JSON lines"),
    Format("json", (".json",), open_json, "JSON", found=False),  # beside a log it says what that is
    Format("hdf5", (".h5", ".hdf5"), partial(Isolated, open_hdf5), "HDF5", ("clock",)),
    Format("mat", (".mat",), partial(Isolated, open_mat), "MATLAB", ("clock",)),
    Format("netcdf", (".nc", ".cdf"), partial(Isolated, open_netcdf), "NetCDF", ("clock",)),
    Format("npz", (".npz", ".npy"), open_numpy, "NumPy", ("clock",)),
    Format("xlsx", (".xlsx", ".xlsm", ".xls", ".ods"), open_workbook, "workbook", ("sheet", "decimal")),
    Format("sqlite", (".sqlite", ".sqlite3", ".db"), open_sqlite, "SQLite", ("sheet",)),
    Format("tdms", (".tdms",), open_tdms, "TDMS", ("clock",)),
    Format("mdf", (".mf4", ".mdf"), partial(Isolated, open_mdf), "MDF", ("clock",)),
    Format("mcap", (".mcap",), partial(Isolated, open_mcap), "MCAP", ("clock",)),
    Format("table", (".h", ".hpp", ".c", ".cpp", ".ino", ".cfg"), open_table, "table", found=False),
)


COMPRESSED, ARCHIVE = ".gz", ".zip"


def format_of(path: Path, name: str | None = None) -> Format:
    """Return the format that `name` states or else the path's suffix means; log.csv.gz is CSV."""
    suffix = path.suffix.lower()
    if suffix == COMPRESSED:
        suffix = Path(path.stem).suffix.lower() or ".csv"
    for entry in FORMATS:
        if entry.name == name or (name is None and suffix in entry.suffixes):
            return entry
    known = [entry.name for entry in FORMATS]
    require(name is None, "Format", f"one of {', '.join(known)}", name, known)
    near = nearest(suffix, [ending for entry in FORMATS for ending in entry.suffixes])
    raise InputError(
        f"File {quoted(path)} cannot be read by its ending '{path.suffix}'{near}; give its --format, or"
        " export it as .csv: 'hallsym info --help' lists the endings."
    )


def _recognised(file: Path, name: str | None) -> Format:
    """Return the format of a file; lines of text are a table of text, whatever ending an instrument gives."""
    with reading(file, "Log", "cannot be read"), open(file, "rb") as stream:
        head = stream.read(PIECE)
    text = name is None and min(head, default=0) >= ord("\t") and b"\n" in head.rstrip()
    other = any(file.suffix.lower() in e.suffixes for e in FORMATS if e.name in ("json", "table"))
    return format_of(file, "csv" if text and not other else name)


MOST_ROWS = 1_000_000_000
"""Samples of a log: 8 GB a column, minutes of reading. More is a damaged count, or must be decimated."""


class Guarded(Source):
    """The columns of one file as `open` reads them; each call of the library is inside the boundary."""

    path: Path

    def __init__(self, path: Path, open: Callable[[Path], Source], fault: str) -> None:
        """Open the file: its names, rows and what is left out are known then."""
        self.path, self.fault = path, fault
        self.inner: Source = self._asked(open, path)
        vars(self).update(about(self.inner))
        self._possible(getattr(self.inner, "rows", 0))
        if RUN in self.left_out:
            raise InputError(
                f"Column run of {quoted(self.path)} cannot be used: {self.left_out[RUN]}; write it again."
            )

    def count(self) -> int:
        """Return the number of rows."""
        return self._possible(self._asked(self.inner.count))

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as text."""
        return self._asked(self.inner.head, count, most)

    def texts(self, name: str) -> Sequence[object] | None:
        """Return the cells of a column."""
        return self._asked(self.inner.texts, name)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""
        pieces = self.inner.chunks(names, size)
        while (piece := self._asked(next, pieces, None)) is not None:
            yield piece

    def _asked(self, question: Callable[..., Any], *words: Any) -> Any:
        """Return what a library answers; whatever it raises becomes one sentence."""
        with reading(self.path, "Log", self.fault):
            return question(*words)

    def _possible(self, rows: int) -> int:
        if not 0 <= rows <= MOST_ROWS:
            raise InputError(
                f"Log {quoted(self.path)} must have at most {MOST_ROWS} samples; it says {rows}, so it is "
                "damaged or has to be decimated."
            )
        return rows


def as_log(
    data: Any,
    remembered: Mapping[str, Foreign] | None = None,
    read_with: Mapping[str, str] | None = None,
    noise: Mapping[str, float] | None = None,
) -> Log:
    """Return a log: itself, or what `read_log` makes of a path or of a table in memory; `noise` wins."""
    if isinstance(data, Log):
        return replace(data, noise=_stated(noise, data.columns).merged(data.noise)) if noise else data
    return read_log(data, remembered=remembered, read_with=read_with, noise=noise)


def _stated(noise: Mapping[str, float] | None, columns: Sequence[str]) -> Noise:
    """Return the noise that a user states, by column."""
    check_noise_keys(noise or {}, columns, "the noise given")
    for key, value in (noise or {}).items():
        require(value > 0, f"Noise '{key}'", "a positive number (1 sigma)", value)
    return Noise.given(noise or {}, columns)


def read_log(
    path: Any,
    *,
    columns: Mapping[str, str | Foreign] | None = None,
    column_file: str | Path | None = None,
    format: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    sheet: str | None = None,
    clock: str | None = None,
    drop_bad: bool = False,
    noise: Mapping[str, float] | None = None,
    counts_per_turn: float | None = None,
    remembered: Mapping[str, Foreign] | None = None,
    read_with: Mapping[str, str] | None = None,
) -> Log:
    """Open a log; samples are read when they are first used.

    `path` is a data file, or a folder with `log.parquet` (or .csv, .h5, .mat) and perhaps `meta.json`; a
    folder or a pattern (`runs/*.csv`) of files that are runs; a list of files, which are runs where they have
    the same columns, else are joined by their times; or a table in memory: a dict of arrays, or a data frame
    of any library that speaks Arrow (pandas, polars, pyarrow, DuckDB). Names state their unit as those of a
    file do: `x_ref_um`, `x_ref [um]`.
    `columns` maps our name, ending with the unit the foreign column is in, to the foreign name:
    `{"hall_a_um": "HallA"}` gives the SI column `hall_a_m`. A column file (TOML) says the same and may give
    noise. `noise` holds 1-sigma values, `{"hall_m": 5e-7}`, and wins over the column file and `meta.json`.
    `counts_per_turn`: of angles in counts (`{"angle_count": "raw"}`); it wins in the same way.
    Of a text file delimiter and decimal sign are recognised; `delimiter` ("tab" and "blank" are words for
    them) and `decimal` state them. `sheet`: of a workbook that has several. `clock`: the channel group (TDMS,
    MDF, MCAP) or file whose samples become the rows, where there are several clocks; the slowest by default.
    `remembered`: columns as an earlier log was mapped (`Fit.columns`); those that this file has, and that
    nothing else gives, are read under the same names, and a note says so.
    `read_with`: options (`decimal`, `sheet`, ...) that an earlier log was read with (`Fit.read_with`), which
    answer what this file leaves open.
    `drop_bad` leaves out the samples and runs that `check_log` would refuse.
    """
    given = {"format": format, "delimiter": delimiter, "decimal": decimal, "sheet": sheet, "clock": clock}
    stated = read_column_file(column_file) if column_file else ColumnFile()
    stems = {split_unit(ours)[0] for ours in columns or {}}  # in another unit, perhaps
    filed = {ours: c for ours, c in stated.columns.items() if split_unit(ours)[0] not in stems}
    mapped: dict[str, str | Foreign] = {**filed, **(columns or {})}
    named = {e if isinstance(e, str) else e.name: ours for ours, e in mapped.items()}
    (file, folder, source, where), said = _answered(path, {**given, "mapped": named}, read_with or {})
    meta = Meta.read(folder / "meta.json") if folder and (folder / "meta.json").exists() else Meta()
    wanted = _resolve(mapped, source)
    again = still_missing(_resolve(remembered or {}, source), source.names, wanted, source.units, where)
    wanted |= again
    given_turn = (counts_per_turn, stated.counts_per_turn, meta.raw.get("counts_per_turn"))
    turn = next((counts_in_turn(counts, where) for counts in given_turn if counts is not None), None)
    runs, sure = ("", True) if RUN in wanted else source.run_column({f.name for f in wanted.values()})
    of_runs = [f"Runs are those of column '{runs}'."] if runs and runs.lower() != RUN else []
    if runs and not sure:
        of_runs = [f"Column '{runs}' may number runs: if it does, add --column run={runs}."]
    elif of_runs:
        wanted[RUN] = Foreign(runs)
    bindings, changed = bind(source.names, wanted, where, turn, source.units)
    table = Table(source, bindings, where)
    table.open = stated.open
    if not any(name != RUN for name in table.columns):
        table.require(sorted({split_unit(ours)[0] for ours in stated.open}))
        words = where.replace(" and ", " ")
        words += "".join(f" --{name} {quoted(text)}" for name, text in source.read_with.items())
        words = words.replace("'", '"')  # the command stands between the others
        raise InputError(
            f"{where} has no column whose name ends with a unit; it has {few(source.names, 5)}; map them"
            f" with --column hall_a_um=ITS_NAME, or by 'hallsym info {words} --write'."
        )
    check_noise_keys(stated.noise, table.columns, "the column file")
    known = _stated(noise, table.columns)
    for values in (stated.noise, meta.noise_1sigma):
        known = known.merged(Noise.given(values, table.columns))
    meta = replace(meta, columns=table.columns)
    unused = check_noise_keys(meta.noise_1sigma, table.columns, "meta.json", strict=False)
    notes = [*table.notes, *of_runs, *said, *source.notes]
    if unused:
        notes.append(f"meta.json states the noise of {', '.join(unused)}, which the log does not have.")
    left_out = {name: why for name, why in source.left_out.items() if split_unit(name)[1]}
    notes += [f"Column {name} is left out: {why}." for name, why in left_out.items()] + changed
    if renamed := [f"{ours} is '{theirs.name}'" for ours, theirs in again.items() if ours != theirs.name]:
        notes.append(f"Columns are named as in the calibration: {', '.join(renamed)}.")
    one = Path(path) if isinstance(path, str | Path) else None  # a folder or a pattern of runs
    log = Log(table, known, meta, file or one, tuple(notes))
    return clean_log(log) if drop_bad else log


class Opened(NamedTuple):
    """An opened log: a single data file, the folder that was named, the columns, and its name."""

    file: Path | None
    folder: Path | None
    source: Source
    where: str


def _answered(
    path: Any, given: Mapping[str, Any], read_with: Mapping[str, str]
) -> tuple[Opened, tuple[str, ...]]:
    """Open a file as `open_source` does; where it leaves something open, as an earlier one was read."""
    known = {name: text for name, text in read_with.items() if name in given and given[name] is None}
    words = ", ".join(f"{name} {text!r}" for name, text in known.items())
    tried = [(given, ()), ({**given, **known}, (f"The file is read as the calibration's log was: {words}.",))]
    errors = []
    # what was stated because something else was recognised goes first; what was asked for, last
    first = not known.keys().isdisjoint(("delimiter", "clock"))
    for options, notes in tried[:: -1 if first else 1] if known else tried[:1]:
        try:
            return open_source(path, **options), notes
        except InputError as error:
            errors.append(error)
    raise errors[first]  # without the help of an earlier one


def files_of(path: str | Path) -> list[Path]:
    """Return the file, the log of a folder, or the runs that a folder or a pattern (`runs/*.csv`) holds.

    Runs may lie in folders of their own; they are in natural order: `run_2` comes before `run_10`. Raises
    `InputError` where there is none.
    """
    given, path = quoted(path), Path(path)
    suffixes = tuple(suffix for entry in FORMATS if entry.found for suffix in entry.suffixes)
    if path.suffix.lower() == ARCHIVE and path.is_file():
        regular(path, "Log")
        with reading(path, "Log", "must be a complete archive; it is cut short or damaged"):
            path = unpacked(path, suffixes, path.stat().st_mtime_ns)
    if path.is_dir():
        logs = [path / f"log{suffix}" for suffix in suffixes if (path / f"log{suffix}").is_file()]
        here, below = (_of_one_kind(path.glob(inside), suffixes) for inside in ("*", "*/*"))
        own = len({file.name for file in below}) == 1 < len(below) and len(here) < 2  # beside a note
        found = logs[:1] or (below if own else here or below)
    elif glob.has_magic(str(path)) and not path.exists():
        found = [Path(name) for name in glob.glob(str(path)) if Path(name).is_file()]
    else:
        found = [path]
    if not found:
        raise InputError(
            f"{given} must hold a log named log.parquet, log.csv, log.h5 or log.mat, or files that are"
            " runs; it holds none."
        )
    return [regular(file, "Log") for file in sorted(found, key=natural)]


def _of_one_kind(paths: Iterable[Path], suffixes: Sequence[str]) -> list[Path]:
    """Return the files of the most frequent suffix, of several the first: notes may lie beside runs."""
    known = (path for path in paths if path.suffix.lower() in suffixes and path.name[0] != ".")
    files = [path for path in known if path.is_file()]
    counts = Counter(path.suffix for path in files)
    usual = max(counts, key=lambda suffix: (counts[suffix], -suffixes.index(suffix.lower())), default="")
    return [path for path in files if path.suffix == usual]


def natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts paths by the numbers in them: `run_2` comes before `run_10`."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part or 0), "") if k % 2 else (0, part) for k, part in enumerate(parts)]


def _open(file: Path, format: str | None, stated: Mapping[str, str | None]) -> Source:
    if file.stat().st_size == 0:
        raise InputError(f"Log {quoted(file)} is empty (0 bytes); record or copy it again.")
    entry = _recognised(file, format)
    options = {name: text for name, text in stated.items() if text is not None}
    for name in options:
        if name not in entry.options:
            raise InputError(
                f"Option {name} must be left out for {quoted(file)}: a {entry.name} file has none."
            )
    sign = options.get("decimal", ".")
    require(sign in (".", ","), "Decimal sign", "'.' or ','", sign)
    if "delimiter" in options:
        options["delimiter"] = stated_delimiter(options["delimiter"])
    fault = f"must be a complete {entry.kind} file; it is cut short or damaged"
    source = Guarded(file, partial(entry.open, **options), fault)
    found: Source = source
    for parted in (
        side_by_side,
        by_signal,
        *(() if "clock" in entry.options else (stamped, by_clock, by_rows, paced)),
    ):
        found = parted(source, quoted(file)) if found is source else found
    found.read_with = {**({"format": format} if format else {}), **options}
    return found


def open_source(
    path: Any,
    *,
    format: str | None = None,
    clock: str | None = None,
    mapped: Mapping[str, str] | None = None,
    **stated: str | None,
) -> Opened:
    """Return what `read_log` reads, its columns under their own names; other arguments are as there.

    `mapped`: our names, with their units, of columns that somebody mapped.
    """
    if isinstance(path, Mapping) or hasattr(path, "__arrow_c_stream__"):
        return Opened(None, None, source_of(path, "The table"), "The table")
    paths = path if isinstance(path, list | tuple) else [path]
    if not paths or not all(isinstance(one, str | Path) for one in paths):
        raise InputError(
            "A log must be a path, a dict of arrays, a data frame, a Log or a list of paths; instead received"
            f" a {type(path).__name__}."
        )
    files = [file for one in paths for file in files_of(one)]
    folder = Path(paths[0]) if Path(paths[0]).is_dir() else None
    if len(files) == 1:
        source = _open(files[0], format, {"clock": clock, **stated})
        packed = Path(paths[0]).suffix.lower() == ARCHIVE  # whose files have no lasting name
        return Opened(files[0], folder, source, quoted(paths[0] if packed else files[0]))
    where = quoted(paths[0]) if len(paths) == 1 else " and ".join(quoted(one) for one in paths[:3])
    same = len({file.stem for file in files}) < len(files)
    groups = [
        Group(f"{file.parent.name}/{file.name}" if same else file.stem, source, mapped)
        for file, source in ((file, _open(file, format, stated)) for file in files)
    ]
    odd = next((g for g in groups if set(g.channels) != set(groups[0].channels)), None)
    if odd and len(paths) == 1:
        names = sorted(set(odd.channels) ^ set(groups[0].channels))
        raise InputError(
            f"Files of {where} must have the same columns to be runs; {odd.name} and {groups[0].name} differ"
            f" in {few(names, 4)}: name the files of one recording with --join."
        )
    left_out = {name: why for g in groups for name, why in g.source.left_out.items()}
    source = GroupedSource(where, f"{len(files)} files", groups, left_out, clock, files=True)
    source.read_with = groups[0].source.read_with
    source.notes = (*dict.fromkeys(note for g in groups[:1] for note in g.source.notes), *source.notes)
    return Opened(None, folder, source, where)


def _resolve(wanted: Mapping[str, str | Foreign], source: Source) -> dict[str, Foreign]:
    """Let a mapping use a column's long name (`log.HallA`) as well as its short one."""

    def own(name: str) -> str:
        if name in source.names or name in source.aliases:
            return source.aliases.get(name, name)
        part = re.compile(rf"(?:.*\W)?{re.escape(name)}(?:\W.*)?")
        longer = [c for c in source.names if part.fullmatch(c) or split_unit(c)[0] == name]
        return longer[0] if len(longer) == 1 else name  # without unit and groups, as people say it

    entries = {ours: Foreign(e) if isinstance(e, str) else e for ours, e in wanted.items()}
    return {ours: structs.replace(e, name=own(e.name)) for ours, e in entries.items()}
