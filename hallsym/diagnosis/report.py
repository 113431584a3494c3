"""The Diagnosis, put together from what the stages found. Nothing is decided here."""

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np

from hallsym.diagnosis.confusable import Confusable, smaller_findings
from hallsym.diagnosis.curve_words import shape
from hallsym.diagnosis.decoded_errors import decoded_errors, waves
from hallsym.diagnosis.gap import worth_reporting
from hallsym.diagnosis.localisation import Located, located
from hallsym.diagnosis.model_error import model_error
from hallsym.diagnosis.noise import LARGER, noise_text, with_noise
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import (
    Diagnosis,
    FoundEffect,
    Gap,
    LogRecord,
    Metric,
    NoiseFinding,
    NoiseFloor,
    Shrinkage,
    Sizes,
)
from hallsym.diagnosis.remainder import Unexplained
from hallsym.diagnosis.residual_table import both
from hallsym.diagnosis.selection import Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.shares import sizes
from hallsym.diagnosis.validation import Validation
from hallsym.diagnosis.verdict import QUIET, WITH_REST, Verdict, closed
from hallsym.diagnosis.words import gap_text, gap_unit, percent
from hallsym.estimation.calibration import Fit
from hallsym.families import added_effects
from hallsym.log.quality.gains import listed


def report(
    setup: Setup,
    selection: Selection,
    found: Validation,
    effects: tuple[FoundEffect, ...],
    verdict: Verdict,
    alike: Confusable,
    noise: NoiseFinding | None = None,
) -> Diagnosis:
    """Return the diagnosis.

    `effects`: what was found; `alike`: what the log cannot tell apart; `noise`: that is left.
    """
    quiet = verdict in QUIET
    named = () if quiet else effects
    after = found.before.metric if quiet else found.metric
    metric = Metric(found.before.metric, after, found.floor.metric)
    share = closed(metric.before, metric.after, metric.floor)
    loud = noise if noise is not None and noise.larger and verdict not in WITH_REST else None
    where, rest = _located(setup, selection, found, verdict, loud)
    left = unexplained(rest, 1 - share) if rest else None
    gap_after = found.before.gap if quiet else _gap_after(found)
    unit = gap_unit(setup.fit.model.pose)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(verdict, named, alike.instead_of, metric, unit, setup.held_out, noise, left),
        held_out=setup.held_out,
        noise_floor=NoiseFloor(found.floor_by_output, _source(setup.fit)),
        gap_before=found.before.gap,
        gap_after=gap_after,
        metric=metric,
        shrinkage=_shrinkage(found, metric, share, quiet),
        ranked=alike.ranked,
        groups=alike.groups,
        effects=named,
        where=where.statements,
        shares=where.shares,
        size=_size(setup, found, where, loud is not None),
        remaining=rest.statements if rest else (),
        unexplained=left,
        model_error=model_error(setup, found, gap_after, after, left, alike),
        separate_by=alike.separate,
        validation_runs=setup.holdout,
        not_testable=selection.not_testable,
        smaller_findings=smaller_findings(setup, selection, found, effects if quiet else ()),
        threshold=setup.threshold,
        model=setup.fit.model.name,
        log=_log(setup),
        notes=_notes(setup, found, verdict == "no gap"),
        seconds=perf_counter() - setup.began,
        versions=dict(setup.fit.versions),
        waves=waves(found.start.base, found.base if named else None),
        next_step=() if quiet else next_step(setup, found),
        noise=noise,
        significance=selection.significance,
    )


def _shrinkage(found: Validation, metric: Metric, share: float, quiet: bool) -> Shrinkage:
    """Return how far the gap shrinks; a channel assignment and faults of samples count by what they are."""
    added, judged = len(found.base.p) - len(found.start.base.p), found.judged
    if quiet or judged is None:
        return Shrinkage(1 - metric.after / metric.before, None, share, 0 if quiet else added)
    start = found.start
    held = [u for u in range(len(start.output)) if u not in set(start.fitted.tolist())]
    rewired = start.gap(np.array(held)) / found.before.metric if found.miswired and held else 1.0
    scale = found.metric / found.after.metric * min(rewired, 1.0)
    return Shrinkage(
        1 - scale * (1 - judged.value), judged.interval(scale), share, added, judges=len(judged.before)
    )


def unexplained(found: Located, share: float) -> Unexplained:
    """Return what is left, as `located` found it; `share`: part of the gap above the noise floor."""
    first = found.statements[0] if found.statements else None
    curve = found.curves[0] if found.curves else None
    return Unexplained(
        share=share,
        by=first.by if first else None,
        at=first.at if first else None,
        of_it=first.share if first else None,
        text=first.text if first else "it goes with no sensor, coordinate, frequency or run above chance",
        curve=shape(curve, found.fitted) if curve and found.fitted else None,
    )


def _log(setup: Setup) -> LogRecord:
    log = setup.fit.log
    return LogRecord(
        path=log["path"],
        sha256=log["sha256"],
        rows=log["rows"],
        runs=log["runs"],
        holdout=tuple(log["holdout"]),
        span={column: (low, high) for column, (low, high) in log["span"].items()},
        runs_fitted=len(setup.runs),
    )


def _gap_after(found: Validation) -> Gap:
    """Return the gap with everything that was found; faults of samples count by their power."""
    gap, share = found.cured.gap, found.metric / found.cured.metric
    return Gap({c: v * share for c, v in gap.rmse.items()}, gap.peak)


def _located(
    setup: Setup, selection: Selection, found: Validation, verdict: Verdict, loud: NoiseFinding | None
) -> tuple[Located, Located | None]:
    """Return where the gap lies and, if it is unexplained, where the rest lies.

    Faults of samples count by their power over all of the excess. `loud`: noise that is larger than its
    floor; the excess is what exceeds that, for noise lies nowhere.
    """
    start, runs = found.start.base, setup.base.log.runs
    if loud is not None:
        start = with_noise(start, loud)
    plain = start.on_all
    floor = found.floor.metric * (1.0 if loud is None else loud.ratio)
    if found.before.metric > floor * (1 + setup.policy.negligible):
        screened, noisy = selection.screened_at(found.start.base), verdict in QUIET
        gap = located(plain, runs, screened, found.faults, found.variance, noisy=noisy)
    else:
        gap = Located((), (), *both(plain, runs))
    if verdict not in WITH_REST:
        return gap, None
    if found.base is start:
        return gap, gap
    return gap, located(found.base, runs, selection.screened_at(found.base))


def _size(setup: Setup, found: Validation, where: Located, loud: bool) -> Sizes:
    """Return how large the gap is over the noise floor, channels as they were logged.

    `loud`: whether `where` holds it against noise that is larger than the floor.
    """
    start = setup.as_logged(found.start.base)
    fitted, held = both(start, setup.base.log.runs) if setup.miswired or loud else (where.fitted, where.held)
    errors = {"fitted": decoded_errors(start, setup.runs), "held_out": found.before}
    return sizes({"fitted": fitted, "held_out": held}, errors, setup.fit.noise_floor)


def _notes(setup: Setup, found: Validation, quiet: bool) -> tuple[str, ...]:
    """Return the notes of the fit, and what a noise floor needs said that the log contradicts."""
    notes = list(setup.fit.notes)
    if found.floor_was is not None:
        notes.append(
            f"The estimated noise was {found.floor_was:.3g} x the error with the effects found: a pattern "
            "from sample to sample was taken for noise. That error serves as the noise floor; state the "
            "noise (--noise) if you know it."
        )
    if quiet and found.before.metric > worth_reporting(found.floor, setup.threshold, setup.policy):
        times = found.before.metric / found.floor.metric
        notes.append(
            f"The error is {times:.3g} x the {'stated' if found.floor.stated else 'estimated'} noise and "
            "depends on nothing that the log holds: the noise is larger than that, or more correlated in "
            "time."
        )
    return tuple(dict.fromkeys(notes))


def _source(fit: Fit) -> str:
    given = {s.source == "given" for s in fit.noise.sigmas.values()}
    return "stated and estimated" if len(given) == 2 else "stated" if given == {True} else "estimated"


# -- sentences, and the next command -----------------------------------------------------------------------


def sentence(
    verdict: str,
    effects: Sequence[FoundEffect],
    instead_of: Callable[[str], Sequence[str]],
    gap: Metric,
    unit: tuple[float, str],
    held_out: str,
    noise: NoiseFinding | None,
    left: Unexplained | None,
) -> str:
    """Return the diagnosis in one or two sentences; gaps in `unit`, the factor and name a person reads.

    `instead_of`: effect -> what the log cannot tell from it. `held_out`: what judges. `noise`: that is left;
    `left`: what has no cause.
    """
    judges = f"{held_out}s"
    before, after, floor = (gap_text(v, unit) for v in (gap.before, gap.after, gap.floor))
    small = gap.before <= gap.floor * (1 + POLICY.negligible)
    if verdict == "no gap":
        alone = f"noise alone gives {floor}"
        return f"No gap. The error on the {judges} is {before}; {alone}" + (
            "." if small else ", and the difference is not worth reporting."
        )
    times = gap.before / max(gap.floor, 1e-300)
    said = f"The error on the {judges} is {before}, {times:.3g} x the noise floor"
    if verdict == LARGER and noise is not None:
        return f"{LARGER.capitalize()}. {said}, and that is noise: {noise_text(noise, stated=True)}."
    if not effects and small:
        hidden = f"The error on the {judges} is {before}, no more than noise alone gives ({floor})"
        return f"{hidden}, but the residual of the readings has a shape; no known effect explains it."
    if not effects:
        return f"{said}; no known effect explains it."
    named = listed([_with_others(e.name, instead_of(e.name)) for e in effects])
    if verdict == "behaves like":
        first = next(e for e in effects if e.behaves_like or e.at_bound)
        why = (
            f"a flexible alternative predicts other {held_out.split(' ', 1)[1]}s better"
            if first.behaves_like
            else "parameters of it ended at their bounds"
        )
        return (
            f"{said}. The machine behaves like {first.name}, but {why}, so the cause is not known. "
            f"With {named} it falls to {after}."
        )
    if verdict == "partly explained" and left is not None:
        remains = f"{percent(left.share)} of the excess over the noise has no known cause"
        where = f"Of what is left, {left.text}" if left.by else left.text.capitalize()
        return f"{said}. With {named} it falls to {after}; {remains}. {where}."
    rest = "" if verdict == "explained" else "; the rest has no known cause"
    open_ = closed(gap.before, gap.after, gap.floor) < 1 - POLICY.minor
    if verdict == "explained" and open_ and noise is not None and noise.larger:
        rest = f"; what is left follows nothing that is logged: noise, {noise.ratio:.3g} x the noise floor"
    return f"{said}. With {named} it falls to {after}{rest}."


def _with_others(name: str, others: Sequence[str]) -> str:
    """Return an effect with those that the log cannot tell from it: `time_skew (or first_order_lag)`."""
    return f"{name} (or {' or '.join(others)})" if others else name


def next_step(setup: Setup, found: Validation) -> tuple[str, ...]:
    """Return the arguments of `hallsym fit LOG` that fit the model with the effects found, in their order.

    The pieces of a split recording are no runs of the log on disk, so they are not held out.
    """
    variants = [e.exact.score.variant for e in found.effects]
    texts = [v.text for v in variants if v.text]
    if not texts:
        return ()
    model = setup.fit.model
    words = ["--model", model.name]
    for text in (*added_effects(model), *texts):
        words += ["--effect", text]
    if not setup.split:
        words += ["--holdout", ",".join(map(str, setup.holdout))]
    return (*words, *(["--resolve-wiring"] if setup.miswired else []))
