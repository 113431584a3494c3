"""A wave over any periodic coordinate is localised there: a trial array with one or two of them."""

import casadi as ca
import numpy as np
import pytest

from hallsym.diagnosis import Base
from hallsym.diagnosis.curves import lack_of_fit
from hallsym.diagnosis.localisation import located
from hallsym.log import Log
from hallsym.model import Family, Model, Parameter

PERIODS = {"x": 24e-3, "y": 36e-3}
DECAY = 12e-3
NOISE = 1e-3
"""Of each reading; its amplitude is 1."""
RUNS, SAMPLES = 30, 200


def array(other: str) -> Model:
    """Two sensors for each direction, a quarter of a period apart: periodic along x, and y or height z."""

    def field(s, p):
        waves = {c: 2 * np.pi * s[f"{c}_m"] / PERIODS[c] for c in PERIODS if f"{c}_m" in s}
        size = p["size"] * (ca.exp(-s["z_m"] / DECAY) if "z_m" in s else 1)
        s["reading"] = ca.vertcat(*(size * f(u) for u in waves.values() for f in (ca.sin, ca.cos)))
        s["gain"] = ca.SX.ones(2 * len(waves))

    coordinates = ("x", other)
    named = {f"{c}{end}": PERIODS[c] for c in coordinates if c in PERIODS for end in ("_m", "_ref_m")}
    return Model(
        name="trial", family=Family("trial"), pose=tuple(f"{c}_m" for c in coordinates),
        references=tuple(f"{c}_ref_m" for c in coordinates), state=(),
        channels=tuple(f"{kind}_{c}_v" for c in coordinates if c in PERIODS for kind in ("sin", "cos")),
        parameters=(Parameter("size", 1.0, 0.5, 2.0, "V", "amplitude of the field"),),
        steps=(("field", field),), period=named, typical=((0.0, 0.0), (5e-3, 5e-3)),
    )  # fmt: skip


def base_with(other: str, over: str, orders: tuple[int, ...], size: float = 2e-2) -> Base:
    """A log whose position error along `over` has `size` periods of waves of the given orders."""
    model, rng = array(other), np.random.default_rng(3)
    n = RUNS * SAMPLES
    t = np.arange(n) * 1e-2
    far = 30e-3 if other == "y" else 3e-3
    pose = {"x": 40e-3 * np.sin(2.3 * t), other: far * (1 + np.sin(1.7 * t + 1))}
    angle = 2 * np.pi * pose[over] / PERIODS[over]
    apparent = pose | {over: pose[over] + size * PERIODS[over] / 6 * sum(np.sin(k * angle) for k in orders)}
    data = {"run": np.arange(n) // SAMPLES, "t_s": t}
    data |= {f"{c}_ref_m": x for c, x in pose.items()}
    shrunk = np.exp(-pose["z"] / DECAY) if "z" in pose else 1.0
    for c in (c for c in pose if c in PERIODS):
        u = 2 * np.pi * apparent[c] / PERIODS[c]
        data |= {f"{kind}_{c}_v": shrunk * f(u) + NOISE * rng.standard_normal(n)
                 for kind, f in (("sin", np.sin), ("cos", np.cos))}  # fmt: skip
    sigma = dict.fromkeys(model.channels, NOISE) | {"x_ref_m": 1e-7, f"{other}_ref_m": 1e-7}
    return Base(
        Log.from_arrays(data), model, np.ones(1), {}, NOISE**2 * np.eye(len(model.channels)), (0,),
        np.ones(2), frozenset(), sigma,
    )  # fmt: skip


@pytest.mark.parametrize(("other", "over"), [("y", "x"), ("y", "y"), ("z", "x")])
@pytest.mark.parametrize("orders", [pytest.param((3,), marks=pytest.mark.slow), (3, 5)])
def test_an_error_of_a_period_is_named_with_its_coordinate(other: str, over: str, orders) -> None:
    base = base_with(other, over, orders)
    first, *_ = located(base, base.log.runs).statements
    assert first.by == f"place in the period of {over}"
    assert first.p_value == 1 / 2000  # the least that 1999 draws of signs can give
    assert first.share > 0.8


def test_lack_of_fit_over_a_period_is_seen_with_the_coordinate() -> None:
    base = base_with("y", "y", (3,))
    best = lack_of_fit(base, base.log.runs).best(0.01)
    assert best is not None
    assert best.name == "place in the period of y"
    assert lack_of_fit(base_with("y", "y", ()), base.log.runs).best(0.01) is None
