"""Derivatives of the readings with respect to the new parameters of candidate effects, where not nil.

Most new parameters act on one reading only. Their derivatives are kept as rows, one per parameter and channel
that it moves, so that what is nil is neither stored nor multiplied.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.log.batches import Batch
from hallsym.model import Model
from hallsym.model.arrays import on_arrays


def reading_and_derivatives(model: Model) -> Callable[..., list[np.ndarray]]:
    """Return `(p, zeros, pose, state) -> reading, its derivatives by parameters and by zeros`, on arrays."""

    def made() -> Callable[..., list[np.ndarray]]:
        s = model.symbols
        reading = s.full(s.reading)
        parts = [reading, ca.jacobian(reading, s.parameters), ca.jacobian(reading, s.zeros)]
        inputs = [s.parameters, s.zeros, s.pose, s.state]
        return on_arrays(ca.Function("base", inputs, [ca.densify(part) for part in parts]))

    return model.remember("reading, derivatives", made)


@dataclass(frozen=True, eq=False)
class Slope:
    """`run(p, zeros, pose, state) -> (rows, samples)`; each row has a channel and a column (parameter)."""

    run: Callable[..., list[np.ndarray]]
    model: Model
    p: np.ndarray
    channel: np.ndarray
    column: np.ndarray


def slope_of(model: Model, p: np.ndarray, new: Sequence[str]) -> Slope:
    """Return d reading / d new parameters at the values p of `model`, rows in order of their channel."""
    index = [model.names.index(name) for name in new]
    at = tuple(p[index].tolist())
    run, channel, column = model.remember(("slope", *index, *at), lambda: _rows_of(model, index, at))
    return Slope(run, model, p, channel, column)


def _rows_of(
    model: Model, index: Sequence[int], at: Sequence[float]
) -> tuple[Callable[..., list[np.ndarray]], np.ndarray, np.ndarray]:
    """Function, channels and columns of a `Slope` with respect to some parameters at their values."""
    s = model.symbols
    slope = ca.jacobian(s.full(s.reading), s.parameters[index])
    slope = ca.sparsify(ca.substitute(slope, s.parameters[index], ca.DM(at)))
    channel, column = (np.array(k, dtype=int) for k in slope.sparsity().get_triplet())
    order = np.lexsort((column, channel))
    entries = slope.nonzeros()
    rows = ca.vertcat(*(entries[k] for k in order)) if len(order) else ca.SX(0, 1)
    function = ca.Function("slope", [s.parameters, s.zeros, s.pose, s.state], [ca.densify(rows)])
    return on_arrays(function), channel[order], column[order]


class Slopes:
    """The rows of all candidates, channel by channel.

    `span`: columns of each candidate, `columns` of them in all. For each channel k `column[k]` is the column
    of each row and `parts[k]` the rows of each candidate. `spoiled`: candidates that were not finite
    somewhere; their rows are 0 there.
    """

    def __init__(
        self, model: Model, p: np.ndarray, candidates: Mapping[str, tuple[Model, Sequence[str]]]
    ) -> None:
        values = dict(zip(model.names, p.tolist(), strict=True))
        self.channels = range(len(model.channels))
        self.references = model.references
        self.each: dict[str, Slope] = {}
        self.span: dict[str, slice] = {}
        self.columns = 0
        self.spoiled: set[str] = set()
        columns: list[list[np.ndarray]] = [[] for _ in self.channels]
        self.parts: list[list[slice]] = [[] for _ in self.channels]
        for key, (wide, new) in candidates.items():
            slope = slope_of(wide, wide.vector(values), new)
            self.each[key] = slope
            self.span[key] = slice(self.columns, self.columns + len(new))
            for k in self.channels:
                here = slope.column[slope.channel == k] + self.columns
                start = self.parts[k][-1].stop if self.parts[k] else 0
                self.parts[k].append(slice(start, start + len(here)))
                columns[k].append(here)
            self.columns += len(new)
        self.column = [np.concatenate([*c, np.zeros(0, dtype=int)]) for c in columns]

    def rows(self, batch: Batch, zeros: np.ndarray, weights: np.ndarray | None) -> list[np.ndarray]:
        """Return the rows of each channel, (rows, samples), times the root of the weights."""
        out = [np.empty((len(c), len(batch))) for c in self.column]
        pose = batch.columns(self.references)
        for j, (key, slope) in enumerate(self.each.items()):
            (values,) = slope.run(slope.p, zeros, pose, batch.columns(slope.model.state))
            if not np.isfinite(values).all():
                self.spoiled.add(key)
                values = np.zeros_like(values)
            for k in self.channels:
                out[k][self.parts[k][j]] = values[slope.channel == k]
        if weights is not None:
            for rows in out:
                rows *= np.sqrt(weights)
        return out
