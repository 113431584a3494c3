"""The methods that make a curve of points: one tuple, and each is one function of its points.

`make(u, points, control)`: parameters (N,) in [0, 1], points (N, d), control points of a least-squares
fit. HRA is high relative accuracy: solved by the bidiagonal factors of the collocation matrix.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.trajectory.basis import Basis, basis_named
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.curve import Form
from hallsym.trajectory.factorisation import factorise
from hallsym.trajectory.forms import ChebyshevForm, RationalForm, SplineForm, chebyshev_nodes
from hallsym.trajectory.orthogonal import orthogonalise

Array = np.ndarray
MOST_GLOBAL = 100
"""Largest number of points through which one polynomial is put without being asked to."""

NODES: dict[str, Callable[[int], Array]] = {
    "equidistant": lambda n: np.linspace(0.0, 1.0, n),
    "interior": lambda n: np.arange(1, n + 1) / (n + 1),
    "chebyshev": chebyshev_nodes,
}
"""Where points are taken in the range: both ends included; without the ends; dense towards the ends."""


@dataclass(frozen=True)
class Method:
    """How points become a curve; `nodes`: the spacings tried where points may be chosen.

    `least`, `most`: counts of points it is tried with. `fitted`: least squares, with control points of its
    own number. `anywhere`: takes points at any parameters. `left_out`: how many, to estimate errors.
    """

    name: str
    words: str
    make: Callable[[Array, Array, int], Form]
    nodes: tuple[str, ...] = ("equidistant",)
    least: int = 2
    most: int = MOST_GLOBAL
    fitted: bool = False
    anywhere: bool = True
    left_out: int = 200


def inside(basis: Basis, u: Array) -> Array:
    """Return parameters of the basis for shares u of its interval, the ends exactly."""
    return np.clip(basis.start + u * (basis.stop - basis.start), basis.start, basis.stop)


def interpolated(name: str, u: Array, points: Array, control: int = 0) -> Form:
    """Put a curve in an fg-Bernstein basis through points, with high relative accuracy."""
    basis = basis_named(name)
    return FgForm(basis, factorise(basis, inside(basis, u)).solve(points))


def fitted(name: str, u: Array, points: Array, control: int) -> Form:
    """Fit a curve in an fg-Bernstein basis to points by least squares, with high relative accuracy."""
    basis = basis_named(name)
    return FgForm(basis, orthogonalise(factorise(basis, inside(basis, u), control)).solve(points))


def by_elimination(u: Array, points: Array, control: int = 0) -> Form:
    """Solve the same equations as `bernstein` by LU of the collocation matrix."""
    basis, n = basis_named("bernstein"), len(u) - 1
    matrix = FgForm(basis, np.eye(n + 1)).evaluate(u)
    try:
        return FgForm(basis, np.linalg.solve(matrix, points))
    except np.linalg.LinAlgError:
        raise InputError("The collocation matrix is singular in float64; LU cannot solve it.") from None


def spline(degree: int, natural: bool, u: Array, points: Array, control: int = 0) -> Form:
    """Put a spline through points; not-a-knot ends, or second derivatives of 0 (`natural`)."""
    ends = "natural" if natural else None
    from scipy.interpolate import make_interp_spline  # slow to load

    found = make_interp_spline(u, points, k=degree, bc_type=ends)
    return SplineForm(np.asarray(found.t, float), degree, np.asarray(found.c, float))


def polynomial(u: Array, points: Array, control: int = 0) -> Form:
    """Put a polynomial through values at the Chebyshev nodes, kept as these values."""
    if not np.allclose(u, chebyshev_nodes(len(u)), rtol=0, atol=1e-12):
        raise InputError("The method chebyshev needs points at the Chebyshev nodes of the range.")
    return ChebyshevForm(points)


def rational(u: Array, points: Array, control: int = 0) -> Form:
    """Fit one rational function per coordinate (AAA), until it meets the points to 1e-13 of their size."""
    from scipy.interpolate import AAA  # slow to load

    size = np.abs(points).max(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of coordinates that few points do not determine: the error says so
        try:
            found = [
                AAA(u, p, rtol=1e-13, max_terms=max(min(len(u) // 2, 50), 1)) if s > 0 else None
                for p, s in zip(points.T, size, strict=True)
            ]
        except (ValueError, np.linalg.LinAlgError):
            raise InputError("AAA finds no rational function of these points.") from None
    parts = [
        (a.support_points, a.support_values, a.weights) if a else (u[:1], np.zeros(1), np.ones(1))
        for a in found
    ]
    order = [np.argsort(z) for z, _, _ in parts]
    return RationalForm(*(tuple(part[k][o] for part, o in zip(parts, order, strict=True)) for k in range(3)))


BOTH = ("equidistant", "chebyshev")
METHODS: tuple[Method, ...] = (
    Method("bernstein", "Bernstein, HRA", partial(interpolated, "bernstein"), BOTH),
    Method("trigonometric", "trigonometric, HRA", partial(interpolated, "trigonometric"), BOTH),
    Method("bernstein-lu", "Bernstein, LU", by_elimination),
    Method(
        "bernstein-ls", "Bernstein, least squares, HRA", partial(fitted, "bernstein"), most=5000, fitted=True
    ),
    Method(
        "trigonometric-ls",
        "trigonometric, least squares, HRA",
        partial(fitted, "trigonometric"),
        most=5000,
        fitted=True,
    ),
    Method("chebyshev", "Chebyshev, barycentric", polynomial, ("chebyshev",), anywhere=False),
    Method("linear", "polyline", partial(spline, 1, False), most=50_000),
    Method("cubic", "cubic spline", partial(spline, 3, False), least=4, most=20_000),
    Method("natural", "natural cubic spline", partial(spline, 3, True), least=3, most=20_000),
    Method("quintic", "quintic spline", partial(spline, 5, False), least=6, most=20_000),
    Method("septic", "spline of degree 7", partial(spline, 7, False), least=8, most=20_000),
    Method("aaa", "rational, AAA", rational, least=4, most=200, left_out=12),
)


def method_named(name: str) -> Method:
    """Return a method by name; raises `InputError` for an unknown one."""
    for method in METHODS:
        if method.name == name:
            return method
    known = [method.name for method in METHODS]
    raise InputError(f"Method {name!r} is not known{nearest(name, known)}; known: {', '.join(known)}.")


def nodes_named(name: str, count: int) -> Array:
    """Return that many parameters in [0, 1]; raises `InputError` for an unknown spacing."""
    if name not in NODES:
        raise InputError(f"Nodes {name!r} are not known{nearest(name, [*NODES])}; known: {', '.join(NODES)}.")
    if count < 2:
        raise InputError(f"A curve needs at least 2 points; {count} asked for.")
    return NODES[name](count)
