"""Which effect: score tests of the whole catalogue from one pass, then exact refits of what is promising."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.decoding import columns_of
from hallsym.diagnosis.chance import beyond
from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.refit import Refitted, inverse, refit, solve, with_model
from hallsym.diagnosis.tangent import Base, Tangents, tangents
from hallsym.errors import InputError
from hallsym.model import Model

FOLDS = 11
"""A prime, so that folds do not fall in step with settings that recur every few runs."""
CLOSE = 0.75
"""Effects that explain at least this part of what the best one explains are refitted exactly.

The first order misjudges what is not linear, so the best one of it need not be the best. Below this part an
effect leaves a quarter of the squares that the best one explains, far more than a refit makes up for."""
REFITS = 6
"""Effects that are refitted at most; each takes some five passes over the log."""
STARTS = 3
"""Starts that are refitted of an effect whose numbers were searched on a grid: the first order of one, such
as a rail, says little of where it ends."""
NIL = 1e-9
"""Part of a column's squares below which what is left of it is rounding (products are good to 1e-13)."""
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
class Score:
    """What one variant of an effect would explain, to first order.

    `gain`: decrease of the whitened squares on the fitted runs; `bic`: N log cost plus the price of its
    parameters; `ratio`: gap metric over that without it, cross-validated within the fitted runs; `p_value`:
    of the score test across runs, before any correction for what else was tried. `absorbed`: the model's own
    parameters hide it. `place`: of the effect in the catalogue, the usual causes first.
    """

    effect: Effect
    variant: Variant
    model: Model
    gain: float
    size: int
    bic: float
    ratio: float
    p_value: float
    absorbed: bool = False
    place: int = 0

    def corrected(self, effects: int) -> float:
        """Return the p-value corrected for `effects` tested and for the numbers searched within this one."""
        return min(1.0, self.p_value * effects * self.variant.tried)


@dataclass(frozen=True, eq=False)
class Trouble:
    """An effect that could not be tried, and why."""

    name: str
    reason: str


def candidates(
    base: Base, catalogue: Sequence[Effect], facts: Facts
) -> tuple[dict[str, tuple[Effect, Variant, Model, list[str]]], list[Trouble]]:
    """Return every variant of every effect that this log can show, and the effects that it cannot."""
    out: dict[str, tuple[Effect, Variant, Model, list[str]]] = {}
    trouble = []
    for effect in catalogue:
        missing = [c for c in effect.needs if c not in facts.columns]
        if missing:
            what = "time" if missing[0] == "t_s" else missing[0].rsplit("_", 1)[0]
            trouble.append(Trouble(effect.name, f"no {what} logged"))
            continue
        if effect.name in base.model.effects:
            continue
        try:
            variants = effect.variants(base.model, facts)
            for variant in variants:
                wide, new = _extended(base.model, effect, variant)
                lacking = _lacking(wide, facts)
                if lacking:
                    raise InputError(f"no {lacking} logged")
                out[f"{effect.name}|{variant.label}"] = (effect, variant, wide, new)
        except InputError as error:
            trouble.append(Trouble(effect.name, str(error)))
        except Exception as error:  # a user's effect may raise anything: the others still run
            trouble.append(Trouble(effect.name, f"raised {type(error).__name__}: {error}"))
    return out, trouble


def _lacking(model: Model, facts: Facts) -> str | None:
    """Return a column that the model reads and the log does not have."""
    made = {c.name for c in model.computed}
    needed = [*columns_of(model), *(c for m in model.computed for c in m.needs)]
    return next((c for c in needed if c not in made and c not in facts.columns), None)


def _extended(model: Model, effect: Effect, variant: Variant) -> tuple[Model, list[str]]:
    wide = variant.make(model)
    if not isinstance(wide, Model):
        raise InputError(
            f"Effect {effect.name} must return a Model; instead it returned {type(wide).__name__}."
        )
    new = [p.name for p in wide.parameters if p.name not in model.names]
    if not new:
        raise InputError(f"Effect {effect.name} adds no parameter, so there is nothing to test.")
    return wide, new


def scores(
    base: Base,
    tried: dict[str, tuple[Effect, Variant, Model, list[str]]],
    runs: Sequence[int],
    inflation: float,
) -> tuple[list[Score], Tangents]:
    """Score every candidate on `runs`; best first (by BIC), one pass over the log."""
    t = tangents(base, {key: (model, new) for key, (_, _, model, new) in tried.items()})
    tried = {key: entry for key, entry in tried.items() if key not in t.spoiled}
    units, K = t.units(runs), len(base.model.channels)
    folds = [units[k::FOLDS] for k in range(min(FOLDS, len(units)))]
    sums = [t.likelihood[f].sum(axis=0) for f in folds]
    total = _Split(np.sum(sums, axis=0), t.span[""].stop)
    N = float(t.count[units].sum()) * K
    start = total.square
    parts = [
        (_Split(total.M - own, t.span[""].stop), t.output[f].sum(axis=0), own)
        for f, own in zip(folds, sums, strict=True)
    ]
    plain = sum(train.tested(output, NONE)[-1, -1] for train, output, _ in parts)
    out = []
    places = {name: k for k, name in enumerate(dict.fromkeys(e.name for e, *_ in tried.values()))}
    for key, (effect, variant, model, new) in tried.items():
        at = np.arange(t.span[key].start, t.span[key].stop)
        own = total.of(at)
        raw, left = np.diag(total.M)[at], np.diag(own)[:-1]
        absorbed = bool(np.all(left <= NIL * np.maximum(raw, 1e-300)))
        lower, upper = (b[[model.names.index(n) for n in new]] for b in model.bounds)
        v = np.append(-np.clip(total.solved(at, raw), lower, upper), 1.0)
        cost = float(v @ own @ v)
        gain = max(start - cost, 0.0)
        size = len(new) + variant.shapes
        ratio, p = _cross_validated(parts, at, raw, lower, upper, plain, -v[:-1])
        out.append(
            Score(
                effect,
                variant,
                model,
                gain,
                size,
                _bic(cost, N / inflation, size, N),
                ratio,
                p,
                absorbed,
                places[effect.name],
            )
        )
    return sorted(out, key=lambda s: s.bic), t


NONE = np.zeros(0, dtype=int)


class _Split:
    """Products over some units with the model's own parameters taken out of what is asked for."""

    def __init__(self, products: np.ndarray, parameters: int) -> None:
        self.M = products
        self.own = parameters
        self.through = inverse(self.M[:parameters, :parameters]) @ self.M[:parameters]

    @property
    def square(self) -> float:
        """Squares that the model leaves."""
        return float(self.of(NONE)[-1, -1])

    def of(self, at: np.ndarray) -> np.ndarray:
        """Return the products of the columns `at` and the residual."""
        pick = np.append(at, len(self.M) - 1)
        return self.M[pick[:, None], pick] - self.M[pick, : self.own] @ self.through[:, pick]

    def solved(self, at: np.ndarray, raw: np.ndarray) -> np.ndarray:
        """Return coefficients of the columns `at`; 0 where next to nothing of their squares `raw` is left."""
        own = self.of(at)
        seen = np.flatnonzero(np.diag(own)[:-1] > NIL * np.maximum(raw, 1e-300))
        pick = np.append(seen, len(at))
        out = np.zeros(len(at))
        out[seen] = solve(own[pick[:, None], pick], np.arange(len(seen)))
        return out

    def tested(self, M: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return products of other units with what was taken out as these units say."""
        pick = np.append(at, len(self.M) - 1)
        P = self.through[:, pick]
        across = M[pick, : self.own] @ P
        return M[pick[:, None], pick] - across - across.T + P.T @ M[: self.own, : self.own] @ P


def _bic(cost: float, effective: float, size: int, N: float) -> float:
    return float(effective * np.log(max(cost, 1e-300) / N) + size * np.log(max(effective, 2.0)))


def _cross_validated(
    parts: list[tuple[_Split, np.ndarray, np.ndarray]],
    at: np.ndarray,
    raw: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    plain: float,
    best: np.ndarray,
) -> tuple[float, float]:
    """Gap metric over that without the effect, and the significance of its score, both across runs.

    The score of each fold is taken along what the other folds say, so under no effect its mean is 0. Tested
    against how what the effect leaves scatters between folds of runs, whatever happens within a run.
    """
    total, scores, noise = 0.0, [], []
    for train, output, likelihood in parts:
        theta = np.clip(train.solved(at, raw), lower, upper)
        v = np.append(-theta, 1.0)
        total += float(v @ train.tested(output, at) @ v)
        M = train.tested(likelihood, at)
        scores.append(float(theta @ M[:-1, -1]))
        noise.append(float(theta @ (M[:-1, -1] - M[:-1, :-1] @ best)))
    return float(np.sqrt(total / max(plain, 1e-300))), beyond(np.array(scores), np.array(noise))


def by_name(ranked: Sequence[Score]) -> list[Score]:
    """Keep the best variant of each effect, best first."""
    seen: dict[str, Score] = {}
    for score in ranked:
        seen.setdefault(score.effect.name, score)
    return list(seen.values())


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
    return _bic(fit.cost, N / inflation, size, N)


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
    effect, shape = score.effect, score.variant.shape
    if effect.refine is None or shape is None:
        return score
    refine, width = effect.refine, float(shape)
    finer = replace(effect, variants=lambda m, f: refine(m, f, width))
    tried, _ = candidates(base, [finer], facts)
    ranked, _ = scores(base, tried, runs, inflation)
    best = min([score, *ranked], key=lambda s: s.bic)
    return replace(best, effect=effect)


def distance(a: Refitted, b: Refitted) -> float:
    """Whitened squared distance between what two fits leave: how far this log tells them apart."""
    from hallsym.diagnosis.survey import pieces

    known = {run for unit in a.fitted for run in a.tangents.runs[unit]}
    total = 0.0
    for one, other in zip(pieces(a.base, frozenset(known)), pieces(b.base, frozenset(known)), strict=True):
        total += float((((one.residual - other.residual) * one.used) ** 2).sum())
    return total
