"""Errors in variables: the bias of a score because columns and residual both contain the references' noise.

The columns of an effect are functions of the logged pose, and so is the residual. Noise of the pose moves
both, so their product has a non-zero mean without any effect. The bias is simulated: every reference is moved
by noise of its size with the autocorrelation of the residual, and derived columns with it; the product of the
changes estimates the bias. Autocorrelation matters to derived columns only, such as an acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.diagnosis.normal_equations import Columns, NormalEquations, stretches
from hallsym.diagnosis.residuals import Base
from hallsym.estimation.goodness_of_fit import ROOM
from hallsym.log import Block
from hallsym.log.batches import Batch, batches, is_cached
from hallsym.log.derived import share_windows
from hallsym.log.part import Window
from hallsym.model import Model

WHITE = np.array([1.0, 0.0])
"""Autocorrelation of white noise."""


class _Moved:
    """A log with noise of standard deviation `sizes` and an autocorrelation added to some columns.

    Its last half is tapered (the flat-top window of Politis and Romano 1995), so that a resonance keeps its
    width, on which a computed acceleration depends.
    """

    def __init__(self, log: Any, sizes: Mapping[str, float], autocorrelation: np.ndarray) -> None:
        self.log, self.sizes, n = log, sizes, len(autocorrelation)
        tapered = autocorrelation * np.minimum(1.0, 2 * (1 - np.arange(n) / n))
        spectrum = np.maximum(np.fft.rfft(np.append(tapered, tapered[:0:-1])).real, 0.0)
        weights = np.fft.fftshift(np.fft.irfft(np.sqrt(spectrum), 2 * n - 1))
        self.weights = weights / np.sqrt((weights**2).sum())

    def __getattr__(self, name: str) -> Any:
        return getattr(self.log, name)

    @property
    def source(self) -> _Moved:
        return self

    @property
    def windows(self) -> tuple[Window, ...]:
        rng, known = np.random.default_rng(0), getattr(self.log, "windows", ())
        return tuple(replace(w, data=self._moved(w.data, rng)) for w in known)

    def blocks(self, columns: Sequence[str] | None = None, size: int = 1 << 16) -> Iterator[Block]:
        rng, wanted = np.random.default_rng(0), self.log.columns if columns is None else columns
        if windows := self.windows:
            yield from (window.block(wanted) for window in windows)
            return
        known = (b for batch in batches(self.log, wanted) for b in batch.blocks)
        for block in known if is_cached(self.log) else self.log.blocks(wanted, size):
            yield Block(block.run, self._moved(block.data, rng))

    def _moved(self, data: Mapping[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        out = dict(data)
        n = len(next(iter(out.values()))) + len(self.weights) - 1
        for column, by in self.sizes.items():
            signs = rng.integers(0, 2, n) * 2.0 - 1.0
            if column in out:
                out[column] = out[column] + by * np.convolve(signs, self.weights, "valid")
        return out


def shared_noise(
    base: Base,
    candidates: Mapping[str, tuple[Model, Sequence[str]]],
    t: NormalEquations,
    length: int | None,
    autocorrelation: np.ndarray = WHITE,
) -> np.ndarray:
    """Return the whitened products with the residual that noise alone makes, (units of `t`, columns).

    Columns are [parameters | candidates]. `length`: samples of a stretch, None for whole runs.
    `autocorrelation`: of the residual at lags 0, 1, ... Nothing where no reference has noise.
    """
    work = Columns(base, candidates, t.graph)
    out = np.zeros((len(t.runs), work.n + work.count))
    logged = (c for c in (*base.model.references, *base.model.state) if c in base.log.columns)
    sizes = {c: s for c in logged if (s := base.sigma.get(c, 0.0)) > 0}
    if not sizes or not work.count:
        return out
    log: Any = _Moved(base.log, sizes, autocorrelation)
    share_windows(base.log, log)
    every = max(1, base.log.rows // ROOM)
    seen: dict[int, int] = {}
    for down, up in zip(work.batches(base.log), work.batches(log), strict=True):
        weights = down.weights(base.keep)
        part = None if weights is None else weights[::every]
        thinned = [_thinned(b, every) for b in (up, down)]
        cut, keys = stretches(up, seen, length)
        edges = -(-np.array(cut.edges) // every)
        low, high = (np.minimum(at, len(thinned[0]) - k) for at, k in ((edges[:-1], 1), (edges[1:], 0)))
        scales = np.diff(cut.edges) / np.maximum(high - low, 1)
        most = -(-work.most // 2)  # both logs are side by side in one batch
        for (moved, at), (still, _) in zip(*(b.pieces(most) for b in thinned), strict=True):
            n, data = len(moved), {c: np.append(v, still.data[c]) for c, v in moved.data.items()}
            both = Batch(moved.runs * 2, data, (*moved.edges, *(n + edge for edge in still.edges[1:])))
            rows = work.rows(both, None if part is None else np.tile(part[at], 2))
            rows = rows[:, :n] - rows[:, n:]
            products, change = np.zeros((work.size, n)), work.precision @ rows[work.residual]
            for k, of in enumerate(work.of_channel):  # a column has one row a channel
                products[work.column[of]] += rows[work.row[of]] * change[k]
            here = np.maximum([low - at.start, np.maximum(high, low + 1) - at.start], 0)
            for key, begin, end, scale in zip(keys, *here, scales, strict=True):
                out[t.unit_of[key]] += scale * products[work.z : -1, begin:end].sum(axis=1)
    return out


def _thinned(batch: Batch, every: int) -> Batch:
    """Every so many samples of a batch."""
    data = {c: v[::every] for c, v in batch.data.items()}
    return Batch(batch.runs, data, tuple(-(-edge // every) for edge in batch.edges))
