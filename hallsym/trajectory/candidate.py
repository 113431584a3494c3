"""One row of the table of methods, all of them, and which is best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.methods import Method


@dataclass(frozen=True, eq=False)
class Candidate:
    """One method on one spacing of points: its curve and error, or the reason why there is none.

    `error_m`: upper bound, or estimate; `at_least_m`: what it certainly reaches, None of an estimate.
    `between_m`: upper bound between the first and the last point, where these are not the ends of the range.
    """

    method: Method
    nodes: str
    points: int
    curve: Curve | None
    error_m: float
    at_least_m: float | None = None
    reason: str = ""
    rotation_rad: float | None = None
    between_m: float | None = None

    @property
    def control_points(self) -> int:
        """Number of control points, or of values."""
        return 0 if self.curve is None else self.curve.control_points

    @property
    def numbers(self) -> int:
        """How many numbers a controller has to store."""
        return 0 if self.curve is None else self.curve.form.numbers

    def to_dict(self) -> dict[str, Any]:
        """Return the row as a record."""
        return {
            "method": self.method.name,
            "nodes": self.nodes,
            "points": self.points,
            "control_points": self.control_points,
            "numbers": self.numbers,
            "max_error_m": self.error_m if np.isfinite(self.error_m) else None,
            "at_least_m": self.at_least_m,
            "max_error_between_points_m": self.between_m,
            "max_error_rad": self.rotation_rad,
            "reason": self.reason,
        }


@dataclass(frozen=True, eq=False)
class Choice:
    """All candidates, and the best: within the tolerance with the fewest numbers, else most exact."""

    candidates: tuple[Candidate, ...]
    best: Candidate
    tolerance_m: float | None
    kind: str  # "bounded" or "estimated"
    notes: tuple[str, ...] = ()

    @property
    def curve(self) -> Curve:
        """The chosen curve."""
        assert self.best.curve is not None
        return self.best.curve

    def meets(self, candidate: Candidate) -> bool:
        """Whether a candidate holds the tolerance; True where none is stated."""
        limit = np.inf if self.tolerance_m is None else self.tolerance_m
        return candidate.curve is not None and candidate.error_m <= limit

    def to_dict(self) -> dict[str, Any]:
        """Return the choice as a record."""
        return {
            "method": self.best.method.name,
            "nodes": self.best.nodes,
            "points": self.best.points,
            "control_points": self.best.control_points,
            "max_error_m": self.best.error_m if np.isfinite(self.best.error_m) else None,
            "at_least_m": self.best.at_least_m,
            "max_error_between_points_m": self.best.between_m,
            "max_error_rad": self.best.rotation_rad,
            "error_kind": self.kind,
            "tolerance_m": self.tolerance_m,
            "within_tolerance": None if self.tolerance_m is None else self.meets(self.best),
            "methods": [c.to_dict() for c in self.candidates],
            "notes": list(self.notes),
        }


def best_of(candidates: Sequence[Candidate], tolerance: float | None) -> Candidate:
    """Return the candidate to use; raises `InputError` if none was made, or none holds `tolerance`."""
    made = [c for c in candidates if c.curve is not None and np.isfinite(c.error_m)]
    if not made:
        raise InputError(_why_none(candidates))
    if tolerance is None:
        return min(made, key=lambda c: c.error_m)
    held = [c for c in made if c.error_m <= tolerance]
    if not held:
        least = min(made, key=lambda c: c.error_m)
        raise InputError(
            f"No curve holds {1e6 * tolerance:.4g} um: the nearest is {least.method.name} with "
            f"{least.points} "
            f"points, {1e6 * least.error_m:.4g} um; give more points or allow a larger tolerance."
        )
    return min(held, key=lambda c: c.numbers)


def _why_none(candidates: Sequence[Candidate]) -> str:
    """Return the sentence for no curve at all: a method's own, else what the first one says."""
    sentences = [c.reason for c in candidates if c.reason[:1].isupper()]
    if sentences:
        return sentences[0]
    if not candidates:
        return "No method is left: the options exclude each other."
    return (
        f"No method makes a curve of this; {candidates[0].method.name}: {candidates[0].reason.rstrip('.')}."
    )
