"""The 6-DOF precision stage read by three or more Hall probes.

Chen, Liu, Fu, Song, Tan: Calibration of the Hall Measurement System for a 6-DOF Precision Stage Using
Self-Adaptive Hybrid TLBO, Sensors 2016, 16, 872, doi:10.3390/s16060872. Equation numbers are the paper's;
the published text lost its minus signs, docs/theory.md says how they were restored.

One model and its effects: `stage15` is Eq. (15); with `zero_deviation` it is Eq. (30), with
`vertical_coupling` Eq. (31). Positions in m, angles in rad, a in 1/m, b and c in 1/rad.
Valid for planar motion up to about 2 mm and 1 mrad (`exact_rotation` beyond that).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import radians
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, require
from hallsym.families import published
from hallsym.families.mechanisms import free, started
from hallsym.log import Meta
from hallsym.model import Combination, Family, Model, Parameter, Signals, effect
from hallsym.toml import number

FAMILY = Family("stage")
"""The family of these models, set by the package."""
POSE = ("x_m", "y_m", "rz_rad")
REFERENCES = ("x_ref_m", "y_ref_m", "rz_ref_rad")
STATE = ("z_m", "rx_rad", "ry_rad")
ORIGIN = 0.5
"""Largest x0 and y0, the point at which Z is measured [m]: a stage is no larger than this."""


@dataclass(frozen=True)
class Probe:
    """A Hall probe: its log column, position [m] in the stage frame, and direction of positive reading."""

    channel: str
    position: tuple[float, float]
    senses: tuple[float, float]

    @property
    def label(self) -> str:
        """Letter used in parameter names: `hall_a_m` gives `A`."""
        parts = self.channel.split("_")
        return parts[1].upper() if len(parts) > 2 else self.channel

    @property
    def entry(self) -> dict[str, Any]:
        """The probe as a log's meta.json and a saved calibration describe it."""
        return {"channel": self.channel, "position_m": list(self.position), "senses": list(self.senses)}


def paper_layout() -> tuple[Probe, ...]:
    """Return the paper's stage: A at (+H1x, +H1y) and B at (-H2x, +H2y) sense Y, C at (+H3x, +H3y) X."""
    h = published.values("table1_designed")
    return (
        Probe("hall_a_m", (h["H1x"], h["H1y"]), (0.0, 1.0)),
        Probe("hall_b_m", (-h["H2x"], h["H2y"]), (0.0, 1.0)),
        Probe("hall_c_m", (h["H3x"], h["H3y"]), (1.0, 0.0)),
    )


@cache
def stage15(layout: tuple[Probe, ...] | None = None) -> Model:
    """Return Model (15): reading_k = eta_k n_k . (x - p_y Rz, y + p_x Rz), n_k rotated by theta_k.

    `layout`: three or more probes; the paper's by default. Bounds are Table 3's for the paper's layout, else
    H +-25 % (at least 50 mm), eta .55 to 1.05, theta +-8 deg.
    """
    probes = paper_layout() if layout is None else tuple(layout)
    _check(probes)

    def displacement(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["displacement"] = ca.vertcat(*along(probes, p, *(s[c] for c in POSE)))

    def gain(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["gain"] = ca.vertcat(*(p[f"eta_{probe.label}"] for probe in probes))  # (14)

    def reading(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["reading"] = s["gain"] * s["displacement"]  # (13), (15)

    return Model(
        name="stage15",
        family=FAMILY,
        pose=POSE,
        references=REFERENCES,
        state=STATE,
        channels=tuple(p.channel for p in probes),
        parameters=_parameters(probes, paper=probes == paper_layout()),
        steps=(("mechanics", displacement), ("transducer", gain), ("electronics", reading)),
        combinations=tuple(_lever_arm(k, probe) for k, probe in enumerate(probes)),
        layout=probes,
        closed_form=closed_form,
    )


@cache
def stage30(layout: tuple[Probe, ...] | None = None) -> Model:
    """Return Model (30): Model (15) with the zero deviations of each run."""
    return replace(zero_deviation(stage15(layout)), name="stage30")


@cache
def stage31(layout: tuple[Probe, ...] | None = None) -> Model:
    """Return Model (31): Model (30) with gains that follow Z, Rx, Ry in nine free coefficients."""
    return replace(vertical_coupling(stage30(layout)), name="stage31")


@cache
def stage31_tied(layout: tuple[Probe, ...] | None = None) -> Model:
    """Return Model (31) with the vertical coupling of a rigid stage: three slopes and one point."""
    return replace(tied_vertical_coupling(stage30(layout)), name="stage31_tied")


# -- effects ---------------------------------------------------------------------------------------------


@effect(link="reference", diagnosed=False)
def zero_deviation(model: Model) -> Model:
    """Zero deviations of the probes in each run, Eq. (30).

    One per probe and run, in m. They enter as displacement d_k = delta_k / phi_k(0); |delta_k| <= 10 um in
    the paper.
    """
    offsets = tuple(
        Parameter(f"delta_{p.label}", 0.0, -10e-6, 10e-6, "m", f"zero deviation of probe {p.label} in a run")
        for p in model.layout
    )

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["displacement"] = s["displacement"] + ca.vertcat(*(p[z.name] for z in offsets))

    return model.with_step("reference", step, effect="zero_deviation", offsets=offsets)


@effect(link="transducer", diagnosed=False, unless=("tied_vertical_coupling",))
def vertical_coupling(model: Model) -> Model:
    """Gain follows Z, Rx, Ry: a, b, c of Eq. (31).

    phi_k = eta_k + a_k Z + b_k Rx + c_k Ry with bounds of Table 5. Its signs belong to the paper's layout;
    for another layout the bounds are +-5000.
    """
    units = {"a": "1/m", "b": "1/rad", "c": "1/rad"}
    what = {"a": "Z", "b": "Rx", "c": "Ry"}
    paper = published.bounds() if model.layout == paper_layout() else {}
    parameters = tuple(
        Parameter(
            f"{q}_{p.label}",
            0.0,
            *paper.get(f"{q}_{p.label}", (-5000.0, 5000.0)),
            units[q],
            f"change of gain {p.label} with {what[q]}",
        )
        for p in model.layout
        for q in "abc"
    )

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        rows = [
            p[f"a_{k}"] * s["z_m"] + p[f"b_{k}"] * s["rx_rad"] + p[f"c_{k}"] * s["ry_rad"]  # (31)
            for k in (probe.label for probe in model.layout)
        ]
        s["gain"] = s["gain"] + ca.vertcat(*rows)

    return model.with_step("transducer", step, effect="vertical_coupling", parameters=parameters)


@effect(link="transducer", diagnosed=False, unless=("vertical_coupling",))
def tied_vertical_coupling(model: Model) -> Model:
    """Gain follows the height of each probe on a rigid stage.

    A rigid stage lifts probe k by Z + (y_k - y0) Rx - (x_k - x0) Ry, where (x0, y0) is the point at which Z
    is measured: b_k / a_k = y_k - y0 and c_k / a_k = -(x_k - x0). Five parameters instead of nine, and the
    probe coordinates along the sensing axis become observable.
    """
    slopes = free(
        {f"a_{p.label}": f"change of gain {p.label} with height" for p in model.layout}, 5000.0, "1/m"
    )
    point = free({f"{c}0": f"{c} of the point where Z is measured" for c in "xy"}, ORIGIN, "m")

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        rows = []
        for k, probe in enumerate(model.layout):
            x, y = position(k, probe, p)
            lift = s["z_m"] + (y - p["y0"]) * s["rx_rad"] - (x - p["x0"]) * s["ry_rad"]
            rows.append(p[f"a_{probe.label}"] * lift)
        s["gain"] = s["gain"] + ca.vertcat(*rows)

    return model.with_step("transducer", step, effect="tied_vertical_coupling", parameters=slopes + point)


@effect(link="mechanics", diagnosed=False)
def exact_rotation(model: Model) -> Model:
    """Finite rotation, Eq. (2), in place of small angles.

    A probe at p moves by R(Rz) (p + (x, y)) - p; the terms that Eq. (8) dropped are x Rz, y Rz and Rz^2.
    """

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        versine = s.derive("1 - cos rz", 1 - ca.cos(s["rz_rad"]))
        sine = s.derive("sin rz", ca.sin(s["rz_rad"]))
        rows = []
        for k, probe in enumerate(model.layout):
            (x, y), (nx, ny) = position(k, probe, p), direction(probe, p)
            px, py = x + s["x_m"], y + s["y_m"]
            moved = nx * (-versine * px - sine * py) + ny * (sine * px - versine * py)  # (2)
            small = nx * (-y * s["rz_rad"]) + ny * (x * s["rz_rad"])  # (8)
            rows.append(moved - small)
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    return model.with_step("mechanics", step, effect="exact_rotation")


# -- a start in closed form ------------------------------------------------------------------------------


def closed_form(model: Model, coefficients: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return parameters from unconstrained feature coefficients: each probe is a rank-1 matrix.

    `coefficients`: feature name -> (n_channels,), from linear least squares. Row "state", column "pose" of a
    probe's matrix is phi's coefficient times (n_x, n_y, lever arm), so its leading singular vectors are the
    gain and the sensing direction, whatever the angle. Parameters it cannot see stay nominal.
    """
    p = model.named(model.nominal)
    slopes, none = {}, np.zeros(len(model.layout))
    for k, probe in enumerate(model.layout):
        rows = [[f"{pose}*{state}".rstrip("*") for pose in model.pose] for state in ("", *STATE)]
        matrix = np.array([[coefficients.get(name, none)[k] for name in row] for row in rows])
        weight = np.array([1.0, *[_TYPICAL] * len(STATE)])[:, None]
        _, _, v = np.linalg.svd(matrix * weight)
        phi, pose = matrix @ v[0], v[0]  # matrix = phi pose^T
        norm = float(np.hypot(pose[0], pose[1])) or 1.0
        sign = 1.0 if phi[0] >= 0 else -1.0
        phi, (nx, ny, lever) = phi * norm * sign, pose / norm * sign
        slopes[probe.label] = phi
        angle = np.arctan2(ny, nx) - np.arctan2(probe.senses[1], probe.senses[0])
        p[f"theta_{probe.label}"] = float(np.arctan2(np.sin(angle), np.cos(angle)))
        p[f"eta_{probe.label}"] = float(phi[0])
        _set_lever(p, k, probe, nx, ny, lever)
    if "vertical_coupling" in model.effects:
        for label, phi in slopes.items():
            p |= {f"{q}_{label}": float(value) for q, value in zip("abc", phi[1:], strict=True)}
    if "tied_vertical_coupling" in model.effects:
        p |= _tied_start(model, slopes)
    return np.array([p[name] for name in model.names])


_TYPICAL = 3e-4
"""Typical vertical motion [m, rad] that weighs the rows of a probe's matrix."""


def _set_lever(p: dict[str, float], k: int, probe: Probe, nx: float, ny: float, lever: float) -> None:
    """Give the lever arm p_x n_y - p_y n_x to the coordinate that carries most of it."""
    sx, sy = _signs(probe)
    hx, hy = f"H{k + 1}x", f"H{k + 1}y"
    if abs(ny) >= abs(nx):
        p[hx] = sx * (lever + sy * p[hy] * nx) / ny
    else:
        p[hy] = sy * (sx * p[hx] * ny - lever) / nx


def _tied_start(model: Model, slopes: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Slopes and the point (x0, y0) from b / a = y - y0 and c / a = -(x - x0), weighted by slope."""
    phi = np.array([slopes[probe.label] for probe in model.layout])
    x, y = np.array([probe.position for probe in model.layout]).T
    a, weight = phi[:, 1], phi[:, 1] ** 2
    start = {f"a_{probe.label}": float(value) for probe, value in zip(model.layout, a, strict=True)}
    if weight.sum() > 0:
        start["x0"] = float((weight * x + a * phi[:, 3]).sum() / weight.sum())
        start["y0"] = float((weight * y - a * phi[:, 2]).sum() / weight.sum())
    return start


# -- the chain -------------------------------------------------------------------------------------------


FARTHEST = 5.0
"""Distance [m] of a probe from the middle of a stage: a machine of 10 m. The paper's are at 0.2 m."""


def _check(probes: tuple[Probe, ...]) -> None:
    if len(probes) < 3:
        raise InputError(
            f"The stage needs at least 3 probes to determine x, y and Rz; the layout has {len(probes)}."
        )
    labels = [p.label for p in probes]
    if len(set(labels)) < len(labels):
        raise InputError(f"Probe channels must have different letters; instead received {', '.join(labels)}.")
    for p in probes:
        if not np.all(np.abs([*p.position, *p.senses]) <= FARTHEST):
            raise InputError(f"Position, 'senses' of probe {p.channel} must be finite, up to {FARTHEST:g} m.")
        if not abs(p.senses[0] ** 2 + p.senses[1] ** 2 - 1) < 1e-6:
            raise InputError(
                f"'senses' of probe {p.channel} must be a unit vector; instead received {list(p.senses)}."
            )
    x, y, nx, ny = np.array([[*p.position, *p.senses] for p in probes]).T
    lever = x * ny - y * nx
    responses = np.column_stack([nx, ny, lever / max(np.abs(lever).max(), 1e-12)])
    if np.linalg.cond(responses) > 1e4:
        raise InputError(
            "The probes of a layout must determine x, y and Rz; these do not: all sense along one "
            "direction, or their lines of sight meet in one point."
        )


def _parameters(probes: tuple[Probe, ...], *, paper: bool) -> tuple[Parameter, ...]:
    """H (magnitudes; the signs belong to the layout), eta and theta of every probe."""
    bounds = published.bounds() if paper else {}
    parameters = []
    for k, probe in enumerate(probes, start=1):
        for axis, value in zip("xy", probe.position, strict=True):
            slack = max(0.25 * abs(value), 0.05)
            low, high = bounds.get(f"H{k}{axis}", (abs(value) - slack, abs(value) + slack))
            parameters.append(
                Parameter(f"H{k}{axis}", abs(value), low, high, "m", f"|{axis}| of probe {probe.label}")
            )
    for label in (probe.label for probe in probes):
        low, high = bounds.get(f"eta_{label}", (0.55, 1.05))
        parameters.append(Parameter(f"eta_{label}", 1.0, low, high, "1", f"gain of probe {label} at Z = 0"))
    limit = radians(8)
    for label in (probe.label for probe in probes):
        meaning = f"misalignment of probe {label}"
        parameters.append(Parameter(f"theta_{label}", 0.0, -limit, limit, "rad", meaning))
    return tuple(parameters)


def _signs(probe: Probe) -> tuple[int, int]:
    """Signs of the coordinates of a probe, which belong to the layout."""
    x, y = probe.position
    return (-1 if x < 0 else 1), (-1 if y < 0 else 1)


def position(k: int, probe: Probe, p: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the position of probe k [m] by its parameters, which are magnitudes."""
    sx, sy = _signs(probe)
    return sx * p[f"H{k + 1}x"], sy * p[f"H{k + 1}y"]


def direction(probe: Probe, p: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the sensing axis of a probe rotated counter-clockwise by theta, Eq. (10)."""
    (nx, ny), theta = probe.senses, p[f"theta_{probe.label}"]
    return nx * ca.cos(theta) - ny * ca.sin(theta), ny * ca.cos(theta) + nx * ca.sin(theta)


def along(probes: tuple[Probe, ...], p: Mapping[str, ca.SX], x: ca.SX, y: ca.SX, rz: ca.SX) -> list[ca.SX]:
    """Return the displacement that each probe senses of a small planar motion, Eq. (11)."""
    rows = []
    for k, probe in enumerate(probes):
        (px, py), (nx, ny) = position(k, probe, p), direction(probe, p)
        rows.append(nx * x + ny * y + (px * ny - py * nx) * rz)
    return rows


def _lever_arm(k: int, probe: Probe) -> Combination:
    """The factor of Rz in Eq. (11), the only way in which H enters a small-angle reading."""
    hx, hy, theta = f"H{k + 1}x", f"H{k + 1}y", f"theta_{probe.label}"
    sx, sy = _signs(probe)
    nx, ny = probe.senses
    terms = [(sx * ny, hx, "cos"), (sx * nx, hx, "sin"), (-sy * nx, hy, "cos"), (sy * ny, hy, "sin")]
    text = ""
    for factor, name, turn in terms:
        if factor:
            sign = ("-" if factor < 0 else "") if not text else (" - " if factor < 0 else " + ")
            scale = "" if abs(factor) == 1 else f"{abs(factor):.9g}*"
            text += f"{sign}{scale}{name}*{turn}({theta})"

    def value(p: Mapping[str, ca.SX]) -> ca.SX:
        (px, py), (dx, dy) = position(k, probe, p), direction(probe, p)
        return px * dy - py * dx

    return Combination(text, "m", (hx, hy, theta), value)


# -- machines described by a log folder ------------------------------------------------------------------


def from_meta(make: Callable[..., Model], meta: Meta) -> Model:
    """Return the model for the layout and nominal values in a log's `meta.json`; the paper's by default."""
    layout = None if meta.probes is None else tuple(_probe(entry) for entry in meta.probes)
    model, nominal = make(layout), dict(meta.nominal)
    labels = [probe.label for probe in model.layout]
    for key in {"eta", "theta_rad"} & nominal.keys():
        value = nominal.pop(key)
        good = isinstance(value, list) and len(value) == len(labels)
        require(good, f"Nominal '{key}'", f"a list of {len(labels)} numbers", value)
        nominal |= zip((f"{key.removesuffix('_rad')}_{k}" for k in labels), value, strict=True)
    return started(model, nominal, stage31(layout), stage31_tied(layout)) if nominal else model


def _probe(entry: Mapping[str, Any]) -> Probe:
    try:
        x, y = (number(v, "position_m", "a probe") for v in entry["position_m"])
        nx, ny = (number(v, "senses", "a probe") for v in entry["senses"])
        return Probe(str(entry["channel"]), (x, y), (nx, ny))
    except (KeyError, TypeError, ValueError):
        raise InputError(
            "A probe must have 'channel', 'position_m' = [x, y] and 'senses' = [nx, ny]; "
            f"instead received {entry!r}."
        ) from None
