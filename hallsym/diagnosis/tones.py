"""Steady tones in what a model leaves: lines of its spectrum that do not scatter as noise does."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.estimation.decoding import decoding_gain

SEGMENT = 128
"""Samples of a segment of the spectrum."""
FEWEST_SEGMENTS = 8
"""Segments from which on a spectrum has lines."""
AROUND = 7
"""Frequencies on either side of one whose median is what a line stands out from."""
SLOWEST = 4
"""Frequencies of a segment that are drift and no line."""
CERTAIN = 8.0
"""Standard deviations of the mean power of noise by which a line stands out."""


def tones(base: Base, runs: Iterable[int]) -> float:
    """Return by how much the gap metric of `runs` falls without the steady tones of the decoded error."""
    model, spread, back = base.model, decoding_gain(base.model), np.linalg.inv(base.whiten)
    of_run: dict[int, list[np.ndarray]] = {}
    window = np.hanning(SEGMENT)
    for piece in pieces(base, frozenset(runs)):
        pose, state = ([piece.data[c] for c in names] for names in (model.references, model.state))
        (gain,) = spread(base.p, pose, state, base.weight)
        D = gain.reshape(len(model.channels), len(model.pose), -1)
        e = np.einsum("kis,ks->is", D, back @ piece.residual) * base.pose_weights[:, None]
        e = np.where(piece.used, e, 0.0)
        for low in range(0, e.shape[1] - SEGMENT + 1, SEGMENT):
            part = e[:, low : low + SEGMENT]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            power = (np.abs(np.fft.rfft(part, axis=1)) ** 2).sum(axis=0)
            of_run.setdefault(piece.run, []).append(power)
    segments = sum(map(len, of_run.values()))
    if segments < FEWEST_SEGMENTS:
        return 0.0
    P = np.sum([np.sum(own, axis=0) for own in of_run.values()], axis=0)
    smooth = median_filter(P, 2 * AROUND + 1, mode="reflect")
    certain = P / np.maximum(smooth, 1e-300) > 1 + CERTAIN / np.sqrt(len(model.pose) * segments)
    certain[:SLOWEST] = False
    if not _steady(list(of_run.values()), certain):
        return 0.0
    share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
    return 1 - float(np.sqrt(max(1 - share, 0.0)))


def _steady(of_run: Sequence[Sequence[np.ndarray]], certain: np.ndarray) -> bool:
    """Return whether lines have the same power all through a run, unlike noise.

    Of few segments some noise is steady by chance, so no more of the other frequencies may be as steady than
    a false alarm has; of many, all noise is nearly as steady, so the line must be by a good part more. Runs
    of one segment are held against each other.
    """
    single = [own[0] for own in of_run if len(own) == 1]
    groups = [np.array(own) for own in (*of_run, single) if len(own) > 1]
    means = [np.maximum(own.mean(axis=0), 1e-300) for own in groups]
    varies = np.sum([((own - m) ** 2 / m).sum(axis=0) for own, m in zip(groups, means, strict=True)], axis=0)
    squares = np.sum([(len(own) - 1) * m for own, m in zip(groups, means, strict=True)], axis=0)
    noise = ~certain & (squares > 0)
    if not noise.any() or not squares[certain].sum() > 0:
        return True
    beside = np.convolve(certain, np.ones(3), mode="same") > 0  # a part of the line's power is theirs
    others = (varies / np.maximum(squares, 1e-300))[noise & ~beside]
    line = varies[certain].sum() / squares[certain].sum()
    as_steady = float((others <= line).mean()) if len(others) else 0.0
    usual = float(np.median(others)) if len(others) else np.inf
    return bool(as_steady < POLICY.false_alarm and line < POLICY.mostly * usual)
