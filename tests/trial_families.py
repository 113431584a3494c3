"""A family that hallsym does not know, written with its public names only: an array over three sums.

A magnet array of wavelength L moves over fixed sensors, L = 30 mm, lc = L / 2 pi. At the height z its field
is exp(-z / lc) cos(x / lc), so one period of x looks like the next (Maguire, UBC 2015, section 2.2).
"""

from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen import Box, Decoupler, Entry, Margin, Step, limits
from hallsym.model import Example, Family, Model, Parameter, PoseMetric, effect, on_arrays, rate

LENGTH = 0.03
LC = LENGTH / (2 * pi)
THIRDS = [2 * pi * k / 3 for k in range(3)]


def gains_and_offsets(channels):
    """Gain (1 V at z = 0) and offset of each channel."""
    gains = [
        Parameter(f"g{k}", 1.0, 0.5, 2.0, "V", f"amplitude of {c} at z = 0") for k, c in enumerate(channels)
    ]
    offsets = [Parameter(f"o{k}", 0.0, -0.1, 0.1, "V", f"offset of {c}") for k, c in enumerate(channels)]
    return *gains, *offsets


def amplified(s, p):
    """Set the readings: gain * field + offset."""
    n = s["field"].numel()
    s["gain"] = ca.vertcat(*(p[f"g{k}"] for k in range(n)))
    s["reading"] = s["gain"] * s["field"] + ca.vertcat(*(p[f"o{k}"] for k in range(n)))


def phasor(v, p, channels):
    """Sine and cosine of three channels a third of a period apart, each times exp(-height / lc)."""
    b = [(v[k] - p[f"o{k}"]) / p[f"g{k}"] for k in channels]
    return [2 / 3 * sum(b_k * f(u) for b_k, u in zip(b, THIRDS, strict=True)) for f in (np.sin, np.cos)]


def array_2dof(layout=None):
    """An array over three column sums: x along it, z above it."""
    channels = ("col_0_v", "col_1_v", "col_2_v")

    def field(s, p):
        fade = s.derive("fade", ca.exp(-s["z_m"] / LC))
        cos, sin = (s.derive(f.__name__, f(s["x_m"] / LC)) for f in (ca.cos, ca.sin))
        s["wave"] = fade * cos, fade * sin
        s["field"] = ca.vertcat(*(wave_of(s["wave"], p["phase"] - u) for u in THIRDS))

    def begin(v, p):
        sin, cos = phasor(v, p, range(3))
        return ca.vertcat(LC * (ca.atan2(sin, cos) - p["phase"]), -LC * ca.log(ca.hypot(sin, cos)))

    return Model(
        name="array_2dof",
        family=ARRAY,
        pose=("x_m", "z_m"),
        references=("x_ref_m", "z_ref_m"),
        state=(),
        channels=channels,
        parameters=(
            *gains_and_offsets(channels),
            Parameter("phase", 0.0, -2 * pi, 2 * pi, "rad", "phase of the array at the zero of x"),
        ),
        steps=(("field", field), ("electronics", amplified)),
        closed_form=start_2dof,
        period={"x_m": LENGTH, "x_ref_m": LENGTH, "phase": 2 * pi},
        begin=begin,
        typical=tuple((k * LENGTH / 8, 5e-3) for k in range(8)),
    )


def wave_of(wave, phase):
    """cos(x / lc + phase) exp(-z / lc) from the pair at phase 0."""
    return wave[0] * ca.cos(phase) - wave[1] * ca.sin(phase)


def start_2dof(model, coefficients):
    """Gains, offsets and phase from the coefficients of the features."""
    nothing = np.zeros(3)
    cos, sin = (coefficients.get(name, nothing) for name in ("fade*cos", "fade*sin"))
    phase = np.angle(np.sum((cos - 1j * sin) * np.exp(1j * np.array(THIRDS))))
    found = {f"g{k}": float(np.hypot(cos[k], sin[k])) for k in range(3)} | {"phase": float(phase)}
    found |= {f"o{k}": float(v) for k, v in enumerate(coefficients.get("1", nothing))}
    return model.vector(found)


@effect(link="field", waves=(3,), separate="another height")
def second_harmonic(model):
    """Second harmonic of the field, which arrays of unlike magnets have: three waves of error per period."""
    added = tuple(Parameter(n, 0.0, -0.5, 0.5, "1", "second harmonic over the first") for n in ("h2c", "h2s"))

    def step(s, p):
        cos, sin = s["wave"]
        double = cos * cos - sin * sin, 2 * cos * sin
        rows = []
        for u in THIRDS:
            c, d = (wave_of(double, 2 * (p["phase"] - u) + turn) for turn in (0.0, pi / 2))
            rows.append(p["h2c"] * c + p["h2s"] * d)
        s["field"] = s["field"] + ca.vertcat(*rows)

    return model.with_step("field", step, effect="second_harmonic", parameters=added)


@effect(link="clock", separate="several speeds", needs=("t_s",))
def late_readings(model):
    """Readings that come later than the reference."""
    speed = rate("x_ref_m")
    delay = Parameter("delay", 0.0, -0.01, 0.01, "s", "delay of the readings")

    def step(s, p):
        cos, sin = s["wave"]
        slope = ca.vertcat(*(-cos * ca.sin(p["phase"] - u) - sin * ca.cos(p["phase"] - u) for u in THIRDS))
        s["field"] = s["field"] - p["delay"] * s[speed.name] / LC * slope

    wide = model.with_columns(speed)
    return wide.with_step("field", step, effect="late_readings", parameters=(delay,))


def lowered(model, p, weight, box):
    """The C of three sums near x = 0: the arctangent of x and the logarithm of z are odd series."""

    v = model.named(p)
    inputs, columns = [ca.SX.sym(f"col_{k}") for k in range(3)], model.channels
    grid = np.array([g.ravel() for g in np.meshgrid(*(np.linspace(*box.ends[c], 9) for c in model.pose))])
    read = np.array([np.asarray(model.reading(p, [], q, [])).ravel() for q in grid.T])
    ends = Box(dict(zip(columns, zip(read.min(axis=0), read.max(axis=0), strict=True), strict=True)))
    middle = float(np.exp(-2 * np.mean(box.ends["z_m"]) / LC))
    entries = {"middle": (middle, "1"), "level": (float(np.mean(box.ends["z_m"])), "m")}
    for name, turn in (("sin", np.sin), ("cos", np.cos)):
        factors = [2 / 3 * turn(u - v["phase"]) / v[f"g{k}"] for k, u in enumerate(THIRDS)]
        entries |= {f"{name}_{k}": (float(f), "1/V") for k, f in enumerate(factors)}
        entries[f"{name}_rest"] = -sum(f * v[f"o{k}"] for k, f in enumerate(factors)), "1"
    e = {name: ca.SX.sym(name) for name in (*entries, "zero_x", "zero_z")}
    made = {n: ca.SX.sym(n) for n in ("sine", "cosine", "size", "q", "qq", "t", "tt")}
    sin, cos, size, q, qq, t, tt = made.values()
    sums = [sum((e[f"{n}_{k}"] * m for k, m in enumerate(inputs)), e[f"{n}_rest"]) for n in ("sin", "cos")]
    steps = (
        Step("sine", sums[0]),
        Step("cosine", sums[1]),
        Step("size", sin * sin + cos * cos),
        Step("q", sin / cos),
        Step("qq", q * q),
        Step("t", (size - e["middle"]) / (size + e["middle"])),
        Step("tt", t * t),
        Step("x", e["zero_x"] + LC * odd_series(q, qq, [(-1) ** n / (2 * n + 1) for n in range(8)]), "[m]"),
        Step(
            "z",
            (e["zero_z"] + e["level"]) - LC * odd_series(t, tt, [1 / (2 * n + 1) for n in range(8)]),
            "[m]",
        ),
    )

    symbol = ca.SX.sym("v", 3)
    closed = on_arrays(ca.Function("closed", [symbol], [model.begin(symbol, v)]))

    return Decoupler(
        model=model, inputs=columns, limits=limits(columns, ends), at_pose=(), box=ends,
        exact=lambda readings: closed(list(readings))[0],
        table=tuple(Entry(name, *value, name) for name, value in entries.items()), steps=steps,
        offsets=tuple(Entry(f"zero_{a}", 0.0, "m", f"added to {a}_m") for a in "xz"),
        margins=(Margin(columns[0], "middle"),), approximation=1e-8,
        symbols={**dict(zip(columns, inputs, strict=True)), **e, **made,
                 "x_m": ca.SX.sym("x"), "z_m": ca.SX.sym("z")},
    )  # fmt: skip


def odd_series(x, square, factors):
    """x (f0 + f1 x^2 + ...) by Horner's rule."""
    total = ca.SX(factors[-1])
    for f in reversed(factors[:-1]):
        total = total * square + f
    return x * total


ARRAY = Family(
    name="array",
    about="an array (col_0_v, ...; x_ref_m)",
    models=(array_2dof,),
    readings=r"col_\d+_v",
    pose_metric=PoseMetric("m"),
    effects=(second_harmonic, late_readings),
    words={"x_ref_m": "x along the array"},
    decoder=lowered,
    example=Example(
        campaign={
            "step_s": 2e-3,
            "run": [
                {
                    "duration_s": 1.0,
                    "x_m": {"kind": "sine", "amplitude": 0.02, "frequency_hz": f},
                    "z_m": {"kind": "sine", "amplitude": 1e-3, "frequency_hz": 2.3 * f, "about": 5e-3},
                }
                for f in (1.0, 1.3, 1.7, 2.1, 2.6)
            ],
        },
        values={"g0": 1.05, "g1": 0.97, "g2": 1.01, "o0": 2e-3, "o1": -1e-3, "o2": 1e-3, "phase": 0.7},
        noise={"col_0_v": 1e-4, "col_1_v": 1e-4, "col_2_v": 1e-4, "x_ref_m": 1e-7, "z_ref_m": 1e-7},
    ),
)
