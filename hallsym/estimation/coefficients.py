"""The coefficients of a model's features as functions of its parameters, with their derivatives."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.model.arrays import on_arrays
from hallsym.model.features import Features


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
        value, slope = (np.asarray(v) for v in self.features.expansion[0](p, self.centre))
        return (
            np.ascontiguousarray(np.swapaxes(value.T.reshape(shape), 1, 2)),
            np.ascontiguousarray(np.transpose(slope.reshape(*shape, -1), (0, 2, 3, 1))),
        )

    def curvature(self, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return sum of weights * d2 coefficient / dp2, shape (n, n), weights shaped as coefficients."""
        flat = np.swapaxes(weights, 1, 2).ravel()
        return np.asarray(self.features.expansion[1](p, self.centre, flat))
