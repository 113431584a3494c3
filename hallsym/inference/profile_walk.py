"""The walk along a profile to one end of an interval: points by a pull, the pull by secant steps."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

import solvers
from hallsym.estimation.likelihood import Cost
from hallsym.inference.profile_tangent import Tangent

Status = Literal["reached", "at bound", "open", "failed"]
STIFF = 10.0
"""mu in units of the profile's own curvature: p* then stops one part in eleven short of v."""
CLOSE = 1e-4
"""The end of an interval is found when the root of the rise is this near to that of the threshold."""
TRIES, STRETCH = 40, 4.0
"""Points that are tried on a side, and how far one may go beyond the last, in distances from the estimate."""
WALL = 0.01
"""How near [standard uncertainties] the walk goes to where the profile cannot be computed any more."""
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


class Pull:
    """Points of the profile: minimises F + mu (g - v)^2, per sample, in scaled parameters."""

    def __init__(self, cost: Cost, began: Tangent, std: float, threshold: float) -> None:
        self.tangent, self.quantity, self.scaled = began, began.quantity, began.scaled
        self.std, self.threshold, self.evaluations = std if began.std > 0 else 0.0, threshold, 0
        self.mu = STIFF / self.std**2 if self.std > 0 else 0.0
        self.start = Point(began.value, began.value, 0.0, began.p)
        self.samples, self.problem = self.scaled.samples(cost), self.scaled.problem(cost)

    def solve(self, guess: np.ndarray, v: float) -> "Point | str":
        """Return the point of the profile that the pull towards `v` ends at, or why there is none."""
        start = self.scaled.to_unit(np.clip(guess, *self.scaled.model.bounds))
        tolerance = SOLVED * self.threshold / max(abs(self.tangent.cost), self.threshold)
        found = solvers.newton(self.pulled(v), start, tolerance=tolerance)
        self.evaluations += found.evaluations
        if found.status != "converged":
            return found.message
        p = self.scaled.from_unit(found.x)
        value = self.quantity.first(p)[0]
        rise = found.cost * self.samples - self.mu * (value - v) ** 2 - self.tangent.cost
        return Point(v, value, rise, p)

    def pulled(self, v: float) -> solvers.Problem:
        """F + mu (g - v)^2."""
        scaled, free, weight = self.scaled, self.scaled.free, self.mu / self.samples
        inner = self.problem.second_order

        def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            f, gradient, hessian = inner(x)
            value, slope, bend = self.quantity.at(scaled.from_unit(x))
            slope, off = slope[free] * scaled.scale, value - v
            bend = bend[np.ix_(free, free)] * np.outer(scaled.scale, scaled.scale)
            return (
                f + weight * off**2,
                gradient + 2.0 * weight * off * slope,
                hessian + 2.0 * weight * (np.outer(slope, slope) + off * bend),
            )

        problem = self.problem
        return solvers.Problem(problem.cost, problem.lower, problem.upper, derivatives=derivatives)


class Walk:
    """Walks from the optimum to the end on one side, `sign` -1 or 1."""

    def __init__(self, pull: Pull, sign: float) -> None:
        self.pull, self.sign, self.aim = pull, sign, float(np.sqrt(pull.threshold))
        self.path = [pull.start]
        quantity = pull.quantity
        self.limit = quantity.upper if sign > 0 else quantity.lower
        width = quantity.upper - quantity.lower
        self.slack = 1e-9 * (width if np.isfinite(width) else 1.0 + abs(pull.start.value))

    def ahead(self, value: float, of: float) -> float:
        """How far `value` is outside of `of`."""
        return self.sign * (value - of)

    def end(self) -> Side:
        """Find the end: secant steps of v on the root of the rise, kept between points that bracket it."""
        name, start, std = self.pull.quantity.name, self.pull.start, self.pull.std
        if self.ahead(self.limit, start.value) <= self.slack:
            return Side(self.limit, "at bound", f"{name} is at its bound")
        if std == 0.0:
            return Side(self.sign * np.inf, "open", f"nothing that is free moves {name}")
        near, far, before, wall, why = start, None, start, self.sign * np.inf, ""
        v = start.value + self.sign * self.aim * (std + 1.0 / (std * self.pull.mu))
        for _ in range(TRIES):
            found = self.at(v)
            if isinstance(found, str):
                wall, why = v, found
            else:
                self.path.append(found)
                if abs(found.root - self.aim) <= CLOSE * self.aim:
                    return Side(self.within(self.crossing(before, found)), "reached")
                if (side := self.stopped(near, far, found)) is not None:
                    return side
                near, far = (near, found) if found.root >= self.aim else (found, far)
                v, before = self.next(before, found, near, far), found
            if self.ahead(wall, near.v) <= WALL * std:
                return Side(np.nan, "failed", f"the profile of {name} stops at {near.value:.6g}: {why}")
            v = v if self.ahead(wall, v) > 0 else 0.5 * (near.v + wall)
        return self.unfinished(near, far)

    def stopped(self, near: Point, far: Point | None, found: Point) -> Side | None:
        """What ends the walk before the threshold: the quantity's bound, or those of other parameters."""
        name = self.pull.quantity.name
        if found.root >= self.aim:
            return None
        if self.ahead(self.limit, found.value) <= self.slack:
            return Side(self.limit, "at bound", f"{name} meets its bound at a rise of {found.rise:.3g}")
        moved = self.ahead(found.value, near.value) > 1e-6 * abs(found.v - near.v)
        if far is None and not moved and found.root <= near.root + 1e-6 * self.aim:
            return Side(found.value, "open", f"bounds of other parameters stop {name} at {found.value:.6g}")
        return None

    def unfinished(self, near: Point, far: Point | None) -> Side:
        """What is known after the last try."""
        name, std = self.pull.quantity.name, self.pull.std
        if far is not None:
            return Side(
                np.nan, "failed", f"{TRIES} points did not pin down where the rise of {name} is enough"
            )
        away = abs(near.value - self.pull.start.value) / std
        reason = f"{away:.3g} standard uncertainties from the optimum {name} has a rise of {near.rise:.3g}"
        return Side(self.sign * np.inf, "open", reason)

    def within(self, value: float) -> float:
        """Return the value inside the quantity's own bounds."""
        return float(min(max(value, self.pull.quantity.lower), self.pull.quantity.upper))

    def crossing(self, before: Point, found: Point) -> float:
        """Value at which the root meets its aim, by the line through the last two points."""
        step = found.root - before.root
        if abs(step) <= CLOSE * self.aim:
            return found.value
        return found.value + (self.aim - found.root) * (found.value - before.value) / step

    def next(self, before: Point, found: Point, near: Point, far: Point | None) -> float:
        """Return the v to try: by the secant, inside the bracket, not too far beyond what is known."""
        step = found.root - before.root
        v = found.v + (self.aim - found.root) * (found.v - before.v) / step if step else np.nan
        if far is not None:
            inside = self.ahead(v, near.v) > 0 and self.ahead(far.v, v) > 0
            return v if inside else 0.5 * (near.v + far.v)
        most = near.v + self.sign * STRETCH * max(abs(near.v - self.pull.start.v), self.pull.std)
        return v if self.ahead(v, near.v) > 0 and self.ahead(most, v) > 0 else most

    def at(self, v: float) -> "Point | str":
        """Return the point that the pull towards `v` ends at, from where the known points lead."""
        start, pull = self.pull.start, self.pull
        if len(self.path) == 1:
            share = 1.0 / (1.0 + 1.0 / (pull.mu * pull.std**2))
            return pull.solve(start.p + share * (v - start.value) * pull.tangent.direction, v)
        a, b = sorted(self.path, key=lambda point: abs(point.v - v))[:2]
        apart = b.v - a.v
        far = abs(apart) > 1e-3 * abs(v - a.v)
        return pull.solve(a.p + (b.p - a.p) * ((v - a.v) / apart) if far else a.p, v)

    def fill(self, points: int) -> None:
        """Add points evenly spaced in v between the optimum and the farthest one."""
        last = self.path[-1].v
        for share in np.arange(1, points + 1) / (points + 1):
            found = (
                self.at(self.pull.start.v + share * (last - self.pull.start.v)) if len(self.path) > 1 else ""
            )
            if not isinstance(found, str):
                self.path.append(found)
