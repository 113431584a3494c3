"""A family of decaying waves, for tests of its C: sums of sensors under a periodic array, with harmonics.

Independent of hallsym's own families: B(x, z) = sum_h A_h exp(-h z / lc) cos(h (x_s - x) / lc + phase), field
in tesla at the gap z, times gain, plus offset (Maguire, UBC 2015, chapter 2).
"""

from math import pi

import casadi as ca
from firmware import known

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
