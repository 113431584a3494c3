"""The Diagnosis, put together from what the stages found. Nothing is decided here."""

from collections.abc import Callable, Sequence
from time import perf_counter

import casadi as ca
import numpy as np

from hallsym.codegen import cost_of
from hallsym.codegen.operations import graph
from hallsym.diagnosis.confusable import Confusable, smaller_findings
from hallsym.diagnosis.curve_words import shape
from hallsym.diagnosis.decoded_errors import decoded_errors, waves
from hallsym.diagnosis.faults import Fault, wiring_p, wirings
from hallsym.diagnosis.localisation import Located, located
from hallsym.diagnosis.noise import LARGER, noise_text, with_noise
from hallsym.diagnosis.record import (
    Diagnosis,
    Estimate,
    FoundEffect,
    Gap,
    LogRecord,
    Metric,
    ModelLeft,
    NoiseFloor,
    NotExcluded,
    Shrinkage,
    Sizes,
    Unexplained,
)
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.residual_table import both
from hallsym.diagnosis.selection import Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.shares import sizes
from hallsym.diagnosis.validation import QUIET, Held, Validation, Verdict, closed
from hallsym.diagnosis.words import SHOWN, gap_text, gap_unit
from hallsym.errors import InputError, counted
from hallsym.estimation.calibration import Fit
from hallsym.estimation.residual_noise import ResidualNoise
from hallsym.families import added_effects
from hallsym.families.faults import FAULTS
from hallsym.log.quality.gains import listed
from hallsym.model import Model


def report(
    setup: Setup,
    selection: Selection,
    found: Validation,
    effects: tuple[FoundEffect, ...],
    verdict: Verdict,
    alike: Confusable,
    noise: ResidualNoise | None = None,
) -> Diagnosis:
    """Return the diagnosis.

    `effects`: what was found; `alike`: what the log cannot tell apart; `noise`: that is left.
    """
    quiet = verdict in QUIET
    named = () if quiet else effects
    after = found.before.metric if quiet else found.metric
    metric = Metric(found.before.metric, after, found.floor.metric)
    share = closed(metric.before, metric.after, metric.floor)
    loud = noise if noise is not None and noise.larger and verdict != "unexplained" else None
    where, rest = _located(setup, selection, found, verdict, loud)
    left = unexplained(rest, 1 - share) if rest else None
    gap_after = found.before.gap if quiet else _gap_after(found)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(setup, verdict, named, alike.instead_of, metric, noise),
        held_out=setup.held_out,
        noise_floor=NoiseFloor(dict(found.floor.outputs), _source(setup.fit)),
        gap_before=found.before.gap,
        gap_after=gap_after,
        metric=metric,
        shrinkage=_shrinkage(found, metric, share, quiet),
        ranked=alike.ranked,
        groups=alike.groups,
        effects=named,
        where=where.statements,
        size=_size(setup, found, where, loud is not None),
        remaining=rest.statements if rest else (),
        unexplained=left,
        model_error=model_error(setup, found, gap_after, after, rest, left, alike),
        separate_by=alike.separate,
        validation_runs=setup.holdout,
        not_testable=selection.not_testable,
        smaller_findings=smaller_findings(setup, selection, found, effects if quiet else ()),
        threshold=setup.threshold,
        model=setup.fit.model.name,
        log=_log(setup),
        notes=tuple(dict.fromkeys(setup.fit.notes)),
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
    value, interval = 1 - scale * (1 - judged.value), judged.interval(scale)
    return Shrinkage(value, interval, share, added, len(judged.before), judged.policy.fewest)


def unexplained(found: Located, share: float) -> Unexplained:
    """Return what is left, as `located` found it; `share`: part of the gap above the noise floor."""
    curve = found.curves[0] if found.curves else None
    return Unexplained(share, shape(curve, found.fitted) if curve and found.fitted else None)


def _log(setup: Setup) -> LogRecord:
    log = setup.fit.log
    return LogRecord(
        path=log["path"],
        sha256=log["sha256"],
        rows=log["rows"],
        runs=log["runs"],
        holdout=tuple(log["holdout"]),
        span={column: (low, high) for column, (low, high) in log["span"].items()},
    )


def _gap_after(found: Validation) -> Gap:
    """Return the gap with everything that was found; faults of samples count by their power."""
    gap, share = found.cured.gap, found.metric / found.cured.metric
    return Gap({c: v * share for c, v in gap.rmse.items()}, gap.peak)


def _located(
    setup: Setup, selection: Selection, found: Validation, verdict: Verdict, loud: ResidualNoise | None
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
    if verdict != "unexplained":
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
    floors = {"fitted": setup.floor_fitted.outputs, "held_out": setup.floor.outputs}
    return sizes({"fitted": fitted, "held_out": held}, errors, floors)


def _source(fit: Fit) -> str:
    given = {s.source == "given" for s in fit.noise.sigmas.values()}
    return "stated and estimated" if len(given) == 2 else "stated" if given == {True} else "estimated"


# -- sentences, and the next command -----------------------------------------------------------------------


def sentence(
    setup: Setup,
    verdict: str,
    effects: Sequence[FoundEffect],
    instead_of: Callable[[str], Sequence[str]],
    gap: Metric,
    noise: ResidualNoise | None,
) -> str:
    """Return the diagnosis in one or two sentences.

    `instead_of`: effect -> what the log cannot tell from it. `noise`: that is left.
    """
    judges, unit = f"{setup.held_out}s", gap_unit(setup.fit.model.pose)
    before, after, floor = (gap_text(v, unit) for v in (gap.before, gap.after, gap.floor))
    small = gap.before <= gap.floor * (1 + setup.policy.negligible)
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
    alike = [(e.name, instead_of(e.name)) for e in effects]  # such as time_skew (or first_order_lag)
    named = listed([f"{name} (or {' or '.join(others)})" if others else name for name, others in alike])
    rest = "" if verdict == "explained" else "; the rest has no known cause"
    open_ = closed(gap.before, gap.after, gap.floor) < 1 - setup.policy.minor
    if verdict == "explained" and open_ and noise is not None and noise.larger:
        rest = f"; what is left follows nothing that is logged: noise, {noise.ratio:.3g} x the noise floor"
    return f"{said}. With {named} it falls to {after}{rest}."


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


# -- what a budget takes -------------------------------------------------------------------------------------


def model_error(
    setup: Setup,
    found: Validation,
    gap: Gap,
    metric: float,
    lies: Located | None,
    rest: Unexplained | None,
    alike: Confusable,
) -> ModelLeft:
    """Return what the model leaves beyond the noise, and the models that the log does not exclude.

    `gap`, `metric`: the error that is left on the holdout runs. `lies`, `rest`: where it lies and
    its shape, where it is unexplained.
    """
    floor = found.floor.outputs
    known = metric <= found.floor.metric * (1 + setup.policy.negligible)
    above = {c: float(np.sqrt(max(v**2 - floor[c] ** 2, 0.0))) for c, v in gap.rmse.items()}
    curve = rest.curve if rest else None
    placed = (*setup.base.model.references, *setup.base.model.state)  # the coordinates that a position has
    counts = curve is not None and curve.line and curve.column.removeprefix("d0_") in placed
    share = lies.statements[0].share if lies is not None and lies.statements and counts else 0.0
    left = float(np.sqrt(max(1 - share, 0.0)))
    return ModelLeft(
        rest={c: 0.0 if known else v * left for c, v in above.items()},
        shape_counts=counts,
        candidates=_candidates(found, alike.fits),
    )


def _candidates(found: Validation, fits: tuple[Refitted, ...]) -> tuple[NotExcluded, ...]:
    """Return the named model and those the log does not exclude, each with its probability by BIC."""
    if not fits:
        return ()
    models = found.fit, *fits
    bic = np.array([f.bic(len(f.base.free), found.inflation) for f in models])
    weight = np.exp(-0.5 * (bic - bic.min()))
    return tuple(
        NotExcluded(tuple(added_effects(f.base.model)), f.base.values, float(w))
        for f, w in zip(models, weight / weight.sum(), strict=True)
    )


# -- what was found ------------------------------------------------------------------------------------------


def findings(setup: Setup, found: Validation) -> tuple[FoundEffect, ...]:
    """Return what was found, by share of the excess; a wrong channel assignment wins a tie.

    What does not lower the error on the holdout runs is no finding.
    """
    if found.metric >= found.before.metric:
        return ()
    fit, known = found.fit, np.maximum(np.diag(found.fit.covariance()), 0.0)
    spread = np.sqrt(known * fit.variance(1.0) * found.inflation)  # of the slow averages of what is left
    out = [_effect(found, e, spread) for e in found.effects]
    out += [_fault(setup, found, f) for f in found.faults]
    if setup.miswired:
        out.insert(0, _assignment(setup, found))
    return tuple(sorted(out, key=lambda e: -e.share))


def _effect(found: Validation, held: Held, spread: np.ndarray) -> FoundEffect:
    score, fit = held.exact.score, found.fit
    model, before = fit.base.model, held.without.base.model
    stuck, unseen = fit.at_bound(), fit.unseen()
    index = {n: model.names.index(n) for n in score.model.names if n in model.names and n not in before.names}
    ended = tuple(n for n, j in index.items() if j in stuck)
    blind = [n for n, j in index.items() if j in unseen]
    return FoundEffect(
        name=score.effect.name,
        link=score.effect.link,
        variant=score.variant.label,
        parameters={
            n: Estimate(
                float(fit.base.p[j]),
                None if j in stuck or j in unseen else float(spread[j]),
                model.parameters[j].unit,
            )
            for n, j in index.items()
        },
        p_value=held.p_value,
        shrinkage=held.judged.value,
        interval=held.judged.interval(),
        share=_share(found, held.errors.metric**2 - found.after.metric**2),
        cost=firmware_cost(before, model, fit.base.p),
        text=score.variant.text,
        at_bound=ended,
        note=_note(ended, blind),
    )


def _note(ended: Sequence[str], blind: Sequence[str]) -> str:
    """Return what qualifies an effect: parameters at their bounds or unseen."""
    said = []
    if ended:
        bound = "its bound" if len(ended) == 1 else "their bounds"
        said.append(
            f"{', '.join(ended)} ended at {bound}, so there is no interval; the intervals of other "
            "parameters hold only if the bound is right. Either the bound is wrong for this machine, or "
            "another effect does part of the work."
        )
    if blind:
        said.append(f"No sample of this log depends on {', '.join(blind)}: fixed at the nominal value.")
    return " ".join(said)


def _fault(setup: Setup, found: Validation, fault: Fault) -> FoundEffect:
    scale = found.fault_scale
    return FoundEffect(
        name=fault.name,
        link=fault.record.link,
        variant=fault.text,
        parameters=fault.parameters,
        p_value=min(1.0, fault.p_value * setup.tested),
        shrinkage=1 - scale,
        interval=None,
        share=_share(found, (1 - scale**2) * found.after.metric**2),
        cost="no parameter: a repair, not a model",
        note=_repair(fault.name),
    )


def _share(found: Validation, squares: float) -> float:
    """Return the share of the excess above the floor that `squares` are."""
    excess = max(found.before.metric**2 - found.floor.metric**2, 1e-300)
    return float(np.clip(squares / excess, 0.0, 1.0))


def _assignment(setup: Setup, found: Validation) -> FoundEffect:
    """Return exchanged or inverted channels."""
    model, wiring = setup.base.model, setup.miswired or ()
    swapped = [c for c, (source, _) in zip(model.channels, wiring, strict=True) if source != c]
    flipped = [source for source, sign in wiring if sign < 0]
    name = "channel_swap" if swapped else "sign_inversion"
    drop = 1 - found.metric / found.before.metric
    p = wiring_p(found.start.base, setup.log, setup.runs) * setup.tested * wirings(len(model.channels))
    return FoundEffect(
        name=name,
        link="electronics",
        variant=f"{' and '.join(swapped)} exchanged" if swapped else f"{' and '.join(flipped)} inverted",
        parameters={},
        p_value=min(1.0, p),
        shrinkage=drop,
        interval=None,
        share=closed(found.before.metric, found.metric, found.floor.metric),
        cost="no parameter: the channel assignment is corrected",
        note=_repair(name),
    )


def _repair(name: str) -> str:
    return f"{name} {FAULTS[name].refusal}"


def operations(model: Model) -> int:
    """Return the count of arithmetic operations of one decoded pose, common subexpressions counted once.

    Each sine or division of the model's own expression is one operation: for models that have no C.
    """
    return graph([ca.cse(*model.decoded.call(model.decoded.sx_in()))]).count


def firmware_cost(before: Model, after: Model, p: np.ndarray | None = None) -> str:
    """Return in words what the step from one model to another adds: parameters, instructions, signals.

    `p`: parameters of `after`, which decide how often a non-linear model is iterated; nominal by default.
    """
    added = counted(len(after.parameters) - len(before.parameters), "parameter")
    signals = [c.name for c in after.computed if c.name not in before.state]
    text = f"{added}; {_work(before, after, p)}"
    if signals:
        some = ", ".join(signals[:SHOWN]) + (", ..." if len(signals) > SHOWN else "")
        text += f" and {counted(len(signals), 'signal')} to compute ({some})"
    return text


def _work(before: Model, after: Model, p: np.ndarray | None) -> str:
    shared = None
    if p is not None:
        shared = before.vector({n: v for n, v in after.named(p).items() if n in before.names})
    try:
        old, new = cost_of(before, shared), cost_of(after, p)
    except InputError:
        return f"decoding {operations(before)} -> {operations(after)} operations, no C"
    return (
        f"C about {old.instructions} -> {new.instructions} instructions, "
        f"parameter table {old.table} -> {new.table} B"
    )
