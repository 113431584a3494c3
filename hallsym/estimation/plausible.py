"""Whether a log can be what it says, judged by linear coefficients of its runs before a solver sees them.

Units, signs and order of channels and references, and references that are late by whole samples.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hallsym.estimation.factors import RunStatistics, projected
from hallsym.estimation.likelihood import Cost, Point
from hallsym.estimation.optimum import MOVED, LinearFit
from hallsym.estimation.outliers import residuals
from hallsym.log import Log, Noise
from hallsym.log.phase import continuous
from hallsym.log.quality.findings import Fault
from hallsym.log.quality.gains import Explanation, Responses, judge_gains
from hallsym.log.quality.gains import Judgement as Judgement
from hallsym.log.table import TableLike, View
from hallsym.model import Model
from hallsym.model.arrays import medians_of
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
    leads, counts = (part > LEADS).any(axis=2), summary.counts[:, None]
    usual = medians_of(energy / counts, leads | ~leads.any(axis=0))  # over the runs that a reference leads
    moved = told.any(axis=2) & (own / counts > AT_REST**2 * usual)
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


Wiring = tuple[tuple[str, int], ...]
"""For each nominal channel: the channel that carries it and its sign."""


class _Rewired(View):
    """The table of a log whose channels are taken from other channels, with a sign."""

    def __init__(self, table: TableLike, sources: dict[str, tuple[str, int]]) -> None:
        super().__init__(table)
        self.sources = sources

    def counts_per_turn(self, column: str) -> float | None:
        """Return the counts of a turn of the column's source; None of an inverted one, which is below 0."""
        source, sign = self.sources.get(column, (column, 1))
        return self.table.counts_per_turn(source) if sign > 0 else None

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[dict[str, np.ndarray]]:
        wanted = tuple(dict.fromkeys(self.sources.get(c, (c, 1))[0] for c in columns))
        for piece in self.table.pieces(wanted, size):
            yield {c: self._taken(piece, c) for c in columns}

    def _taken(self, piece: dict[str, np.ndarray], column: str) -> np.ndarray:
        source, sign = self.sources.get(column, (column, 1))
        return piece[source] if sign > 0 else -piece[source]


def rewired(log: Log, channels: Sequence[str], wiring: Wiring | None) -> Log:
    """Return the log with `channels[k]` read from `wiring[k]`: another channel, perhaps inverted."""
    if wiring is None:
        return log
    sources = dict(zip(channels, wiring, strict=True))
    sigmas = dict(log.noise.sigmas)
    sigmas |= {c: log.noise.sigmas[s] for c, (s, _) in sources.items() if s in log.noise.sigmas}
    return replace(log, table=_Rewired(log.table, sources), noise=Noise(sigmas))


def composed(first: Wiring | None, then: Wiring | None, channels: Sequence[str]) -> Wiring | None:
    """Return the wiring of a log that was wired as `first` and, on that, as `then`."""
    if first is None or then is None:
        return first or then
    at = {c: first[k] for k, c in enumerate(channels)}
    return tuple((at[source][0], sign * at[source][1]) for source, sign in then)


def as_read(log: Log, model: Model, wiring: Wiring | None = None) -> Log:
    """Return the log as `model` reads it: wired as a fit found it, columns that repeat made continuous."""
    return continuous(rewired(log, model.channels, wiring), model)


def wiring_of(explanations: Sequence[Explanation]) -> Wiring | None:
    """Return the wiring that explains a log's slopes; None where only other columns or units explain them."""
    for found in explanations:
        if found.only_channels and all(c.factor == 1 for c in found.channels):
            return tuple((c.source, c.sign) for c in found.channels)
    return None


MISFIT = 1.5
"""Mean square of residuals over noise from which on it is asked for."""
SAMPLES = 0.5
"""Delay in samples from which on a logger is to blame; less is a lag, a matter of diagnosis."""
MOST, ALIKE = 0.8, 0.2
"""Share of the misfit that a delay must explain; relative difference of the channels' delays, at most."""


def lateness(log: Log, point: Point) -> str | None:
    """Return a note where the readings follow references of another time; None where they do not.

    One parameter by channel: residuals r against the rate of the model's reading m, delay = r.m' / m'.m'.
    `point`: of the cost at the optimum.
    """
    cost, model = point.cost, point.cost.summary.model
    noise, used = point.covariance.mean(axis=0).diagonal(), set(cost.summary.runs)
    if "t_s" not in log.columns or point.value < MISFIT * float(cost.summary.counts.sum()) * len(noise):
        return None
    residual = residuals(model, point.p, dict(zip(cost.summary.runs, point.zeros, strict=True)))
    sums, ticks, rows = np.zeros((3, len(model.channels))), list[float](), 0
    for block in log.blocks((*model.references, *model.state, *model.channels, "t_s")):
        t = block.data["t_s"]
        if block.run not in used or len(t) < 3 or not np.all(np.diff(t) > 0):
            continue
        left = residual(block)
        rate = np.gradient(np.array([block.data[c] for c in model.channels]) - left, t, axis=1)
        left = left - left.mean(axis=1, keepdims=True)
        sums += np.array([(left * left).sum(axis=1), (left * rate).sum(axis=1), (rate * rate).sum(axis=1)])
        ticks.append(float(np.median(np.diff(t))))
        rows += len(t)
    tick = float(np.median(ticks)) if ticks else 0.0
    # a rate by central differences holds half the variance of the references' own noise, per tick squared
    sums[2] -= rows * (noise - cost.reading_variance) / max(2 * tick**2, 1e-300)
    if not ticks or not np.all(sums[2] > 0):
        return None
    delay = sums[1] / sums[2]
    excess = sums[0] - rows * noise
    explained = (sums[1] ** 2 / sums[2]).sum() / max(excess.sum(), 1e-300)
    middle = float(np.median(delay))
    if explained < MOST or abs(middle) < SAMPLES * tick or np.ptp(delay) > ALIKE * abs(middle):
        return None
    when = "late" if middle > 0 else "early"
    return Fault(
        f"References of {log.name} look {abs(middle) / tick:.2g} samples ({abs(middle):.3g} s) {when} beside "
        f"the readings, which explains {100 * min(explained, 1.0):.0f} % of what the model leaves: check how "
        "columns were put together; hallsym diagnose compares a delay with a lag and hysteresis."
    )


def judge(
    log: Log, everything: Cost, merged: Cost, linear: LinearFit, holdout: Collection[int] = ()
) -> Judgement:
    """Judge the columns of a log by its cost; a run in `holdout` is no reason to refuse."""
    seen, coupling = responses_of(everything), coupling_of(merged, linear)
    state = everything.summary.first_state
    moved = 0.0 if coupling is None else np.abs(state - np.median(state, axis=0)) @ np.abs(coupling)
    return Judgement() if seen is None else judge_gains(log, seen, holdout, moved)
