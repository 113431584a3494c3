"""Effects of the stage that the paper's models leave out: physics only, each a function `Model -> Model`.

New parameters are 0 where the effect is absent. Displacements in m, times in s; u is what a probe feels along
its sensing axis, v the motion across it.
"""

from collections.abc import Callable, Mapping, Sequence
from math import pi

import casadi as ca
import numpy as np

from hallsym.computed import Computed, Stretch, campaign_time, rate, run_time
from hallsym.families import stage
from hallsym.model import Model, Parameter, Signals, Step

UNIT = 0.5e-3
"""Displacement [m] at which relative non-linearities are stated."""
AXES = ("x_ref_m", "y_ref_m", "rz_ref_rad")

Make = Callable[[Model], Model]


def _labels(model: Model) -> list[str]:
    return [probe.label for probe in model.layout]


def _free(names: Sequence[str], limit: float, unit: str, meaning: str) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, 0.0, -limit, limit, unit, meaning) for name in names)


def _column(p: Mapping[str, ca.SX], names: Sequence[str]) -> ca.SX:
    return ca.vertcat(*(p[name] for name in names))


def _add(
    model: Model,
    link: str,
    effect: str,
    parameters: tuple[Parameter, ...],
    step: Step,
    *columns: str | Computed,
) -> Model:
    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=parameters)


def _along(model: Model, p: Mapping[str, ca.SX], x: ca.SX, y: ca.SX, rz: ca.SX) -> ca.SX:
    """What each probe feels of a small planar motion, Eq. (11)."""
    rows = []
    for k, probe in enumerate(model.layout):
        (px, py), (nx, ny) = stage._position(k, probe, p), stage._direction(probe, p)
        rows.append(nx * x + ny * y + (px * ny - py * nx) * rz)
    return ca.vertcat(*rows)


def _across(model: Model, s: Signals, p: Mapping[str, ca.SX]) -> ca.SX:
    """Motion of each probe across its sensing axis."""
    rows = []
    for k, probe in enumerate(model.layout):
        (px, py), (nx, ny) = stage._position(k, probe, p), stage._direction(probe, p)
        rows.append(-ny * (s["x_m"] - py * s["rz_rad"]) + nx * (s["y_m"] + px * s["rz_rad"]))
    return ca.vertcat(*rows)


# -- field -------------------------------------------------------------------------------------------------


def nonlinearity(effect: str, powers: Sequence[int]) -> Make:
    """Displacement u becomes u + sum of c u^n / UNIT^(n - 1), c per probe."""

    def make(model: Model) -> Model:
        names = {n: [f"{effect}{n}_{k}" for k in _labels(model)] for n in powers}

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            u = s["displacement"]
            for n in powers:
                s["displacement"] = s["displacement"] + _column(p, names[n]) * u**n / UNIT ** (n - 1)

        new = _free([n for row in names.values() for n in row], 0.5, "1", "share of 0.5 mm at 0.5 mm")
        return _add(model, "field", effect, new, step)

    return make


CROSS = {"uv": (1, 1), "vv": (0, 2), "uuv": (2, 1), "uvv": (1, 2), "vvv": (0, 3)}


def cross_axis_sensitivity(terms: Sequence[str]) -> Make:
    """Displacement u gains c u^i v^j / UNIT^(i + j - 1): leakage of the motion across the sensing axis."""

    def make(model: Model) -> Model:
        names = {t: [f"cross_{t}_{k}" for k in _labels(model)] for t in terms}

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            u, v = s["displacement"], _across(model, s, p)
            for t in terms:
                i, j = CROSS[t]
                s["displacement"] = s["displacement"] + _column(p, names[t]) * u**i * v**j / UNIT ** (
                    i + j - 1
                )

        new = _free([n for row in names.values() for n in row], 0.5, "1", "share of 0.5 mm at 0.5 mm")
        return _add(model, "field", "cross_axis_sensitivity", new, step)

    return make


# -- transducer --------------------------------------------------------------------------------------------


def vertical_gain_coupling(model: Model) -> Model:
    """The a, b, c terms of Model (31) under the field's name."""
    return stage.vertical_coupling(model)


def height_quadratic_tied(model: Model) -> Model:
    """Gain gains e h^2 per probe, h the height of the probe's place on a rigid stage."""
    names = [f"bend_{k}" for k in _labels(model)]
    coupled = "vertical_coupling" in model.effects

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        rows = []
        for k, probe in enumerate(model.layout):
            a, label = p.get(f"a_{probe.label}"), probe.label
            if coupled:
                h = s["z_m"] + (p[f"b_{label}"] * s["rx_rad"] + p[f"c_{label}"] * s["ry_rad"]) / a
            else:
                px, py = stage._position(k, probe, p)
                h = s["z_m"] + py * s["rx_rad"] - px * s["ry_rad"]
            rows.append(h**2)
        s["gain"] = s["gain"] + _column(p, names) * ca.vertcat(*rows)

    return _add(model, "transducer", "height_quadratic", _free(names, 1e6, "1/m2", "bend with height"), step)


PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))


def height_quadratic(model: Model) -> Model:
    """Gain gains all second-order terms of Z, Rx, Ry: six per probe."""
    names = [[f"bend_{k}_{i}{j}" for i, j in PAIRS] for k in _labels(model)]

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        state = [s[c] for c in stage.STATE]
        rows = [
            sum(p[n] * state[i] * state[j] for n, (i, j) in zip(row, PAIRS, strict=True)) for row in names
        ]
        s["gain"] = s["gain"] + ca.vertcat(*rows)

    new = _free([n for row in names for n in row], 1e6, "1/m2", "bend of the gain")
    return _add(model, "transducer", "height_quadratic", new, step)


def gain_drift(
    effect: str, columns: Sequence[Computed | str], read: Callable[[Signals], list[ca.SX]]
) -> Make:
    """Gain times 1 + sum of g f(t), g per probe; f are data-only functions of the columns."""

    def make(model: Model) -> Model:
        wide = model.with_columns(*columns)
        n = len(read(Signals((*wide.pose, *wide.state))))
        names = [[f"{effect}{j}_{k}" for k in _labels(model)] for j in range(n)]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            rows = sum(_column(p, row) * f for row, f in zip(names, read(s), strict=True))
            s["gain"] = s["gain"] * (1 + rows)

        new = _free([m for row in names for m in row], 1.0, "1", "relative drift of the gain")
        return _add(wide, "transducer", effect, new, step)

    return make


def offset_drift(
    effect: str, columns: Sequence[Computed | str], read: Callable[[Signals], list[ca.SX]]
) -> Make:
    """Reading plus sum of o f(t), o per probe."""

    def make(model: Model) -> Model:
        wide = model.with_columns(*columns)
        n = len(read(Signals((*wide.pose, *wide.state))))
        names = [[f"{effect}{j}_{k}" for k in _labels(model)] for j in range(n)]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            rows = sum(_column(p, row) * f for row, f in zip(names, read(s), strict=True))
            s["reading"] = s["reading"] + rows

        new = _free([m for row in names for m in row], 1e-3, "m", "drift of the offset")
        return _add(wide, "electronics", effect, new, step)

    return make


def powers_of_time(duration_s: float, degree: int) -> tuple[list[Computed], Callable[[Signals], list[ca.SX]]]:
    """Return shifted Legendre polynomials of campaign time, degrees 1 to `degree`."""

    def read(s: Signals) -> list[ca.SX]:
        x = 2 * s["campaign_s"] / duration_s - 1
        return [x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2][:degree]

    return [campaign_time()], read


def settling(tau_s: float) -> tuple[list[Computed], Callable[[Signals], list[ca.SX]]]:
    """Return exp(-t / tau): the shape of a warm-up."""

    def read(s: Signals) -> list[ca.SX]:
        return [ca.exp(-s["campaign_s"] / tau_s)]

    return [campaign_time()], read


def temperature(mean: float) -> tuple[list[str], Callable[[Signals], list[ca.SX]]]:
    """Return the logged temperature above its mean."""
    return ["temperature_degc"], lambda s: [s["temperature_degc"] - mean]


# -- mechanics and reference -------------------------------------------------------------------------------


def vertical_offset_coupling(model: Model) -> Model:
    """Displacement plus c . (Z, Rx, Ry), c per probe: probe lever arm, tilt of probe or magnet."""
    names = [[f"tilt_{k}_{c}" for c in stage.STATE] for k in _labels(model)]

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        rows = [sum(p[n] * s[c] for n, c in zip(row, stage.STATE, strict=True)) for row in names]
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    new = _free([n for row in names for n in row], 1.0, "1", "displacement per vertical motion")
    return _add(model, "mechanics", "vertical_offset_coupling", new, step)


def second_order_rotation(model: Model) -> Model:
    """Share of the finite-rotation terms x Rz, y Rz, Rz^2 that Eq. (8) drops: 1 for a rigid stage."""
    new = _free(["finite_rotation"], 3.0, "1", "share of the finite rotation")

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        x, y, rz = s["x_m"], s["y_m"], s["rz_rad"]
        rows = []
        for k, probe in enumerate(model.layout):
            (px, py), (nx, ny) = stage._position(k, probe, p), stage._direction(probe, p)
            rows.append(nx * (-y * rz - px * rz**2 / 2) + ny * (x * rz - py * rz**2 / 2))
        s["displacement"] = s["displacement"] + p["finite_rotation"] * ca.vertcat(*rows)

    return _add(model, "mechanics", "second_order_rotation", new, step)


def second_order_rotation_body(model: Model) -> Model:
    """The same with the translation stated in the turned frame: only the terms with Rz^2 remain free."""
    names = ["rotation_x", "rotation_y", "rotation_rz"]

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        x, y, rz = s["x_m"], s["y_m"], s["rz_rad"]
        rows = []
        for k, probe in enumerate(model.layout):
            (px, py), (nx, ny) = stage._position(k, probe, p), stage._direction(probe, p)
            rows.append(
                -p[names[0]] * nx * y * rz
                + p[names[1]] * ny * x * rz
                - p[names[2]] * (nx * px + ny * py) * rz**2 / 2
            )
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    return _add(model, "mechanics", "second_order_rotation", _free(names, 3.0, "1", "share"), step)


def _reference(
    effect: str, terms: Sequence[tuple[int, str]], limit: float, unit: str, *columns: Computed
) -> Make:
    """Logged pose coordinate i = true + e column: each probe is expected to feel less by that much."""

    def make(model: Model) -> Model:
        names = [f"{effect}_{model.pose[i]}_{c}" for i, c in terms]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            error = [ca.SX(0)] * 3
            for name, (i, c) in zip(names, terms, strict=True):
                error[i] = error[i] + p[name] * s[c]
            s["displacement"] = s["displacement"] - _along(model, p, *error)

        return _add(
            model, "reference", effect, _free(names, limit, unit, "error of the reference"), step, *columns
        )

    return make


def reference_abbe_error(terms: Sequence[tuple[int, str]]) -> Make:
    """The reference reads tilt (or lift) times an Abbe arm: pairs of pose index and vertical column."""
    return _reference("reference_abbe_error", terms, 1.0, "m/rad")


def reference_scale_error() -> Make:
    """Each axis of the reference is off by a factor; eta, H and theta absorb it."""
    terms = [(0, "x_m"), (1, "y_m"), (2, "rz_rad")]
    return _reference("reference_scale_error", terms, 0.1, "1")


def reference_drift(degree: int = 1) -> Make:
    """The reference creeps within every run along a polynomial of its time, one per axis."""
    columns = [run_time(n) for n in range(1, degree + 1)]
    terms = [(k, c.name) for c in columns for k in range(3)]
    return _reference("reference_drift", terms, 1e-3, "m/s", *columns)


# -- clock and electronics ---------------------------------------------------------------------------------


SERIES = {"time_skew": (-1.0, 1 / 2, -1 / 6, 1 / 24), "first_order_lag": (-1.0, 1.0, -1.0, 1.0)}
"""Factors of tau^n d^n/dt^n: a delay, and 1 / (1 + tau d/dt), to fourth order in tau times frequency."""


def delayed(effect: str, shared: bool) -> Make:
    """Probes feel the past: `time_skew` delays, `first_order_lag` low-passes; one tau or one per probe."""
    factors = SERIES[effect]

    def make(model: Model) -> Model:
        columns = [rate(c, n) for n in range(1, len(factors) + 1) for c in AXES]
        names = [f"tau_{effect}"] * 3 if shared else [f"tau_{effect}_{k}" for k in _labels(model)]
        names = names[:1] * len(model.layout) if shared else names
        least = 0.0 if effect == "first_order_lag" else -0.05
        new = tuple(Parameter(n, 0.0, least, 0.05, "s", "delay") for n in dict.fromkeys(names))

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            tau = _column(p, names)
            for n, factor in enumerate(factors, start=1):
                moved = _along(model, p, *(s[f"d{n}_{c}"] for c in AXES))
                s["displacement"] = s["displacement"] + factor * tau**n * moved

        return _add(
            model, "reference" if effect == "time_skew" else "transducer", effect, new, step, *columns
        )

    return make


def _felt(model: Model, k: int, s: Stretch) -> np.ndarray:
    """Displacement of probe k by the nominal layout and the smoothed reference."""
    probe = model.layout[k]
    (px, py), (nx, ny) = probe.position, probe.senses
    x, y, rz = (s.rate(c, 0) for c in AXES)
    return nx * x + ny * y + (px * ny - py * nx) * rz


def stop_operator(u: np.ndarray, width: float) -> np.ndarray:
    """Return the elastic part of a play of half-width `width`, -1 to 1, starting from 0.

    z follows du / width and stops at +-1: between turning points it has a closed form.
    """
    return _stops_from(u, width, (0.0,))[0][0] if len(u) else np.empty(0)


def stop_state(u: np.ndarray, width: float) -> np.ndarray:
    """Return state and d state / d width of a play whose state at the first sample nobody knows, (2, n).

    From every start s in [-1, 1] the state is clip(s + U, low, high): U the travel over the width, low and
    high the states from -1 and 1. Returned is the mean over all starts; once the motion has covered 2 width,
    low and high are one and the state is known.
    """
    if len(u) == 0:
        return np.zeros((2, 0))
    (low, by_low), (high, by_high) = _stops_from(u, width, (-1.0, 1.0))
    U = (u - u[0]) / width
    a, b = np.clip(low - U, -1.0, 1.0), np.clip(high - U, -1.0, 1.0)
    inside = ((b + U) ** 2 - (a + U) ** 2) / 2
    mean = 0.5 * (low * (a + 1) + inside + high * (1 - b))
    slope = 0.5 * (by_low * (a + 1) - U / width * (b - a) + by_high * (1 - b))
    return np.array([mean, slope])


def _stops_from(u: np.ndarray, width: float, starts: Sequence[float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """State from each start, and its slope with the width: both in closed form between turning points."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(np.sign(np.diff(u))) != 0) + 1, [len(u) - 1]])
    strokes = (np.diff(u[edges]) / width).tolist()
    stroke = np.repeat(np.arange(len(strokes)), np.diff(edges))
    along = (u[1:] - u[edges[stroke]]) / width
    out = []
    for start in starts:
        states, slopes = [start], [0.0]
        for moved in strokes:
            state = states[-1] + moved
            slopes.append(slopes[-1] - moved / width if abs(state) < 1.0 else 0.0)
            states.append(1.0 if state > 1.0 else -1.0 if state < -1.0 else state)
        z, slope = np.full(len(u), start), np.zeros(len(u))
        z[1:] = np.clip(np.array(states)[stroke] + along, -1.0, 1.0)
        slope[1:] = np.where(np.abs(z[1:]) < 1.0, np.array(slopes)[stroke] - along / width, 0.0)
        out.append((z, slope))
    return out


def _play(what: str, model: Model, k: int, width: float) -> Computed:
    """Return `state`, `slope` or `width` of the play of probe k as a column; `width` in m of reading.

    The play is in what the probe feels: its half-width there is that of the reading over the gain at rest.
    `slope` is d state / d half-width [1/m], `width` the half-width [m] at which both are taken.
    """
    label = _labels(model)[k]

    def taken(values: Mapping[str, float]) -> Computed:
        at = values.get(WIDTH, width) / values.get(f"eta_{label}", 1.0)

        def column(s: Stretch) -> np.ndarray:
            if what == "width":
                return np.full(len(s.data["t_s"]), at)
            both = s.once(("play", label, at), lambda: stop_state(_felt(model, k, s), at))
            return both[("state", "slope").index(what)]

        return Computed(f"{what}_{label}_{width:.6g}", AXES, column, taken, f"{at:.17g}")

    return taken({})


WIDTH = "half_width"
"""Name of the parameter of a play."""


def _wave(kind: str, frequency_hz: float) -> Computed:
    """Return a sine or cosine of campaign time, as a column."""
    wave = np.sin if kind == "sin" else np.cos

    def column(s: Stretch) -> np.ndarray:
        return np.asarray(wave(2 * pi * frequency_hz * (s.data["t_s"] - s.origin_s)))

    return Computed(f"{kind}_{frequency_hz:.9g}", (), column)


def hysteresis(width_m: float) -> Make:
    """Displacement plus h z, z the elastic part of a play; h per probe, and one half-width [m of reading].

    `width_m`: about the half-width; a fit moves it, by the slope of z with it. Of the state in which a run
    starts nobody knows anything: see `stop_state`.
    """

    def make(model: Model) -> Model:
        labels = _labels(model)
        names = [f"loop_{k}" for k in labels]
        columns = [
            [_play(what, model, k, width_m) for what in ("state", "slope", "width")]
            for k in range(len(labels))
        ]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            rows = []
            for k, row in zip(labels, columns, strict=True):
                state, slope, at = (s[c.name] for c in row)
                rows.append(p[f"loop_{k}"] * (state + slope * (p[WIDTH] / p[f"eta_{k}"] - at)))
            s["displacement"] = s["displacement"] + ca.vertcat(*rows)

        new = (
            *_free(names, 1e-4, "m", "half loop"),
            Parameter(WIDTH, width_m, width_m / 4, width_m * 4, "m", "half-width of the loop, of reading"),
        )
        return _add(model, "field", "hysteresis", new, step, *(c for row in columns for c in row))

    return make


def mount_slip(probe: int, instant_s: float) -> Make:
    """One probe moves at an instant: its gain, lever arm and offset step."""

    def make(model: Model) -> Model:
        label = _labels(model)[probe]
        column = Computed(
            f"after_{instant_s:.9g}", (), lambda s: (s.data["t_s"] - s.origin_s >= instant_s) * 1.0
        )
        new = (
            Parameter(f"slip_gain_{label}", 0.0, -0.5, 0.5, "1", "step of the gain"),
            Parameter(f"slip_offset_{label}", 0.0, -1e-3, 1e-3, "m", "step of the offset"),
        )
        unit = ca.DM.zeros(len(model.layout))
        unit[probe] = 1

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            after = s[column.name]
            moved = s["displacement"] + p[new[1].name] * after * unit
            s["displacement"] = moved + p[new[0].name] * after * moved * unit

        return _add(model, "field", "mount_slip", new, step, column)

    return make


def motor_stray_field(positions: Sequence[str] = ()) -> Make:
    """Reading plus C times acceleration, C per probe and axis; also times position where named."""

    def make(model: Model) -> Model:
        terms = ["", *positions]
        names = [
            [f"stray_{k}_{a}{'_' + q if q else ''}" for q in terms for a in model.pose]
            for k in _labels(model)
        ]
        columns = [rate(c, 2) for c in AXES]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            pushes = [s[c.name] * (s[q] / UNIT if q else 1) for q in terms for c in columns]
            rows = [sum(p[n] * f for n, f in zip(row, pushes, strict=True)) for row in names]
            s["reading"] = s["reading"] + ca.vertcat(*rows)

        new = _free([n for row in names for n in row], 1e-2, "m s2/m", "reading per acceleration")
        return _add(model, "electronics", "motor_stray_field", new, step, *columns)

    return make


def mains_hum(frequency_hz: float, harmonics: Sequence[int] = (1,)) -> Make:
    """Reading plus a sine at the mains frequency (and harmonics), amplitude and phase per probe."""

    def make(model: Model) -> Model:
        waves = [_wave(kind, n * frequency_hz) for n in harmonics for kind in ("sin", "cos")]
        names = [[f"hum_{w.name}_{k}" for w in waves] for k in _labels(model)]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            rows = [sum(p[n] * s[w.name] for n, w in zip(row, waves, strict=True)) for row in names]
            s["reading"] = s["reading"] + ca.vertcat(*rows)

        new = _free([n for row in names for n in row], 1e-4, "m", "amplitude of the hum")
        return _add(model, "electronics", "mains_hum", new, step, *waves)

    return make


def clipping(low: Sequence[float], high: Sequence[float]) -> Make:
    """Readings beyond `low` and `high` [m, one per probe] lose the share that is the parameter (1: hard)."""

    def make(model: Model) -> Model:
        names = [f"clipped_{k}" for k in _labels(model)]

        def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
            rows = []
            for k, name in enumerate(names):
                m = s["reading"][k]
                over = ca.fmax(m - high[k], 0) if np.isfinite(high[k]) else 0
                under = ca.fmax(low[k] - m, 0) if np.isfinite(low[k]) else 0
                rows.append(m - p[name] * (over - under))
            s["reading"] = ca.vertcat(*rows)

        return _add(model, "electronics", "saturation", _free(names, 1.5, "1", "share clipped"), step)

    return make
