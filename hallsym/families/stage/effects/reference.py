"""Effects of the stage at the reference: every probe seems to sense what the logged pose is off by."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.mechanisms import P, free
from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.parts import along
from hallsym.model import Model, Signals, effect
from hallsym.model.arguments import one_of
from hallsym.model.derived import Computed, run_time


def _off(
    model: Model, effect: str, terms: Sequence[tuple[int, str]], limit: float, unit: str, *columns: Computed
) -> Model:
    """Logged pose coordinate i = true + e column: each probe is expected to sense less by that much."""
    names = [f"{effect}_{model.pose[i]}_{c}" for i, c in terms]

    def step(s: Signals, p: P) -> None:
        error = [ca.SX(0)] * 3
        for name, (i, c) in zip(names, terms, strict=True):
            error[i] = error[i] + p[name] * s[c]
        s["displacement"] = s["displacement"] - ca.vertcat(*along(model, p, *error))

    what = [f"error of the reference of {model.pose[i]} per {c}" for i, c in terms]
    new = free(dict(zip(names, what, strict=True)), limit, unit)
    return model.with_columns(*columns).with_step("reference", step, effect=effect, parameters=new)


@effect(link="reference", label="three factors", separate="a known length beside the reference")
def reference_scale_error(model: Model) -> Model:
    """Scale factor of a reference axis.

    Each axis of the reference is off by a factor; eta, H and theta absorb it.
    """
    return _off(model, "reference_scale_error", list(enumerate(model.pose)), 0.1, "1")


@effect(
    link="reference",
    separate="Rx and Ry moved within a run while the rest stands still, beside a second reference",
)
def reference_abbe_error(
    model: Model,
    arms: str = one_of(
        {"tilt": "x with Ry, y with Rx", "all": "x and y with Z, Rx, Ry"},
        "vertical motions that the reference of x and y reads",
    ),
) -> Model:
    """The reference reads tilt times an Abbe arm."""
    tilt, everything = ((0, "ry_rad"), (1, "rx_rad")), [(i, c) for i in (0, 1) for c in stage.STATE]
    return _off(model, "reference_abbe_error", tilt if arms == "tilt" else everything, 1.0, "m/rad")


@effect(link="reference", separate="a long run at rest")
def reference_drift(
    model: Model,
    degree: int = one_of(
        {1: "one rate per axis", 3: "a cubic of each run's time per axis"},
        "degree of the polynomial of each run's time",
    ),
) -> Model:
    """The reference creeps within a run."""
    columns = [run_time(n) for n in range(1, degree + 1)]
    terms = [(k, c.name) for c in columns for k in range(3)]
    return _off(model, "reference_drift", terms, 1e-3, "m/s", *columns)
