"""What is done so far, one line a device: a fleet that was stopped or killed goes on where it was."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from hallsym.errors import InputError
from hallsym.fleets.row import Settings
from hallsym.fleets.sources import Device


def journal_of(output: str | Path) -> Path:
    """Return the journal that stands beside an output."""
    return Path(f"{output}.journal")


class Journal:
    """Rows by stamp as they are done; each is on the disk before the next device is reported."""

    def __init__(self, path: Path, settings: Settings) -> None:
        """Read what an earlier run of the same settings left."""
        self.path, self._settings = path, json.dumps(asdict(settings), sort_keys=True, default=str)
        self._stream: IO[str] | None = None
        self.rows: dict[str, dict[str, Any]] = {}
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else ()
        for entry in map(_entry, lines):
            self.rows[entry.get("stamp", "")] = entry.get("row", {})

    def _stamp(self, device: Device) -> str:
        """Return what changes with the settings, and when the log of a device is recorded again."""
        path = Path(device.log)
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        try:
            told = [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files if p.is_file()]
        except OSError:
            told = []
        return hashlib.sha256(repr((self._settings, str(path), told)).encode()).hexdigest()[:16]

    def done(self, device: Device) -> dict[str, Any] | None:
        """Return the row of a device whose log has not changed since; None for one that is to be fitted."""
        return self.rows.get(self._stamp(device))

    def add(self, device: Device, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        if self._stream is None:
            try:
                self._stream = open(self.path, "a", encoding="utf-8")  # noqa: SIM115
            except OSError as error:
                raise InputError(f"Cannot write {self.path}: {error.strerror}.") from error
            self._stream.write("\n")  # ends a line that was cut short
        self._stream.write(json.dumps({"stamp": self._stamp(device), "row": dict(row)}) + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Stop writing."""
        if self._stream is not None:
            self._stream.close()


def _entry(line: str) -> dict[str, Any]:
    """Return one line; nothing of one that a killed process cut short."""
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
