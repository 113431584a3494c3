"""The record by which a log is judged against a model: what its readings answered to the references, by run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Responses:
    """Slopes d reading / d reference of each run, by linear least squares, and what they leave.

    `slopes`, `std`: (runs, n_pose, n_channels), 0 for a reference that did not move. `moved`: (runs, n_pose).
    `unexplained`: (runs, n_channels) share of a reading's variance that the references leave, 0 where a
    channel hears only noise. `signal`: (runs, n_channels) variance of a reading over that of its noise.
    """

    model: Model
    runs: tuple[int, ...]
    slopes: np.ndarray
    std: np.ndarray
    moved: np.ndarray
    unexplained: np.ndarray
    signal: np.ndarray
