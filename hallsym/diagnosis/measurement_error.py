"""What a candidate's columns and the residual have in common because both hold the noise of the references.

The columns of an effect are functions of the logged pose, and so is the residual. Noise of the pose moves
both, so their product has a mean that no effect made: a score that says so much of every log is no evidence.
It is measured: every reference is moved by noise of its size and of the residual's colour, and derived
columns with it; the product of what that changes is expected to be the bias. Colour matters to derived
columns only: an acceleration goes with coloured noise otherwise than with white noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.diagnosis.normal_equations import Accumulator, Slopes
from hallsym.diagnosis.residuals import Base
from hallsym.estimation.residual_noise import ROOM
from hallsym.log import Block
from hallsym.log.batches import Batch, batches, is_held
from hallsym.log.derived import share_windows
from hallsym.model import Model

WHITE = np.array([1.0, 0.0])
"""Autocorrelation of white noise."""


class _Moved:
    """A log with some columns moved by noise of standard deviation `sizes`; `colour`: autocorrelation.

    Its last half is tapered (the flat-top window of Politis and Romano 1995), so that a resonance keeps its
    width: what a computed acceleration has of it depends on how sharp it is.
    """

    def __init__(self, log: Any, sizes: Mapping[str, float], colour: np.ndarray) -> None:
        self.log, self.sizes, n = log, sizes, len(colour)
        tapered = colour * np.minimum(1.0, 2 * (1 - np.arange(n) / n))
        spectrum = np.maximum(np.fft.rfft(np.append(tapered, tapered[:0:-1])).real, 0.0)
        weights = np.fft.fftshift(np.fft.irfft(np.sqrt(spectrum), 2 * n - 1))
        self.weights = weights / np.sqrt((weights**2).sum())

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
            n = len(next(iter(data.values()))) + len(self.weights) - 1
            for column, by in self.sizes.items():
                signs = rng.integers(0, 2, n) * 2.0 - 1.0
                if column in data:
                    data[column] = data[column] + by * np.convolve(signs, self.weights, "valid")
            yield Block(block.run, data)


def with_noise(base: Base, colour: np.ndarray = WHITE) -> Base | None:
    """Return `base` with its references moved by noise of their size; None where they have none.

    `colour`: autocorrelation of the noise at lags 0, 1, ...
    """
    model = base.model
    columns = (*model.references, *model.state)
    sizes = {c: s for c in columns if c in base.log.columns and (s := base.sigma.get(c, 0.0)) > 0}
    if not sizes:
        return None
    log = _Moved(base.log, sizes, colour)
    share_windows(base.log, log)  # type: ignore[arg-type]
    return replace(base, log=log)  # type: ignore[arg-type]


def shared_noise(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]],
    length: int | None,
    colour: np.ndarray = WHITE,
    slopes: Slopes | None = None,
) -> dict[tuple[int, int], np.ndarray]:
    """Return (run, stretch) -> what noise alone makes of the whitened products with the residual, (columns,).

    Columns are [parameters | candidates]. `length`: samples of a stretch, None for whole runs.
    `colour`: autocorrelation of the residual at lags 0, 1, ... `slopes`: of the candidates, where known.
    """
    noisy = with_noise(base, colour)
    work = Accumulator(base, candidates, decoded=False, slopes=slopes)
    own, column = work.z + work.n, work.slopes.column
    if noisy is None or not work.slopes.columns:
        return {}
    every = max(1, base.log.rows // ROOM)
    sums: dict[tuple[int, int], np.ndarray] = {}
    seen: dict[int, int] = {}
    for down, up in zip(work.batches(base.log), work.batches(noisy.log), strict=True):
        weights = down.weights(base.keep)
        part = None if weights is None else weights[::every]
        thinned = [_thinned(b, every) for b in (up, down)]
        products = np.zeros((work.n + work.slopes.columns, len(thinned[0])))
        for (moved, at), (still, _) in zip(*(b.pieces(work.most) for b in thinned), strict=True):
            own_part = None if part is None else part[at]
            (near, rows), (near2, rows2) = (work.columns(piece, own_part) for piece in (moved, still))
            change = work.precision @ (near[-1] - near2[-1])
            products[: work.n, at] = np.einsum("cks,ks->cs", near[work.z : own] - near2[work.z : own], change)
            for k, of in enumerate(work.slopes.of_channel):  # a column has one row a channel
                products[work.n + column[of], at] += (rows[of] - rows2[of]) * change[k]
        keys, first, counts = _stretches(up, seen, length)
        low = np.minimum(-(-np.array(first) // every), products.shape[1] - 1)
        high = np.minimum(-(-(np.array(first) + counts) // every), products.shape[1])
        parts = np.add.reduceat(products, low, axis=1) * (np.array(counts) / np.maximum(high - low, 1))
        for key, own_part in zip(keys, parts.T, strict=True):
            sums[key] = sums.get(key, 0.0) + own_part
    return sums


def _thinned(batch: Batch, every: int) -> Batch:
    """Every so many samples of a batch."""
    data = {c: v[::every] for c, v in batch.data.items()}
    return Batch(batch.blocks, data, tuple(-(-edge // every) for edge in batch.edges))


def _stretches(
    batch: Batch, seen: dict[int, int], length: int | None
) -> tuple[list[tuple[int, int]], list[int], list[int]]:
    """Return (run, stretch), first sample and number of samples of each stretch of a batch.

    `seen`: samples of each run before the batch; it is brought up to date.
    """
    whole = batch if length is None else batch.cut(length, seen.get(batch.blocks[0].run, 0))
    keys, first, counts = list[tuple[int, int]](), list[int](), list[int]()
    for block, part in whole.parts():
        done = seen.get(block.run, 0)
        keys.append((block.run, done // length if length else 0))
        first.append(part.start)
        counts.append(part.stop - part.start)
        seen[block.run] = done + counts[-1]
    return keys, first, counts
