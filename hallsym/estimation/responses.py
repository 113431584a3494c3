"""What the readings of each run answered to its references: small regressions on run statistics."""

import numpy as np

from hallsym.estimation.likelihood import Cost
from hallsym.estimation.run_statistics import RunStatistics, projected
from hallsym.estimation.start import MOVED, LinearFit
from hallsym.log.quality.gains import Responses
from hallsym.model.features import Features

SHARE, CLEAR = 0.02, 0.1
"""Share of a reading's variance that the motion of a reference must make to be judged by; and the share that
may stay unexplained where the motion is smaller than the noise that is stated, perhaps in another unit."""
APART = 25.0
"""Energy of what a reference moves apart from the others, over its noise's, from which on its slope means
something: noise of a reference lowers its slope by one part in this."""
LEADS, AT_REST = 0.3, 0.05
"""Share of a reading's variance by which a reference leads a run; and the motion, beside that of the runs it
leads, at which it is at rest: what is left there follows the others, and its slope is noise over noise."""


def pose_features(features: Features) -> list[int] | None:
    """Return for each reference the feature that is its motion or begins as it does; None if one has none."""
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
    noise = np.einsum("rjj->rj", cost.noise_in_features)[:, index]
    X, Y = _freed(summary, index)
    gram, cross = np.swapaxes(X, 1, 2) @ X, np.swapaxes(X, 1, 2) @ Y
    energy, total = np.einsum("rjj->rj", gram), np.einsum("rik,rik->rk", Y, Y)
    signal = total / (summary.counts[:, None] * cost.reading_variance)
    together, inverse, left = _regression(gram, cross, total, energy > 0)
    part = together**2 * energy[:, :, None] / np.maximum(total, 1e-300)[:, None, :]
    own = 1.0 / np.maximum(np.einsum("rjj->rj", inverse), 1e-300)
    clear = own > APART * summary.counts[:, None] * noise
    never = ~clear.any(axis=0)  # then the noise is not in the unit of the column
    told = (part > SHARE) & (clear[:, :, None] | (never[:, None] & (left < CLEAR * total)[:, None, :]))
    share = np.where(signal > MOVED, left / np.maximum(total, 1e-300), 0.0)
    moved = told.any(axis=2) & _moves(energy, own, (part > LEADS).any(axis=2), summary.counts)
    slopes, inverse, left = _regression(gram, cross, total, moved)
    freedom = np.maximum(summary.counts[:, None] - moved.sum(axis=1, keepdims=True) - 1.0, 1.0)
    each = left / freedom  # of a short run too small by chance: what is usual is the least
    variance = np.maximum(np.maximum(each, np.median(each, axis=0)), cost.reading_variance)
    std = np.sqrt(np.einsum("rjj->rj", inverse)[:, :, None] * variance[:, None, :])
    return Responses(model, summary.runs, slopes, std, moved, share, signal, gram, total, together)


def _freed(summary: RunStatistics, index: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the features `index` and the readings of each run, freed of what a run has of its own."""
    features, n_zero = summary.features, summary.features.n_zero
    if min(index) >= n_zero:
        rows = summary.projected
        return rows[:, :, [k - n_zero for k in index]], rows[:, :, features.size - n_zero :]
    # zeros go along with the motion: only the features that do not move with it are a run's own
    pose = features.exponents.copy()
    pose[:, len(features.model.pose) : len(features.model.pose) + len(features.model.state)] = 0
    own = [k for k in range(n_zero) if not pose[k].any()]
    rows = projected(
        summary.triangles[:, :, [*own, *index, *range(features.size, summary.triangles.shape[2])]], len(own)
    )
    return rows[:, :, : len(index)], rows[:, :, len(index) :]


def _moves(energy: np.ndarray, own: np.ndarray, leads: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return whether each reference (runs, j) moves apart from the others, beside the runs it leads."""
    usual = np.where(leads, energy / counts[:, None], np.nan)
    any_ = leads.any(axis=0)
    usual[:, ~any_] = (energy / counts[:, None])[:, ~any_]
    return np.asarray(own / counts[:, None] > AT_REST**2 * np.nanmedian(usual, axis=0))


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


def coupling_of(merged: Cost, linear: LinearFit) -> np.ndarray | None:
    """Return the relative change of gains with each state column, (n_state, n_channels).

    None where no feature is a pose times a state.
    """
    features, model = merged.summary.features, merged.summary.model
    index = model.remember("coupled features", lambda: coupled_features(features))
    if index is None:
        return None
    R_f = merged.triangles[0][0]
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", R_f, R_f), 1e-300))
    used = (R_f / size)[:, linear.moved]
    variance = np.full(features.size, np.inf)
    inverse = np.linalg.pinv(used.T @ used, rcond=1e-12, hermitian=True)
    variance[linear.moved] = np.diag(inverse) / size[linear.moved] ** 2
    alone, coupled = index
    slopes, change = linear.coefficients[alone][:, None], linear.coefficients[coupled]
    along = slopes / variance[coupled][..., None]
    told = (along * slopes).sum(axis=0)
    return np.asarray((along * change).sum(axis=0) / np.where(told > 0, told, np.inf))


def coupled_features(features: Features) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the feature of each reference (n_pose,) and of its product with each state (n_pose, n_state)."""
    model, index = features.model, pose_features(features)
    if index is None or not model.state:
        return None
    where = {tuple(row): k for k, row in enumerate(features.exponents.tolist())}
    out = np.zeros((len(index), len(model.state)), dtype=int)
    for j, k in enumerate(index):
        for n in range(len(model.state)):
            row = features.exponents[k].copy()
            row[len(model.pose) + n] += 1
            if tuple(row.tolist()) not in where:
                return None
            out[j, n] = where[tuple(row.tolist())]
    return np.array(index), out
