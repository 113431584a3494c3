"""Flexible alternatives: does a named effect describe what it makes, or does the machine only behave like it?

What an effect adds to the readings, as it was fitted, is its contribution. A flexible alternative in the same
link lets the contribution vary: its strength follows, in any smooth way, the coordinate that the contribution
is a function of; or, where the contribution follows the speed, the readings respond to the past of it in any
linear way. The right cause needs none of that. Where a free variation predicts runs that it was not fitted
on, the machine does something that the named effect resembles and is not.

The variation is a Gaussian process of reduced rank: few functions with a normal prior, whose width is the one
of the greatest marginal likelihood (Rasmussen and Williams 2006, 5.4.1; doi:10.7551/mitpress/3206.001.0001).
"""

from collections.abc import Iterator

import numpy as np
from scipy.signal import lfilter

from hallsym.diagnosis.features import Features, powers
from hallsym.diagnosis.normal_equations import reading_and_derivatives
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.record import Resemblance
from hallsym.diagnosis.regression import FOLDS, lengths, others
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Held, Validation
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.log.quality.runs import FEWEST_SAMPLES
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import rate

DEGREE, TOGETHER = 3, 2
"""Highest power of a coordinate that the strength of an effect follows; of several coordinates together."""
MEMORIES = 5
"""Low-passes that a response to the past is made of. What went before a run is not known: the time constant
of the slowest is a minor part of a run (`Policy.minor`)."""
PRIORS = tuple(10.0**k for k in range(-4, 1))
"""Inverse variances of the prior, for features of unit length; the evidence chooses one."""


PAST = ("the past",)


def resemblances(setup: Setup, found: Validation) -> dict[str, Resemblance]:
    """Return, for each effect that the machine only behaves like, the alternative that beats it most.

    An alternative must be certain, and its misfit must be material (`Policy.minor`).
    """
    out: dict[str, Resemblance] = {}
    for held in found.effects:
        tried = flexible(setup, found, held)
        sure = [f for f in tried if f.p_value < setup.policy.beyond_doubt]
        best = max(sure, key=lambda f: f.misfit, default=None)
        if best is not None and best.misfit >= setup.policy.minor:
            out[held.name] = best
    return out


def flexible(setup: Setup, found: Validation, held: Held) -> list[Resemblance]:
    """Return the flexible alternatives to an effect, all others in place."""
    base, known = found.end, frozenset(setup.runs)
    if len(known) < setup.policy.fewest:
        return []
    work = _Work(base, held, known, setup)
    for piece in pieces(base, known):
        work.add(piece)
    return work.finish(max(held.without.cost - found.fit.cost, 1e-300))


def _moving(setup: Setup, held: Held) -> bool:
    """Return whether an effect follows how fast the reference moves."""
    plain = setup.base.model
    rates = {rate(c, n).name for c in plain.references for n in range(1, 5)}
    wide = held.exact.score.variant.make(plain)
    return bool(rates & set(wide.state) - set(plain.state))


class _Work:
    """Products of each run: the model's columns, varied contributions, residual."""

    def __init__(self, base: Base, held: Held, runs: frozenset[int], setup: Setup) -> None:
        self.base, self.policy, model = base, setup.policy, base.model
        self.moving = base.timed and _moving(setup, held)
        self.features = Features(base, runs)
        self.read = reading_and_derivatives(model)
        self.plain = on_arrays(model.reading)
        self.p = np.where(np.isin(model.names, held.added), model.nominal, base.p)
        self.z, self.n = len(model.zeros), len(base.free)
        self.sums: dict[tuple[str, ...], dict[int, np.ndarray]] = {}
        self.shares: dict[tuple[str, ...], list[np.ndarray]] = {}

    def add(self, piece: Piece) -> None:
        """Add a stretch of a run."""
        base, model = self.base, self.base.model
        K, samples = len(model.channels), len(piece.t)
        pose, state = ([piece.data[c] for c in names] for names in (model.references, model.state))
        zeros = np.repeat(base.zeros_in(piece.run)[:, None], samples, axis=1)
        reading, *slopes = self.read(base.p, zeros, pose, state)
        (bare,) = self.plain(self.p, zeros, pose, state)
        made = np.broadcast_to(reading - bare, (K, samples))
        near = slopes[0].reshape(-1, K, samples)[list(base.free)]
        if self.z:
            near = np.concatenate([slopes[1].reshape(-1, K, samples), near])
        near = base.whiten @ near
        for by, varied in self._varied(self.features.quiet(piece), made, bare):
            X = np.concatenate([near, base.whiten @ varied, piece.residual[None]])[..., piece.used]
            X = X.reshape(len(X), -1)
            runs = self.sums.setdefault(by, {})
            runs[piece.run] = runs.get(piece.run, 0.0) + X @ X.T

    def _varied(
        self, piece: Piece, made: np.ndarray, bare: np.ndarray
    ) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
        """Yield what the strength follows, and the contribution (K, samples) so varied, (n, K, samples)."""
        for by, x in self._coordinates(piece, bare):
            followed = powers_of(x, TOGETHER if len(by) > 1 else DEGREE)
            yield by, followed * made
            for k, own in enumerate(made):
                basis = np.vstack([np.ones_like(own), followed[:, k % followed.shape[1]]])
                rows = np.vstack([basis, basis * bare[k], own])[:, piece.used]
                sums = self.shares.setdefault(by, [np.zeros((len(rows),) * 2) for _ in made])
                sums[k] += rows @ rows.T
        if self.moving and len(piece.t) >= 2 * FEWEST_SAMPLES:
            span = float(piece.t[-1] - piece.t[0])
            step = span / (len(piece.t) - 1)
            lasting = np.geomspace(step, max(self.policy.minor * span, 2 * step), MEMORIES)
            yield PAST, np.array([_remembered(made, step / tau) - made for tau in lasting])

    def _coordinates(self, piece: Piece, bare: np.ndarray) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
        """Yield columns and their values over their ranges, (columns, K or 1, samples)."""
        f, model = self.features, self.base.model
        straight = [c for c in model.references if c not in f.periodic]
        for c in f.periodic:
            turn = 2 * np.pi / model.period[c] * piece.data[c]
            yield (c,), np.array([np.cos(turn), np.sin(turn)])[:, None]
        for columns in (straight, f.states(piece)):
            rows = [f.unit(piece, c) for c in columns]
            yield from (((c,), row[None, None]) for c, row in zip(columns, rows, strict=True))
            if len(rows) > 1:
                yield tuple(columns), np.array(rows)[:, None]
        if not f.turning:
            ranges = np.array([f.ranges[c] for c in model.channels])
            yield model.channels, ((bare - ranges[:, :1]) / ranges[:, 1:])[None]
        extra = ("temperature_degc", *(("campaign_s",) if self.base.timed else ()))
        yield from (((c,), f.unit(piece, c)[None, None]) for c in extra if c in piece.data)

    def finish(self, gain: float) -> list[Resemblance]:
        """Return the variations over what the contribution is a function of; `gain`: squares it explains."""
        tried = {by: runs for by, runs in self.sums.items() if by == PAST or self._function_of(by)}
        return [self._judged(by, runs, gain, len(tried)) for by, runs in tried.items()]

    def _function_of(self, by: tuple[str, ...]) -> bool:
        """Return whether offsets and gains over a coordinate make all of the contribution that counts."""
        whole = sum(M[-1, -1] for M in self.shares[by])
        left = sum(max(float(_projected(M, len(M) - 1)[0, 0]), 0.0) for M in self.shares[by])
        return bool(left <= self.policy.negligible * whole)

    def _judged(
        self, by: tuple[str, ...], runs: dict[int, np.ndarray], gain: float, tried: int
    ) -> Resemblance:
        each = [eliminate(M, self.z)[0] for M in runs.values()]
        folds = np.array([np.sum(each[k::FOLDS], axis=0) for k in range(min(FOLDS, len(each)))])
        whole = _projected(folds.sum(axis=0), self.n)
        pull = _prior(whole)
        best = _solved(whole, pull)
        squares, scores, noise = 0.0, [], []
        for left_out, rest in zip(folds, others(folds), strict=True):
            c, M = _solved(_projected(rest, self.n), pull), _tested(rest, left_out, self.n)
            squares += float(2 * c @ M[:-1, -1] - c @ M[:-1, :-1] @ c)
            scores.append(float(c @ M[:-1, -1]))
            noise.append(float(c @ (M[:-1, -1] - M[:-1, :-1] @ best)))
        p = beyond(np.array(scores), np.array(noise))
        return Resemblance(by, float(np.sqrt(max(squares, 0.0) / gain)), min(1.0, p * tried))


def powers_of(x: np.ndarray, degree: int) -> np.ndarray:
    """Return products (n, K or 1, samples) of the rows of x (columns, K or 1, samples) up to a degree."""
    return np.stack([powers(x[:, k], degree) for k in range(x.shape[1])], axis=1)


def _remembered(made: np.ndarray, share: float) -> np.ndarray:
    """Return a contribution behind a low-pass that begins at its first value."""
    pole, first = np.exp(-share), made[:, :1]
    return lfilter([1 - pole], [1, -pole], made - first, axis=1) + first


# -- regression on products, the model's own n columns fitted anew ------------------------------------------


def _projected(M: np.ndarray, n: int) -> np.ndarray:
    return M[n:, n:] - M[n:, :n] @ pseudo_inverse(M[:n, :n]) @ M[:n, n:]


def _tested(train: np.ndarray, M: np.ndarray, n: int) -> np.ndarray:
    """Return the products of left-out runs, with the projection that the other runs give."""
    P = pseudo_inverse(train[:n, :n]) @ train[:n, n:]
    across = M[n:, :n] @ P
    return M[n:, n:] - across - across.T + P.T @ M[:n, :n] @ P


def _prior(M: np.ndarray) -> float:
    """Return the inverse variance of the prior that has the greatest marginal likelihood."""
    G, b, d = M[:-1, :-1], M[:-1, -1], lengths(M[:-1, :-1])
    size, V = np.linalg.eigh(G / np.outer(d, d))
    size, c = np.maximum(size, 0.0), V.T @ (b / d)
    evidence = [float((c**2 / (size + a)).sum() - np.log1p(size / a).sum()) for a in PRIORS]
    return PRIORS[int(np.argmax(evidence))]


def _solved(M: np.ndarray, pull: float) -> np.ndarray:
    G, b, d = M[:-1, :-1], M[:-1, -1], lengths(M[:-1, :-1])
    return np.asarray(np.linalg.solve(G / np.outer(d, d) + pull * np.eye(len(d)), b / d) / d)
