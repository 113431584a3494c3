"""What the readings of each run answered to its references: small regressions on run statistics."""

import numpy as np

from hallsym.estimation.likelihood import Cost
from hallsym.estimation.start import MOVED
from hallsym.log.quality.responses import Responses
from hallsym.model.features import Features

SHARE, CLEAR = 0.02, 0.1
"""Share of a reading's variance that the motion of a reference must make to be judged by; and the share that
may stay unexplained where the motion is smaller than the noise that is stated, perhaps in another unit."""


def pose_features(features: Features) -> list[int] | None:
    """Return for each reference the feature that is its motion, or begins as it does; None if one has none."""
    model = features.model
    rest = [np.zeros(1) for _ in (*model.pose, *model.state)]
    n, centre = len(model.pose), np.zeros(features.exponents.shape[1])
    slopes = features.slopes(rest[:n], rest[n:], centre)[0].reshape(len(rest), -1)
    alone = np.count_nonzero(slopes, axis=0) == 1
    found = [np.flatnonzero(alone & (slopes[j] == 1.0)) for j in range(n)]
    return [int(k[0]) for k in found] if all(len(k) for k in found) else None


def responses_of(cost: Cost) -> Responses | None:
    """Return slopes by run; None where a reading is not nearly linear in the pose."""
    summary = cost.summary
    features, model = summary.features, summary.model
    index = model.remember("pose features", lambda: pose_features(features))
    if index is None:
        return None
    rows, noise = summary.projected, np.einsum("rjj->rj", cost.noise_in_features)[:, index]
    inner = [k - features.n_zero for k in index]
    X, Y = rows[:, :, inner], rows[:, :, features.size - features.n_zero :]
    gram, cross = np.swapaxes(X, 1, 2) @ X, np.swapaxes(X, 1, 2) @ Y
    energy, total = np.einsum("rjj->rj", gram), np.einsum("rik,rik->rk", Y, Y)
    signal = total / (summary.counts[:, None] * cost.reading_variance)
    slopes, _, left = _regression(gram, cross, total, energy > 0)
    part = slopes**2 * energy[:, :, None] / np.maximum(total, 1e-300)[:, None, :]
    clear = energy > MOVED * summary.counts[:, None] * noise
    told = (part > SHARE) & (clear[:, :, None] | (left < CLEAR * total)[:, None, :])
    moved = told.any(axis=2)
    slopes, inverse, left = _regression(gram, cross, total, moved)
    freedom = np.maximum(summary.counts[:, None] - moved.sum(axis=1, keepdims=True) - 1.0, 1.0)
    variance = np.maximum(left / freedom, cost.reading_variance)
    std = np.sqrt(np.einsum("rjj->rj", inverse)[:, :, None] * variance[:, None, :])
    share = np.where(signal > MOVED, left / np.maximum(total, 1e-300), 0.0)
    return Responses(model, summary.runs, slopes, std, moved, share, signal)


def _regression(
    gram: np.ndarray, cross: np.ndarray, total: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slopes (r, j, k) with the columns `used` (r, j), the inverse of their products, what is left."""
    energy = np.einsum("rjj->rj", gram)
    scale = used / np.sqrt(np.where(energy > 0, energy, 1.0))
    outer = scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.pinv(gram * outer, rcond=1e-9, hermitian=True) * outer
    slopes = inverse @ cross
    return slopes, inverse, np.maximum(total - np.einsum("rjk,rjk->rk", slopes, cross), 0.0)
