"""A family of decaying waves, for tests of its C: sums of sensors under a periodic array, with harmonics.

Independent of hallsym's own families: B(x, z) = sum_h A_h exp(-h z / lc) cos(h (x_s - x) / lc + phase), field
in tesla at the gap z, times gain, plus offset (Maguire, UBC 2015, chapter 2).
"""

from math import pi

import casadi as ca
import numpy as np
from firmware import known
from msgspec import structs

from hallsym.estimation.calibration import LogRecord
from hallsym.log import Noise, Sigma
from hallsym.model import Family, Model, Parameter, PoseMetric

LENGTH = 0.03
LC = LENGTH / (2 * pi)
THIRD = LENGTH / 3


def sums(count=3, pitch=THIRD):
    """Sums at a pitch, gains, offsets and places of their own; fifth harmonic and wavelength are
    parameters."""
    channels = tuple(f"col_{k}_v" for k in range(count))

    def field(s, p):
        lc, rows = p["wavelength"] / (2 * pi), []
        for k in range(count):
            place = (k * pitch + p[f"dx{k}"] - s["x_m"]) / lc
            rows.append(
                sum(
                    p[f"A{h}"] * ca.exp(-h * (s["z_m"] + p[f"dz{k}"]) / lc) * ca.cos(h * (place + p["phase"]))
                    for h in (1, 2, 5)
                )
            )
        s["field"] = ca.vertcat(*rows)

    def amplified(s, p):
        s["gain"] = ca.vertcat(*(p[f"g{k}"] for k in range(count)))
        s["reading"] = s["gain"] * s["field"] + ca.vertcat(*(p[f"o{k}"] for k in range(count)))

    each = [
        Parameter(f"{n}{k}", nominal, nominal - wide, nominal + wide, unit, f"{what} of {c}")
        for n, nominal, wide, unit, what in (
            ("g", 4.0, 2.0, "V/T", "gain"),
            ("o", 0.0, 0.1, "V", "offset"),
            ("dx", 0.0, 1e-3, "m", "place along"),
            ("dz", 0.0, 1e-3, "m", "height"),
        )
        for k, c in enumerate(channels)
    ]
    return Model(
        name="sums", family=WAVES, pose=("x_m", "z_m"), references=("x_ref_m", "z_ref_m"), state=(),
        channels=channels,
        parameters=(
            *each,
            Parameter("A1", 0.8875, 0.5, 1.5, "T", "first harmonic"),
            Parameter("A2", 0.0, -0.1, 0.1, "T", "second harmonic"),
            Parameter("A5", -0.225, -0.5, 0.5, "T", "fifth harmonic"),
            Parameter("phase", 0.0, -2 * pi, 2 * pi, "rad", "phase of the array at the zero of x"),
            Parameter("wavelength", LENGTH, 0.02, 0.04, "m", "wavelength"),
        ),
        steps=(("field", field), ("electronics", amplified)),
        period={"x_m": LENGTH, "x_ref_m": LENGTH},
    )  # fmt: skip


WAVES = Family(
    "waves", models=(sums,), readings=r"col_\d+_v", pose_metric=PoseMetric("m", 0.1), decoder="wave"
)

VALUES = {
    "g0": 4.12, "g1": 3.9, "g2": 4.03, "o0": 2e-3, "o1": -4e-3, "o2": 1e-3, "dx1": 4e-5, "dz2": -3e-5,
    "phase": 0.7,
}  # fmt: skip


def calibrated(model=None, values=VALUES, gaps=(0.004, 0.01), sigma=1e-4):
    """A calibration of a wave at known parameters over a range of gaps [m]."""
    model = model or sums()
    p = model.vector({k: v for k, v in values.items() if k in model.names})
    return known(
        model, p, noise=Noise({c: Sigma(sigma, "given") for c in model.channels}),
        log=LogRecord(span={"x_ref_m": (-0.03, 0.03), "z_ref_m": gaps}, sha256=64 * "0"),
    )  # fmt: skip


# -- four arrays on a mover ----------------------------------------------------------------------------------

CENTRES = {"x1": (-0.075, 0.09), "x2": (0.075, -0.09), "y1": (0.09, 0.075), "y2": (-0.09, -0.075)}
"""Centres of the arrays on the mover [m]: a pinwheel."""
SIX = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
ACROSS = 6


def turning(s):
    """Rz Ry Rx, from the mover's axes to the board's."""
    (ca_, cb, cc), (sa, sb, sc) = ([f(s[f"r{a}_rad"]) for a in "xyz"] for f in (ca.cos, ca.sin))
    return [
        [cc * cb, cc * sb * sa - sc * ca_, cc * sb * ca_ + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca_, sc * sb * ca_ - cc * sa],
        [-sb, cb * sa, cb * ca_],
    ]


def planar(count=6, across=ACROSS):
    """Four arrays over `count` sums each: means of `across` sensors side by side, a third of a period
    apart."""
    places = {
        (array, k): [
            (cx + (k - (count - 1) / 2) * THIRD, cy + (j - (across - 1) / 2) * THIRD)
            if array.startswith("x")
            else (cx + (j - (across - 1) / 2) * THIRD, cy + (k - (count - 1) / 2) * THIRD)
            for j in range(across)
        ]
        for array, (cx, cy) in CENTRES.items()
        for k in range(count)
    }
    channels = tuple(f"{a}_{'col' if a[0] == 'x' else 'row'}_{k}_v" for a, k in places)

    def field(s, p):
        r, k, rows = turning(s), 2 * pi / LENGTH, []
        for (array, _), sensors in places.items():
            axis, total = "xy".index(array[0]), 0
            for sensor in sensors:
                d = [sensor[0] - s["x_m"], sensor[1] - s["y_m"], -s["z_m"]]
                m = [sum(r[i][j] * d[i] for i in range(3)) for j in range(3)]
                u = m[axis] - CENTRES[array][axis]
                for h in (1, 5):
                    size = p[f"A{h}"] * ca.exp(h * k * m[2])
                    total += size * (r[2][2] * ca.cos(h * k * u) - r[2][axis] * ca.sin(h * k * u))
            rows.append(total / len(sensors))
        s["field"] = ca.vertcat(*rows)

    def amplified(s, p):
        s["gain"] = ca.vertcat(*(p[f"g{k}"] for k in range(len(channels))))
        s["reading"] = s["gain"] * s["field"] + ca.vertcat(*(p[f"o{k}"] for k in range(len(channels))))

    return Model(
        name="planar", family=WAVES, pose=SIX, references=tuple(f"{c[:-2]}_ref_m" if c[-1] == "m" else
        f"{c[:-4]}_ref_rad" for c in SIX), state=(), channels=channels,
        parameters=(
            *(Parameter(f"g{k}", 4.0, 2.0, 6.0, "V/T", f"gain of {c}") for k, c in enumerate(channels)),
            *(Parameter(f"o{k}", 0.0, -0.1, 0.1, "V", f"offset of {c}") for k, c in enumerate(channels)),
            Parameter("A1", 0.8875, 0.5, 1.5, "T", "first harmonic"),
            Parameter("A5", -0.225, -0.5, 0.5, "T", "fifth harmonic"),
        ),
        steps=(("field", field), ("electronics", amplified)),
    )  # fmt: skip


def calibrated_planar(count=6, gaps=(0.0045, 0.0085), travel=0.0145, tilt=0.01, across=ACROSS):
    """A calibration of four arrays: gains and offsets of 1 % and 2 mV."""
    model = planar(count, across)
    rng = np.random.default_rng(4)
    n = len(model.channels)
    values = {f"g{k}": 4 * (1 + 0.01 * rng.standard_normal()) for k in range(n)}
    values |= {f"o{k}": 2e-3 * rng.standard_normal() for k in range(n)}
    fit = calibrated(model, values)
    span = dict.fromkeys(("x_ref_m", "y_ref_m"), (-travel, travel)) | {"z_ref_m": gaps}
    span |= {f"r{a}_ref_rad": (-tilt, tilt) for a in "xyz"}
    return fit.changed(log=structs.replace(fit.log, span=span))
