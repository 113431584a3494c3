"""What a curve costs the position, e_position = e_machine + e_curve (Eq. (15)), and what points are worth.

The article's e_stage is the error of the machine that follows the curve, its e_trajectory that of the curve.
As uncertainties the two add in squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, sqrt
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.choose import choose_curve, method_named
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.nominal import nominal

SHARE = 0.02
"""What a curve may add to the uncertainty of the machine before more control points are worth having."""
ROWS, FEW = 8, 30
"""How many numbers of points are tried: one by one up to `FEW`, else from a third of the curve's own."""


@dataclass(frozen=True)
class Worth:
    """What a curve with so many control points does to the position: `gain_m` is what the last step saved."""

    control_points: int
    error_m: float
    expanded_m: float
    gain_m: float


@dataclass(frozen=True, eq=False)
class CurveCost:
    """What a curve adds to the expanded uncertainty of the machine that follows it.

    `machine_m`, `total_m`: without and with the curve [m], coverage factor `coverage`. `rows`: what other
    numbers of control points are worth, empty for a curve made of points.
    """

    curve: Curve
    machine_m: float
    total_m: float
    coverage: float
    rows: tuple[Worth, ...]

    @property
    def growth_m(self) -> float:
        """What the curve adds [m]."""
        return self.total_m - self.machine_m

    @property
    def allowed_m(self) -> float:
        """Error of a curve that adds 2 % [m]."""
        return self.machine_m * sqrt((1 + SHARE) ** 2 - 1) / self.coverage

    @property
    def enough(self) -> Worth | None:
        """The fewest control points whose curve adds at most 2 %, None where that is not known."""
        return next((row for row in self.rows if row.expanded_m <= self.machine_m * (1 + SHARE)), None)

    def to_dict(self) -> dict[str, Any]:
        """Return the record for JSON, SI."""
        found = self.enough
        return {
            "method": self.curve.method,
            "control_points": self.curve.control_points,
            "max_error_m": self.curve.max_error_m,
            "error_kind": self.curve.error_kind,
            "coverage_factor": self.coverage,
            "expanded_without_curve_m": self.machine_m,
            "expanded_with_curve_m": self.total_m,
            "growth_m": self.growth_m,
            "allowed_error_m": self.allowed_m,
            "enough_control_points": None if found is None else found.control_points,
            "worth": [vars(row) for row in self.rows],
        }


def curve_cost(curve: Curve, machine_m: float, coverage: float = 2.0) -> CurveCost:
    """Return what a curve costs a machine of expanded uncertainty `machine_m` [m], and what points are worth.

    The largest error of the curve counts as its standard uncertainty. Raises `InputError` for a curve whose
    error is not known.
    """
    if curve.max_error_m is None:
        raise InputError("The curve does not state its error; make it with 'hallsym trajectory', which does.")
    if not (machine_m > 0 and 0 < coverage < inf):
        raise InputError("The uncertainty of the machine and the coverage factor must be positive.")
    total = hypot(machine_m, coverage * curve.max_error_m)
    rows: list[Worth] = []
    for count, error in _errors(curve):
        expanded = hypot(machine_m, coverage * error)
        rows.append(Worth(count, error, expanded, rows[-1].expanded_m - expanded if rows else 0.0))
    return CurveCost(curve, machine_m, total, coverage, tuple(rows))


def _errors(curve: Curve) -> list[tuple[int, float]]:
    """Control points and error of the curve made of its expression by other counts, none of one of points.

    Counts go up to its own and two further.
    """
    made_of = curve.source
    if "curve" not in made_of:
        return []
    span = (str(made_of["parameter"]), repr(curve.start), repr(curve.stop))
    source, method = nominal(made_of["curve"], span, made_of["values"]), method_named(curve.method)
    own = curve.control_points if method.fitted else int(made_of["points"])
    least = max(own - ROWS + 3 if own <= FEW else own // 3, method.least, 3)
    counts = range(least, own) if own <= FEW else np.geomspace(least, own, ROWS - 2).round().astype(int)
    errors: dict[int, float] = {}
    for count in sorted({*map(int, counts), own, own + 1, own + 2}):
        points, control = (None, count) if method.fitted else (count, None)
        try:
            best = choose_curve(source, points=points, control=control, method=method.name).best
        except InputError:  # a count of which the method makes no curve
            continue
        errors[best.to_dict()["control_points"]] = best.error_m
    return sorted(errors.items())
