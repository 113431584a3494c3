"""The reference decoder of six coordinates: weighted least squares over all readings, converged in double."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.model import Model
from hallsym.model.arrays import on_arrays

BATCH = 2048
"""Samples that the reference decoder takes at a time."""
NEWTON = 3
"""Steps from the closed form: each leaves a thousandth of what the one before did, or less."""


@dataclass(frozen=True, eq=False)
class Reference(ABC):
    """A model of six coordinates at parameters `p`, over poses `middle` +- `half` (6,)."""

    model: Model
    p: np.ndarray
    weight: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    accuracy: np.ndarray
    """What terms may leave of each coordinate (6,)."""
    memory: dict = field(default_factory=dict, kw_only=True)
    """Trial poses and their readings by seed and number, the same whatever is chosen for a decoder."""

    @abstractmethod
    def decoded(self, readings: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses (6, s) as the generated code computes them, functions exact."""

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return on_arrays(self.model.reading)

    @cached_property
    def _slopes(self) -> Callable[..., list[np.ndarray]]:
        """Poses -> d readings / d pose, column by column."""
        pose = ca.SX.sym("pose", 6)
        readings = self.model.reading(self.p, np.zeros(len(self.model.zeros)), pose, [])
        return on_arrays(ca.Function("slopes", [pose], [ca.densify(ca.vec(ca.jacobian(readings, pose)))]))

    def readings(self, pose: np.ndarray) -> np.ndarray:
        """Return readings (n, s) at poses (6, s)."""
        return np.asarray(self._run(self.p, np.zeros(len(self.model.zeros)), list(pose), [])[0])

    def poses(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random poses of the box, corners among them."""
        share = rng.uniform(-1, 1, (6, count))
        share[:, : count // 20] = np.sign(share[:, : count // 20])
        return np.asarray(self.middle[:, None] + self.half[:, None] * share)

    def trials(self, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return random poses (6, s) of the box and their readings (n, s)."""
        if (seed, count) not in self.memory:
            pose = self.poses(np.random.default_rng(seed), count)
            self.memory[seed, count] = pose, self.readings(pose)
        return self.memory[seed, count]

    def solved(self, readings: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses (6, s) of weighted least squares over all channels: the reference decoder.

        `near` (2, s): places in the period that is meant; the middle of the box without it.
        """
        parts = []
        for first in range(0, readings.shape[1], BATCH):
            part = slice(first, first + BATCH)
            parts.append(self._solved(readings[:, part], None if near is None else near[:, part]))
        return np.hstack(parts)

    def _solved(self, readings: np.ndarray, near: np.ndarray | None) -> np.ndarray:
        """Steps with the slopes at the closed form, which is within some um of the solution."""
        n, root = len(self.model.channels), np.sqrt(self.weight)[:, None]
        with np.errstate(all="ignore"):
            pose = np.clip(np.nan_to_num(self.decoded(readings, near)), -1e3, 1e3)
            scaled = (np.asarray(self._slopes(list(pose))[0]).reshape(6, n, -1) * root).transpose(2, 0, 1)
            left = scaled @ scaled.transpose(0, 2, 1)  # s, 6, 6
            bad = ~np.isfinite(left).all(axis=(1, 2))
            left[bad], scaled[bad] = np.eye(6), 0.0
            left = left + np.eye(6) * 1e-14 * np.trace(left, axis1=1, axis2=2)[:, None, None]
            inverse = np.linalg.inv(left) @ scaled  # s, 6, n
            for _ in range(NEWTON):
                off = np.nan_to_num(readings - self.readings(pose), posinf=0.0, neginf=0.0)
                pose = pose + (inverse @ (root * off).T[..., None])[..., 0].T
        return np.asarray(pose)
