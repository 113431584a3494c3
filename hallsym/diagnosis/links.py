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

from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.normal_equations import Accumulator, coefficients, eliminated
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residual_table import SHORTEST, ResidualTable, at_rest
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.scores import NIL, Score, by_name
from hallsym.diagnosis.shares import LEAST, LEVEL, Found
from hallsym.diagnosis.words import percent
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.model import LINKS, Model
from hallsym.model.arrays import on_arrays

ROOM, CHANNELS = 40_000, 3
"""Samples that are looked at: of a longer log some runs, evenly chosen, and of long runs the beginning. Of
more than so many channels as many readings."""
FEW = 8
"""Runs that are looked at at least."""
PARTS = 11
"""Groups of runs that are left out in turn."""


class Groups:
    """Products of the columns [parameters | effects | residual] by group of runs, zeros eliminated.

    `own`: count of the parameters. `span`: columns of each effect. `readings`: whitened readings in all.
    """

    def __init__(
        self,
        products: Sequence[np.ndarray],
        own: int,
        readings: float,
        span: Mapping[str, slice],
        bounds: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Take the products (c, c) of each group."""
        self.span, self.bounds, self.readings, self.own = span, bounds, readings, own
        self.groups = products
        self.total = np.sum(products, axis=0)
        self.raw = np.diag(self.total)[own:]
        self.known: dict[tuple[str, ...], float] = {(): 0.0}

    def at(self, names: Sequence[str]) -> np.ndarray:
        """Return the columns of some effects."""
        spans = [self.span[n] for n in names]
        return np.concatenate([np.arange(s.start, s.stop) for s in spans] or [np.zeros(0, int)]) - self.own

    def takes(self, names: Sequence[str]) -> float:
        """Return the whitened squares that some effects together take off runs they were not fitted on."""
        key = tuple(sorted(names))
        if key not in self.known:
            at, own = self.at(key), np.arange(self.own)
            pick, total = np.ix_(*[[*own, *(own.size + at), -1]] * 2), 0.0
            everything = self.total[pick]
            for group in self.groups:
                part = group[pick]
                follow = _follow(everything - part, self.own)
                train, test = eliminated(everything - part, follow), eliminated(part, follow)
                seen = np.flatnonzero(np.diag(train)[:-1] > NIL * self.raw[at])
                theta = np.zeros(len(at))
                theta[seen] = coefficients(train, seen)
                theta = np.clip(theta, self.bounds[0][at], self.bounds[1][at])
                total += float(2 * theta @ test[:-1, -1] - theta @ test[:-1, :-1] @ theta)
            self.known[key] = total
        return self.known[key]


def _follow(total: np.ndarray, own: int) -> np.ndarray:
    """Return how the first `own` columns follow the others in products `total`."""
    return -pseudo_inverse(total[:own, :own]) @ total[:own, own:]


def groups_of(base: Base, tried: Mapping[str, Score]) -> Groups:
    """Read the fitted runs once more, where the axes were: see `smoothed`."""
    candidates = {
        name: (s.model, [n for n in s.model.names if n not in base.model.names]) for name, s in tried.items()
    }
    models = [m for m, _ in candidates.values()]
    base = replace(base, log=smoothed(base, models), keep=None)
    work = Accumulator(base, candidates)
    place = {run: k % PARTS for k, run in enumerate(base.log.runs)}
    products: dict[int, np.ndarray] = {}
    readings = 0.0
    for run in work.stretches(base.log.rows):
        whole, at = np.sum([s.products for s in run], axis=0), place[run[0].run]
        left = eliminate(whole, work.z)[0] if work.z else whole
        products[at] = products.get(at, 0.0) + left
        readings += sum(s.size for s in run)
    span = {k: v for k, v in work.span.items() if k and k not in work.slopes.spoiled}
    return Groups([products[k] for k in sorted(products)], work.n, readings, span, _bounds(candidates))


def smoothed(base: Base, models: Sequence[Model]) -> Log:
    """Return fitted runs with the reference smoothed, readings shifted so that the residual stays as it is.

    The noise of the reference is in the residual and in what an effect makes of the reference: an effect of
    an axis that stood still would take up that noise, which is none of its doing.
    """
    model, made = base.model, {c.name for m in models for c in m.computed}
    needs = [
        c for m in (base.model, *models) for c in (*columns_of(m), *(n for k in m.computed for n in k.needs))
    ]
    kept = tuple(dict.fromkeys(c for c in (*needs, "t_s") if c not in made and c in base.log.columns))
    fitted = [run for run in base.log.runs if run not in base.holdout]
    room = ROOM * CHANNELS // max(CHANNELS, len(model.channels))
    most = max(FEW, round(room / base.log.rows * len(base.log.runs)))
    chosen = fitted[:: max(1, -(-len(fitted) // most))]
    read, back = on_arrays(model.reading), np.linalg.inv(base.whiten)
    count = dict.fromkeys(chosen, 0)
    parts = []
    for piece in pieces(base, frozenset(chosen), kept):
        if count[piece.run] >= room / len(chosen) + SHORTEST:
            continue
        count[piece.run] += len(piece.t)
        pose = [at_rest(piece.data[f"d0_{c}"], base.sigma.get(c, 0.0)) for c in model.references]
        state = [piece.data[c] for c in model.state]
        readings = read(base.p, base.zeros_in(piece.run), pose, state)[0] + back @ piece.residual
        data = {c: piece.data[c] for c in kept} | {"run": np.full(len(piece.t), piece.run)}
        parts.append(data | dict(zip((*model.references, *model.channels), (*pose, *readings), strict=True)))
    joined = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    return Log.from_arrays(joined, base.log.noise, base.log.meta, base.log.name)


def _bounds(candidates: Mapping[str, tuple[Model, list[str]]]) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = [], []
    for model, new in candidates.values():
        low, high = (b[[model.names.index(n) for n in new]] for b in model.bounds)
        lower.append(low)
        upper.append(high)
    return np.concatenate([*lower, []]), np.concatenate([*upper, []])


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
    groups = groups_of(base, tried)
    excess = r.excess / r.residual.size * groups.readings
    found = {link: _link(groups, own, excess) for link, own in _by_link(base, tried).items()}
    every = [name for f in found.values() if f and f.alone >= LEAST for name in f.names]
    whole = groups.takes(every)
    rows, said = [], []
    for link in (*LINKS, *(k for k in found if k not in LINKS)):
        best = found.get(link)
        if best:
            others = [name for name in every if name not in best.names]
            beside = groups.takes(others)
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


def _link(groups: Groups, own: Sequence[Score], excess: float) -> Link | None:
    """The effects of one link: the best, and others that add to it."""
    known = [s for s in own if s.effect.name in groups.span]
    if not known:
        return None
    names: list[str] = []
    taken = 0.0
    while len(names) < min(MOST, len(known)):
        left = [s.effect.name for s in known if s.effect.name not in names]
        more = {name: groups.takes([*names, name]) for name in left}
        best = max(more, key=lambda name: more[name])
        if names and more[best] - taken < LEAST * excess:
            break
        names, taken = [*names, best], more[best]
    p = min(s.p_value for s in known if s.effect.name in names)
    return Link(tuple(names), float(np.clip(taken / excess, 0.0, 1.0)), p)
