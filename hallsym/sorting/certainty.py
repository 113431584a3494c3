"""To what gains and offsets are known: by repeats, by readings about their lines, by the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.sorting.bench import Measured
from hallsym.sorting.bins import LOT
from hallsym.sorting.result import Drift
from hallsym.sorting.seating import FEWEST, Scatter, grouped
from hallsym.units import Array


@dataclass(frozen=True, eq=False)
class Certainty:
    """Standard uncertainties of gains and offsets (n,) [their units], nan where nothing tells them.

    `dof` of that of the gains; `instead`: what stands for a repeatability that is not known, else empty.
    """

    gain: Array
    offset: Array
    dof: float
    instead: str = ""


def certainty(
    m: Measured, gain: Array, at: Array, count: Array, scatter: Scatter | None, drift: Drift
) -> Certainty:
    """Return the uncertainties of sensors with `gain` and `count` measurements (n,), of which `at` stand."""
    line, dof = _line(m, at)
    weigh = np.bincount(m.sensor[at], minlength=m.sensor.max() + 1)
    kept = np.flatnonzero(weigh)

    def mean_std(root: Array) -> Array:
        """Uncertainty of the mean of a sensor's measurements, each `line` times its root."""
        return np.asarray(line * np.sqrt(np.bincount(m.sensor[at], root[at] ** 2, len(weigh))[kept]) / count)

    offset = _offsets(m, at)
    by_offset = mean_std(m.offset_root) if np.isnan(offset) else offset / np.sqrt(count)
    if scatter is not None:
        return Certainty(scatter.std / np.sqrt(count) * gain, by_offset, scatter.dof)
    if dof >= FEWEST and line > 0:
        std = mean_std(m.gain_root)
        share = 100 * float(np.median(std / gain))
        return Certainty(std, by_offset, dof, f"the scatter of readings about their lines, {share:.2g} %")
    level = _reference(drift)
    told = f"the noise of the reference sensor, {100 * level:.2g} %" if level else ""
    return Certainty(level / np.sqrt(count) * gain, by_offset, np.inf, told)


def _line(m: Measured, at: Array) -> tuple[float, float]:
    """Standard deviation of a reading about its line, nan where no measurement tells it, and its dof."""
    dof = float(m.spare[at].sum())
    return (float(np.sqrt(m.square[at].sum() / dof)) if dof else float("nan")), dof


def _offsets(m: Measured, at: Array) -> float:
    """Standard deviation of one measurement of an offset, from repeats; nan without any."""
    groups = [m.offset[g] for g in grouped(m.sensor[at], at) if len(g) > 1]
    if not groups:
        return float("nan")
    square = sum(float(np.sum((x - x.mean()) ** 2)) for x in groups)
    return float(np.sqrt(square / sum(len(x) - 1 for x in groups)))


def _reference(drift: Drift) -> float:
    """The noise of the reference, relative; of a few readings all that it moves from one to the next."""
    read = drift.read[np.isfinite(drift.read)] if drift.read is not None else np.zeros(0)
    if not 2 <= len(read) < LOT:
        return drift.noise
    return max(drift.noise, float(np.sqrt(np.mean(np.diff(read) ** 2) / 2)))
