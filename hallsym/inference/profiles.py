"""Profile likelihood: how far one quantity can move before the data object, everything else at its best.

F is -2 log likelihood up to a constant, so the interval of level q holds the values whose profile rises by
at most chi2(q, 1) above the optimum: Venzon & Moolgavkar, Applied Statistics 37 (1988) 87,
doi:10.2307/2347496.

The minimiser p* of F + mu (g(p) - v)^2 has the least F of all points with its own g(p*), whatever v and mu:
it lies on the profile. So no constraint has to be met, only v has to be steered until the rise is the
threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hallsym.estimation.likelihood import Cost
from hallsym.inference.profile_tangent import tangent
from hallsym.inference.profile_walk import Pull, Side, Walk
from hallsym.model.quantities import Quantity

BETTER = 1e-3
"""Part of the threshold by which a point must lie below the optimum to count as a better one."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one quantity.

    `value`: at the optimum. `lower`, `upper`: the ends at `level`, where the rise is `threshold`. `values`,
    `rises`: (k,) the points that were computed, in ascending order, the optimum among them. `better`: (n,)
    parameters with a lower cost than the optimum, if some were met, and `drop`, how much lower F is there.
    """

    quantity: Quantity
    value: float
    level: float
    threshold: float
    lower: Side
    upper: Side
    values: np.ndarray
    rises: np.ndarray
    evaluations: int
    better: np.ndarray | None = None
    drop: float = 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends."""
        return self.lower.value, self.upper.value

    @property
    def ok(self) -> bool:
        """Whether both ends are where the threshold or the quantity's own bound is."""
        return all(side.status in ("reached", "at bound") for side in (self.lower, self.upper))

    def curve(self, points: int = 101) -> tuple[np.ndarray, np.ndarray]:
        """Return values and rises on a fine grid, for a picture: the signed root is nearly a line."""
        if len(self.values) < 2:
            return self.values, self.rises
        grid = np.linspace(self.values[0], self.values[-1], points)
        root = np.sign(self.values - self.value) * np.sqrt(np.maximum(self.rises, 0.0))
        return grid, scipy.interpolate.PchipInterpolator(self.values, root)(grid) ** 2


def profile(
    cost: Cost,
    p: np.ndarray,
    quantity: Quantity,
    *,
    held: Sequence[int],
    std: float | None = None,
    level: float = 0.95,
    scale: float = 1.0,
    points: int = 0,
) -> Profile:
    """Return the profile of `quantity` around the optimum `p` (n,) of `cost`.

    `held`: index of the parameters that stay as in `p`. `std`: about its standard uncertainty, the first
    step; from the curvature of `cost` by default. `scale`: square of the standard uncertainty that is
    believed over the likelihood's; the threshold is multiplied by it. `points`: further points per side,
    about evenly spaced. For several quantities give `cost.anchored(p)`: what belongs to `p` is computed once.
    """
    began = tangent(cost, p, quantity, held)
    threshold = float(scipy.special.chdtri(1, 1 - level)) * scale
    step = float(std) / np.sqrt(scale) if std is not None and np.isfinite(std) and std > 0 else began.std
    pull = Pull(cost, began, step, threshold)
    walks = [Walk(pull, sign) for sign in (-1.0, 1.0)]
    lower, upper = (walk.end() for walk in walks)
    for walk in walks:
        walk.fill(points)
    path = [pull.start] + [point for walk in walks for point in walk.path[1:]]
    path.sort(key=lambda point: point.value)
    lowest = min(path, key=lambda point: point.rise)
    better = lowest.rise < -BETTER * threshold
    return Profile(
        quantity=quantity,
        value=began.value,
        level=level,
        threshold=threshold,
        lower=lower,
        upper=upper,
        values=np.array([point.value for point in path]),
        rises=np.array([point.rise for point in path]),
        evaluations=pull.evaluations,
        better=lowest.p if better else None,
        drop=-lowest.rise if better else 0.0,
    )
