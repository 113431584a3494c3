"""What was found, as records: effects that hold, faults of samples, a wrong channel assignment."""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.decoded_errors import interval
from hallsym.diagnosis.faults import Fault, wiring_p, wirings
from hallsym.diagnosis.firmware_cost import firmware_cost
from hallsym.diagnosis.ranking import count_of
from hallsym.diagnosis.record import Estimate, FoundEffect
from hallsym.diagnosis.sentences import at_bound_text, unseen_text
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Held, Validation
from hallsym.diagnosis.verdict import closed
from hallsym.families.faults import FAULTS

EITHER = ("sign_inversion", "channel_swap")
"""Faults of the channel assignment that an angle from two channels cannot tell apart."""


def findings(setup: Setup, found: Validation) -> tuple[FoundEffect, ...]:
    """Return what was found, by share of the excess; a wrong channel assignment wins a tie."""
    spread = _standard_errors(found)
    out = [_effect(found, e, spread) for e in found.effects]
    out += [_fault(setup, found, f) for f in found.faults]
    if setup.miswired:
        out.insert(0, _assignment(setup, found))
    return tuple(sorted(out, key=lambda e: -e.share))


def _standard_errors(found: Validation) -> np.ndarray:
    """Standard errors of all parameters, for the noise and the slow averages of what is left."""
    noise = max(found.fit.cost / count_of(found.fit), 1e-12)
    return np.sqrt(np.maximum(np.diag(found.fit.covariance()), 0.0) * noise * found.inflation)


def _effect(found: Validation, held: Held, spread: np.ndarray) -> FoundEffect:
    score, fit = held.selected.exact.score, found.fit
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
        shrinkage=1 - found.after.metric / held.errors.metric,
        interval=interval(held.errors, found.after),
        share=_share(found, held.errors.metric**2 - found.after.metric**2),
        cost=firmware_cost(before, model, fit.base.p),
        text=score.variant.text,
        at_bound=ended,
        note=_note(ended, blind),
    )


def _note(ended: Sequence[str], blind: Sequence[str]) -> str:
    return " ".join([*([at_bound_text(ended)] if ended else []), *([unseen_text(blind)] if blind else [])])


def _fault(setup: Setup, found: Validation, fault: Fault) -> FoundEffect:
    scale = found.fault_scale
    return FoundEffect(
        name=fault.name,
        link=fault.link,
        variant=fault.text,
        parameters=fault.parameters,
        p_value=min(1.0, fault.p_value * setup.tested),
        shrinkage=1 - scale,
        interval=(1 - scale, 1 - scale),
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
        interval=(drop, drop),
        share=closed(found.before.metric, found.metric, found.floor.metric),
        cost="no parameter: the channel assignment is corrected",
        note=_repair(name),
    )


def _repair(name: str) -> str:
    return f"{name} {FAULTS[name].refusal}"
