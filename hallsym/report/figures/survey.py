"""One pass over a log: what its pictures show, for any number of samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import ErrorTable, columns_of, decoder
from hallsym.log import Block, Log
from hallsym.log.batches import SIZE, Weigh
from hallsym.log.derived import extended
from hallsym.log.phase import designed, near
from hallsym.report.figures.trace import Trace


@dataclass
class _Run:
    """What a picture has to know of one run; the pairs hold the designed and the fitted model."""

    start: int
    first_state: np.ndarray
    zeros: np.ndarray
    samples: int = 0
    kept: int = 0
    squares: Any = 0.0
    peak: Any = 0.0
    pose: list[np.ndarray] = field(default_factory=list)
    state: list[np.ndarray] = field(default_factory=list)
    state_sum: Any = 0.0


@dataclass(frozen=True, eq=False)
class Survey:
    """A log as its pictures need it, for any number of samples.

    `edges`: (runs + 1,) sample numbers where runs begin. `travel`: (runs, n_pose) reference's least to
    greatest value. `state`: (runs, n_state) mean vertical state, `drift` its travel.
    `reach`: (n_pose + n_state, 2) least and greatest value of reference and state over all runs. `errors`:
    traces of the designed and the fitted model, `time`: trace of `t_s` if it is logged, `rejected`: 1 where
    samples were.
    """

    runs: tuple[int, ...]
    edges: np.ndarray
    travel: np.ndarray
    state: np.ndarray
    drift: np.ndarray
    reach: np.ndarray
    designed: ErrorTable
    fitted: ErrorTable
    errors: tuple[Trace, Trace]
    time: Trace | None
    rejected: Trace
    n_rejected: int


class Decode:
    """Pose of a block by the designed and by the fitted model, each (n_pose, samples)."""

    def __init__(self, fit: Fit) -> None:
        """Compile the decoder of the fit's model."""
        self.fit, self.model = fit, fit.model
        self.run = decoder(fit.model, np.array([fit.noise[c].value ** 2 for c in fit.model.channels]))

    def zeros(self, run: int, first_state: np.ndarray) -> np.ndarray:
        """Displacements delta / phi(0) of one run, Eq. (31)."""
        delta = self.fit.zeros.get(run)
        if delta is None or not len(self.model.zeros):
            return np.zeros(len(self.model.zeros))
        return np.asarray(delta) / self.model.zero_scale(self.fit.values, first_state)

    def __call__(self, block: Block, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose by the designed and by the fitted model; `block` holds the references too."""
        readings, state = (
            [block.data[c] for c in names] for names in (self.model.channels, self.model.state)
        )
        reference = np.array([block.data[c] for c in self.model.references])
        before = self.run(designed(self.model, self.fit.values), np.zeros_like(zeros), readings, state)
        after = self.run(self.fit.values, zeros, readings, state)
        return near(self.model, before, reference), near(self.model, after, reference)


def look_over(log: Log, fit: Fit, keep: Weigh | None = None) -> Survey:
    """Read `log` once and return what its pictures show."""
    model, decode = fit.model, Decode(fit)
    traces = Trace(len(model.pose), squares=True), Trace(len(model.pose), squares=True)
    time, rejected = Trace(1) if "t_s" in log.columns else None, Trace(1)
    columns = (*columns_of(model), *(("t_s",) if time else ()))
    runs: dict[int, _Run] = {}
    total = 0
    sigma = fit.noise.std
    wide = extended(log, model, sigma, model.named(fit.values))
    for block in wide.blocks(columns, size=SIZE):
        reference = np.array([block.data[c] for c in model.references])
        n = reference.shape[1]
        state = np.array([block.data[c] for c in model.state]).reshape(len(model.state), n)
        kept = np.ones(n, dtype=bool) if keep is None else keep(block) > 0
        if block.run not in runs:
            runs[block.run] = _Run(total, state[:, 0], decode.zeros(block.run, state[:, 0]))
        run = runs[block.run]
        errors = [pose - reference for pose in decode(block, run.zeros)]
        for trace, error in zip(traces, errors, strict=True):
            trace.add(np.where(kept, error, np.nan))
        if time:
            time.add(block.data["t_s"][None])
        rejected.add(np.where(kept, np.nan, 1.0)[None])
        _gather(run, np.array(errors)[:, :, kept], reference[:, kept], state[:, kept])
        run.samples += n
        total += n
    return _survey(fit, runs, total, traces, time, rejected)


def _gather(run: _Run, errors: np.ndarray, reference: np.ndarray, state: np.ndarray) -> None:
    if not reference.shape[1]:
        return
    run.kept += reference.shape[1]
    run.squares = run.squares + np.einsum("vij,vij->vi", errors, errors)
    run.peak = np.maximum(run.peak, np.abs(errors).max(axis=2))
    run.pose = _extent(run.pose, reference)
    run.state = _extent(run.state, state)
    run.state_sum = run.state_sum + state.sum(axis=1)


def _extent(before: list[np.ndarray], values: np.ndarray) -> list[np.ndarray]:
    low, high = values.min(axis=1), values.max(axis=1)
    return [np.minimum(before[0], low), np.maximum(before[1], high)] if before else [low, high]


def _survey(
    fit: Fit,
    runs: Mapping[int, _Run],
    total: int,
    errors: tuple[Trace, Trace],
    time: Trace | None,
    rejected: Trace,
) -> Survey:
    found, n, k = list(runs.values()), len(fit.model.pose), len(fit.model.state)
    count = np.array([r.kept for r in found], dtype=float)
    squares = np.array([r.squares if r.kept else np.zeros((2, n)) for r in found])
    peak = np.array([r.peak if r.kept else np.zeros((2, n)) for r in found])
    tables = [ErrorTable(fit.model.pose, tuple(runs), count, squares[:, v], peak[:, v]) for v in (0, 1)]
    return Survey(
        runs=tuple(runs),
        edges=np.array([*(r.start for r in found), total]),
        travel=np.array([r.pose[1] - r.pose[0] if r.kept else np.zeros(n) for r in found]),
        state=np.array([r.state_sum / r.kept if r.kept else r.first_state for r in found]),
        drift=np.array([r.state[1] - r.state[0] if r.kept else np.zeros(k) for r in found]),
        reach=_reach([r for r in found if r.kept], n + k),
        designed=tables[0],
        fitted=tables[1],
        errors=errors,
        time=time,
        rejected=rejected,
        n_rejected=int(total - count.sum()),
    )


def _reach(runs: Sequence[_Run], size: int) -> np.ndarray:
    if not runs:
        return np.zeros((size, 2))
    low, high = (np.array([np.append(r.pose[end], r.state[end]) for r in runs]) for end in (0, 1))
    return np.column_stack([low.min(axis=0), high.max(axis=0)])


def held_out(fit: Fit) -> tuple[int, ...]:
    """Held-out runs, also of a fit that was read back."""
    return fit.errors.holdout if fit.errors else tuple(fit.log.get("holdout", ()))
