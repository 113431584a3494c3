"""The devices of a fleet: a folder of logs, a pattern, several files, or a table of logs."""

import glob
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log import open_source
from hallsym.log.formats import COMPRESSED, FORMATS

LOG_COLUMN, DEVICE_COLUMN, ORDER_COLUMN = "log", "device", "order"
SUFFIXES = tuple(suffix for entry in FORMATS for suffix in entry.suffixes)


@dataclass(frozen=True)
class Device:
    """One device: its name, its log, its place in the order of production, what else is known of it."""

    name: str
    log: str
    order: float
    covariates: Mapping[str, Any] = field(default_factory=dict)


def devices_of(sources: str | Path | Sequence[str | Path]) -> tuple[Device, ...]:
    """Return the devices that folders, patterns, logs or a table of logs name.

    A folder holds logs, or folders with a log each. A table (CSV, Parquet, workbook) has a column `log` of
    paths, relative to the table, and perhaps `device`, `order` and covariates of any name. Order is that of
    the table, else of the names, in which numbers count as such: dev9 comes before dev10.
    Raises `InputError` for what is not there and for devices of the same name.
    """
    given = [sources] if isinstance(sources, str | Path) else list(sources)
    if not given:
        raise InputError(
            "A fleet needs logs: a folder, a pattern such as 'logs/*.parquet', or a table of logs."
        )
    if len(given) == 1 and (found := _table(Path(given[0]))) is not None:
        return _different(found)
    paths = [path for source in given for path in _paths(str(source))]
    return _different([Device(_name(path), str(path), float(k)) for k, path in enumerate(paths)])


def _paths(source: str) -> list[Path]:
    path = Path(source)
    if path.is_dir():
        found = [p for p in path.iterdir() if _is_log(p)]
        if any(p.is_file() and p.name.partition(".")[0] == "log" for p in found):
            return [path]
        if not found:
            raise InputError(
                f"Folder {quoted(path)} must hold logs, or folders with a log each; it holds none."
            )
        return sorted(found, key=_natural)
    if path.exists():
        return [path]
    if found := [Path(p) for p in glob.glob(source, recursive=True) if _is_log(Path(p))]:
        return sorted(found, key=_natural)
    raise InputError(f"No log is called {quoted(source)}; give a folder, a pattern or a table of logs.")


def _is_log(path: Path) -> bool:
    if path.is_dir():
        return any((path / f"log{suffix}").is_file() for suffix in SUFFIXES)
    name = path.name.lower().removesuffix(COMPRESSED)
    return path.is_file() and not name.startswith(".") and name.endswith(SUFFIXES)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", str(path))
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]


def _name(path: Path) -> str:
    return path.name if path.is_dir() else path.name.partition(".")[0]


def _table(path: Path) -> list[Device] | None:
    """Return the devices of a table of logs; None for a file that is none."""
    if not path.is_file() or not path.name.lower().removesuffix(COMPRESSED).endswith(SUFFIXES):
        return None
    _, _, source = open_source(path)
    known = (*source.names, *source.left_out)
    if LOG_COLUMN not in known:
        return None
    columns = _columns(path, source)
    logs = [_text(value) for value in columns[LOG_COLUMN]]
    names = [_text(value) for value in columns.get(DEVICE_COLUMN, [])] or [_name(Path(log)) for log in logs]
    order = columns.get(ORDER_COLUMN, list(range(len(logs))))
    others = [c for c in columns if c not in (LOG_COLUMN, DEVICE_COLUMN, ORDER_COLUMN)]
    out = []
    for k, (name, log) in enumerate(zip(names, logs, strict=True)):
        if not log or not name:
            raise InputError(f"Row {k + 1} of {quoted(path)} must name a log and a device; one is empty.")
        try:
            place = float(order[k])
        except (TypeError, ValueError):
            raise InputError(
                f"Column order of {quoted(path)} must hold numbers; row {k + 1} has {order[k]!r}."
            ) from None
        where = log if Path(log).is_absolute() or "://" in log else str(path.parent / log)
        out.append(Device(name, where, place, {c: columns[c][k] for c in others}))
    return out


def _text(value: Any) -> str:
    return "" if value is None else str(value).strip()


def _columns(path: Path, source: Any) -> dict[str, list[Any]]:
    """Return every column of a table, of text and of numbers."""
    if path.suffix.lower() in (".parquet", ".pq"):
        import pyarrow.parquet as parquet

        return dict(parquet.read_table(path).to_pydict())
    from pyarrow import ArrowInvalid, csv

    try:
        return dict(csv.read_csv(path).to_pydict())
    except ArrowInvalid as error:
        raise InputError(
            f"Table {quoted(path)} must be CSV with commas or Parquet, with a column 'log' ({error})."
        ) from error


def _different(devices: Sequence[Device]) -> tuple[Device, ...]:
    seen: dict[str, Device] = {}
    for device in devices:
        if device.name in seen:
            raise InputError(
                f"Two devices are called {device.name!r} ({quoted(seen[device.name].log)} and "
                f"{quoted(device.log)}); give each its own name in a table with columns log and device."
            )
        seen[device.name] = device
    return tuple(devices)
