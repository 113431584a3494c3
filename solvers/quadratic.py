"""The bounded quadratic step that Newton takes and by which every local result is judged."""

from __future__ import annotations

import numpy as np

from solvers.problem import FloatArray

TINY = float(np.finfo(float).tiny)
SMALL_STEP = 1e-8  # of the variable or its box
RIDGE = 1e-10  # of the unit diagonal: holds back directions the data say nothing about


def bounded_step(
    gradient: FloatArray, hessian: FloatArray, low: FloatArray, high: FloatArray, damping: float = 0.0
) -> tuple[FloatArray, float]:
    """Minimise the damped quadratic model within `low <= step <= high`; return the step and its promise.

    `low = lower - x <= 0` and `high = upper - x >= 0`. Variables whose step would leave the box are set
    on the bound and the rest is solved again. The promise is how much the undamped model says is gained.
    The Hessian is brought to unit diagonal first, so the units of the variables do not matter.
    """
    step = np.zeros_like(gradient)
    free = np.where(gradient > 0.0, low < 0.0, high > 0.0) & (low < high)
    if free.all():
        wish = -_solve(hessian, gradient, damping + RIDGE)
        if ((wish >= low) & (wish <= high)).all():
            return wish, float(-(wish @ gradient) - 0.5 * (wish @ hessian @ wish))
    while free.any():
        inner, numbers = hessian[np.ix_(free, free)], np.flatnonzero(free)
        wish = -_solve(inner, (gradient + hessian @ step)[free], damping + RIDGE)
        outside = (wish < low[free]) | (wish > high[free])
        if not outside.any():
            step[free] = wish
            break
        pinned = numbers[outside]
        step[pinned] = np.clip(wish[outside], low[pinned], high[pinned])
        free[pinned] = False
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
