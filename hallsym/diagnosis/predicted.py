"""How far a family of shapes predicts runs that it was not fitted on, from products of its columns."""

from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.chance import beyond

RIDGE = 1e-3
"""Pull of coefficients towards 0, over the squares of their column: what no fold determines stays 0."""


@dataclass(frozen=True)
class Shape:
    """How far a generic family lowers the gap metric on runs it was not fitted on, and its significance."""

    by: str
    drop: float
    p_value: float


def solved(train: np.ndarray, n: int) -> np.ndarray:
    """Coefficients of the first n columns for the others, (n, E), pulled to 0 a little."""
    G = train[:n, :n]
    size = np.sqrt(np.maximum(np.diag(G), 0.0))  # differences of sums may round below 0
    d = np.maximum(size, 1e-9 * max(size.max(initial=0.0), 1e-140))  # what never moved has no coefficient
    A = G / np.outer(d, d) + RIDGE * np.eye(n)
    return np.linalg.solve(A, train[:n, n:] / d[:, None]) / d[:, None]


def gained(x: np.ndarray, test: np.ndarray) -> float:
    """Decrease of the squares of `test` by coefficients x."""
    n = len(x)
    return float(2 * (x * test[:n, n:]).sum() - ((test[:n, :n] @ x) * x).sum())


def judged(by: str, folds: np.ndarray, E: int) -> Shape:
    """Return what a family explains of folds left out in turn; their last E columns are the errors."""
    total, n = folds.sum(axis=0), folds.shape[1] - 1 - E
    if len(folds) < 3:
        return Shape(by, 0.0, 1.0)
    own = np.diag(total)[1 : 1 + n]
    live = 1 + np.flatnonzero(own > 1e-9 * max(own.max(), 1e-300))
    pick = np.concatenate([live, np.arange(1 + n, 1 + n + E)])
    folds, total, n = folds[:, pick[:, None], pick], total[np.ix_(pick, pick)], len(live)
    best = solved(total, n)
    gains, scores, noise = [], [], []
    for fold, rest in zip(folds, others(folds), strict=True):
        x = solved(rest, n)
        gains.append(gained(x, fold))
        scores.append(float((x * fold[:n, n:]).sum()))
        noise.append(float((x * (fold[:n, n:] - fold[:n, :n] @ best)).sum()))
    p = beyond(np.array(scores), np.array(noise))
    return shape(by, np.array(gains), float(np.trace(total[n:, n:])), p)


def others(folds: np.ndarray) -> np.ndarray:
    """Sum of all folds but one, for each; a difference to the total would leave rounding where nothing is."""
    before, after = np.cumsum(folds[:-1], axis=0), np.cumsum(folds[:0:-1], axis=0)[::-1]
    return np.concatenate([after[:1], before[:-1] + after[1:], before[-1:]])


def shape(by: str, gains: np.ndarray, total: float, p_value: float) -> Shape:
    """Return a shape by the squares that it takes away, of `total`."""
    share = float(np.clip(gains.sum() / max(total, 1e-300), 0.0, 1.0))
    return Shape(by, 1 - float(np.sqrt(1 - share)), p_value)
