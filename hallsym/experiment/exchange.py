"""Whole runs: greedy choice, then exchange one run for another while that helps.

Fedorov, Theory of Optimal Experiments, Academic Press 1972, ch. 3. The slope of the criterion says which
candidates are worth a try; in the end every candidate has been tried for every run.
"""

from dataclasses import replace

import numpy as np

from hallsym.experiment.criteria import Criterion
from hallsym.experiment.relaxed import Relaxed

BETTER = 1e-6
"""Relative gain below which an exchange is not made."""
PASSES = 30
TRIED = 12
"""Candidates of largest slope that are tried, until none of them helps."""


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


def rounded(relaxed: Relaxed, runs: int) -> np.ndarray:
    """Whole numbers below the relaxed shares, at most `runs` in all; `greedy` adds what is missing."""
    return np.floor(relaxed.shares * runs + 1e-9).astype(int)


def exchange(
    infos: np.ndarray, base: np.ndarray, counts: np.ndarray, criterion: Criterion, rng: np.random.Generator
) -> np.ndarray:
    """Exchange runs one for one until none helps; the order in which they are tried is random."""
    counts, tried = counts.copy(), TRIED
    for _ in range(PASSES):
        better = _pass(infos, base, counts, criterion, rng, tried)
        if not better and tried >= len(infos):
            break
        tried = TRIED if better else len(infos)
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
    infos: np.ndarray,
    base: np.ndarray,
    runs: int,
    criterion: Criterion,
    relaxed: Relaxed,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the better of two starts, greedy and the rounded relaxation, each exchanged; (candidates,).

    A criterion with corners can hold an exchange up where two runs would have to change at once: it is
    rounded first.
    """
    starts: tuple[np.ndarray, ...] = (
        greedy(infos, base, runs, criterion),
        greedy(infos, base, runs, criterion, rounded(relaxed, runs)),
    )
    if criterion.soft is not None:
        soft = replace(criterion, values=criterion.soft)
        starts = tuple(exchange(infos, base, counts, soft, rng) for counts in starts)
    found = [exchange(infos, base, counts, criterion, rng) for counts in starts]
    return max(found, key=lambda c: float(criterion.values(base + np.tensordot(c, infos, axes=1))))
