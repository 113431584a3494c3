"""Effects of the stage at the mechanics, the clock and the reference: real and apparent displacements."""

from collections.abc import Callable, Sequence

import casadi as ca

from hallsym.errors import require
from hallsym.families.mechanisms import DELAY, P, add_terms, free, late
from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.parts import AXES, SENSED, labels
from hallsym.model import Facts, Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import Try, beside, found, one_of
from hallsym.model.derived import Computed, run_time

PER = one_of({"log": "one delay", "probe": "a delay per probe"}, "one value for the log or for each probe")


@effect(
    link="clock",
    separate=Way(
        "the same motion at several frequencies", "a lag turns into phase that bends, a delay does not"
    ),
)
def time_skew(model: Model, per: str = PER) -> Model:
    """Constant delay between readings and reference."""
    shared = per == "log"
    return late(model, "time_skew", "reference", SENSED, DELAY, rates_along(model), shared=shared)


def rates_along(model: Model) -> Callable[[Signals, P, int], list[ca.SX]]:
    """Return the time derivatives of what each probe senses, from the rates of the reference."""
    return lambda s, p, n: stage.along(model.layout, p, *(s[f"d{n}_{c}"] for c in AXES))


@effect(
    link="mechanics",
    label="nine lever arms",
    separate="Z, Rx, Ry moved within a run while x, y, Rz stand still",
)
def vertical_offset_coupling(model: Model) -> Model:
    """Reading follows Z, Rx, Ry whatever the stroke.

    Displacement plus c . (Z, Rx, Ry), c per probe: probe lever arm, tilt of probe or magnet.
    """
    arms = {f"tilt_{{k}}_{c}": f"displacement of probe {{k}} per {c}" for c in stage.STATE}
    return add_terms(
        model, "vertical_offset_coupling", "mechanics", SENSED, arms,
        lambda s, p: lambda u, k: [s[c] for c in stage.STATE], 1.0, "1",
    )  # fmt: skip


@effect(link="mechanics", unless=("exact_rotation",), separate="large Rz while x and y are off centre")
def second_order_rotation(
    model: Model,
    form: str = one_of(
        {"rigid": "rigid stage", "terms": "term by term"}, "terms of one stage, or each by itself"
    ),
) -> Model:
    """Finite rotation that the small-angle model drops.

    Share of the finite-rotation terms x Rz, y Rz, Rz^2 that Eq. (8) drops: 1 for a rigid stage.

    Term by term, with the translation stated in the rotated frame: only the terms with Rz^2 remain free.
    """
    rigid = form == "rigid"
    names = ["finite_rotation"] if rigid else ["rotation_x", "rotation_y", "rotation_rz"]

    def step(s: Signals, p: P) -> None:
        x, y, rz = s["x_m"], s["y_m"], s["rz_rad"]
        of_x, of_y, of_rz = (p[n] for n in (names * 3 if rigid else names))
        rows = []
        for k, probe in enumerate(model.layout):
            (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
            rotation = of_rz * (nx * px + ny * py) * rz**2 / 2
            rows.append(-of_x * nx * y * rz + of_y * ny * x * rz - rotation)
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    new = free(dict.fromkeys(names, "share of the finite rotation: 1 for a rigid stage"), 3.0, "1")
    return model.with_step("mechanics", step, effect="second_order_rotation", parameters=new)


def slips(model: Model, facts: Facts) -> list[Try]:
    """Return the probes and instants of the slips that a log may show."""
    names = labels(model)
    return [
        Try(
            {"probe": names[k], "instant_s": t},
            f"probe {names[k]} between {low:.6g} and {high:.6g} s",
            shapes=1,
            tried=facts.instants_tried,
        )
        for k, t, low, high in facts.instants
    ]


@effect(link="mechanics", separate="the first setting again at the end and in between")
def mount_slip(
    model: Model,
    probe: str = beside("letter of the probe that moved"),
    instant_s: float = found(slips, "time since the first sample of the log"),
) -> Model:
    """One probe or magnet moved at an instant.

    Its gain, lever arm and offset step.
    """
    known = labels(model)
    require(probe in known, "Probe of mount_slip", f"one of {', '.join(known)}", probe, known)
    column = Computed(f"after_{instant_s:.9g}", (), lambda s: (s.data["t_s"] - s.origin_s >= instant_s) * 1.0)
    kinds = (("gain", 0.5, "1"), ("offset", 1e-3, "m"), ("lever", 0.05, "m"))
    gain, offset, lever = (
        Parameter(f"slip_{what}_{probe}", 0.0, -most, most, unit, f"step of the {what} of probe {probe}")
        for what, most, unit in kinds
    )
    unit = ca.DM([float(k == probe) for k in known])

    def step(s: Signals, p: P) -> None:
        after = s[column.name]
        moved = s["displacement"] + (p[offset.name] + p[lever.name] * s["rz_rad"]) * after * unit
        s["displacement"] = moved + p[gain.name] * after * moved * unit

    wide = model.with_columns(column)
    return wide.with_step("field", step, effect="mount_slip", parameters=(gain, offset, lever))


# -- at the reference --------------------------------------------------------------------------------------


def _off(
    model: Model, effect: str, terms: Sequence[tuple[int, str]], limit: float, unit: str, *columns: Computed
) -> Model:
    """Logged pose coordinate i = true + e column: each probe is expected to sense less by that much."""
    names = [f"{effect}_{model.pose[i]}_{c}" for i, c in terms]

    def step(s: Signals, p: P) -> None:
        error = [ca.SX(0)] * 3
        for name, (i, c) in zip(names, terms, strict=True):
            error[i] = error[i] + p[name] * s[c]
        s["displacement"] = s["displacement"] - ca.vertcat(*stage.along(model.layout, p, *error))

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
