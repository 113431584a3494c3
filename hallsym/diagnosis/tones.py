"""Steady tones in what a model leaves: lines of its spectrum that do not scatter as noise does."""

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.p_values import statistic_at
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.survey import SEGMENT
from hallsym.estimation.decoding import decoding_gain

LOBE = 4
"""Frequencies that a line takes in a spectrum with Hann's window, the width of its main lobe: so many at the
slow end are drift, and a median over four lobes is what lies between lines."""


def tones(base: Base, runs: Iterable[int]) -> float:
    """Return by how much the gap metric of `runs` falls without the steady tones of the decoded error."""
    model, spread, back = base.model, decoding_gain(base.model), np.linalg.inv(base.whiten)
    length, run, power = 2 * SEGMENT, [], []
    window = np.hanning(length)
    for piece in pieces(base, frozenset(runs)):
        pose, state = ([piece.data[c] for c in names] for names in (model.references, model.state))
        (gain,) = spread(base.p, pose, state, base.weight)
        D = gain.reshape(len(model.channels), len(model.pose), -1)
        e = np.einsum("kis,ks->is", D, back @ piece.residual) * base.pose_weights[:, None]
        e = np.where(piece.used, e, 0.0)
        for low in range(0, e.shape[1] - length + 1, length):
            part = e[:, low : low + length]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            run.append(piece.run)
            power.append((np.abs(np.fft.rfft(part, axis=1)) ** 2).sum(axis=0))
    if len(run) < POLICY.fewest:
        return 0.0
    P = np.sum(power, axis=0)
    smooth = median_filter(P, 4 * LOBE - 1, mode="reflect")
    freedom = 2 * len(model.pose) * len(run)
    certain = P * freedom > smooth * statistic_at(POLICY.certain / len(P), freedom)
    certain[:LOBE] = False
    if not _steady(np.array(run), np.array(power), certain):
        return 0.0
    share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
    return 1 - float(np.sqrt(max(1 - share, 0.0)))


def _steady(run: np.ndarray, power: np.ndarray, certain: np.ndarray) -> bool:
    """Return whether lines have the same power (segments, frequencies) all through a run, unlike noise.

    Of few segments some noise is steady by chance, so no more of the other frequencies may be as steady than
    a false alarm has; of many, all noise is nearly as steady, so the line must be by a good part more. Runs
    of one segment are held against each other.
    """
    _, index, count = np.unique(run, return_inverse=True, return_counts=True)
    _, group, count = np.unique(
        np.where(count[index] > 1, index, -1), return_inverse=True, return_counts=True
    )
    means = np.array([power[group == k].mean(axis=0) for k in range(len(count))]).clip(1e-300)
    varies = ((power - means[group]) ** 2 / means[group]).sum(axis=0)
    squares = (count - 1) @ means
    beside = np.convolve(certain, np.ones(3), mode="same") > 0  # a part of the line's power is theirs
    others = varies[~beside] / np.maximum(squares[~beside], 1e-300)
    if not len(others) or not squares[certain].sum() > 0:
        return True
    line = varies[certain].sum() / squares[certain].sum()
    return bool(np.mean(others <= line) < POLICY.false_alarm and line < POLICY.mostly * np.median(others))
