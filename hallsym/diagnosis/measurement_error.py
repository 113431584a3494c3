"""What a candidate's columns and the residual have in common because both hold the noise of the references.

The columns of an effect are functions of the logged pose, and so is the residual. Noise of the pose moves
both, so their product has a mean that no effect made: a score that says so much of every log is no evidence.
It is measured: every reference is moved by its noise, with random signs from sample to sample, and derived
columns with it; the product of what that changes is expected to be the bias.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hallsym.diagnosis.derivatives import Slopes, reading_and_derivatives
from hallsym.diagnosis.residuals import Base
from hallsym.estimation.decoding import columns_of
from hallsym.log import Block
from hallsym.log.batches import Batch, batches, is_held
from hallsym.log.derived import extended
from hallsym.model import Model

SAMPLES = 8_000
"""Samples that are moved; of a longer log one of so many.

The bias is a few standard deviations of a score at most, and this many samples tell it to about 1 %."""


class _Moved:
    """A log with some columns moved by `sizes` times random signs."""

    def __init__(self, log: Any, sizes: Mapping[str, float]) -> None:
        self.log, self.sizes = log, sizes

    def __getattr__(self, name: str) -> Any:
        return getattr(self.log, name)

    @property
    def source(self) -> _Moved:
        return self

    def blocks(self, columns: Sequence[str] | None = None, size: int = 1 << 16) -> Iterator[Block]:
        rng, wanted = np.random.default_rng(0), self.log.columns if columns is None else columns
        known = (b for batch in batches(self.log, wanted) for b in batch.blocks)
        for block in known if is_held(self.log) else self.log.blocks(wanted, size):
            data = dict(block.data)
            for column, by in self.sizes.items():
                signs = rng.integers(0, 2, len(next(iter(data.values())))) * 2 - 1
                if column in data:
                    data[column] = data[column] + by * signs
            yield Block(block.run, data)


def shared_noise(
    base: Base, candidates: Mapping[str, tuple[Model, Sequence[str]]], length: int | None
) -> dict[tuple[int, int], np.ndarray]:
    """Return (run, stretch) -> what noise alone makes of the whitened products with the residual, (columns,).

    Columns are [parameters | candidates]. `length`: samples of a stretch, None for whole runs.
    """
    model = base.model
    columns = (*model.references, *model.state)
    sizes = {c: s for c in columns if c in base.log.columns and (s := base.sigma.get(c, 0.0)) > 0}
    slopes = Slopes(model, base.p, candidates)
    if not sizes or not slopes.columns:
        return {}
    wide = model
    for other, _ in candidates.values():
        wide = wide.with_columns(*other.computed)
    wanted = tuple(
        dict.fromkeys(c for m in (model, *(m for m, _ in candidates.values())) for c in columns_of(m))
    )
    read, precision = reading_and_derivatives(model), np.linalg.inv(base.covariance)
    n, K = len(base.free), len(model.channels)
    every = max(1, base.log.rows // SAMPLES)

    def batches_of(log: Any) -> Iterator[Batch]:
        return batches(extended(log, wide, base.sigma, base.values), wanted)

    def columns_at(
        batch: Batch, weights: np.ndarray | None
    ) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Own columns (n, K, samples), rows of the candidates, and the residual (K, samples)."""
        zeros = base.zeros_of(batch)
        pose, state = batch.columns(model.references), batch.columns(model.state)
        reading, slope, *_ = read(base.p, zeros, pose, state)
        own = slope.reshape(-1, K, len(batch))[list(base.free)]
        residual = np.array(batch.columns(model.channels)) - reading
        if weights is not None:
            own, residual = own * np.sqrt(weights), residual * np.sqrt(weights)
        return own, slopes.rows(batch, zeros, weights), residual

    sums: dict[tuple[int, int], np.ndarray] = {}
    seen: dict[int, int] = {}
    for down, up in zip(batches_of(base.log), batches_of(_Moved(base.log, sizes)), strict=True):
        weights = down.weights(base.keep)
        own, rows, residual = columns_at(_thinned(up, every), None if weights is None else weights[::every])
        own2, rows2, residual2 = columns_at(
            _thinned(down, every), None if weights is None else weights[::every]
        )
        change = precision @ (residual - residual2)
        products = np.zeros((n + slopes.columns, change.shape[1]))
        products[:n] = np.einsum("cks,ks->cs", own - own2, change)
        for k, column in enumerate(slopes.column):
            products[n + column] += (rows[k] - rows2[k]) * change[k]  # a column has one row a channel
        for block, part in up.parts():
            first = seen.get(block.run, 0)
            seen[block.run] = first + part.stop - part.start
            edges = _edges(first, seen[block.run], length)
            for low, high in pairwise(edges):
                key = block.run, 0 if length is None else low // length
                a, b = (-(-(part.start + k - first) // every) for k in (low, high))
                mean = products[:, a:b].mean(axis=1) if b > a else products.mean(axis=1)
                sums[key] = sums.get(key, 0.0) + (high - low) * mean
    return sums


def _thinned(batch: Batch, every: int) -> Batch:
    """Every so many samples of a batch."""
    data = {c: v[::every] for c, v in batch.data.items()}
    return Batch(batch.blocks, data, tuple(-(-edge // every) for edge in batch.edges))


def _edges(first: int, stop: int, length: int | None) -> list[int]:
    """Samples of a run between `first` and `stop` at which its stretches begin and end."""
    return [first, *(range(first - first % length + length, stop, length) if length else ()), stop]
