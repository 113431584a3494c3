"""Columns that no log holds but an effect needs: rates, time since the start, memory of the motion.

A model names them among its `state` and carries how to compute them; `extended(log, model)` is the log with
them. They are computed run by run from blocks that overlap at their edges, so memory does not grow with the
log. Rates come from local polynomials whose window is as wide as the motion allows: wide windows average the
noise of the reference, and a window is too wide once what it leaves is more than that noise.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.polynomial import legendre

from hallsym.log import Block, Log
from hallsym.medians import median

if TYPE_CHECKING:
    from hallsym.model import Model

ORDER = 5
"""Degree of the local polynomials."""
HALVES = (3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 34, 44, 58, 76, 100)
"""Half widths [samples] that are tried."""
HALO = 4 * HALVES[-1]
"""Samples of context on either side of a block."""
ROOM = 100_000_000
"""Bytes of computed columns that are kept for the next pass over the same log."""
WINDOWED = 20_000
"""Runs whose smoothing windows are kept for the next pass over the same log."""
_KEPT: WeakKeyDictionary[Log, dict[tuple, np.ndarray]] = WeakKeyDictionary()
_HALVES: WeakKeyDictionary[Log, dict[tuple, dict[str, int]]] = WeakKeyDictionary()
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Computed:
    """A column made from others: `rule(stretch) -> (samples,)`; `needs` are the logged columns it reads.

    `name` says all that the rule depends on: two columns of one name are one column.
    """

    name: str
    needs: tuple[str, ...]
    rule: Callable[[Stretch], np.ndarray]
    at: Callable[[Mapping[str, float]], Computed] | None = None
    """Of a column that depends on parameters (the width of a loop): the column at their values."""
    key: str = ""
    """Says what `name` does not, once it is taken at values."""


@dataclass(eq=False)
class Stretch:
    """Consecutive samples of one run with context: `data[column]`, and what holds for the whole run.

    `first_s`: time of the first sample of the run and `origin_s` of the log. `sigma`: noise by column.
    `halves`: smoothing windows chosen at the beginning of the run.
    """

    run: int
    data: dict[str, np.ndarray]
    first_s: float
    origin_s: float
    sigma: Mapping[str, float]
    halves: dict[str, int]
    _known: dict[Hashable, Any] = field(default_factory=dict)

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what `make` returns, computed once per stretch under `key`."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def rate(self, column: str, order: int = 1) -> np.ndarray:
        """Return the time derivative of a column (order 0: the column smoothed), unit per second^order."""
        return self.once((column, order), lambda: self._derivative(column, order))

    def _derivative(self, column: str, order: int) -> np.ndarray:
        values, t = self.data[column], self.data["t_s"]
        if len(values) < 2 * HALVES[0] + 1:
            return np.zeros(len(values)) if order else values
        step, even, grid = self.once("grid", lambda: _grid(t))
        x = values if even else np.interp(grid, t, values)
        if column not in self.halves:
            self.halves[column] = widest_half(x, self.sigma.get(column, 0.0))
        half = min(self.halves[column], (len(x) - 1) // 2)
        if 2 * half + 1 <= ORDER:
            return np.zeros(len(values)) if order else values
        smooth = _local(x, half, order) / step**order
        return smooth if even else np.interp(t, grid, smooth)


def _grid(t: np.ndarray) -> tuple[float, bool, np.ndarray]:
    """Step of the times, whether they have one, and times that do."""
    steps = np.diff(t)
    step = median(steps)
    even = bool(np.abs(steps - step).max() < 0.25 * step)
    return step, even, t if even else np.arange(t[0], t[-1] + 0.5 * step, step)


@lru_cache(maxsize=256)
def _windows(half: int, order: int) -> np.ndarray:
    """Weights of a window for derivative `order` at each of its places, (2 half + 1, 2 half + 1).

    Row j is the value at place j of the polynomial of degree ORDER that fits the window best.
    """
    x = np.arange(-half, half + 1) / half
    basis, _ = np.linalg.qr(legendre.legvander(x, ORDER))
    slopes = np.linalg.lstsq(legendre.legvander(x, ORDER), basis, rcond=None)[0]
    derived = legendre.legder(slopes, order, axis=0) if order else slopes
    return legendre.legval(x, derived).T @ basis.T / half**order


def _local(x: np.ndarray, half: int, order: int) -> np.ndarray:
    """Derivative per sample^order by local polynomials; near the ends by that of the last window."""
    weights = _windows(half, order)
    out = np.empty(len(x))
    out[half:-half] = np.convolve(x, weights[half][::-1], mode="valid")
    out[:half] = weights[:half] @ x[: 2 * half + 1]
    out[-half:] = weights[-half:] @ x[-2 * half - 1 :]
    return out


def widest_half(x: np.ndarray, sigma: float) -> int:
    """Return the half width of the widest window that leaves no more than noise of deviation sigma."""
    best, level = HALVES[0], sigma**2
    for half in HALVES:
        if 2 * half + 1 > len(x):
            break
        keep = 1.0 - float(_windows(half, 0)[half, half])
        left = x - _local(x, half, 0)
        inside = left[half:-half] if len(x) > 4 * half else left
        power = float(np.mean(inside**2)) / keep
        if half == HALVES[0]:
            level = max(level, power)
        if power > level * (1.0 + 3.0 * np.sqrt(2.0 / len(inside))):
            break
        best = half
    return best


class ExtendedLog:
    """A log that also serves computed columns; everything else is the log's own."""

    def __init__(self, log: Log, computed: Sequence[Computed], sigma: Mapping[str, float]) -> None:
        """Serve `computed` beside the columns of `log`; `sigma`: noise by column."""
        self.log, self.sigma = log, dict(sigma)
        self.computed = {c.name: c for c in computed}
        self._origin: float | None = None

    def __getattr__(self, name: str) -> Any:
        """Everything that is not about columns comes from the log itself."""
        return getattr(self.log, name)

    @property
    def columns(self) -> tuple[str, ...]:
        """Logged and computed columns."""
        return (*self.log.columns, *self.computed)

    def blocks(self, columns: Sequence[str] | None = None, size: int = 1 << 16) -> Iterator[Block]:
        """Yield consecutive blocks of one run each, of at most `size` samples, with `columns` (or all)."""
        wanted = self.columns if columns is None else tuple(columns)
        made = [self.computed[c] for c in wanted if c in self.computed]
        if not made:
            yield from self.log.blocks(wanted, size)
            return
        raw = dict.fromkeys(c for c in wanted if c not in self.computed)
        raw |= dict.fromkeys(c for m in made for c in m.needs) | {"t_s": None}
        kept = _KEPT.setdefault(self.log, {})
        for stretch, inner in self._stretches(tuple(raw), size):
            data = {c: stretch.data[c][inner] for c in wanted if c not in self.computed}
            at = (stretch.run, float(stretch.data["t_s"][inner.start]), inner.stop - inner.start)
            yield Block(stretch.run, data | {m.name: _column(kept, m, stretch, inner, at) for m in made})

    def _stretches(self, columns: tuple[str, ...], size: int) -> Iterator[tuple[Stretch, slice]]:
        """Yield blocks with up to HALO samples of context on either side, and where the block itself lies."""
        held: _Held | None = None
        windows = _HALVES.setdefault(self.log, {})
        sigma = tuple(sorted(self.sigma.items()))
        for block in self.log.blocks(columns, size):
            if self._origin is None:
                self._origin = float(block.data["t_s"][0])
            if held is not None and held.run != block.run:
                yield from held.pieces(size, last=True)
                held = None
            if held is None:
                held = _Held(block.run, block.data, self._origin, self.sigma)
                if len(windows) < WINDOWED:  # chosen once, on the same stretch: the first of this size
                    held.halves = windows.setdefault((block.run, held.first, size, sigma), held.halves)
            else:
                held.add(block.data)
            yield from held.pieces(size, last=False)
        if held is not None:
            yield from held.pieces(size, last=True)


def _column(
    kept: dict[tuple, np.ndarray], made: Computed, stretch: Stretch, inner: slice, at: tuple
) -> np.ndarray:
    """Return a computed column of the block `at` run, time and length, kept while there is room."""
    key = (made.name, made.key, *at)
    if key not in kept:
        values = _finite(made.rule(stretch))[inner]
        if len(kept) * values.nbytes > ROOM:
            return values
        kept[key] = values.copy()
    return kept[key]


class _Held:
    """Samples of one run that wait for their context."""

    def __init__(self, run: int, data: dict[str, np.ndarray], origin: float, sigma: Mapping[str, float]):
        self.run, self.data, self.origin, self.sigma = run, data, origin, sigma
        self.first, self.done = float(data["t_s"][0]), 0
        self.halves: dict[str, int] = {}

    def add(self, data: dict[str, np.ndarray]) -> None:
        self.data = {c: np.concatenate([v, data[c]]) for c, v in self.data.items()}

    def pieces(self, size: int, last: bool) -> Iterator[tuple[Stretch, slice]]:
        while True:
            total = len(self.data["t_s"])
            ready = total - self.done - (0 if last else HALO)
            if ready <= 0 or (ready < size and not last):
                return
            stop = self.done + min(ready, size)
            end = min(total, stop + HALO)
            data = {c: v[:end] for c, v in self.data.items()}
            stretch = Stretch(self.run, data, self.first, self.origin, self.sigma, self.halves)
            yield stretch, slice(self.done, stop)
            cut = max(0, stop - HALO)
            self.data = {c: v[cut:] for c, v in self.data.items()}
            self.done = stop - cut


def extended(
    log: Log,
    model: Model,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> Any:
    """Return the log with the computed columns of `model`; the log itself if there are none.

    `sigma`: noise by column, the log's own where not given. `values`: parameters by name, for columns that
    depend on some (nominal where not given).
    """
    if not model.computed:
        return log
    known = {c: s.value for c, s in log.noise.sigmas.items()} | dict(sigma or {})
    return ExtendedLog(log, [c.at(values) if c.at and values else c for c in model.computed], known)


def _finite(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    return values if np.isfinite(values).all() else np.nan_to_num(values, posinf=0.0, neginf=0.0)


# -- columns that several effects share --------------------------------------------------------------------


def rate(column: str, order: int = 1) -> Computed:
    """Return d^order column / dt^order; named `d1_x_ref_m`, for example."""
    return Computed(f"d{order}_{column}", (column,), lambda s: s.rate(column, order))


def campaign_time() -> Computed:
    """Return seconds since the first sample of the log."""
    return Computed("campaign_s", (), lambda s: s.data["t_s"] - s.origin_s)


def run_time(power: int = 1) -> Computed:
    """Return seconds since the first sample of the run, to a power."""
    name = "run_s" if power == 1 else f"run_s{power}"
    return Computed(name, (), lambda s: (s.data["t_s"] - s.first_s) ** power)
