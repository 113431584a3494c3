"""Run statistics: a log of any length, reduced without loss to one small triangle per run.

The residual of a reading is linear in the features of `hallsym.model.features`, so the R factor of
[features | readings] holds everything a least-squares cost can ask of a run, for any parameters and any zero
deviations. QR, not Gram and Cholesky: it keeps the digits (docs/theory.md gives the measured error).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.log.batches import Batch, Weigh, batches
from hallsym.log.phase import continuous
from hallsym.model import Model
from hallsym.model.features import Features, find_features

PIECE = 8000
"""Entries of a piece that is reduced at once: fits the cache, and stays below the size at which BLAS starts
threads, whose wake-up costs more than the work."""
SLOPE_SAMPLES = 64
"""Samples per block that estimate how reference noise enters; a weight needs no more."""
MOST_PLACES = 512
"""Samples of a run whose pose is kept where the direction of the reference's noise goes round."""


@dataclass(frozen=True, eq=False)
class RunStatistics:
    """The runs of a log as seen by one model.

    `triangles`: (runs, n, n), n = n_features + n_channels, readings last.
    `slopes`: (runs, pairs), mean product of d feature i / d column and d feature j / d column for each entry
    of `features.slope_pairs`: how noise of a logged column, pose or state, enters the residual. Where the
    noise of the columns is known (`features.std`), of all together.
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
            variance = np.ones(1)
        out = np.zeros((len(self.runs), f, f))
        column, i, j = self.features.slope_pairs
        for c in np.flatnonzero(variance):
            here = column == c
            out[:, i[here], j[here]] += variance[c] * self.slopes[:, here]
        upper = np.triu_indices(f, 1)
        out[:, upper[1], upper[0]] = out[:, upper[0], upper[1]]
        return out

    def select(self, runs: Iterable[int]) -> "RunStatistics":
        """Return the statistics of some of the runs, in the order given."""
        place = {run: k for k, run in enumerate(self.runs)}
        index = [place[run] for run in runs]
        return replace(
            self,
            runs=tuple(self.runs[k] for k in index),
            triangles=self.triangles[index],
            slopes=self.slopes[index],
            counts=self.counts[index],
            first_state=self.first_state[index],
            mean_state=self.mean_state[index],
            places=tuple(self.places[k] for k in index) if self.places else (),
        )

    @cached_property
    def projected(self) -> np.ndarray:
        """Rows of each triangle, the features that carry zeros projected out: (runs, n, n - n_zero)."""
        k = self.features.n_zero
        return self.triangles if k == 0 else projected(self.triangles, k)

    def merged(self) -> "RunStatistics":
        """Return one run for all, the features that carry zeros projected out.

        For constant vertical state within each run this is exactly the cost with the zeros eliminated; for
        moving state it gives up a little information, so it serves starts and global searches, not the fit.
        """
        rows = self.projected
        share = self.counts / self.counts.sum()
        return RunStatistics(
            features=self.features.without_zeros,
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
    names = ("triangles", "slopes", "counts", "first_state", "mean_state")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    places = tuple(place for part in parts for place in part.places)
    return replace(first, runs=tuple(runs), places=places, **arrays)


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

    `weigh(block) -> (samples,)`: weights in [0, 1], 1 by default (how outliers are taken out).
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

    `place(batch)`: what the features are taken at: one centre (n_variables,) for all, or zeros (z, samples).
    """
    model = features.model
    centre = np.zeros(0)
    gathered: dict[int, _Run] = {}
    for batch in batches(log, columns_of(model), on_rows):
        at = place(batch)
        centre = at if at.ndim == 1 else centre
        _gather(gathered, features, at, batch, batch.weights(weigh))
    runs = list(gathered.values())
    return RunStatistics(
        features=features,
        centre=centre,
        runs=tuple(gathered),
        triangles=np.array([r.triangle for r in runs]),
        slopes=np.array([r.slopes / max(r.slope_count, 1) for r in runs]),
        counts=np.array([r.count for r in runs]),
        first_state=np.array([r.first_state for r in runs]),
        mean_state=np.array([r.state_sum / max(r.count, 1e-300) for r in runs]),
        places=tuple(_thinned(np.hstack(r.places)) for r in runs) if model.typical else (),
    )


def _centre(features: Features, batch: Batch) -> np.ndarray:
    """Mean of the first block, for every variable: takes large common offsets out of the monomials."""
    first, model = batch.blocks[0].data, features.model
    means = [[np.mean(first[c]) for c in columns] for columns in (model.references, model.state)]
    return np.array(features.variables(*means)).ravel()


def _gather(
    gathered: "dict[int, _Run]",
    features: Features,
    at: np.ndarray,
    batch: Batch,
    weights: np.ndarray | None,
) -> None:
    """Add a batch to the runs it belongs to."""
    model, n = features.model, features.size
    pose, state = batch.columns(model.references), batch.columns(model.state)
    rows = np.empty((len(batch), n + len(model.channels)))
    rows[:, :n] = features.values(pose, state, at)[0].T
    rows[:, n:] = np.transpose(batch.columns(model.channels))
    if weights is not None:
        rows *= np.sqrt(weights)[:, None]
    weight = np.ones(len(batch)) if weights is None else weights
    states = np.array(state) if state else np.zeros((0, len(batch)))
    pick, edges = _sparse(batch)
    there = at if at.ndim == 1 else at[:, pick]
    slopes = features.slopes([v[pick] for v in pose], [v[pick] for v in state], there)[0]
    slopes = slopes.reshape(len(pose) + len(state), n, -1)
    if features.std is not None:
        slopes *= features.std[:, None, None]
    for k, (block, part) in enumerate(batch.parts()):
        run = gathered.setdefault(block.run, _Run(states[:, part.start]))
        run.add(rows[part], weight[part], states[:, part])
        here = pick[edges[k] : edges[k + 1]]
        run.add_slopes(slopes[:, :, edges[k] : edges[k + 1]], weight[here], features)
        if model.typical:
            run.places.append(np.vstack([*(v[here] for v in pose), *(v[here] for v in state)]))


def _sparse(batch: Batch) -> tuple[np.ndarray, list[int]]:
    """Every so many samples of each block, and where the blocks begin among them."""
    picks = [
        np.arange(at.start, at.stop, -(-(at.stop - at.start) // SLOPE_SAMPLES)) for _, at in batch.parts()
    ]
    return np.concatenate(picks), np.cumsum([0, *map(len, picks)]).tolist()


def _thinned(places: np.ndarray) -> np.ndarray:
    return places[:, :: -(-places.shape[1] // MOST_PLACES)]


class _Run:
    """Accumulates one run, block by block."""

    def __init__(self, first_state: np.ndarray) -> None:
        self.first_state = first_state.copy()
        self.triangle: np.ndarray | None = None
        self.slopes: np.ndarray | float = 0.0
        self.slope_count = 0.0
        self.places: list[np.ndarray] = []
        self.count = 0.0
        self.state_sum: np.ndarray | float = 0.0

    def add(self, rows: np.ndarray, weight: np.ndarray, states: np.ndarray) -> None:
        self.triangle = _triangle(rows if self.triangle is None else np.vstack([self.triangle, rows]))
        self.count += float(weight.sum())
        self.state_sum = self.state_sum + states @ weight

    def add_slopes(self, slopes: np.ndarray, weight: np.ndarray, features: Features) -> None:
        if features.std is None:
            products = (slopes * weight) @ np.swapaxes(slopes, 1, 2)
        else:
            products = np.tensordot(slopes * weight, slopes, axes=([0, 2], [0, 2]))[None]
        self.slopes = self.slopes + products[tuple(features.slope_pairs)]
        self.slope_count += float(weight.sum())


def _triangle(rows: np.ndarray) -> np.ndarray:
    """R factor of `rows`, padded to a square; tall blocks are reduced piece by piece."""
    n = rows.shape[1]
    piece = max(PIECE // n, 2 * n)
    while len(rows) > piece:
        whole = len(rows) // piece
        pieces = _r(rows[: whole * piece].reshape(whole, piece, n))
        rows = np.vstack([pieces.reshape(-1, n), rows[whole * piece :]])
    if len(rows) < n:
        rows = np.vstack([rows, np.zeros((n - len(rows), n))])
    return _r(rows)


def projected(triangles: np.ndarray, k: int) -> np.ndarray:
    """Rows of each triangle with its first k columns projected out, the k columns left out.

    Where the vertical state is still, those columns are multiples of each other: only their rank counts.
    """
    first, rest = triangles[:, :, :k], triangles[:, :, k:]
    size = np.sqrt(np.einsum("rij,rij->rj", first, first))[:, None]
    u, s, _ = np.linalg.svd(first / np.where(size > 0, size, 1.0), full_matrices=False)
    u = u * (s > 1e-9 * s[:, :1])[:, None]
    return rest - u @ (np.swapaxes(u, 1, 2) @ rest)


def _r(matrices: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(matrices, mode="r"))
