"""Every method side by side, and the one that holds a tolerance with the fewest numbers to store.

Where the nominal curve is an expression, each method gets the fewest points with which it holds, and its
error is bounded over the whole range. Where only points are given, the error is estimated by leaving out one
at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.bounds import Bound, bound
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.forms import RationalForm
from hallsym.trajectory.methods import METHODS, Method
from hallsym.trajectory.nominal import Nominal
from hallsym.trajectory.target import Target, resolution

LINEAR_SEARCH = 64
"""Up to so many points every count is tried; above, the least is found by bisection."""
MOST_FITTED = 40
"""Largest number of control points tried in least squares."""
FITTED_POINTS = 201
"""Points of a least-squares fit to an expression, unless stated."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One method on one spacing of points: its curve and error, or the reason why there is none.

    `error_m`: upper bound, or estimate; `at_least_m`: what it certainly reaches, None of an estimate.
    """

    method: Method
    nodes: str
    points: int
    curve: Curve | None
    error_m: float
    at_least_m: float | None = None
    reason: str = ""
    rotation_rad: float | None = None

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
    return f"No method makes a curve of this; {candidates[0].method.name}: {candidates[0].reason.rstrip('.')}."


def of_nominal(
    nominal: Nominal,
    tolerance: float | None = None,
    *,
    points: int | None = None,
    control: int | None = None,
    methods: Sequence[Method] = METHODS,
    nodes: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Return every method's curve for an expression, each with its bounded error.

    Give `tolerance` [m], `points`, or both; `points`: the count for every method instead of the least.
    `control`: control points of least squares.
    """
    if tolerance is None and points is None:
        raise InputError(
            "Give a --tolerance, or the number of --points; without either there is nothing to choose."
        )
    target = Target(nominal)
    held = resolution(target.grid[1])
    if tolerance is not None and tolerance < 4 * held:
        raise InputError(
            f"A tolerance of {1e6 * tolerance:.3g} um is below what float64 can hold of these coordinates, "
            f"{4e6 * held:.3g} um."
        )
    rows = []
    for method, spacing in _spacings(methods, nodes):
        progress(f"{method.words}, {spacing}")
        rows.append(_candidate(target, method, spacing, tolerance, points, control))
    if control is not None and not any(method.fitted for method in methods):
        raise InputError("--control belongs to least squares; choose bernstein-ls or trigonometric-ls.")
    return Choice(tuple(rows), best_of(rows, tolerance), tolerance, "bounded", _notes(rows))


def _spacings(methods: Sequence[Method], nodes: str | None) -> Iterator[tuple[Method, str]]:
    for method in methods:
        if nodes is None:
            yield from ((method, spacing) for spacing in method.nodes)
        elif method.anywhere or nodes in method.nodes:
            yield method, nodes


def _candidate(
    target: Target,
    method: Method,
    nodes: str,
    tolerance: float | None,
    points: int | None,
    control: int | None,
) -> Candidate:
    try:
        if tolerance is None or (points is not None and (control is not None or not method.fitted)):
            count = points or FITTED_POINTS
            if count > method.most and not method.fitted and method.name != "bernstein-lu":
                reason = f"not tried with more than {method.most} points"
                return Candidate(method, nodes, count, None, np.inf, reason=reason)
            _enough(method, count)
            size = _best_size(target, method, nodes, count) if method.fitted and control is None else control
            return _bounded(target, method, nodes, count, size or 0)
        return _least(target, method, nodes, tolerance, points, control)
    except InputError as error:
        return Candidate(method, nodes, points or 0, None, np.inf, reason=str(error))


def _best_size(target: Target, method: Method, nodes: str, count: int) -> int:
    """Return the number of control points with which a fit of `count` points comes nearest to the curve."""
    errors: list[float] = []
    for size in range(2, min(count, MOST_FITTED) + 1):
        errors.append(target.sampled(target.made(method, nodes, count, size)))
        if len(errors) > 5 and min(errors[-5:]) > min(errors):
            break
    return 2 + int(np.argmin(errors)) if errors else count


def _enough(method: Method, count: int) -> None:
    if count < method.least:
        raise InputError(f"The method {method.name} needs at least {method.least} points; there are {count}.")


def _bounded(target: Target, method: Method, nodes: str, count: int, control: int) -> Candidate:
    curve = target.made(method, nodes, count, control)
    if isinstance(curve.form, RationalForm) and target.sampled(curve) > 1e-3:
        raise InputError("The rational function has a pole in the range.")
    found: Bound = bound(curve, target.nominal)
    known = Curve(
        curve.form, curve.start, curve.stop, curve.coordinates, method.name, found.at_most, "bounded",
        {"curve": target.nominal.text, "values": dict(target.nominal.values), "nodes": nodes, "points":
        count}, )  # fmt: skip
    return Candidate(method, nodes, count, known, found.at_most, found.at_least, "", found.rotation_rad)


def _least(
    target: Target, method: Method, nodes: str, tolerance: float, points: int | None, control: int | None
) -> Candidate:
    """Return the candidate with the fewest points (control points of least squares) within the tolerance."""

    def size(count: int) -> tuple[int, int]:
        return (points or FITTED_POINTS, count) if method.fitted else (count, 0)

    def holds(count: int) -> bool:
        curve = target.made(method, nodes, *size(count))
        return target.sampled(curve) <= tolerance

    if method.fitted and control is not None:
        return _bounded(target, method, nodes, points or FITTED_POINTS, control)
    most = min(MOST_FITTED, points or FITTED_POINTS) if method.fitted else method.most
    count = _first(holds, method.least, most)
    for more in range(4 if count else 0):  # what is sampled may just miss the largest error
        found = _bounded(target, method, nodes, *size(count + more))
        if found.error_m <= tolerance:
            return found
    what = "control points" if method.fitted else "points"
    raise InputError(f"not within the tolerance with up to {most} {what}.")


def _first(holds: Callable[[int], bool], least: int, most: int) -> int:
    """Return the first count that holds, 0 if none: each is tried up to LINEAR_SEARCH, then bisection."""
    last = min(LINEAR_SEARCH, most)
    for count in range(least, last + 1):
        if holds(count):
            return count
    low, high = last, last
    while high < most:
        low, high = high, min(2 * high, most)
        if holds(high):
            break
    else:
        return 0
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _notes(rows: Sequence[Candidate]) -> tuple[str, ...]:
    """Say what the high relative accuracy of the solution is worth for these points."""
    found = {(c.method.name, c.nodes): c for c in rows if c.curve is not None}
    notes = []
    hra, lu = found.get(("bernstein", "equidistant")), found.get(("bernstein-lu", "equidistant"))
    both = hra and lu and hra.points == lu.points and (lu.at_least_m or 0) > 0.5 * lu.error_m
    if both and hra and lu and hra.error_m > 0.9 * lu.error_m:
        rest = "solving the equations more exactly than their points are rounded cannot help."
        notes.append(
            f"high relative accuracy gains nothing over LU here ({1e6 * hra.error_m:.3g} um and "
            f"{1e6 * lu.error_m:.3g} um): {rest}"
        )
    notes += moved_by_the_origin(rows)
    return tuple(notes)


def moved_by_the_origin(rows: Sequence[Candidate]) -> list[str]:
    """Say which trigonometric curves have an even number of control points, which is an odd order."""
    made = [c for c in rows if c.curve is not None and c.method.name.startswith("trigonometric")]
    even = sorted({c.control_points for c in made if c.control_points % 2 == 0})
    if not even:
        return []
    counts = " and ".join(map(str, even))
    return [
        f"trigonometric curves of an even number of control points ({counts}) do not contain constants: they "
        "change when the origin moves."
    ]
