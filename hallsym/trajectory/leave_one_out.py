"""Which curve to put through points of which nothing else is known: errors estimated by leaving points out.

Each inner point is left out, the curve is made of the others, and its distance from that point is an error.
An interpolating curve then has a gap twice as wide, so that this is more than the error between the points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from hallsym.errors import InputError
from hallsym.terminal import Step
from hallsym.trajectory.basis import basis_named
from hallsym.trajectory.candidate import Candidate, Choice, best_of
from hallsym.trajectory.choose import MOST_FITTED, check_counts
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.curve import Curve, Form
from hallsym.trajectory.factorisation import factorise
from hallsym.trajectory.methods import METHODS, Method, inside
from hallsym.trajectory.notes import moved_by_the_origin
from hallsym.trajectory.orthogonal import orthogonalise
from hallsym.trajectory.points import Points
from hallsym.trajectory.target import resolution

Array = np.ndarray
SIZES = (2, 3, 4, 6, 8, 11, 16, 22, 31, MOST_FITTED)
"""Numbers of control points that a least-squares fit tries before it looks between them."""


def of_points(
    points: Points,
    tolerance: float | None = None,
    *,
    control: int | None = None,
    methods: Sequence[Method] = METHODS,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Return every method's curve through (or fitted to) points, with its error by leaving points out.

    Raises `InputError` for a tolerance [m] below the rounding of the points or of float64.
    """
    check_counts(None, control)
    if tolerance is not None:
        if tolerance < points.rounding:
            raise InputError(
                f"A tolerance of {1e6 * tolerance:.4g} um is below the rounding of the points, "
                f"{1e6 * points.rounding:.4g} um (half their last digit); give more digits, or say with "
                "--rounding what they are worth."
            )
        if tolerance < 4 * resolution(points.points):
            raise InputError(
                f"A tolerance of {1e6 * tolerance:.3g} um is below what float64 can hold of these "
                f"coordinates, {4e6 * resolution(points.points):.3g} um."
            )
    rows = []
    for k, method in enumerate(methods):
        progress(Step(f"methods, {k + 1} of {len(methods)}: {method.words}", k / len(methods)))
        rows.append(_candidate(points, method, tolerance, control))
    notes = [
        "errors are estimated by leaving out one point at a time; the points themselves are taken as right."
    ]
    made = [row.method for row in rows if row.curve is not None and not row.method.fitted]
    fewer = sorted({m.left_out for m in made if m.left_out < len(points.t) - 2})
    if fewer:
        counts = " or ".join(map(str, fewer))
        notes.append(f"of {len(points.t) - 2} inner points {counts} were left out, evenly spread.")
    notes += [*moved_by_the_origin(rows), *points.notes]
    return Choice(tuple(rows), best_of(rows, tolerance), tolerance, "estimated", tuple(notes))


def _candidate(points: Points, method: Method, tolerance: float | None, control: int | None) -> Candidate:
    count = len(points.t)
    refused = ""
    if not method.anywhere:
        refused = "needs points at nodes of its own; give the curve as an expression"
    elif count > method.most:
        refused = f"not tried with more than {method.most} points"
    elif count < method.least + 1:
        refused = f"needs at least {method.least + 1} points to leave one out"
    if refused:
        return Candidate(method, "given", count, None, np.inf, reason=refused)
    try:
        if method.fitted:
            form, errors = _fitted(points, method, tolerance, control)
        else:
            form = method.make(points.shares, points.points, 0)
            errors = _left_out(points, method)
    except InputError as error:
        return Candidate(method, "given", count, None, np.inf, reason=str(error))
    turning = [k for k, name in enumerate(points.coordinates) if not name.endswith("_m")]
    worst = float(points.distances(errors).max())
    rotation = float(np.abs(errors[:, turning]).max()) if turning else None
    curve = Curve(
        form, float(points.t[0]), float(points.t[-1]), points.coordinates, method.name, worst, "estimated",
        {"points": count, "file": points.name, **({} if rotation is None else {"max_error_rad": rotation})},
    )  # fmt: skip
    return Candidate(method, "given", count, curve, worst, rotation_rad=rotation)


def _left_out(points: Points, method: Method) -> Array:
    """Return the errors (left out, d) of an interpolating curve at points that it did not see."""
    u, p = points.shares, points.points
    inner = np.arange(1, len(u) - 1)
    if len(inner) > method.left_out:
        inner = inner[np.linspace(0, len(inner) - 1, method.left_out).round().astype(int)]
    errors = []
    for k in inner:
        form = method.make(np.delete(u, k), np.delete(p, k, axis=0), 0)
        a, b = form.domain
        errors.append(form.evaluate(np.array([a + u[k] * (b - a)]))[0] - p[k])
    return np.array(errors)


def _fitted(
    points: Points, method: Method, tolerance: float | None, control: int | None
) -> tuple[Form, Array]:
    """Return the least-squares curve and its errors at left-out points, r/(1 - leverage).

    `control` control points; else the fewest within the tolerance, else as many as err least.
    """
    basis, count = basis_named(method.name.removesuffix("-ls")), len(points.t)
    t = inside(basis, points.shares)

    @cache
    def tried(size: int) -> tuple[float, Form, Array]:
        q = orthogonalise(factorise(basis, t, size))
        form = FgForm(basis, q.solve(points.points))
        spare = np.maximum(1 - q.leverage(), 1e-12)[1:-1, None]
        errors = (form.evaluate(t) - points.points)[1:-1] / spare
        return float(points.distances(errors).max()), form, errors

    if control is not None:
        return tried(control)[1:]
    sizes = [size for size in SIZES if size < count] or [count]
    limit = -1.0 if tolerance is None else tolerance
    held = next((k for k, size in enumerate(sizes) if tried(size)[0] <= limit), None)
    if held is None:
        return tried(min(sizes, key=lambda size: tried(size)[0]))[1:]
    low, high = sizes[max(held - 1, 0)], sizes[held]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if tried(middle)[0] <= limit else (middle, high)
    return tried(high)[1:]
