"""The devices of a fleet: a folder of logs, several files, or a table of logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log.formats import COMPRESSED, FORMATS, natural

SUFFIXES = tuple(suffix for entry in FORMATS if entry.found for suffix in entry.suffixes)


@dataclass(frozen=True)
class Device:
    """One device: its name, its log, what else is known of it."""

    name: str
    log: str
    covariates: Mapping[str, Any] = field(default_factory=dict)


def devices_of(sources: str | Path | Sequence[str | Path]) -> tuple[Device, ...]:
    """Return the devices that folders, logs or a table of logs name.

    A folder holds logs, or folders with a log each. A table (CSV, Parquet) has a column `log` of paths,
    relative to the table, and perhaps `device` and covariates of any name. Order is that of the table, else
    of the names, in which numbers count as such: dev9 comes before dev10.
    Raises `InputError` for what is not there and for devices of the same name.
    """
    given = [sources] if isinstance(sources, str | Path) else list(sources)
    if not given:
        raise InputError("A fleet needs logs: a folder, files, or a table of logs.")
    found = _table(Path(given[0])) if len(given) == 1 else None
    if found is None:
        found = [Device(_name(path), str(path)) for source in given for path in _paths(Path(source))]
    seen: dict[str, Device] = {}
    for device in found:
        if device.name in seen:
            raise InputError(
                f"Two devices are called {device.name!r} ({quoted(seen[device.name].log)} and "
                f"{quoted(device.log)}); give each its own name in a table with columns log and device."
            )
        seen[device.name] = device
    return tuple(found)


def _paths(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"No log is called {quoted(path)}; give a folder, files or a table of logs.")
    if not path.is_dir() or _is_log(path):
        return [path]
    found = [p for p in path.iterdir() if _is_log(p)]
    if not found:
        raise InputError(f"Folder {quoted(path)} must hold logs, or folders with a log each; it holds none.")
    return sorted(found, key=natural)


def _is_log(path: Path) -> bool:
    if path.is_dir():
        return any((path / f"log{suffix}").is_file() for suffix in SUFFIXES)
    name = path.name.lower().removesuffix(COMPRESSED)
    return path.is_file() and not name.startswith(".") and name.endswith(SUFFIXES)


def _name(path: Path) -> str:
    return path.name if path.is_dir() else path.name.partition(".")[0]


def read_table(path: Path) -> Any:
    """Return a CSV or Parquet file as a table of pyarrow; None where it cannot be read."""
    from pyarrow import ArrowException, csv, parquet

    try:
        return csv.read_csv(path) if path.suffix.lower() == ".csv" else parquet.read_table(path)
    except ArrowException:
        return None


def _table(path: Path) -> list[Device] | None:
    """Return the devices of a table of logs; None for a file that is none."""
    table = read_table(path) if path.is_file() and path.suffix.lower() in (".csv", ".parquet") else None
    if table is None or "log" not in table.column_names:
        return None
    out = []
    for k, row in enumerate(table.to_pylist()):
        log = str(row.pop("log") or "").strip()
        name = str(row.pop("device", _name(Path(log))) or "").strip()
        if not log or not name:
            raise InputError(f"Row {k + 1} of {quoted(path)} must name a log and a device; one is empty.")
        out.append(Device(name, str(path.parent / log), row))
    return out
