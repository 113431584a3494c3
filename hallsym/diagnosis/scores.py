"""Screening: score tests of the whole catalogue, from one pass over the log."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from hallsym.diagnosis.measurement_error import shared_noise
from hallsym.diagnosis.normal_equations import NormalEquations, Products, normal_equations, pooled
from hallsym.diagnosis.p_values import Joint, SignFlips, least_p, memory, searched, stretch
from hallsym.diagnosis.record import Significance
from hallsym.diagnosis.residuals import FOLDS, NIL, Base
from hallsym.diagnosis.survey import LEAST
from hallsym.errors import InputError
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.factors import pseudo_inverse
from hallsym.model import Effect, Facts, Model, Variant
from solvers import bounded_step

Values = float | np.ndarray


class Candidate(NamedTuple):
    """One variant of an effect on a model: the extended `model` and the names of its `new` parameters."""

    effect: Effect
    variant: Variant
    model: Model
    new: list[str]


@dataclass(frozen=True, eq=False)
class Score:
    """Score of one variant of an effect: the squares that it would explain, to first order.

    `gain`: decrease of the whitened squares on the fitted runs. `size`: parameters added, searched numbers
    included. `bic`: Bayesian information criterion with the effect. `ratio`: gap metric over that without the
    effect, cross-validated within the fitted runs, without the bias by the references' noise. `p_value`: from
    sign flips of the runs' scores, corrected for all tests; `statistic`: its statistic. `absorbed`: the
    model's own parameters can do the same. `place`: of the effect in the catalogue, usual causes first.
    `kept`: part of the gain that is not due to the references' noise. `p_by_noise`: the p-value by the
    spectrum of the noise alone, 1 where that is not known.
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
    kept: float = 1.0
    p_by_noise: float = 1.0
    statistic: float = -np.inf

    @property
    def key(self) -> str:
        """Key of the candidate."""
        return f"{self.effect.name}|{self.variant.label}"


def candidates(
    base: Base, catalogue: Sequence[Effect], facts: Facts
) -> tuple[dict[str, Candidate], dict[str, str]]:
    """Return every variant of every testable effect, and why others are not testable on this log."""
    out: dict[str, Candidate] = {}
    trouble: dict[str, str] = {}
    for effect in catalogue:
        if effect.name in base.model.effects:
            continue
        try:
            for candidate in _variants(base.model, effect, facts):
                out[f"{effect.name}|{candidate.variant.label}"] = candidate
        except InputError as error:
            trouble[effect.name] = str(error)
        except Exception as error:  # a user's effect may raise anything: the others still run
            trouble[effect.name] = f"raised {type(error).__name__}: {error}"
    return out, trouble


def _variants(model: Model, effect: Effect, facts: Facts) -> Iterator[Candidate]:
    missing = [c for c in effect.needs if c not in facts.columns]
    if missing:
        what = "time" if missing[0] == "t_s" else missing[0].rsplit("_", 1)[0]
        raise InputError(f"no {what} logged")
    for variant in effect.variants(model, facts):
        wide = variant.make(model)
        new = [p.name for p in wide.parameters if p.name not in model.names]
        if not new:
            raise InputError(f"Effect {effect.name} adds no parameter, so there is nothing to test.")
        known = {c.name for c in wide.computed}.union(facts.columns)
        for column in (*columns_of(wide), *(c for made in wide.computed for c in made.needs)):
            if column not in known:
                raise InputError(f"no {column} logged")
        yield Candidate(effect, variant, wide, new)


class Screen:
    """The catalogue scored beside one fit, from one pass over the log.

    `scores`: best first, by BIC, with p-values once they are weighed. `length`: samples of the stretches that
    are the units of p-values, None where runs are; `lasting`: of a unit. `significance`: of any effect at
    all. `t`: the products of the pass, until p-values are computed; `fitted`: fits to the runs, judged on the
    same. `top`: the maximum statistic of each draw of signs, that of the log first. `refits`: models that
    were fitted for the p-values. `spoiled`: candidates whose readings are not finite.
    """

    def __init__(
        self, base: Base, tried: dict[str, Candidate], runs: Sequence[int], *, tested: bool = True
    ) -> None:
        """Score `tried` on `runs`; `tested`: for p-values (`weigh`), for which few runs are cut."""
        self.base, self.tried, self.runs = base, tried, tuple(runs)
        self.refits: dict[Model, Any] = {}
        rows = base.log.rows / len(base.log.runs)
        self.length = stretch(rows * len(runs), len(runs), base.policy) if tested else None
        self.lasting = self.length or rows
        self.new = {key: (c.model, c.new) for key, c in tried.items()}
        own = [group for group in pooled(base) if set(runs).issuperset(group)]
        folds = [[*chain(*own[k::FOLDS])] for k in range(min(FOLDS, len(own)))]
        t = normal_equations(base, self.new, self.length, judged=folds)
        at = np.arange(len(t.runs))
        among, groups = np.isin(at, t.units(runs)), np.array([np.isin(at, t.units(fold)) for fold in folds])
        cross_validated = Regressions(t, tried, among & ~groups, t.decoded)
        # p-values need no decoded products of each group
        self.t = replace(t, decoded=t.decoded.summed())
        self.fitted = Regressions(self.t, tried, among[None], self.t.decoded)
        places = {name: k for k, name in enumerate(dict.fromkeys(c.effect.name for c in tried.values()))}
        known = [key for key in tried if key not in t.spoiled]
        scores = [self._score(key, float(among @ t.count), cross_validated) for key in known]
        self.scores = sorted((replace(s, place=places[s.effect.name]) for s in scores), key=lambda s: s.bic)
        self.spoiled = t.spoiled

    def _score(self, key: str, readings: float, cross_validated: "Regressions") -> Score:
        """Return the score of a candidate on so many readings of each channel.

        `cross_validated`: fits without groups of runs, judged on each.
        """
        c, found = self.tried[key], self.fitted.solved(key)
        N, size = readings * len(c.model.channels), len(c.new) + c.variant.shapes
        return Score(
            effect=c.effect,
            variant=c.variant,
            model=c.model,
            gain=max(float(found.plain[0] - found.left[0]), 0.0),
            size=size,
            bic=float(bic(found.left[0], N, size, N)),
            ratio=cross_validated.ratio(key),
            p_value=1.0,
            absorbed=bool(found.absorbed[0]),
        )

    def weigh(
        self,
        autocorrelation: np.ndarray,
        remembers: float | None = None,
        peak: float = np.inf,
        louder: float = 1.0,
    ) -> None:
        """Give the scores their p-values, for noise with this autocorrelation.

        `remembers`: correlation length of the noise in samples; None: that of `autocorrelation`, and 0 for
        slices of a recording. `peak`: of the spectrum of the stated noise (`spectrum_peak`); infinity where
        it was not stated. `louder`: variance of the noise over the stated one. It may be that of the
        references, so everything is tested with their noise as stated and as loud, and the larger p-value
        counts.
        """
        sizes = (1.0, louder) if louder > (1 + self.base.policy.negligible) ** 2 else (1.0,)
        variants = Counter(s.effect.name for s in self.scores)
        flips = self._flips(autocorrelation, remembers, sizes)
        drawn: dict[str, list[np.ndarray]] = {}
        for s in self.scores:
            z = [] if s.absorbed else [f.statistic(s.key) for f in flips]
            # numbers that were searched elsewhere, and are not among the variants
            tried = s.variant.tried / variants[s.effect.name]
            drawn[s.key] = [searched(each, tried) for each in z if each is not None]
        joints = [Joint(each) for each in zip(*filter(None, drawn.values()), strict=True)] or [Joint(())]
        self.top = joints[0].top if any(drawn.values()) else None
        most = {s.effect.name: max(variants[s.effect.name], s.variant.tried) for s in self.scores}
        # weighted Bonferroni: each test has its part of the error rate, sign flips the rest
        part = self.base.policy.minor
        of_signs = 1.0 - part * np.isfinite(peak)
        out = []
        for s in self.scores:
            z0 = [float(z[0]) for z in drawn[s.key]] or [-np.inf]
            kept = min((f.kept[s.key] for f in flips), default=1.0) if drawn[s.key] else 1.0
            s = replace(s, kept=kept, ratio=1 - (1 - s.ratio) * kept, statistic=z0[0])
            if not s.absorbed and np.isfinite(peak):
                by_noise = max(float(chdtrc(s.size, kept * s.gain / peak)), LEAST)
                s = replace(s, p_by_noise=min(1.0, sum(most.values()) * by_noise))
            signs = max(joint.p_value(z) for joint, z in zip(joints, z0, strict=False))
            p = min(1.0, signs / of_signs, s.p_by_noise / part)
            ratio = min(s.ratio, self._ratio(s, peak)) if p < self.base.policy.false_alarm else s.ratio
            out.append(replace(s, p_value=p, ratio=ratio))
        self.scores = out
        units = len(self.t.units(self.runs))
        unit = "run" if self.length is None else "stretch"
        least = min((s.p_value for s in out), default=1.0)
        self.significance = Significance(least, least_p(units), units, unit)
        del self.t, self.fitted  # they are larger than the log

    def _ratio(self, score: Score, peak: float) -> float:
        """Return the gap metric with a candidate over that without, on the same runs less its optimism.

        Fits without some runs extrapolate more: six runs at different heights.
        """
        if not np.isfinite(peak):
            return np.inf
        real = max(0.0, 1 - 2 * score.size * peak / max(score.gain, NIL))
        squares = 1 - self.fitted.ratio(score.key) ** 2
        return float(np.sqrt(max(1 - squares * real * score.kept, 0.0)))

    def _flips(
        self, autocorrelation: np.ndarray, remembers: float | None, sizes: Sequence[float]
    ) -> list[SignFlips]:
        """Return the sign flips of all candidates, for noise of the references of each of these variances."""
        base = self.base
        noise = shared_noise(base, self.new, self.t, self.length, autocorrelation)
        if remembers is None:
            remembers = 0.0 if base.sliced else memory(autocorrelation, base.policy)
        memories = self.lasting / max(remembers, NIL)
        return [
            SignFlips(self.t, self.runs, size * noise, base.policy, memories=memories, joined=base.joined)
            for size in sizes
        ]


class Regressions:
    """Fits of candidates to stacks of units, (F, units) of 0 and 1; `judged`: products that judge each."""

    def __init__(
        self, t: NormalEquations, tried: dict[str, Candidate], training: np.ndarray, judged: Products
    ) -> None:
        stacks = Products(*(np.tensordot(training * 1.0, each, 1) for each in t.whitened))
        self.t, self.tried, self.judged, n = replace(t, whitened=stacks), tried, judged, t.span[""].stop
        self.inverse = pseudo_inverse(self.t.likelihood[:, :n, :n])
        self.plain = self.solved(None).by

    def solved(self, key: str | None) -> "Solved":
        """Fit a candidate (None: nothing) and the model's own parameters to each stack of units."""
        n = len(self.inverse[0])
        M = self.t.of(key)
        through = self.inverse @ M[:, :n, n:]
        left = M[:, n:, n:] - M[:, n:, :n] @ through
        raw, squares = (np.diagonal(x, axis1=1, axis2=2)[:, :-1] for x in (M[:, n:, n:], left))
        seen = squares > NIL * np.maximum(raw, 1e-300)
        inside = left[:, :-1, :-1] * (seen[:, :, None] & seen[:, None, :])
        theta = (pseudo_inverse(inside) @ (left[:, :-1, -1] * seen)[:, :, None])[:, :, 0]
        if key:
            c = self.tried[key]
            lower, upper = (b[[c.model.names.index(name) for name in c.new]] for b in c.model.bounds)
            for f in np.flatnonzero(((theta < lower) | (theta > upper)).any(axis=1)):
                own, (low, high) = left[f][:-1], (np.where(seen[f], b, 0.0) for b in (lower, upper))
                theta[f] = bounded_step(-own[:, -1], own[:, :-1], low, high)[0]
        v = np.ones((len(M), theta.shape[1] + 1))
        v[:, :-1] = -theta
        by_own = -(through @ v[:, :, None])[:, :, 0]
        squares_left = np.einsum("fi,fij,fj->f", v, left, v)
        return Solved(np.hstack([by_own, v]), left[:, -1, -1], squares_left, ~seen.any(axis=1))

    def ratio(self, key: str) -> float:
        """Return the gap metric with a candidate over that without, on the units that judge."""
        M, u, none = self.judged.of(self.t.span[key], self.t.places[key]), self.solved(key).by, self.plain
        pick = np.append(np.arange(none.shape[1] - 1), M.shape[1] - 1)
        squares = np.einsum("fi,fij,fj->", u, M, u)
        plain = np.einsum("fi,fij,fj->", none, M[:, pick[:, None], pick], none)
        return float(np.sqrt(squares / max(plain, 1e-300)))


class Solved(NamedTuple):
    """Fits to F stacks of units: `by` (F, n + k + 1) makes what is left of the columns.

    `plain`, `left`: (F,) squares without and with the candidate; `absorbed`: the model's parameters suffice.
    """

    by: np.ndarray
    plain: np.ndarray
    left: np.ndarray
    absorbed: np.ndarray


def bic(cost: Values, effective: Values, size: int, N: Values) -> np.ndarray:
    """Return the Bayesian information criterion of squares over N numbers, `effective` independent."""
    return np.asarray(
        effective * np.log(np.maximum(cost, 1e-300) / N) + size * np.log(np.maximum(effective, 2.0))
    )


def by_name(ranked: Sequence[Score]) -> list[Score]:
    """Keep the best variant of each effect, best first."""
    seen: dict[str, Score] = {}
    for score in ranked:
        seen.setdefault(score.effect.name, score)
    return list(seen.values())
