"""Charts of what is left: its histogram and spectrum, and the correlation of the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from hallsym.report.data import Correlation, Residuals
from hallsym.report.page.marks import (
    NARROW,
    RIM,
    Chart,
    Mark,
    Scale,
    below,
    beside,
    line,
    path,
    polyline,
    px,
    rect,
    text,
)
from hallsym.report.words import MINUS, largest, name, scale, three

LEFT, TOP, BOTTOM = 46.0, 22.0, 112.0
DECADE = 10.0
"""A spectrum that spans less is drawn on a linear scale."""
LOOKS = {1: ("median",), 2: ("median0", "median")}
"""Lines by how many versions of a model there are."""


def histograms(found: Mapping[str, Residuals]) -> list[Chart]:
    """Draw how often an error is how large, one picture per output, with the normal curve of the floor."""
    return [_histogram(found, k) for k in range(len(next(iter(found.values())).pose))]


def _histogram(found: Mapping[str, Residuals], k: int) -> Chart:
    first = next(iter(found.values()))
    factor, unit = scale(first.pose[k], largest(first.edges[k]), first.turning)
    edges, floor = factor * first.edges[k], factor * first.floor[k]
    width = edges[1] - edges[0]
    shares = {version: r.counts[k] / max(r.counts[k].sum(), 1) for version, r in found.items()}
    normal = np.zeros(0)
    if floor > 0:
        z = edges / floor
        normal = np.diff([0.5 * math.erfc(-v / math.sqrt(2)) for v in z])
    high = 1.05 * max(largest(np.array(v)) for v in (*shares.values(), normal)) or 1.0
    x = Scale(edges[0], edges[-1], LEFT, NARROW - RIM)
    y = Scale(0.0, 100 * high, BOTTOM, TOP)
    parts = [text(0, 12, f"{name(first.pose[k])}: share of samples [%]", look="title")]
    parts += [*beside(y, LEFT, NARROW - RIM, 4), *below(x, BOTTOM, f"error [{unit}]")]
    for look, share in zip(("band0", "band")[-len(shares) :], shares.values(), strict=True):
        steps = "".join(
            f"V{px(y(100 * s))}H{px(x(b))}" for s, (_, b) in zip(share, pairwise(edges), strict=True)
        )
        parts.append(path(f"M{px(x(edges[0]))} {px(BOTTOM)}{steps}V{px(BOTTOM)}Z", look))
    if floor > 0:
        middles = (edges[:-1] + 0.5 * width).tolist()
        parts.append(
            polyline([(x(a), y(100 * v)) for a, v in zip(middles, normal.tolist(), strict=True)], "level")
        )
    spread = {v: factor * _spread(r, k) for v, r in found.items()}
    says = f"histogram of the error in {name(first.pose[k])}: half of the samples within " + ", ".join(
        f"{three(s)} {unit}{f' {version}' if len(spread) > 1 else ''}" for version, s in spread.items()
    )
    return Chart(NARROW, BOTTOM + 34, says, parts)


def _spread(residuals: Residuals, k: int) -> float:
    """Return the size of error that half of the samples stay below, to one bin."""
    middles = np.abs(0.5 * (residuals.edges[k][1:] + residuals.edges[k][:-1]))
    order = np.argsort(middles, kind="stable")
    up = np.cumsum(residuals.counts[k][order])
    return float(middles[order][np.searchsorted(up, 0.5 * up[-1])]) if up[-1] else 0.0


def spectra(found: Mapping[str, Residuals]) -> list[Chart]:
    """Draw the amplitude spectral density of the errors, one picture per output; none where there is none."""
    known = {version: r for version, r in found.items() if len(r.frequency)}
    if len(known) < len(found) or len(next(iter(known.values())).frequency) < 3:
        return []
    return [_spectrum(known, k) for k in range(len(next(iter(known.values())).pose))]


def _spectrum(found: Mapping[str, Residuals], k: int) -> Chart:
    first = next(iter(found.values()))
    sizes = np.concatenate([r.density[k] for r in found.values()] + [first.white[k : k + 1]])
    sizes = sizes[sizes > 0] if (sizes > 0).any() else np.ones(1)
    factor, unit = scale(first.pose[k], float(sizes.max()), first.turning)
    low, high = factor * float(sizes.min()) / 1.3, factor * float(sizes.max()) * 1.3
    log = high > DECADE * low
    x = Scale(float(first.frequency[0]), float(first.frequency[-1]), LEFT, NARROW - RIM, log=True)
    y = Scale(low if log else 0.0, high, BOTTOM, TOP, log)
    per = "√Hz" if first.timed else "√(cycles per sample)"
    title = "frequency [Hz]" if first.timed else "frequency [cycles per sample]"
    parts = [text(0, 12, f"{name(first.pose[k])} [{unit}/{per}]", look="title")]
    parts += [*beside(y, LEFT, NARROW - RIM, 3), *below(x, BOTTOM, title, 3)]
    for look, r in zip(LOOKS[len(found)], found.values(), strict=True):
        points = zip(r.frequency.tolist(), (factor * r.density[k]).tolist(), strict=True)
        parts.append(polyline([(x(a), y(v)) for a, v in points], look))
    if first.white[k] > 0:
        at = y(factor * first.white[k])
        parts.append(line(LEFT, at, NARROW - RIM, at, "level"))
    peak = int(np.argmax(first.density[k]))
    says = (
        f"spectrum of the error in {name(first.pose[k])}: most, {three(factor * first.density[k][peak])} "
        f"{unit}/{per}, at {three(first.frequency[peak])} {title.partition('[')[2].rstrip(']')}"
    )
    return Chart(NARROW, BOTTOM + 34, says, parts)


def matrix(found: Correlation, least: float) -> Chart | None:
    """Draw the correlation of every two parameters: fuller is more, a dash is negative; None for fewer.

    Correlations of at least `least` are read out.
    """
    n = len(found.names)
    if n < 2:
        return None
    room = 14.0 + 6.4 * max(map(len, found.names))
    cell = min(26.0, max(13.0, (700.0 - room) / n))
    parts: list[Mark] = []
    for row, own in enumerate(found.names):
        top = room + cell * row
        parts.append(text(room - 5, top + 0.5 * cell + 4, own, "end"))
        x, y = room + cell * (row + 0.5) + 4, room - 5
        turned = text(x, y, own)
        parts.append(
            turned._replace(attributes={**turned.attributes, "transform": f"rotate(-90 {px(x)} {px(y)})"})
        )
        for column in range(row + 1):
            value, left = float(found.values[row, column]), room + cell * column
            said = f"{own} and {found.names[column]}: {value:.2f}".replace("-", MINUS)
            look = "diagonal" if row == column else "neg" if value < 0 else "pos"
            parts.append(rect(left, top, cell - 1, cell - 1, look, said, abs(value)))
            if value < -0.1:
                at = top + 0.5 * cell - 0.5
                parts.append(line(left + 0.3 * cell, at, left + 0.65 * cell, at, "dash"))
    strong = [
        f"{found.names[a]} and {found.names[b]} {found.values[a, b]:.2f}".replace("-", MINUS)
        for a in range(n)
        for b in range(a)
        if abs(found.values[a, b]) >= least
    ]
    says = f"correlation of parameters: {', '.join(strong) or f'none of {least:g} or more'}"
    size = room + cell * n + 2
    look = "matrix" if size <= 560 else "matrix wide"
    return Chart(size, size, says, parts, {"class": look, "width": px(1.2 * size)})
