"""`Curve`: what the machine follows, its points, derivatives, length, curvature and extent; saved as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.files import atomic_write
from hallsym.reading import read_json, reading
from hallsym.trajectory.basis import BASES, basis_named
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.forms import ChebyshevForm, RationalForm, SplineForm

Array = np.ndarray
Form = FgForm | SplineForm | ChebyshevForm | RationalForm
FORMAT = "hallsym-curve-1"


@dataclass(frozen=True, eq=False)
class Curve:
    """A parametric curve on [start, stop] of the user's parameter; coordinates in SI, named `x_m`, `rz_rad`.

    `max_error_m`: largest distance from what it stands for, None if not known; `error_kind`: "bounded" (holds
    everywhere) or "estimated" (left-out points). `method`: how it was made.
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

    @property
    def rate(self) -> float:
        """Derivative of the form's parameter by the user's."""
        a, b = self.form.domain
        return (b - a) / (self.stop - self.start)

    def __call__(self, t: Array | float, derivative: int = 0) -> Array:
        """Return points (len(t), d), or the derivative by the user's parameter of that order.

        Raises `InputError` for parameters outside [start, stop].
        """
        t = np.atleast_1d(np.asarray(t, float))
        slack = 4e-16 * max(abs(self.start), abs(self.stop))
        if not np.all((t >= self.start - slack) & (t <= self.stop + slack)):
            raise InputError(
                f"Parameters of the curve must be within {self.start:.9g} .. {self.stop:.9g}; got "
                f"{t[~((t >= self.start) & (t <= self.stop))][0]:.9g}."
            )
        form = self.form
        for _ in range(derivative):
            form = form.derivative()
        return form.evaluate(self.inner(t)) * self.rate**derivative

    def parts(self, least: int = 64) -> Array:
        """Return parameters that cut the curve into smooth parts, at least `least` of them."""
        a, b = self.form.domain
        breaks = self.start + (self.form.breaks() - a) / (b - a) * (self.stop - self.start)
        return np.unique(np.r_[np.linspace(self.start, self.stop, least + 1), breaks])

    def speed(self, t: Array) -> Array:
        """Return `|dp/dt|` over the lengths (len(t),)."""
        return np.linalg.norm(self(t, 1)[:, self.lengths], axis=1)

    def arc_lengths(self) -> tuple[Array, Array]:
        """Return parameters and the length of path from the start to each, by Gauss-Legendre between them."""
        edges = self.parts(max(256, 4 * self.control_points))
        x, w = np.polynomial.legendre.leggauss(8)
        half = np.diff(edges)[:, None] / 2
        t = edges[:-1, None] + half * (1 + x)
        speed = self.speed(np.clip(t.ravel(), self.start, self.stop)).reshape(t.shape)
        return edges, np.r_[0.0, np.cumsum((half * speed) @ w)]

    def length(self) -> float:
        """Return the length of the path [m]."""
        return float(self.arc_lengths()[1][-1])

    def at_length(self, s: Array) -> Array:
        """Return the parameters at lengths of path `s` from the start, within [0, length]."""
        edges, lengths = self.arc_lengths()
        s = np.clip(np.atleast_1d(np.asarray(s, float)), 0.0, lengths[-1])
        t = np.interp(s, lengths, edges)
        x, w = np.polynomial.legendre.leggauss(8)
        for _ in range(3):  # Newton, within the part between two edges
            part = np.clip(np.searchsorted(lengths, s, side="right") - 1, 0, len(edges) - 2)
            half = (t - edges[part]) / 2
            inside = np.clip(edges[part][:, None] + half[:, None] * (1 + x), self.start, self.stop)
            travelled = lengths[part] + half * (self.speed(inside.ravel()).reshape(inside.shape) @ w)
            speed = self.speed(t)
            step = np.divide(s - travelled, speed, out=np.zeros_like(t), where=speed > 0)
            t = np.clip(t + step, edges[part], edges[part + 1])
        return t

    def curvature(self, t: Array | float) -> Array:
        """Return the curvature [1/m] (len(t),); infinite at a cusp."""
        one, two = self(t, 1)[:, self.lengths], self(t, 2)[:, self.lengths]
        square = np.sum(one * one, axis=1)
        area = np.sqrt(np.maximum(square * np.sum(two * two, axis=1) - np.sum(one * two, axis=1) ** 2, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(square > 0, area / square**1.5, np.inf)

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
        return {
            "format": FORMAT,
            "method": self.method,
            "coordinates": list(self.coordinates),
            "start": self.start,
            "stop": self.stop,
            "max_error_m": self.max_error_m,
            "error_kind": self.error_kind,
            "source": dict(self.source),
            "form": _form_to_dict(self.form),
        }

    def save(self, path: str | Path) -> None:
        """Write the curve as JSON; a file that was there is replaced only by a complete new one."""
        atomic_write(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")


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
    form, names = _form_from_dict(raw["form"]), tuple(str(name) for name in raw["coordinates"])
    start, stop, error = float(raw["start"]), float(raw["stop"]), raw["max_error_m"]
    if not (np.isfinite([start, stop]).all() and start < stop):
        raise ValueError("start must be less than stop")
    if form.control.ndim != 2 or form.control.shape[1] != len(names) or not names:
        raise ValueError("as many coordinates as columns of control points are needed")
    if not isinstance(form, RationalForm) and not np.isfinite(form.control).all():
        raise ValueError("control points must be finite")
    if raw["error_kind"] not in ("bounded", "estimated", None):
        raise ValueError("error_kind must be bounded, estimated or null")
    if not all(name.endswith(("_m", "_rad")) for name in names):
        raise ValueError("coordinates must be in m or rad, such as x_m")
    return Curve(
        form, start, stop, names, str(raw["method"]), None if error is None else float(error),
        raw["error_kind"], dict(raw["source"]),
    )  # fmt: skip


def _form_to_dict(form: Form) -> dict[str, Any]:
    if isinstance(form, FgForm):
        if form.basis.name not in BASES:
            raise InputError(f"A curve in the basis {form.basis.name!r} of your own cannot be saved.")
        shape = {} if form.basis.shape is None else {"shape": form.basis.shape}
        return {"kind": form.basis.name, **shape, "control": form.control.tolist()}
    if isinstance(form, SplineForm):
        knots = form.knots.tolist()
        return {"kind": "spline", "degree": form.degree, "knots": knots, "control": form.control.tolist()}
    if isinstance(form, ChebyshevForm):
        return {"kind": "chebyshev", "control": form.control.tolist()}
    parts = {"support": form.support, "values": form.values, "weights": form.weights}
    return {"kind": "aaa", **{key: [v.tolist() for v in part] for key, part in parts.items()}}


def _form_from_dict(raw: Mapping[str, Any]) -> Form:
    kind = raw["kind"]
    if kind == "aaa":
        parts = [tuple(np.array(v, float) for v in raw[key]) for key in ("support", "values", "weights")]
        if len({tuple(map(len, part)) for part in parts}) != 1:
            raise ValueError("support, values and weights must have the same lengths")
        return RationalForm(*parts)
    control = np.array(raw["control"], float)
    if kind == "spline":
        knots, degree = np.array(raw["knots"], float), int(raw["degree"])
        if degree < 1 or len(knots) != len(control) + degree + 1 or (np.diff(knots) < 0).any():
            raise ValueError("knots must increase and be as many as control points + degree + 1")
        return SplineForm(knots, degree, control)
    if kind == "chebyshev":
        return ChebyshevForm(control)
    return FgForm(basis_named(kind, raw.get("shape")), control)
