"""Decoded errors of two versions of a model on the same samples, block by block, and what differs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.arrays import on_arrays
from hallsym.batches import Weigh, batches
from hallsym.computed import extended
from hallsym.decoding import columns_of, decoder
from hallsym.diagnosis.tangent import Base, decoding_gain
from hallsym.log import Block
from hallsym.turning import wrapped

BLOCKS = 400
RESAMPLED = 1000


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """Decoded errors by block of samples: `count` (b,), sums of `squares` (b, pose), `peak` (pose,)."""

    pose: tuple[str, ...]
    length_m: float
    count: np.ndarray
    squares: np.ndarray
    peak: np.ndarray

    def gap(self) -> dict[str, dict[str, float]]:
        """Return rmse and peak per pose coordinate."""
        rmse = np.sqrt(self.squares.sum(axis=0) / max(self.count.sum(), 1.0))
        return {
            "rmse": dict(zip(self.pose, rmse.tolist(), strict=True)),
            "peak": dict(zip(self.pose, self.peak.tolist(), strict=True)),
        }

    @property
    def sums(self) -> np.ndarray:
        """Squares of each block with rotation as length."""
        scale = np.array([self.length_m if c.startswith("r") else 1.0 for c in self.pose])
        return self.squares @ scale**2

    @property
    def metric(self) -> float:
        """The gap metric: root of the summed mean squares, rotation as length [m]."""
        return float(np.sqrt(self.sums.sum() / max(self.count.sum(), 1.0)))


Decode = Callable[[Block], np.ndarray]


def _decoded(base: Base) -> Decode:
    """Errors of the decoded pose."""
    model, decode = base.model, decoder(base.model, np.diag(base.covariance))
    none = np.zeros(len(model.zeros))

    def error(block: Block) -> np.ndarray:
        readings, states = ([block.data[c] for c in names] for names in (model.channels, model.state))
        error = decode(base.p, base.zeros.get(block.run, none), readings, states)
        error = error - np.array([block.data[c] for c in model.references])
        for k, c in enumerate(model.references):
            if c in model.period:
                error[k] = wrapped(error[k], model.period[c])
        return error

    return error


def _predicted(base: Base) -> Decode:
    """What the residual of the readings moves the pose by: for readings that no pose can be decoded from."""
    model = base.model
    read, spread, none = on_arrays(model.reading), decoding_gain(model), np.zeros(len(model.zeros))

    def error(block: Block) -> np.ndarray:
        pose, states = ([block.data[c] for c in names] for names in (model.references, model.state))
        residual = np.array([block.data[c] for c in model.channels])
        residual = residual - read(base.p, base.zeros.get(block.run, none), pose, states)[0]
        (gain,) = spread(base.p, pose, states, base.weight)
        return np.einsum("kis,ks->is", gain.reshape(len(residual), len(model.pose), -1), residual)

    return error


def block_errors(base: Base, runs: Sequence[int], rows: int, keep: Weigh | None) -> BlockErrors:
    """Decode some runs and return their errors; `rows` of the log sets the size of a block.

    A reading at its rail has lost its pose: with saturation the errors are those of the readings, mapped.
    """
    model, wanted = base.model, set(runs)
    size = max(50, rows // BLOCKS)
    errors_of = _predicted(base) if "saturation" in model.effects else _decoded(base)
    count, squares, peak = [], [], np.zeros(len(model.pose))
    for batch in batches(extended(base.log, model, base.sigma), columns_of(model)):
        weights = batch.weights(keep)
        for block, at in batch.parts():
            if block.run not in wanted:
                continue
            error = errors_of(block)
            if weights is not None:
                error = error[:, weights[at] > 0]
            for low in range(0, error.shape[1], size):
                part = error[:, low : low + size]
                count.append(part.shape[1])
                squares.append((part**2).sum(axis=1))
                peak = np.maximum(peak, np.abs(part).max(axis=1, initial=0.0))
    return BlockErrors(
        model.pose,
        base.length_m,
        np.array(count, float),
        np.array(squares).reshape(-1, len(model.pose)),
        peak,
    )


def interval(before: BlockErrors, after: BlockErrors, seed: int = 0) -> tuple[float, float]:
    """95 % interval of 1 - after / before, from resampled blocks."""
    rng = np.random.default_rng(seed)
    a, b = before.sums, after.sums
    if len(a) != len(b):
        value = 1 - after.metric / before.metric
        return value, value
    pick = rng.integers(0, len(a), (RESAMPLED, len(a)))
    ratio = np.sqrt(b[pick].sum(axis=1) / np.maximum(a[pick].sum(axis=1), 1e-300))
    low, high = np.quantile(1 - ratio, [0.025, 0.975])
    return float(low), float(high)
