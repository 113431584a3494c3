"""Screening: score tests of the whole catalogue, from one pass over the log."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hallsym.diagnosis.normal_equations import NormalEquations, coefficients, normal_equations
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.residuals import Base
from hallsym.errors import InputError
from hallsym.estimation import pseudo_inverse
from hallsym.estimation.decoding import columns_of
from hallsym.model import Effect, Facts, Model, Variant

FOLDS = 11
"""A prime, so that folds do not fall in step with settings that recur every few runs."""
NIL = 1e-9
"""Part of a column's squares below which what is left of it is rounding (products are good to 1e-13)."""


class Candidate(NamedTuple):
    """One variant of an effect on a model: the extended `model` and the names of its `new` parameters."""

    effect: Effect
    variant: Variant
    model: Model
    new: list[str]


@dataclass(frozen=True, eq=False)
class Score:
    """What one variant of an effect would explain, to first order.

    `gain`: decrease of the whitened squares on the fitted runs. `size`: parameters added, searched numbers
    included. `bic`: Bayesian information criterion with the effect. `ratio`: gap metric over that without the
    effect, cross-validated within the fitted runs. `p_value`: of the score test across runs, not corrected.
    `absorbed`: the model's own parameters can do the same. `place`: of the effect in the catalogue, usual
    causes first.
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
) -> tuple[dict[str, Candidate], list[Trouble]]:
    """Return every variant of every effect that this log can show, and the effects that it cannot."""
    out: dict[str, Candidate] = {}
    trouble = []
    for effect in catalogue:
        if effect.name in base.model.effects:
            continue
        try:
            for candidate in _variants(base.model, effect, facts):
                out[f"{effect.name}|{candidate.variant.label}"] = candidate
        except InputError as error:
            trouble.append(Trouble(effect.name, str(error)))
        except Exception as error:  # a user's effect may raise anything: the others still run
            trouble.append(Trouble(effect.name, f"raised {type(error).__name__}: {error}"))
    return out, trouble


def _variants(model: Model, effect: Effect, facts: Facts) -> Iterator[Candidate]:
    missing = [c for c in effect.needs if c not in facts.columns]
    if missing:
        what = "time" if missing[0] == "t_s" else missing[0].rsplit("_", 1)[0]
        raise InputError(f"no {what} logged")
    for variant in effect.variants(model, facts):
        wide, new = _extended(model, effect, variant)
        lacking = _lacking(wide, facts)
        if lacking:
            raise InputError(f"no {lacking} logged")
        yield Candidate(effect, variant, wide, new)


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
    base: Base, tried: dict[str, Candidate], runs: Sequence[int], inflation: float = POLICY.inflation
) -> tuple[list[Score], frozenset[str]]:
    """Score every candidate on `runs`, best first (by BIC); return those that are not finite beside it.

    One pass over the log for all candidates, or for as many as have `COLUMNS` parameters together.
    """
    places = {name: k for k, name in enumerate(dict.fromkeys(c.effect.name for c in tried.values()))}
    found, spoiled = list[Score](), frozenset[str]()
    for part in _parts(tried):
        t = normal_equations(base, {key: (c.model, c.new) for key, c in part.items()})
        found += _scored(t, part, base, runs, inflation, places)
        spoiled |= t.spoiled
    return sorted(found, key=lambda s: s.bic), spoiled


COLUMNS = 400
"""Parameters of candidates that are screened in one pass: 1.3 MB for the products of each run, twice."""


def _parts(tried: dict[str, Candidate]) -> Iterator[dict[str, Candidate]]:
    """Yield the candidates in parts of at most `COLUMNS` parameters, in order."""
    part: dict[str, Candidate] = {}
    size = 0
    for key, c in tried.items():
        if part and size + len(c.new) > COLUMNS:
            yield part
            part, size = {}, 0
        part[key] = c
        size += len(c.new)
    yield part


def _scored(
    t: NormalEquations,
    tried: dict[str, Candidate],
    base: Base,
    runs: Sequence[int],
    inflation: float,
    places: dict[str, int],
) -> list[Score]:
    """Score candidates from their products."""
    units = t.units(runs)
    groups = [units[k::FOLDS] for k in range(min(FOLDS, len(units)))]
    sums = [t.likelihood[g].sum(axis=0) for g in groups]
    own = t.span[""].stop
    total = _Split(np.sum(sums, axis=0), own)
    folds = [
        _Fold(_Split(total.M - left_out, own), t.output[g].sum(axis=0), left_out)
        for g, left_out in zip(groups, sums, strict=True)
    ]
    plain = sum(f.train.tested(f.output, NONE)[-1, -1] for f in folds)
    N = float(t.count[units].sum()) * len(base.model.channels)
    out = []
    for key, c in tried.items():
        if key in t.spoiled:
            continue
        at = np.arange(t.span[key].start, t.span[key].stop)
        products = total.of(at)
        raw, left = np.diag(total.M)[at], np.diag(products)[:-1]
        lower, upper = (b[[c.model.names.index(n) for n in c.new]] for b in c.model.bounds)
        best = np.clip(total.solved(at, raw), lower, upper)
        v = np.append(-best, 1.0)
        cost = float(v @ products @ v)
        ratio, p = _cross_validated(folds, at, raw, (lower, upper), plain, best)
        size = len(c.new) + c.variant.shapes
        out.append(
            Score(
                effect=c.effect,
                variant=c.variant,
                model=c.model,
                gain=max(total.square - cost, 0.0),
                size=size,
                bic=bic(cost, N / inflation, size, N),
                ratio=ratio,
                p_value=p,
                absorbed=bool(np.all(left <= NIL * np.maximum(raw, 1e-300))),
                place=places[c.effect.name],
            )
        )
    return out


NONE = np.zeros(0, dtype=int)


class _Split:
    """Products over some units, the model's own parameters projected out of the columns asked for."""

    def __init__(self, products: np.ndarray, parameters: int) -> None:
        self.M = products
        self.own = parameters
        self.through = pseudo_inverse(self.M[:parameters, :parameters]) @ self.M[:parameters]

    @property
    def square(self) -> float:
        """Squares that the model leaves."""
        return float(self.of(NONE)[-1, -1])

    def of(self, at: np.ndarray) -> np.ndarray:
        """Return the products of the columns `at` and the residual."""
        pick = np.append(at, len(self.M) - 1)
        return self.M[pick[:, None], pick] - self.M[pick, : self.own] @ self.through[:, pick]

    def solved(self, at: np.ndarray, raw: np.ndarray) -> np.ndarray:
        """Return the coefficients of the columns `at`, 0 where the model absorbs their squares `raw`."""
        own = self.of(at)
        seen = np.flatnonzero(np.diag(own)[:-1] > NIL * np.maximum(raw, 1e-300))
        pick = np.append(seen, len(at))
        out = np.zeros(len(at))
        out[seen] = coefficients(own[pick[:, None], pick], np.arange(len(seen)))
        return out

    def tested(self, M: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the products of other units, with the projection that these units give."""
        pick = np.append(at, len(self.M) - 1)
        P = self.through[:, pick]
        across = M[pick, : self.own] @ P
        return M[pick[:, None], pick] - across - across.T + P.T @ M[: self.own, : self.own] @ P


class _Fold(NamedTuple):
    """A group of runs left out: products of the others, and of its own in the output and the likelihood."""

    train: _Split
    output: np.ndarray
    likelihood: np.ndarray


def bic(cost: float, effective: float, size: int, N: float) -> float:
    """Return the Bayesian information criterion of squares over N numbers, `effective` independent."""
    return float(effective * np.log(max(cost, 1e-300) / N) + size * np.log(max(effective, 2.0)))


def _cross_validated(
    folds: list[_Fold],
    at: np.ndarray,
    raw: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    plain: float,
    best: np.ndarray,
) -> tuple[float, float]:
    """Return the gap metric over that without the effect, and the p-value of its score, both across runs.

    The coefficients come from the other folds, so without an effect the score of a fold has mean 0. Its
    scatter is that of the residual with the effect fitted (`best`), from fold to fold: it holds for noise
    that is correlated within a run.
    """
    total, scores, noise = 0.0, [], []
    for train, output, likelihood in folds:
        theta = np.clip(train.solved(at, raw), *bounds)
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
