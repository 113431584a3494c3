"""The thesis's error model (section 2.6): what each cause makes of x and z over a period, and single numbers.

A cause is a model with an effect at given values; the reading it gives is decoded by the plain model, in
closed form or by least squares over all sensors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log, pi, sin

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import arrays
from hallsym.model import Model, on_arrays

MU_0 = 4e-7 * pi
"""Permeability of vacuum [T m/A], to 5e-10."""
TEMPERATURE_COEFFICIENT = -1.2e-3
"""Relative change of the remanence of sintered NdFeB per degC (thesis, section 2.6)."""


@dataclass(frozen=True, eq=False)
class PeriodError:
    """Error of the decoded pose over one wavelength of x, at one gap.

    `x_m`: (n,) places. `error`: (n_pose, n) decoded less true [m]. `waves`: of x and z, the number of waves
    per wavelength that is largest; 0 where the error is below `NOTHING`.
    """

    x_m: np.ndarray
    error: np.ndarray
    waves: tuple[int, ...]

    @property
    def peak(self) -> np.ndarray:
        """Largest deviation of the error of x and of z from its mean [m]."""
        return np.abs(self.error - self.error.mean(axis=1, keepdims=True)).max(axis=1)


NOTHING = 1e-9
"""Error [m] that counts as none."""


def period_error(
    model: Model,
    values: Mapping[str, float],
    *,
    decoder: Model | None = None,
    z_m: float | None = None,
    closed_form: bool = False,
    samples: int = 360,
) -> PeriodError:
    """Return the error that a machine with `values` of the parameters of `model` makes over a period of x.

    `decoder`: the model that decodes, by default the plain one with the same amplitudes. `closed_form`: by
    arctangent and logarithm alone; else least squares over all sensors.

    >>> from hallsym.families.halbach.effects.transducer import gain_mismatch
    >>> from hallsym.families.halbach.models import halbach
    >>> period_error(gain_mismatch(halbach()), {"gain_0": 0.01}).waves
    (2, 2)
    """
    (array,) = arrays(model.layout).values()
    plain = decoder
    if plain is None:
        make = model.family.maker(model.name)
        plain = model if make is None else make(model.layout)
    x = array.wavelength_m * np.arange(samples) / samples
    z = np.full(samples, array.level_m if z_m is None else z_m)
    p = model.vector(values)
    known = {n: v for n, v in values.items() if n in plain.names}
    q = plain.vector(known)
    still = np.zeros((len(model.state), samples))
    (read,) = on_arrays(model.reading)(p, [], [x, z], still)
    if closed_form and plain.begin is not None:
        v = ca.SX.sym("v", len(plain.channels))
        named = {n: ca.SX(a) for n, a in zip(plain.names, q, strict=True)}
        found = on_arrays(ca.Function("closed", [v], [ca.densify(plain.begin(v, named))]))(read)[0]
    else:
        found = on_arrays(plain.decoded)(q, [], read, [], np.ones(len(read)))[0]
    error = found - np.array([x, z])
    error[0] -= array.wavelength_m * np.round(error[0] / array.wavelength_m)
    spectrum = np.abs(np.fft.rfft(error - error.mean(axis=1, keepdims=True), axis=1)) / samples
    waves = tuple(int(np.argmax(s)) if 2 * s.max() > NOTHING else 0 for s in spectrum)
    return PeriodError(x, error, waves)


def table(
    causes: Mapping[str, tuple[Model, Mapping[str, float]]], **about: float
) -> Sequence[tuple[str, int, float, float]]:
    """Return rows (cause, waves per wavelength, peak error of x, of z [m]); `about` as for `period_error`."""
    rows = []
    for name, (model, values) in causes.items():
        found = period_error(model, values, **about)  # type: ignore[arg-type]
        rows.append((name, max(found.waves), float(found.peak[0]), float(found.peak[1])))
    return rows


def temperature_error_m(wavelength_m: float, warmer_k: float) -> float:
    """Return the error of the gap z [m] where the magnets are `warmer_k` warmer than at calibration.

    -lc ln(1 - .0012 dT): a weaker field is taken for a wider gap (the thesis counts z the other way).

    >>> round(1e3 * temperature_error_m(0.03, 10), 4)
    0.0576
    """
    return -wavelength_m / (2 * pi) * log(1 + TEMPERATURE_COEFFICIENT * warmer_k)


def trace_field_t(current_a: float, x_m: float, z_m: float) -> float:
    """Return the field [T] along z of a long straight trace at (x, z) from it: mu0 I x / 2 pi (x^2 + z^2).

    >>> round(1e3 * trace_field_t(20, 1e-3, 0), 6)
    4.0
    """
    return MU_0 * current_a * x_m / (2 * pi * (x_m**2 + z_m**2))


def yaw_bias_m(wavelength_m: float, width_m: float, yaw_rad: float) -> float:
    """Return the error of z [m] of sums over a width W turned by yaw: -lc ln sinc(W yaw / 2 lc) (2.5).

    >>> round(1e6 * yaw_bias_m(0.03, 0.03, 0.01), 3)
    0.785
    """
    half = width_m * yaw_rad * pi / wavelength_m
    return -wavelength_m / (2 * pi) * log(sin(half) / half) if half else 0.0


def harmonic_over_remanence(order: int, wavelength_m: float, thickness_m: float, magnets: int = 4) -> float:
    """Return the field of a harmonic of an array at its face over the remanence of its magnets (2-3).

    >>> [round(harmonic_over_remanence(h, 0.03, 0.0075), 3) for h in (1, 5, 9)]
    [0.713, -0.18, 0.1]
    """
    filled = sin(order * pi / magnets) / (order * pi / magnets)
    return filled * (1 - exp(-2 * pi * order * thickness_m / wavelength_m))
