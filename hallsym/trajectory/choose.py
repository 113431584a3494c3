"""Every method side by side, and the one that holds a tolerance with the fewest numbers to store.

Each method gets the fewest points with which it holds, and its error is bounded over the whole range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hallsym.errors import InputError
from hallsym.terminal import Step
from hallsym.trajectory.bounds import Bound, bound
from hallsym.trajectory.candidate import Candidate, Choice, best_of
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.forms import RationalForm
from hallsym.trajectory.methods import METHODS, Method, nodes_named
from hallsym.trajectory.nominal import Nominal
from hallsym.trajectory.notes import beyond_the_points, of_accuracy
from hallsym.trajectory.target import Target, resolution

LINEAR_SEARCH = 64
"""Up to so many points every count is tried; above, the least is found by bisection."""
MOST_FITTED = 40
"""Largest number of control points tried in least squares."""
FITTED_POINTS = 201
"""Points of a least-squares fit to an expression, unless stated."""


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
    `control`: control points of least squares, of 201 points unless stated.
    """
    if tolerance is None and points is None and control is None:
        raise InputError(
            "Give a --tolerance, or the number of --points; without either there is nothing to choose."
        )
    check_counts(points, control)
    target = Target(nominal)
    held = resolution(target.grid[1])
    if tolerance is not None and tolerance < 4 * held:
        raise InputError(
            f"A tolerance of {1e6 * tolerance:.3g} um is below what float64 can hold of these coordinates, "
            f"{4e6 * held:.3g} um."
        )
    rows = []
    spacings = list(_spacings(methods, nodes))
    for k, (method, spacing) in enumerate(spacings):
        progress(Step(f"methods, {k + 1} of {len(spacings)}: {method.words}, {spacing}", k / len(spacings)))
        rows.append(_candidate(target, method, spacing, tolerance, points, control))
    if control is not None and not any(method.fitted for method in methods):
        raise InputError("--control belongs to least squares; choose bernstein-ls or trigonometric-ls.")
    best = best_of(rows, tolerance)
    return Choice(tuple(rows), best, tolerance, "bounded", (*beyond_the_points(best), *of_accuracy(rows)))


def check_counts(points: int | None, control: int | None) -> None:
    """Refuse numbers of points and control points that make no curve."""
    for count, least, what in ((points, 2, "points"), (control, 1, "control points")):
        if count is not None and count < least:
            raise InputError(f"A curve needs at least {least} {what}; {count} asked for.")


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
    if isinstance(curve.form, RationalForm) and target.sampled(curve) > np.ptp(target.grid[1], axis=0).max():
        raise InputError("The rational function has a pole in the range.")
    found: Bound = bound(curve, target.nominal)
    known = Curve(
        curve.form, curve.start, curve.stop, curve.coordinates, method.name, found.at_most, "bounded",
        {"curve": target.nominal.text, "parameter": target.nominal.parameter,
         "values": dict(target.nominal.values), "nodes": nodes, "points": count,
         **({} if found.rotation_rad is None else {"max_error_rad": found.rotation_rad})},
    )  # fmt: skip
    between = None
    if nodes == "interior":
        u = nodes_named(nodes, count)[[0, -1]] * (curve.stop - curve.start) + curve.start
        between = bound(curve, target.nominal, (float(u[0]), float(u[1]))).at_most
    return Candidate(
        method, nodes, count, known, found.at_most, found.at_least, "", found.rotation_rad, between
    )  # fmt: skip


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
