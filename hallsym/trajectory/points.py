"""Points that a curve shall pass, read from a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, require
from hallsym.files import MOST_NUMBER
from hallsym.log.formats import open_source
from hallsym.trajectory.factorisation import check_increasing
from hallsym.trajectory.nominal import COORDINATES
from hallsym.units import si_name, split_unit

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Points:
    """Points (N, d) in SI at increasing parameters t (N,)."""

    t: Array
    points: Array
    coordinates: tuple[str, ...]
    name: str = "points"
    notes: tuple[str, ...] = ()
    """Notes on the file."""

    @property
    def shares(self) -> Array:
        """Parameters scaled to [0, 1]."""
        return (self.t - self.t[0]) / (self.t[-1] - self.t[0])


def points_of(
    points: Array,
    t: Array | None = None,
    coordinates: tuple[str, ...] = ("x_m", "y_m"),
    name: str = "points",
) -> Points:
    """Return points with their parameters checked; without `t` it is the length of the chords up to each.

    Raises `InputError` for shapes that do not fit, numbers that are none, repeated or unordered parameters.
    """
    points = np.asarray(points, float)
    fit = points.ndim == 2 and points.shape[1] == len(coordinates) and len(points) >= 2
    require(fit, f"Table {name}", f"at least 2 rows of {', '.join(coordinates)}", f"shape {points.shape}")
    good = np.abs(points) <= MOST_NUMBER
    if not good.all():
        row = int(np.argwhere(~good)[0, 0])
        raise InputError(f"Point {row + 1} of {name} is not a finite number.")
    lengths = [k for k, c in enumerate(coordinates) if c.endswith("_m")]
    if t is None:
        steps = np.linalg.norm(np.diff(points[:, lengths], axis=0), axis=1)
        if (steps == 0).any():
            k = int(np.argmax(steps == 0))
            raise InputError(
                f"Points {k + 1} and {k + 2} of {name} are the same; take one out or give a column t."
            )
        t = np.r_[0.0, np.cumsum(steps)]
    t = np.asarray(t, float)
    if t.shape != (len(points),) or not np.isfinite(t).all():
        raise InputError(
            f"Parameters of {name} must be one finite number for each of its {len(points)} points."
        )
    check_increasing(t, name)
    return Points(t, points, tuple(coordinates), name)


def read_points(path: str | Path) -> Points:
    """Read points from a table in any format that `read_log` reads.

    Its columns are such as x_um, y_um, rz_urad, and t (or t_s, t_mm) if they have a parameter. Raises
    `InputError` for what cannot be read.
    """
    source = open_source(path).source
    path = Path(path)
    known = {name: _column(name, path) for name in source.names}
    if len({column for column, _ in known.values()}) < len(known):
        raise InputError(f"Points file {path} gives a column twice; keep one of each.")
    found = {known[name][0]: known[name][1] * v for name, v in source.read(source.names).items()}
    order = tuple(c for c in COORDINATES.values() if c in found)
    if not any(c.endswith("_m") for c in order):
        raise InputError(f"Points file {path} must have at least one of the columns x, y, z, such as x_um.")
    points = np.column_stack([found[c] for c in order])
    return replace(points_of(points, found.get("t"), order, path.name), notes=source.notes)


def _column(name: str, path: Path) -> tuple[str, float]:
    if name == "t" or name.startswith("t_"):
        return "t", 1.0
    found, unit = si_name(name), split_unit(name)[1]
    if unit is None or found not in COORDINATES.values():
        known = ", ".join(COORDINATES)
        raise InputError(
            f"Column {name!r} of {path} must be t, or one of {known} with its unit, such as x_um or rz_urad."
        )
    return found, unit.factor
