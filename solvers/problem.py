"""The nouns every optimiser shares: `Problem`, `Population`, `Result`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Derivatives = Callable[[FloatArray], tuple[float, FloatArray, FloatArray]]
Status = Literal["converged", "budget", "interrupted", "failed"]
INTERRUPTED = "Interrupted: this is the best point so far; start from it to go on."


@dataclass(frozen=True, eq=False)
class Problem:
    """A cost to be made small inside a box.

    cost: a whole population at once, `(n, dim) -> (n,)`; anything that is not finite counts as +inf.
    lower, upper: `(dim,)`; finite for the global methods, infinite is fine for the local ones;
        where both are equal the variable is fixed.
    derivatives: `x (dim,) -> (f, gradient (dim,), Hessian (dim, dim))`, exact, of the same function as
        `cost`; the local methods need it.
    value: `x (dim,) -> f`, where that alone costs less: a step that does not lower it has no derivatives.

    >>> Problem(lambda x: (x**2).sum(axis=1), lower=[-1.0, -1.0], upper=[1.0, 2.0]).dim
    2
    """

    cost: Callable[[FloatArray], FloatArray]
    lower: FloatArray
    upper: FloatArray
    derivatives: Derivatives | None = None
    value: Callable[[FloatArray], float] | None = None

    def __post_init__(self) -> None:
        """Copy the bounds into read-only arrays, and refuse those that enclose nothing."""
        for name in ("lower", "upper"):
            bound = np.array(getattr(self, name), dtype=float)
            if bound.ndim != 1 or bound.size == 0 or np.isnan(bound).any():
                raise misuse(name, "Problem", "one-dimensional, not empty and free of nan", bound)
            bound.flags.writeable = False
            object.__setattr__(self, name, bound)
        if self.lower.shape != self.upper.shape:
            raise misuse("upper", "Problem", f"as long as lower, {self.lower.size}", self.upper.size)
        if not (self.lower <= self.upper).all():
            worst = int(np.argmax(self.lower > self.upper))
            wanted = f"at most upper[{worst}] = {self.upper[worst]:g}"
            raise misuse(f"lower[{worst}]", "Problem", wanted, self.lower[worst])

    @property
    def dim(self) -> int:
        """Number of variables."""
        return self.lower.size

    @property
    def width(self) -> FloatArray:
        """`upper - lower`, shape (dim,)."""
        with np.errstate(over="ignore"):
            return self.upper - self.lower

    @property
    def second_order(self) -> Derivatives:
        """Value, gradient and Hessian; an error where the problem has none."""
        if self.derivatives is None:
            raise misuse("derivatives", "Problem", "given for a local method", None)
        return self.derivatives

    def require_finite_box(self, where: str) -> None:
        """Global methods sample the box, so it must have a finite width."""
        for name, bound in (("lower", self.lower), ("upper", self.upper), ("width", self.width)):
            if not np.isfinite(bound).all():
                raise misuse(name, f"Problem, in {where},", "finite", bound)

    def evaluate(self, x: FloatArray) -> Population:
        """Cost of every row of `x (n, dim)`; a value that is not finite becomes +inf."""
        cost = np.asarray(self.cost(x), dtype=float)
        if cost.shape != (len(x),):
            raise misuse("cost", "Problem", f"a function that returns shape ({len(x)},)", cost.shape)
        return Population(x, np.where(np.isfinite(cost), cost, np.inf))


@dataclass(frozen=True, eq=False)
class Population:
    """Points and their costs: `x (n, dim)`, `cost (n,)`."""

    x: FloatArray
    cost: FloatArray

    def __len__(self) -> int:
        """Number of points."""
        return len(self.cost)

    @property
    def best(self) -> FloatArray:
        """The cheapest point, shape (dim,)."""
        return self.x[np.argmin(self.cost)]

    def improved_by(self, tried: Population) -> Population:
        """Row by row, take the new point where it is strictly better."""
        wins = tried.cost < self.cost
        return Population(np.where(wins[:, None], tried.x, self.x), np.where(wins, tried.cost, self.cost))

    def cheapest(self, n: int) -> Population:
        """The `n` cheapest points, cheapest first; equal costs keep their order."""
        order = np.argsort(self.cost, kind="stable")[:n]
        return Population(self.x[order], self.cost[order])


Evaluate = Callable[[FloatArray], Population]


# A global method: a generator function that yields its population after each generation. It gets the first
# population, `evaluate` (brings rows into the box, counts them, returns them with their cost) and a random
# generator.
Solver = Callable[..., Iterator[Population]]


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a solver.

    x (dim,), cost: the best point evaluated.
    status: "converged", "budget", "interrupted" or "failed"; message: what that means here, and what to do.
    evaluations: rows of `Problem.cost`, or calls of the derivatives.
    first: cost at the start, the least of a population; infinite where it was not evaluated.
    seconds: wall time.
    """

    x: FloatArray
    cost: float
    status: Status
    message: str
    evaluations: int
    first: float
    seconds: float


def misuse(what: str, where: str, wanted: str, received: object) -> ValueError:
    """The one sentence pattern for wrong input."""
    return ValueError(f"Input {what} of {where} must be {wanted}; instead received {received!r}.")


def choice(name: str, known: tuple[str, ...], what: str, where: str) -> str:
    """Return `name` if it is known, else raise an error that lists the known ones."""
    if name not in known:
        raise misuse(what, where, "one of " + ", ".join(known), name)
    return name


def rows(points: ArrayLike, dim: int, what: str, where: str) -> FloatArray:
    """Points as a finite array (n, dim); a single point may be given as (dim,)."""
    x = np.atleast_2d(np.asarray(points, dtype=float))
    if x.ndim != 2 or x.shape[1] != dim or not np.isfinite(x).all():
        raise misuse(what, where, f"finite, of shape (n, {dim})", np.asarray(points))
    return x
