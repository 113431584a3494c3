"""Effects of the stage at the transducer: the gain of a probe with height and tilts."""

import casadi as ca

from hallsym.families.parts import P, add, column, free
from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.parts import labels
from hallsym.model import Model, Signals


def vertical_gain_coupling(model: Model) -> Model:
    """The a, b, c terms of Model (31) under the field's name."""
    return stage.vertical_coupling(model)


def height_quadratic_tied(model: Model) -> Model:
    """Gain gains e h^2 per probe, h the height of the probe's place on a rigid stage."""
    names = [f"bend_{k}" for k in labels(model)]
    coupled = "vertical_coupling" in model.effects

    def step(s: Signals, p: P) -> None:
        rows = []
        for k, probe in enumerate(model.layout):
            a, label = p.get(f"a_{probe.label}"), probe.label
            if coupled:
                h = s["z_m"] + (p[f"b_{label}"] * s["rx_rad"] + p[f"c_{label}"] * s["ry_rad"]) / a
            else:
                px, py = stage.position(k, probe, p)
                h = s["z_m"] + py * s["rx_rad"] - px * s["ry_rad"]
            rows.append(h**2)
        s["gain"] = s["gain"] + column(p, names) * ca.vertcat(*rows)

    return add(model, "transducer", "height_quadratic", free(names, 1e6, "1/m2", "bend with height"), step)


PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))


def height_quadratic(model: Model) -> Model:
    """Gain gains all second-order terms of Z, Rx, Ry: six per probe."""
    names = [[f"bend_{k}_{i}{j}" for i, j in PAIRS] for k in labels(model)]

    def step(s: Signals, p: P) -> None:
        state = [s[c] for c in stage.STATE]
        rows = [
            sum(p[n] * state[i] * state[j] for n, (i, j) in zip(row, PAIRS, strict=True)) for row in names
        ]
        s["gain"] = s["gain"] + ca.vertcat(*rows)

    new = free([n for row in names for n in row], 1e6, "1/m2", "bend of the gain")
    return add(model, "transducer", "height_quadratic", new, step)
