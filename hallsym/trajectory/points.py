"""Points that a curve shall pass, read from CSV."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, quoted, require
from hallsym.files import read_text, reading
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
    good = points.ndim == 2 and points.shape[1] == len(coordinates) and len(points) >= 2
    require(good, f"The {name}", f"at least 2 rows of {', '.join(coordinates)}", f"shape {points.shape}")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0, 0])
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


_NO_CSV = "is not CSV text"


def read_points(path: str | Path) -> Points:
    """Read points from CSV: columns such as x_um, y_um, rz_urad, and t (or t_s) if they have a parameter.

    The unit ends the name of a column. Raises `InputError` for what cannot be read.
    """
    text = read_text(path, "Points file", _NO_CSV, "copy it again", "give the path of a CSV file")
    path = Path(path)
    with reading(path, "Points file", _NO_CSV):
        rows = [row for row in csv.reader(io.StringIO(text, newline="")) if any(cell.strip() for cell in row)]
    rows = [row for row in rows if not row[0].lstrip().startswith("#")]
    if len(rows) < 3:
        raise InputError(f"Points file {path} must hold a line of column names and at least 2 points.")
    names = [name.strip() for name in rows[0]]
    columns = [_column(name, path) for name in names]
    si = [column for column, _ in columns]
    if len(set(si)) != len(si):
        raise InputError(f"Points file {path} gives a column twice; keep one of each.")
    order = [si.index(c) for c in COORDINATES.values() if c in si]
    if not any(si[k].endswith("_m") for k in order):
        raise InputError(f"Points file {path} must have at least one of the columns x, y, z, such as x_um.")
    numbered = enumerate(rows[1:], 1)
    table = np.array(
        [[_cell(row, k, number, names, path) for k in range(len(names))] for number, row in numbered]
    )
    made = points_of(
        table[:, order] * np.array([columns[k][1] for k in order]),
        table[:, si.index("t")] if "t" in si else None,
        tuple(si[k] for k in order),
        path.name,
    )
    torn = (
        f"the last line of {quoted(path.name)} does not end with a newline: if the file was cut short, its "
        "last point is wrong."
    )
    return made if text.endswith(("\n", "\r")) else replace(made, notes=(torn,))


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


def _cell(row: list[str], k: int, number: int, names: list[str], path: Path) -> float:
    try:
        value = float(row[k]) if len(row) == len(names) else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"Point {number} of {path} must have a finite number for {names[k]}; its line is {row}."
        )
    return value
