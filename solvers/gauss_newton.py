"""Gauss-Newton for costs whose linearisation is expensive, such as one pass over a recording.

The caller linearises; this loop only decides which point is linearised next. A step goes to the minimum of
the linearised problem. If the cost is higher there, the step is shortened until it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol, TypeVar

SHORTER, SHORTEST = 0.3, 1e-3
"""Factor on a step that raised the cost, and the share of a step below which none is tried."""

P = TypeVar("P")
P_co = TypeVar("P_co", covariant=True)


class Linearisation(Protocol[P_co]):
    """A problem linearised at one point."""

    @property
    def cost(self) -> float:
        """The exact cost at the point."""

    def moved(self, share: float) -> P_co:
        """Return the point at `share` (0 to 1) of the way to the minimum of the linearised problem."""


L = TypeVar("L", bound=Linearisation)
Outcome = Literal["converged", "stuck", "budget"]


def gauss_newton(
    linearise: Callable[[P], L], start: P, converged: Callable[[L, float], bool], most: int
) -> tuple[L, Outcome]:
    """Return the linearisation with the least cost, and why the loop ended there.

    `converged(now, gained)`: whether `now` is the optimum; `gained` is the decrease of the cost by the last
    step, infinite before the first. `most`: linearisations at most. "stuck": no step, however short, lowers
    the cost.

    >>> class Line:
    ...     def __init__(self, x):
    ...         self.x, self.cost = x, (x * x - 2.0) ** 2
    ...
    ...     def moved(self, share):
    ...         return self.x - share * (self.x**2 - 2.0) / (2.0 * self.x)
    >>> best, outcome = gauss_newton(Line, 1.0, lambda now, gained: gained < 1e-12, most=20)
    >>> round(best.x, 9), outcome
    (1.414213562, 'converged')
    """
    now, gained, share, at = None, float("inf"), 1.0, start
    for _ in range(most):
        there = linearise(at)
        if now is None or there.cost <= now.cost:
            gained = gained if now is None else now.cost - there.cost
            now, share = there, 1.0
            if converged(now, gained):
                return now, "converged"
        elif share * SHORTER > SHORTEST:
            share *= SHORTER
        else:
            return now, "stuck"
        at = now.moved(share)
    assert now is not None
    return now, "budget"
