"""Sets of effects that a log cannot tell from the effects that were selected.

An eccentricity with a free direction is one and two waves of error per turn; so are offsets, a gain mismatch
and axes that are not perpendicular, together. All effects that were tested are held against all that were
selected, sets against sets. Products of one pass screen them, to first order: the contributions that the
selected effects make, as they were fitted, are explained by the columns of others. What leaves as little is
refitted exactly, and stands beside the selected effects if its residual cannot be told from theirs.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hallsym.diagnosis.normal_equations import ENTRIES, Accumulator, coefficients
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.refit import Refitted, refit, with_effects
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.scores import Score, bic
from hallsym.diagnosis.selection import Selection, cancels
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.log.batches import HELD, Batch


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
    refitted: set[tuple[tuple[str, ...], tuple[str, ...]]] = set()
    for proposal in _ordered(list(_proposals(setup, found, products)), setup.policy):
        of = proposal.of
        beside = [a for a in out if a.instead_of == of]
        full = sum(other == of for other, _ in refitted) == setup.policy.starts
        like = any(len(a.names) == len(proposal.names) and set(a.names) & set(proposal.names) for a in beside)
        like |= any(set(proposal.names) & set(known.get(name, ())) for name in of)
        if full or like or (of, proposal.names) in refitted or any(proposal.holds(a) for a in out):
            continue
        refitted.add((of, proposal.names))
        exact = _exact(setup, found, proposal, [tried[k] for k in proposal.keys])
        out += [exact] if exact else []
    return out


def _tried(selection: Selection, found: Validation) -> dict[str, Score]:
    """Return the variants that were tested: all that search no number, and the best ones that do."""
    taken = {h.name for h in found.effects}
    out: dict[str, Score] = {}
    for screened in selection.screened:
        best: set[str] = set()
        for s in screened.scores:  # best first
            name = s.effect.name
            if name in taken or s.absorbed or (s.variant.tried > 1 and name in best):
                continue
            best.add(name)
            out.setdefault(f"{name}|{s.variant.label}", s)
    return out


# -- screening ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Products:
    """Products of columns: of the model, of all effects, contributions of the selected ones, and residual.

    The zeros of each run are eliminated. `tried`: the other effects. `own`: columns of the model without
    effects; `selected`, `others`: those of each effect; `made`: the contribution of each selected effect.
    `count`: readings.
    """

    M: np.ndarray
    tried: Mapping[str, Score]
    own: np.ndarray
    selected: Mapping[str, np.ndarray]
    others: Mapping[str, np.ndarray]
    made: Mapping[str, int]
    count: float

    def names(self, keys: Iterable[str]) -> tuple[str, ...]:
        """Return the names of effects of `tried`."""
        return tuple(self.tried[k].effect.name for k in keys)

    def searched(self, key: str) -> bool:
        """Return whether a number of an effect of `tried` was searched."""
        return self.tried[key].variant.tried > 1


def _products(setup: Setup, found: Validation, tried: Mapping[str, Score]) -> _Products:
    end, start = found.end, found.start.base
    p = start.model.vector({n: end.values[n] for n in start.model.names})
    plain = replace(start, p=p, zeros=end.zeros, keep=end.keep)
    models = {key: s.variant.make(start.model) for key, s in tried.items()}
    new = {key: [n for n in m.names if n not in start.model.names] for key, m in models.items()}
    near, far = Accumulator(end), Accumulator(plain, {key: (models[key], new[key]) for key in tried})
    n, z = len(end.free), len(end.model.zeros)
    nominal = end.model.nominal
    bare = {h.name: np.where(np.isin(end.model.names, h.added), nominal, end.p) for h in found.effects}
    runs: dict[int, np.ndarray] = {}
    total = 0.0
    every = max(1, end.log.rows // HELD)  # of a longer log, batches spread over it
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
    M = sum(eliminate(P, z)[0] for P in runs.values())
    first = n + far.slopes.columns
    index = {end.model.names[k]: j for j, k in enumerate(end.free)}
    selected = {h.name: np.array([index[q] for q in h.added if q in index], dtype=int) for h in found.effects}
    taken = np.concatenate(list(selected.values()))
    return _Products(
        M=np.asarray(M) * every,
        tried=tried,
        own=np.setdiff1d(np.arange(n), taken),
        selected=selected,
        others={key: n + np.arange(s.start, s.stop) - far.n for key, s in far.span.items() if key in tried},
        made={name: first + k for k, name in enumerate(bare)},
        count=total * every,
    )


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
    policy, inflation = setup.policy, found.inflation
    selected = tuple(P.selected)
    known = {h.name: {r.name for r in h.exact.rivals} for h in found.effects}
    everything = np.concatenate([P.own, *P.selected.values()])
    least = float(P.M[-1, -1] - coefficients(P.M, everything) @ P.M[everything, -1])
    noise = policy.separated**2 * max(least / max(P.count, 1.0), 1e-12) * inflation

    def bic_of(left: float, size: int) -> float:
        return float(bic(left, P.count / inflation, size, P.count))

    for size in range(1, min(policy.most_in_set, len(selected)) + 1):
        for of in combinations(selected, size):
            near = np.concatenate([P.own, *(P.selected[n] for n in selected if n not in of)])
            R = _projected(_with_target(P, of), near)
            limit = noise + policy.negligible * (
                R[-1, -1] - least
            )  # of what the selected effects explain here
            most = policy.most_in_set if size == 1 else policy.most_in_set - 1
            before = bic_of(least, sum(len(P.selected[n]) for n in of))
            for keys, columns, left in _sets(R, P, most, least + limit):
                names, more = P.names(keys), bic_of(left, columns) - before
                if more < 2 * policy.as_good and not (size == len(keys) == 1 and names[0] in known[of[0]]):
                    places = sum(map(P.searched, keys)), *sorted(P.tried[k].place for k in keys)
                    yield _Proposal(of, keys, names, more, places)


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
    T = np.eye(len(P.M))
    T[[P.made[n] for n in of], -1] = 1.0
    return np.asarray(T.T @ P.M @ T)


def _projected(M: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the products with the columns `near` projected out of all others."""
    return M - M[:, near] @ pseudo_inverse(M[np.ix_(near, near)]) @ M[near]


_Sets = list[tuple[tuple[str, ...], int, float]]
"""Sets of effects with the number of their columns and the squares they leave."""


def _sets(R: np.ndarray, P: _Products, most: int, enough: float) -> _Sets:
    """Return sets that leave at most `enough`.

    Grown one effect at a time from the best few of each size: once from effects that search no number,
    which sets with flexible effects would crowd out, and once from all.
    """
    seen = {
        key: at[np.diag(R)[at] > NIL * np.maximum(np.diag(P.M)[at], 1e-300)] for key, at in P.others.items()
    }
    if _left(R, np.concatenate(list(seen.values()))) > enough:
        return []  # not even all of them
    plain = {key: at for key, at in seen.items() if not P.searched(key)}
    found = {entry[0]: entry for pool in (plain, seen) for entry in _grown(R, P, pool, most, enough)}
    return list(found.values())


def _grown(R: np.ndarray, P: _Products, seen: Mapping[str, np.ndarray], most: int, enough: float) -> _Sets:
    """Return the sets of a pool that leave at most `enough`; none holds another."""
    grown: list[tuple[str, ...]] = [()]
    out: _Sets = []
    for _ in range(most):
        tried: dict[tuple[str, ...], tuple[int, float]] = {}
        for keys in grown:
            for key, at in seen.items():
                wider = tuple(sorted((*keys, key)))
                if len(at) and not {*P.names([key])} & {*P.names(keys)} and wider not in tried:
                    columns = np.concatenate([seen[k] for k in wider])
                    tried[wider] = len(columns), _left(R, columns)
        ranked = sorted(tried, key=lambda keys: tried[keys][1])
        out += [(keys, *tried[keys]) for keys in ranked if tried[keys][1] <= enough]
        best: dict[tuple[str, ...], tuple[str, ...]] = {}  # of the same effects the best variants
        for keys in ranked:
            if tried[keys][1] > enough:
                best.setdefault(tuple(sorted(P.names(keys))), keys)
        grown = list(best.values())[: POLICY.most_refits]
    return out


def _left(R: np.ndarray, columns: np.ndarray) -> float:
    """Return the squares that some columns leave."""
    return float(R[-1, -1] - coefficients(R, columns) @ R[columns, -1])


# -- exact refits --------------------------------------------------------------------------------------------


def _exact(
    setup: Setup, found: Validation, proposal: _Proposal, scores: Sequence[Score]
) -> Alternative | None:
    """Refit a set exactly; None if the log tells it apart, or it is no cause."""
    policy, end = setup.policy, found.end
    known, others = end.values, [h.exact.score for h in found.effects if h.name not in proposal.of]
    base = with_effects(found.start.base, (s.variant for s in (*others, *scores)), known)
    fit = refit(replace(base, zeros=end.zeros, keep=end.keep), setup.runs)
    values, new = fit.base.values, [n for n in fit.base.model.names if n not in known]
    if not all(s.effect.possible(values) for s in scores) or cancels(fit, new, policy.half):
        return None
    if any(fit.base.model.names[k] in new for k in fit.at_bound()):
        return None
    one = found.fit if found.end is found.fit.base else refit(end, setup.runs)
    limit = policy.separated**2 * one.variance(found.inflation)
    if fit.cost - one.cost >= limit:
        return None
    apart = one.distance(fit)
    return Alternative(proposal.of, tuple(scores), fit, apart) if apart < limit else None
