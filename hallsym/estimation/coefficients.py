"""The coefficients of a model's features as functions of its parameters, with their derivatives."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import casadi as ca
import numpy as np

from hallsym.model.arrays import on_arrays
from hallsym.model.features import Features

SPARSE = 4
"""Features per channel, over those that move the channel, from which on only these are multiplied."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Slopes (1 + n_zeros, m, n) of the coefficients of m pairs of a `channel` and a `feature`, (m,) each."""

    channel: np.ndarray
    feature: np.ndarray
    slope: np.ndarray


@runtime_checkable
class Linear(Protocol):
    """Features whose coefficients are linear in the parameters: most are nil, and none is written out."""

    def linear(self, p: np.ndarray) -> tuple[np.ndarray, Rows]:
        """Return the coefficients (1 + n_zeros, n_features, n_channels) and the slopes that are not nil."""
        ...


@dataclass(frozen=True, eq=False)
class Coefficients:
    """c(p) and E_l(p) of a model with their derivatives, as one CasADi call each.

    Arrays have the axes (1 + n_zeros, n_features, n_channels), c first, then one E_l per zero.
    """

    features: Features
    centre: np.ndarray

    @property
    def n_zeros(self) -> int:
        """Zeros of a run that these features carry: all of the model's, or none once projected out."""
        return self.features.n_zeros

    @cached_property
    def population(self) -> Callable[[np.ndarray], np.ndarray]:
        """`(m, n) parameter vectors -> (m, n_features, n_channels)` coefficients c at zero deviation."""
        model = self.features.model
        c = self.features.coefficients(model.symbols.parameters, ca.SX.zeros(len(model.zeros)), self.centre)
        run = on_arrays(ca.Function("population", [model.symbols.parameters], [ca.densify(c)]))
        shape = (len(model.channels), self.features.size)

        def coefficients(points: np.ndarray) -> np.ndarray:
            (flat,) = run(np.ascontiguousarray(points.T))
            return np.transpose(flat.reshape(*shape, len(points)), (2, 1, 0))

        return coefficients

    def first(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients and their slopes, the latter (1 + n_zeros, n_features, n, n_channels)."""
        model = self.features.model
        shape = (1 + self.n_zeros, len(model.channels), self.features.size)
        value, slope = self.features.expansion[0](p, self.centre)
        return (
            np.ascontiguousarray(np.swapaxes(value.T.reshape(shape), 1, 2)),
            np.ascontiguousarray(np.transpose(slope.reshape(*shape, -1), (0, 2, 3, 1))),
        )

    def slopes(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, Rows | None]:
        """Return the coefficients, their slopes and where these are.

        Where most features move a channel the slopes are as `first` gives them, and stand at None. Else they
        are those that are not nil, (1 + n_zeros, m, n), of m pairs of a channel and a feature.
        """
        if isinstance(self.features, Linear):
            c, rows = self.features.linear(p)
            if SPARSE * len(rows.channel) >= c[0].size:
                dense = np.zeros((*c.shape[:2], len(p), c.shape[2]))
                dense[:, rows.feature, :, rows.channel] = np.swapaxes(rows.slope, 0, 1)
                return c, dense, None
            return c, rows.slope, rows
        c, dense = self.first(p)
        moved = np.any(c[1:] != 0, axis=0).T | np.any(dense != 0, axis=(0, 2)).T
        k, at = np.nonzero(moved)
        if SPARSE * len(k) >= moved.size:
            return c, dense, None
        slope = np.swapaxes(dense[:, at, :, k], 0, 1)
        return c, slope, Rows(k, at, slope)

    def curvature(self, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return sum of weights * d2 coefficient / dp2, shape (n, n), weights shaped as coefficients."""
        flat = np.swapaxes(weights, 1, 2).ravel()
        return self.features.expansion[1](p, self.centre, flat)
