"""The Diagnosis, assembled from the results of the stages, and the confusable effects.

Confusable effects are exact refits that leave the same residual; a recording would separate them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from hallsym.diagnosis.decoded_errors import decoded_errors, waves
from hallsym.diagnosis.faults import Fault, assignment_p, assignments
from hallsym.diagnosis.localisation import Located, located, shape, sizes
from hallsym.diagnosis.record import (
    LARGER,
    Diagnosis,
    Estimate,
    FoundEffect,
    Gap,
    Metric,
    ModelLeft,
    NoiseFloor,
    NotExcluded,
    Separation,
    Shrinkage,
    Sizes,
    SmallerFinding,
    Unexplained,
)
from hallsym.diagnosis.refit import Refitted, refit
from hallsym.diagnosis.residual_table import both
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.selection import REFERENCE, Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import (
    QUIET,
    Validated,
    Validation,
    Verdict,
    closed,
    goodness_on_all,
    unfounded,
)
from hallsym.diagnosis.words import SHOWN, gap_text, gap_unit, noise_text
from hallsym.errors import counted, listed
from hallsym.estimation.calibration import coverage_factor
from hallsym.estimation.goodness_of_fit import ResidualNoise
from hallsym.families import added_effects
from hallsym.families.faults import ASSIGNMENT_FAULTS
from hallsym.model import Model, ways_text


@dataclass(frozen=True, eq=False)
class Confusable:
    """Groups of confusable effects, recordings that separate each, and all names with evidence."""

    groups: tuple[tuple[str, ...], ...]
    separate: tuple[Separation, ...]
    ranked: tuple[str, ...]
    fits: tuple[Refitted, ...] = ()
    """Models that the log does not exclude, each with everything else that was found in place."""

    def instead_of(self, name: str) -> list[str]:
        """Return the effects that are confusable with this one."""
        return [other for group in self.groups if name in group for other in group if other != name][:SHOWN]


def confusable(
    setup: Setup, found: Validation, effects: Sequence[FoundEffect], verdict: Verdict
) -> Confusable:
    """Return the effects that are confusable on this log: exact refits that leave the same residual.

    `ranked`: the effects by share, members of their groups, and, where they explain the gap, other effects
    that the log does not exclude in their place. An effect that does not lower the gap on the holdout runs
    has no evidence.
    """
    policy, pairs = setup.policy, setup.base.model.family.pairs
    separate, fits, possible = list[Separation](), list[Refitted](), list[str]()
    for validated in found.effects:
        one, rest = validated.exact, {h.name for h in found.effects} - {validated.name}
        variance = one.fit.variance(found.inflation)  # of slow averages
        limit = policy.separated**2 * variance
        rivals = [r for r in one.rivals if r.fit.cost - one.fit.cost < limit]
        possible += [r.name for r in rivals]
        # parameters for which the log gives no reason make no rival
        near = [r for r in rivals if not pairs or r.bic - one.bic < 2 * policy.as_good]
        own = [(d, r) for r in near if (d := one.fit.distance(r.fit)) < limit][:SHOWN]
        fits += [r.fit for _, r in own if rest <= set(r.fit.base.model.effects) and r.fit not in fits]
        if own:
            members = [one.score.effect, *(r.score.effect for _, r in own)]
            ways = ways_text(way for e in members for way in e.separate)
            sigma = float((min(d for d, _ in own) / variance) ** 0.5)
            separate.append(Separation(tuple(e.name for e in members), ways, sigma))
    groups = [s.group for s in separate]
    if effects and effects[0].name in ASSIGNMENT_FAULTS and len(setup.base.model.pose) == 1:
        groups.insert(0, ASSIGNMENT_FAULTS)  # either turns the angle round, and its zero is free
    names = [e.name for e in effects if e.share > 0] + [name for group in groups for name in group]
    names += possible if verdict == "explained" else []
    return Confusable(tuple(groups), tuple(separate), tuple(dict.fromkeys(names)), tuple(fits))


def smaller_findings(
    setup: Setup, selection: Selection, found: Validation, below: Sequence[FoundEffect] = ()
) -> tuple[SmallerFinding, ...]:
    """Return the effects that are significant and worth less than the threshold.

    First those that were named but are too small together (`below`), then those that score beside what was
    selected.
    """
    out = [SmallerFinding(e.name, e.shrinkage, e.p_value) for e in below]
    known, here, floor = {h.name for h in found.effects}, selection.fit.metric, setup.floor_fitted.metric
    for score in by_name(selection.last or ()):
        p, shrinkage = score.p_value, 1 - score.ratio
        if score.effect.link == REFERENCE and unfounded(here, score.ratio * here, floor, setup.policy):
            continue
        # larger ones were validated, and not selected
        small = setup.policy.minor * setup.threshold <= shrinkage < setup.threshold
        if p < setup.policy.certain and small and score.effect.name not in known:
            out.append(SmallerFinding(score.effect.name, shrinkage, p))
    return tuple(out)


# -- the record --------------------------------------------------------------------------------------------


def report(
    setup: Setup,
    selection: Selection,
    found: Validation,
    effects: tuple[FoundEffect, ...],
    verdict: Verdict,
    confused: Confusable,
    noise: ResidualNoise | None = None,
) -> Diagnosis:
    """Return the diagnosis.

    `effects`: found; `confused`: the confusable ones; `noise`: of the residual.
    """
    quiet = verdict in QUIET or not effects
    named = () if quiet else effects
    after = found.before.metric if quiet else found.metric
    metric = Metric(found.before.metric, after, found.floor.metric)
    share = closed(metric.before, metric.after, metric.floor)
    loud = noise if noise is not None and noise.larger and verdict != "unexplained" else None
    plain = found.start.base.on_all
    where, rest = _located(setup, selection, found, verdict, plain, loud)
    left = unexplained(rest, 1 - share) if rest else None
    gap_after, cured = found.before.gap, found.cured.gap
    if not quiet:  # faults of samples count by their power
        power = found.metric / found.cured.metric
        ends = {c: (low * power, high * power) for c, (low, high) in cured.interval.items()}
        gap_after = Gap({c: v * power for c, v in cured.rmse.items()}, cured.peak, ends)
    given = {s.source == "given" for s in setup.fit.noise.sigmas.values()}
    source = "stated and estimated" if len(given) == 2 else "stated" if given == {True} else "estimated"
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(setup, found, verdict, named, confused.instead_of, metric, noise),
        held_out=setup.held_out,
        noise_floor=NoiseFloor(dict(found.floor.outputs), source),
        gap_before=found.before.gap,
        gap_after=gap_after,
        metric=metric,
        shrinkage=_shrinkage(found, metric, share, quiet),
        ranked=confused.ranked,
        groups=confused.groups,
        effects=named,
        where=where.statements,
        size=_size(setup, found, plain),
        remaining=rest.statements if rest else (),
        unexplained=left,
        model_error=model_error(setup, found, gap_after, after, rest, left, confused),
        separate_by=confused.separate,
        validation_runs=setup.holdout,
        not_testable=selection.not_testable,
        smaller_findings=smaller_findings(setup, selection, found, effects if quiet else ()),
        threshold=setup.threshold,
        model=setup.fit.model.name,
        log=setup.fit.log,
        notes=tuple(dict.fromkeys(setup.fit.notes)),
        seconds=perf_counter() - setup.began,
        versions=dict(setup.fit.versions),
        waves=waves(found.start.base, found.base if named else None),
        next_step=() if quiet else next_step(setup, found),
        noise=noise,
        significance=selection.significance,
    )


def _shrinkage(found: Validation, metric: Metric, share: float, quiet: bool) -> Shrinkage:
    """Return how far the gap shrinks, with a corrected channel assignment and without faulty samples."""
    added, judged = len(found.base.p) - len(found.start.base.p), found.judged
    if quiet or judged is None:
        return Shrinkage(1 - metric.after / metric.before, None, share, 0 if quiet else added)
    start = found.start
    holdout = [u for u in range(len(start.output)) if u not in set(start.fitted.tolist())]
    rewired = start.gap(np.array(holdout)) / found.before.metric if found.miswired and holdout else 1.0
    scale = found.metric / found.after.metric * min(rewired, 1.0)
    value, interval = 1 - scale * (1 - judged.value), judged.interval(scale)
    return Shrinkage(value, interval, share, added, len(judged.before), judged.policy.fewest)


def unexplained(found: Located, share: float) -> Unexplained:
    """Return the unexplained rest, as `located` found it; `share`: part of the gap above the noise floor."""
    return Unexplained(share, shape(found.curves[0]) if found.curves else None)


def _located(
    setup: Setup,
    selection: Selection,
    found: Validation,
    verdict: Verdict,
    plain: Base,
    loud: ResidualNoise | None,
) -> tuple[Located, Located | None]:
    """Return where the gap lies and, if it is unexplained, where the rest lies.

    Faults of samples count by their power over all of the excess. `plain`: the fit without effects on all
    samples. `loud`: noise larger than its floor, which is not localised: the excess is counted above it.
    """
    gap, runs, floor, start = Located((), ()), setup.base.log.runs, found.floor.metric, found.start.base
    if loud is not None:
        larger = np.array([max(loud.by_sensor[c], 1.0) for c in plain.model.channels])
        plain = replace(plain, covariance=plain.covariance * np.outer(larger, larger))
        floor *= loud.ratio
    if verdict not in QUIET or found.before.metric > floor * (1 + setup.policy.negligible):
        screened, noisy = selection.screened_at(start), verdict in QUIET
        gap = located(plain, runs, screened, found.faults, found.variance, noisy=noisy)
    if verdict != "unexplained":
        return gap, None
    if found.base is start:
        return gap, gap
    return gap, located(found.base, runs, selection.screened_at(found.base))


def _size(setup: Setup, found: Validation, plain: Base) -> Sizes:
    """Return how large the gap of `plain` is over the noise floor, channels as they were logged."""
    start = setup.as_logged(plain)
    fitted, holdout = both(start, setup.base.log.runs)
    errors = {"fitted": decoded_errors(start, setup.runs), "held_out": found.before}
    floors = {"fitted": setup.floor_fitted.outputs, "held_out": setup.floor.outputs}
    return sizes({"fitted": fitted, "held_out": holdout}, errors, floors)


# -- sentences, and the next command -----------------------------------------------------------------------


def sentence(
    setup: Setup,
    found: Validation,
    verdict: str,
    effects: Sequence[FoundEffect],
    instead_of: Callable[[str], Sequence[str]],
    gap: Metric,
    noise: ResidualNoise | None,
) -> str:
    """Return the diagnosis in one or two sentences.

    `instead_of`: effect -> effects confusable with it. `noise`: of the residual.
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
    place = ""
    if small or not effects:
        known = goodness_on_all(setup, found.start.base)
        place = f", {known.where}" if known.material and not setup.split else ""
        if small and (place or not effects):
            said = f"The error on the {judges} is {before}, no more than noise alone gives ({floor}), but"
            place = f" the residual of the readings {'is not noise' if place else 'has a shape'}{place}"
    if not effects:
        cause = "no known effect explains it"
        if found.effects and known.material and not goodness_on_all(setup, found.end).material:
            cause = f"{listed([e.name for e in found.effects])} explains it, but does not lower the error"
        return f"{said}{place}; {cause}."
    confused = [(e.name, instead_of(e.name)) for e in effects]  # such as time_skew (or first_order_lag)
    named = listed([f"{name} (or {' or '.join(others)})" if others else name for name, others in confused])
    rest = "" if verdict == "explained" else "; the rest has no known cause"
    open_ = closed(gap.before, gap.after, gap.floor) < 1 - setup.policy.minor
    if verdict == "explained" and open_ and noise is not None and noise.larger:
        rest = f"; the rest depends on no logged quantity: noise, {noise.ratio:.3g} x the noise floor"
    return f"{said}{place}. With {named} it falls to {after}{rest}."


def next_step(setup: Setup, found: Validation) -> tuple[str, ...]:
    """Return the arguments of `hallsym fit LOG` that fit the model with the effects found, in their order.

    The pieces of a split recording are no runs of the log on disk, so they are no holdout runs of it.
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
    wires = [one.text for one in setup.fit.corrections] if setup.miswired else []
    return (*words, *(word for text in wires for word in ("--correct", text)))


# -- what a budget takes -------------------------------------------------------------------------------------


def model_error(
    setup: Setup,
    found: Validation,
    gap: Gap,
    metric: float,
    lies: Located | None,
    rest: Unexplained | None,
    confused: Confusable,
) -> ModelLeft:
    """Return the model error beyond the noise, and the models that the log does not exclude.

    `gap`, `metric`: the remaining error on the holdout runs. `lies`, `rest`: its place and shape if it is
    unexplained.
    """
    floor = found.floor.outputs
    known = metric <= found.floor.metric * (1 + setup.policy.negligible)
    above = {c: float(np.sqrt(max(v**2 - floor[c] ** 2, 0.0))) for c, v in gap.rmse.items()}
    curve = rest.curve if rest else None
    placed = (*setup.base.model.references, *setup.base.model.state)  # the coordinates that a position has
    counts = curve is not None and curve.line and curve.column.removeprefix("d0_") in placed
    share = lies.statements[0].share if lies is not None and lies.statements and counts else 0.0
    left = float(np.sqrt(max(1 - share, 0.0)))
    own = found.fit  # each model with its probability by BIC, on the part of a long log that rivals have
    if confused.fits and found.base.part is not found.base:
        own = refit(found.base.part, setup.runs)
    bic = np.array([f.bic(len(f.base.free), found.inflation) for f in (own, *confused.fits)])
    weight = np.exp(-0.5 * (bic - bic.min()))
    bases = found.base, *(f.base for f in confused.fits)
    return ModelLeft(
        rest={c: 0.0 if known else v * left for c, v in above.items()},
        shape_counts=counts,
        candidates=tuple(
            NotExcluded(tuple(added_effects(base.model)), base.values, float(w))
            for base, w in zip(bases, weight / weight.sum(), strict=True)
            if confused.fits
        ),
    )


# -- what was found ------------------------------------------------------------------------------------------


Price = Callable[[Model, Model, np.ndarray], str]
"""Says what C costs, without an effect and with it at parameters (n,): `hallsym.codegen.price`."""


def findings(setup: Setup, found: Validation, price: Price | None = None) -> tuple[FoundEffect, ...]:
    """Return the findings by share of the excess; a wrong channel assignment wins a tie.

    An effect that does not lower the error on the holdout runs is not a finding.
    """
    if found.metric >= found.before.metric:
        return ()
    covariance, dof = found.fit.uncertainty()
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    out = [_effect(found, e, (std, std * coverage_factor(dof)), price) for e in found.effects]
    scale, before = found.metric / found.after.metric, found.before.metric
    share = _share(found, (1 - scale**2) * found.after.metric**2)
    out += [_repaired(setup, fault, 1 - scale, share) for fault in found.faults]
    if setup.miswired:
        wrong, share = _assignment(setup, found.start.base), closed(before, found.metric, found.floor.metric)
        out.insert(0, _repaired(setup, wrong, 1 - found.metric / before, share))
    return tuple(sorted(out, key=lambda e: -e.share))


def _effect(
    found: Validation, validated: Validated, spread: tuple[np.ndarray, np.ndarray], price: Price | None
) -> FoundEffect:
    """Return an effect as it is reported; `spread`: (n,) standard uncertainties, half of the intervals."""
    score, fit = validated.exact.score, found.fit
    model, before = fit.base.model, validated.without.base.model
    stuck, unseen, values = fit.at_bound(), fit.unseen(), fit.values()
    index = {n: model.names.index(n) for n in score.model.names if n in model.names and n not in before.names}
    ended = tuple(n for n, j in index.items() if j in stuck)
    blind = [n for n, j in index.items() if j in unseen]
    known = {n: float(values[j]) for n, j in index.items()}
    found_of = {}
    for n, j in index.items():
        std, half = (None, None) if j in stuck or j in unseen else (float(each[j]) for each in spread)
        ends = None if half is None else (known[n] - half, known[n] + half)
        found_of[n] = Estimate(known[n], std, model.parameters[j].unit, ends)
    remark = score.effect.remark(known, {n: np.inf if e.std is None else e.std for n, e in found_of.items()})
    priced, p = model, fit.base.p
    if before.computed:  # by another effect, with which no C is generated: the price of this one alone
        before = found.start.base.model
        priced = score.variant.make(before)
        p = priced.vector({n: v for n, v in model.named(p).items() if n in priced.names})
    return FoundEffect(
        name=score.effect.name,
        link=score.effect.link,
        variant=score.variant.label,
        parameters=found_of,
        p_value=score.p_value,
        shrinkage=validated.judged.value,
        interval=validated.judged.interval(),
        share=_share(found, validated.errors.metric**2 - found.after.metric**2),
        cost=grown(before, priced) + (f"; {price(before, priced, p)}" if price else ""),
        text=score.variant.text,
        at_bound=ended,
        note=" ".join(filter(None, (remark, _note(ended, blind)))),
    )


def _note(ended: Sequence[str], blind: Sequence[str]) -> str:
    """Return the qualification of an effect: parameters at their bounds or without effect on the log."""
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


def _repaired(setup: Setup, fault: Fault, shrinkage: float, share: float) -> FoundEffect:
    """Return a fault of the recording, which no model describes, as a found effect."""
    repair = (
        "the channel assignment is corrected" if fault.name in ASSIGNMENT_FAULTS else "a repair, not a model"
    )
    return FoundEffect(
        name=fault.name,
        link=fault.record.link,
        variant=fault.text,
        parameters=fault.parameters,
        p_value=min(1.0, fault.p_value * setup.tested),
        shrinkage=shrinkage,
        interval=None,
        share=share,
        cost=f"no parameter: {repair}",
        note=f"{fault.name} {fault.record.refusal}",
    )


def _assignment(setup: Setup, base: Base) -> Fault:
    """Return exchanged or inverted channels; `base`: the fit with the channels put right."""
    channels, assigned = base.model.channels, setup.miswired or ()
    swapped = [c for c, (source, _) in zip(channels, assigned, strict=True) if source != c]
    flipped = [source for source, sign in assigned if sign < 0]
    text = f"{' and '.join(swapped)} exchanged" if swapped else f"{' and '.join(flipped)} inverted"
    p = assignment_p(base, setup.log, setup.runs) * assignments(len(channels))
    return Fault("channel_swap" if swapped else "sign_inversion", text, 1.0, {}, p)


def _share(found: Validation, squares: float) -> float:
    """Return the share of the excess above the floor that `squares` are."""
    excess = max(found.before.metric**2 - found.floor.metric**2, 1e-300)
    return float(np.clip(squares / excess, 0.0, 1.0))


def grown(before: Model, after: Model) -> str:
    """Return in words what the step from one model to another adds: parameters, and signals to compute."""
    text = counted(len(after.parameters) - len(before.parameters), "parameter")
    signals = [c.name for c in after.computed if c.name not in before.state]
    if signals:
        some = ", ".join(signals[:SHOWN]) + (", ..." if len(signals) > SHOWN else "")
        text += f" and {counted(len(signals), 'signal')} to compute ({some})"
    return text
