"""Factors: a log of any length, reduced to one small triangle per run.

The residual of a reading is linear in the features of `hallsym.model.features`, so the R factor of
[features | readings] is a sufficient statistic of a run for a least-squares cost, for any parameters and any
offsets. QR, not Gram and Cholesky: it keeps the digits (docs/theory.md gives the measured error).

A reading that is no polynomial of the columns, or not linear in the offsets of a run, or that reads columns
made from the log (rates, memory), is replaced by its tangent at parameters p0 and offsets z0:

    reading = [r(p0, z0) - J_z z0] + J_p (p - p0) + J_z z,      J_p = dr/dp, J_z = dr/dz

J_p, J_z and the bracket are functions of the data: features too, whose coefficients 1, p - p0 and z are
linear. At p0 value and gradient of the cost are exact, so an optimum found by taking the tangent again at
each step (Gauss-Newton, `hallsym.estimation.optimum`) is that of the exact cost.

A run's offsets appear in no other run, so they are eliminated from its equations before the runs are summed.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import isqrt
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtpqrt

from hallsym.errors import InputError
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.log.batches import Batch, Weigh, batches
from hallsym.log.derived import extended
from hallsym.log.phase import continuous
from hallsym.model import Model
from hallsym.model.arrays import jacobian, on_arrays
from hallsym.model.features import Features, Tangent, find_features

# -- lossless triangles of a polynomial reading --------------------------------------------------------------

PIECE = 16_000
"""Entries of a piece that is reduced at once: fits the cache. Wide ones are four times as high as wide."""
SLOPE_SAMPLES = 64
"""Samples per block from which the effect of reference noise is estimated; a weight needs no more."""
MOST_PLACES = 512
"""Samples of a run whose pose is kept where the direction of the reference's noise varies with the pose."""

BY_RUN = ("triangles", "slopes", "counts", "first_state", "mean_state")
"""Arrays of run statistics, one row per run."""


@dataclass(frozen=True, eq=False)
class RunStatistics:
    """The run statistics of a log for one model.

    `triangles`: (runs, m, n), n = n_features + n_channels, readings last; m rows, n at most: as many as the
    longest run has samples where these are fewer.
    `slopes`: (runs, pairs), mean product of d feature i / d column and d feature j / d column for each entry
    of `features.slope_pairs`: how noise of a logged column, pose or state, enters the residual. Where the
    noise of the columns is known (`features.std`), (runs, n_features^2): of all columns together.
    `counts`: samples per run (sum of weights). `first_state`: vertical state at the reset of each run.
    `mean_state`: mean vertical state of each run. `places`: per run (n_columns, samples), pose and state
    of some samples, where the noise of the reference acts in another direction at each (`Model.typical`).
    """

    features: Features
    centre: np.ndarray
    runs: tuple[int, ...]
    triangles: np.ndarray
    slopes: np.ndarray
    counts: np.ndarray
    first_state: np.ndarray
    mean_state: np.ndarray
    places: tuple[np.ndarray, ...] = ()

    @property
    def model(self) -> Model:
        """The model whose features these are."""
        return self.features.model

    def noise_in_features(self, variance: np.ndarray) -> np.ndarray:
        """Sum over columns of variance (n_columns,) * mean outer product of feature slopes, (runs, f, f)."""
        f, std = self.features.size, self.features.std
        if std is not None:
            if not np.allclose(std**2, variance):
                raise ValueError("these run statistics were made for another noise of the logged columns")
            return self.slopes.reshape(-1, f, f)
        out = np.zeros((len(self.runs), f, f))
        column, i, j = self.features.slope_pairs
        for c in np.flatnonzero(variance):
            here = column == c
            out[:, i[here], j[here]] += variance[c] * self.slopes[:, here]
        both = out + np.swapaxes(out, 1, 2)
        both[:, np.arange(f), np.arange(f)] /= 2
        return both

    def select(self, runs: Iterable[int]) -> "RunStatistics":
        """Return the statistics of some of the runs, in the order given."""
        place = {run: k for k, run in enumerate(self.runs)}
        index = [place[run] for run in runs]
        places = tuple(self.places[k] for k in index) if self.places else ()
        arrays: dict[str, Any] = {name: getattr(self, name)[index] for name in BY_RUN}
        return replace(self, runs=tuple(self.runs[k] for k in index), places=places, **arrays)

    @property
    def logged(self) -> tuple[str, ...]:
        """The columns that the features are made of."""
        return (*self.model.references, *self.model.state)

    def merged(self) -> "RunStatistics":
        """Return one run for all, the features that carry offsets projected out.

        For constant vertical state within each run this is exactly the cost with the offsets eliminated; for
        moving state it gives up a little information, so it serves starts and global searches, not the fit.
        """
        k = self.features.n_zero
        rows = self.triangles if k == 0 else projected(self.triangles, k)
        share = self.counts / self.counts.sum()
        return RunStatistics(
            features=self.features.without_offsets,
            centre=self.centre,
            runs=(0,),
            triangles=_triangle(rows.reshape(-1, rows.shape[-1]))[None],
            slopes=(share @ self.slopes)[None],
            counts=np.array([self.counts.sum()]),
            first_state=(share @ self.first_state)[None],
            mean_state=(share @ self.mean_state)[None],
            places=(np.hstack(self.places),) if self.places else (),
        )


def joined(parts: Sequence[RunStatistics]) -> RunStatistics:
    """Return the runs of several logs as one summary; no sample is touched again.

    The parts are of one model and have one centre, and each run stands in one of them: then triangles, and
    all else, are bitwise those of one pass over all.
    """
    first = parts[0]
    if any(not np.array_equal(part.centre, first.centre) for part in parts):
        raise ValueError("run statistics are joined where they have one centre")
    if len(set(runs := [run for part in parts for run in part.runs])) != len(runs):
        raise ValueError("run statistics are joined where each run stands in one of them")
    arrays: dict[str, Any] = {n: np.concatenate([getattr(part, n) for part in parts]) for n in BY_RUN[1:]}
    triangles = _stacked([own for part in parts for own in part.triangles])
    places = tuple(place for part in parts for place in part.places)
    return replace(first, runs=tuple(runs), places=places, triangles=triangles, **arrays)


def summarise(
    log: Log,
    model: Model,
    weigh: Weigh | None = None,
    on_rows: Callable[[int], None] | None = None,
    centre: np.ndarray | None = None,
) -> RunStatistics:
    """Read a log once and return its run statistics for `model`.

    `centre`: (n_variables,) of the features, that of another log to be `joined` with; by default the
    mean of the first block.

    `weigh(block) -> (samples,)`: weights, 1 by default; 0 for outliers, which are left out.
    `on_rows(samples so far)` is called along the way.
    """
    features, known = find_features(model), [] if centre is None else [centre]
    log = continuous(log, model)

    def place(batch: Batch) -> np.ndarray:
        if not known:
            known.append(_centre(features, batch))
        return known[0]

    return summarised(log, features, place, weigh, on_rows)


def summarised(
    log: Log,
    features: Features,
    place: Callable[[Batch], np.ndarray],
    weigh: Weigh | None = None,
    on_rows: Callable[[int], None] | None = None,
) -> RunStatistics:
    """Read a log once and return the run statistics of given features.

    `place(batch)`: where the features are taken: one centre (n_variables,) for all, or offsets (z, samples).
    """
    model, states = features.model, len(features.model.state)
    centre = np.zeros(0)
    runs: list[int] = []
    triangles: list[np.ndarray] = []
    totals: list[np.ndarray] = []
    first_state: list[np.ndarray] = []
    places: list[list[np.ndarray]] = []
    for batch in batches(log, columns_of(model), on_rows):
        at = place(batch)
        centre = at if at.ndim == 1 else centre
        for run, triangle, sums, begin, some in _blocks(features, at, batch, batch.weights(weigh)):
            if runs and run == runs[-1]:
                triangles[-1] = _triangle(np.vstack([triangles[-1], triangle]))
                totals[-1] = totals[-1] + sums
                places[-1] += some
            else:
                runs.append(run)
                triangles.append(triangle)
                totals.append(sums)
                first_state.append(begin)
                places.append(some)
    counts, looked, state, slopes = np.split(np.array(totals), [1, 2, 2 + states], axis=1)
    return RunStatistics(
        features=features,
        centre=centre,
        runs=tuple(runs),
        triangles=_stacked(triangles),
        slopes=slopes / np.maximum(looked, 1.0),
        counts=counts[:, 0].copy(),
        first_state=np.array(first_state),
        mean_state=state / np.maximum(counts, 1e-300),
        places=tuple(
            v[:, :: -(-v.shape[1] // MOST_PLACES)] for v in map(np.hstack, places if model.typical else ())
        ),
    )


def _centre(features: Features, batch: Batch) -> np.ndarray:
    """Mean of the first block, for every variable: takes large common offsets out of the monomials."""
    first, model = next(batch.blocks).data, features.model
    means = [[np.mean(first[c]) for c in columns] for columns in (model.references, model.state)]
    return np.array(features.variables(*means)).ravel()


def _blocks(
    features: Features, at: np.ndarray, batch: Batch, weights: np.ndarray | None
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]]:
    """Yield of each block its run, triangle, sums, first state, and some places where the model needs them.

    The sums are those of weights, of weights of the samples whose slopes are taken, of states and of products
    of slopes.
    """
    model, n = features.model, features.size
    pose, state = batch.columns(model.references), batch.columns(model.state)
    columns = np.empty((n + len(model.channels), len(batch)))
    columns[n:] = batch.columns(model.channels)
    features.values(pose, state, at, out=[columns[:n]])
    if weights is not None:
        columns *= weights
    triangles = [_triangle(columns[:, part].T) for _, part in batch.parts()]
    weight = np.ones(len(batch)) if weights is None else weights
    sizes = ((at, at.stop - at.start) for _, at in batch.parts())
    picks = [np.arange(at.start, at.stop, -(-size // SLOPE_SAMPLES)) for at, size in sizes]
    pick, edges = np.concatenate(picks), np.cumsum([0, *map(len, picks)]).tolist()
    there = at if at.ndim == 1 else at[:, pick]
    slopes = features.slopes([v[pick] for v in pose], [v[pick] for v in state], there)[0]
    slopes *= weight[pick]
    starts = list(batch.edges[:-1])
    weighed = np.array([np.add.reduceat(v, starts) for v in (weight, *(v * weight for v in state))]).T
    looked = np.add.reduceat(weight[pick], edges[:-1])[:, None]
    sums = np.hstack([weighed[:, :1], looked, weighed[:, 1:], _products(slopes, features, edges)])
    places: list[list[np.ndarray]] = [[] for _ in batch.runs]
    if model.typical:
        seen = np.vstack([v[pick] for v in (*pose, *state)])
        places = [[seen[:, a:b]] for a, b in pairwise(edges)]
    begin = np.array([v[starts] for v in state]).reshape(len(state), len(starts)).T
    yield from zip(batch.runs, triangles, sums, begin, places, strict=True)


def _products(slopes: np.ndarray, features: Features, edges: Sequence[int]) -> np.ndarray:
    """Return the sums over the samples of each block of products of slopes, (blocks, pairs).

    `slopes`: (entries, samples); block k lies at `edges[k]` to `edges[k + 1]`.
    """
    if features.std is None:
        first, second = features.entry_pairs
        return np.add.reduceat(slopes[first] * slopes[second], edges[:-1], axis=1).T
    slopes = slopes.reshape(-1, features.size, slopes.shape[1])
    every = (np.swapaxes(slopes[:, :, a:b], 0, 1).reshape(features.size, -1) for a, b in pairwise(edges))
    return np.array([(own @ own.T).ravel() for own in every])


def _triangle(rows: np.ndarray) -> np.ndarray:
    """R factor of rows (m, n), of m rows where these are fewer; more are reduced piece by piece.

    A triangle over a piece is reduced by LAPACK's TPQRT, in panels that balance their own work and that on
    the other columns.
    """
    m, n = rows.shape
    if m <= n:
        return np.asarray(np.linalg.qr(rows, mode="r"))
    triangle, piece = np.zeros((n, n), order="F"), max(PIECE // n, 4 * n)
    for low in range(0, m, piece):
        part = np.array(rows[low : low + piece], order="F")
        triangle = dtpqrt(0, isqrt(n), triangle, part, overwrite_a=True, overwrite_b=True)[0]
    return np.asarray(triangle)


def _stacked(triangles: Sequence[np.ndarray]) -> np.ndarray:
    """Return R factors (rows, n) of several runs as one array, filled up with zeros to the most rows."""
    out = np.zeros((len(triangles), max(map(len, triangles)), triangles[0].shape[1]))
    for own, filled in zip(triangles, out, strict=True):
        filled[: len(own)] = own
    return out


def projected(triangles: np.ndarray, k: int) -> np.ndarray:
    """Rows of each triangle with its first k columns projected out, the k columns left out.

    Where the vertical state is still, those columns are multiples of each other: only their rank counts.
    """
    first, rest = triangles[:, :, :k], triangles[:, :, k:]
    size = np.sqrt(np.einsum("rij,rij->rj", first, first))[:, None]
    u, s, _ = np.linalg.svd(first / np.where(size > 0, size, 1.0), full_matrices=False)
    u = u * (s > 1e-9 * s[:, :1])[:, None]
    return rest - u @ (np.swapaxes(u, 1, 2) @ rest)


# -- triangles of tangents -----------------------------------------------------------------------------------

STEP = 1e-6
"""Step of differences over the largest value of a column: slopes are good to six digits."""
READINGS, SAMPLES, SMALLEST = 360, 40, 5.0
"""Fewest readings, and poses and states, for the structural null directions; and decades below 1 [SI] by
which every second of them may be smaller: a stage moves by 1e-4 m."""


@lru_cache(maxsize=64)
def exact(model: Model) -> bool:
    """Return whether the model has run statistics of its own, exact for all parameters."""
    if model.computed:
        return False
    s = model.symbols
    if s.offsets.numel() and any(ca.which_depends(ca.vec(s.reading), s.offsets, 2, False)):
        return False
    try:
        find_features(model)
    except InputError:
        return False
    return True


@dataclass(frozen=True, eq=False)
class Program:
    """The features of a model's tangents as functions of (p, offsets, pose, state).

    `entries`: (channel, parameter) of each entry of J_p that is not always 0; `zero_entries`: those of
    J_z. The features are those of J_z, then of J_p, then the bracket of each channel.
    """

    entries: tuple[tuple[int, int], ...]
    zero_entries: tuple[tuple[int, int], ...]
    values: Callable[..., list[np.ndarray]]


@lru_cache(maxsize=32)
def program(model: Model) -> Program:
    """Return the tangents of a model, by differentiation."""
    s = model.symbols
    reading = ca.densify(s.full(s.reading))
    by_p, by_z = jacobian(reading, s.parameters), ca.jacobian(reading, s.offsets)
    entries, zero_entries = _entries(by_p), _entries(by_z)
    rest = reading - by_z @ s.offsets if s.offsets.numel() else reading
    rows = ca.vertcat(*(by_z[k, j] for k, j in zero_entries), *(by_p[k, j] for k, j in entries), rest)
    rows = ca.cse(rows)
    inputs = [s.parameters, s.offsets, s.pose, s.state]
    return Program(
        entries,
        zero_entries,
        on_arrays(ca.Function("tangents", inputs, [ca.densify(rows)])),
    )


def _entries(jacobian: ca.SX) -> tuple[tuple[int, int], ...]:
    rows, columns = jacobian.sparsity().get_triplet()
    return tuple((int(k), int(j)) for k, j in zip(rows, columns, strict=True))


@dataclass(frozen=True, eq=False)
class TangentFeatures(Features):
    """Features of the tangent at the parameters `at`, with the interface of `Features`.

    `noise`: (n_columns,) of the logged columns. Many channels have many features, so the covariance by noise
    is kept as one matrix and not one for each column.
    """

    at: np.ndarray
    noise: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Noise (n_columns,) of the logged columns."""
        return self.noise

    @cached_property
    def values(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, offsets) -> [features]` on arrays of samples; `offsets`: (z, samples)."""
        run = program(self.model).values
        return lambda pose, state, offsets, **more: run(self.at, offsets, pose, state, **more)

    @cached_property
    def slopes(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, offsets) -> [d feature / d column]` times the noise of each column that has some.

        Shape (noisy columns * n_features, samples). Taken at offsets of 0: the weight of a residual does not
        depend on the offsets. By differences: a weight needs no more digits, and derivatives of the tangent
        take eight times the operations.
        """
        values, noisy = self.values, np.flatnonzero(self.noise)

        def slopes(
            pose: Sequence[np.ndarray], state: Sequence[np.ndarray], offsets: np.ndarray
        ) -> list[np.ndarray]:
            columns = np.array([*pose, *state])
            count, samples = columns.shape
            step = STEP * np.maximum(np.abs(columns).max(axis=1, initial=0.0), STEP)
            moved = np.repeat(columns[:, None], 1 + len(noisy), axis=1)
            moved[noisy, 1 + np.arange(len(noisy))] += step[noisy, None]
            step = moved[noisy, 1 + np.arange(len(noisy))] - columns[noisy]  # as rounded
            flat = moved.reshape(count, -1)
            none = np.zeros((len(offsets), flat.shape[1]))
            found = values(flat[: len(pose)], flat[len(pose) :], none)[0].reshape(self.size, -1, samples)
            out = np.swapaxes(found[:, 1:] - found[:, :1], 0, 1) * (self.noise[noisy, None] / step)[:, None]
            out[:, : self.n_zero] = 0.0  # as in `slope_entries`
            return [out.reshape(-1, samples)]

        return slopes

    def tangent(self, p: np.ndarray) -> Tangent:
        """Return the coefficients at `p`."""
        parts, K = program(self.model), len(self.model.channels)
        k0, j0 = np.array(parts.zero_entries, dtype=int).reshape(-1, 2)[: self.n_zero].T
        k, j = np.array(parts.entries, dtype=int).reshape(-1, 2).T
        return Tangent(
            np.concatenate([k0, k, np.arange(K)]),
            np.concatenate([np.zeros(len(k0)), p[j] - self.at[j], np.ones(K)]),
            np.append(j0, self.n_offsets + j),
        )

    @property
    def point(self) -> np.ndarray:
        """Parameters of the tangent, (n,)."""
        return self.at

    @property
    def everywhere(self) -> Features:
        """The tangent at the nominal parameters."""
        return _nominal_tangent(self.model)

    def slope_rows(self, p: np.ndarray) -> np.ndarray:
        """Return d reading / d parameters, (rows, n), at random poses and states of all sizes up to 1.

        Large ones determine curvature; where a rail cuts a reading off, small ones determine the rest. Poses
        are about those that are typical of the model, if it states any.
        """
        model, rng = self.model, np.random.default_rng(0)
        count = max(SAMPLES, READINGS // len(model.channels))
        pose, state = model.poses(count, rng), rng.standard_normal((len(model.state), count))
        size = np.where(np.arange(count) % 2, 10.0 ** -(SMALLEST * rng.random(count)), 1.0)
        pose, state = pose if model.typical else pose * size, state * size
        offsets = np.zeros((len(model.offsets), count))
        parts, rows = program(model), np.zeros((len(model.names), len(model.channels), count))
        k, j = np.array(parts.entries, dtype=int).reshape(-1, 2).T
        at = len(parts.zero_entries)
        rows[j, k] = parts.values(p, offsets, pose, state)[0][at : at + len(k)]
        return rows.reshape(len(rows), -1).T


@lru_cache(maxsize=32)
def _nominal_tangent(model: Model) -> TangentFeatures:
    logged = len(model.references) + len(model.state)
    return TangentFeatures(model, np.zeros((0, 1), dtype=int), 0, model.nominal, np.zeros(logged))


def summarise_at(
    log: Log,
    model: Model,
    p: np.ndarray,
    offsets: Mapping[int, np.ndarray],
    sigma: Mapping[str, float],
    weigh: Weigh | None = None,
) -> RunStatistics:
    """Read a log once and return its run statistics for the tangent of `model` at `p` and `offsets` by run.

    `weigh` as for `summarise`; `sigma`: noise by column.
    """
    parts = program(model)
    noise = np.array([sigma.get(c, 0.0) for c in (*model.references, *model.state)])
    size = len(parts.zero_entries) + len(parts.entries) + len(model.channels)
    features = TangentFeatures(
        model, np.zeros((size, 1), dtype=int), len(parts.zero_entries), np.array(p), noise
    )
    wide = extended(log, model, sigma, model.named(p))
    return summarised(wide, features, lambda batch: batch.offsets(offsets, len(model.offsets)), weigh)


# -- normal equations ----------------------------------------------------------------------------------------

SINGULAR = 1e-11
"""Singular values below this part of the largest are rounding, for matrices of unit diagonal."""


def unit_scale(matrix: np.ndarray) -> np.ndarray:
    """Return 1 / sqrt(diagonal), (..., v): the units in which the diagonal is 1; 1 where it is 0."""
    diagonal = np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 0.0)
    return 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, such as the covariance of an information matrix.

    The matrix is brought to unit diagonal first, so the units of the unknowns cost no digits.
    """
    outer = _outer(unit_scale(matrix))
    return np.linalg.inv(matrix * outer) * outer


def pseudo_inverse(matrix: np.ndarray, singular: float = SINGULAR) -> np.ndarray:
    """Return the pseudo-inverse of a matrix of products whose columns differ in unit."""
    outer = _outer(unit_scale(matrix))
    return np.linalg.pinv(matrix * outer, rcond=singular, hermitian=True) * outer


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve symmetric equations (..., v, v) x = right (..., v, k); least norm where they are singular."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return pseudo_inverse(matrix) @ right


def eliminate(matrix: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the first `count` unknowns of each run: its offsets.

    `matrix`: (..., v, v) information, Hessian or products of columns. Returns the Schur complement of the
    others, (..., v - count, v - count), and `follow`, (..., count, v - count): at the minimum `offsets =
    follow @ others`.
    """
    across = matrix[..., :count, count:]
    follow = -solve(matrix[..., :count, :count], across)
    return matrix[..., count:, count:] + np.swapaxes(across, -1, -2) @ follow, follow


def _outer(scale: np.ndarray) -> np.ndarray:
    return scale[..., :, None] * scale[..., None, :]
