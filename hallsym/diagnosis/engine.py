"""`diagnose`: where the gap is, which effect causes it, and how far it shrinks with that effect.

Each stage takes typed records and returns one:

    prepare    the model fitted on the fit runs                                   -> Setup
    select     screening by scores, greedy search with exact refits               -> Selection
    validate   the selected effects on the holdout runs, faults of samples        -> Validation
    decide     the residual noise, the verdict                                    -> Verdict
    confusable effects that are confusable, recordings that separate them         -> Confusable
    report     all of these                                                       -> Diagnosis
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hallsym.diagnosis.facts import change_points
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.report import Confusable, Price, confusable, findings, report
from hallsym.diagnosis.residual_table import residual_table
from hallsym.diagnosis.residuals import Base, forget_candidates
from hallsym.diagnosis.selection import select
from hallsym.diagnosis.setup import Setup, prepare
from hallsym.diagnosis.survey import noise_of_rest
from hallsym.diagnosis.validation import QUIET, decide, validate
from hallsym.estimation.calibration import Fit
from hallsym.families.recording import corrected
from hallsym.log import as_log
from hallsym.model import Effect, Model


@dataclass(frozen=True, eq=False)
class Examined:
    """A diagnosis with the `fit` that was diagnosed and the models `before` and `after`.

    `after` holds the effects that were found; it is None where the verdict names none.
    """

    diagnosis: Diagnosis
    fit: Fit
    before: Base
    after: Base | None


def diagnose(
    log: Any,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    corrections: str | Sequence[str] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    budget: float | None = None,
    policy: Policy = POLICY,
    price: Price | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Diagnose the gap between `model` and the machine that recorded `log`.

    `model`: a name, a Model, or a Fit whose model is taken; the log's own base model by default. `holdout`:
    runs to judge on; the log's own, else every fifth. `effects`: the user's own, beside the catalogue.
    `corrections`: mistakes of the recording to undo, as for `fit`. `threshold`: relative decrease of the gap
    metric that counts; the log's own, else 5 %. `budget`: seconds within which it ends with the result
    so far and a note. `policy`: all other thresholds. `price`: says what an effect costs in C
    (`hallsym.codegen.price`); without it the `cost` of an effect is its parameters and signals.

    Raises `InputError` for a log that the model cannot have produced or with too few runs to hold any out.
    """
    log = as_log(log, model.columns, model.read_with) if isinstance(model, Fit) else as_log(log)
    log = corrected(log, corrections)
    return examine(
        prepare(
            log, model, holdout=holdout, effects=effects, threshold=threshold, drop_bad=drop_bad,
            budget=budget, policy=policy, on_progress=on_progress,
        ),
        price,
    ).diagnosis  # fmt: skip


def examine(setup: Setup, price: Price | None = None) -> Examined:
    """Diagnose as `diagnose` does and return the fitted models too, which a page draws."""
    selection = select(setup.part)
    forget_candidates(selection.fit.base)
    others = without_events(setup, selection.fit.base.on_all)
    if others is not setup and not setup.over() and (again := select(others.part)).effects:
        setup, selection = others, again
    selection = selection.on_all(setup)
    if selection.stopped:
        setup = replace(setup, fit=setup.fit.changed(notes=(*setup.fit.notes, selection.stopped)))
    found = validate(setup, selection)
    noise = noise_of_rest(found.counted, setup.runs)
    verdict = decide(setup, found, noise)
    named = findings(setup, found, price)
    quiet = verdict in QUIET
    confused = Confusable((), (), ()) if quiet else confusable(setup, found, named, verdict)
    diagnosis = report(setup, selection, found, named, verdict, confused, noise)
    return Examined(diagnosis, setup.fit, setup.base, found.base if diagnosis.effects else None)


def without_events(setup: Setup, base: Base) -> Setup:
    """Return the setup with holdout runs that step at `base` moved to the fitted ones.

    An offset that changes within a run is known from that run alone. The nearest other run takes its place,
    the later one of two, since a step shows after it.
    """
    tables = (residual_table(base, frozenset(runs)) for runs in (setup.runs, setup.holdout))
    stepped = {s.run for s in change_points(*(t for t in tables if t)) if s.p_value < setup.policy.certain}
    free = [run for run in setup.runs if run not in stepped]
    if setup.split or not free or stepped.isdisjoint(setup.holdout):
        return setup
    instead = (
        run if run not in stepped else min(free, key=lambda r: (abs(r - run), -r)) for run in setup.holdout
    )
    judging = tuple(dict.fromkeys(instead))
    return replace(setup, holdout=judging, base=replace(setup.base, holdout=frozenset(judging)))
