"""Screening: score tests of the whole catalogue, from one pass over the log."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hallsym.diagnosis.measurement_error import shared_noise
from hallsym.diagnosis.normal_equations import NormalEquations, coefficients, of_parts
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import Significance
from hallsym.diagnosis.regression import FOLDS, NIL
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.sign_flips import SignFlips, adjusted, least_p, searched, stretch
from hallsym.errors import InputError
from hallsym.estimation import pseudo_inverse
from hallsym.estimation.decoding import columns_of
from hallsym.model import Effect, Facts, Model, Variant


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
    effect, cross-validated within the fitted runs. `p_value`: from random signs of the runs' scores,
    corrected for all that was tried; `statistic`: what it rests on. `absorbed`: the model's own parameters
    can do the same. `place`: of the effect in the catalogue, usual causes first.
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
    statistic: float = -np.inf


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
    """Score every candidate on `runs`, best first, without p-values; and those that are not finite."""
    screen = Screen(base, tried, runs, inflation)
    return screen.scores, screen.spoiled


class Screen:
    """The catalogue scored beside one fit, from one pass over the log.

    `scores`: best first, by BIC. `significance`: that any of them is there at all. `tables`: the products of
    the candidates, in parts of as many as have `COLUMNS` parameters together, or of fewer (`NUMBERS`). `top`:
    the largest statistic of all with each draw of signs, that of the log first.
    """

    def __init__(
        self,
        base: Base,
        tried: dict[str, Candidate],
        runs: Sequence[int],
        inflation: float,
        *,
        colour: np.ndarray | None = None,
    ) -> None:
        """Score `tried` on `runs`; `colour`: autocorrelation of the residual, None: without p-values."""
        self.tried, self.tables, self.inflation = tried, list[Table](), inflation
        places = {name: k for k, name in enumerate(dict.fromkeys(c.effect.name for c in tried.values()))}
        variants = Counter(c.effect.name for c in tried.values())
        found, flipped = list[Score](), list[np.ndarray]()
        length = (
            stretch(base.log.rows / len(base.log.runs) * len(runs), len(runs)) if colour is not None else None
        )
        parts = list(_parts(tried, base.log.rows // length if length else len(base.log.runs)))
        plain = [{key: (c.model, c.new) for key, c in part.items()} for part in parts]
        made = of_parts(base, plain, length)
        shared = shared_noise(base, plain, length, colour) if colour is not None else [{} for _ in parts]
        for part, t, noise in zip(parts, made, shared, strict=True):
            table = Table(t, part, len(base.model.channels))
            flips = SignFlips(t, runs, noise) if colour is not None else None
            self.tables.append(table)
            for key, score in table.fast(runs, inflation):
                at, name = table.at(key), score.effect.name
                z = None if score.absorbed or flips is None else flips.statistic(at)
                if z is not None:
                    # numbers that were searched elsewhere, and are not among the variants
                    flipped.append(searched(z, score.variant.tried / variants[name]))
                p = 1.0 if z is None else -1.0
                found.append(
                    replace(
                        score,
                        place=places[name],
                        p_value=p,
                        ratio=table.ratio(key, runs),
                        statistic=-np.inf if z is None else float(flipped[-1][0]),
                    )
                )
        adjusted_p, least = adjusted(np.array(flipped))
        self.top = np.max(flipped, axis=0, initial=-np.inf) if flipped else None
        units = len(self.tables[0].t.units(runs))
        unit = "run" if length is None else "stretch"
        self.significance = Significance(least, least_p(units), units, unit)
        rest = iter(adjusted_p.tolist())
        found = [s if s.p_value > 0 else replace(s, p_value=next(rest)) for s in found]
        found = [replace(s, p_value=min(s.p_value, EVENTS * s.variant.by_itself)) for s in found]
        self.scores = sorted(found, key=lambda s: s.bic)

    def choice(self, runs: Sequence[int], level: float, taken: str | None, policy: Policy) -> "Choice | None":
        """Return what some of the runs alone would choose: the best by BIC that lowers the gap by `level`.

        `taken`: an effect that stays the choice where it is as good. To first order, from the products.
        """
        ranked = sorted(
            (
                (s.bic, s.gain, key, table)
                for table in self.tables
                for key, s in table.fast(runs, self.inflation)
            ),
            key=lambda r: r[0],
        )
        most = max((gain for _, gain, *_ in ranked), default=0.0)
        found: dict[str, tuple[float, Choice]] = {}
        for least, gain, key, table in ranked:
            name = table.tried[key].effect.name
            if name in found or gain < policy.promising * most or len(found) == policy.most_refits:
                continue
            if table.ratio(key, runs) <= 1 - level:
                found[name] = least, Choice(name, key, table)
        if not found:
            return None
        best = min(found.values(), key=lambda f: f[0])
        own = found.get(taken or "")
        return own[1] if own and own[0] - best[0] < policy.as_good else best[1]

    def foreseen(
        self, runs: Sequence[int], group: frozenset[int], choice: "Choice | None"
    ) -> dict[tuple[int, ...], float]:
        """Return the squared decoded errors of the runs of `group` as `runs` foresee them with a choice."""
        table = choice.table if choice else self.tables[0]
        at = table.at(choice.key) if choice else NONE
        train = Split(table.products(runs), table.own)
        theta = table.solved(train, choice.key) if choice else np.zeros(0)
        out: dict[tuple[int, ...], float] = {}
        for unit, own in enumerate(table.t.runs):
            if not group.isdisjoint(own):
                out[own] = out.get(own, 0.0) + train.error(table.t.output[unit], at, theta)
        return out

    @property
    def spoiled(self) -> frozenset[str]:
        """Candidates whose readings are not finite."""
        return frozenset(key for table in self.tables for key in table.t.spoiled)


EVENTS = 10.0
"""What the p-value of a single event is multiplied by, to stand beside those by signs (weighted Bonferroni).

An event such as a step lies in one run, of which signs know nothing. A tenth of the error rate is its own."""
FEWEST, COLUMNS = 100, 400
"""Parameters of candidates whose products are one table: of 1.3 MB for each run, twice, at most."""
NUMBERS = 12_500_000
"""Products of all candidates that are held, twice: 200 MB. Those of two candidates are nil, so that smaller
tables hold the same in less; in tables of fewer than `FEWEST` parameters the model's own are most."""


def _parts(tried: dict[str, Candidate], units: int) -> Iterator[dict[str, Candidate]]:
    """Yield the candidates in order, in parts of so many parameters that `NUMBERS` is kept."""
    everything = sum(len(c.new) for c in tried.values())
    most = int(np.clip(NUMBERS // max(1, units * everything), FEWEST, COLUMNS))
    part: dict[str, Candidate] = {}
    size = 0
    for key, c in tried.items():
        if part and size + len(c.new) > most:
            yield part
            part, size = {}, 0
        part[key] = c
        size += len(c.new)
    yield part


class Choice(NamedTuple):
    """A variant of an effect that was chosen, and the products that say so."""

    name: str
    key: str
    table: "Table"


NONE = np.zeros(0, dtype=int)


class Split:
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

    def cost(self, at: np.ndarray, theta: np.ndarray) -> float:
        """Return the squares that are left with the columns `at` times `theta`."""
        v = np.append(-theta, 1.0)
        return float(v @ self.of(at) @ v)

    def error(self, M: np.ndarray, at: np.ndarray, theta: np.ndarray) -> float:
        """Return the squares of other units, of products M, with what these units give."""
        v = np.append(-theta, 1.0)
        return float(v @ self.tested(M, at) @ v)

    def tested(self, M: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the products of other units, with the projection that these units give."""
        pick = np.append(at, len(self.M) - 1)
        P = self.through[:, pick]
        across = M[pick, : self.own] @ P
        return M[pick[:, None], pick] - across - across.T + P.T @ M[: self.own, : self.own] @ P


class Table:
    """Products of candidates and of the model's own parameters, from which any set of runs is scored."""

    def __init__(self, t: NormalEquations, tried: dict[str, Candidate], channels: int) -> None:
        self.t, self.tried, self.channels = t, tried, channels
        self.own = t.span[""].stop
        self.run = np.array([unit[0] for unit in t.runs])
        self.known: tuple[tuple[int, ...], list[tuple[Split, np.ndarray]]] = ((), [])

    def at(self, key: str) -> np.ndarray:
        """Return the columns of a candidate."""
        return np.arange(self.t.span[key].start, self.t.span[key].stop)

    def limits(self, key: str) -> tuple[np.ndarray, ...]:
        """Return the bounds of the parameters of a candidate."""
        c = self.tried[key]
        return tuple(b[[c.model.names.index(n) for n in c.new]] for b in c.model.bounds)

    def folds(self, runs: Sequence[int], count: int = FOLDS) -> list[np.ndarray]:
        """Return the units of groups of runs that are left out in turn."""
        units = self.t.units(runs)
        own = list(dict.fromkeys(self.run[units].tolist()))
        return [units[np.isin(self.run[units], own[k::count])] for k in range(min(count, len(own)))]

    def products(self, runs: Sequence[int]) -> np.ndarray:
        """Return the products of all columns over some runs."""
        return self.t.likelihood[self.t.units(runs)].sum(axis=0)

    def solved(self, train: "Split", key: str) -> np.ndarray:
        """Return the coefficients of a candidate within its bounds."""
        at = self.at(key)
        return np.clip(train.solved(at, np.diag(train.M)[at]), *self.limits(key))

    def ratio(self, key: str, runs: Sequence[int]) -> float:
        """Return the gap metric with a candidate over that without, cross-validated within some runs."""
        at, folds = self.at(key), self.split(tuple(runs))
        squares = sum(train.error(output, at, self.solved(train, key)) for train, output in folds)
        plain = sum(train.error(output, NONE, np.zeros(0)) for train, output in folds)
        return float(np.sqrt(squares / max(plain, 1e-300)))

    def split(self, runs: tuple[int, ...]) -> list[tuple["Split", np.ndarray]]:
        """Return the products of all groups of runs but one, and of that one in the output, for each."""
        if self.known[0] != runs:
            groups = self.folds(runs)
            sums = [self.t.likelihood[g].sum(axis=0) for g in groups]
            total = np.sum(sums, axis=0)
            folds = [
                (Split(total - left_out, self.own), self.t.output[g].sum(axis=0))
                for g, left_out in zip(groups, sums, strict=True)
            ]
            self.known = runs, folds
        return self.known[1]

    def fast(self, runs: Sequence[int], inflation: float) -> Iterator[tuple[str, Score]]:
        """Score every candidate on some runs; p-values, places and the cross-validated gap are not set."""
        total = Split(self.products(runs), self.own)
        N = float(self.t.count[self.t.units(runs)].sum()) * self.channels
        square = total.square
        for key, c in self.tried.items():
            if key in self.t.spoiled:
                continue
            at = self.at(key)
            raw, left = np.diag(total.M)[at], np.diag(total.of(at))[:-1]
            cost, size = total.cost(at, self.solved(total, key)), len(c.new) + c.variant.shapes
            yield (
                key,
                Score(
                    effect=c.effect,
                    variant=c.variant,
                    model=c.model,
                    gain=max(square - cost, 0.0),
                    size=size,
                    bic=bic(cost, N / inflation, size, N),
                    ratio=1.0,
                    p_value=1.0,
                    absorbed=bool(np.all(left <= NIL * np.maximum(raw, 1e-300))),
                ),
            )


def bic(cost: float, effective: float, size: int, N: float) -> float:
    """Return the Bayesian information criterion of squares over N numbers, `effective` independent."""
    return float(effective * np.log(max(cost, 1e-300) / N) + size * np.log(max(effective, 2.0)))


def by_name(ranked: Sequence[Score]) -> list[Score]:
    """Keep the best variant of each effect, best first."""
    seen: dict[str, Score] = {}
    for score in ranked:
        seen.setdefault(score.effect.name, score)
    return list(seen.values())
