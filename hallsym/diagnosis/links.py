"""Which link of the chain the excess lies in: what the best testable effect of each link takes up of it.

Links overlap: what a delay of the clock does, a lag of the transducer can nearly do too. So beside each share
stands the largest one of another link.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residual_table import ResidualTable
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, by_name
from hallsym.diagnosis.shares import Found, outputs
from hallsym.diagnosis.words import percent
from hallsym.model import LINKS


@dataclass(frozen=True)
class Link:
    """The effect or fault `name` of a link, and the share of the excess that it takes up."""

    name: str
    share: float
    p_value: float


def of_links(base: Base, scored: Sequence[Score], r: ResidualTable, faults: Sequence[Fault] = ()) -> Found:
    """Return what each link can take up of the excess of `r`, and statements on those that surely do.

    `scored`: effects at `base`, each by its own score: the gap metric, cross-validated, and the p-value for
    all that was tried. `faults`: of single samples, with `power` as part of the excess.
    """
    out = outputs(r)
    whole, noise = float(out.weight @ out.squares.mean(axis=1)), float(out.weight @ out.noise)
    excess = max(whole - noise, 1e-300)
    found: dict[str, Link] = {}

    def add(link: str, name: str, share: float, p_value: float) -> None:
        if link not in found or share > found[link].share:
            found[link] = Link(name, float(np.clip(share, 0.0, 1.0)), p_value)

    for s in by_name(scored):
        if not s.absorbed:
            add(_link_of(base, s), s.effect.name, (1 - s.ratio**2) * whole / excess, s.p_value)
    for f in faults:
        add(f.record.link, f.name, f.power, f.p_value)
    top = max((f.share for f in found.values() if f.p_value < POLICY.false_alarm), default=0.0)
    rows, said = [], []
    for link in (*LINKS, *(k for k in found if k not in LINKS)):
        if link not in found:
            rows.append(Share("link", link, None, None, "no effect of this link could be tested"))
            continue
        own = found[link]
        text = f"{own.name}; another link: {_best_of({k: f for k, f in found.items() if k != link})}"
        rows.append(Share("link", link, own.share, own.p_value, text))
        if own.p_value < POLICY.false_alarm and own.share >= max(POLICY.negligible, (1 - POLICY.minor) * top):
            text = f"{percent(own.share)} of the excess can come from the {link} ({text})"
            said.append(Statement("link", link, own.share, own.p_value, text))
    # of links that take up the same the first of the chain stands first, whatever the rounding
    return rows, sorted(said, key=lambda s: -round(s.share, 6))


def _best_of(found: dict[str, Link]) -> str:
    link = max(found, key=lambda k: found[k].share, default=None)
    return f"{link} {percent(found[link].share)}" if link else "none tested"


def _link_of(base: Base, score: Score) -> str:
    """Return the link that an effect acts on; one that does not say it is placed by the step that it adds."""
    if score.effect.link in LINKS:
        return score.effect.link
    old = {id(step) for _, step in base.model.steps}
    return next((on for on, step in score.model.steps if id(step) not in old), score.effect.link)
