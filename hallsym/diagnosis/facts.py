"""What effects may know of a log before they are tried: length, columns, rails, hum, change points."""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.change_points import change_points
from hallsym.diagnosis.normal_equations import Accumulator, Stretch
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residual_table import ROOM, residual_table
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.survey import MAINS, MAINS_BAND, SEGMENT, Survey
from hallsym.estimation import eliminate, pseudo_inverse
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.model import Facts, Model

MAX_SEGMENTS = 1200
"""Stretches that a log is cut into at most; a slip may be at the start of each."""


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
    length = max(SEGMENT, -(-rows // MAX_SEGMENTS))
    stretches = [run for run in Accumulator(base).stretches(length) if run[0].run in set(runs)]
    return tuple(
        _best(stretches, k, column, len(base.model.zeros), base.holdout) for k, column in enumerate(places)
    )


def _best(
    stretches: Sequence[Sequence[Stretch]], k: int, column: int, z: int, holdout: frozenset[int]
) -> tuple[int, float]:
    """Instant at which a step of probe k's gain and offset lowers the squares of the fitted runs most.

    Where those leave open on which side of it a held-out run lies, that run says it of itself, like its zero
    deviation. Within a held-out run there is no instant: nothing that is fitted would know its offset.
    """
    runs = {run[0].run for run in stretches}
    gains = _gains(stretches, k, column, z, runs - holdout)
    most = max((gain for _, gain in gains), default=0.0)
    equal = {t for t, gain in gains if gain >= most * (1 - NIL)}
    if len(equal) > 1:
        gains = [(t, gain) for t, gain in _gains(stretches, k, column, z, runs) if t in equal]
    return k, max(gains, key=lambda g: g[1])[0] if gains else 0.0


def _gains(
    stretches: Sequence[Sequence[Stretch]], k: int, column: int, z: int, counted: set[int]
) -> list[tuple[float, float]]:
    """Every instant with what a step lowers the squares of the `counted` runs by."""
    stacks = [np.array([s.products for s in run]) for run in stretches]
    wholes = [M.sum(axis=0) for M in stacks]
    lefts, follows = zip(*(eliminate(M, z) for M in wholes), strict=True)
    reduced = [left * (run[0].run in counted) for run, left in zip(stretches, lefts, strict=True)]
    total = np.sum(reduced, axis=0)
    n = len(total) - 1
    JJ = pseudo_inverse(total[:n, :n])
    after, out = np.zeros_like(total), []
    for run, stack, whole, follow, own in reversed(
        list(zip(stretches, stacks, wholes, follows, reduced, strict=True))
    ):
        if run[0].run in counted and len(run) > 1:
            late = np.cumsum(stack[:0:-1], axis=0)
            gains = _gain(total, JJ, *_split(whole, follow, late, after, k, column))
            out += list(zip((s.start_s for s in run[:0:-1]), gains.tolist(), strict=True))
        after = after + own
        # between runs: the offset is the zero's
        step = after[None, :, [column]], after[None, [column], [column]][..., None]
        out.append((run[0].start_s, float(_gain(total, JJ, *step)[0])))
    return out


def _split(
    whole: np.ndarray, follow: np.ndarray, late: np.ndarray, after: np.ndarray, k: int, column: int
) -> tuple[np.ndarray, np.ndarray]:
    """Products of the two step columns (gain, offset) with the others and each other, for many instants.

    `late`: (instants, c, c) products of what of the run comes after; `follow`: how its zeros follow.
    """
    z = len(follow)
    pick = [z + column, k]
    cross = late[:, z:, :][:, :, pick] + follow.T @ late[:, :z, :][:, :, pick]
    own = late[:, pick, :][:, :, pick]
    through = np.linalg.lstsq(whole[:z, :z], np.hstack(list(late[:, :z, :][:, :, pick])), rcond=1e-12)[0]
    through = through.reshape(z, len(late), 2).swapaxes(0, 1)
    own = own - late[:, pick, :][:, :, :z] @ through
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
    gain = np.einsum("ij,ijk,ik->i", b, pseudo_inverse(A, NIL), b)
    return np.where((left <= NIL * np.maximum(raw, 1e-300)).any(axis=1), 0.0, gain)


# -- two levels of offset among the runs ---------------------------------------------------------------------

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


QUANTILES = (0.998, 0.99, 0.97, 0.93)
"""Quantiles of the readings that are tried as rails, each high and low."""


def _steps_at(base: Base, found: Sequence[tuple[int, float]]) -> tuple[float, ...]:
    """Return the p-value of a step in the run of each instant and channel; 1 where another channel steps."""
    fitted = [run for run in base.log.runs if run not in base.holdout]
    r = residual_table(base, fitted) if found else None
    if r is None:
        return ()
    steps = {(s.run, s.channel): s.p_value for s in change_points(r)}
    times = r.columns["campaign_s"]
    runs = [int(r.run[int(np.argmin(np.abs(times - t)))]) for _, t in found]
    return tuple(steps.get((run, k), 1.0) for run, (k, _) in zip(runs, found, strict=True))


def facts_of(base: Base, found: Survey) -> Facts:
    """Return what effects may know of the log; searched numbers come from the residual of `base`."""
    model, log = base.model, base.log
    slips = instants(base, log.runs, log.rows)
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        columns=tuple(c for c in log.columns if base.timed or c != "t_s"),
        temperature=_mean(log, "temperature_degc") if "temperature_degc" in log.columns else None,
        extremes=_extremes(log, model),
        rails=rails_of(log, model),
        lines_hz=found.lines_hz,
        lines_tried=max(1, round(2 * MAINS_BAND * len(MAINS) * found.duration_s)),
        instants=slips,
        instants_p=_steps_at(base, slips),
        instants_tried=len(model.layout) * min(MAX_SEGMENTS, -(-log.rows // SEGMENT) + len(log.runs)),
        on_runs=switched_runs(base) if len(model.channels) > len(model.pose) and not model.zeros else (),
        on_runs_tried=2 ** (len(log.runs) - 1),
    )


def _mean(log: Log, column: str) -> float:
    sums = [(b.data[column].sum(), len(b)) for b in batches(log, (column,))]
    return float(sum(s for s, _ in sums) / sum(n for _, n in sums))


def rails_of(log: Log, model: Model) -> tuple[tuple[float, float], ...]:
    """Return lowest and highest value of each channel where it repeats exactly; -inf and inf where not."""
    low, high = np.full(len(model.channels), np.inf), np.full(len(model.channels), -np.inf)
    at_low, at_high = np.zeros(len(low)), np.zeros(len(low))
    for batch in batches(log, model.channels):
        values = np.array(batch.columns(model.channels))
        lowest, highest = values.min(axis=1), values.max(axis=1)
        at_low = np.where(lowest < low, 0, at_low)
        at_high = np.where(highest > high, 0, at_high)
        low, high = np.minimum(low, lowest), np.maximum(high, highest)
        at_low += (values == low[:, None]).sum(axis=1)
        at_high += (values == high[:, None]).sum(axis=1)
    return tuple(
        (a if n >= POLICY.rail_repeats else -np.inf, b if m >= POLICY.rail_repeats else np.inf)
        for a, b, n, m in zip(low.tolist(), high.tolist(), at_low, at_high, strict=True)
    )


def _extremes(log: Log, model: Model) -> np.ndarray:
    """Return quantiles of the readings, high and low in turn: (2 n_quantiles, n_channels)."""
    thin = max(1, log.rows // ROOM)
    values = np.hstack([np.array(b.columns(model.channels))[:, ::thin] for b in batches(log, model.channels)])
    return np.vstack([np.quantile(values, [a, 1 - a], axis=1) for a in QUANTILES])
