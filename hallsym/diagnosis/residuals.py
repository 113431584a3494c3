"""A fitted model on a log, and its residual, run by run: computed once for each log that fits in memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.estimation.decoding import columns_of, decoding_gain
from hallsym.log import Log
from hallsym.log.batches import CACHED_ROWS, Batch, Weigh, batches, forget, is_cached, remembered
from hallsym.log.derived import HALO, extended
from hallsym.log.part import Part, part_of
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import campaign_time, rate, run_time

FOLDS = 11
"""Groups of runs left out in turn; a prime, so that they do not coincide with recurring settings."""
PART = CACHED_ROWS // 2
"""Samples of the part of a longer log: they know the size of the noise to .3 %, far better than any gap that
is worth reporting, and the columns of all effects fit in 200 MB."""
NIL = 1e-9
"""Relative squares below which a column is rounding: absorbed by the model, or constant."""


@dataclass(frozen=True, eq=False)
class Base:
    """A fitted model on a log, as the fit left it or with effects added.

    `p`: (n,) values; `offsets`: displacement by run; `covariance`: (K, K) of one residual; `free`: index of
    parameters that the fit moves; `pose_weights`: (n_pose,) of the pose metric; `holdout`: holdout runs;
    `timed`: whether the log holds time, and not a counter in its place. `sliced`: whether the runs are slices
    of one recording, one after the other. `policy`: thresholds of what is decided on it.
    """

    log: Log
    model: Model
    p: np.ndarray
    offsets: Mapping[int, np.ndarray]
    covariance: np.ndarray
    free: tuple[int, ...]
    pose_weights: np.ndarray
    holdout: frozenset[int]
    sigma: Mapping[str, float]
    keep: Weigh | None = None
    timed: bool = True
    sliced: bool = False
    policy: Policy = POLICY

    @property
    def joined(self) -> bool:
        """Whether noise continues from run to run, since runs have no offsets."""
        return self.timed and not self.model.offsets

    @property
    def on_all(self) -> "Base":
        """The same on all samples."""
        return self if self.keep is None else replace(self, keep=None)

    @cached_property
    def part(self) -> "Base":
        """The same on a bounded part of a long log (`part_of`); itself where the log is short."""
        if self.log.rows <= CACHED_ROWS or isinstance(self.log, Part):
            return self
        log = part_of(self.log, PART, HALO)
        return replace(self, log=log, keep=self.keep and remembered(self.keep, log.rows))

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return self.model.named(self.p)

    @property
    def weight(self) -> np.ndarray:
        """1 / variance of each channel's reading, for decoding with more probes than coordinates."""
        return 1.0 / np.diag(self.covariance)

    @property
    def whiten(self) -> np.ndarray:
        """Matrix (K, K) that turns a residual into one of unit covariance."""
        return np.linalg.cholesky(np.linalg.inv(self.covariance)).T

    def offsets_in(self, run: int) -> np.ndarray:
        """Return the zero deviations of a run, (offsets,); nil of one that was not fitted."""
        return self.offsets.get(run, np.zeros(len(self.model.offsets)))

    def offsets_of(self, batch: Batch) -> np.ndarray:
        """Return the zero deviations of every sample of a batch, (offsets, samples)."""
        return batch.offsets(self.offsets, len(self.model.offsets))

    def batches(self, model: Model | None = None) -> Iterator[Batch]:
        """Return the log in batches with all columns that the model, or an extended one, reads."""
        model = model or self.model
        return batches(extended(self.log, model, self.sigma, self.values), columns_of(model))

    def to_pose(self, pose: Sequence[np.ndarray], state: Sequence[np.ndarray]) -> np.ndarray:
        """Return d pose / d reading at some samples, (n_pose, K, samples)."""
        return decoding_gain(self.model, self.p, pose, state, self.weight)


Found = TypeVar("Found")


def found_once(look: Callable[[Base, frozenset[int]], Found]) -> Callable[[Base, Iterable[int]], Found]:
    """Return `look` with its results for a base and runs cached for the life of the base."""

    @wraps(look)
    def looked_up(base: Base, runs: Iterable[int]) -> Found:
        known, key = vars(base).setdefault("_found", {}), (look.__qualname__, frozenset(runs))
        if key not in known:
            known[key] = look(base, key[1])
        found: Found = known[key]
        return found

    return looked_up


@dataclass(frozen=True, eq=False)
class Piece:
    """A stretch of one run: times, whitened residual, rate of the reading [1/s] and readings, (K, samples).

    `expected` is the expected reading and `speed` its rate, whitened like the residual. `used` says which
    samples count. `data` holds the columns of the model, the rates of the reference up to the third
    (`d0_x_ref_m`: smoothed), `t_s`, `campaign_s`, `run_s` and, where logged, `temperature_degc`.
    """

    run: int
    t: np.ndarray
    residual: np.ndarray
    expected: np.ndarray
    speed: np.ndarray
    readings: np.ndarray
    used: np.ndarray
    data: dict[str, np.ndarray]


def pieces(base: Base, runs: frozenset[int], *, whole: bool = False) -> Iterator[Piece]:
    """Yield the whitened residual of some runs beside the quantities it may depend on.

    Of a long log a bounded part of it (`Base.part`), unless the `whole` log is asked for. What is cached of a
    log (`is_cached`) serves the next call with the same base.
    """
    base = base if whole else base.part
    model, (log, columns) = base.model, _beside(base)
    known, evaluate = _kept(base, base.log.runs) if is_cached(base.log) else [], _residual_of(base)
    for k, batch in enumerate(batches(log, columns)):
        weights = batch.weights(base.keep)
        residual, speed = known[k] if known else evaluate(batch)
        readings = np.array(batch.columns(model.channels))
        expected = base.whiten @ readings - residual
        for block, (_, at) in zip(batch.blocks, batch.parts(), strict=True):
            if block.run in runs:
                used = np.ones(at.stop - at.start, bool) if weights is None else weights[at] > 0
                yield Piece(
                    block.run, block.data["t_s"], residual[:, at], expected[:, at], speed[:, at],
                    readings[:, at], used, dict(block.data),
                )  # fmt: skip


def _beside(base: Base) -> tuple[Any, tuple[str, ...]]:
    """Return the log with the columns that a residual is looked at beside, and their names."""
    model = base.model
    rates = (rate(c, order) for order in range(4) for c in model.references)
    extra = (*rates, campaign_time(), run_time())
    log = extended(base.log, model.with_columns(*extra), base.sigma, base.values)
    wanted = (*columns_of(model), *(c.name for c in extra), "t_s", "temperature_degc")
    return log, tuple(dict.fromkeys(c for c in wanted if c in log.columns))


def forget_candidates(base: Base) -> None:
    """Free the columns that models without a place in `base` read: together they are larger than the log."""
    forget(*_beside(base))


@found_once
def _kept(base: Base, _: frozenset[int]) -> list[tuple[np.ndarray, np.ndarray]]:
    model = base.model.with_columns(*map(rate, base.model.references))
    return list(map(_residual_of(base), base.batches(model)))


def _residual_of(base: Base) -> Callable[[Batch], tuple[np.ndarray, np.ndarray]]:
    """Compile the whitened residual of a batch and the rate of the expected reading, (K, n)."""
    model, whiten = base.model, base.whiten
    run = model.remember("reading and its rate", lambda: _reading_and_rate(model))
    rates = [rate(c).name for c in model.references]

    def evaluate(batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        pose, state = batch.columns(model.references), batch.columns(model.state)
        expected, moved = run(base.p, base.offsets_of(batch), pose, state, batch.columns(rates))
        return whiten @ (np.array(batch.columns(model.channels)) - expected), whiten @ moved

    return evaluate


def _reading_and_rate(model: Model) -> Callable[..., list[np.ndarray]]:
    s = model.symbols
    reading = s.full(s.reading)
    velocity = ca.SX.sym("velocity", len(model.references))
    slope = ca.jacobian(reading, s.pose) @ velocity
    inputs = [s.parameters, s.offsets, s.pose, s.state, velocity]
    return on_arrays(ca.Function("residual", inputs, [ca.densify(reading), ca.densify(slope)]))
