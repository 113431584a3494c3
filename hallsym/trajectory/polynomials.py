"""A curve as polynomial pieces in Bernstein form, which is what controllers take."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial, log, pi

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.basis import BERNSTEIN
from hallsym.trajectory.corner_cutting import UNIT, FgForm
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.factorisation import factorise
from hallsym.trajectory.forms import ChebyshevForm, SplineForm, chebyshev_nodes

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Pieces:
    """Bezier control points (pieces, degree + 1, d) between `breaks` (pieces + 1,) of the user's parameter.

    `error`: largest distance from the curve that rewriting it has made [m].
    """

    breaks: Array
    control: Array
    error: float = 0.0

    @property
    def degree(self) -> int:
        """Degree of the pieces."""
        return self.control.shape[1] - 1

    def evaluate(self, t: Array) -> Array:
        """Return points (len(t), d)."""
        k = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.control) - 1)
        s = ((t - self.breaks[k]) / (self.breaks[k + 1] - self.breaks[k]))[:, None]
        p = self.control[k].transpose(1, 0, 2)
        while len(p) > 1:
            p = (1 - s) * p[:-1] + s * p[1:]
        return p[0]


def pieces_of(curve: Curve) -> Pieces:
    """Return a polynomial curve as Bezier pieces.

    Raises `InputError` for curves that are not polynomials: the trigonometric basis and AAA.
    """
    form = curve.form
    if isinstance(form, SplineForm):
        return _checked(curve, *_of_spline(form))
    if isinstance(form, FgForm) and form.basis.name == "bernstein":
        return Pieces(np.array([curve.start, curve.stop]), form.control[None])
    if isinstance(form, ChebyshevForm):
        if len(form.control) > 60:
            raise InputError(
                f"A polynomial of degree {len(form.control) - 1} has no Bernstein form that float64 can "
                "hold; take fewer points or a spline."
            )
        control = factorise(BERNSTEIN, chebyshev_nodes(len(form.control))).solve(form.control)
        return _checked(curve, np.array([0.0, 1.0]), control[None])
    raise InputError(
        f"A curve by the method {curve.method!r} is not made of polynomials, which this export needs; choose "
        "--method bernstein, chebyshev or a spline."
    )


def _of_spline(form: SplineForm) -> tuple[Array, Array]:
    """Breaks and Bezier points of each piece, from its derivatives at the left end."""
    start, stop = form.domain
    breaks, degree, part = np.r_[start, form.breaks(), stop], form.degree, form
    width, powers = np.diff(breaks)[:, None], []
    for j in range(degree + 1):
        powers.append(part.evaluate(breaks[:-1]) * width**j / factorial(j))
        part = part.derivative()
    share = [[comb(i, j) / comb(degree, j) for j in range(degree + 1)] for i in range(degree + 1)]
    return breaks, np.einsum("ij,jpd->pid", np.array(share), np.array(powers))


def _checked(curve: Curve, breaks: Array, control: Array) -> Pieces:
    """Return pieces with a bound of their distance from the curve.

    Both are polynomials in each piece: they differ by at most Lebesgue's constant, 1 + (2/pi) ln(degree + 1),
    times their difference at Chebyshev nodes, to which the rounding of both evaluations there is added.
    """
    a, b = curve.form.domain
    breaks = curve.start + (breaks - a) / (b - a) * (curve.stop - curve.start)
    breaks[0], breaks[-1] = curve.start, curve.stop
    made = Pieces(breaks, control)
    share = chebyshev_nodes(made.degree + 1)
    t = (breaks[:-1, None] + share * np.diff(breaks)[:, None]).ravel()
    found = np.abs(made.evaluate(t) - curve(t))[:, curve.lengths].max()
    rounding = 32 * (made.degree + 1) * UNIT * np.abs(control[:, :, curve.lengths]).max()
    return Pieces(breaks, control, float((1 + 2 / pi * log(made.degree + 1)) * (found + rounding)))
