"""Bringing candidates back into the box, and whether a box is left to search in."""

from __future__ import annotations

import numpy as np

from solvers.problem import FloatArray, Problem, misuse


def clip(x: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Move what is outside onto the nearest bound."""
    return np.clip(x, lower, upper)


def reflect(x: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Fold what is outside back in, as often as it takes; what is inside stays as it is, to the bit.

    The bounds act as mirrors, so a candidate any number of widths away still lands inside in one step.
    Clipping instead piles candidates up on the faces of the box, where differences between them vanish.
    """
    outside = (x < lower) | (x > upper)
    if not outside.any():
        return x
    low, high = (np.broadcast_to(bound, x.shape)[outside] for bound in (lower, upper))
    width = high - low
    with np.errstate(invalid="ignore"):  # a fixed variable (width 0) or an infinite candidate: clip below
        folded = low + width - np.abs(np.mod(x[outside] - low, 2.0 * width) - width)
    inside = x.copy()
    inside[outside] = np.clip(np.where(np.isfinite(folded), folded, x[outside]), low, high)
    return inside


BOUNDS = {"reflect": reflect, "clip": clip}


def require_finite_box(problem: Problem, where: str) -> None:
    """Global methods sample the box, so it must have a finite width."""
    for name, bound in (("lower", problem.lower), ("upper", problem.upper), ("width", problem.width)):
        if not np.isfinite(bound).all():
            raise misuse(name, f"Problem, in {where},", "finite", bound)
