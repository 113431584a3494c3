"""What a curve costs the position, e_position = e_machine + e_curve (Eq. (15)), and what points are worth.

The article's e_stage is the error of the machine that follows the curve, its e_trajectory that of the curve.
As uncertainties the two add in squares.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.choose import of_nominal
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.methods import Method, method_named
from hallsym.trajectory.nominal import Nominal, nominal

Array = np.ndarray
SHARE = 0.02
"""What a curve may add to the uncertainty of the machine before more control points are worth having."""
ROWS, FEW = 8, 30
"""How many numbers of points `worth_of` tries: one by one up to `FEW`, else from a third of its own."""


def position_error(machine_m: Array | float, curve_m: Array | float) -> Array:
    """Return e_position = e_machine + e_curve, Eq. (15); both with the same sign, or magnitudes."""
    return np.asarray(machine_m, float) + np.asarray(curve_m, float)


def expanded(machine_m: Array | float, curve_m: Array | float, coverage: float = 2.0) -> Array:
    """Return the expanded uncertainty of a machine that follows a curve [m].

    `machine_m`: expanded uncertainty of the machine with the coverage factor `coverage`; `curve_m`: standard
    uncertainty of the curve. 500.94 nm grows by 9.9 nm for 50 nm.
    """
    machine, curve = np.asarray(machine_m, float), np.asarray(curve_m, float)
    if (machine < 0).any() or (curve < 0).any() or not 0 < coverage < inf:
        raise InputError("Uncertainties must be 0 or more, and the coverage factor positive.")
    return np.hypot(machine, coverage * curve)


@dataclass(frozen=True)
class Worth:
    """What a curve with so many control points does to the position: `gain_m` is what the last step saved."""

    control_points: int
    error_m: float
    expanded_m: float
    gain_m: float


def worth(
    machine_m: float, error: Callable[[int], float], counts: Sequence[int], coverage: float = 2.0
) -> tuple[Worth, ...]:
    """Return the marginal value of control points: expanded uncertainty for each count, and what it saves.

    `error(count)`: error of the curve with so many control points [m], taken as its standard uncertainty.
    """
    if not counts or list(counts) != sorted(set(counts)):
        raise InputError("Counts of control points must increase; there must be at least one.")
    rows: list[Worth] = []
    for count in counts:
        size = float(error(count))
        total = float(expanded(machine_m, size, coverage))
        rows.append(Worth(count, size, total, rows[-1].expanded_m - total if rows else 0.0))
    return tuple(rows)


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
        return allowed(self.machine_m, coverage=self.coverage)

    @property
    def enough(self) -> Worth | None:
        """The fewest control points whose curve adds at most 2 %, None where that is not known."""
        return enough(self.rows, self.machine_m)

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

    Raises `InputError` for a curve whose error is not known.
    """
    if curve.max_error_m is None:
        raise InputError("The curve does not state its error; make it with 'hallsym trajectory', which does.")
    total = float(expanded(machine_m, curve.max_error_m, coverage))
    return CurveCost(curve, machine_m, total, coverage, worth_of(curve, machine_m, coverage))


def worth_of(curve: Curve, machine_m: float, coverage: float = 2.0) -> tuple[Worth, ...]:
    """Return the value of control points for a curve made of an expression, by its own method and nodes.

    Counts go up to its own and two further. Nothing for a curve made of points: its expression is not known.
    """
    found = remade(curve)
    if found is None:
        return ()
    source, method, nodes = found
    own = curve.control_points if method.fitted else int(curve.source["points"])
    least = max(own - ROWS + 3 if own <= FEW else own // 3, method.least, 3)
    counts = range(least, own) if own <= FEW else np.geomspace(least, own, ROWS - 2).round().astype(int)
    errors: dict[int, float] = {}
    for count in sorted({*map(int, counts), own, own + 1, own + 2}):
        points, control = (None, count) if method.fitted else (count, None)
        try:
            best = of_nominal(source, points=points, control=control, methods=[method], nodes=nodes).best
        except InputError:  # a count of which the method makes no curve
            continue
        errors[best.control_points] = best.error_m
    return worth(machine_m, errors.__getitem__, sorted(errors), coverage) if errors else ()


def remade(curve: Curve) -> tuple[Nominal, Method, str] | None:
    """Return the expression, the method and the nodes that a curve was made with; None for one of points."""
    source: Mapping = curve.source
    if not {"curve", "values", "nodes", "points"} <= set(source):
        return None
    span = (str(source.get("parameter", "t")), repr(curve.start), repr(curve.stop))
    return nominal(source["curve"], span, source["values"]), method_named(curve.method), str(source["nodes"])


def enough(rows: Sequence[Worth], machine_m: float, share: float = SHARE) -> Worth | None:
    """Return the first count whose curve adds at most `share` to the uncertainty of the machine, or None."""
    if not 0 < share < inf:
        raise InputError(f"The share that a curve may add must be positive; got {share!r}.")
    return next((row for row in rows if row.expanded_m <= machine_m * (1 + share)), None)


def allowed(machine_m: float, share: float = SHARE, coverage: float = 2.0) -> float:
    """Return the error of a curve [m] that adds `share` to the expanded uncertainty of the machine."""
    if not (machine_m > 0 and 0 < share < inf):
        raise InputError("The uncertainty of the machine and the share must be positive.")
    return machine_m * sqrt((1 + share) ** 2 - 1) / coverage
