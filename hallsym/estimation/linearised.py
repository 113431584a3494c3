"""Run statistics of models that have none of their own: the reading as a line around a point.

A reading that is no polynomial of the columns, or not linear in the zeros of a run, or that reads columns
made from the log (rates, memory), is replaced by its tangent at parameters p0 and zeros z0:

    reading = [r(p0, z0) - J_z z0] + J_p (p - p0) + J_z z,      J_p = dr/dp, J_z = dr/dz

J_p, J_z and the bracket are functions of the data: features, like those of `hallsym.model.features`, whose
coefficients 1, p - p0 and z are linear. At p0 value and gradient of the cost are exact, so an optimum found
by taking the tangent again at each step (Gauss-Newton, `gauss_newton`) is that of the exact cost.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.run_statistics import RunStatistics, summarised
from hallsym.log import Log
from hallsym.log.batches import Batch, Weigh
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.features import Features, Rows, find_features

READINGS, SAMPLES, SMALLEST = 360, 40, 5.0
"""Readings, and poses and states at least, at which it is asked what no recording can determine; and decades
below 1 [SI] that every second of them may be smaller by: a stage moves by 1e-4 m."""


@lru_cache(maxsize=64)
def exact(model: Model) -> bool:
    """Return whether the model has run statistics of its own, exact for all parameters."""
    if model.computed:
        return False
    s = model.symbols
    if s.zeros.numel() and any(ca.which_depends(ca.vec(s.reading), s.zeros, 2, False)):
        return False
    try:
        find_features(model)
    except InputError:
        return False
    return True


@dataclass(frozen=True, eq=False)
class Program:
    """The features of a model's tangents and their slopes as functions of (p, zeros, pose, state).

    `entries`: (channel, parameter) of each entry of J_p that is not always 0; `zero_entries`: those of
    J_z. The features are those of J_z, then of J_p, then the bracket of each channel.
    """

    entries: tuple[tuple[int, int], ...]
    zero_entries: tuple[tuple[int, int], ...]
    values: Callable[..., list[np.ndarray]]
    slopes: Callable[..., list[np.ndarray]]
    slope_sparsity: ca.Sparsity
    by_parameter: Callable[..., list[np.ndarray]]

    @cached_property
    def pairs(self) -> np.ndarray:
        """Features whose slopes with any column are not always 0, in pairs: (0, i, j), i <= j, (3, pairs)."""
        rows = np.unique(np.array(self.slope_sparsity.get_triplet()[0], dtype=int))
        moved = rows[rows >= len(self.zero_entries)]
        return np.array([np.zeros(len(moved) * (len(moved) + 1) // 2, dtype=int), *_pairs(moved)])


@lru_cache(maxsize=32)
def program(model: Model) -> Program:
    """Return the tangents of a model, by differentiation."""
    s = model.symbols
    reading = ca.densify(s.full(s.reading))
    by_p, by_z = ca.jacobian(reading, s.parameters), ca.jacobian(reading, s.zeros)
    entries, zero_entries = _entries(by_p), _entries(by_z)
    rest = reading - by_z @ s.zeros if s.zeros.numel() else reading
    rows = ca.vertcat(*(by_z[k, j] for k, j in zero_entries), *(by_p[k, j] for k, j in entries), rest)
    inputs = [s.parameters, s.zeros, s.pose, s.state]
    slopes = ca.jacobian(rows, ca.vertcat(s.pose, s.state))
    return Program(
        entries,
        zero_entries,
        on_arrays(ca.Function("tangents", inputs, [ca.densify(rows)])),
        on_arrays(ca.Function("tangent_slopes", inputs, [ca.densify(slopes)])),
        slopes.sparsity(),
        on_arrays(ca.Function("by_parameter", inputs, [ca.densify(by_p)])),
    )


def _pairs(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.triu_indices(len(rows))
    return rows[i], rows[j]


def _entries(jacobian: ca.SX) -> tuple[tuple[int, int], ...]:
    rows, columns = jacobian.sparsity().get_triplet()
    return tuple((int(k), int(j)) for k, j in zip(rows, columns, strict=True))


@dataclass(frozen=True, eq=False)
class TangentFeatures(Features):
    """Features of the tangent at the parameters `at`; a stand-in wherever `Features` serve a cost.

    `noise`: (n_columns,) of the logged columns. Features are many where channels are: what noise makes of
    them is kept as one matrix and not one for each column.
    """

    at: np.ndarray
    noise: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Noise (n_columns,) of the logged columns."""
        return self.noise

    @cached_property
    def slope_pairs(self) -> np.ndarray:
        """Where products of two slopes are not always 0, as `Features.slope_pairs`."""
        return program(self.model).pairs

    @cached_property
    def values(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, zeros) -> [features]` on arrays of samples; `zeros`: (z, samples)."""
        run = program(self.model).values
        return lambda pose, state, zeros: run(self.at, zeros, pose, state)

    @cached_property
    def slopes(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, zeros) -> [d feature / d column]`, (n_columns * n_features, samples).

        Taken at zeros of 0: the weight of a residual does not depend on the zeros.
        """
        run = program(self.model).slopes
        return lambda pose, state, zeros: run(self.at, np.zeros_like(zeros), pose, state)

    def linear(self, p: np.ndarray) -> tuple[np.ndarray, Rows]:
        """Return the coefficients at p, (1 + z, n_features, K), and their slopes, constant, where not nil."""
        parts, K, z = program(self.model), len(self.model.channels), self.n_zeros
        skip = len(parts.zero_entries) - self.n_zero
        value = np.zeros((1 + z, self.size, K))
        k0, j0 = np.array(parts.zero_entries[skip:], dtype=int).reshape(-1, 2).T
        k, j = np.array(parts.entries, dtype=int).reshape(-1, 2).T
        at = self.n_zero + np.arange(len(k))
        value[1 + j0, np.arange(len(k0)), k0] = 1.0
        value[0, at, k] = p[j] - self.at[j]
        value[0, self.size - K + np.arange(K), np.arange(K)] = 1.0
        slope = np.zeros((1 + z, len(k0) + len(k), len(p)))
        slope[0, len(k0) + np.arange(len(k)), j] = 1.0
        return value, Rows(np.append(k0, k), np.append(np.arange(len(k0)), at), slope)

    @property
    def point(self) -> np.ndarray:
        """Parameters of the tangent, (n,)."""
        return self.at

    def slope_rows(self, p: np.ndarray) -> np.ndarray:
        """Return d reading / d parameters, (rows, n), at random poses and states of all sizes up to 1.

        Large ones tell curvature apart; of a reading that a rail cuts off there, small ones tell the rest.
        Poses are about those that are typical of the model, if it states any.
        """
        model, rng = self.model, np.random.default_rng(0)
        count = max(SAMPLES, READINGS // len(model.channels))
        pose, state = model.poses(count, rng), rng.standard_normal((len(model.state), count))
        size = np.where(np.arange(count) % 2, 10.0 ** -(SMALLEST * rng.random(count)), 1.0)
        pose, state = pose if model.typical else pose * size, state * size
        zeros = np.zeros((len(model.zeros), count))
        wide = [np.asarray(v).astype(p.dtype) for v in (p, zeros, pose, state)]
        (rows,) = program(model).by_parameter(*wide)
        return np.moveaxis(rows.reshape(len(model.names), -1), 0, 1)


def summarise_at(
    log: Log,
    model: Model,
    p: np.ndarray,
    zeros: Mapping[int, np.ndarray],
    sigma: Mapping[str, float],
    weigh: Weigh | None = None,
) -> RunStatistics:
    """Read a log once and return its run statistics for the tangent of `model` at `p` and `zeros` by run.

    `weigh` as for `summarise`; `sigma`: noise by column.
    """
    parts = program(model)
    noise = np.array([sigma.get(c, 0.0) for c in (*model.references, *model.state)])
    size = len(parts.zero_entries) + len(parts.entries) + len(model.channels)
    features = TangentFeatures(
        model, np.zeros((size, 1), dtype=int), len(parts.zero_entries), np.array(p), noise
    )
    none = np.zeros(len(model.zeros))

    def place(batch: Batch) -> np.ndarray:
        own = np.array([zeros.get(block.run, none) for block in batch.blocks])
        return np.repeat(own, np.diff(batch.edges), axis=0).T

    return summarised(extended(log, model, sigma, model.named(p)), features, place, weigh)
