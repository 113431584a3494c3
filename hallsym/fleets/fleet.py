"""The verb `fleet`: every device fitted by itself, as many at once as there are workers."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from hallsym.errors import InputError, counted
from hallsym.families import adapted, build, effect_named
from hallsym.fleets.journal import Journal, journal_of
from hallsym.fleets.result import Fleet
from hallsym.fleets.row import Job, Settings, failed, row_of
from hallsym.fleets.sources import ORDER_COLUMN, Device, devices_of
from hallsym.fleets.workers import Failed, completed
from hallsym.log import Meta
from hallsym.model import Model
from hallsym.terminal import said_time

Progress = Callable[[str], None]


def fleet(
    sources: str | Path | Sequence[str | Path],
    model: str | None = None,
    *,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    solver: str = "direct",
    loss: str = "auto",
    diagnose: bool = False,
    drop_bad: bool = False,
    resolve_wiring: bool = False,
    reading: Mapping[str, Any] | None = None,
    machine: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    on_progress: Progress | None = None,
) -> Fleet:
    """Calibrate every device of a fleet and return one row a device.

    `sources`: a folder of logs, a pattern, logs, or a table of logs with columns `log`, `device`, `order` and
    covariates. `model`, `effects`, `parameters`, `solver`, `loss`, `drop_bad`, `resolve_wiring`: as for
    `fit`, of every log; numbers of effects that are left open are found on each. `reading`: more of
    `read_log`. `machine`: probes and tables of a machine file. `diagnose`: diagnose each log too. `output`:
    the table to write; beside it a journal keeps what is done until all is, so that the same call goes on
    where an earlier one was stopped. `workers`: local processes, one a core by default; `scheduler`: address
    of a Dask scheduler instead.

    A log that cannot be fitted gives a row with its reason. A log whose run statistics show nothing amiss is
    read once, without error tables (`fit(quick=True)`).

    Raises `InputError` for sources that are not there, devices of one name and a scheduler that does not
    answer.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    if workers is not None and workers < 1:
        raise InputError(f"'workers' must be 1 or more; instead received {workers}.")
    devices = devices_of(sources)
    settings = Settings(
        model, tuple(effects), dict(parameters or {}), machine, solver, loss, dict(reading or {}), drop_bad,
        resolve_wiring, diagnose,
    )  # fmt: skip
    if model is not None:
        _built(model, settings)
    journal = None if output is None else Journal(journal_of(output), settings)
    rows = _rows(devices, settings, journal, workers, scheduler, say)
    rows = [_of_one_model(row, rows) for row in rows]
    found = Fleet(tuple(rows), _model(rows, settings), perf_counter() - began)
    if output is not None:
        found.save(output)
    if journal is not None:
        journal.path.unlink(missing_ok=True)
    return found


def _rows(
    devices: Sequence[Device],
    settings: Settings,
    journal: Journal | None,
    workers: int | None,
    scheduler: str | None,
    say: Progress,
) -> list[dict[str, Any]]:
    """Return the row of every device, in their order; those that the journal knows are not fitted again."""
    rows: dict[str, dict[str, Any]] = {}
    if journal is not None:
        rows = {d.name: row for d in devices if (row := journal.done(d)) is not None}
    jobs = [Job(device, settings) for device in devices if device.name not in rows]
    began, before = perf_counter(), len(rows)
    try:
        for done in completed(row_of, jobs, workers=workers, scheduler=scheduler) if jobs else ():
            device, told = done.work.device, done.result
            rows[device.name] = failed(told.reason) if isinstance(told, Failed) else told
            if journal is not None:
                journal.add(device, rows[device.name])
            say(_progress(len(rows), len(devices), before, perf_counter() - began))
    finally:
        if journal is not None:
            journal.close()
    return [
        {"device": d.name, "log": d.log, ORDER_COLUMN: d.order, **d.covariates, **rows[d.name]}
        for d in devices
    ]


def _progress(done: int, every: int, before: int, seconds: float) -> str:
    """Return how far the fleet is, and the time that is left."""
    left = seconds / max(done - before, 1) * (every - done)
    return f"{done} of {counted(every, 'device')}, {said_time(left)} left"


def _of_one_model(row: dict[str, Any], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the row, or that its log is of another model than most of the fleet."""
    models = [(r.get("model"), r.get("effects")) for r in rows if r.get("model")]
    if not row.get("model") or not models:
        return row
    usual = max(dict.fromkeys(models), key=models.count)
    if (row["model"], row["effects"]) == usual:
        return row
    reason = (
        f"Its log is of model {row['model']}, most of the fleet is {usual[0]}; fit it in a fleet of its own."
    )
    kept = {k: row[k] for k in row if ":" not in k and k not in ("model", "effects")}
    return {**kept, **failed(reason)}


def _model(rows: Sequence[Mapping[str, Any]], settings: Settings) -> Model | None:
    """Return the model of the devices that were fitted, with the columns of the first of them."""
    row = next((r for r in rows if r.get("model")), None)
    if row is None:
        return None
    return _built(str(row["model"]), settings)


def _built(name: str, settings: Settings) -> Model:
    """Return the model of the fleet, without effects whose numbers each log has of its own.

    Raises `InputError` for a model, an effect or a parameter that is not known.
    """
    model, found = build(name, meta=Meta(probes=(settings.machine or {}).get("probes"))), True
    for text in settings.effects:
        effect = effect_named(text, model)
        if ":" in text or not effect.lacking(text):
            model = effect.added(model, text)
        else:
            found = False
    known = {p.name for p in (*model.parameters, *model.zeros)}
    changes = {n: e for n, e in settings.parameters.items() if found or n in known}
    return adapted(model, (), changes)
