"""Newton's method with exact Hessian in a box, and Gauss-Newton for costs that are expensive to linearise.

Small problems, solved thousands of times: Levenberg-Marquardt control of the damping (Nocedal & Wright,
Numerical Optimization, 2nd ed., ch. 4 and 10), bounds by pinning variables that would leave the box.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from solvers.problem import INTERRUPTED, FloatArray, Problem, Result, Status, misuse

EPS = float(np.finfo(float).eps)
NEGLIGIBLE = 1e-6  # of the cost: what a converged point may still promise when steps no longer improve


TINY = float(np.finfo(float).tiny)
SMALL_STEP = 1e-8  # of the variable or its box
RIDGE = 1e-10  # of the unit diagonal: holds back directions the data say nothing about


def bounded_step(
    gradient: FloatArray, hessian: FloatArray, low: FloatArray, high: FloatArray, damping: float = 0.0
) -> tuple[FloatArray, float]:
    """Minimise the damped quadratic model within `low <= step <= high`; return the step and its promise.

    `low = lower - x <= 0` and `high = upper - x >= 0`. The variable whose step would leave the box by most is
    set on its bound and the rest is solved again. The promise is how much the undamped model says is gained.
    The Hessian is brought to unit diagonal first, so the units of the variables do not matter.
    """
    step, numbers = np.zeros_like(gradient), np.flatnonzero(low < high)
    while len(numbers):
        inner = hessian[np.ix_(numbers, numbers)]
        wish = -_solve(inner, (gradient + hessian @ step)[numbers], damping + RIDGE)
        beyond = np.maximum(np.maximum(low[numbers] - wish, wish - high[numbers]), 0.0)
        if not beyond.any():
            step[numbers] = wish
            break
        worst = int(np.argmax(np.where(beyond > 0.0, beyond / (high - low)[numbers], -1.0)))
        k = numbers[worst]
        step[k] = np.clip(wish[worst], low[k], high[k])
        numbers = np.delete(numbers, worst)
    return step, float(-(gradient @ step) - 0.5 * (step @ hessian @ step))


def what_is_left(
    gradient: FloatArray, hessian: FloatArray, x: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[float, bool]:
    """How much lower the model says the cost could still be, and whether the step there is only rounding.

    The second says it where the first cannot: at a cost of zero every promise is as large as the cost.
    """
    step, left = bounded_step(gradient, hessian, lower - x, upper - x)
    width = upper - lower
    size = np.abs(x) + np.where(np.isfinite(width), width, 0.0)
    return left, bool((np.abs(step) <= SMALL_STEP * size).all())


def curves_down(hessian: FloatArray, x: FloatArray, lower: FloatArray, upper: FloatArray) -> bool:
    """Whether a stationary point is a saddle or a maximum: a variable off its bounds curves downwards."""
    free = (x > lower) & (x < upper)
    if not free.any():
        return False
    scaled, _ = _unit_diagonal(hessian[np.ix_(free, free)])
    try:
        np.linalg.cholesky(scaled + 1e-6 * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        return True
    return False


def _unit_diagonal(hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
    size = np.maximum(np.abs(hessian.diagonal()), 1e-20 * np.abs(hessian).max(axis=1))
    scale = 1.0 / np.sqrt(np.where(size > TINY, size, 1.0))  # an empty row stays as it is
    return hessian * scale * scale[:, None], scale


def _solve(hessian: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """`(H + damping D)^-1 g`, D the diagonal; where H is indefinite, with |eigenvalues| instead."""
    scaled, scale = _unit_diagonal(hessian)
    try:
        damped = scaled.copy()
        damped.flat[:: len(damped) + 1] += damping
        np.linalg.cholesky(damped)
        return scale * np.linalg.solve(damped, scale * gradient)
    except np.linalg.LinAlgError:
        size, vectors = np.linalg.eigh(scaled)
        return scale * (vectors @ ((vectors.T @ (scale * gradient)) / (np.abs(size) + damping)))


def newton(problem: Problem, x0: ArrayLike, *, max_iterations: int = 200, tolerance: float = 1e-12) -> Result:
    """Refine one point; never returns a worse one than `x0` clipped into the box.

    Needs `problem.derivatives`; made for up to some 200 variables. Converged means:
    the bounded quadratic model promises less than `tolerance` times the cost, or less than rounding.

    >>> bowl = Problem(
    ...     lambda x: (x[:, 0] - 2) ** 2,
    ...     lower=[0.0],
    ...     upper=[9.0],
    ...     derivatives=lambda x: ((x[0] - 2) ** 2, 2 * (x - 2), 2 * np.eye(1)),
    ... )
    >>> newton(bowl, [7.0]).x
    array([2.])
    """
    began = perf_counter()
    start, note = inside(problem, x0, "newton")
    descent = _Descent(problem, start, tolerance)
    status: Status
    try:
        status, message = descent.run(max_iterations)
    except KeyboardInterrupt:
        status, message = "interrupted", INTERRUPTED
    return Result(
        descent.x, descent.f, status, message + note, descent.evaluations, descent.first,
        perf_counter() - began,
    )  # fmt: skip


class _Descent:
    """State of one descent."""

    def __init__(self, problem: Problem, x: FloatArray, tolerance: float) -> None:
        self.problem, self.x, self.tolerance = problem, x, tolerance
        self.derivatives = problem.second_order
        self.f, self.first, self.evaluations = np.inf, np.inf, 0
        self.damping, self.factor, self.successes = 0.0, 10.0, 0

    def run(self, max_iterations: int) -> tuple[Status, str]:
        """Iterate until there is a reason to stop."""
        if not self.take(self.x):
            return "failed", "The cost or its derivatives are not finite at the start: choose another start."
        self.first = self.f
        lower, upper = self.problem.lower, self.problem.upper
        self.floor = self.tolerance * EPS * abs(self.f)
        for _ in range(max_iterations):
            step, gain = bounded_step(
                self.gradient, self.hessian, lower - self.x, upper - self.x, self.damping
            )
            stuck = bool((np.abs(step) <= EPS * np.abs(self.x)).all())
            if stuck or abs(gain) <= self.tolerance * abs(self.f) + self.floor:
                return self.verdict()
            if gain < 0.0:  # pinning at bounds has spoilt the step: a shorter one goes downhill
                self.adapt(-1.0)
                continue
            before = self.f
            taken = self.take(np.minimum(np.maximum(self.x + step, lower), upper))
            self.adapt((before - self.f) / gain if taken else -1.0)
        return "budget", f"{max_iterations} iterations are spent: raise max_iterations, or go on from here."

    def take(self, x: FloatArray) -> bool:
        """Evaluate; move there if it is finite and strictly better."""
        self.evaluations += 1
        better = self.problem.value is None or self.problem.value(x) < self.f
        if better:
            f, gradient, hessian = self.derivatives(x)
            better = bool(-np.inf < f < self.f and np.isfinite(gradient).all() and np.isfinite(hessian).all())
        if better:
            self.x, self.f, self.gradient, self.hessian = x, float(f), gradient, hessian
        return better

    def adapt(self, ratio: float) -> None:
        """Damping from the ratio of actual to predicted decrease.

        In a narrow curved valley the damping just short of failure is the fastest: the factor by which it
        falls shrinks with a failure and grows again with successes in a row.
        """
        if ratio < 0.25:
            if self.successes:
                self.factor = max(1.5, np.sqrt(self.factor))
            self.damping = self.damping * (self.factor if self.successes else 10.0) or 1e-3
            self.successes = 0
            return
        self.successes += 1
        if self.successes > 1:
            self.factor = min(10.0, self.factor**2)
        self.damping = self.damping / self.factor if self.damping > 1e-6 else 0.0

    def verdict(self) -> tuple[Status, str]:
        """Judge the point where steps have become negligible, by what an undamped one would promise."""
        at = self.x, self.problem.lower, self.problem.upper
        if curves_down(self.hessian, *at):
            return "failed", "Stationary, but a saddle or a maximum: start from a point moved a little."
        left, rounding = what_is_left(self.gradient, self.hessian, *at)
        if rounding or abs(left) <= NEGLIGIBLE * abs(self.f) + self.floor:
            return "converged", f"The quadratic model promises {left:.1e} below a cost of {self.f:.6e}."
        return "failed", "No step improves: the derivatives do not belong to this cost, or are noisy."


def inside(problem: Problem, x0: ArrayLike, where: str) -> tuple[FloatArray, str]:
    """`x0` as a finite vector, clipped into the box, and a note if it was outside."""
    given = np.array(x0, dtype=float)
    if given.shape != (problem.dim,) or not np.isfinite(given).all():
        raise misuse("x0", where, f"finite, of shape ({problem.dim},)", x0)
    x = np.minimum(np.maximum(given, problem.lower), problem.upper)
    return x, "" if (x == given).all() else " The start was outside the bounds and was clipped."


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
