"""The verb `fleet`: every device fitted by itself, as many at once as there are workers.

A journal beside the output keeps what is done, one line a device: a fleet that was stopped or killed goes on
where it was.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import IO, Any

from hallsym.errors import InputError, one_line, require
from hallsym.families import build, effect_named
from hallsym.families.machine_file import Machine, read_machine
from hallsym.files import json_text, reason
from hallsym.fleets.result import Fleet, table_suffix
from hallsym.fleets.row import FAILED, Settings, row_of
from hallsym.fleets.sources import Device, devices_of
from hallsym.fleets.workers import Failed, completed
from hallsym.log import Meta
from hallsym.model import Model
from hallsym.output import Step


def fleet(
    sources: str | Path | Sequence[str | Path],
    model: str | None = None,
    *,
    effects: Sequence[str] = (),
    machine: Machine | str | Path | None = None,
    diagnose: bool = False,
    drop_bad: bool = False,
    reading: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> Fleet:
    """Calibrate every device of a fleet and return one row a device.

    `sources`: a folder of logs, logs, or a table of logs with columns `log`, `device` and covariates.
    `model`, `effects`, `drop_bad`: as for `fit`, of every log; numbers of effects that are left open are
    found on each. `machine`: a machine file, or what `read_machine` returns. `reading`: more of `read_log`.
    `diagnose`: diagnose each log too. `output`: the table to write; beside it a journal keeps what is done
    until all is, so that the same call goes on where an earlier one was stopped. `workers`: local processes,
    one a core by default; `scheduler`: address of a Dask scheduler instead.

    A log that cannot be fitted gives a row with its reason. A log whose run statistics show nothing amiss is
    read once, without error tables (`fit(quick=True)`).

    Raises `InputError` for sources that are not there, devices of one name and a scheduler that does not
    answer.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    require(workers is None or workers >= 1, "'workers'", "1 or more", workers)
    devices = devices_of(sources)
    if output:
        table_suffix(output)
    known = machine if isinstance(machine, Machine) else read_machine(machine)
    settings = Settings(model, tuple(effects), known, dict(reading or {}), drop_bad, diagnose)
    if model is not None:
        _built(model, settings)
    journal = Journal(journal_of(output) if output else None, settings)
    rows = {d.name: row for d in devices if (row := journal.done(d)) is not None}
    left = [device for device in devices if device.name not in rows]
    before = len(rows)
    work = completed(partial(row_of, settings), left, workers=workers, scheduler=scheduler) if left else ()
    with journal:
        for device, outcome in work:
            if isinstance(outcome, Failed):
                outcome = {"verdict": FAILED, "reason": one_line(outcome.reason)}
            rows[device.name] = outcome
            journal.add(device, rows[device.name])
            share = (len(rows) - before) / len(left)
            say(Step(f"devices, {len(rows)} of {len(devices)}", share))
    table = [{"device": d.name, "log": d.log, **d.covariates, **rows[d.name]} for d in devices]
    models = Counter(str(row["model"]) for row in table if "model" in row).most_common(1)
    known_model = _built(models[0][0], settings) if models else None
    found = Fleet(tuple(table), known_model, perf_counter() - began)
    if output is not None:
        found.save(output)
        journal_of(output).unlink(missing_ok=True)
    return found


def _built(name: str, settings: Settings) -> Model:
    """Return a model of the fleet, without effects whose numbers each log has of its own.

    Raises `InputError` for a model, an effect or a parameter that is not known.
    """
    meta = settings.machine.applied(Meta())
    plain = build(name, meta=meta)
    stated = tuple(e for e in settings.effects if ":" in e or not effect_named(e, plain).lacking(e))
    parameters = settings.machine.parameters if stated == settings.effects else {}
    return build(name, meta=meta, added=stated, parameters=parameters)


def journal_of(output: str | Path) -> Path:
    """Return the journal that stands beside an output."""
    return Path(f"{output}.journal")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="replace")).hexdigest()[:16]


class Journal:
    """Rows by stamp as they are done; each is on the disk before the next device is reported."""

    def __init__(self, path: Path | None, settings: Settings) -> None:
        """Read what an earlier run of the same settings left; without a path nothing is kept."""
        self.path, self._settings = path, json.dumps(asdict(settings), sort_keys=True, default=str)
        self._stream: IO[str] | None = None
        self._rows: dict[str, dict[str, Any]] = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                digest, _, text = line.partition(" ")
                if digest == _digest(text):  # else a killed process cut it short, or it is damaged
                    entry = json.loads(text)
                    self._rows[entry["stamp"]] = entry["row"]

    def _stamp(self, device: Device) -> str:
        """Return what changes with the settings, and when the log of a device is recorded again."""
        path = Path(device.log)
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        outcome = [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files if p.is_file()]
        return _digest(repr((self._settings, str(path), outcome)))

    def done(self, device: Device) -> dict[str, Any] | None:
        """Return the row of a device whose log has not changed since; None for one that is to be fitted."""
        return self._rows.get(self._stamp(device)) if self._rows else None

    def add(self, device: Device, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        if self.path is None:
            return
        if self._stream is None:
            try:
                self._stream = self.path.open("a", encoding="utf-8")
            except OSError as error:
                raise InputError(f"Cannot write {self.path}: {reason(error)}.") from error
            self._stream.write("\n")  # ends a line that was cut short
        text = json_text({"stamp": self._stamp(device), "row": dict(row)}, None)
        self._stream.write(f"{_digest(text)} {text}\n")
        self._stream.flush()

    def __enter__(self) -> "Journal":
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop writing."""
        if self._stream is not None:
            self._stream.close()
