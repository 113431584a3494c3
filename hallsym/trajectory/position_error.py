"""What a curve costs the position, e_position = e_stage + e_trajectory (Eq. (15)), and its worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from hallsym.errors import InputError

Array = np.ndarray


def position_error(stage_m: Array | float, trajectory_m: Array | float) -> Array:
    """Return e_position = e_stage + e_trajectory, Eq. (15); both with the same sign, or magnitudes."""
    return np.asarray(stage_m, float) + np.asarray(trajectory_m, float)


def expanded(stage_m: Array | float, trajectory_m: Array | float, coverage: float = 2.0) -> Array:
    """Return the expanded uncertainty of the stage and of the trajectory's standard uncertainty together [m].

    `stage_m`: expanded uncertainty of the stage with the coverage factor `coverage`; `trajectory_m`: standard
    uncertainty of the curve. 500.94 nm grows by 9.9 nm for 50 nm.
    """
    stage, trajectory = np.asarray(stage_m, float), np.asarray(trajectory_m, float)
    if (stage < 0).any() or (trajectory < 0).any() or not 0 < coverage < inf:
        raise InputError("Uncertainties must be 0 or more, and the coverage factor positive.")
    return np.hypot(stage, coverage * trajectory)


@dataclass(frozen=True)
class Worth:
    """What a curve with so many control points does to the position: `gain_m` is what the last step saved."""

    control_points: int
    error_m: float
    expanded_m: float
    gain_m: float


def worth(
    stage_m: float, error: Callable[[int], float], counts: Sequence[int], coverage: float = 2.0
) -> tuple[Worth, ...]:
    """Return the marginal value of control points: expanded uncertainty for each count, and what it saves.

    `error(count)`: error of the curve with so many control points [m], taken as its standard uncertainty.
    """
    if not counts or list(counts) != sorted(set(counts)):
        raise InputError("Counts of control points must increase; there must be at least one.")
    rows: list[Worth] = []
    for count in counts:
        size = float(error(count))
        total = float(expanded(stage_m, size, coverage))
        rows.append(Worth(count, size, total, rows[-1].expanded_m - total if rows else 0.0))
    return tuple(rows)


def enough(rows: Sequence[Worth], stage_m: float, share: float = 0.02) -> Worth | None:
    """Return the first count whose curve adds at most `share` to the uncertainty of the stage, or None."""
    if not 0 < share < inf:
        raise InputError(f"The share that a curve may add must be positive; got {share!r}.")
    return next((row for row in rows if row.expanded_m <= stage_m * (1 + share)), None)


def allowed(stage_m: float, share: float = 0.02, coverage: float = 2.0) -> float:
    """Return the error of a curve [m] that adds `share` to the expanded uncertainty of the stage."""
    if not (stage_m > 0 and 0 < share < inf):
        raise InputError("The uncertainty of the stage and the share must be positive.")
    return stage_m * sqrt((1 + share) ** 2 - 1) / coverage


def along(
    points: Array, trajectory_m: float, uncertainty: Callable[[Array], Array], coverage: float = 2.0
) -> tuple[Array, int]:
    """Return the expanded uncertainty at points (N, d) of a path, and the index where it is worst.

    `uncertainty(points)`: expanded uncertainty of the stage at each (N,) [m], such as from its map.
    """
    total = expanded(uncertainty(np.asarray(points, float)), trajectory_m, coverage)
    return total, int(np.argmax(total))
