"""Effects of Halbach arrays at the mechanics and the clock: where sensors are, and when they are read."""

import casadi as ca

from hallsym.families.halbach import links
from hallsym.families.mechanisms import P, free
from hallsym.model import Facts, Model, Signals, Way, effect
from hallsym.model.arguments import one_of
from hallsym.model.derived import rate

MOST_OFF_M, MOST_TILT_RAD, MOST_DELAY_S = 3e-3, 0.3, 0.05
FIFTH = Way("sweeps at a smaller gap", "the fifth harmonic sees a tilt and a place differently")


def _planes(model: Model) -> tuple[str, ...]:
    """Axes in the plane of the board along which the field changes."""
    return tuple(c[0] for c in model.pose if c in ("x_m", "y_m"))


@effect(link="mechanics", waves=(2,), separate=FIFTH)
def sensor_position_error(
    model: Model,
    along: str = one_of(
        {"plane": "on the board", "space": "on the board and in height"},
        "directions in which sensors are off",
    ),
) -> Model:
    """Sensors are off their nominal pitch (board-fixed)."""
    axes = (*_planes(model), *("z" if along == "space" else ""))
    meanings = {
        f"d{a}_{k}": f"{a} of sensor {k} beyond its nominal place" for k in links.labels(model) for a in axes
    }

    def step(s: Signals, p: P) -> None:
        for k, label in enumerate(links.labels(model)):
            for a in axes:
                place = s["placed"][k]
                place["xyz".index(a)] = place["xyz".index(a)] + p[f"d{a}_{label}"]

    new = free(meanings, MOST_OFF_M, "m")
    return model.with_step("mechanics", step, effect="sensor_position_error", parameters=new)


@effect(link="mechanics", waves=(2,), separate=FIFTH, label="each sensor")
def sensor_tilt(model: Model) -> Model:
    """Sensors are tilted against the board and read part of the field in its plane (board-fixed)."""
    axes = _planes(model)
    meanings = {
        f"tilt{a}_{k}": f"slope of the axis of sensor {k} towards {a}"
        for k in links.labels(model)
        for a in axes
    }

    def step(s: Signals, p: P) -> None:
        for k, label in enumerate(links.labels(model)):
            for a in axes:
                s["tilted"][k]["xy".index(a)] = s["tilted"][k]["xy".index(a)] + p[f"tilt{a}_{label}"]

    new = free(meanings, MOST_TILT_RAD, "rad")
    return model.with_step("mechanics", step, effect="sensor_tilt", parameters=new)


def multiplexed(per: str, model: Model, facts: Facts) -> bool:
    """Return whether a delay of each channel is tried: always one for the log."""
    return True


@effect(
    link="clock",
    needs=("t_s",),
    separate=Way("the same motion at several speeds", "a lag lowers the amplitude, a delay does not"),
)
def time_skew(
    model: Model,
    per: str = one_of(
        {"log": "one delay", "channel": "a delay per channel"}, "one delay for the log or for each channel"
    ),
) -> Model:
    """Constant delay between readings and reference; a multiplexed converter has one per channel."""
    names = [f"delay_{k}" for k in links.labels(model)] if per == "channel" else ["delay"]
    columns = [rate(c, n) for n in (1, 2) for c in model.references]

    def step(s: Signals, p: P) -> None:
        for coordinate, column in zip(model.pose, model.references, strict=True):
            by: list[ca.SX] = [-p[n] * s[f"d1_{column}"] + p[n] ** 2 * s[f"d2_{column}"] / 2 for n in names]
            links.move(s, coordinate, by if per == "channel" else by[0])

    new = free(dict.fromkeys(names, "delay of the readings"), MOST_DELAY_S, "s")
    return model.with_columns(*columns).with_step("clock", step, effect="time_skew", parameters=new)
