"""Effects of the stage at the electronics: what is added to a reading, and where it stops."""

from collections.abc import Sequence
from math import pi

import casadi as ca
import numpy as np

from hallsym.families.parts import Make, P, add, free
from hallsym.families.stage.effects.parts import AXES, UNIT, labels
from hallsym.model import Model, Signals
from hallsym.model.derived import Computed, Stretch, rate


def motor_stray_field(positions: Sequence[str] = ()) -> Make:
    """Reading plus C times acceleration, C per probe and axis; also times position where named."""

    def make(model: Model) -> Model:
        terms = ["", *positions]
        names = [
            [f"stray_{k}_{a}{'_' + q if q else ''}" for q in terms for a in model.pose] for k in labels(model)
        ]
        columns = [rate(c, 2) for c in AXES]

        def step(s: Signals, p: P) -> None:
            pushes = [s[c.name] * (s[q] / UNIT if q else 1) for q in terms for c in columns]
            rows = [sum(p[n] * f for n, f in zip(row, pushes, strict=True)) for row in names]
            s["reading"] = s["reading"] + ca.vertcat(*rows)

        new = free([n for row in names for n in row], 1e-2, "m s2/m", "reading per acceleration")
        return add(model, "electronics", "motor_stray_field", new, step, *columns)

    return make


def mains_hum(frequency_hz: float, harmonics: Sequence[int] = (1,)) -> Make:
    """Reading plus a sine at the mains frequency (and harmonics), amplitude and phase per probe."""

    def make(model: Model) -> Model:
        waves = [_wave(kind, n * frequency_hz) for n in harmonics for kind in ("sin", "cos")]
        names = [[f"hum_{w.name}_{k}" for w in waves] for k in labels(model)]

        def step(s: Signals, p: P) -> None:
            rows = [sum(p[n] * s[w.name] for n, w in zip(row, waves, strict=True)) for row in names]
            s["reading"] = s["reading"] + ca.vertcat(*rows)

        new = free([n for row in names for n in row], 1e-4, "m", "amplitude of the hum")
        return add(model, "electronics", "mains_hum", new, step, *waves)

    return make


def _wave(kind: str, frequency_hz: float) -> Computed:
    """Return a sine or cosine of campaign time, as a column."""
    wave = np.sin if kind == "sin" else np.cos

    def column(s: Stretch) -> np.ndarray:
        return np.asarray(wave(2 * pi * frequency_hz * (s.data["t_s"] - s.origin_s)))

    return Computed(f"{kind}_{frequency_hz:.9g}", (), column)


def clipping(low: Sequence[float], high: Sequence[float]) -> Make:
    """Readings beyond `low` and `high` [m, one per probe] lose the share that is the parameter (1: hard)."""

    def make(model: Model) -> Model:
        names = [f"clipped_{k}" for k in labels(model)]

        def step(s: Signals, p: P) -> None:
            rows = []
            for k, name in enumerate(names):
                m = s["reading"][k]
                over = ca.fmax(m - high[k], 0) if np.isfinite(high[k]) else 0
                under = ca.fmax(low[k] - m, 0) if np.isfinite(low[k]) else 0
                rows.append(m - p[name] * (over - under))
            s["reading"] = ca.vertcat(*rows)

        return add(model, "electronics", "saturation", free(names, 1.5, "1", "share clipped"), step)

    return make
