"""`diagnose`: where the gap is, which effect makes it, and how far it shrinks once that effect is added.

The base model is fitted on the fit runs. Effects are then added greedily: one pass scores the catalogue, the
promising ones are refitted exactly, the best is kept if it lowers the gap metric enough in cross-validation
within the fit runs. Only the final set is judged, once, on the held-out runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from hallsym.diagnosis import holdout_pieces
from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Effect
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.report import report
from hallsym.diagnosis.search import Search, base_of, floor_of
from hallsym.errors import InputError, counted
from hallsym.estimation import fit, noise_of
from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import logged_columns
from hallsym.families import build, default_model
from hallsym.log import Log, clean_log
from hallsym.log.phase import continuous
from hallsym.model import Model

THRESHOLD = 0.05
"""Relative decrease of the gap metric from which on a gap is worth reporting."""
HOLD_EVERY = 5
"""Of runs without a named holdout every fifth is held out."""
FEWEST_RUNS = 3


@dataclass(frozen=True, eq=False)
class Examined:
    """A diagnosis with what it rests on: the `fit` that was diagnosed, the model `before` and `after`.

    `after` holds the effects that were found; it is None where the verdict names none.
    """

    diagnosis: Diagnosis
    fit: Fit
    before: Base
    after: Base | None


def diagnose(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Diagnose the gap between `model` and the machine that recorded `log`.

    `model`: a name, a Model, or a Fit whose model is taken; the log's own base model by default. `holdout`:
    runs to judge on; the log's own, else every fifth. `effects`: the user's own, beside the catalogue.
    `threshold`: relative decrease of the gap metric that counts; the log's own, else 5 %.

    Raises `InputError` for a log that the model cannot have produced or with too few runs to hold any out.
    """
    return examine(
        log, model, holdout=holdout, effects=effects, threshold=threshold, drop_bad=drop_bad,
        on_progress=on_progress,
    ).diagnosis  # fmt: skip


def examine(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> Examined:
    """Diagnose as `diagnose` does and return the fitted models too, which a page draws."""
    began, say = perf_counter(), on_progress or (lambda _: None)
    model, timed = _built(log, model), "t_s" in log.columns
    whole = log
    log, pieces = _pieces(log, model) if holdout is None else (log, None)
    apart = pieces or _holdout(log, holdout)
    level = _threshold(log, threshold)
    say("fitting the model")
    log, result = _fitted(log, model, apart, drop_bad, say, "auto" if timed or not pieces else "none")
    wiring = result.wiring
    base = base_of(log, result)
    base = replace(base, model=model.family.direct(base.model), timed=timed)
    runs = [r for r in base.log.runs if r not in apart]
    search = Search(
        base, runs, (*model.family.catalogue, *effects), level, floor_of(result, base.pose_weights), say
    )
    search.run()
    said = report(search, log, result, apart, wiring, level, perf_counter() - began)
    if pieces:  # which the log on disk does not have
        at = said.next_step.index("--holdout") if said.next_step else 0
        notes = _of_whole(said.notes, model, log, whole)
        said = replace(said, next_step=said.next_step[:at] + said.next_step[at + 2 :], notes=notes)
    return Examined(said, result, base, search.now.base if said.effects else None)


def _built(log: Log, model: str | Model | Fit | None) -> Model:
    if isinstance(model, Fit):
        model = model.model
    return model if isinstance(model, Model) else build(model or default_model(log.meta), meta=log.meta)


def _pieces(log: Log, model: Model) -> tuple[Log, tuple[int, ...] | None]:
    """Take a recording of too few runs to pieces, where runs have nothing of their own."""
    if model.zeros or log.meta.holdout or len(log.runs) >= FEWEST_RUNS or log.rows < holdout_pieces.FEWEST:
        return log, None
    # a turn goes on from piece to piece: a short turn of the reference counts from one zero
    log = continuous(replace(log, noise=noise_of(log, model)), model)
    return holdout_pieces.split(log, None if holdout_pieces.TIME in log.columns else _spikes(log, model))


def _spikes(log: Log, model: Model) -> np.ndarray | None:
    """Which knots are spikes, judged where they are neighbours, as in their groups they are not."""
    try:
        found = fit(log, model, solver="direct", resolve_wiring=True)
    except InputError:
        return None  # the fit of the groups says it of what is left
    if found.keep is None or found.source is None:
        return None
    return np.concatenate([found.keep(block) for block in found.source.blocks()]) == 0


def _of_whole(notes: Sequence[str], model: Model, log: Log, whole: Log) -> tuple[str, ...]:
    """Return notes with what an inspection says of the recording, not of its pieces, which are no runs."""
    if not model.inspect:
        return tuple(notes)
    of_pieces = model.inspect(model, log).notes
    true = model.inspect(model, whole).notes
    return tuple(dict.fromkeys((*(note for note in notes if note not in of_pieces), *true)))


def _fitted(
    log: Log,
    model: Model,
    apart: tuple[int, ...],
    drop_bad: bool,
    say: Callable[[str], None],
    loss: str = "auto",
) -> tuple[Log, Fit]:
    """Fit the model; samples that no fit can use are left out, which is then noted."""

    def fitted(source: Log, drop: bool) -> Fit:
        return fit(
            source, model, solver="direct", holdout=apart, loss=loss, resolve_wiring=True, drop_bad=drop,
            on_progress=say,
        )  # fmt: skip

    if not drop_bad:
        try:
            return log, fitted(log, False)
        except InputError as error:
            refused = error
    cleaned = clean_log(log, logged_columns(model))
    if not drop_bad and cleaned.rows == log.rows:
        raise refused
    # a reading at its rail calibrates nothing, but shows the rail
    whole = clean_log(log, logged_columns(model), rails=False)
    return whole, fitted(log, True)


def _holdout(log: Log, holdout: Sequence[int] | None) -> tuple[int, ...]:
    """Held-out runs: as asked, the log's own, else every fifth."""
    if holdout is None:
        holdout = log.meta.holdout or log.runs[HOLD_EVERY // 2 :: HOLD_EVERY]
    if len(log.runs) < FEWEST_RUNS or len(log.runs) - len(set(holdout)) < 2 or not holdout:
        short, many = log.rows < holdout_pieces.FEWEST, counted(len(log.runs), "run")
        raise InputError(
            f"{log.name} has {many}, too few to hold any out and still choose an effect on the others "
            "(2 to fit and 1 to judge on at least); record more runs or "
            + (
                f"at least {holdout_pieces.FEWEST} samples (it has {log.rows})."
                if short
                else "split a long one."
            )
        )
    return tuple(holdout)


def _threshold(log: Log, threshold: float | None) -> float:
    level = threshold if threshold is not None else (log.meta.gap_threshold_rel or THRESHOLD)
    if not 0 < level < 1:
        raise InputError(f"Input threshold of diagnose must be between 0 and 1; instead received {level:g}.")
    return float(level)
