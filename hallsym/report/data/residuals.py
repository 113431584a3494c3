"""How the errors of a decoded pose are distributed, in size and in frequency, from one pass over a log."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.report.data.survey import Survey

BINS, REACH = 61, 4.0
"""Bins of a histogram, and where it ends, in rms of the error or the noise floor, whichever is more."""
SHORTEST, LONGEST = 32, 1024
"""Samples of a segment of which a spectrum is averaged: a power of two up to half the median run."""
EVEN = 0.05
"""Steps of time may differ by this part of the median for a spectrum: a clock with jitter."""
MISSING = 0.05
"""Part of the samples of a block that may be left out for a spectrum; zero stands in their place."""
POINTS = 90
"""Points of a spectrum, equally far apart on a logarithmic axis."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Errors of the decoded pose over a whole log, SI.

    `edges`: (n_pose, bins + 1), `counts`: (n_pose, bins), the outermost bins hold what lies beyond. `floor`:
    (n_pose,) noise floor, 0 where unknown. `frequency`: (points,) in Hz, or per sample if not `timed`;
    `density`: (n_pose, points) amplitude spectral density, one-sided, per root Hz; both are empty where the
    runs are too short or unevenly sampled. `white`: (n_pose,) the density of white noise as large as
    the floor.
    """

    pose: tuple[str, ...]
    edges: np.ndarray
    counts: np.ndarray
    floor: np.ndarray
    frequency: np.ndarray
    density: np.ndarray
    white: np.ndarray
    timed: bool
    turning: Collection[str] | None = None


class ResidualTally:
    """Sums of a pass: counts by bin, and the power of segments."""

    def __init__(
        self, pose: Sequence[str], survey: Survey, floor: np.ndarray, turning: Collection[str] | None = None
    ) -> None:
        """Start with what a survey of the log knows of its errors; `floor`: (n_pose,) in SI."""
        over = survey.fitted.over()
        rms = np.array([over["rmse"][c] if over else 0.0 for c in pose])
        self.pose, self.floor, self.timed, self.turning = tuple(pose), floor, survey.time is not None, turning
        reach = REACH * np.maximum(np.maximum(floor, rms), 1e-300)
        self.edges = reach[:, None] * np.linspace(-1.0, 1.0, BINS + 1)
        self.counts = np.zeros((len(self.pose), BINS), dtype=np.int64)
        half = float(np.median(np.diff(survey.edges))) / 2
        self.length = int(min(2 ** np.floor(np.log2(max(half, 1.0))), LONGEST))
        self.power, self.segments, self.step = np.zeros((len(self.pose), self.length // 2 + 1)), 0, 0.0

    def add(self, time: np.ndarray, errors: np.ndarray) -> None:
        """Add a block: `time` [s] (samples,), `errors` (n_pose, samples) in SI, nan where nothing counts."""
        for counts, edges, row in zip(self.counts, self.edges, errors, strict=True):
            inside = np.clip(row[np.isfinite(row)], edges[0], edges[-1])
            counts += np.histogram(inside, edges)[0]
        missing = ~np.isfinite(errors)
        if errors.shape[1] < self.length or self.length < SHORTEST or missing.mean() > MISSING:
            return
        steps = np.diff(time) if self.timed else np.ones(1)
        step = float(np.median(steps))
        self.step = self.step or step
        if step <= 0 or np.abs(steps / self.step - 1.0).max() > EVEN:
            return
        rows = np.where(missing, 0.0, errors)
        from scipy.signal import welch  # takes long to import

        _, power = welch(rows, 1.0 / self.step, nperseg=self.length, noverlap=0, axis=1)
        count = errors.shape[1] // self.length
        self.power += count * power
        self.segments += count

    def found(self) -> Residuals:
        """Return what was gathered."""
        common = self.pose, self.edges, self.counts, self.floor
        if not self.segments:
            nothing = np.zeros((len(self.pose), 0))
            return Residuals(*common, np.zeros(0), nothing, self.floor, self.timed, self.turning)
        frequency = np.fft.rfftfreq(self.length, self.step)[1:-1]  # the last has half the power
        edges = np.geomspace(frequency[0], frequency[-1] * 1.001, POINTS + 1)
        starts = np.unique(np.searchsorted(frequency, edges[:-1]))
        width = np.diff([*starts, len(frequency)])
        power = np.add.reduceat(self.power[:, 1:-1], starts, axis=1) / (width * self.segments)
        at = np.add.reduceat(frequency, starts) / width
        white = self.floor * np.sqrt(2.0 * self.step)
        return Residuals(*common, at, np.sqrt(power), white, self.timed, self.turning)
