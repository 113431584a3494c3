"""Which effect: exact refits of what the score tests find promising, in order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Facts
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.scores import Score, bic, by_name, candidates, scores

CLOSE = 0.75
"""Effects that explain at least this part of what the best one explains are refitted exactly.

The first order misjudges what is not linear, so the best one of it need not be the best. Below this part an
effect leaves a quarter of the squares that the best one explains, far more than a refit makes up for."""
REFITS = 6
"""Effects that are refitted at most; each takes some five passes over the log."""
STARTS = 3
"""Starts that are refitted of an effect whose numbers were searched on a grid: the first order of one, such
as a rail, says little of where it ends."""
NEARLY, UNSEEN = 0.97, 0.01
"""Part of the best effect's gain, and relative gap, within which fewer parameters are preferred.

Real machines have imperfections of every kind below the threshold (5 %) of what is worth reporting. Both are
below it: what they leave out is no finding. The smaller effect is then the simpler explanation; the other
stays listed, as not excluded."""
FORESEEN = 0.75
"""Gap that is left on other runs, over that of the best fitting effect, by which an effect beats it.

A first order is good to about a quarter (`CLOSE`); what is better by more foresees more."""
ALIKE = 0.05
"""Relative difference of the gaps of two exact fits up to which they fit alike: what is worth reporting."""


@dataclass(frozen=True, eq=False)
class Exact:
    """An effect refitted exactly."""

    score: Score
    fit: Refitted
    bic: float


def refitted(
    base: Base,
    scored: Sequence[Score],
    runs: Sequence[int],
    facts: Facts,
    inflation: float,
    worth: Callable[[Score], bool],
    stands: Callable[[Exact], bool] = lambda _: True,
) -> list[Exact]:
    """Refit the promising effects exactly, shapes refined; best first. None where none is `worth` it.

    An effect whose fit does not `stand`, or that no start brings to parameters that its cause can have, is
    left out but for its plainer variants, and what it was in the way of is looked at.
    """

    def exact(first: Score) -> Exact | None:
        starts = [s for s in left if s.effect is first.effect and s.gain >= CLOSE * first.gain]
        wanted, possible = (STARTS if first.variant.tried > 1 else 1), []
        for score in starts[:REFITS]:
            found = _exact(base, _finer(base, score, runs, facts, inflation), runs, inflation)
            if score.effect.possible(found.fit.base.values):
                possible.append(found)
            if len(possible) == wanted:
                break
        best = min(possible, key=lambda e: e.bic, default=None)
        return best if best is not None and stands(best) else None

    left = list(scored)
    known: dict[int, Exact | None] = {}
    for _ in range(REFITS):
        tried = _promising(left, worth)
        known |= {id(s): exact(s) for s in tried if id(s) not in known}
        fitted = [(s, known[id(s)]) for s in tried]
        out = [e for _, e in fitted if e is not None]
        if len(out) == len(fitted) or any(worth(e.score) for e in out):
            return _ordered(out, left, worth)
        fallen = {s.effect.name: s.size for s, e in fitted if e is None}
        left = [s for s in left if s.size < fallen.get(s.effect.name, s.size + 1)]
    return []


def _promising(scored: Sequence[Score], worth: Callable[[Score], bool]) -> list[Score]:
    """Effects that explain nearly as much as the best one that is `worth` it.

    What explains much of the runs that it was fitted on and nothing of others is not what others are held
    against.
    """
    named = [s for s in by_name(scored) if not s.absorbed]
    best = max((s.gain for s in named if worth(s)), default=np.inf)
    return [s for s in named if s.gain >= CLOSE * best and s.ratio < 1][:REFITS]


def _exact(base: Base, score: Score, runs: Sequence[int], inflation: float) -> Exact:
    fit = refit(with_model(base, score.model), runs)
    return Exact(score, fit, bic_of(fit, score.size, inflation))


def bic_of(fit: Refitted, size: int, inflation: float) -> float:
    """Return the BIC of a fit with `size` parameters more than the model without effects has."""
    N = float(fit.tangents.count[fit.fitted].sum()) * len(fit.base.model.channels)
    return bic(fit.cost, N / inflation, size, N)


def _ordered(exact: Sequence[Exact], scored: Sequence[Score], worth: Callable[[Score], bool]) -> list[Exact]:
    """Best first; those that are not `worth` it behind those that are."""
    first = _plain_first(sorted(exact, key=lambda e: e.bic), scored)
    return _foreseen_first([e for e in first if worth(e.score)]) + [e for e in first if not worth(e.score)]


def _foreseen_first(exact: list[Exact]) -> list[Exact]:
    """Put the effect first that fits nearly as well as the best one and predicts other runs far better.

    Where much else is left, that is no noise, and BIC has no measure for it.
    """
    if not exact:
        return exact
    gap = exact[0].fit.gap(exact[0].fit.fitted)
    near = [e for e in exact if e.fit.gap(e.fit.fitted) <= gap * (1 + ALIKE)]
    least = min(near, key=lambda e: e.score.ratio)
    if least.score.ratio >= FORESEEN * exact[0].score.ratio:
        return exact
    return [least, *(e for e in exact if e is not least)]


def _plain_first(exact: list[Exact], scored: Sequence[Score]) -> list[Exact]:
    """Put an effect with fewer parameters first if it explains as good as all that the best one does.

    Real machines have small imperfections of every kind: many parameters take some of them along, and with
    enough samples that is significant without being evidence. An effect that has a form as plain itself stays
    first. Of two that are the same on this log the one for which fewer numbers were searched goes first, then
    the one that stands first in the catalogue.
    """
    if not exact:
        return exact
    best = exact[0]
    gap, gain = best.fit.gap(best.fit.fitted), best.score.gain
    plain = [
        e
        for e in exact[1:]
        if e.score.size < best.score.size
        and e.fit.cost - best.fit.cost <= (1 - NEARLY) * gain
        and e.fit.gap(e.fit.fitted) <= gap * (1 + UNSEEN)
        and not _as_plain(best.score, e.score, scored)
    ]
    if plain:
        first = min(plain, key=lambda e: (e.score.size, e.bic))
    else:
        same = [best, *(e for e in exact[1:] if _same(best, e))]
        first = min(same, key=lambda e: (e.score.variant.tried, e.score.place))
    return [first, *(e for e in exact if e is not first)]


def _as_plain(best: Score, other: Score, scored: Sequence[Score]) -> bool:
    """Whether the best effect has a form with as few parameters as another that explains no less."""
    return any(
        s.effect is best.effect and s.size <= other.size and s.gain >= (1 - UNSEEN) * other.gain
        for s in scored
    )


def _same(a: Exact, b: Exact) -> bool:
    """Whether two effects of one size leave the same, to less than what one sample's noise adds."""
    N = float(a.fit.tangents.count[a.fit.fitted].sum()) * len(a.fit.base.model.channels)
    return a.score.size == b.score.size and abs(b.fit.cost - a.fit.cost) * N <= a.fit.cost


def _finer(base: Base, score: Score, runs: Sequence[int], facts: Facts, inflation: float) -> Score:
    """Refine a searched shape twice around its best value."""
    finer = score.effect.around(score.variant)
    if finer is None:
        return score
    tried, _ = candidates(base, [finer], facts)
    ranked, _ = scores(base, tried, runs, inflation)
    best = min([score, *ranked], key=lambda s: s.bic)
    return replace(best, effect=score.effect)


def distance(a: Refitted, b: Refitted) -> float:
    """Whitened squared distance between what two fits leave: how far this log tells them apart."""
    from hallsym.diagnosis.residuals import pieces

    known = {run for unit in a.fitted for run in a.tangents.runs[unit]}
    total = 0.0
    for one, other in zip(pieces(a.base, frozenset(known)), pieces(b.base, frozenset(known)), strict=True):
        total += float((((one.residual - other.residual) * one.used) ** 2).sum())
    return total
