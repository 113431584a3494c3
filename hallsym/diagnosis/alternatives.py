"""Sets of effects that a log cannot tell from the effects that were selected.

An eccentricity with a free direction is one and two waves of error per turn; so are offsets, a gain mismatch
and axes that are not perpendicular, together. All effects that were tested are held against all that were
selected, sets against sets. Products of one pass screen them, to first order: the contributions that the
selected effects make, as they were fitted, are explained by the columns of others. What leaves as little is
refitted exactly, and stands beside the selected effects if its residual cannot be told from theirs.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import log

import numpy as np

from hallsym.diagnosis.normal_equations import ENTRIES, Accumulator, coefficients
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.ranking import count_of, distance
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score
from hallsym.diagnosis.selection import Selection, cancels
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Held, Validation
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.log.batches import Batch
from hallsym.model import Model

SHOWN = 2
"""Sets that stand beside the same effects at most, of one size none with an effect of another: most further
ones only exchange a member for one like it."""
COLUMNS = 400
"""Parameters of effects that are screened together, those that explain most alone: 1.3 MB of products."""
SAMPLES = 200_000
"""Samples that products are made of; of a longer log, batches spread over it."""
BEYOND = 2.0
"""Times its bounds that a parameter of a set may be to first order: refitted exactly it would stop there."""
FIRST = 2
"""Linearisations after which a set must leave less than at its start."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Effects that together leave what the selected effects `instead_of` leave.

    `fit`: the model with them, all other selected effects in place. `distance`: whitened squared distance of
    its residual from that of the selected effects.
    """

    instead_of: tuple[str, ...]
    scores: tuple[Score, ...]
    fit: Refitted
    distance: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(s.effect.name for s in self.scores)


def alternatives(
    setup: Setup, selection: Selection, found: Validation, known: Mapping[str, Collection[str]]
) -> list[Alternative]:
    """Return the sets of effects that stand beside selected ones: of one set none holds another that does.

    `known`: effect -> those of which the log is known not to tell it apart.
    """
    if not found.effects:
        return []
    tried = _tried(selection, found)
    if not tried:
        return []
    products = _products(setup, found, tried)
    out: list[Alternative] = []
    refits: Counter[tuple[str, ...]] = Counter()
    seen: set[tuple[tuple[str, ...], tuple[str, ...]]] = set()
    for proposal in _ordered(list(_proposals(setup, found, products)), setup.policy):
        of = proposal.of
        beside = [a for a in out if a.instead_of == of]
        full = len(beside) == SHOWN or refits[of] == setup.policy.starts
        like = any(len(a.names) == len(proposal.names) and set(a.names) & set(proposal.names) for a in beside)
        like |= any(set(proposal.names) & set(known.get(name, ())) for name in of)
        if full or like or (of, proposal.names) in seen or any(proposal.holds(a) for a in out):
            continue
        refits[of] += 1
        seen.add((of, proposal.names))
        exact = _exact(setup, found, proposal, [tried[k] for k in proposal.keys])
        out += [exact] if exact else []
    return out


def _tried(selection: Selection, found: Validation) -> dict[str, Score]:
    """Return the variants that were tested: all that search no number, and the best ones that do."""
    taken = {h.selected.name for h in found.effects}
    out: dict[str, Score] = {}
    for screened in selection.screened:
        best: set[str] = set()
        for s in screened.scores:  # best first
            name = s.effect.name
            if name in taken or s.absorbed or (s.variant.tried > 1 and name in best):
                continue
            best.add(name)
            out.setdefault(f"{name}|{s.variant.label}", s)
    kept = sorted(out, key=lambda key: -out[key].gain)
    sizes = np.cumsum([out[key].size for key in kept])
    return {key: out[key] for key, size in zip(kept, sizes, strict=True) if size <= COLUMNS}


# -- screening ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Products:
    """Products of columns: of the model, of all effects, contributions of the selected ones, and residual.

    The zeros of each run are eliminated. `own`: columns of the model without effects; `selected`, `others`:
    those of each effect; `made`: the contribution of each selected effect. `count`: readings. `width`: how
    far each column's parameter may go from where it is nil.
    """

    M: np.ndarray
    own: np.ndarray
    selected: Mapping[str, np.ndarray]
    others: Mapping[str, np.ndarray]
    made: Mapping[str, int]
    names: Mapping[str, str]
    places: Mapping[str, int]
    searched: Mapping[str, bool]
    count: float
    width: np.ndarray


def _products(setup: Setup, found: Validation, tried: Mapping[str, Score]) -> _Products:
    end, start = found.end, found.start.base
    p = start.model.vector({n: end.values[n] for n in start.model.names})
    plain = replace(start, p=p, zeros=end.zeros, keep=end.keep)
    made = {key: s.variant.make(start.model) for key, s in tried.items()}
    new = {key: [n for n in m.names if n not in start.model.names] for key, m in made.items()}
    near, far = Accumulator(end), Accumulator(plain, {key: (made[key], new[key]) for key in tried})
    n, z = len(end.free), len(end.model.zeros)
    bare = {h.selected.name: _without(end, h) for h in found.effects}
    runs: dict[int, np.ndarray] = {}
    total = 0.0
    every = max(1, setup.log.rows // SAMPLES)
    known = set(setup.runs)
    for k, (one, other) in enumerate(zip(near.batches(), far.batches(), strict=True)):
        if k % every:
            continue
        weights = one.weights(end.keep)
        white, wide = near.whitener(one, weights), far.whitener(other, weights)
        contributions = _contributions(near, one, bare, weights)
        for block, part in one.parts():
            if block.run not in known:
                continue
            for here in _slices(part, far.size * len(end.model.channels)):
                A, T = white(here), wide(here)
                X = np.concatenate([A[:-1], T[z + far.n : -1], contributions[..., here], A[-1:]])
                X = X.reshape(len(X), -1)
                runs[block.run] = runs.get(block.run, 0.0) + X @ X.T
                total += X.shape[1]
    M = sum(eliminate(P, z)[0] if z else P for P in runs.values())
    first = n + far.slopes.columns
    index = {end.model.names[k]: j for j, k in enumerate(end.free)}
    selected = {
        h.selected.name: np.array([index[q] for q in h.added if q in index], dtype=int) for h in found.effects
    }
    taken = np.concatenate(list(selected.values()))
    return _Products(
        M=np.asarray(M) * every,
        own=np.setdiff1d(np.arange(n), taken),
        selected=selected,
        others={key: n + np.arange(s.start, s.stop) - far.n for key, s in far.span.items() if key in tried},
        made={name: first + k for k, name in enumerate(bare)},
        names={key: s.effect.name for key, s in tried.items()},
        places={key: s.place for key, s in tried.items()},
        searched={key: s.variant.tried > 1 for key, s in tried.items()},
        count=total * every,
        width=_widths(n + far.slopes.columns + len(bare) + 1, n - far.n, far, made, new),
    )


def _widths(
    size: int, first: int, far: Accumulator, made: Mapping[str, Model], new: Mapping[str, Sequence[str]]
) -> np.ndarray:
    """Return how far each of `size` columns may go; those of the candidates of `far` begin at `first`."""
    out = np.full(size, np.inf)
    for key, model in made.items():
        at = [model.names.index(n) for n in new[key]]
        lower, upper = (np.abs(b - model.nominal)[at] for b in model.bounds)
        span = far.span[key]
        out[first + span.start : first + span.stop] = np.maximum(lower, upper)
    return out


def _without(base: Base, held: Held) -> np.ndarray:
    """Return the values of `base` with an effect undone."""
    return np.where(np.isin(base.model.names, held.added), base.model.nominal, base.p)


def _contributions(
    near: Accumulator, batch: Batch, bare: Mapping[str, np.ndarray], weights: np.ndarray | None
) -> np.ndarray:
    """Return what each selected effect adds to the whitened readings, (effects, K, samples)."""
    base, model = near.base, near.base.model
    zeros = base.zeros_of(batch)
    pose, state = batch.columns(model.references), batch.columns(model.state)
    whole = near.read(base.p, zeros, pose, state)[0]
    out = [near.whiten @ (whole - near.read(p, zeros, pose, state)[0]) for p in bare.values()]
    return np.array(out) * (1.0 if weights is None else np.sqrt(weights))


def _slices(part: slice, columns: int) -> Iterator[slice]:
    step = max(1, ENTRIES // columns)
    for low in range(part.start, part.stop, step):
        yield slice(low, min(low + step, part.stop))


@dataclass(frozen=True)
class _Proposal:
    """Effects `keys` that leave, to first order, as little as the selected ones `of`; BIC above theirs."""

    of: tuple[str, ...]
    keys: tuple[str, ...]
    names: tuple[str, ...]
    bic: float
    places: tuple[int, ...]
    """Numbers that were searched, then the places in the catalogue."""

    def holds(self, other: Alternative) -> bool:
        """Return whether it only adds effects to an alternative that is known."""
        return set(other.instead_of) <= set(self.of) and set(other.names) <= set(self.names)


def _proposals(setup: Setup, found: Validation, P: _Products) -> Iterator[_Proposal]:
    """Yield sets of other effects that may stand beside sets of selected ones."""
    policy = setup.policy
    selected = tuple(P.selected)
    known = {h.selected.name: {r.score.effect.name for r in h.selected.rivals} for h in found.effects}
    everything = np.concatenate([P.own, *P.selected.values()])
    least = float(P.M[-1, -1] - coefficients(P.M, everything) @ P.M[everything, -1])
    variance = max(least / max(P.count, 1.0), 1e-12) * found.inflation
    for size in range(1, min(policy.most_in_set, len(selected)) + 1):
        for of in combinations(selected, size):
            others = [P.selected[n] for n in selected if n not in of]
            near = np.concatenate([P.own, *others])
            M = _with_target(P, of)
            R = _projected(M, near)
            squares = R[-1, -1] - least  # what the selected effects explain here
            limit = policy.separated**2 * variance + policy.nearly_linear * squares
            most = policy.most_in_set if size == 1 else policy.most_in_set - 1
            for keys, theta, left in _sets(R, P, most, least + limit):
                names = tuple(P.names[k] for k in keys)
                bic = (left - least) / variance + log(max(P.count / found.inflation, 2.0)) * (
                    len(theta) - sum(len(P.selected[n]) for n in of)
                )
                if bic < 2 * policy.as_good and not (size == len(keys) == 1 and names[0] in known[of[0]]):
                    searched = sum(P.searched[k] for k in keys)
                    places = (searched, *sorted(P.places[k] for k in keys))
                    yield _Proposal(of, keys, names, float(bic), places)


def _ordered(proposals: Sequence[_Proposal], policy: Policy) -> list[_Proposal]:
    """Return small sets first, of these the ones that explain as much as the best, usual causes first."""
    best: dict[tuple[tuple[str, ...], int], float] = {}
    for p in proposals:
        size = p.of, len(p.names)
        best[size] = min(p.bic, best.get(size, np.inf))

    def order(p: _Proposal) -> tuple[int, bool, tuple[int, ...], float]:
        worse = p.bic - best[p.of, len(p.names)] >= policy.as_good
        return len(p.of) + len(p.names), worse, p.places, p.bic

    return sorted(proposals, key=order)


def _with_target(P: _Products, of: Sequence[str]) -> np.ndarray:
    """Return the products with the contributions of some selected effects added to the residual."""
    v = np.zeros(len(P.M))
    v[-1] = 1.0
    v[[P.made[n] for n in of]] = 1.0
    M = P.M.copy()
    M[:, -1] = P.M @ v
    M[-1, :] = M[:, -1]
    M[-1, -1] = v @ P.M @ v
    return M


def _projected(M: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the products with the columns `near` projected out of all others."""
    return M - M[:, near] @ pseudo_inverse(M[np.ix_(near, near)]) @ M[near]


def _sets(
    R: np.ndarray, P: _Products, most: int, enough: float
) -> list[tuple[tuple[str, ...], np.ndarray, float]]:
    """Return sets that leave at most `enough`, with their coefficients and what they leave.

    Grown one effect at a time from the best few of each size: once from effects that search no number,
    which sets with flexible effects would crowd out, and once from all.
    """
    seen = {
        key: at[np.diag(R)[at] > NIL * np.maximum(np.diag(P.M)[at], 1e-300)] for key, at in P.others.items()
    }
    together = np.concatenate(list(seen.values()))
    if not len(together) or R[-1, -1] - coefficients(R, together) @ R[together, -1] > enough:
        return []  # not even all of them
    plain = {key: at for key, at in seen.items() if not P.searched[key]}
    found = {entry[0]: entry for pool in (plain, seen) for entry in _grown(R, P, pool, most, enough)}
    return list(found.values())


def _grown(
    R: np.ndarray, P: _Products, seen: Mapping[str, np.ndarray], most: int, enough: float
) -> list[tuple[tuple[str, ...], np.ndarray, float]]:
    """Return the sets of a pool that leave at most `enough`; none holds another."""
    grown: list[tuple[str, ...]] = [()]
    out: list[tuple[tuple[str, ...], np.ndarray, float]] = []
    for _ in range(most):
        tried: dict[tuple[str, ...], tuple[np.ndarray, float]] = {}
        for keys in grown:
            names = {P.names[k] for k in keys}
            for key, at in seen.items():
                wider = tuple(sorted((*keys, key)))
                if not len(at) or P.names[key] in names or wider in tried:
                    continue
                columns = np.concatenate([seen[k] for k in wider])
                pick = np.append(columns, len(R) - 1)
                theta = coefficients(R[np.ix_(pick, pick)], np.arange(len(columns)))
                tried[wider] = theta, float(R[-1, -1] - theta @ R[columns, -1])
        ranked = sorted(tried, key=lambda keys: tried[keys][1])
        done = [
            keys for keys in ranked if tried[keys][1] <= enough and _inside(P, seen, keys, tried[keys][0])
        ]
        out += [(keys, *tried[keys]) for keys in done]
        best: dict[tuple[str, ...], tuple[str, ...]] = {}  # of the same effects the best variants
        for keys in ranked:
            if tried[keys][1] > enough:
                best.setdefault(tuple(sorted(P.names[k] for k in keys)), keys)
        grown = list(best.values())[: POLICY.most_refits]
    return out


def _inside(P: _Products, seen: Mapping[str, np.ndarray], keys: Sequence[str], theta: np.ndarray) -> bool:
    """Return whether the parameters of a set are, to first order, inside `BEYOND` times their bounds."""
    columns = np.concatenate([seen[k] for k in keys])
    return bool(np.all(np.abs(theta) <= BEYOND * P.width[columns]))


# -- exact refits --------------------------------------------------------------------------------------------


def _exact(
    setup: Setup, found: Validation, proposal: _Proposal, scores: Sequence[Score]
) -> Alternative | None:
    """Refit a set exactly; None if the log tells it apart, or it is no cause."""
    policy, end = setup.policy, found.end
    base = found.start.base
    for held in found.effects:
        if held.selected.name not in proposal.of:
            base = with_model(base, held.selected.exact.score.variant.make(base.model))
    known = end.values
    for score in scores:
        base = with_model(base, score.variant.make(base.model))
    p = np.array([known.get(n, v) for n, v in zip(base.model.names, base.p, strict=True)])
    start = replace(base, p=p, zeros=end.zeros, keep=end.keep)
    near = refit(start, setup.runs, FIRST)
    if near.base is start:
        return None  # the step that leaves as little to first order leaves more: it does not say what is left
    fit = refit(near.base, setup.runs)
    values, new = fit.base.values, [n for n in fit.base.model.names if n not in known]
    if not all(s.effect.possible(values) for s in scores) or cancels(fit, new, policy.cancelling):
        return None
    if any(fit.base.model.names[k] in new for k in fit.at_bound()):
        return None
    one = found.fit if found.end is found.fit.base else refit(end, setup.runs)
    variance = max(one.cost / count_of(one), 1e-12) * found.inflation
    limit = policy.separated**2 * variance
    if fit.cost - one.cost >= limit:
        return None
    apart = distance(one, fit)
    return Alternative(proposal.of, tuple(scores), fit, apart) if apart < limit else None
