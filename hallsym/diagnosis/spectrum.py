"""Where a residual lies in frequency: the motion and its harmonics, mains, slow, fast."""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.residuals import Piece

LINE = 0.01
"""Power of the motion, over that of its strongest line, from which on a frequency counts as its own."""
AROUND = 12
"""Frequencies on either side that a line is held against."""
MEDIAN = 0.85
"""Median over mean of the power of noise, a little low for the sum over three readings."""
RESOLVED = 3
"""Periods that a stretch must hold for its motion to be told from what is slow."""
MAINS = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""
MAINS_DRIFT = 0.3
"""Distance from them [Hz] that the mains and a clock may drift by."""
CROWDED = 0.3
"""Share of all frequencies from which on a motion is broad and has none of its own."""
SHORTEST = 32
"""Samples that a stretch must have."""
BANDS = (0.0, 0.5, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""Lower ends of the bands in which all other frequencies are told apart [Hz]."""
ENOUGH = 2_000_000
"""Samples after which no more are looked at."""


@dataclass(frozen=True)
class Band:
    """Frequencies that belong together: `kind` "mains", "motion" (also its harmonics) or "band"."""

    kind: str
    name: str


MOTION = Band("motion", "the frequencies of the motion")
HARMONICS = {2: Band("motion", f"twice {MOTION.name}"), 3: Band("motion", f"three times {MOTION.name}")}


@dataclass(eq=False)
class Spectrum:
    """Power of the whitened residual by band and run: `power[band][run]`, `white` for noise."""

    power: dict[Band, dict[int, float]] = field(default_factory=dict)
    white: dict[Band, dict[int, float]] = field(default_factory=dict)
    motion_hz: list[float] = field(default_factory=list)
    seen: int = 0

    def add(self, piece: Piece) -> None:
        """Add a stretch of one run."""
        n = len(piece.t)
        if n < SHORTEST or self.seen > ENOUGH:
            return
        self.seen += n
        r = np.where(piece.used, piece.residual, 0.0)
        f = np.fft.rfftfreq(n, float(np.median(np.diff(piece.t))))
        twice = np.where((f > 0) & ((n % 2 == 1) | (f < f[-1])), 2.0, 1.0)
        power = (np.abs(np.fft.rfft(r, axis=1)) ** 2).sum(axis=0) / n * twice
        white = twice * len(r)
        around = np.maximum(white, median_filter(power, 2 * AROUND + 1, mode="nearest") / MEDIAN)
        left = np.ones(len(f), bool)
        for band, mask in self._bands(piece, f).items():
            here = mask & left
            left &= ~mask
            floor = white if band.kind == "band" else around
            for store, values in ((self.power, power), (self.white, floor)):
                runs = store.setdefault(band, {})
                runs[piece.run] = runs.get(piece.run, 0.0) + float(values[here].sum())

    def _bands(self, piece: Piece, f: np.ndarray) -> dict[Band, np.ndarray]:
        """Frequencies of each band; the first that claims one has it."""
        wide = max(MAINS_DRIFT, 1.5 * f[1])
        out = {Band("mains", f"the mains, {hz:g} Hz"): np.abs(f - hz) < wide for hz in MAINS}
        window = np.hanning(len(piece.t))
        moved = np.abs(np.fft.rfft(piece.speed * window, axis=1)) ** 2
        position = moved.sum(axis=0) / np.maximum(f, f[1]) ** 2
        slow = float(position[1:RESOLVED].max())
        position[:RESOLVED] = 0.0
        lines = np.flatnonzero(position > LINE * max(position.max(), slow))
        near = _near(lines, len(f))
        if position.max() > slow and near.mean() < CROWDED:
            self.motion_hz.append(float(f[np.argmax(position)]))
            out[MOTION] = near
            for n, band in HARMONICS.items():
                out[band] = _near(n * lines[n * lines < len(f)], len(f))
        for low, high in zip(BANDS, (*BANDS[1:], np.inf), strict=True):
            name = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"more than {low:g} Hz"
            if (mask := (f >= low) & (f < high)).any():
                out[Band("band", name)] = mask
        return out


def _near(lines: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros(n, bool)
    for shift in (-1, 0, 1):
        out[np.clip(lines + shift, 0, n - 1)] = True
    return out
