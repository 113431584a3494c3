"""In which runs a field may have been switched on: two levels of offset among the runs, from one pass."""

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.residuals import pieces

FEWEST = 4
"""Runs that two levels must be told from."""


def switched_runs(base: Base) -> tuple[int, ...]:
    """Return the runs whose offset forms a level of its own beside the others; none where runs are too few.

    Offsets are the mean whitened residuals of each run, along the direction in which they differ most; the
    split into two levels is the one that explains most of their squares. A run of either side says of itself,
    held out or not, on which level it lies. The first run is always on the other level.
    """
    sums: dict[int, np.ndarray] = {}
    counts: dict[int, int] = {}
    for piece in pieces(base, frozenset(base.log.runs)):
        total = piece.residual[:, piece.used].sum(axis=1)
        sums[piece.run] = sums.get(piece.run, 0.0) + total
        counts[piece.run] = counts.get(piece.run, 0) + int(piece.used.sum())
    runs = [run for run, n in counts.items() if n]
    if len(runs) < FEWEST:
        return ()
    n = np.array([counts[run] for run in runs], dtype=float)
    mean = np.array([sums[run] / counts[run] for run in runs])
    mean -= n @ mean / n.sum()
    _, _, along = np.linalg.svd(np.sqrt(n)[:, None] * mean, full_matrices=False)
    level = mean @ along[0]
    order = np.argsort(level)
    below = np.cumsum((n * level)[order])[:-1]
    left = np.cumsum(n[order])[:-1]
    split = 1 + int(np.argmax(below**2 * (1 / left + 1 / (n.sum() - left))))
    high = {runs[k] for k in order[split:]}
    on = set(runs) - high if runs[0] in high else high
    return tuple(sorted(on))
