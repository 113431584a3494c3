"""Decode the pose from readings over a log and tabulate its errors against the reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.arrays import on_arrays
from hallsym.batches import Weigh, batches
from hallsym.cost import cost_of
from hallsym.log import Log
from hallsym.model import Model
from hallsym.summary import summarise
from hallsym.turning import near


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Errors of the decoded pose, run by run: reference subtracted, one column per pose coordinate.

    `count`: (runs,) samples. `squares`: (runs, n_pose) sums of squares. `peak`: (runs, n_pose) largest
    absolute error. Units are those of `pose` (m, rad).
    """

    pose: tuple[str, ...]
    runs: tuple[int, ...]
    count: np.ndarray
    squares: np.ndarray
    peak: np.ndarray

    def over(self, runs: Sequence[int] | None = None) -> dict[str, dict[str, float]] | None:
        """Return `{"rmse": {x_m: ..}, "peak": {..}}` over some runs (default: all); None without any."""
        pick = [k for k, run in enumerate(self.runs) if runs is None or run in set(runs)]
        if not pick or self.count[pick].sum() == 0:
            return None
        rmse = np.sqrt(self.squares[pick].sum(axis=0) / self.count[pick].sum())
        peak = self.peak[pick].max(axis=0)
        return {
            "rmse": dict(zip(self.pose, rmse.tolist(), strict=True)),
            "peak": dict(zip(self.pose, peak.tolist(), strict=True)),
        }


def decoder(model: Model, reading_variance: np.ndarray) -> Callable[..., np.ndarray]:
    """Return `decode(p, zeros, readings, states) -> (n_pose, samples)`, compiled once for arrays."""
    run, weight = on_arrays(model.decoded), 1.0 / np.asarray(reading_variance)

    def decode(p: np.ndarray, zeros: np.ndarray, readings: list, states: list) -> np.ndarray:
        return run(p, zeros, readings, states, weight)[0]

    return decode


def error_tables(
    log: Log,
    model: Model,
    versions: Sequence[tuple[np.ndarray, Mapping[int, np.ndarray]]],
    reading_variance: np.ndarray,
    keep: Weigh | None = None,
    on_rows: Callable[[int], None] | None = None,
) -> list[ErrorTable]:
    """Return one error table per version `(parameters, zeros by run)`, from one pass over the log.

    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part.
    """
    decode, none = decoder(model, reading_variance), np.zeros(len(model.zeros))
    sums: list[dict[int, list]] = [{} for _ in versions]
    for batch in batches(log, columns_of(model), on_rows):
        readings, states = batch.columns(model.channels), batch.columns(model.state)
        weights, lengths = batch.weights(keep), np.diff(batch.edges)
        for (p, zeros), total in zip(versions, sums, strict=True):
            own = np.array([zeros.get(block.run, none) for block in batch.blocks])
            error = decode(p, np.repeat(own, lengths, axis=0).T, readings, states)
            reference = np.array(batch.columns(model.references))
            error = near(model, error, reference) - reference if model.period else error - reference
            for block, at in batch.parts():
                _add(total, block.run, error[:, at] if weights is None else error[:, at][:, weights[at] > 0])
    return [_table(model, total) for total in sums]


def judge(log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float]) -> ErrorTable:
    """Return the errors of fixed parameters on another log; each run's zeros are estimated from that run."""
    summary = summarise(log, model)
    cost = cost_of(summary, noise)
    zeros = dict(zip(summary.runs, cost.at(p).zeros, strict=True))
    return error_tables(log, model, [(p, zeros)], cost.reading_variance)[0]


def columns_of(model: Model) -> tuple[str, ...]:
    """Log columns a model needs for fitting: references, state, channels."""
    return (*model.references, *model.state, *model.channels)


def _add(total: dict[int, list], run: int, error: np.ndarray) -> None:
    n = error.shape[1]
    squares = np.einsum("ij,ij->i", error, error)
    peak = np.maximum(error.max(axis=1), -error.min(axis=1)) if n else np.zeros(len(error))
    if run in total:
        entry = total[run]
        entry[0] += n
        entry[1] = entry[1] + squares
        entry[2] = np.maximum(entry[2], peak)
    else:
        total[run] = [n, squares, peak]


def _table(model: Model, total: dict[int, list]) -> ErrorTable:
    rows = list(total.values())
    return ErrorTable(
        model.pose,
        tuple(total),
        np.array([r[0] for r in rows], dtype=float),
        np.array([r[1] for r in rows]),
        np.array([r[2] for r in rows]),
    )
