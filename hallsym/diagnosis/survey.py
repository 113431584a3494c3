"""Survey of a residual: its memory, hum of the mains, and what its samples show one by one.

One pass over the log, block by block. No model holds these findings (an outlier has no equation), or they
are numbers from which effects are searched (a mains frequency).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.cordic import TOLERANCE
from hallsym.diagnosis.p_values import as_often, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residuals import Base, Piece, found_once, pieces
from hallsym.families.mechanisms import MAINS_HZ, MAINS_REACH_HZ
from hallsym.log.quality.runs import FEWEST_SAMPLES

SEGMENT = 64
"""Samples over which the memory of a residual is added up: half of what a spectrum of it resolves."""
WINDOW = 9
"""Samples of the running median that takes out what changes smoothly: stale stretches of up to 4 stay."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What the residual shows by itself.

    `variance`: of the whitened residual (1: the stated noise). `fast`: the same from second differences.
    `colour`: (SEGMENT,) autocorrelation at lags 0, 1, ... `inflation`: variance of a slow average over that
    of white noise of the same size. `kurtosis`: 3 for Gaussian noise. `values`: different readings of each
    channel among the samples looked at; `adc_step`: (K,) step between them, 0 for none, `step_p`: how likely
    chance makes such steps. `lines_hz`: of hum, one near each frequency of the mains. `instants`: (3, n),
    see `_instants`.
    """

    duration_s: float
    variance: float
    fast: float
    colour: np.ndarray
    inflation: float
    kurtosis: float
    values: tuple[np.ndarray, ...]
    adc_step: np.ndarray
    step_p: float
    lines_hz: tuple[float, ...]
    instants: np.ndarray


@found_once
def survey(base: Base, runs: frozenset[int]) -> Survey:
    """Read the log once and return what the residual of `base` on `runs` shows by itself."""
    K = len(base.model.channels)
    times, rest, readings, instants = [], [np.zeros((K, 0))], [np.zeros((K, 0))], [np.zeros((3, 0))]
    for piece in pieces(base, runs):
        times.append(piece.t)
        rest.append(np.where(piece.used, piece.residual, 0.0))
        readings.append(piece.readings)
        instants.append(_instants(piece))
    squares = np.hstack(rest) ** 2
    variance = _mean(squares)
    colour, inflation = _memory(rest[1:], base.policy)
    values = tuple(map(np.unique, np.hstack(readings)))
    steps = [_step(v, base.policy) for v in values]
    return Survey(
        duration_s=float(times[-1][-1] - times[0][0]) if times else 0.0,
        variance=variance,
        fast=_mean(np.hstack([np.diff(r, 2) for r in rest]) ** 2) / 6,
        colour=colour,
        inflation=inflation,
        kurtosis=_mean(squares**2) / max(variance, NIL) ** 2,
        values=values,
        adc_step=np.array([q for q, _ in steps]),
        step_p=min(1.0, K * min(p for _, p in steps)),  # the channels are as many attempts
        lines_hz=hum(times, rest[1:]),
        instants=np.hstack(instants),
    )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else 1.0


def _memory(rest: Sequence[np.ndarray], policy: Policy) -> tuple[np.ndarray, float]:
    """Return the autocorrelation (SEGMENT,) of blocks (K, n), and the variance of a slow average for it.

    The memory ends where white noise may be as correlated (Bartlett), at 95 %.
    """
    products = np.zeros(SEGMENT)
    for r in rest:
        n = r.shape[1]
        power = np.abs(np.fft.rfft(r - r.mean(axis=1, keepdims=True), 2 * n)) ** 2
        own = np.fft.irfft(power.sum(axis=0), 2 * n)[: min(n, SEGMENT)]
        products[: len(own)] += own
    rho = products / max(products[0], 1e-300)
    chance = np.sqrt(statistic_at(policy.false_alarm, 1) / max(sum(r.size for r in rest), 1))
    end = np.argmax(np.append(rho[1:] < chance, True))
    return rho, max(1.0, 1.0 + 2.0 * float(rho[1 : 1 + end].sum()))


def memory_of_recording(base: Base, runs: frozenset[int]) -> float:
    """Return the samples after which the residual of `base` has forgotten, from run to run.

    It remembers to the last lag at which white noise would hardly be as correlated (Bartlett), all lags
    counted; noise that remembers long may have forgotten earlier. What lies between slices is unknown.
    """
    found = list(pieces(base, runs))
    t = np.concatenate([p.t for p in found])
    step = max(float(np.median(np.diff(t))), 1e-300)
    place = np.round((t - t[0]) / step).astype(int) if base.sliced else np.arange(len(t))
    n = int(place.max()) + 1
    rest = np.hstack([np.where(p.used, p.residual, 0.0) for p in found])
    series, there = np.zeros((len(rest), n)), np.zeros((1, n))
    series[:, place], there[:, place] = rest - rest.mean(axis=1, keepdims=True), 1.0
    lags = np.arange(1, max(2, n // (2 * base.policy.fewest)))
    sums, pairs = (
        np.fft.irfft((np.abs(np.fft.rfft(x, 2 * n)) ** 2).sum(axis=0), 2 * n) for x in (series, there)
    )
    seen = np.maximum(pairs[lags], 1.0) * len(rest)
    rho = sums[lags] / seen / max(float(np.mean(rest**2)), 1e-300)
    chance = np.sqrt(statistic_at(base.policy.false_alarm / len(lags), 1) / seen)
    return float(np.max(lags[np.abs(rho) > chance], initial=0))


def _instants(piece: Piece) -> np.ndarray:
    """Return the time shift that each residual asks for, the speed, and the rest squared: (3, n), whitened.

    What changes smoothly is a gap of the model and not of samples: a running median takes it out.
    """
    quick = piece.residual - median_filter(piece.residual, size=(1, WINDOW), mode="nearest")
    size = np.linalg.norm(piece.speed, axis=0)
    z = (piece.speed * quick).sum(axis=0) / np.maximum(size, 1e-150)
    return np.array([z, size, (quick**2).sum(axis=0) - z**2])


def _step(v: np.ndarray, policy: Policy) -> tuple[float, float]:
    """Step between the ascending values of a channel, 0 for none, and how likely that is by chance.

    Of values without steps a distance is near a whole number of any step with probability 2 TOLERANCE.
    """
    gaps = np.diff(v)
    gaps = gaps[gaps > 1e-13]
    if len(gaps) < FEWEST_SAMPLES:
        return 0.0, 1.0
    q = float(np.quantile(gaps, 0.05))
    q = float(np.median(gaps[gaps < 1.5 * q]))
    whole = np.abs(gaps / q - np.round(gaps / q)) < TOLERANCE
    p = as_often(int(whole.sum()), len(gaps), 2 * TOLERANCE)
    return (q, p) if whole.mean() > 1 - policy.minor else (0.0, p)


# -- hum of the mains ----------------------------------------------------------------------------------------


FINER = 8
"""Frequencies in what a block resolves: power between two of them is a straight line within 0.6 %."""


class Blocks(NamedTuple):
    """Fourier amplitudes of blocks of one length about their middles, (blocks, K, frequencies).

    `middle`: (blocks,) [s], `length` [s], `f` [Hz].
    """

    middle: np.ndarray
    length: float
    f: np.ndarray
    amplitudes: np.ndarray

    def around(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the last own frequency below each of `f`, and how far it is from there to the next."""
        low = np.clip(np.searchsorted(self.f, f) - 1, 0, len(self.f) - 2)
        return low, np.clip((f - self.f[low]) / (self.f[low + 1] - self.f[low]), 0.0, 1.0)

    def power(self, f: np.ndarray) -> np.ndarray:
        """Return the power (f,) of all blocks at some frequencies."""
        low, share = self.around(f)
        at = ((1 - share) * each[:, low] + share * each[:, low + 1] for each in self.amplitudes)
        return np.asarray(sum((np.abs(each) ** 2).sum(axis=0) for each in at) / self.length)

    def together(self, f: np.ndarray, first: float) -> np.ndarray:
        """Return the amplitudes (K, f) of all blocks about the instant `first`, at evenly spaced `f`."""
        shift = self.middle - first
        step = np.exp(-2j * np.pi * np.outer(shift, f[: math.isqrt(len(f)) + 1] - f[0]))
        low, share = self.around(f)
        parts = []
        for start in range(0, len(f), step.shape[1]):
            here = slice(start, start + step.shape[1])
            k, own = np.arange(len(f[here])), low[here] - low[start]
            turned = np.exp(-2j * np.pi * f[start] * shift)[:, None] * step[:, : len(k)]
            knots = self.amplitudes[..., low[start] : low[start] + own[-1] + 2]
            at = np.tensordot(knots, turned, (0, 0))
            parts.append((1 - share[here]) * at[:, own, k] + share[here] * at[:, own + 1, k])
        return np.concatenate(parts, axis=1)


def hum(times: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Return the strongest frequency near each one of the mains; none of blocks too short to tell.

    `times`: (n,) [s] of each block, evenly spaced; `rest`: its residual, (K, n). The power of the blocks
    tells where it is, and their phases where exactly.
    """
    alike: dict[tuple[int, float], list[tuple[np.ndarray, np.ndarray]]] = {}
    for t, r in zip(times, rest, strict=True):
        if len(t) > 2 * FEWEST_SAMPLES:
            alike.setdefault((len(t), float(f"{t[-1] - t[0]:.9g}")), []).append((t, r))
    if not alike:
        return ()
    blocks = [_blocks(*zip(*each, strict=True)) for each in alike.values()]
    longest = max(b.length for b in blocks)
    first, last = min(b.middle[0] for b in blocks), max(b.middle[-1] for b in blocks)
    span = max(last - first, longest)
    out = []
    for hz in MAINS_HZ:
        f = hz + np.arange(-MAINS_REACH_HZ, MAINS_REACH_HZ, 0.5 / longest)
        f = f[np.argmax(sum(b.power(f) for b in blocks))]
        f = f + np.arange(-0.5 / longest, 0.5 / longest, 0.25 / span)
        amplitudes = sum(b.together(f, first) for b in blocks)
        out.append(float(f[np.argmax((np.abs(amplitudes) ** 2).sum(axis=0))]))
    return tuple(out)


def _blocks(times: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> Blocks:
    """Differences of neighbouring samples are taken: what changes slowly has no power there."""
    t, x = np.array(times), np.diff(rest)
    n, length = x.shape[-1], t[0, -1] - t[0, 0]
    ends = [FINER * length * (hz + np.array([-MAINS_REACH_HZ, MAINS_REACH_HZ])) for hz in MAINS_HZ]
    lines = np.concatenate([np.arange(int(low), int(high) + 2) for low, high in ends])
    spectrum = [np.fft.fft(each, FINER * n)[:, lines % (FINER * n)] for each in x]  # too slow: an alias
    middle, f = 0.5 * (t[:, 1] + t[:, -1]), lines / (FINER * length)
    return Blocks(middle, length, f, spectrum * np.exp(2j * np.pi * np.outer(middle - t[:, 1], f))[:, None])
