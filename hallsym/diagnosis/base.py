"""A fitted model on a log: what every residual, derivative and error of a diagnosis is evaluated at."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hallsym.log import Log
from hallsym.log.batches import Batch, Weigh
from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Base:
    """A fitted model on a log, as the fit left it or with effects added.

    `p`: (n,) values; `zeros`: displacement by run; `covariance`: (K, K) of one residual; `free`: index of
    parameters that the fit moves; `pose_weights`: (n_pose,) of the pose metric; `apart`: held-out runs;
    `timed`: whether the log holds time, and not a counter in its place.
    """

    log: Log
    model: Model
    p: np.ndarray
    zeros: Mapping[int, np.ndarray]
    covariance: np.ndarray
    free: tuple[int, ...]
    pose_weights: np.ndarray
    apart: frozenset[int]
    sigma: Mapping[str, float]
    keep: Weigh | None = None
    timed: bool = True

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

    def zeros_in(self, run: int) -> np.ndarray:
        """Return the zero deviations of a run, (zeros,); nil of one that was not fitted."""
        return self.zeros.get(run, np.zeros(len(self.model.zeros)))

    def zeros_of(self, batch: Batch) -> np.ndarray:
        """Return the zero deviations of every sample of a batch, (zeros, samples)."""
        own = np.array([self.zeros_in(block.run) for block in batch.blocks])
        return np.repeat(own, np.diff(batch.edges), axis=0).T
