"""Design criteria: information functions of the information matrix M (m, m), larger is better.

Each phi is concave and phi(t M) = t phi(M) (Pukelsheim, Optimal Design of Experiments, SIAM 2006,
doi:10.1137/1.9780898719109, ch. 5 and 6), so one bound holds for all: with any slope G of phi at any M,
phi(M') <= tr(G M'). Twice the information is twice phi; uncertainties shrink with the root of it.

- D: det(M)^(1/m): the volume of the uncertainty ellipsoid.
- max-u: 1 / max over the workspace of sum_o u_o^2 / reference_o^2, u_o the standard uncertainty that the
  parameters leave in coordinate o of the decoded position.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CRITERIA = ("D", "max-u")
SHARP = 24.0
"""Power that stands for a maximum where max-u has corners, in slopes."""
BETTER = 1e-6
"""Relative gain below which an exchange is not made."""
PASSES = 30
TRIED, MOST_TRIED = 12, 120
"""Candidates of largest slope that are tried first, and when none of them helps."""


@dataclass(frozen=True, eq=False)
class Criterion:
    """`values(M)`: phi of each of (..., m, m), shape (...). `slope(M)`: G (m, m) with phi(M') <= tr(G M')."""

    name: str
    values: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]


def criterion(name: str, m: int, workspace: np.ndarray) -> Criterion:
    """Return a criterion of `CRITERIA` by name.

    `workspace`: (points, n_pose, m) slopes of the decoded position with the coordinates, in references.
    """
    return _d(m) if name == "D" else _max_u(workspace)


def _d(m: int) -> Criterion:
    def values(M: np.ndarray) -> np.ndarray:
        sign, size = np.linalg.slogdet(M)
        return np.where(sign > 0, np.exp(size / m), 0.0)

    return Criterion("D", values, lambda M: values(M) / m * np.linalg.inv(M))


def _max_u(workspace: np.ndarray) -> Criterion:
    points, outputs, m = workspace.shape
    flat = np.ascontiguousarray(workspace.reshape(-1, m))

    def squares(M: np.ndarray) -> np.ndarray:
        """Squared uncertainty at each point of the workspace, (..., points)."""
        by_row = np.sum((flat @ np.linalg.inv(M)) * flat, axis=-1)
        return by_row.reshape(*by_row.shape[:-1], points, outputs).sum(axis=-1)

    def slope(M: np.ndarray) -> np.ndarray:
        u2, inverse = squares(M), np.linalg.inv(M)
        share = (u2 / u2.max()) ** SHARP
        share = share / share.sum()
        loaded = flat * np.sqrt(np.repeat(share, outputs))[:, None] @ inverse
        return loaded.T @ loaded / (share @ u2) ** 2  # the slope of 1 / sum share u2, which bounds 1 / max u2

    return Criterion("max-u", lambda M: 1.0 / squares(M).max(axis=-1), slope)


# -- whole runs: greedy choice, then exchange one run for another while that helps ------------------------
# Fedorov, Theory of Optimal Experiments, Academic Press 1972, ch. 3.


def greedy(
    infos: np.ndarray, base: np.ndarray, runs: int, criterion: Criterion, counts: np.ndarray | None = None
) -> np.ndarray:
    """Return how often each candidate is chosen, (candidates,): the best one more, until there are `runs`."""
    counts = np.zeros(len(infos), dtype=int) if counts is None else counts.copy()
    M = base + np.tensordot(counts, infos, axes=1)
    while counts.sum() < runs:
        best, _ = _best(infos, M, criterion, TRIED)
        counts[best] += 1
        M = M + infos[best]
    return counts


def _best(infos: np.ndarray, M: np.ndarray, criterion: Criterion, tried: int) -> tuple[int, float]:
    """The candidate that adds most to M and the criterion with it, among `tried` of largest slope."""
    if tried >= len(infos):
        some = np.arange(len(infos))
    else:
        slopes = infos.reshape(len(infos), -1) @ criterion.slope(M).ravel()
        some = np.sort(np.argpartition(-slopes, tried)[:tried])
    values = criterion.values(M + infos[some])
    best = int(np.argmax(values))
    return int(some[best]), float(values[best])


def exchange(
    infos: np.ndarray, base: np.ndarray, counts: np.ndarray, criterion: Criterion, rng: np.random.Generator
) -> np.ndarray:
    """Exchange runs one for one until none helps; the order in which they are tried is random."""
    counts, tried = counts.copy(), TRIED
    for _ in range(PASSES):
        better = _pass(infos, base, counts, criterion, rng, tried)
        if not better and tried == MOST_TRIED:
            break
        tried = TRIED if better else MOST_TRIED
    return counts


def _pass(
    infos: np.ndarray,
    base: np.ndarray,
    counts: np.ndarray,
    criterion: Criterion,
    rng: np.random.Generator,
    tried: int,
) -> bool:
    """Try another candidate for each run that is chosen; changes `counts` and returns whether any did."""
    M = base + np.tensordot(counts, infos, axes=1)
    value, better = float(criterion.values(M)), False
    for j in rng.permutation(np.flatnonzero(counts)):
        best, reached = _best(infos, M - infos[j], criterion, tried)
        if reached > value * (1.0 + BETTER):
            counts[j] -= 1
            counts[best] += 1
            M = base + np.tensordot(counts, infos, axes=1)
            value, better = float(criterion.values(M)), True
    return better


def choose(
    infos: np.ndarray, base: np.ndarray, runs: int, phi: Criterion, rng: np.random.Generator
) -> np.ndarray:
    """Return how often each candidate is run, (candidates,).

    A criterion with corners stops exchanges where two runs would have to change at once. So exchanges start
    from the choice for the volume (D), which has none and is near the optimum of every criterion.
    """
    d = criterion("D", len(base), np.empty(0))
    counts = exchange(infos, base, greedy(infos, base, runs, d), d, rng)
    return counts if phi.name == "D" else exchange(infos, base, counts, phi, rng)
