"""Which effect: score tests of the whole catalogue from one pass, then exact refits of what is promising."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.decoding import columns_of
from hallsym.diagnosis.chance import chance
from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.refit import Refitted, inverse, refit, solve, with_model
from hallsym.diagnosis.tangent import Base, Tangents, tangents
from hallsym.errors import InputError
from hallsym.model import Model

FOLDS = 8
CLOSE = 0.75
"""Effects that explain at least this part of what the best one explains are refitted exactly."""
REFITS = 6


@dataclass(frozen=True, eq=False)
class Score:
    """What one variant of an effect would explain, to first order.

    `gain`: decrease of the whitened squares on the fitted runs; `bic`: N log cost plus the price of its
    parameters; `ratio`: gap metric over that without it, cross-validated within the fitted runs; `p_value`:
    of the score test, honest for correlated residuals. `absorbed`: the model's own parameters hide it.
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
            trouble.append(Trouble(effect.name, f"no {missing[0].rsplit('_', 1)[0]} logged"))
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
    units = t.units(runs)
    n_base, K = t.span[""].stop, len(base.model.channels)
    basis = np.arange(n_base)
    total = t.likelihood[units].sum(axis=0)
    N = float(t.count[units].sum()) * K
    own = _project(total, basis)
    start = own[-1, -1]
    folds = [units[k::FOLDS] for k in range(min(FOLDS, len(units)))]
    parts = [_fold(t, units, fold, basis) for fold in folds]
    plain = sum(o[-1, -1] for _, o in parts)
    out = []
    for key, (effect, variant, model, new) in tried.items():
        at = np.arange(t.span[key].start, t.span[key].stop)
        raw, left = np.diag(total)[at], np.diag(own)[at]
        absorbed = bool(np.all(left <= 1e-9 * np.maximum(raw, 1e-300)))
        theta = solve(own, at)
        lower, upper = (b[[model.names.index(n) for n in new]] for b in model.bounds)
        held = np.clip(theta, lower, upper)
        v = np.zeros(len(own))
        v[at], v[-1] = -held, 1.0
        cost = float(v @ own @ v)
        gain = max(start - cost, 0.0)
        ratio = _cross_validated(parts, at, lower, upper, plain)
        noise = max(cost / N, 1e-12)
        out.append(
            Score(
                effect, variant, model, gain, len(new) + variant.shapes,
                _bic(cost, N / inflation, len(new) + variant.shapes, N), ratio,
                chance(gain / (noise * inflation), len(new) + variant.shapes), absorbed,
            )
        )  # fmt: skip
    return sorted(out, key=lambda s: s.bic), t


def _bic(cost: float, effective: float, size: int, N: float) -> float:
    return float(effective * np.log(max(cost, 1e-300) / N) + size * np.log(max(effective, 2.0)))


def _project(M: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Take the columns `basis` out of all others."""
    T = _projector(M, basis)
    return T.T @ M @ T


def _projector(M: np.ndarray, basis: np.ndarray) -> np.ndarray:
    T = np.eye(len(M))
    T[np.ix_(basis, np.arange(len(M)))] -= inverse(M[np.ix_(basis, basis)]) @ M[basis]
    return T


def _fold(
    t: Tangents, units: np.ndarray, fold: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Training products with the basis taken out, and the output products of the fold, alike."""
    train = t.likelihood[np.setdiff1d(units, fold)].sum(axis=0)
    T = _projector(train, basis)
    return T.T @ train @ T, T.T @ t.output[fold].sum(axis=0) @ T


def _cross_validated(
    parts: list[tuple[np.ndarray, np.ndarray]],
    at: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    plain: float,
) -> float:
    total = 0.0
    for train, test in parts:
        theta = np.clip(solve(train, at), lower, upper)
        v = np.concatenate([-theta, [1.0]])
        pick = np.append(at, len(train) - 1)
        total += float(v @ test[np.ix_(pick, pick)] @ v)
    return float(np.sqrt(total / max(plain, 1e-300)))


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
    base: Base, scored: Sequence[Score], runs: Sequence[int], facts: Facts, inflation: float
) -> list[Exact]:
    """Refit the promising effects exactly, shapes refined; best first."""
    best = max((s.gain for s in scored), default=0.0)
    promising = [s for s in by_name(scored) if s.gain >= CLOSE * best and not s.absorbed][:REFITS]
    out = []
    for score in promising:
        score = _finer(base, score, runs, facts, inflation)
        variants = [score]
        # the best variant to first order need not be the best one exactly
        fits = [(s, refit(with_model(base, s.model), runs)) for s in variants]
        for s, fit in fits:
            N = float(fit.tangents.count[fit.fitted].sum()) * len(base.model.channels)
            out.append(Exact(s, fit, _bic(fit.cost, N / inflation, s.size, N)))
    return sorted(out, key=lambda e: e.bic)


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
