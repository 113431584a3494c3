"""What is done so far, one line a device: a fleet that was stopped or killed goes on where it was."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from hallsym.errors import InputError, quoted
from hallsym.fleets.row import Settings
from hallsym.fleets.sources import Device

FORMAT = "hallsym fleet journal 1"


def journal_of(output: str | Path) -> Path:
    """Return the journal that stands beside an output."""
    return Path(f"{output}.journal")


def fingerprint(settings: Settings) -> str:
    """Return what tells settings that give other rows."""
    text = json.dumps(asdict(settings), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def stamp(device: Device) -> str:
    """Return what changes when the log of a device is recorded again: path, size and time of its files."""
    path = Path(device.log)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    try:
        told = [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files if p.is_file()]
    except OSError:
        told = []
    return hashlib.sha256(repr((str(path), told)).encode()).hexdigest()[:16]


class Journal:
    """Rows by device as they are done; each is on the disk before the next device is reported."""

    def __init__(self, path: Path, settings: Settings) -> None:
        """Open the journal, with what an earlier run of the same settings left in it."""
        self.path, self._print = path, fingerprint(settings)
        self.rows: dict[str, dict[str, Any]] = self._read()
        self._stream: IO[str] | None = None

    def _read(self) -> dict[str, dict[str, Any]]:
        if not self.path.exists():
            return {}
        out: dict[str, dict[str, Any]] = {}
        with open(self.path, encoding="utf-8", errors="replace") as stream:
            head = _entry(stream.readline())
            if head is None or head.get("format") != FORMAT:
                raise InputError(
                    f"File {quoted(self.path)} must be the journal of a fleet; remove it, or name another "
                    "output."
                )
            if head.get("settings") != self._print:
                raise InputError(
                    f"Journal {quoted(self.path)} is of other options than those given now; give the same to "
                    "go on, or remove it to begin anew."
                )
            for line in stream:
                entry = _entry(line)  # the last line of a process that was killed may be cut short
                if entry is not None and {"stamp", "row"} <= set(entry):
                    out[entry["stamp"]] = entry["row"]
        return out

    def done(self, device: Device) -> dict[str, Any] | None:
        """Return the row of a device whose log has not changed since; None for one that is to be fitted."""
        return self.rows.get(stamp(device))

    def add(self, device: Device, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        if self._stream is None:
            self._stream = self._opened()
        self._stream.write(json.dumps({"stamp": stamp(device), "row": dict(row)}) + "\n")
        self._stream.flush()

    def _opened(self) -> IO[str]:
        try:
            fresh = not self.rows
            stream = open(self.path, "w" if fresh else "r+", encoding="utf-8")  # noqa: SIM115
        except OSError as error:
            raise InputError(f"Cannot write {quoted(self.path)}: {error.strerror}.") from error
        if fresh:
            stream.write(json.dumps({"format": FORMAT, "settings": self._print}) + "\n")
        else:
            stream.seek(0, os.SEEK_END)
            stream.write("\n")  # ends a line that was cut short
        return stream

    def close(self) -> None:
        """Stop writing."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def remove(self) -> None:
        """Forget what was kept: the output holds it."""
        self.close()
        self.path.unlink(missing_ok=True)


def _entry(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def ordered(rows: Mapping[str, dict[str, Any]], devices: Iterable[Device]) -> list[dict[str, Any]]:
    """Return the rows in the order of the devices."""
    return [rows[device.name] for device in devices if device.name in rows]
