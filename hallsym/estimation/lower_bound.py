"""The cost that no parameters can undercut: that of the linear fit whose coefficients are all free.

A model's readings are linear in its features, and its parameters only choose the coefficients: by formulas,
tied to each other, inside bounds. Free coefficients leave less, whatever the formulas and bounds are. So
the cost at the optimum over this bound says how much formulas and bounds cost; near 1 no other start can be
better, which is evidence where agreement among starts is none.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.estimation.goodness_of_fit import UNSTRUCTURED
from hallsym.estimation.likelihood import Point
from hallsym.estimation.normal_equations import pseudo_inverse, unit_scale

COLLINEAR = 1e-8
"""Eigenvalue, over the largest, below which features repeat each other: to four digits, beyond which the sum
of squares that they explain is rounding."""


@dataclass(frozen=True)
class LowerBound:
    """Cost of the unconstrained linear fit, at the weights that residuals have at the optimum.

    `ratio`: cost at the optimum over `cost`, 1 or more. `expected`: the ratio that follows from the number of
    `coefficients` alone, where the formulas of the model hold and no bound is in the way.
    """

    cost: float
    ratio: float
    expected: float
    coefficients: int

    @property
    def near(self) -> bool:
        """Whether the optimum costs no more, beyond the expected, than what is worth reporting."""
        return self.ratio <= self.expected * (1 + UNSTRUCTURED) ** 2

    def to_dict(self) -> dict[str, Any]:
        """Return the record of calib.json and `--json`."""
        return {**vars(self), "near": self.near}


def lower_bound(point: Point, estimated: int) -> LowerBound | None:
    """Return the bound for the optimum at `point`, where `estimated` parameters were free.

    Offsets of a run that multiply a changing state are free by themselves here too. None where nothing is
    left over to compare with: as many free coefficients as readings.
    """
    cost, summary, z = point.cost, point.cost.summary, point.cost.summary.features.n_zero
    K, left, products = len(cost.reading_variance), point.squares, point.feature_products
    grams, squares, rank = cost.grams, left, 0
    if z:
        inner = pseudo_inverse(grams[:, :z, :z], COLLINEAR)
        rank = int(np.round(np.einsum("rij,rji->r", inner, grams[:, :z, :z])) @ (cost.weights > 0))
        across = inner @ np.concatenate([grams[:, :z, z:], products[:, :z]], axis=2)
        squares = squares - np.swapaxes(products[:, :z], 1, 2) @ across[:, :, -K:]
        products = products[:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, -K:]
        grams = grams[:, z:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, :-K]
    W = point.W * cost.weights[:, None, None]
    f = grams.shape[-1]
    H = np.tensordot(W, grams, axes=(0, 0)).transpose(0, 2, 1, 3).reshape(K * f, K * f)
    g = np.swapaxes(products @ W, 1, 2).sum(axis=0).ravel()
    unit = unit_scale(H)
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    some = values > COLLINEAR * values.max(initial=0.0)
    gains = np.square((unit * g) @ vectors[:, some]) / values[some]
    bound, free = float(np.einsum("rij,rji->", W, squares) - gains.sum()), int(some.sum())
    readings = float(cost.weights @ summary.counts) * K
    zeros = len(summary.model.zeros) * int(np.sum(cost.weights > 0))
    over = readings - rank * K - free
    if over < 1 or not bound > 0:
        return None
    expected = max((readings - estimated - zeros) / over, 1.0)
    return LowerBound(bound, max(point.value / bound, 1.0), expected, free)
