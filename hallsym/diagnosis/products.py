"""Products of columns, run by run: what `normal_equations` reads off a log and all regressions rest on."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Products(NamedTuple):
    """Products of columns: `border` (..., rows, c) of the model's own ones and the residual with all columns,
    `inner` (..., e) of each candidate's with each other, matrix by matrix.

    Products between two candidates are nobody's business. The residual is the last row and column.
    """

    border: np.ndarray
    inner: np.ndarray

    def plus(self, other: "Products") -> "Products":
        """Return the sum."""
        return Products(self.border + other.border, self.inner + other.inner)

    def block(self, k: int) -> "Products":
        """Return the products of block k."""
        return Products(self.border[k], self.inner[k])

    def of(self, span: slice, place: slice) -> np.ndarray:
        """Return the products (..., p, p) of own columns, those of one candidate, and the residual.

        `span`: its columns, `place`: its products; both may be empty.
        """
        n, k = self.border.shape[-2] - 1, span.stop - span.start
        out = np.empty((*self.border.shape[:-2], n + k + 1, n + k + 1))
        own, here = np.array([*range(n), n + k]), slice(n, n + k)
        out[..., own[:, None], own] = self.border[..., [*range(n), -1]]
        out[..., own, here] = self.border[..., span]
        out[..., here, own] = self.border[..., span].swapaxes(-1, -2)
        out[..., here, here] = self.inner[..., place].reshape(*self.inner.shape[:-1], k, k)
        return out


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of the columns [parameters | effects | residual], the zeros of each run eliminated.

    `whitened`, `decoded`: of each unit, weighted by the noise and mapped to the pose. `count`: (units,)
    samples. `runs`: the runs of each unit. `span`: columns of each candidate, by its key; the base's
    parameters are under "". `places`: of its products in `Products.inner`.
    """

    whitened: Products
    decoded: Products
    count: np.ndarray
    runs: tuple[tuple[int, ...], ...]
    span: dict[str, slice]
    places: dict[str, slice]
    follow: np.ndarray
    """(runs, zeros, c): how the zeros of a run follow the other columns; none with candidates."""
    order: tuple[int, ...]
    """The runs of `follow`."""
    spoiled: frozenset[str] = frozenset()
    """Candidates whose slope is not finite somewhere; their columns are 0."""
    offsets: np.ndarray | None = None
    """(units, zeros, c): products with the run's own zeros, in units in which these are orthonormal.

    Over a whole run they add up to 0. None where every unit is a whole run."""

    @property
    def likelihood(self) -> np.ndarray:
        """Products (units, p, p) of the model's own columns and the residual, weighted by the noise."""
        return self.of(None) if self.places else self.whitened.border

    @property
    def output(self) -> np.ndarray:
        """The same mapped to the pose."""
        return self.of(None, decoded=True) if self.places else self.decoded.border

    def of(self, key: str | None, *, decoded: bool = False) -> np.ndarray:
        """Return products (units, p, p) of the model's columns, those of a candidate, and the residual."""
        none = slice(0, 0)
        span, place = (self.span[key], self.places[key]) if key else (none, none)
        return (self.decoded if decoded else self.whitened).of(span, place)

    def units(self, runs: Iterable[int]) -> np.ndarray:
        """Return the index of the units whose runs are all among `runs`."""
        known = set(runs)
        return np.array([k for k, unit in enumerate(self.runs) if known.issuperset(unit)], dtype=int)
