"""Hum of the mains in a residual: the frequency at which it has most power, over the whole of a log."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hallsym.families.mechanisms import MAINS_HZ, MAINS_REACH_HZ
from hallsym.log.quality.runs import FEWEST_SAMPLES

FINER = 8
"""Frequencies in what a block resolves: power between two of them is a straight line within 0.6 %."""


class Block(NamedTuple):
    """Fourier amplitudes of a block about its middle, (K, frequencies); middle and length [s], `f` [Hz]."""

    middle: float
    length: float
    f: np.ndarray
    amplitudes: np.ndarray

    def at(self, f: np.ndarray) -> np.ndarray:
        """Return the amplitudes at other frequencies, (K, f)."""
        return np.array([np.interp(f, self.f, row) for row in self.amplitudes])


def hum(times: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Return the strongest frequency near each one of the mains; none of blocks too short to tell.

    `times`: (n,) [s] of each block, evenly spaced; `rest`: its residual, (K, n). The power of the blocks
    tells where it is, and their phases where exactly.
    """
    blocks = [_block(t, r) for t, r in zip(times, rest, strict=True) if len(t) > 2 * FEWEST_SAMPLES]
    if not blocks:
        return ()
    longest, first = max(b.length for b in blocks), blocks[0].middle
    span = max(blocks[-1].middle - first, longest)
    out = []
    for hz in MAINS_HZ:
        f = hz + np.arange(-MAINS_REACH_HZ, MAINS_REACH_HZ, 0.5 / longest)
        power = sum((np.abs(b.at(f)) ** 2).sum(axis=0) / b.length for b in blocks)
        f = f[np.argmax(power)] + np.arange(-0.5 / longest, 0.5 / longest, 0.25 / span)
        together = sum(b.at(f) * np.exp(-2j * np.pi * f * (b.middle - first)) for b in blocks)
        out.append(float(f[np.argmax((np.abs(together) ** 2).sum(axis=0))]))
    return tuple(out)


def _block(t: np.ndarray, r: np.ndarray) -> Block:
    """Differences of neighbouring samples are taken: what changes slowly has no power there."""
    x, n = np.diff(r), len(t) - 1
    middle, length = 0.5 * (t[1] + t[-1]), t[-1] - t[0]
    ends = [FINER * length * (hz + np.array([-MAINS_REACH_HZ, MAINS_REACH_HZ])) for hz in MAINS_HZ]
    lines = np.concatenate([np.arange(int(low), int(high) + 2) for low, high in ends])
    spectrum = np.fft.fft(x, FINER * n)[:, lines % (FINER * n)]  # a log that is too slow shows an alias
    f = lines / (FINER * length)
    return Block(middle, length, f, spectrum * np.exp(2j * np.pi * f * (middle - t[1])))
