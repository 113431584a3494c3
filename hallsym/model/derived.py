"""Derived columns: quantities that effects need and logs lack, such as rates, time and memory of the motion.

A model names them among its `state` and carries how to compute them; `hallsym.log.derived` serves them beside
the logged columns. Rates come from local polynomials whose window is as wide as the motion allows: wide
windows average the noise of the reference; a window is too wide once its residual exceeds that noise.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.polynomial import legendre

from hallsym.model.arrays import median

ORDER = 5
"""Degree of the local polynomials; near the ends of a run no higher one is used."""
HALVES = (3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 34, 44, 58, 76, 100)
"""Half widths [samples] of windows of that degree."""
WINDOWS = ((11, 6), (11, 8), *((ORDER, half) for half in HALVES))
"""Degrees and half widths that are tried in this order, the fastest motion first.

At six samples a period the first one's slope is .01 % too small, at the cost of noise like that of the
narrowest one of degree 5, whose slope is .7 % too small there and whose curvature is 9 %: rates would be too
small, and a lag, which is a share of the rate, too large."""
CERTAIN = 4.5
"""Standard deviations by which the residual of a window exceeds noise before the window is too wide.

Noise alone does so in 3 of a million windows. A log of 57 runs tries a thousand, and one run with a window
that is too narrow by chance has a fourth derivative of noise, by which a lag and a delay look separable."""
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
    """For a column that depends on parameters (the width of a loop): the column at given values."""
    key: str = ""
    """Distinguishes columns of one `name` that are evaluated at different values."""


@dataclass(eq=False)
class Stretch:
    """Consecutive samples of one run: `data[column]`, and properties of the whole run.

    `first_s`: time of the first sample of the run and `origin_s` of the log. `sigma`: noise by column.
    `windows`: of smoothing, chosen at the beginning of the run. `parts`: of several whole runs, one after
    the other, the stretch of each; `run` and `first_s` are then those of every sample, (samples,).
    """

    run: int | np.ndarray
    data: dict[str, np.ndarray]
    first_s: float | np.ndarray
    origin_s: float
    sigma: Mapping[str, float]
    windows: dict[str, tuple[int, int]]
    parts: Sequence[Stretch] = ()
    _known: dict[Hashable, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, parts: Sequence[Stretch]) -> Stretch:
        """Return several whole runs as one stretch."""
        first = parts[0]
        lengths = [len(part.data["t_s"]) for part in parts]
        run = np.repeat([part.run for part in parts], lengths)
        first_s = np.repeat([part.first_s for part in parts], lengths)
        data = {c: np.concatenate([part.data[c] for part in parts]) for c in first.data}
        return cls(run, data, first_s, first.origin_s, first.sigma, {}, parts)

    @property
    def edges(self) -> list[int]:
        """First sample of each run and the end of the last run, (runs + 1,)."""
        return np.cumsum([0, *(len(part.data["t_s"]) for part in self.parts or (self,))]).tolist()

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what `make` returns, computed once per stretch under `key`."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def rate(self, column: str, order: int = 1) -> np.ndarray:
        """Return the time derivative of a column (order 0: the column smoothed), unit per second^order."""
        if self.parts:
            return self.once(
                (column, order), lambda: np.concatenate([part.rate(column, order) for part in self.parts])
            )
        return self.once((column, order), lambda: self._derivative(column, order))

    def _derivative(self, column: str, order: int) -> np.ndarray:
        values, t = self.data[column], self.data["t_s"]
        if len(values) < 2 * HALVES[0] + 1:
            return np.zeros(len(values)) if order else values
        step, even, grid = self.once("grid", lambda: _grid(t))
        x = values if even else np.interp(grid, t, values)
        if column not in self.windows:
            self.windows[column] = widest_window(x, self.sigma.get(column, 0.0))
        degree, half = self.windows[column]
        longest = (len(x) - 1) // 2
        if longest < HALVES[0]:
            return np.zeros(len(values)) if order else values
        window = (degree if half <= longest else ORDER, min(half, longest))
        smooth = _local(x, window, order) / step**order
        return smooth if even else np.interp(t, grid, smooth)


def _grid(t: np.ndarray) -> tuple[float, bool, np.ndarray]:
    """Time step, whether it is uniform, and times made uniform."""
    steps = np.diff(t)
    step = median(steps)
    even = bool(np.abs(steps - step).max() < 0.25 * step)
    return step, even, t if even else np.arange(t[0], t[-1] + 0.5 * step, step)


@lru_cache(maxsize=256)
def _weights(degree: int, half: int, order: int) -> np.ndarray:
    """Weights of a window for derivative `order` at each of its places, (2 half + 1, 2 half + 1).

    Row j is the value at place j of the polynomial that fits the window best.
    """
    x = np.arange(-half, half + 1) / half
    basis, _ = np.linalg.qr(legendre.legvander(x, degree))
    slopes = np.linalg.lstsq(legendre.legvander(x, degree), basis, rcond=None)[0]
    derived = legendre.legder(slopes, order, axis=0) if order else slopes
    return legendre.legval(x, derived).T @ basis.T / half**order


def _local(x: np.ndarray, window: tuple[int, int], order: int) -> np.ndarray:
    """Derivative per sample^order by local polynomials; near the ends by that of the last window."""
    (degree, half), weights = window, _weights(*window, order)
    if degree > ORDER:
        out = _local(x, (ORDER, HALVES[0]), order)
    else:
        out = np.empty(len(x))
        out[:half] = weights[:half] @ x[: 2 * half + 1]
        out[-half:] = weights[-half:] @ x[-2 * half - 1 :]
    out[half:-half] = np.convolve(x, weights[half][::-1], mode="valid")
    return out


def widest_window(x: np.ndarray, sigma: float) -> tuple[int, int]:
    """Return the last of `WINDOWS` whose residual, like that of all before, is no larger than noise.

    Of std sigma, or as large as the first one leaves.
    """
    best, level = WINDOWS[len(WINDOWS) - len(HALVES)], None
    for degree, half in WINDOWS:
        if 2 * half + 1 > len(x):
            continue
        keep = 1.0 - float(_weights(degree, half, 0)[half, half])
        left = x - _local(x, (degree, half), 0)
        inside = left[half:-half] if len(x) > 4 * half else left
        power = float(np.mean(inside**2)) / keep
        level = max(sigma**2, power) if level is None else level
        if power > level * (1.0 + CERTAIN * np.sqrt(2.0 / len(inside))):
            break
        best = degree, half
    return best


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
