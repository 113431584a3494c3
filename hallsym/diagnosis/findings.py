"""What was found, as records: effects that hold, faults of samples, a wrong channel assignment."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import casadi as ca
import numpy as np

from hallsym.codegen import cost_of
from hallsym.codegen.operations import graph
from hallsym.diagnosis.faults import Fault, wiring_p, wirings
from hallsym.diagnosis.flexible import PAST
from hallsym.diagnosis.record import FoundEffect, Resemblance
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Held, Validation
from hallsym.diagnosis.verdict import closed
from hallsym.diagnosis.words import SHOWN
from hallsym.errors import InputError, counted
from hallsym.families.faults import FAULTS
from hallsym.inference import Estimate
from hallsym.model import Model
from hallsym.units import readable


def findings(
    setup: Setup, found: Validation, resembled: Mapping[str, Resemblance] = MappingProxyType({})
) -> tuple[FoundEffect, ...]:
    """Return what was found, by share of the excess; a wrong channel assignment wins a tie.

    `resembled`: why the machine only behaves like some of the effects.
    """
    spread = _standard_errors(found)
    out = [_effect(found, e, spread, resembled.get(e.name), setup.piece) for e in found.effects]
    out += [_fault(setup, found, f) for f in found.faults]
    if setup.miswired:
        out.insert(0, _assignment(setup, found))
    return tuple(sorted(out, key=lambda e: -e.share))


def _standard_errors(found: Validation) -> np.ndarray:
    """Standard errors of all parameters, for the noise and the slow averages of what is left."""
    noise = found.fit.variance(1.0)
    return np.sqrt(np.maximum(np.diag(found.fit.covariance()), 0.0) * noise * found.inflation)


def _effect(
    found: Validation, held: Held, spread: np.ndarray, resembled: Resemblance | None, piece: str
) -> FoundEffect:
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
        note=_note(score.effect.name, ended, blind, resembled, piece),
        behaves_like=resembled,
    )


def _note(
    name: str, ended: Sequence[str], blind: Sequence[str], resembled: Resemblance | None, piece: str
) -> str:
    """Return what qualifies an effect: parameters at their bounds or unseen, and a better alternative."""
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
    if resembled:
        varied = f"a strength that follows {', '.join(readable(c)[2] for c in resembled.by)} freely"
        if resembled.by == PAST:
            varied = "a free linear response to the past of what it makes"
        said.append(
            f"The machine behaves like {name}, but {varied} predicts other {piece}s better: what the effect "
            f"makes is off by {100 * resembled.misfit:.2g} % (rms). The cause is something of the same kind "
            "that no effect describes."
        )
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
