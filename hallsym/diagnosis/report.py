"""The Diagnosis, put together from what the stages found. Nothing is decided here."""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

from hallsym.diagnosis.confusable import Confusable, smaller_findings
from hallsym.diagnosis.curve_data import unexplained
from hallsym.diagnosis.decoded_errors import block_errors, interval
from hallsym.diagnosis.gap import worth_reporting
from hallsym.diagnosis.gap_size import sizes
from hallsym.diagnosis.localisation import Located, both, located
from hallsym.diagnosis.record import (
    Diagnosis,
    FoundEffect,
    Gap,
    Metric,
    NoiseFloor,
    Shrinkage,
)
from hallsym.diagnosis.selection import Selection
from hallsym.diagnosis.sentences import floor_lowered_text, next_step, sentence, shapeless_text
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.diagnosis.verdict import Verdict, closed
from hallsym.diagnosis.waves import waves
from hallsym.diagnosis.words import gap_unit
from hallsym.estimation.calibration import Fit


def report(
    setup: Setup,
    selection: Selection,
    found: Validation,
    effects: tuple[FoundEffect, ...],
    verdict: Verdict,
    alike: Confusable,
) -> Diagnosis:
    """Return the diagnosis. `effects`: what was found; `alike`: what the log cannot tell apart."""
    quiet = verdict == "no gap"
    named = () if quiet else effects
    after = found.before.metric if quiet else found.metric
    metric = Metric(found.before.metric, after, found.floor.metric)
    share = closed(metric.before, metric.after, metric.floor)
    where, rest = _located(setup, selection, found, verdict)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(verdict, named, alike.groups, metric, gap_unit(setup.fit.model.pose)),
        noise_floor=NoiseFloor(found.floor_by_output, _source(setup.fit)),
        gap_before=Gap(**found.before.gap()),
        gap_after=Gap(**found.before.gap()) if quiet else _gap_after(found),
        metric=metric,
        shrinkage=Shrinkage(
            value=1 - metric.after / metric.before,
            interval=(0.0, 0.0) if quiet else interval(found.before, found.after),
            share_closed=share,
            parameters_added=0 if quiet else len(found.base.p) - len(found.start.base.p),
        ),
        ranked=alike.ranked,
        groups=alike.groups,
        effects=named,
        where=where.statements,
        shares=where.shares,
        size=_size(setup, found, where),
        remaining=rest.statements if rest else (),
        unexplained=unexplained(rest, 1 - share) if rest else {},
        separate_by=alike.separate,
        validation_runs=setup.holdout,
        not_testable=selection.not_testable,
        smaller_findings=smaller_findings(setup, selection, found, effects if quiet else ()),
        threshold=setup.threshold,
        model=setup.fit.model.name,
        log={**setup.fit.log, "runs_fitted": len(setup.runs)},
        notes=_notes(setup, found, quiet),
        seconds=perf_counter() - setup.began,
        versions=dict(setup.fit.versions),
        waves=waves(found.start.base, found.base if named else None),
        next_step=() if quiet else next_step(setup, found),
    )


def _gap_after(found: Validation) -> Gap:
    """Return the gap with everything that was found; faults of samples count by their power."""
    gap, share = found.cured.gap(), found.metric / found.cured.metric
    return Gap({c: v * share for c, v in gap["rmse"].items()}, gap["peak"])


def _located(
    setup: Setup, selection: Selection, found: Validation, verdict: Verdict
) -> tuple[Located, Located | None]:
    """Return where the gap lies and, if it is unexplained, where the rest lies.

    Faults of samples count by their power over all of the excess.
    """
    start, runs = found.start.base, setup.base.log.runs
    plain = replace(start, keep=None)
    if found.before.metric > found.floor.metric * (1 + setup.policy.floor_known):
        gap = located(plain, runs, selection.scores_at(start), found.faults, found.variance)
    else:
        gap = Located((), (), *both(plain, runs))
    if verdict != "unexplained":
        return gap, None
    if found.base is start:
        return gap, gap
    return gap, located(found.base, runs, selection.scores_at(found.base))


def _size(setup: Setup, found: Validation, where: Located) -> dict[str, Any]:
    """Return how large the gap is, channels as they were logged."""
    start = setup.as_logged(found.start.base)
    fitted, held = both(start, setup.base.log.runs) if setup.miswired else (where.fitted, where.held)
    errors = {"fitted": block_errors(start, setup.runs, setup.log.rows, None), "held_out": found.before}
    return sizes({"fitted": fitted, "held_out": held}, errors, setup.fit.noise_floor)


def _notes(setup: Setup, found: Validation, quiet: bool) -> tuple[str, ...]:
    notes: Sequence[str] = setup.fit.notes
    if found.floor_was is not None:
        notes = (*notes, floor_lowered_text(found.floor_was))
    if quiet and found.before.metric > worth_reporting(found.floor, setup.threshold, setup.policy):
        times = found.before.metric / found.floor.metric
        notes = (*notes, shapeless_text(times, found.floor.stated))
    return tuple(dict.fromkeys(notes))


def _source(fit: Fit) -> str:
    given = {s.source == "given" for s in fit.noise.sigmas.values()}
    return "stated and estimated" if len(given) == 2 else "stated" if given == {True} else "estimated"
