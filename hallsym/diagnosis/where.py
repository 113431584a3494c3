"""Where the gap lives: which share of the excess goes with a sensor, a coordinate, a run, a frequency."""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.chance import chance
from hallsym.diagnosis.record import Statement
from hallsym.diagnosis.survey import pieces
from hallsym.diagnosis.tangent import Base

BINS = 8
LEVEL = 0.001
LEAST = 0.02
"""Significance and share of the excess that a statement must have."""
BANDS = (0.0, 0.5, 2.0, 5.0, 10.0, 20.0, 45.0, 55.0, 65.0)

NAMES = {
    "x_ref_m": "place in the stroke of x", "y_ref_m": "place in the stroke of y", "rz_ref_rad": "rotation Rz",
    "z_m": "height Z", "rx_rad": "tilt Rx", "ry_rad": "tilt Ry",
    "temperature_degc": "temperature", "t_s": "time",
    "d1_x_ref_m": "velocity of x", "d1_y_ref_m": "velocity of y", "d1_rz_ref_rad": "velocity of Rz",
}  # fmt: skip


def where(base: Base, runs: Sequence[int], inflation: float) -> tuple[Statement, ...]:
    """Return ranked statements on the excess of the whitened residual of `base` above its noise.

    In each bin of a coordinate the residual may have an offset and a gain of its own; what that explains
    beyond chance is the coordinate's share. Residuals that are only noise get no statement.
    """
    known = frozenset(runs)
    edges = _edges(base, known)
    K, n_pose = len(base.model.channels), len(base.model.pose)
    sums = {c: np.zeros((len(e) + 1, 1 + n_pose + K, 1 + n_pose + K)) for c, e in edges.items()}
    by_run: dict[int, np.ndarray] = {}
    channel, bands, count = np.zeros(K), np.zeros((2, len(BANDS))), 0
    for piece in pieces(base, known):
        r = np.where(piece.used, piece.residual, 0.0)
        motion = [piece.data[c] for c in base.model.references]
        rows = np.vstack([np.ones(len(piece.t)), *motion, r])
        for c, edge in edges.items():
            bin_ = np.searchsorted(edge, piece.data[c])
            for b in np.unique(bin_):
                part = rows[:, bin_ == b]
                sums[c][b] += part @ part.T
        run = by_run.setdefault(piece.run, np.zeros((len(rows), len(rows))))
        run += rows @ rows.T
        channel += (r**2).sum(axis=1)
        count += len(piece.t)
        _spectrum(bands, piece.t, r)
    excess = float(channel.sum()) - count * K
    if excess <= count * K * 0.01:
        return ()
    out = [_of_channel(base, k, channel[k] - count, excess, count * inflation) for k in range(K)]
    for c, parts in sums.items():
        out.append(_of_bins(NAMES.get(c, c), "offset or gain in bins", parts, K, excess, inflation))
    out.append(
        _of_bins("run", "offset or gain of its own", np.array(list(by_run.values())), K, excess, inflation)
    )
    out += _of_bands(bands, excess, inflation)
    kept = [s for s in out if s.p_value < LEVEL and s.share > LEAST]
    return tuple(sorted(kept, key=lambda s: -s.share))


def _edges(base: Base, runs: frozenset[int]) -> dict[str, np.ndarray]:
    """Inner bin edges of each coordinate: quantiles of a sample of the log."""
    seen: dict[str, list[np.ndarray]] = {}
    for piece in pieces(base, runs):
        for c in NAMES:
            if c in piece.data:
                seen.setdefault(c, []).append(piece.data[c][:: max(1, len(piece.t) // 64)])
    out = {}
    for c, parts in seen.items():
        inner = np.unique(np.quantile(np.concatenate(parts), np.arange(1, BINS) / BINS))
        if len(inner) > 1:
            out[c] = inner
    return out


def _of_channel(base: Base, k: int, part: float, excess: float, N: float) -> Statement:
    name, share = base.model.channels[k], part / excess
    p = chance(max(part, 0.0) ** 2 / (2 * N), 1)
    return Statement("sensor", name, share, p, f"{100 * share:.0f} % of the excess is seen by {name}")


def _of_bins(by: str, what: str, parts: np.ndarray, K: int, excess: float, inflation: float) -> Statement:
    n, explained, size = parts.shape[1] - K, 0.0, 0
    strongest, where_ = -1.0, 0
    for b, M in enumerate(parts):
        if M[0, 0] < 4 * n:
            continue
        d = np.sqrt(np.maximum(np.diag(M)[:n], 1e-300))
        A = M[:n, :n] / np.outer(d, d)
        value, vector = np.linalg.eigh(A)
        good = value > 1e-9 * value.max()
        along = (vector[:, good].T @ (M[:n, n:] / d[:, None])) / np.sqrt(value[good])[:, None]
        own = float((along**2).sum())
        size += int(good.sum()) * K
        explained += own
        if own > strongest:
            strongest, where_ = own, b
    share = max(0.0, (explained - inflation * size) / excess)
    p = chance(explained / inflation, max(size, 1))
    text = f"{100 * share:.0f} % of the excess is an {what} of {by}" if by != "run" else (
        f"{100 * share:.0f} % of the excess is an {what} in every run")  # fmt: skip
    return Statement(by, f"bin {where_ + 1} of {len(parts)} most", share, p, text)


def _spectrum(bands: np.ndarray, t: np.ndarray, r: np.ndarray) -> None:
    """Add the power of each band and what white noise would have there."""
    if len(t) < 16:
        return
    power = (np.abs(np.fft.rfft(r, axis=1)) ** 2).sum(axis=0) / len(t)
    f = np.fft.rfftfreq(len(t), float(np.median(np.diff(t))))
    twice = np.where((f > 0) & (f < f[-1]), 2.0, 1.0)
    at = np.searchsorted(BANDS, f, side="right") - 1
    np.add.at(bands[0], at, power * twice)
    np.add.at(bands[1], at, twice * len(r))


def _of_bands(bands: np.ndarray, excess: float, inflation: float) -> list[Statement]:
    out = []
    for k, (power, white) in enumerate(bands.T):
        if white <= 0:
            continue
        high = f"{BANDS[k + 1]:g}" if k + 1 < len(BANDS) else "..."
        share = float(power - white) / excess
        p = chance(power, max(white, 1.0))
        text = f"{100 * share:.0f} % of the excess lies at {BANDS[k]:g} to {high} Hz"
        out.append(Statement("frequency", f"{BANDS[k]:g} to {high} Hz", share, p, text))
    return out
