"""The recorded workspace, thinned, and what a change of each parameter does to the decoded pose over it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.estimation.decoding import columns_of
from hallsym.estimation.likelihood import Cost
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.influence import influence

SAMPLES = 2000
"""Poses that stand for the workspace of a log."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses that a log visited: `pose` (n_pose, s), `state` (n_state, s), `runs` (s,)."""

    pose: np.ndarray
    state: np.ndarray
    runs: np.ndarray


def visited(
    log: Log,
    model: Model,
    most: int = SAMPLES,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> Workspace:
    """Return about `most` poses of `log`, evenly spread over its samples; one pass over the log.

    `sigma`: noise by column, `values`: parameters by name, for the columns that are computed.
    """
    step = max(1, -(-log.rows // most))
    pose: list[np.ndarray] = []
    state: list[np.ndarray] = []
    runs: list[np.ndarray] = []
    offset = 0
    for batch in batches(extended(log, model, sigma, values), columns_of(model)):
        pick = slice(offset, None, step)
        number = np.repeat([block.run for block in batch.blocks], np.diff(batch.edges))
        runs.append(number[pick])
        pose.append(_rows(batch.columns(model.references), pick, len(runs[-1])))
        state.append(_rows(batch.columns(model.state), pick, len(runs[-1])))
        offset = (offset - len(batch)) % step
    return Workspace(np.hstack(pose), np.hstack(state), np.concatenate(runs))


def _rows(columns: Sequence[np.ndarray], pick: slice, n: int) -> np.ndarray:
    return np.array([c[pick] for c in columns]) if columns else np.zeros((0, n))


@dataclass(frozen=True, eq=False)
class Change:
    """How far the decoded pose moves [unit of each pose column] when something changes: over a workspace."""

    rms: Mapping[str, float]
    worst: Mapping[str, float]

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Return `{x_m: {rms, worst}, ...}`."""
        return {c: {"rms": self.rms[c], "worst": self.worst[c]} for c in self.rms}


@dataclass(frozen=True, eq=False)
class Slopes:
    """d pose / d parameters over a workspace, (s, n_pose, n), the zero deviations held."""

    pose: tuple[str, ...]
    slopes: np.ndarray

    def change(self, step: np.ndarray) -> Change:
        """Return what the parameter step (n,) does to the decoded pose."""
        moved = self.slopes @ step
        return Change(
            dict(zip(self.pose, np.sqrt(np.mean(moved**2, axis=0)).tolist(), strict=True)),
            dict(zip(self.pose, np.abs(moved).max(axis=0).tolist(), strict=True)),
        )

    def spread(self, covariance: np.ndarray) -> Change:
        """Return the standard uncertainty of the decoded pose that a covariance (n, n) leaves."""
        variance = np.einsum("spi,ij,spj->sp", self.slopes, covariance, self.slopes)
        variance = np.maximum(variance, 0.0)
        return Change(
            dict(zip(self.pose, np.sqrt(variance.mean(axis=0)).tolist(), strict=True)),
            dict(zip(self.pose, np.sqrt(variance.max(axis=0)).tolist(), strict=True)),
        )


def slopes_over(workspace: Workspace, cost: Cost, p: np.ndarray) -> Slopes:
    """Return the slopes of the decoded pose with the parameters at every pose of a workspace."""
    model, summary = cost.summary.model, cost.summary
    own = dict(zip(summary.runs, cost.at(p).zeros, strict=True))
    none = np.zeros(len(model.zeros))
    zeros = np.array([own.get(int(run), none) for run in workspace.runs]).T
    found = influence(model, p, zeros, workspace.pose, workspace.state, 1.0 / cost.reading_variance)
    return Slopes(model.pose, found.parameters)
