"""Which effect: exact refits of what the score tests find promising, and their order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, Screen, by_name, candidates
from hallsym.model import Effect, Facts


@dataclass(frozen=True, eq=False)
class Exact:
    """An effect refitted exactly.

    Of a selected one, `squares_before`: whitened squares that were left without it; `rivals`: the others that
    were refitted for its place.
    """

    score: Score
    fit: Refitted
    bic: float
    squares_before: float = np.inf
    rivals: tuple["Exact", ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.score.effect.name


def refitted(
    base: Base,
    scored: Sequence[Score],
    runs: Sequence[int],
    facts: Facts,
    worth: Callable[[Score], bool],
    stands: Callable[[Exact], bool] = lambda _: True,
    policy: Policy = POLICY,
) -> list[Exact]:
    """Refit the promising effects exactly and return them, best first; none if none is `worth` it.

    An effect whose refit does not `stand`, or that no start brings to parameters that its cause can have, is
    left out except for its variants with fewer parameters: those that promise as much are refitted in its
    place. If none is worth it, effects that it had displaced are refitted.
    """

    def exact(first: Score) -> Exact | None:
        starts = [s for s in left if s.effect is first.effect and s.gain >= policy.mostly * first.gain]
        wanted = policy.starts if first.variant.tried > 1 else 1
        possible: list[Exact] = []
        for score in starts[: policy.most_refits]:
            found = _exact(base, _finer(base, score, runs, facts, policy), runs, policy)
            if score.effect.possible(found.fit.base.values):
                possible.append(found)
            if len(possible) == wanted:
                break
        best = min(possible, key=lambda e: e.bic, default=None)
        return best if best is not None and stands(best) else None

    left = list(scored)
    known: dict[int, Exact | None] = {}
    for _ in range(policy.most_refits):
        tried = _promising(left, worth, policy)
        known |= {id(s): exact(s) for s in tried if id(s) not in known}
        fitted = [(s, known[id(s)]) for s in tried]
        out = [e for _, e in fitted if e is not None]
        fallen = {s.effect.name: s.size for s, e in fitted if e is None}
        rest = [s for s in left if s.size < fallen.get(s.effect.name, s.size + 1)]
        plainer = any(s.effect.name in fallen and id(s) not in known for s in _promising(rest, worth, policy))
        if not fallen or (any(worth(e.score) for e in out) and not plainer):
            return ordered(out, left, worth, policy)
        left = rest
    return []


def _promising(scored: Sequence[Score], worth: Callable[[Score], bool], policy: Policy) -> list[Score]:
    """Return the effects that explain nearly as much as the best one that is `worth` it.

    An effect that lowers no gap in cross-validation is no competitor, whatever it explains of the runs that
    it was fitted on.
    """
    named = [s for s in by_name(scored) if not s.absorbed]
    best = max((s.gain for s in named if worth(s)), default=np.inf)
    return [s for s in named if s.gain >= policy.mostly * best and s.ratio < 1][: policy.most_refits]


def _finer(base: Base, score: Score, runs: Sequence[int], facts: Facts, policy: Policy) -> Score:
    """Refine a searched number around its best value."""
    finer = score.effect.around(score.variant)
    if finer is None:
        return score
    best = min([score, *_scores(base, [finer], runs, facts, policy)], key=lambda s: s.bic)
    return replace(best, effect=score.effect, p_value=score.p_value)


def _exact(base: Base, score: Score, runs: Sequence[int], policy: Policy) -> Exact:
    fit = refit(with_model(base, score.model), runs)
    return Exact(score, fit, fit.bic(score.size, policy.inflation))


# -- the order ---------------------------------------------------------------------------------------------


def ordered(
    exact: Sequence[Exact], scored: Sequence[Score], worth: Callable[[Score], bool], policy: Policy
) -> list[Exact]:
    """Order exact refits, best first; those that are not `worth` it behind those that are."""
    first = _simpler_first(sorted(exact, key=lambda e: e.bic), scored, policy)
    counted = [e for e in first if worth(e.score)]
    return counted + [e for e in first if not worth(e.score)]


def _simpler_first(exact: list[Exact], scored: Sequence[Score], policy: Policy) -> list[Exact]:
    """Put an effect with fewer parameters first if it explains nearly all that the best one does.

    Real machines have small imperfections of every kind. Many parameters take some of them along, which with
    enough samples is significant and yet no evidence. The best effect stays first if it has a variant with as
    few parameters that explains as much. Of two effects that fit the same on this log, the one with fewer
    searched numbers goes first, then the one that comes first in the catalogue.
    """
    if not exact:
        return exact
    best = exact[0]
    simpler = [e for e in exact[1:] if _simpler(e, best, scored, policy)]
    if simpler:
        return _first(min(simpler, key=lambda e: (e.score.size, e.bic)), exact)
    same = [best, *(e for e in exact[1:] if _same(best, e))]
    return _first(min(same, key=lambda e: (e.score.variant.tried, e.score.place)), exact)


def _simpler(e: Exact, best: Exact, scored: Sequence[Score], policy: Policy) -> bool:
    return (
        e.score.size < best.score.size
        and e.bic - best.bic <= policy.negligible * best.score.gain
        and e.fit.metric <= best.fit.metric * (1 + policy.negligible)
        and not any(
            s.effect is best.score.effect
            and s.size <= e.score.size
            and s.gain >= (1 - policy.negligible) * e.score.gain
            and s.bic <= e.score.bic + policy.as_good
            for s in scored
        )
    )


def _same(a: Exact, b: Exact) -> bool:
    """Return whether two effects of one size leave the same, to less than the noise of one reading."""
    return a.score.size == b.score.size and abs(b.fit.cost - a.fit.cost) * a.fit.readings <= a.fit.cost


def plain_pairs_first(
    exact: list[Exact], catalogue: Sequence[Effect], runs: Sequence[int], facts: Facts, policy: Policy
) -> list[Exact]:
    """Put a plain effect first if it and a second explain more than the flexible best one, by BIC.

    An effect with many parameters may take small imperfections along and so explain more than the plain cause
    does. Then the plain cause and one of the imperfections together explain as much with no more parameters,
    and the flexible effect with a second one leaves nearly as much as these two.
    """
    if not exact:
        return exact
    best = exact[0]
    plain = [
        e
        for e in exact[1:]
        if e.score.size < best.score.size and e.score.gain >= policy.mostly * best.score.gain
    ]
    found: list[tuple[float, Exact, float]] = []
    for e in plain:
        second = _second(e, catalogue, runs, facts, policy)
        if second is None or second.size + e.score.size > best.score.size:
            continue
        both = second.bic + e.score.size * float(np.log(max(e.fit.readings / policy.inflation, 2.0)))
        if both < best.bic:
            found.append((both, e, e.fit.cost - second.gain))
    if not found:
        return exact
    _, first, left = min(found, key=lambda f: f[0])
    second = _second(best, catalogue, runs, facts, policy)
    if second is not None and best.fit.cost - second.gain < policy.half * left:
        return exact
    return _first(first, exact)


def _second(
    e: Exact, catalogue: Sequence[Effect], runs: Sequence[int], facts: Facts, policy: Policy
) -> Score | None:
    """Return the best second effect beside one, by its score."""
    scores = _scores(e.fit.base, catalogue, runs, facts, policy)
    return next((s for s in scores if not s.absorbed), None)


def _scores(
    base: Base, effects: Sequence[Effect], runs: Sequence[int], facts: Facts, policy: Policy
) -> list[Score]:
    tried, _ = candidates(base, effects, facts)
    return Screen(base, tried, runs, policy.inflation).scores


def _first(first: Exact, exact: Sequence[Exact]) -> list[Exact]:
    return [first, *(e for e in exact if e is not first)]
