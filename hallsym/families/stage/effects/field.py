"""Effects of the stage in the field: non-linearity, cross-axis sensitivity, hysteresis."""

from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np

from hallsym.families.mechanisms import P, add_terms, bends, free, stop_state, travel
from hallsym.families.stage.effects.parts import AXES, SENSED, UNIT, across, labels
from hallsym.model import Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import one_of, searched
from hallsym.model.derived import Computed, Stretch

odd_nonlinearity, even_nonlinearity = bends(
    "the reading", "field", SENSED, 0.5, lambda model: UNIT,
    {"separate": "strokes of several lengths"},
    {"separate": "strokes of several lengths on both sides of zero"},
    by_channel=False,
)  # fmt: skip


CROSS = {"uv": (1, 1), "vv": (0, 2), "uuv": (2, 1), "uvv": (1, 2), "vvv": (0, 3)}
"""Powers of the motion along (u) and across (v) the sensing axis, second order first."""


@effect(link="field", separate="x and y moved together, and each alone")
def cross_axis_sensitivity(
    model: Model, order: int = one_of({2: "second order", 3: "up to third order"}, "highest order")
) -> Model:
    """Leakage of the motion across the sensing axis.

    Displacement u gains c u^i v^j / (0.5 mm)^(i + j - 1), v the motion across the sensing axis.
    """

    used = {name: (i, j) for name, (i, j) in CROSS.items() if i + j <= order}
    leaks = {
        f"cross_{name}_{{k}}": f"leakage of along^{i} across^{j} into probe {{k}}, relative at {UNIT:g} m"
        for name, (i, j) in used.items()
    }

    def terms(s: Signals, p: P) -> Callable[[ca.SX, int], list[ca.SX]]:
        def of(u: ca.SX, k: int) -> list[ca.SX]:
            v = across(model, s, p, k)
            return [u**i * v**j / UNIT ** (i + j - 1) for i, j in used.values()]

        return of

    return add_terms(
        model, "cross_axis_sensitivity", "field", SENSED, leaks, terms, 0.5, "1", by_channel=False
    )


WIDTH = "half_width"
"""Name of the parameter of a play."""


@effect(
    link="field",
    separate=Way("the same stroke at several speeds", "a loop keeps its width, a delay does not"),
)
def hysteresis(
    model: Model,
    half_width_m: float = searched(
        (2e-6, 6e-6, 1.5e-5, 4e-5, 1e-4, 2.5e-4),
        "half-width of the loop, in reading, where a fit begins",
        label=lambda width: f"half-width {1e6 * width:.3g} um",
        grid=True,
    ),
) -> Model:
    """Memory of the direction of motion.

    Displacement plus h z, z the elastic part of a play; h per probe, and one half-width [m of reading].

    A fit moves the half-width, by the slope of z with it. The state at the start of a run is unknown: see
    `stop_state`.
    """
    probes = labels(model)
    columns = [
        [_play(what, model, k, half_width_m) for what in ("state", "slope", "width")]
        for k in range(len(probes))
    ]

    def step(s: Signals, p: P) -> None:
        rows = []
        for k, row in zip(probes, columns, strict=True):
            state, slope, at = (s[c.name] for c in row)
            rows.append(p[f"loop_{k}"] * (state + slope * (p[WIDTH] / p[f"eta_{k}"] - at)))
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    loops = free({f"loop_{k}": f"half the height of the loop of probe {k}" for k in probes}, 1e-4, "m")
    width = Parameter(
        WIDTH, half_width_m, half_width_m / 4, half_width_m * 4, "m", "half-width of the loop, of reading"
    )
    wide = model.with_columns(*(c for row in columns for c in row))
    return wide.with_step("field", step, effect="hysteresis", parameters=(*loops, width))


def _play(what: str, model: Model, k: int, width: float) -> Computed:
    """Return `state`, `slope` or `width` of the play of probe k as a column; `width` in m of reading.

    The play is in what the probe senses: its half-width there is that of the reading over the gain at rest.
    `slope` is d state / d half-width [1/m], `width` the half-width [m] at which both are taken.
    """
    label = labels(model)[k]

    def taken(values: Mapping[str, float]) -> Computed:
        at = values.get(WIDTH, width) / values.get(f"eta_{label}", 1.0)

        def column(s: Stretch) -> np.ndarray:
            if what == "width":
                return np.full(len(s.data["t_s"]), at)
            motion = s.once(("travel", label), lambda: travel(_sensed(model, k, s), s.edges))
            both = s.once(("play", label, at), lambda: stop_state(motion, at))
            return both[("state", "slope").index(what)]

        return Computed(f"{what}_{label}_{width:.6g}", AXES, column, taken, f"{at:.17g}")

    return taken({})


def _sensed(model: Model, k: int, s: Stretch) -> np.ndarray:
    """Displacement of probe k by the nominal layout and the smoothed reference."""
    probe = model.layout[k]
    (px, py), (nx, ny) = probe.position, probe.senses
    x, y, rz = (s.rate(c, 0) for c in AXES)
    return nx * x + ny * y + (px * ny - py * nx) * rz
