"""Which link of the chain the excess lies in: what the testable effects of each link alone can take up of it.

The effects of a link are fitted to the residual together with the model's own parameters and every run's
zeros, to first order, on some runs; what they take up is counted on the others. Of a link the effect that
takes up most counts, and a second or third one that adds to it. Links overlap: what a delay of the clock
does, a lag of the transducer can nearly do too. So beside each share stands what all other links together
take up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.normal_equations import Accumulator, coefficients, eliminated
from hallsym.diagnosis.p_values import of_signs
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residual_table import BLOCKS, FEWEST, FOLDS, SHORTEST, ResidualTable, at_rest
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


@dataclass(eq=False)
class Sums:
    """Products of the columns [parameters | effects | residual] of all blocks, and of each group of runs.

    Of a block alone only `near` is kept, the products with the parameters and the residual (own + 1, c): all
    of each would be a hundred times as much. `run`, `readings`: group and number of readings of each block.
    """

    own: int
    groups: dict[int, np.ndarray] = field(default_factory=dict)
    near: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)
    count: dict[tuple[int, int], float] = field(default_factory=dict)

    def add(self, group: int, part: int, products: np.ndarray, size: float) -> None:
        """Add products (c, c) of `size` readings to a block: part `part` of the runs of a group."""
        fold, at = group % PARTS, (group, part)
        self.groups[fold] = self.groups.get(fold, 0) + products
        self.near[at] = self.near.get(at, 0) + products[[*range(self.own), -1]]
        self.count[at] = self.count.get(at, 0.0) + size


class Blocks:
    """Products of the columns [parameters | effects | residual] by block of samples, zeros eliminated.

    `span`: columns of each effect. `readings`: whitened readings in all.
    """

    def __init__(self, sums: Sums, span: Mapping[str, slice], bounds: tuple[np.ndarray, np.ndarray]) -> None:
        """Take the model's own parameters out: of all for significance, of the others for the shares."""
        keys = sorted(sums.near)
        self.run, self.span, self.bounds = np.array([k[0] for k in keys]), span, bounds
        readings = np.array([sums.count[k] for k in keys])
        self.readings = float(readings.sum())
        self.own = own = sums.own
        self.groups = [sums.groups[k] for k in sorted(sums.groups)]
        self.total = self.groups[0].copy()
        for group in self.groups[1:]:
            self.total += group
        follow = _follow(self.total, own)
        self.all, self.raw = eliminated(self.total, follow), np.diag(self.total)[own:]
        last = np.array([_eliminated_residual(sums.near[k], follow) for k in keys])
        level = np.sqrt(readings / np.maximum(last[:, -1], 1e-300))
        self.scores = last[:, :-1] * level[:, None]
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

    def chance(self, name: str) -> float:
        """Return the p-value of one effect: signs of its scores, block by block."""
        at = self.at([name])
        scores = self.scores[:, at]
        q = scores @ pseudo_inverse(self.all[np.ix_(at, at)]) @ scores.T
        return of_signs(q, self.run)


def _follow(total: np.ndarray, own: int) -> np.ndarray:
    """Return how the first `own` columns follow the others in products `total`."""
    return -pseudo_inverse(total[:own, :own]) @ total[:own, own:]


def _eliminated_residual(near: np.ndarray, follow: np.ndarray) -> np.ndarray:
    """Return the last column of `eliminated`, from the rows (own + 1, c) of parameters and residual."""
    own = len(follow)
    across, last = near[:own, own:], near[own]
    moved = near[:own, -1] + near[:own, :own] @ follow[:, -1]
    return np.asarray(last[own:] + across.T @ follow[:, -1] + follow.T @ moved)


def blocks_of(base: Base, tried: Mapping[str, Score]) -> Blocks:
    """Read the fitted runs once more, where the axes were: see `smoothed`."""
    candidates = {
        name: (s.model, [n for n in s.model.names if n not in base.model.names]) for name, s in tried.items()
    }
    models = [m for m, _ in candidates.values()]
    base = replace(base, log=smoothed(base, models), keep=None)
    work = Accumulator(base, candidates)
    runs = base.log.runs
    # a log of many runs has a block for each group of neighbours, one of few runs several blocks in each
    group = {run: k * min(FOLDS, len(runs)) // len(runs) for k, run in enumerate(runs)}
    length = max(SHORTEST, -(-base.log.rows // BLOCKS)) if len(runs) < FEWEST else base.log.rows
    sums = Sums(work.n)
    for run in work.stretches(length):
        follow = eliminate(np.sum([s.products for s in run], axis=0), work.z)[1] if work.z else None
        for part, s in enumerate(run):
            left = s.products if follow is None else eliminated(s.products, follow)
            sums.add(group[s.run], part, left, s.size)
    span = {k: v for k, v in work.span.items() if k and k not in work.slopes.spoiled}
    return Blocks(sums, span, _bounds(candidates))


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
