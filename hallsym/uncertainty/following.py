"""Uncertainty along a curve that the machine follows: e_position = e_machine + e_curve.

Micromachines 2019, 10(9), 597, Eq. (15), doi:10.3390/mi10090597. The error of a curve, bounded or estimated,
counts whole as a standard uncertainty in every length that it moves, as in the article: a limit that is
reached in one direction at a few places stands for all of them, which is on the safe side.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.records import named
from hallsym.trajectory import Curve
from hallsym.uncertainty.gum import Budget, Source
from hallsym.uncertainty.inputs import check_fit
from hallsym.uncertainty.position import expanded_at, place
from hallsym.uncertainty.settings import Settings

PLACES = 501
"""Places along a curve at which the uncertainty is worked out, evenly over its parameter."""
TOP, ALIKE = 0.1, 0.01
"""The worst part of a path: where U is in the upper tenth of its range; none if it varies by under 1 %."""
SOURCE = "curve"


def curve_error(curve: Curve, column: str) -> float:
    """Return the standard uncertainty that a curve adds to a coordinate [m or rad], 0 where it has none.

    Raises `InputError` for a curve whose error is not known.
    """
    if column not in curve.coordinates:
        return 0.0
    error = curve.max_error_m if column.endswith("_m") else curve.source.get("max_error_rad")
    if error is None:
        what = "angle" if column.endswith("_rad") else "position"
        raise InputError(
            f"The curve does not state its error in {what}; make it with 'hallsym trajectory', which does."
        )
    return float(error)


def with_curve(budget: Budget, curve: Curve, column: str | None = None) -> Budget:
    """Return a budget with the error of a curve as one more source; of lengths where no `column` is named.

    Raises `InputError` for a budget that is not of a length.
    """
    if column is None and budget.unit != "m":
        raise InputError(
            f"A curve adds to a budget of a length; that of {budget.quantity!r} is in {budget.unit}."
        )
    if any(source.name == SOURCE for source in budget.sources):
        raise InputError(f"The budget of {budget.quantity!r} has a source {SOURCE!r} already; rename it.")
    error = curve_error(curve, column or next(c for c in curve.coordinates if c.endswith("_m")))
    correlation = budget.correlation
    if correlation is not None:
        n = len(correlation)
        correlation = np.block([[correlation, np.zeros((n, 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    sources = (*budget.sources, Source.normal(SOURCE, error, budget.unit))
    return replace(budget, sources=sources, correlation=correlation)


@dataclass(frozen=True, eq=False)
class AlongCurve:
    """U of every pose coordinate along a curve, in the units of `pose`.

    `parameter`, `travelled_m`: (s,) parameter of the curve and length of path up to there. `at`: pose and
    state column -> (s,). `machine`: (n_pose, s) U of the decoded position alone, `total`: with the curve.
    `error`: pose column -> standard uncertainty of the curve.
    """

    pose: tuple[str, ...]
    parameter: np.ndarray
    travelled_m: np.ndarray
    at: Mapping[str, np.ndarray]
    machine: np.ndarray
    total: np.ndarray
    error: Mapping[str, float]
    turning: Collection[str] = ()

    def worst(self, column: str) -> int:
        """Return the index of the place where a coordinate is known worst."""
        return int(np.argmax(self.total[self.pose.index(column)]))

    def position(self, index: int) -> dict[str, float]:
        """Return pose and state at a place, SI."""
        return {column: float(values[index]) for column, values in self.at.items()}

    def worst_part(self, column: str) -> tuple[float, float] | None:
        """Return the stretch about the worst place where U is in the upper tenth of its range [m].

        None where U varies by less than 1 % along the curve.
        """
        U, k = self.total[self.pose.index(column)], self.worst(column)
        if np.ptp(U) < ALIKE * U[k]:
            return None
        below = np.flatnonzero(U[k] - TOP * np.ptp(U) > U)
        first = int(below[below < k].max(initial=-1)) + 1
        last = int(below[below > k].min(initial=len(U))) - 1
        return float(self.travelled_m[first]), float(self.travelled_m[last])

    def spans(self) -> dict[str, tuple[float, float]]:
        """Return least and greatest value of each pose and state column along the curve."""
        return {column: (float(v.min()), float(v.max())) for column, v in self.at.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers in SI for JSON."""
        worst = {}
        for row, column in enumerate(self.pose):
            k = self.worst(column)
            worst[column] = {
                "at": self.position(k),
                "parameter": float(self.parameter[k]),
                "travelled_m": float(self.travelled_m[k]),
                "part_m": self.worst_part(column),
                "expanded_uncertainty": float(self.total[row, k]),
                "without_curve": float(self.machine[row, k]),
            }
        return {
            "length_m": float(self.travelled_m[-1]),
            "curve_error": dict(self.error),
            "rms": named(self.pose, np.sqrt(np.mean(self.total**2, axis=1))),
            "worst": worst,
        }


def along_curve(
    fit: Fit,
    curve: Curve,
    at: Mapping[str, float] | None = None,
    settings: Settings | None = None,
    *,
    places: int = PLACES,
) -> AlongCurve:
    """Return U of the position along a curve that the machine follows, with the error of the curve.

    `at`: pose or state column -> value in SI of what the curve does not move, 0 where not given. Raises
    `InputError` for a curve that moves what the model has not, and for one whose error is not known.
    """
    settings, model = settings or Settings(), fit.model
    check_fit(fit)
    columns, at = (*model.pose, *model.state), dict(at or {})
    place(model, at)
    for column in curve.coordinates:
        if column not in columns:
            raise InputError(
                f"The curve moves {column}, which {model.name} has not; it has {', '.join(columns)}."
            )
        if column in at:
            raise InputError(f"{column} is given as {at[column]:g}, but the curve moves it; leave it out.")
    parameter = np.linspace(curve.start, curve.stop, places)
    moved = dict(zip(curve.coordinates, curve(parameter).T, strict=True))
    where = {c: moved.get(c, np.full(places, at.get(c, 0.0))) for c in columns}
    pose = np.array([where[c] for c in model.pose])
    state = np.array([where[c] for c in model.state]).reshape(len(model.state), places)
    error = {c: curve_error(curve, c) for c in model.pose}
    added = np.array([error[c] for c in model.pose])
    steps = np.linalg.norm(np.diff(curve(parameter)[:, curve.lengths], axis=0), axis=1)
    return AlongCurve(
        pose=model.pose,
        parameter=parameter,
        travelled_m=np.r_[0.0, np.cumsum(steps)],
        at=where,
        machine=expanded_at(fit, pose, state, settings).T,
        total=expanded_at(fit, pose, state, settings, added).T,
        error=error,
        turning=model.period,
    )
