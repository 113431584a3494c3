"""Coordinates that the strength of an effect may follow, over their ranges, and polynomials of them."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residual_table import at_rest
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.model.arrays import on_arrays


class Features:
    """Features of each stretch of some runs of a log."""

    def __init__(self, base: Base, runs: frozenset[int]) -> None:
        """Read the ranges that features are scaled by."""
        self.base, self.model = base, base.model
        self.read = on_arrays(base.model.reading)
        self.ranges = _ranges(base, runs)
        self.periodic = [c for c in self.model.references if c in self.model.period]
        self.turning = len(self.periodic) == len(self.model.references)

    def quiet(self, piece: Piece) -> Piece:
        """Take from the coordinates what noise they share with the residual.

        The reference is smoothed, an axis whose motion is its noise is at rest, and readings are the ones
        expected there: else the noise of a coordinate would explain itself.
        """
        base, model, data = self.base, self.model, dict(piece.data)
        for c in model.references:
            smooth = at_rest(data[f"d0_{c}"], base.sigma.get(c, 0.0))
            if smooth is not data[f"d0_{c}"]:
                data |= {f"d{k}_{c}": np.zeros(len(smooth)) for k in (1, 2, 3)}
            data[c] = smooth
        pose, state = ([data[c] for c in columns] for columns in (model.references, model.state))
        (expected,) = self.read(base.p, base.zeros_in(piece.run), pose, state)
        return replace(piece, data=data, readings=expected)

    def unit(self, piece: Piece, column: str) -> np.ndarray:
        """Return a column scaled to -1 .. 1 over its range."""
        middle, half = self.ranges[column]
        return (piece.data[column] - middle) / half

    def states(self, piece: Piece) -> list[str]:
        """Return the logged columns of the state that have no family of their own."""
        others = {*(c.name for c in self.model.computed), "temperature_degc", "t_s"}
        return [c for c in self.model.state if c not in others and c in piece.data]


def _ranges(base: Base, runs: frozenset[int]) -> dict[str, tuple[float, float]]:
    """Middle and half range of every column and reading."""
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    for piece in pieces(base, runs):
        columns = piece.data | dict(zip(base.model.channels, piece.readings, strict=True))
        for c, values in columns.items():
            low[c] = min(low.get(c, np.inf), float(values.min(initial=np.inf)))
            high[c] = max(high.get(c, -np.inf), float(values.max(initial=-np.inf)))
    still = {c: max(NIL * max(abs(low[c]), abs(high[c])), 1e-300) for c in low}
    return {c: (0.5 * (low[c] + high[c]), max(0.5 * (high[c] - low[c]), still[c])) for c in low}


def powers(x: np.ndarray, degree: int) -> np.ndarray:
    """Return products of the rows of x up to `degree`, without the constant."""
    rows = [
        np.prod(x[list(pick)], axis=0)
        for n in range(1, degree + 1)
        for pick in combinations_with_replacement(range(len(x)), n)
    ]
    return np.array(rows)
