"""Charts of what is left: its histogram and spectrum, and the correlation of the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hallsym.report.data import Correlation, Residuals
from hallsym.report.page.frames import LOOKS, area, curve, framed, level
from hallsym.report.page.marks import Chart, Mark, Scale, px, rect, text, tile
from hallsym.report.words import MINUS, largest, name, scale, three

DECADE = 10.0
"""A spectrum that spans less is drawn on a linear scale."""


def histograms(found: Mapping[str, Residuals]) -> list[Chart]:
    """Draw how often an error is how large, one picture per output, with the normal curve of the floor."""
    return [_histogram(found, k) for k in range(len(next(iter(found.values())).pose))]


def _histogram(found: Mapping[str, Residuals], k: int) -> Chart:
    first = next(iter(found.values()))
    factor, unit = scale(first.pose[k], largest(first.edges[k]), first.turning)
    edges, floor = factor * first.edges[k], factor * first.floor[k]
    shares = [100 * r.counts[k] / max(r.counts[k].sum(), 1) for r in found.values()]
    steps = np.repeat(edges, 2)[1:-1]
    layers = [
        area(steps, 0 * steps, np.repeat(share, 2), f"band{ending}")
        for ending, share in zip(LOOKS[len(found)], shares, strict=True)
    ]
    if floor > 0:
        shares.append(100 * np.diff([0.5 * math.erfc(-v / floor / math.sqrt(2)) for v in edges]))
        layers.append(curve(0.5 * (edges[1:] + edges[:-1]), shares[-1], "level"))
    said = ", ".join(
        f"{three(factor * _spread(r, k))} {unit}{f' {version}' if len(found) > 1 else ''}"
        for version, r in found.items()
    )
    what = name(first.pose[k])
    says = f"histogram of the error in {what}: half of the samples within {said}"
    x = Scale(edges[0], edges[-1], title=f"error [{unit}]")
    y = Scale(0.0, 1.05 * max(map(largest, shares)) or 100.0)
    return framed(f"{what}: share of samples [%]", says, x, y, layers)


def _spread(residuals: Residuals, k: int) -> float:
    """Return the size of error that half of the samples stay below, to one bin."""
    middles = np.abs(0.5 * (residuals.edges[k][1:] + residuals.edges[k][:-1]))
    order = np.argsort(middles, kind="stable")
    up = np.cumsum(residuals.counts[k][order])
    return float(middles[order][np.searchsorted(up, 0.5 * up[-1])]) if up[-1] else 0.0


def spectra(found: Mapping[str, Residuals]) -> list[Chart]:
    """Draw the amplitude spectral density of the errors, one picture per output; none where there is none."""
    if any(len(r.frequency) < 3 for r in found.values()):
        return []
    return [_spectrum(found, k) for k in range(len(next(iter(found.values())).pose))]


def _spectrum(found: Mapping[str, Residuals], k: int) -> Chart:
    first = next(iter(found.values()))
    sizes = np.concatenate([r.density[k] for r in found.values()] + [first.white[k : k + 1]])
    sizes = sizes[sizes > 0] if (sizes > 0).any() else np.ones(1)
    factor, unit = scale(first.pose[k], float(sizes.max()), first.turning)
    low, high = factor * float(sizes.min()) / 1.3, factor * float(sizes.max()) * 1.3
    log = high > DECADE * low
    per, hz = ("√Hz", "Hz") if first.timed else ("√(cycles per sample)", "cycles per sample")
    layers = [
        curve(r.frequency, factor * r.density[k], f"median{ending}")
        for ending, r in zip(LOOKS[len(found)], found.values(), strict=True)
    ]
    what, peak = name(first.pose[k]), int(np.argmax(first.density[k]))
    most = f"{three(factor * first.density[k][peak])} {unit}/{per}, at {three(first.frequency[peak])} {hz}"
    x = Scale(first.frequency[0], first.frequency[-1], log=True, title=f"frequency [{hz}]", most=3)
    y = Scale(low if log else 0.0, high, log=log, most=3)
    layers.append(level(factor * first.white[k]))
    return framed(f"{what} [{unit}/{per}]", f"spectrum of the error in {what}: most, {most}", x, y, layers)


def matrix(found: Correlation, least: float) -> Chart | None:
    """Draw the correlation of every two parameters: fuller is more, a dash is negative; None for fewer.

    Correlations of at least `least` are read out.
    """
    n = len(found.names)
    if n < 2:
        return None
    room = 14.0 + 6.4 * max(map(len, found.names))
    cell = min(26.0, max(13.0, (700.0 - room) / n))
    marks: list[Mark] = []
    strong = []
    for row, own in enumerate(found.names):
        y = room + cell * row
        marks.append(text(room - 5, y + 0.5 * cell + 4, own, "end"))
        marks.append(text(y + 0.5 * cell + 4, room - 5, own, upright=True))
        marks.append(rect(y, y, cell - 1, cell - 1, "band"))
        for column, other in enumerate(found.names[:row]):
            value = float(found.values[row, column])
            said = f"{own} and {other} {value:.2f}".replace("-", MINUS)
            marks += tile(room + cell * column, y, cell - 1, cell - 1, value, said)
            strong += [said] if abs(value) >= least else []
    says = f"correlation of parameters: {', '.join(strong) or f'none of {least:g} or more'}"
    size = room + cell * n + 2
    look = "matrix" if size <= 560 else "matrix wide"
    return Chart(size, size, says, marks, {"class": look, "width": px(1.2 * size)})
