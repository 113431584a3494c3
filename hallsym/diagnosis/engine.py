"""`diagnose`: where the gap is, which effect makes it, and how far it shrinks once that effect is added.

The stages lead one way, each from typed records to a typed record:

    prepare    the model fitted on the fit runs                                   -> Setup
    select     screening by scores, greedy search with exact refits               -> Selection
    validate   the selected effects on the holdout runs, faults of samples        -> Validation
    decide     the verdict                                                        -> Verdict
    confusable effects the log cannot tell apart, recordings that separate them   -> Confusable
    report     everything of these                                                -> Diagnosis
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from hallsym.diagnosis import holdout_pieces
from hallsym.diagnosis.base import Base
from hallsym.diagnosis.confusable import Confusable, confusable
from hallsym.diagnosis.effect import Effect
from hallsym.diagnosis.findings import findings
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.report import report
from hallsym.diagnosis.selection import select
from hallsym.diagnosis.setup import Setup, base_of, floor_of
from hallsym.diagnosis.validation import validate
from hallsym.diagnosis.verdict import decide
from hallsym.errors import InputError, counted
from hallsym.estimation import fit, noise_of
from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import logged_columns
from hallsym.families import build, default_model
from hallsym.log import Log, clean_log
from hallsym.log.phase import continuous
from hallsym.model import Model

Say = Callable[[str], None]


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
    policy: Policy = POLICY,
    on_progress: Say | None = None,
) -> Diagnosis:
    """Diagnose the gap between `model` and the machine that recorded `log`.

    `model`: a name, a Model, or a Fit whose model is taken; the log's own base model by default. `holdout`:
    runs to judge on; the log's own, else every fifth. `effects`: the user's own, beside the catalogue.
    `threshold`: relative decrease of the gap metric that counts; the log's own, else 5 %. `policy`: all other
    thresholds.

    Raises `InputError` for a log that the model cannot have produced or with too few runs to hold any out.
    """
    return examine(
        prepare(
            log, model, holdout=holdout, effects=effects, threshold=threshold, drop_bad=drop_bad,
            policy=policy, on_progress=on_progress,
        )
    ).diagnosis  # fmt: skip


def examine(setup: Setup) -> Examined:
    """Diagnose as `diagnose` does and return the fitted models too, which a page draws."""
    selection = select(setup)
    found = validate(setup, selection)
    verdict = decide(setup, found)
    named = findings(setup, found)
    quiet = verdict == "no gap"
    alike = Confusable((), (), ()) if quiet else confusable(setup, found, named, verdict)
    diagnosis = report(setup, selection, found, named, verdict, alike)
    return Examined(diagnosis, setup.fit, setup.base, found.base if diagnosis.effects else None)


def prepare(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    policy: Policy = POLICY,
    on_progress: Say | None = None,
) -> Setup:
    """Fit the model on the fit runs: what every stage of a diagnosis, and a self-test, starts from.

    Arguments as for `diagnose`.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    model, timed = _built(log, model), "t_s" in log.columns
    level, whole = _threshold(log, threshold, policy), log
    pieces = None
    if holdout is None:
        log, pieces = _pieces(log, model, policy)
    held = pieces or _holdout(log, holdout, policy)
    say("fitting the model")
    loss = "auto" if timed or not pieces else "none"
    log, result = _fitted(log, _inspecting(model, whole) if pieces else model, held, drop_bad, say, loss)
    result = replace(result, model=model)
    base = base_of(log, result)
    return Setup(
        log=log,
        fit=result,
        base=replace(base, model=model.family.direct(base.model), timed=timed),
        runs=[r for r in base.log.runs if r not in held],
        holdout=held,
        threshold=level,
        split=bool(pieces),
        floor=floor_of(result, base.pose_weights),
        catalogue=(*model.family.catalogue, *effects),
        policy=policy,
        say=say,
        began=began,
    )


def _built(log: Log, model: str | Model | Fit | None) -> Model:
    if isinstance(model, Fit):
        model = model.model
    return model if isinstance(model, Model) else build(model or default_model(log.meta), meta=log.meta)


def _pieces(log: Log, model: Model, policy: Policy) -> tuple[Log, tuple[int, ...] | None]:
    """Split a recording of too few runs if runs have no offsets; return the pieces to hold out."""
    few = len(log.runs) < policy.fewest_runs and log.rows >= holdout_pieces.FEWEST
    if not few or model.zeros or log.meta.holdout:
        return log, None
    # a turn goes on from piece to piece: a short turn of the reference counts from one zero
    log = continuous(replace(log, noise=noise_of(log, model)), model)
    return holdout_pieces.split(log, None if holdout_pieces.TIME in log.columns else _spikes(log, model))


def _spikes(log: Log, model: Model) -> np.ndarray | None:
    """Return which knots are spikes: judged among their neighbours, which a group of knots separates."""
    try:
        found = fit(log, model, solver="direct", resolve_wiring=True)
    except InputError:
        return None  # the fit of the groups raises it again
    if found.keep is None or found.source is None:
        return None
    return np.concatenate([found.keep(block) for block in found.source.blocks()]) == 0


def _inspecting(model: Model, whole: Log) -> Model:
    """Return the model with inspection notes of the `whole` recording, since its pieces are no runs."""
    inspect = model.inspect
    if not inspect:
        return model
    return replace(model, inspect=lambda m, log: replace(inspect(m, log), notes=inspect(m, whole).notes))


def _fitted(
    log: Log, model: Model, held: tuple[int, ...], drop_bad: bool, say: Say, loss: str
) -> tuple[Log, Fit]:
    """Fit the model; samples that no fit can use are left out, and a note says so."""

    def fitted(drop: bool) -> Fit:
        return fit(
            log, model, solver="direct", holdout=held, loss=loss, resolve_wiring=True, drop_bad=drop,
            on_progress=say,
        )  # fmt: skip

    if not drop_bad:
        try:
            return log, fitted(False)
        except InputError:
            if clean_log(log, logged_columns(model)).rows == log.rows:
                raise
    # a reading at its rail calibrates nothing, but shows the rail
    return clean_log(log, logged_columns(model), rails=False), fitted(True)


def _holdout(log: Log, holdout: Sequence[int] | None, policy: Policy) -> tuple[int, ...]:
    """Return the holdout runs: as asked, the log's own, else every fifth."""
    if holdout is None:
        every = policy.holdout_every
        holdout = log.meta.holdout or log.runs[every // 2 :: every]
    if not holdout or len(log.runs) - len(set(holdout)) < 2:
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


def _threshold(log: Log, threshold: float | None, policy: Policy) -> float:
    level = threshold if threshold is not None else (log.meta.gap_threshold_rel or policy.worth_reporting)
    if not 0 < level < 1:
        raise InputError(f"Input threshold of diagnose must be between 0 and 1; instead received {level:g}.")
    return float(level)
