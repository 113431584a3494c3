"""Single numbers of the thesis's error model (section 2.6); errors over a period: `hallsym.error_model`."""

from math import exp, log, pi, sin

MU_0 = 4e-7 * pi
"""Permeability of vacuum [T m/A], to 5e-10."""
TEMPERATURE_COEFFICIENT = -1.2e-3
"""Relative change of the remanence of sintered NdFeB per degC (thesis, section 2.6)."""


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
