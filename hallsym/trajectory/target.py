"""The nominal curve as a search sees it: its points at any nodes, and quick errors of a curve from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hallsym.trajectory.bounds import chords, is_polyline
from hallsym.trajectory.curve import Curve
from hallsym.trajectory.methods import Method, nodes_named
from hallsym.trajectory.nominal import Nominal

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Target:
    """A nominal curve with what its search needs again and again: points to compare with."""

    nominal: Nominal

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Parameters in [0, 1], denser towards the ends, and the points there."""
        u = np.unique(np.r_[np.linspace(0, 1, 1501), np.sin(np.linspace(0, np.pi / 2, 801)) ** 2])
        return u, self.at(u)

    def at(self, u: Array) -> Array:
        """Return the nominal points at shares u of the range."""
        n = self.nominal
        return n(np.clip(n.start + u * (n.stop - n.start), n.start, n.stop))

    def made(self, method: Method, nodes: str, count: int, control: int) -> Curve:
        """Return the curve that a method makes of `count` points."""
        u = nodes_named(nodes, count)
        n = self.nominal
        return Curve(method.make(u, self.at(u), control), n.start, n.stop, n.coordinates, method.name)

    def sampled(self, curve: Curve, per_piece: int = 8) -> float:
        """Largest error at the points compared: quick, and below the bound."""
        pieces = len(curve.form.breaks()) + 1
        u, points = self.grid
        if pieces > 150:
            u = np.linspace(0, 1, pieces * per_piece + 1)
            points = self.at(u)
        return float(self.errors(curve, u, points).max())

    def errors(self, curve: Curve, u: Array, points: Array | None = None) -> Array:
        """Return distances (len(u),) of a curve from the nominal points at shares u, across chords."""
        a, b = curve.form.domain
        inner = np.clip(a + u * (b - a), a, b)
        e = (curve.form.evaluate(inner) - (self.at(u) if points is None else points))[:, curve.lengths]
        if is_polyline(curve):
            _, way, _ = chords(curve, inner)
            e = e - way.T * np.sum(way.T * e, axis=1)[:, None]
        return np.sqrt(np.sum(e * e, axis=1))


def resolution(points: Array) -> float:
    """Return the least error that float64 can hold at such coordinates: one unit in the last place."""
    return float(np.spacing(np.abs(points).max()))
