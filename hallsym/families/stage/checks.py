"""Claims on a fitted stage whose gains follow height and tilt as on no rigid stage."""

from collections.abc import Collection, Iterator
from itertools import combinations
from typing import Any

import numpy as np

from hallsym.families.recording import Correction, scales
from hallsym.log import Fault

SURE = 5.0
"""Standard uncertainties from zero that slopes must have to be tested: a gain may be constant."""
FACTOR = 2.0
"""The slopes of gains over tilt and height fit the distances of the probes within this factor: positions are
known within their bounds, and units differ by 10 and more."""
NEAREST = 1.3
"""Slope that a correction may leave: half way from degrees to a hundredth."""
STATE = ("z_m", "rx_rad", "ry_rad")
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
    positions = np.array([probe.position for probe in model.layout])
    slopes, off = {}, {}
    for q, tilt, axis, sign in TILTS:
        places = positions[:, axis]
        slack = max(bounds[f"H{k + 1}{'xy'[axis]}"] for k in range(len(places)))
        rows = [k for k, name in enumerate(names) if name[0] in (q, "a")]
        if slack > np.ptp(places) / FACTOR or not np.all(std[rows] > 0):
            continue
        if not np.all(np.abs(values[::3]) > SURE * std[::3]):
            continue
        slope, sigma = _slope(values, covariance, "abc".index(q), sign * (places - places.mean()))
        slopes[tilt] = slope
        if abs(slope) > SURE * sigma and not 1 / FACTOR - SURE * sigma < slope < FACTOR + SURE * sigma:
            off[tilt] = slope
    if not off:
        return
    said = " and ".join(f"{slope:.3g} times as much with {tilt}" for tilt, slope in off.items())
    found = _corrections(model, slopes, values, positions)
    correction = found[0].text if len(found) == 1 else None
    remedy = f"{' or '.join(('z_m', *off))} may be in another unit, inverted or exchanged (see --correct)."
    if correction:
        remedy = (
            "of such mistakes one alone puts the axis of the tilts inside the machine; undo it with "
            f"--correct '{correction}'."
        )
    text = f"Beside height, gains change {said} as probes at these places of a rigid stage do: {remedy}"
    yield Fault(text, "gain_plane", ("z_m", *off), correction=correction)


def _corrections(
    model: Any, tilts: Collection[str], values: np.ndarray, positions: np.ndarray
) -> list[Correction]:
    """Return the signs, scales and orders of the state by which gains are those of a rigid stage.

    Their slopes over the places are 1 for these `tilts`, and the axis of the tilts lies no
    further from the origin than the probes do, in x and in y. Of each column the most usual unit.
    `values`: a, b and c of each probe; `positions`: (probes, 2).
    """
    logged = {c: values[k::3] for k, c in enumerate(STATE)}
    reach, out = np.abs(positions).max(), dict[tuple[str, ...], Correction]()
    for one in (
        *(Correction("sign", (c,)) for c in STATE),
        *(Correction("scale", (c,), (f,), unit=unit) for c in STATE for unit, f in scales(model, (c,))),
        *(Correction("exchange", pair) for pair in combinations(STATE, 2)),
    ):
        sources = {c: (c, 1.0) for c in STATE} | one.mistake.sources(one)
        gains = {c: logged[source] / factor for c, (source, factor) in sources.items()}
        fits = True
        for _, tilt, axis, sign in TILTS:
            ratio, places = sign * gains[tilt] / gains["z_m"], positions[:, axis]
            away = places - places.mean()
            slope = away @ ratio / (away @ away) if tilt in tilts else 1.0
            fits &= 1 / NEAREST < slope < NEAREST and abs(np.mean(places - ratio)) <= reach
        if fits:
            out.setdefault(one.columns, one)
    return [*out.values()]


def _slope(values: np.ndarray, covariance: np.ndarray, q: int, places: np.ndarray) -> tuple[float, float]:
    """Return the slope of coefficient `q` over height's, over places (probes,) less their mean; 1 sigma."""
    height, tilt = values[::3], values[q::3]
    weights = places / height / (places @ places)
    gradient = np.zeros(len(values))
    gradient[::3], gradient[q::3] = -weights * tilt / height, weights
    return float(weights @ tilt), float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
