"""Claims on a fitted stage whose gains follow height and tilt as on no rigid stage."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from hallsym.log import Fault

SURE = 5.0
"""Standard uncertainties from zero that slopes must have to be tested: a gain may be constant."""
FACTOR = 2.0
"""The slopes of gains over tilt and height fit the distances of the probes within this factor: positions are
known within their bounds, and units differ by 10 and more."""
TILTS = (("c", "ry_rad", 0, -1.0), ("b", "rx_rad", 1, 1.0))
"""Coefficient of a tilt, the tilt, the axis along which probes are away from it, the sign of b/a or c/a."""


def implausible(fit: Any) -> Iterator[Fault]:
    """Yield the claim that gains follow height and tilts as on no rigid stage, Model (31).

    A rigid stage lifts probe k by Z + (y_k - y0) Rx - (x_k - x0) Ry, so that c_k / a_k = x0 - x_k and
    b_k / a_k = y_k - y0: their slopes over the places of the probes are 1, and 10 where Z is 10 times too
    large. Gains that do not follow tilts are a legal machine: the slope is then no different from zero. An
    axis along which positions may be off by half the distance of the probes says nothing.
    """
    model = fit.model
    names = [f"{q}_{probe.label}" for probe in model.layout for q in "abc"]
    if not set(names) <= set(model.names):
        return
    at = [model.names.index(name) for name in names]
    values, covariance = fit.values[at], fit.covariance[np.ix_(at, at)]
    std = np.sqrt(np.diag(covariance))
    bounds = {p.name: p.upper - p.lower for p in model.parameters}
    off = {}
    for q, tilt, axis, sign in TILTS:
        places = np.array([probe.position[axis] for probe in model.layout])
        slack = max(bounds[f"H{k + 1}{'xy'[axis]}"] for k in range(len(places)))
        rows = [k for k, name in enumerate(names) if name[0] in (q, "a")]
        if slack > np.ptp(places) / FACTOR or not np.all(std[rows] > 0):
            continue
        if not np.all(np.abs(values[::3]) > SURE * std[::3]):
            continue
        slope, sigma = _slope(values, covariance, "abc".index(q), sign * (places - places.mean()))
        if abs(slope) > SURE * sigma and not 1 / FACTOR - SURE * sigma < slope < FACTOR + SURE * sigma:
            off[tilt] = slope
    if off:
        said = " and ".join(f"{slope:.3g} times as much with {tilt}" for tilt, slope in off.items())
        yield Fault(
            f"Beside height, gains change {said} as probes at these places of a rigid stage do: z_m or "
            f"{' or '.join(off)} may be in another unit, inverted or exchanged (see --correct).",
            "gain_plane", ("z_m", *off),
        )  # fmt: skip


def _slope(values: np.ndarray, covariance: np.ndarray, q: int, places: np.ndarray) -> tuple[float, float]:
    """Return the slope of coefficient `q` over height's, over places (probes,) less their mean; 1 sigma."""
    height, tilt = values[::3], values[q::3]
    weights = places / height / (places @ places)
    gradient = np.zeros(len(values))
    gradient[::3], gradient[q::3] = -weights * tilt / height, weights
    return float(weights @ tilt), float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
