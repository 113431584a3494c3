"""Profile likelihood of one quantity, all others re-optimised.

F is -2 log likelihood up to a constant, so the interval of level q holds the values whose profile rises by
at most chi2(q, 1) above the optimum: Venzon & Moolgavkar, Applied Statistics 37 (1988) 87,
doi:10.2307/2347496.

The minimiser p* of F + mu (g(p) - v)^2 has the least F of all points with its own g(p*), whatever v and mu:
it lies on the profile. So no constraint has to be met: v is adjusted until the rise is the threshold.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy

import solvers
from hallsym.estimation.calibration import INTERVAL
from hallsym.estimation.factors import pseudo_inverse
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Cost
from hallsym.estimation.optimum import Scaled
from hallsym.model.model import Quantity
from hallsym.records import plain

THRESHOLD = float(scipy.special.chdtri(1, 1 - INTERVAL))
"""Rise of -2 log likelihood at the ends of an interval."""
BOUND = 1e-6
"""A parameter this near to a bound, in widths, is at it."""
ASYMMETRY, WIDTH = 0.02, 0.05
"""Tolerances of a normal interval against the profile's, in half-widths: between sides, and in width."""


@dataclass(frozen=True, eq=False)
class Tangent:
    """The profile of a quantity to first order: its value and where the optimum moves with it.

    `p`: (n,) the optimum, `cost`: F there. `direction`: (n,) dp / d quantity along the profile. `std`:
    standard uncertainty from the curvature of F alone; 0 if nothing that is free moves the quantity.
    `scaled`: the free parameters.
    """

    quantity: Quantity
    scaled: Scaled
    p: np.ndarray
    cost: float
    value: float
    std: float
    direction: np.ndarray


def tangent(cost: Cost, p: np.ndarray, quantity: Quantity, found: Determination) -> Tangent:
    """Return the first order of the profile of `quantity` at the optimum `p`; parameters at bounds stay."""
    p = np.asarray(p, dtype=float)
    scaled = Scaled(cost.summary.model, p, found.coordinates())
    f, gradient, hessian = cost.at(p).derivatives()
    value, slope = quantity.first(p)
    lower, upper = (bound[scaled.free] for bound in scaled.model.bounds)
    near, at, pushes = BOUND * scaled.scale, p[scaled.free], gradient[scaled.free]
    pinned = ((at - lower <= near) & (pushes > 0)) | ((upper - at <= near) & (pushes < 0))
    still = Tangent(quantity, scaled, p, f, value, 0.0, np.zeros_like(p))
    for axes in (found.coordinates(scaled.free[pinned].tolist()), scaled.axes):
        own, rise = axes.curvature(hessian), axes.slope(slope)
        if not len(rise) or not (np.diag(own) > 0).all():
            continue
        along = pseudo_inverse(own, 1e-14) @ rise
        size = float(rise @ along)
        if size > 0:
            still.direction[:] = axes.basis(len(p)) @ along / size
            return replace(still, std=float(np.sqrt(2.0 * size)))
    return still


def skewness(
    cost: Cost, p: np.ndarray, quantity: Quantity, *, found: Determination, std: float, scale: float = 1.0
) -> np.ndarray:
    """Return the half-widths of an interval over those of the normal one, (lower, upper), without a profile.

    Arguments as for `profile`. nan on a side that meets a bound. F is evaluated twice, along the tangent of
    the profile: it differs from the profile only in fourth order of the distance, and includes the third
    order, the asymmetry.
    """
    began, aim, ratios = tangent(cost, p, quantity, found), float(np.sqrt(THRESHOLD)), np.full(2, np.nan)
    lower, upper = cost.summary.model.bounds
    if not (began.std > 0 and np.isfinite(std) and std > 0):
        return ratios
    for side, sign in enumerate((-1.0, 1.0)):
        at = began.p + sign * aim * np.sqrt(scale) * began.std * began.direction
        inside = ((lower <= at) & (at <= upper))[began.scaled.free].all()
        if inside and quantity.lower <= began.value + sign * aim * std <= quantity.upper:
            away = abs(quantity.first(at)[0] - began.value)
            root = np.sqrt(max(cost.at(at).value - began.cost, 0.0))
            ratios[side] = away * np.sqrt(scale) / (root * std) if root > 0 else np.nan
    return ratios


def normal_enough(ratios: np.ndarray) -> bool:
    """Return whether the normal interval is good enough by `skewness`: symmetric, of the same width."""
    return bool(abs(ratios.mean() - 1.0) <= WIDTH and 0.5 * abs(ratios[1] - ratios[0]) <= ASYMMETRY)


Status = Literal["reached", "at bound", "open", "failed"]
STIFF = 10.0
"""mu in units of the profile's own curvature: p* then stops one part in eleven short of v."""
CLOSE = 1e-4
"""The end of an interval is found when the root of the rise is this near to that of the threshold."""
TRIES, STRETCH = 40, 4.0
"""Most points on a side, and largest step beyond the last, in distances from the estimate."""
WALL = 0.01
"""Smallest distance [standard uncertainties] of the walk from a point where the profile fails."""
SOLVED = 1e-6
"""Part of the threshold that a point of the profile may still be above its minimum."""


@dataclass(frozen=True)
class Side:
    """One end of an interval.

    `value`: the end (the bound, if the profile ends there; infinite or the last value reached when open; nan
    when it failed). `status`: "reached", "at bound" (the quantity's own bound comes before the threshold),
    "open" (the threshold is not met inside the bounds) or "failed". `reason`: a sentence, empty if reached.
    """

    value: float
    status: Status
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Point:
    """A point of the profile: the v it was pulled to, the quantity, its rise of F, the parameters."""

    v: float
    value: float
    rise: float
    p: np.ndarray

    @property
    def root(self) -> float:
        """Root of the rise, nearly linear in the quantity."""
        return float(np.sqrt(max(self.rise, 0.0)))


class Walk:
    """Walks along the profile from the optimum to the end on one side, `sign` -1 or 1.

    A point of the profile minimises F + mu (g - v)^2, per sample, in scaled parameters.
    """

    def __init__(self, cost: Cost, began: Tangent, std: float, threshold: float, sign: float) -> None:
        self.tangent, self.quantity, self.scaled, self.sign = began, began.quantity, began.scaled, sign
        self.std, self.threshold = std if began.std > 0 else 0.0, threshold
        self.aim = float(np.sqrt(threshold))
        self.mu = STIFF / self.std**2 if self.std > 0 else 0.0
        self.samples, self.problem = self.scaled.samples(cost), self.scaled.problem(cost)
        self.start = Point(began.value, began.value, 0.0, began.p)
        self.path = [self.start]
        self.name, low, high = self.quantity.name, self.quantity.lower, self.quantity.upper
        self.limit = high if sign > 0 else low
        self.slack = 1e-9 * (high - low if np.isfinite(high - low) else 1.0 + abs(began.value))

    def ahead(self, value: float, of: float) -> float:
        """How far `value` is outside of `of`."""
        return self.sign * (value - of)

    def end(self) -> Side:
        """Find the end: secant steps of v on the root of the rise, kept between points that bracket it."""
        start, std = self.start, self.std
        if self.ahead(self.limit, start.value) <= self.slack:
            return Side(self.limit, "at bound", f"{self.name} is at its bound")
        if std == 0.0:
            return Side(self.sign * np.inf, "open", f"nothing that is free moves {self.name}")
        near, far, before, wall, why = start, None, start, self.sign * np.inf, ""
        v = start.value + self.sign * self.aim * (std + 1.0 / (std * self.mu))
        for _ in range(TRIES):
            found = self.at(v)
            if isinstance(found, str):
                wall, why = v, found
            else:
                self.path.append(found)
                if (side := self.stopped(near, far, before, found)) is not None:
                    return side
                near, far = (near, found) if found.root >= self.aim else (found, far)
                v, before = self.next(before, found, near, far), found
            if self.ahead(wall, near.v) <= WALL * std:
                return Side(np.nan, "failed", f"the profile of {self.name} stops at {near.value:.6g}: {why}")
            v = v if self.ahead(wall, v) > 0 else 0.5 * (near.v + wall)
        if far is not None:
            reason = f"{TRIES} points did not pin down where the rise of {self.name} is enough"
            return Side(np.nan, "failed", reason)
        away = f"{abs(near.value - start.value) / std:.3g} standard uncertainties from the optimum"
        return Side(self.sign * np.inf, "open", f"{away} {self.name} has a rise of {near.rise:.3g}")

    def stopped(self, near: Point, far: Point | None, before: Point, found: Point) -> Side | None:
        """Return the end of the walk: the threshold, the quantity's bound, or bounds of other parameters."""
        if abs(found.root - self.aim) <= CLOSE * self.aim:
            step, value = found.root - before.root, found.value
            if abs(step) > CLOSE * self.aim:  # where the line through the last two points meets the threshold
                value += (self.aim - found.root) * (found.value - before.value) / step
            return Side(float(np.clip(value, self.quantity.lower, self.quantity.upper)), "reached")
        if found.root >= self.aim:
            return None
        if self.ahead(self.limit, found.value) <= self.slack:
            return Side(self.limit, "at bound", f"{self.name} meets its bound at a rise of {found.rise:.3g}")
        moved = self.ahead(found.value, near.value) > 1e-6 * abs(found.v - near.v)
        if far is None and not moved and found.root <= near.root + 1e-6 * self.aim:
            reason = f"bounds of other parameters stop {self.name} at {found.value:.6g}"
            return Side(found.value, "open", reason)
        return None

    def next(self, before: Point, found: Point, near: Point, far: Point | None) -> float:
        """Return the next v: by the secant, inside the bracket, not too far beyond known points."""
        step = found.root - before.root
        v = found.v + (self.aim - found.root) * (found.v - before.v) / step if step else np.nan
        if far is not None:
            inside = self.ahead(v, near.v) > 0 and self.ahead(far.v, v) > 0
            return v if inside else 0.5 * (near.v + far.v)
        most = near.v + self.sign * STRETCH * max(abs(near.v - self.start.v), self.std)
        return v if self.ahead(v, near.v) > 0 and self.ahead(most, v) > 0 else most

    def at(self, v: float) -> Point | str:
        """Return the point that the pull towards `v` ends at, or why there is none; from the known points."""
        if len(self.path) == 1:
            share = 1.0 / (1.0 + 1.0 / (self.mu * self.std**2))
            guess = self.start.p + share * (v - self.start.value) * self.tangent.direction
        else:
            a, b = sorted(self.path, key=lambda point: abs(point.v - v))[:2]
            span = b.v - a.v
            far = abs(span) > 1e-3 * abs(v - a.v)
            guess = a.p + (b.p - a.p) * ((v - a.v) / span) if far else a.p
        begin = self.scaled.to_unit(np.clip(guess, *self.scaled.model.bounds))
        tolerance = SOLVED * self.threshold / max(abs(self.tangent.cost), self.threshold)
        found = solvers.newton(self.pulled(v), begin, tolerance=tolerance)
        if found.status != "converged":
            return found.message
        p = self.scaled.from_unit(found.x)
        value = self.quantity.first(p)[0]
        rise = found.cost * self.samples - self.mu * (value - v) ** 2 - self.tangent.cost
        return Point(v, value, rise, p)

    def pulled(self, v: float) -> solvers.Problem:
        """F + mu (g - v)^2."""
        scaled, axes, weight = self.scaled, self.scaled.axes, self.mu / self.samples
        inner = self.problem.second_order

        def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            f, gradient, hessian = inner(x)
            value, slope, bend = self.quantity.at(scaled.from_unit(x))
            slope, off = axes.slope(slope) * scaled.scale, value - v
            bend = axes.curvature(bend) * np.outer(scaled.scale, scaled.scale)
            return (
                f + weight * off**2,
                gradient + 2.0 * weight * off * slope,
                hessian + 2.0 * weight * (np.outer(slope, slope) + off * bend),
            )

        return replace(self.problem, derivatives=derivatives, value=None)

    def fill(self, points: int) -> None:
        """Add points evenly spaced in v between the optimum and the farthest one."""
        first, last = self.start.v, self.path[-1].v
        for share in np.arange(1, points + 1) / (points + 1) if len(self.path) > 1 else ():
            found = self.at(first + share * (last - first))
            if not isinstance(found, str):
                self.path.append(found)


BETTER = 1e-3
"""Part of the threshold by which a point must lie below the optimum to count as a better one."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one quantity.

    `value`: at the optimum. `lower`, `upper`: ends of the 95 % interval, where the rise is `threshold`.
    `values`, `rises`: (k,) the points that were computed, in ascending order, the optimum among them.
    `better`: (n,) parameters with a lower cost than the optimum, if any, and `drop`, how much lower F is.
    """

    quantity: Quantity
    value: float
    threshold: float
    lower: Side
    upper: Side
    values: np.ndarray
    rises: np.ndarray
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

    def to_dict(self) -> dict[str, Any]:
        """Return the curve (values, rises of -2 log likelihood) and how its ends came."""
        ends = [
            {"value": plain(side.value), "status": side.status, "why": side.reason}
            for side in (self.lower, self.upper)
        ]
        return {
            "of": self.quantity.name,
            "unit": self.quantity.unit,
            "value": self.value,
            "threshold": self.threshold,
            "values": self.values.tolist(),
            "rises": self.rises.tolist(),
            "ends": ends,
        }


def profile(
    cost: Cost,
    p: np.ndarray,
    quantity: Quantity,
    *,
    found: Determination,
    std: float | None = None,
    scale: float = 1.0,
    points: int = 0,
) -> Profile:
    """Return the profile of `quantity` around the optimum `p` (n,) of `cost`.

    `found`: which parameters stay as in `p`, and the gauges of the others. `std`: about its standard
    uncertainty, the first step; from the curvature of `cost` by default. `scale`: squared ratio of the
    standard uncertainty to the likelihood's; the threshold is multiplied by it. `points`: further points per
    side, about evenly spaced. For several quantities give `cost.anchored(p)`: what belongs to `p` is computed
    once.
    """
    began, threshold = tangent(cost, p, quantity, found), THRESHOLD * scale
    step = float(std) / np.sqrt(scale) if std is not None and np.isfinite(std) and std > 0 else began.std
    walks = [Walk(cost, began, step, threshold, sign) for sign in (-1.0, 1.0)]
    lower, upper = (walk.end() for walk in walks)
    for walk in walks:
        walk.fill(points)
    path = sorted([*walks[0].path, *walks[1].path[1:]], key=lambda point: point.value)
    lowest = min(path, key=lambda point: point.rise)
    better = lowest.rise < -BETTER * threshold
    return Profile(
        quantity=quantity,
        value=began.value,
        threshold=threshold,
        lower=lower,
        upper=upper,
        values=np.array([point.value for point in path]),
        rises=np.array([point.rise for point in path]),
        better=lowest.p if better else None,
        drop=-lowest.rise if better else 0.0,
    )
