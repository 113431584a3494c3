"""Which effects are promising: score tests of the whole catalogue from one pass over the log."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.normal_equations import NormalEquations, normal_equations
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.refit import inverse, solve
from hallsym.errors import InputError
from hallsym.estimation.decoding import columns_of
from hallsym.model import Model

FOLDS = 11
"""A prime, so that folds do not fall in step with settings that recur every few runs."""
NIL = 1e-9
"""Part of a column's squares below which what is left of it is rounding (products are good to 1e-13)."""


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
) -> tuple[list[Score], NormalEquations]:
    """Score every candidate on `runs`; best first (by BIC), one pass over the log."""
    t = normal_equations(base, {key: (model, new) for key, (_, _, model, new) in tried.items()})
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
                bic(cost, N / inflation, size, N),
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


def bic(cost: float, effective: float, size: int, N: float) -> float:
    """Return the Bayesian information criterion of squares over N numbers, `effective` of them free."""
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
