"""Compare methods, and choose the one within a tolerance with the fewest numbers to store.

Of an expression each method takes the fewest points for the tolerance, and its error is bounded over the
whole range. Of points the error is that at the points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.output import Step
from hallsym.trajectory.bounds import bound, is_polyline
from hallsym.trajectory.curve import Curve, FgForm, Form, SplineForm
from hallsym.trajectory.factorisation import BASES, factorise, orthogonalise
from hallsym.trajectory.nominal import Nominal, nominal, read_span
from hallsym.trajectory.points import Points, points_of, read_points

Array = np.ndarray
MOST_GLOBAL, MOST_FITTED, MOST_SPLINE = 100, 40, 5000
"""Largest number of points of one polynomial, of control points in least squares, of points of a spline."""
FITTED_POINTS = 201
"""Points of a least-squares fit to an expression, unless stated."""
LINEAR_SEARCH = 64
"""Up to so many points every count is tried; above, the least is found by bisection."""

# -- methods ---------------------------------------------------------------------------------------------


def chebyshev_nodes(n: int) -> Array:
    """Return the n Chebyshev nodes of the first kind on [0, 1], increasing: (1 - cos(pi (2k + 1)/(2n)))/2."""
    return np.sin(np.pi * (2 * np.arange(n) + 1) / (4 * n)) ** 2


@dataclass(frozen=True)
class Method:
    """A method from points to a curve: `make(u, points, control)`, parameters (N,) in [0, 1], points (N, d).

    `least`, `most`: counts of points it is tried with, of control points where it is `fitted` (least
    squares). `nodes(count)`: where points are taken of an expression.
    """

    name: str
    words: str
    make: Callable[[Array, Array, int], Form]
    least: int = 2
    most: int = MOST_GLOBAL
    fitted: bool = False
    nodes: Callable[[int], Array] = lambda n: np.linspace(0.0, 1.0, n)


def accurate(name: str, u: Array, points: Array, control: int = 0) -> Form:
    """Put a curve in an fg-Bernstein basis through points, with high relative accuracy.

    With `control` points of its own it is fitted to them by least squares.
    """
    basis = BASES[name]
    t = np.clip(basis.start + u * (basis.stop - basis.start), basis.start, basis.stop)
    if control:
        return FgForm(basis, orthogonalise(factorise(basis, t, control)).solve(points))
    return FgForm(basis, factorise(basis, t).solve(points))


def spline(degree: int, u: Array, points: Array, control: int = 0) -> Form:
    """Put a spline with not-a-knot ends through points."""
    from scipy.interpolate import make_interp_spline  # slow to load

    found = make_interp_spline(u, points, k=degree)
    return SplineForm(np.asarray(found.t, float), degree, np.asarray(found.c, float))


METHODS = (
    Method("bernstein", "Bernstein, HRA", partial(accurate, "bernstein")),
    Method(
        "bernstein-chebyshev", "Bernstein, HRA, Chebyshev nodes", partial(accurate, "bernstein"),
        nodes=chebyshev_nodes,
    ),
    Method("trigonometric", "trigonometric, HRA", partial(accurate, "trigonometric")),
    Method(
        "bernstein-ls", "Bernstein, least squares, HRA", partial(accurate, "bernstein"), most=MOST_FITTED,
        fitted=True,
    ),
    Method(
        "trigonometric-ls", "trigonometric, least squares, HRA", partial(accurate, "trigonometric"),
        most=MOST_FITTED, fitted=True,
    ),
    Method("linear", "polyline", partial(spline, 1), most=MOST_SPLINE),
    Method("cubic", "cubic spline", partial(spline, 3), least=4, most=MOST_SPLINE),
    Method("quintic", "quintic spline", partial(spline, 5), least=6, most=MOST_SPLINE),
)  # fmt: skip
"""HRA is high relative accuracy: solved by the bidiagonal factors of the collocation matrix."""


def method_named(name: str) -> Method:
    """Return a method by name; raises `InputError` for an unknown one."""
    known = {method.name: method for method in METHODS}
    if name not in known:
        names = ", ".join(known)
        raise InputError(f"Method {name!r} is not known{nearest(name, list(known))}; known: {names}.")
    return known[name]


# -- what a curve is made of -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Target:
    """A nominal curve or points, with values that a search needs repeatedly."""

    source: Nominal | Points

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Parameters in [0, 1] and the points there: those given, or dense ones, denser towards the ends."""
        if isinstance(self.source, Points):
            return self.source.shares, self.source.points
        u = np.unique(np.r_[np.linspace(0, 1, 1501), np.sin(np.linspace(0, np.pi / 2, 801)) ** 2])
        return u, self.at(u)

    def at(self, u: Array) -> Array:
        """Return the nominal points at shares u of the range."""
        n = self.source
        assert isinstance(n, Nominal)
        return n(np.clip(n.start + u * (n.stop - n.start), n.start, n.stop))

    def made(self, method: Method, count: int, control: int) -> Curve:
        """Return the curve that a method makes of `count` points, or of those given."""
        n = self.source
        if isinstance(n, Points):
            form = method.make(n.shares, n.points, control)
            return Curve(form, float(n.t[0]), float(n.t[-1]), n.coordinates, method.name)
        u = method.nodes(count)
        return Curve(method.make(u, self.at(u), control), n.start, n.stop, n.coordinates, method.name)

    def errors(self, curve: Curve, u: Array, points: Array) -> Array:
        """Return differences (len(u), d) from points at shares u; of a polyline from its chords."""
        a, b = curve.form.domain
        inner = np.clip(a + u * (b - a), a, b)
        e = curve.form.evaluate(inner) - points
        if isinstance(curve.form, SplineForm) and is_polyline(curve):
            way = curve.form.evaluate(inner, 1)[:, curve.lengths]
            size = np.sum(way**2, axis=1)
            along = np.sum(way * e[:, curve.lengths], axis=1)
            along = np.divide(along, size, out=np.zeros_like(size), where=size > 0)
            k = curve.form.piece(inner)
            along = inner - np.clip(inner - along, *curve.form.knots[[k, k + 1]])
            e[:, curve.lengths] -= along[:, None] * way
        return e

    def sampled(self, curve: Curve) -> float:
        """Largest distance at the points compared: of an expression quick, and below the bound."""
        u, points = self.grid
        pieces = len(curve.form.edges(1)) - 1
        if pieces > 150 and isinstance(self.source, Nominal):
            u = np.linspace(0, 1, 8 * pieces + 1)
            points = self.at(u)
        return float(np.linalg.norm(self.errors(curve, u, points)[:, curve.lengths], axis=1).max())


# -- the table -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidate:
    """One method: its curve and error, or the reason why there is none.

    `error_m`: upper bound, or the error at the points; `at_least_m`: what it certainly reaches.
    """

    method: Method
    points: int
    curve: Curve | None
    error_m: float = np.inf
    at_least_m: float | None = None
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the row as a record."""
        made = self.curve
        return {
            "method": self.method.name,
            "points": self.points,
            "control_points": made.control_points if made else 0,
            "numbers": made.form.numbers if made else 0,
            "max_error_m": self.error_m if made else None,
            "at_least_m": self.at_least_m,
            "max_error_rad": made.source.get("max_error_rad") if made else None,
            "reason": self.reason,
        }


@dataclass(frozen=True, eq=False)
class Choice:
    """All candidates, and the best: within the tolerance with the fewest numbers, else most exact."""

    candidates: tuple[Candidate, ...]
    best: Candidate
    tolerance_m: float | None

    @property
    def curve(self) -> Curve:
        """The chosen curve."""
        assert self.best.curve is not None
        return self.best.curve

    def meets(self, candidate: Candidate) -> bool:
        """Whether a candidate holds the tolerance; True where none is stated."""
        return self.tolerance_m is None or candidate.error_m <= self.tolerance_m

    def to_dict(self) -> dict[str, Any]:
        """Return the choice as a record."""
        return self.best.to_dict() | {
            "error_kind": self.curve.error_kind,
            "tolerance_m": self.tolerance_m,
            "methods": [c.to_dict() for c in self.candidates],
        }


def choose_curve(
    source: str | Path | Nominal | Points | Array,
    tolerance: float | None = None,
    *,
    span: str | None = None,
    values: Mapping[str, float] | None = None,
    points: int | None = None,
    control: int | None = None,
    method: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Return each method's curve for `source`, and the best: within `tolerance` [m], the fewest numbers.

    `source`: an expression with its `span`, such as "t=0:2*pi", and `values` in SI; a CSV file of points; or
    points (N, 2) in m. `points`: how many are taken of an expression. `control`: control points of least
    squares. `method`: only this one; of points the cubic spline unless stated.

    >>> choice = choose_curve("x = r*t; y = r*t**2", 1e-9, span="t=0:1", values={"r": 1e-3})
    >>> choice.best.method.name, choice.curve.control_points
    ('bernstein', 3)
    """
    if isinstance(source, str) and span is not None:
        source = nominal(source, read_span(span), values)
    elif isinstance(source, str | Path):
        source = read_points(source)
    elif isinstance(source, np.ndarray):
        source = points_of(source)
    if isinstance(source, Points):
        points, method = len(source.t), method or "cubic"
    elif tolerance is None and points is None and control is None:
        raise InputError(
            "Give a --tolerance, or the number of --points; without either there is nothing to choose."
        )
    methods: Sequence[Method] = METHODS if method is None else (method_named(method),)
    if control is not None:
        methods = [m for m in methods if m.fitted]
        if not methods:
            raise InputError("--control belongs to least squares; choose bernstein-ls or trigonometric-ls.")
    target, rows = Target(source), []
    _ = target.grid  # refuses an expression that is not a number somewhere
    for k, one in enumerate(methods):
        progress(Step(f"methods, {k + 1} of {len(methods)}: {one.words}", k / len(methods)))
        try:
            rows.append(_candidate(target, one, tolerance, points, control))
        except InputError as error:
            rows.append(Candidate(one, points or 0, None, reason=str(error)))
    made = [row for row in rows if row.curve is not None]
    if not made:
        raise InputError(rows[0].reason)
    best = min(made, key=lambda c: c.error_m)
    if tolerance is not None and best.error_m > tolerance:
        raise InputError(
            f"No curve holds {1e6 * tolerance:.4g} um: the nearest is {best.method.name} with "
            f"{best.points} points, {1e6 * best.error_m:.4g} um; give more points or allow a larger "
            "tolerance."
        )
    if tolerance is not None:
        met = [c for c in made if c.error_m <= tolerance]
        best = min(met, key=lambda c: c.curve.form.numbers if c.curve else 0)
    return Choice(tuple(rows), best, tolerance)


def _candidate(
    target: Target, method: Method, tolerance: float | None, points: int | None, control: int | None
) -> Candidate:
    """Return the candidate of a stated count, or of the fewest points (control points) that hold."""
    what = "control points" if method.fitted else "points"
    stated = control if method.fitted else points
    taken = points or FITTED_POINTS

    def made(count: int) -> Curve:
        return target.made(method, taken, count) if method.fitted else target.made(method, count, 0)

    def known(count: int) -> Candidate:
        return _certified(target, method, made(count), taken if method.fitted else count)

    if stated is not None:
        if not method.least <= stated <= method.most:
            raise InputError(
                f"The method {method.name} takes {method.least} to {method.most} {what}; {stated} asked for."
            )
        return known(stated)
    if tolerance is None:
        raise InputError("Least squares needs --control or a --tolerance.")
    most = min(method.most, taken) if method.fitted else method.most
    first = _first(lambda count: target.sampled(made(count)) <= tolerance, method.least, most)
    for count in range(first, first + 4 if first else 0):  # samples may miss the largest error
        found = known(count)
        if found.error_m <= tolerance:
            return found
    raise InputError(f"{method.name} is not within the tolerance with up to {most} {what}.")


def _certified(target: Target, method: Method, curve: Curve, count: int) -> Candidate:
    """Return a candidate with its error: bounded of an expression, else at the points."""
    source = target.source
    if isinstance(source, Points):
        e = np.abs(target.errors(curve, source.shares, source.points))
        worst, least, kind = target.sampled(curve), None, "at the points"
        angular = [k for k in range(len(curve.coordinates)) if k not in curve.lengths]
        rotation = float(e[:, angular].max()) if angular else None
        made_of: dict[str, Any] = {"points": count, "file": source.name}
    else:
        found = bound(curve, source)
        worst, least, kind, rotation = found.at_most, found.at_least, "bounded", found.rotation_rad
        made_of = {"curve": source.text, "parameter": source.parameter, "values": dict(source.values),
                   "points": count}  # fmt: skip
    if rotation is not None:
        made_of["max_error_rad"] = rotation
    known = Curve(curve.form, curve.start, curve.stop, curve.coordinates, method.name, worst, kind, made_of)
    return Candidate(method, count, known, worst, least)


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
