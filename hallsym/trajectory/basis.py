"""fg-Bernstein bases: u_k(t) = C(n, k) f(t)^k g(t)^(n-k), k = 0 .. n (Micromachines 2019, 10, 597, Eq. (7)).

With f, g >= 0 and f/g strictly increasing, every collocation matrix of the basis is totally positive. All
that the algorithms need of a basis is f, g and the differences W(t, s) = f(t) g(s) - f(s) g(t) for s < t,
each computed without a subtraction that loses digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError, nearest

Array = np.ndarray
HALF_PI = math.pi / 2


@dataclass(frozen=True, eq=False)
class Basis:
    """A pair f, g on [start, stop] that spans, for every order n, n + 1 functions f^k g^(n-k).

    `difference(t, s)`: W(t, s) for s < t, to full relative accuracy. `rates`: (alpha, beta) where
    f' = alpha f + beta g and g' = -beta f - alpha g; without them a curve has no derivatives. `shape`: D of
    the trigonometric basis.
    """

    name: str
    start: float
    stop: float
    f: Callable[[Array], Array]
    g: Callable[[Array], Array]
    difference: Callable[[Array, Array], Array]
    rates: tuple[float, float] | None = None
    shape: float | None = None

    @property
    def partition(self) -> bool:
        """Whether f + g = 1, so that the basis functions sum to one."""
        return self.name == "bernstein"

    def largest(self, n: int) -> float:
        """Largest sum of the n + 1 basis functions on the interval, (f + g)^n at its middle."""
        middle = np.array([(self.start + self.stop) / 2])
        return 1.0 if self.partition else float((self.f(middle) + self.g(middle))[0] ** n)


def _bernstein() -> Basis:
    return Basis("bernstein", 0.0, 1.0, lambda t: t, lambda t: 1 - t, lambda t, s: t - s, (1.0, 1.0))


BERNSTEIN = _bernstein()
"""f = t, g = 1 - t on [0, 1]: polynomials. W(t, s) = t - s."""


def trigonometric(shape: float = HALF_PI) -> Basis:
    """Return the basis f = sin((D + t)/2), g = sin((D - t)/2) on [-D, D], 0 < D < pi.

    W(t, s) = sin(D) sin((t - s)/2). Even orders n = 2m span the trigonometric polynomials of degree m. Odd
    orders do not contain constants: a curve of odd order depends on where the origin lies.
    """
    if not 0 < shape < math.pi:
        raise InputError(f"Shape D of the trigonometric basis must be between 0 and pi; got {shape:g}.")
    return Basis(
        "trigonometric",
        -shape,
        shape,
        lambda t: np.sin((shape + t) / 2),
        lambda t: np.sin((shape - t) / 2),
        lambda t, s: math.sin(shape) * np.sin((t - s) / 2),
        (0.5 / math.tan(shape), 0.5 / math.sin(shape)),
        shape,
    )


BASES = ("bernstein", "trigonometric")


def basis_named(name: str, shape: float | None = None) -> Basis:
    """Return a basis by name; raises `InputError` for an unknown one."""
    if name == "bernstein":
        return BERNSTEIN
    if name == "trigonometric":
        return trigonometric(HALF_PI if shape is None else shape)
    raise InputError(f"Basis {name!r} is not known{nearest(name, list(BASES))}; known: {', '.join(BASES)}.")


@dataclass(frozen=True, eq=False)
class Values:
    """f and g at the parameters t, checked for total positivity."""

    t: Array
    f: Array
    g: Array


def check_increasing(t: Array, name: str) -> None:
    """Refuse parameters (points,) that repeat or are out of order; `name` says of what."""
    steps = np.diff(t)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0))
        what = "repeats" if steps[k] == 0 else "is less than"
        raise InputError(
            f"Parameters of {name} must increase: number {k + 2} ({t[k + 1]:.9g}) {what} number {k + 1} "
            f"({t[k]:.9g}); sort the points and take repeated ones out."
        )


def values(basis: Basis, t: Array) -> Values:
    """Return f and g at strictly increasing parameters (points,) of the basis.

    Raises `InputError` if parameters repeat, are out of order or outside the interval, or if f, g or the
    differences of neighbours are not positive there, so that the collocation matrix is not totally positive.
    """
    t = np.asarray(t, float)
    if t.ndim != 1 or not len(t):
        raise InputError(f"Parameters of a curve must be a list of numbers; got shape {t.shape}.")
    if not np.isfinite(t).all():
        raise InputError(
            f"Parameter {int(np.argmin(np.isfinite(t))) + 1} of the points is not a finite number."
        )
    check_increasing(t, "the points")
    if t[0] < basis.start or t[-1] > basis.stop:
        outside = t[0] if t[0] < basis.start else t[-1]
        raise InputError(
            f"Parameters of the points must lie in the interval {basis.start:.9g} .. {basis.stop:.9g} of the "
            f"{basis.name} basis; {outside:.9g} lies outside."
        )
    f, g = np.asarray(basis.f(t), float), np.asarray(basis.g(t), float)
    inside = slice(1 if t[0] == basis.start else 0, -1 if t[-1] == basis.stop else None)
    positive = (f >= 0).all() and (g >= 0).all() and (f[inside] > 0).all() and (g[inside] > 0).all()
    if not positive or (np.asarray(basis.difference(t[1:], t[:-1])) <= 0).any():
        raise InputError(
            f"The basis {basis.name!r} is not totally positive at these parameters: f and g must be positive "
            "inside the interval and f/g must increase."
        )
    return Values(t, f, g)
