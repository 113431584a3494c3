"""When a probe may have slipped: a step of gain and offset at any of many instants, from one pass."""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.refit import inverse
from hallsym.diagnosis.survey import SEGMENT
from hallsym.diagnosis.tangent import Products

MAX_SEGMENTS = 1200
"""Stretches that a log is cut into at most; a slip may be at the start of each."""
SAME = 1e-9
"""Relative difference below which two instants are the same to the fitted runs."""


def instants(base: Base, runs: Sequence[int], rows: int) -> tuple[tuple[int, float], ...]:
    """Return, for each probe, the instant [s since the log began] at which a step explains most.

    Runs that are held out take no part, but for the side of it on which they lie.
    """
    names = [f"eta_{probe.label}" for probe in base.model.layout]
    if not base.model.zeros or any(n not in base.model.names for n in names):
        return ()
    places = [
        base.free.index(base.model.names.index(n)) for n in names if base.model.names.index(n) in base.free
    ]
    if len(places) < len(names):
        return ()
    segments = _segments(base, set(runs), max(SEGMENT, -(-rows // MAX_SEGMENTS)))
    return tuple(
        _best(segments, k, column, len(base.model.zeros), base.apart) for k, column in enumerate(places)
    )


def _segments(base: Base, runs: set[int], size: int) -> list[tuple[int, float, np.ndarray]]:
    """Run, first time and products of each stretch of `size` samples, zeros still among the columns."""
    out = []
    for run, start, white in Products(base).segments(size):
        if run in runs:
            out.append((run, start, white))
    return out


def _best(
    segments: list[tuple[int, float, np.ndarray]], k: int, column: int, z: int, apart: frozenset[int]
) -> tuple[int, float]:
    """Instant at which a step of probe k's gain and offset lowers the squares of the fitted runs most.

    Where those leave open on which side of it a held-out run lies, that run says it of itself, like its zero
    deviation. Within a held-out run there is no instant: nothing that is fitted would know its offset.
    """
    runs = {run for run, _, _ in segments}
    gains = _gains(segments, k, column, z, runs - apart)
    most = max((gain for _, gain in gains), default=0.0)
    equal = {t for t, gain in gains if gain >= most * (1 - SAME)}
    if len(equal) > 1:
        gains = [(t, gain) for t, gain in _gains(segments, k, column, z, runs) if t in equal]
    return k, max(gains, key=lambda g: g[1])[0] if gains else 0.0


def _gains(
    segments: list[tuple[int, float, np.ndarray]], k: int, column: int, z: int, counted: set[int]
) -> list[tuple[float, float]]:
    """Every instant with what a step lowers the squares of the `counted` runs by."""
    by_run: dict[int, list[tuple[int, float, np.ndarray]]] = {}
    for segment in segments:
        by_run.setdefault(segment[0], []).append(segment)
    stacks = {run: np.array([s[2] for s in parts]) for run, parts in by_run.items()}
    wholes = {run: M.sum(axis=0) for run, M in stacks.items()}
    zeros = {run: np.linalg.pinv(M[:z, :z], rcond=1e-12, hermitian=True) for run, M in wholes.items()}
    reduced = {run: _reduced(M, zeros[run], z) * (run in counted) for run, M in wholes.items()}
    total = np.sum(list(reduced.values()), axis=0)
    n = len(total) - 1
    JJ = inverse(total[:n, :n])
    after, out = np.zeros_like(total), []
    for run in reversed(by_run):
        parts = by_run[run]
        if run in counted and len(parts) > 1:
            late = np.cumsum(stacks[run][:0:-1], axis=0)
            gains = _gain(total, JJ, *_split(wholes[run], zeros[run], late, after, k, column))
            out += list(zip((p[1] for p in parts[:0:-1]), gains.tolist(), strict=True))
        after = after + reduced[run]
        # between runs: the offset is the zero's
        step = after[None, :, [column]], after[None, [column], [column]][..., None]
        out.append((parts[0][1], float(_gain(total, JJ, *step)[0])))
    return out


def _reduced(M: np.ndarray, zeros: np.ndarray, z: int) -> np.ndarray:
    return M[z:, z:] - M[z:, :z] @ zeros @ M[:z, z:]


def _split(
    whole: np.ndarray, zeros: np.ndarray, late: np.ndarray, after: np.ndarray, k: int, column: int
) -> tuple[np.ndarray, np.ndarray]:
    """Products of the two step columns (gain, offset) with the others and each other, for many instants.

    `late`: (instants, c, c) products of what of the run comes after; `zeros`: inverse of those of its zeros.
    """
    z = len(zeros)
    pick = [z + column, k]
    through = zeros @ late[:, :z, :][:, :, pick]
    cross = late[:, z:, :][:, :, pick] - whole[z:, :z] @ through
    own = late[:, pick, :][:, :, pick] - late[:, pick, :][:, :, :z] @ through
    cross[:, :, 0] += after[:, column]
    own[:, 0, 0] += after[column, column]
    return cross, own


def _gain(total: np.ndarray, JJ: np.ndarray, cross: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Decrease of the squares when the step columns join the parameters, for many instants."""
    n = len(total) - 1
    through = JJ @ cross[:, :n]
    A = own - cross[:, :n].swapaxes(1, 2) @ through
    b = cross[:, n] - through.swapaxes(1, 2) @ total[:n, n]
    left, raw = (np.diagonal(M, axis1=1, axis2=2) for M in (A, own))
    d = np.sqrt(np.maximum(left, 1e-300))
    x = np.linalg.pinv(A / (d[:, :, None] * d[:, None]), rcond=1e-9, hermitian=True) @ (b / d)[:, :, None]
    gain = np.einsum("ij,ij->i", b / d, x[:, :, 0])
    return np.where((left <= 1e-9 * np.maximum(raw, 1e-300)).any(axis=1), 0.0, gain)
