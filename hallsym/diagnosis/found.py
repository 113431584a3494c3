"""What was found, as records: effects that hold, faults of samples, the wiring."""

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.decoded_errors import BlockErrors, interval
from hallsym.diagnosis.faults import Fault, wiring_p, wirings
from hallsym.diagnosis.holding import holding
from hallsym.diagnosis.price import price
from hallsym.diagnosis.record import Estimate, FoundEffect
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.sentences import blind_text, stuck_text
from hallsym.estimation.channel_assignment import Wiring
from hallsym.families.faults import FAULTS
from hallsym.log import Log
from hallsym.model import Model

EITHER = ("sign_inversion", "channel_swap")
"""Faults of the wiring that an angle read from two channels cannot tell apart."""


def closed(before: float, after: float, floor: float) -> float:
    """Return the share of the excess above the floor that is closed, in squares."""
    excess = before**2 - floor**2
    return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0)) if excess > 0 else 0.0


def cures(fault: Fault) -> float:
    """Return the decrease of the metric without a fault."""
    return 1 - float(np.sqrt(max(1 - fault.power, 0.0)))


def found_effects(
    search: Search,
    before: BlockErrors,
    after: BlockErrors,
    floor: float,
    inflation: float,
    apart: tuple[int, ...],
    rows: int,
) -> list[FoundEffect]:
    """Return the effects that hold on the held-out runs, with what each is worth beside the others."""
    out = []
    N = float(search.now.tangents.count[search.now.fitted].sum()) * len(search.start.base.model.channels)
    noise = max(search.now.cost / N, 1e-12)
    spread = np.sqrt(np.maximum(np.diag(search.now.covariance()), 0.0) * noise * inflation)
    stuck = search.now.at_bound()
    unseen = search.now.unseen()
    for each in holding(search, before, after, apart, rows):
        found, without, errors = each.found, each.without, each.errors
        score = found.exact.score
        new = [n for n in score.model.names if n not in without.base.model.names]
        model = search.now.base.model
        index = {n: model.names.index(n) for n in new if n in model.names}
        values = {
            n: Estimate(
                float(search.now.base.p[j]),
                None if j in stuck or j in unseen else float(spread[j]),
                model.parameters[j].unit,
            )
            for n, j in index.items()
        }
        ended = tuple(n for n, j in index.items() if j in stuck)
        blind = [n for n, j in index.items() if j in unseen]
        excess = max(before.metric**2 - floor**2, 1e-300)
        out.append(
            FoundEffect(
                name=score.effect.name,
                link=score.effect.link,
                variant=score.variant.label,
                parameters=values,
                p_value=each.p_value,
                shrinkage=1 - after.metric / errors.metric,
                interval=interval(errors, after),
                share=float(np.clip((errors.metric**2 - after.metric**2) / excess, 0.0, 1.0)),
                cost=price(without.base.model, model, search.now.base.p),
                text=score.variant.text,
                at_bound=ended,
                note=" ".join([stuck_text(ended)] * bool(ended) + [blind_text(blind)] * bool(blind)),
            )
        )
    return out


def fault_record(
    fault: Fault, scale: float, before: BlockErrors, after: BlockErrors, floor: float, tested: int
) -> FoundEffect:
    """Return a fault of samples; `scale`: gap without the faults over the gap with them."""
    excess = max(before.metric**2 - floor**2, 1e-300)
    share = float(np.clip((1 - scale**2) * after.metric**2 / excess, 0.0, 1.0))
    return FoundEffect(
        fault.name, fault.link, fault.text, fault.parameters,
        min(1.0, fault.p_value * tested), 1 - scale,
        (1 - scale, 1 - scale), share, "no parameter: a repair, not a model", note=_repair(fault.name),
    )  # fmt: skip


def miswired(model: Model, wiring: Wiring) -> bool:
    """Return whether channels are exchanged or inverted against what the model takes them for."""
    if len(model.channels) == 1:
        return False  # a direction, not a wire
    return any(source != c or sign < 0 for c, (source, sign) in zip(model.channels, wiring, strict=True))


def wiring_record(
    base: Base, log: Log, wiring: Wiring, search: Search, before: BlockErrors, left: float, floor: float
) -> FoundEffect:
    """Return exchanged or inverted channels of `log`; `left`: the gap with the wiring put right."""
    model = base.model
    swapped = [c for c, (source, _) in zip(model.channels, wiring, strict=True) if source != c]
    flipped = [source for source, sign in wiring if sign < 0]
    what = f"{' and '.join(swapped)} exchanged" if swapped else f"{' and '.join(flipped)} inverted"
    drop = 1 - left / before.metric
    p = min(1.0, wiring_p(base, log, search.runs) * search.tested * wirings(len(model.channels)))
    return FoundEffect(
        "channel_swap" if swapped else "sign_inversion", "electronics", what, {}, p, drop, (drop, drop),
        closed(before.metric, left, floor), "no parameter: the wiring is put right",
        note=_repair("channel_swap" if swapped else "sign_inversion"),
    )  # fmt: skip


def _repair(name: str) -> str:
    return f"{name} {FAULTS[name].refusal}"
