"""Which link of the chain the excess lies in: what the testable effects of each link alone can take up of it.

The effects of a link are fitted to the residual together with the model's own parameters and every run's
zeros, to first order, on some runs; what they take up is counted on the others. Of a link the effect that
takes up most counts, and a second or third one that adds to it. Links overlap: what a delay of the clock
does, a lag of the transducer can nearly do too. So beside each share stands what all other links together
take up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.link_products import Blocks, blocks_of
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residual_table import ResidualTable
from hallsym.diagnosis.scores import Score, by_name
from hallsym.diagnosis.shares import LEAST, LEVEL, Found
from hallsym.diagnosis.words import percent
from hallsym.model import LINKS

MOST = 3
"""Effects of a link that are taken together."""
AS_GOOD = 0.9
"""Of links that take up at least this part of what the best one does each is named."""


def of_links(base: Base, scored: Sequence[Score], r: ResidualTable, faults: Sequence[Fault] = ()) -> Found:
    """Return what each link can take up of the excess of `r`, and statements on those that surely do.

    `scored`: effects at `base`, of which the best variant of each is taken. `faults`: of single samples, with
    `power` as part of the excess; they have no equation.
    """
    tried = {s.effect.name: s for s in by_name(scored) if not s.absorbed}
    blocks = blocks_of(base, tried)
    excess = r.excess / r.residual.size * blocks.readings
    found = {link: _link(blocks, own, excess, len(scored)) for link, own in _by_link(base, tried).items()}
    every = [name for f in found.values() if f and f.alone >= LEAST for name in f.names]
    whole = blocks.takes(every)
    rows, said = [], []
    for link in (*LINKS, *(k for k in found if k not in LINKS)):
        best = found.get(link)
        if best:
            others = [name for name in every if name not in best.names]
            beside = blocks.takes(others)
            best = replace(
                best,
                others=float(np.clip(beside / excess, 0.0, 1.0)),
                only=float(np.clip((whole - beside) / excess, 0.0, best.alone)),
            )
        best = _with_faults(best, [f for f in faults if f.link == link])
        if best is None:
            rows.append(Share("link", link, None, None, "no effect of this link could be tested"))
            continue
        rows.append(Share("link", link, best.alone, best.p_value, _beside(best)))
        said.append((link, best))
    top = max((b.alone for _, b in said if b.p_value < LEVEL), default=0.0)
    named = [(link, b) for link, b in said if b.worth(top)]
    # of links that take up the same the first of the chain stands first, whatever the rounding
    named.sort(key=lambda x: (-round(x[1].alone, 6), -round(x[1].only, 6)))
    return rows, [_statement(link, b) for link, b in named]


@dataclass(frozen=True)
class Link:
    """What the effects `names` of a link take up of the excess `alone`; what all `others` together do.

    `only`: what is lost without this link when all are taken together.
    """

    names: tuple[str, ...]
    alone: float
    p_value: float
    others: float = 0.0
    only: float = 0.0

    def worth(self, top: float) -> bool:
        """Return whether to say so: it is sure, and either nothing else does it or none does more."""
        sure = self.p_value < LEVEL and self.alone >= LEAST
        return sure and (self.only >= LEAST or self.alone >= AS_GOOD * top)


def _statement(link: str, found: Link) -> Statement:
    text = f"{percent(found.alone)} of the excess can come from the {link} ({_beside(found)})"
    return Statement("link", link, found.alone, found.p_value, text, kind="link")


def _beside(found: Link) -> str:
    return f"{' and '.join(found.names)}; all other links together: {percent(found.others)}"


def _with_faults(best: Link | None, faults: Sequence[Fault]) -> Link | None:
    first = max(faults, key=lambda f: f.power, default=None)
    if first is None or (best and best.alone >= first.power):
        return best
    share = min(first.power, 1.0)
    return Link((first.name,), share, first.p_value, best.others if best else 0.0, share)


def _by_link(base: Base, tried: Mapping[str, Score]) -> dict[str, list[Score]]:
    """Effects by the link that they act on; one that does not say it is placed by the step that it adds."""
    out: dict[str, list[Score]] = {}
    for score in tried.values():
        link = score.effect.link
        if link not in LINKS:
            old = {id(step) for _, step in base.model.steps}
            link = next((on for on, step in score.model.steps if id(step) not in old), link)
        out.setdefault(link, []).append(score)
    return out


def _link(blocks: Blocks, own: Sequence[Score], excess: float, count: int) -> Link | None:
    """The effects of one link: the best, and others that add to it."""
    known = [s for s in own if s.effect.name in blocks.span]
    if not known:
        return None
    tried = {s.effect.name: s.variant.tried for s in known}
    names: list[str] = []
    taken = 0.0
    while len(names) < min(MOST, len(known)):
        left = [s.effect.name for s in known if s.effect.name not in names]
        more = {name: blocks.takes([*names, name]) for name in left}
        best = max(more, key=lambda name: more[name])
        if names and more[best] - taken < LEAST * excess:
            break
        names, taken = [*names, best], more[best]
    p = min(min(1.0, count * tried[name] * blocks.chance(name)) for name in names)
    return Link(tuple(names), float(np.clip(taken / excess, 0.0, 1.0)), p)
