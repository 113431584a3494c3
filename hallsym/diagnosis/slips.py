"""When a probe may have slipped: a step of gain and offset at any of many instants, from one pass."""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.refit import inverse
from hallsym.diagnosis.survey import SEGMENT
from hallsym.diagnosis.tangent import Base, Products

MAX_SEGMENTS = 1200
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
    whole = {run: np.sum([s[2] for s in parts], axis=0) for run, parts in by_run.items()}
    reduced = {run: _reduced(M, z) * (run in counted) for run, M in whole.items()}
    total = np.sum(list(reduced.values()), axis=0)
    n = len(total) - 1
    JJ = inverse(total[:n, :n])
    after, out = np.zeros_like(total), []
    for run in reversed(by_run):
        parts = by_run[run]
        late = np.zeros_like(whole[run])
        for j in range(len(parts) - 1, 0, -1) if run in counted else ():
            late = late + parts[j][2]
            step = _split(whole[run], late, after, k, column, z)
            out.append((parts[j][1], _gain(total, JJ, *step)))
        after = after + reduced[run]
        # between runs: the offset is the zero's
        step = after[:, [column]], after[[column], [column]][:, None]
        out.append((parts[0][1], _gain(total, JJ, *step)))
    return out


def _reduced(M: np.ndarray, z: int) -> np.ndarray:
    return M[z:, z:] - M[z:, :z] @ np.linalg.lstsq(M[:z, :z], M[:z, z:], rcond=1e-12)[0]


def _split(
    whole: np.ndarray, late: np.ndarray, after: np.ndarray, k: int, column: int, z: int
) -> tuple[np.ndarray, np.ndarray]:
    """Products of the two step columns (gain, offset) with the others and each other."""
    pick = [z + column, k]
    n = len(whole)
    M = np.zeros((n + 2, n + 2))
    M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:] = whole, late[:, pick], late[pick], late[np.ix_(pick, pick)]
    R = _reduced(M, z)
    m = n - z
    cross, own = R[:m, m:].copy(), R[m:, m:].copy()
    cross[:, 0] += after[:, column]
    own[0, 0] += after[column, column]
    return cross, own


def _gain(total: np.ndarray, JJ: np.ndarray, cross: np.ndarray, own: np.ndarray) -> float:
    """Decrease of the squares when the step columns join the parameters."""
    n = len(total) - 1
    through = JJ @ cross[:n]
    A = own - cross[:n].T @ through
    b = cross[n] - through.T @ total[:n, n]
    d = np.sqrt(np.maximum(np.diag(A), 1e-300))
    if np.any(np.diag(A) <= 1e-9 * np.maximum(np.diag(own), 1e-300)):
        return 0.0
    x = np.linalg.lstsq(A / np.outer(d, d), b / d, rcond=1e-9)[0]
    return float(b / d @ x)
