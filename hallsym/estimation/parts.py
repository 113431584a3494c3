"""A pass over a log in parts, made where `read_log(workers=)` says: one piece of work a part.

A part goes out as the names of its file and columns, a model as names and numbers (`families.recipe`); arrays
come back. Memory is bounded here and there: a part is read in the pieces in which the whole log would be.
"""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from hallsym.errors import InputError
from hallsym.families.recipe import made, recipe_of
from hallsym.log import Log
from hallsym.model import Model
from hallsym.workers import Failed, Workers, completed


@dataclass(frozen=True, eq=False)
class _Part:
    """Part `number` of a log, and what is called with it: `call(log, model, *arguments)`."""

    number: int
    rows: int
    log: Log
    call: Callable[..., Any]
    recipe: bytes
    arguments: tuple[Any, ...]


def shared_out(log: Log, model: Model) -> bool:
    """Return whether passes over a log for `model` are made by workers.

    Columns that are computed from logged ones are made where the log is opened.
    """
    return log.table.workers is not None and not model.computed


def by_parts(
    call: Callable[..., Any],
    log: Log,
    model: Model,
    *arguments: Any,
    on_rows: Callable[[int], None] | None = None,
) -> list[Any]:
    """Return `call(part, model, *arguments)` of every part of a log, in their order.

    `call`: a function of a module that returns arrays; `arguments` go with it. `on_rows(samples so far)` is
    called as parts are done. Raises `InputError` where a part cannot be read, or workers are lost with it.
    """
    recipe, workers = pickle.dumps(recipe_of(model)), log.table.workers or Workers()
    work = []
    for k in range(log.table.parts):
        part = replace(log, table=log.table.part(k))
        work.append(_Part(k, part.table.count(), part, call, recipe, arguments))
    found: list[Any] = [None] * len(work)
    rows = 0
    for done in completed(_called, work, workers=workers.count, scheduler=workers.scheduler):
        if isinstance(done.result, Failed):
            raise InputError(f"Part {done.work.number + 1} of {log.name}: {done.result.reason}")
        found[done.work.number] = done.result
        rows += done.work.rows
        if on_rows:
            on_rows(rows)
    return found


def whole_runs(parts: Sequence[Sequence[int]], where: str) -> None:
    """Refuse a run that stands in two parts; `parts`: the runs of each."""
    seen: dict[int, int] = {}
    for k, runs in enumerate(parts):
        for run in runs:
            if run in seen:
                raise InputError(
                    f"Run {run} of {where} stands in parts {seen[run] + 1} and {k + 1}; workers take parts "
                    "of whole runs: cut it between runs, or leave workers out."
                )
            seen[run] = k


def _called(part: _Part) -> Any:
    return part.call(part.log, _built(part.recipe), *part.arguments)


@lru_cache(maxsize=8)
def _built(recipe: bytes) -> Model:
    return made(pickle.loads(recipe))
