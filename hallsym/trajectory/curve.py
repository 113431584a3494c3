"""`Curve`: what the machine follows, its points, derivatives, length and extent; saved as JSON.

Its form is a curve in an fg-Bernstein basis (Micromachines 2019, 10, 597) or a B-spline.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import comb
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted, require
from hallsym.files import read_json, reading, write_json
from hallsym.trajectory.factorisation import BASES, Basis

Array = np.ndarray
FORMAT = "hallsym-curve-1"
MOST_VALUES = 1_000_000
"""Most numbers in memory during an evaluation."""


@dataclass(frozen=True, eq=False)
class FgForm:
    """sum_k C(n, k) f^k g^(n-k) control[k]; control points (n + 1, d)."""

    basis: Basis
    control: Array

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return self.basis.start, self.basis.stop

    @property
    def numbers(self) -> int:
        """Number of values that a controller has to store."""
        return self.control.size

    def edges(self, least: int) -> Array:
        """Return parameters that cut the curve into at least so many smooth parts, the ends included."""
        return np.linspace(*self.domain, least + 1)

    def evaluate(self, t: Array, derivative: int = 0) -> Array:
        """Return points (len(t), d), or their derivative by t, by de Casteljau's algorithm."""
        control = self.control
        for _ in range(derivative):
            control = self._slope(control)
        step = max(1, MOST_VALUES // control.size)
        return np.concatenate([self._points(control, t[k : k + step]) for k in range(0, len(t), step)])

    def _points(self, control: Array, t: Array) -> Array:
        f, g = self.basis.f(t)[:, None], self.basis.g(t)[:, None]
        p = np.repeat(control[:, None], len(t), axis=1)
        while len(p) > 1:
            p = g * p[:-1] + f * p[1:]
        return p[0]

    def _slope(self, p: Array) -> Array:
        """Control points of the derivative, of the same order: f' and g' are combinations of f and g."""
        alpha, beta = self.basis.rates
        n = len(p) - 1
        k = np.arange(n + 1)[:, None]
        after, before = np.vstack([p[1:], p[-1:]]), np.vstack([p[:1], p[:-1]])
        differences = (n - k) * (after - p) + k * (p - before)
        return alpha * differences + (beta - alpha) * ((n - k) * after - k * before)

    def series(self, t: Any) -> list[Any]:
        """Return the coordinates as power series of balls for the parameter as one (flint.arb_series)."""
        from flint import arb

        f, g = self.basis.series(t)
        n, one = len(self.control) - 1, 0 * t + 1
        powers = [one]
        for _ in range(n):
            powers.append(powers[-1] * g)
        found = [0 * t for _ in self.control.T]
        for k in range(n, -1, -1):
            share = powers[n - k] * comb(n, k)
            found = [p * f + share * arb(c) for p, c in zip(found, self.control[k].tolist(), strict=True)]
        return found


@dataclass(frozen=True, eq=False)
class SplineForm:
    """A B-spline of a degree: knots (n + degree + 2,), control points (n + 1, d). Degree 1 is a polyline."""

    knots: Array
    degree: int
    control: Array

    @property
    def domain(self) -> tuple[float, float]:
        """Interval of the parameter."""
        return float(self.knots[self.degree]), float(self.knots[-self.degree - 1])

    @property
    def numbers(self) -> int:
        """Number of values that a controller has to store: control points and inner knots."""
        return self.control.size + max(len(self.knots) - 2 * self.degree - 2, 0)

    def edges(self, least: int) -> Array:
        """Return parameters that cut the curve into at least so many smooth parts, the ends included."""
        start, stop = self.domain
        inner = self.knots[(self.knots > start) & (self.knots < stop)]
        return np.unique(np.r_[np.linspace(start, stop, least + 1), inner])

    def evaluate(self, t: Array, derivative: int = 0) -> Array:
        """Return points (len(t), d) of the curve, or their derivative by t."""
        from scipy.interpolate import BSpline  # slow to load

        return BSpline(self.knots, self.control, self.degree)(t, derivative)

    def piece(self, t: Array | float) -> Array:
        """Return the number of the knot with which the piece at t begins."""
        k = np.searchsorted(self.knots, t, side="right") - 1
        return np.clip(k, self.degree, len(self.control) - 1)

    def series(self, t: Any) -> list[Any]:
        """Return the piece at t as power series of balls (flint.arb_series), by de Boor's algorithm."""
        from flint import arb

        p, i = self.degree, self.piece(float(t[0].mid()))
        knots = [arb(v) for v in self.knots[i - p : i + p + 1].tolist()]
        points = [[0 * t + arb(c) for c in row] for row in self.control[i - p : i + 1].tolist()]
        for r in range(1, p + 1):
            for j in range(p, r - 1, -1):
                left, right = knots[j], knots[j + 1 + p - r]
                share = (t - left) / (right - left)
                points[j] = [a + share * (b - a) for a, b in zip(points[j - 1], points[j], strict=True)]
        return points[p]


Form = FgForm | SplineForm


@dataclass(frozen=True, eq=False)
class Curve:
    """A parametric curve on [start, stop] of the user's parameter; coordinates in SI, named `x_m`, `rz_rad`.

    `max_error_m`: largest distance from the nominal curve, None if not known; `error_kind`: "bounded" (valid
    everywhere) or "at the points". `method`: that made it.
    """

    form: Form
    start: float = 0.0
    stop: float = 1.0
    coordinates: tuple[str, ...] = ("x_m", "y_m")
    method: str = ""
    max_error_m: float | None = None
    error_kind: str | None = None
    source: Mapping[str, Any] = field(default_factory=dict)

    @property
    def control_points(self) -> int:
        """How many control points (or stored values) the curve has."""
        return len(self.form.control)

    @property
    def lengths(self) -> list[int]:
        """Indices of the coordinates that are lengths."""
        return [k for k, name in enumerate(self.coordinates) if name.endswith("_m")]

    def inner(self, t: Array) -> Array:
        """Return the parameter of the form for the user's parameter."""
        a, b = self.form.domain
        share = (np.asarray(t, float) - self.start) / (self.stop - self.start)
        return np.clip(a + share * (b - a), a, b)

    def outer(self, u: Array | float) -> Any:
        """Return the user's parameter for that of the form."""
        a, b = self.form.domain
        return np.clip(self.start + (u - a) / (b - a) * (self.stop - self.start), self.start, self.stop)

    def __call__(self, t: Array | float, derivative: int = 0) -> Array:
        """Return points (len(t), d), or the derivative by the user's parameter of that order.

        Raises `InputError` for parameters outside [start, stop].
        """
        t = np.atleast_1d(np.asarray(t, float))
        slack = 4e-16 * max(abs(self.start), abs(self.stop))
        outside = t[~((t >= self.start - slack) & (t <= self.stop + slack))]
        wanted = f"within {self.start:.9g} .. {self.stop:.9g}"
        require(not len(outside), "Parameters of the curve", wanted, outside[:1].tolist())
        a, b = self.form.domain
        rate = (b - a) / (self.stop - self.start)
        return self.form.evaluate(self.inner(t), derivative) * rate**derivative

    def length(self) -> float:
        """Return the length of the path [m], by Gauss-Legendre between edges."""
        edges = self.outer(self.form.edges(max(256, 4 * self.control_points)))
        x, w = np.polynomial.legendre.leggauss(8)
        half = np.diff(edges)[:, None] / 2
        t = edges[:-1, None] + half * (1 + x)
        slope = self(np.clip(t.ravel(), self.start, self.stop), 1)[:, self.lengths]
        return float(np.cumsum((half * np.linalg.norm(slope, axis=1).reshape(t.shape)) @ w)[-1])

    def extent(self) -> dict[str, tuple[float, float]]:
        """Return least and greatest value of each coordinate: sampled, then refined where it turns."""
        t = np.linspace(self.start, self.stop, max(1001, 20 * self.control_points))
        points, found = self(t), {}
        for k, name in enumerate(self.coordinates):
            ends = []
            for sign in (1.0, -1.0):
                j = int(np.argmin(sign * points[:, k]))
                near = np.linspace(t[max(j - 1, 0)], t[min(j + 1, len(t) - 1)], 501)
                ends.append(sign * float(np.min(sign * np.r_[self(near)[:, k], points[j, k]])))
            found[name] = (ends[0], ends[1])
        return found

    # -- files ---------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return the curve as the record that JSON holds (hallsym/trajectory/curve.schema.json)."""
        form = self.form
        kind: dict[str, Any] = (
            {"kind": form.basis.name}
            if isinstance(form, FgForm)
            else {"kind": "spline", "degree": form.degree, "knots": form.knots.tolist()}
        )
        return {
            "format": FORMAT,
            "method": self.method,
            "coordinates": list(self.coordinates),
            "start": self.start,
            "stop": self.stop,
            "max_error_m": self.max_error_m,
            "error_kind": self.error_kind,
            "source": dict(self.source),
            "form": {**kind, "control": form.control.tolist()},
        }

    def save(self, path: str | Path) -> None:
        """Write the curve as JSON; a file that was there is replaced only by a complete new one."""
        write_json(path, self.to_dict())


def is_curve(path: str | Path) -> bool:
    """Return whether a file is a curve that `Curve.save` wrote."""
    try:
        raw = read_json(path, "File", "copy it again")
    except InputError:
        return False
    return isinstance(raw, dict) and str(raw.get("format")).startswith("hallsym-curve")


def read_curve(path: str | Path) -> Curve:
    """Read a curve that `Curve.save` wrote. Raises `InputError` for a missing or foreign file."""
    remedy = "a curve is what 'hallsym trajectory' saves with -o curve.json"
    raw = read_json(path, "Curve", remedy, "make one with 'hallsym trajectory'")
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        found = raw.get("format") if isinstance(raw, dict) else None
        raise InputError(
            f"File {quoted(path)} must be a curve of format {FORMAT!r}; instead it says {found!r}."
        )
    with reading(path, "Curve", "is damaged", "make it again with 'hallsym trajectory'"):
        return curve_from_dict(raw)


def curve_from_dict(raw: Mapping[str, Any]) -> Curve:
    """Return the curve of a record; raises ValueError, KeyError or TypeError where it cannot be one."""
    said, names = raw["form"], tuple(str(name) for name in raw["coordinates"])
    control = np.array(said["control"], float)
    if said["kind"] == "spline":
        knots, degree = np.array(said["knots"], float), int(said["degree"])
        if degree < 1 or len(knots) != len(control) + degree + 1 or not (np.diff(knots) >= 0).all():
            raise ValueError("knots must be numbers that increase, as many as control points + degree + 1")
    form = (
        SplineForm(knots, degree, control)
        if said["kind"] == "spline"
        else FgForm(BASES[said["kind"]], control)
    )
    start, stop, error = float(raw["start"]), float(raw["stop"]), raw["max_error_m"]
    if not (np.isfinite([start, stop]).all() and start < stop):
        raise ValueError("start must be less than stop")
    if form.control.ndim != 2 or form.control.shape[1] != len(names) or not names:
        raise ValueError("as many coordinates as columns of control points are needed")
    if not np.isfinite(form.control).all():
        raise ValueError("control points must be finite")
    if raw["error_kind"] not in ("bounded", "at the points", None):
        raise ValueError("error_kind must be bounded, at the points or null")
    if not all(name.endswith(("_m", "_rad")) for name in names):
        raise ValueError("coordinates must be in m or rad, such as x_m")
    return Curve(
        form, start, stop, names, str(raw["method"]), None if error is None else float(error),
        raw["error_kind"], dict(raw["source"]),
    )  # fmt: skip
