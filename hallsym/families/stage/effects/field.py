"""Effects of the stage in the field: what a probe feels is bent, leaks across, remembers or jumps."""

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hallsym.families.parts import Make, P, add, column, free
from hallsym.families.play import stop_state
from hallsym.families.stage.effects.parts import AXES, UNIT, across, labels
from hallsym.model import Model, Parameter, Signals
from hallsym.model.derived import Computed, Stretch


def nonlinearity(effect: str, powers: Sequence[int]) -> Make:
    """Displacement u becomes u + sum of c u^n / UNIT^(n - 1), c per probe."""

    def make(model: Model) -> Model:
        names = {n: [f"{effect}{n}_{k}" for k in labels(model)] for n in powers}

        def step(s: Signals, p: P) -> None:
            u = s["displacement"]
            for n in powers:
                s["displacement"] = s["displacement"] + column(p, names[n]) * u**n / UNIT ** (n - 1)

        new = free([n for row in names.values() for n in row], 0.5, "1", "share of 0.5 mm at 0.5 mm")
        return add(model, "field", effect, new, step)

    return make


CROSS = {"uv": (1, 1), "vv": (0, 2), "uuv": (2, 1), "uvv": (1, 2), "vvv": (0, 3)}


def cross_axis_sensitivity(terms: Sequence[str]) -> Make:
    """Displacement u gains c u^i v^j / UNIT^(i + j - 1): leakage of the motion across the sensing axis."""

    def make(model: Model) -> Model:
        names = {t: [f"cross_{t}_{k}" for k in labels(model)] for t in terms}

        def step(s: Signals, p: P) -> None:
            u, v = s["displacement"], across(model, s, p)
            for t in terms:
                i, j = CROSS[t]
                s["displacement"] = s["displacement"] + column(p, names[t]) * u**i * v**j / UNIT ** (
                    i + j - 1
                )

        new = free([n for row in names.values() for n in row], 0.5, "1", "share of 0.5 mm at 0.5 mm")
        return add(model, "field", "cross_axis_sensitivity", new, step)

    return make


WIDTH = "half_width"
"""Name of the parameter of a play."""


def hysteresis(width_m: float) -> Make:
    """Displacement plus h z, z the elastic part of a play; h per probe, and one half-width [m of reading].

    `width_m`: about the half-width; a fit moves it, by the slope of z with it. Of the state in which a run
    starts nobody knows anything: see `stop_state`.
    """

    def make(model: Model) -> Model:
        probes = labels(model)
        names = [f"loop_{k}" for k in probes]
        columns = [
            [_play(what, model, k, width_m) for what in ("state", "slope", "width")]
            for k in range(len(probes))
        ]

        def step(s: Signals, p: P) -> None:
            rows = []
            for k, row in zip(probes, columns, strict=True):
                state, slope, at = (s[c.name] for c in row)
                rows.append(p[f"loop_{k}"] * (state + slope * (p[WIDTH] / p[f"eta_{k}"] - at)))
            s["displacement"] = s["displacement"] + ca.vertcat(*rows)

        new = (
            *free(names, 1e-4, "m", "half loop"),
            Parameter(WIDTH, width_m, width_m / 4, width_m * 4, "m", "half-width of the loop, of reading"),
        )
        return add(model, "field", "hysteresis", new, step, *(c for row in columns for c in row))

    return make


def _play(what: str, model: Model, k: int, width: float) -> Computed:
    """Return `state`, `slope` or `width` of the play of probe k as a column; `width` in m of reading.

    The play is in what the probe feels: its half-width there is that of the reading over the gain at rest.
    `slope` is d state / d half-width [1/m], `width` the half-width [m] at which both are taken.
    """
    label = labels(model)[k]

    def taken(values: Mapping[str, float]) -> Computed:
        at = values.get(WIDTH, width) / values.get(f"eta_{label}", 1.0)

        def column(s: Stretch) -> np.ndarray:
            if what == "width":
                return np.full(len(s.data["t_s"]), at)
            both = s.once(("play", label, at), lambda: stop_state(_felt(model, k, s), at))
            return both[("state", "slope").index(what)]

        return Computed(f"{what}_{label}_{width:.6g}", AXES, column, taken, f"{at:.17g}")

    return taken({})


def _felt(model: Model, k: int, s: Stretch) -> np.ndarray:
    """Displacement of probe k by the nominal layout and the smoothed reference."""
    probe = model.layout[k]
    (px, py), (nx, ny) = probe.position, probe.senses
    x, y, rz = (s.rate(c, 0) for c in AXES)
    return nx * x + ny * y + (px * ny - py * nx) * rz


def mount_slip(probe: int, instant_s: float) -> Make:
    """One probe moves at an instant: its gain, lever arm and offset step."""

    def make(model: Model) -> Model:
        label = labels(model)[probe]
        column = Computed(
            f"after_{instant_s:.9g}", (), lambda s: (s.data["t_s"] - s.origin_s >= instant_s) * 1.0
        )
        new = (
            Parameter(f"slip_gain_{label}", 0.0, -0.5, 0.5, "1", "step of the gain"),
            Parameter(f"slip_offset_{label}", 0.0, -1e-3, 1e-3, "m", "step of the offset"),
        )
        unit = ca.DM.zeros(len(model.layout))
        unit[probe] = 1

        def step(s: Signals, p: P) -> None:
            after = s[column.name]
            moved = s["displacement"] + p[new[1].name] * after * unit
            s["displacement"] = moved + p[new[0].name] * after * moved * unit

        return add(model, "field", "mount_slip", new, step, column)

    return make
