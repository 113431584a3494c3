"""Simulated rings with their truth: one field under several Halls, and a rotor that ripples.

The bundled log `data/ring/log.csv` is `bundled()`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.estimation.self_calibration import TURN, Plane, columns, phasors

HALLS = (0.0, TURN / 3, 2 * TURN / 3)
ONE = np.radians(1.0)


@dataclass(frozen=True, eq=False)
class Ring:
    """A field c_n (waves,) seen by Halls at `places` with offsets and gains of their own."""

    pairs: int
    field: np.ndarray
    places: np.ndarray
    offsets: np.ndarray
    gains: np.ndarray

    def readings(self, theta: np.ndarray) -> np.ndarray:
        """Return readings (samples, Halls) at true angles (samples,)."""
        n = np.arange(1, len(self.field) + 1)
        return np.stack(
            [
                o + g * (np.exp(1j * np.multiply.outer(theta + p, n)) @ self.field).real
                for p, o, g in zip(self.places, self.offsets, self.gains, strict=True)
            ],
            axis=1,
        )

    def table(self, plane: Plane, count: int) -> np.ndarray:
        """Return the true table (count,) of the angle that a plane decodes."""
        theta = np.arange(4096) * TURN / 4096
        u = plane.phase(self.readings(theta)) / self.pairs
        at = np.hstack([columns(u, np.arange(1, count + 1)), np.ones((4096, 1))])
        weight = np.sqrt(np.gradient(u))
        found = np.linalg.lstsq(at * weight[:, None], (theta - u) * weight, rcond=None)[0]
        return phasors(found[:-1])


def ring(
    seed: int, pairs: int = 1, places: Sequence[float] = HALLS, size: float = 0.03, jitter: float = 0.02
) -> Ring:
    """Return a ring whose field has waves beside the fundamental of about `size`; places are electrical."""
    rng = np.random.default_rng(seed)
    n = np.arange(1, 4 * pairs + 8)
    field = size * (rng.standard_normal(len(n)) + 1j * rng.standard_normal(len(n))) / (1 + abs(n - pairs))
    field[pairs - 1] = 1.0
    count = len(places)
    return Ring(
        pairs, field, (np.array(places) + jitter * rng.standard_normal(count)) / pairs,
        0.03 * rng.standard_normal(count), 1 + 0.05 * rng.standard_normal(count),
    )  # fmt: skip


def motion(
    turns: float,
    rows: int,
    speed: float = 1.0,
    cogging: float = 0.0,
    kinematic: float = 0.0,
    order: int = 4,
    direction: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and true angles, `rows` a turn at speed 1; `cogging` falls with the speed squared."""
    time = np.arange(int(turns * rows / speed)) / rows
    base = 0.3 + direction * TURN * speed * time
    ripple = cogging / speed**2 * np.cos(order * base + 0.7) + kinematic * np.cos(order * base - 1.1)
    return time, base + ripple


def recorded(
    own: Ring, seed: int, rows: int = 1200, noise: float = 0.002, **kind: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and readings of a run."""
    time, theta = motion(rows=rows, **kind)
    x = own.readings(theta)
    return time, x + noise * np.random.default_rng(1000 + seed).standard_normal(x.shape)


def bundled() -> np.ndarray:
    """Return the counts (rows, 3) of `data/ring/log.csv`: 4 pole pairs, a drive with .1 deg at wave 10."""
    own = ring(7, pairs=4, places=np.radians([0.0, 101.0, 262.0]))
    _, x = recorded(own, 7, rows=600, turns=5.1, kinematic=0.1 * ONE, order=10)
    return np.round(2048 + 900 * x).astype(int)
