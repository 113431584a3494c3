"""A log made ready to be fitted: checked, inspected, read as its model reads it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from hallsym.errors import InputError
from hallsym.estimation.channel_assignment import Wiring, as_read
from hallsym.estimation.decoding import knows_rails, logged_columns
from hallsym.families import adapted, build, default_model
from hallsym.log import Log, usable
from hallsym.model import Inspection, Model


@dataclass(frozen=True, eq=False)
class Prepared:
    """A log as its model reads it; `mounted`: how an inspection found its channels wired."""

    log: Log
    model: Model
    notes: tuple[str, ...]
    mounted: Inspection

    @property
    def wiring(self) -> Wiring | None:
        """The wiring that was found by inspection."""
        return self.mounted.wiring


def model_of(
    log: Log,
    model: str | Model | None,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
) -> Model:
    """Return the model that is fitted to a log; arguments as for `fit`."""
    if isinstance(model, Model):
        return adapted(model, tuple(effects), parameters or {}, own)
    name = model or default_model(log.meta)
    return build(name, meta=log.meta, added=tuple(effects), parameters=parameters, own=own)


def prepared(log: Log, model: Model, *, drop_bad: bool) -> Prepared:
    """Return a log that was checked, without bad samples if `drop_bad`. Raises `InputError` for others."""
    log, notes = usable(log, logged_columns(model), drop_bad=drop_bad, rails=not knows_rails(model))
    mounted = model.inspect(model, log) if model.inspect else Inspection()
    notes = [*notes, *mounted.notes]
    return Prepared(as_read(log, model, mounted.wiring), model, tuple(notes), mounted)


def held_out(log: Log, holdout: Sequence[int]) -> tuple[int, ...]:
    """Return held-out runs, all of them in the log and not all of the log. Raises `InputError` for others."""
    unknown = [run for run in holdout if run not in log.runs]
    if unknown:
        raise InputError(f"Held-out run {unknown[0]} is not in the log; its runs are {runs_said(log.runs)}.")
    if holdout and set(log.runs) <= set(holdout):
        raise InputError("Every run is held out; leave at least one to fit.")
    return tuple(holdout)


def runs_said(runs: Sequence[int]) -> str:
    """Return runs as words; of many the first two and the last."""
    return ", ".join(map(str, runs)) if len(runs) <= 8 else f"{runs[0]}, {runs[1]}, ... {runs[-1]}"
