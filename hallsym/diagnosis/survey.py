"""Survey of a residual: its autocorrelation and spectrum, hum of the mains, single samples.

These findings have no model equation (an outlier), or they are starting values of effects (a mains
frequency).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, next_fast_len
from scipy.linalg import solve_toeplitz
from scipy.ndimage import median_filter

from hallsym.diagnosis.p_values import as_often, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residuals import NIL, Base, Piece, found_once, pieces
from hallsym.estimation.goodness_of_fit import ResidualNoise, noise_left
from hallsym.families.mechanisms import MAINS_HZ, MAINS_REACH_HZ
from hallsym.log.quality.scan import FEWEST_SAMPLES

SEGMENT = 64
"""Lags over which the autocorrelation of a residual is summed: half of a spectral segment."""
WINDOW = 9
"""Samples of the running median that removes smooth changes: stale stretches of up to 4 stay."""
TOLERANCE = 0.25
"""Largest distance of a value from its level, over the spacing of the levels.

It allows for rounding to counts of half that spacing; half of all values would be as near by chance."""
ORDER = 20
"""Lags of the autoregression: a resonance, and the beginning of 1/f noise within a run."""
LEAST = 1e-9
"""Least p-value by the spectrum: the tails of real noise are unknown so far out."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Statistics of the residual alone.

    `variance`: of the whitened residual (1: the stated noise). `fast`: the same from second differences.
    `autocorrelation`: (SEGMENT,) at lags 0, 1, ... `inflation`: variance of a slow average
    over that of white noise of the same size. `kurtosis`: 3 for Gaussian noise. `values`: different readings
    among the samples looked at, if there is one channel; `adc_step`: (K,) step between those of each channel,
    0 for none, `step_p`: how likely chance makes such steps. `lines_hz`: of hum, one near each frequency of
    the mains. `instants`: (3, n), see `_instants`.
    """

    duration_s: float
    variance: float
    fast: float
    autocorrelation: np.ndarray
    inflation: float
    kurtosis: float
    values: np.ndarray | None
    adc_step: np.ndarray
    step_p: float
    lines_hz: tuple[float, ...]
    instants: np.ndarray


@found_once
def survey(base: Base, runs: frozenset[int]) -> Survey:
    """Read the log once and return the statistics of the residual of `base` on `runs`."""
    K = len(base.model.channels)
    times, rest, readings, moved = [], list[np.ndarray](), [np.zeros((K, 0))], [np.zeros((3, 0))]
    for piece in pieces(base, runs):
        times.append(piece.t)
        rest.append(np.where(piece.used, piece.residual, 0.0))
        readings.append(piece.readings)
        moved.append(_instants(piece))
    instants = np.hstack(moved)
    levels = [np.unique(np.concatenate(own)) for own in zip(*readings, strict=True)]
    moved, readings = [], []  # lists as large as the log
    steps, values = [_step(v, base.policy) for v in levels], levels[0] if K == 1 else None
    del levels
    moments = np.square, lambda r: r**4, lambda r: np.diff(r, 2) ** 2
    variance, fourth, fast = (_mean(rest, moment) for moment in moments)
    autocorrelation, inflation = _memory(rest, base.policy)
    return Survey(
        duration_s=float(times[-1][-1] - times[0][0]) if times else 0.0,
        variance=variance,
        fast=fast / 6,
        autocorrelation=autocorrelation,
        inflation=inflation,
        kurtosis=fourth / max(variance, NIL) ** 2,
        values=values,
        adc_step=np.array([q for q, _ in steps]),
        step_p=min(1.0, K * min(p for _, p in steps)),  # the channels are as many attempts
        lines_hz=hum(times, rest),
        instants=instants,
    )


def _mean(blocks: Sequence[np.ndarray], of: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the mean of a function of all blocks, 1 without samples."""
    sums = [(float(values.sum()), values.size) for values in map(of, blocks)]
    total, count = np.sum(sums, axis=0) if sums else (0.0, 0)
    return float(total / count) if count else 1.0


def products_at_lags(rows: np.ndarray, lags: int | None = None) -> np.ndarray:
    """Return the sums over rows (K, n) of products of values at lags 0, 1, ... `lags` - 1; of all n."""
    n = rows.shape[1]
    power = (np.abs(np.fft.rfft(rows, 2 * n)) ** 2).sum(axis=0)
    own = np.asarray(np.fft.irfft(power, 2 * n)[: min(n, lags or n)])
    return own if lags is None else np.append(own, np.zeros(lags - len(own)))


def _memory(rest: Sequence[np.ndarray], policy: Policy) -> tuple[np.ndarray, float]:
    """Return the autocorrelation (SEGMENT,) of blocks (K, n), and the variance of a slow average for it.

    It is cut off where white noise may be as correlated (Bartlett), at 95 %.
    """
    centred = (r - r.mean(axis=1, keepdims=True) for r in rest)
    products = sum((products_at_lags(r, SEGMENT) for r in centred), np.zeros(SEGMENT))
    rho = products / max(products[0], 1e-300)
    chance = np.sqrt(statistic_at(policy.false_alarm, 1) / max(sum(r.size for r in rest), 1))
    end = np.argmax(np.append(rho[1:] < chance, True))
    return rho, max(1.0, 1.0 + 2.0 * float(rho[1 : 1 + end].sum()))


def memory_of_recording(base: Base, runs: frozenset[int]) -> float:
    """Return the correlation length of the residual of `base` in samples, across runs.

    It is the last lag at which white noise would hardly be as correlated (Bartlett, corrected for all lags),
    an upper limit for slow noise. Gaps between slices are unknown.
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
    sums, pairs = (products_at_lags(x)[lags] for x in (series, there))
    seen = np.maximum(pairs, 1.0) * len(rest)
    rho = sums / seen / max(float(np.mean(rest**2)), 1e-300)
    chance = np.sqrt(statistic_at(base.policy.false_alarm / len(lags), 1) / seen)
    return float(np.max(lags[np.abs(rho) > chance], initial=0))


def spectrum_peak(base: Base, runs: Iterable[int]) -> float:
    """Return the largest value of the spectrum of the whitened residual: 1 for white noise as assumed.

    No column collects more of the noise, however slow it is. So the squares that a candidate explains are
    compared with chi-square times this value as well: sign flips have no power where one run, or four, carry
    an effect. The spectrum is that of an autoregression of the residual with the best effect, and at one
    period per run, beyond so few lags, the observed one. Effects outside the catalogue stay in it and raise
    it. At least 1, and infinity where tails are too heavy for chi-square.
    """
    rest = [np.where(piece.used, piece.residual, 0.0) for piece in pieces(base, frozenset(runs))]
    count = max(sum(x.size for x in rest), 1)
    products = sum((products_at_lags(x, ORDER + 1) for x in rest), np.zeros(ORDER + 1))
    rho = products / count  # biased, so that it is positive definite
    if not rho[0] > 0 or sum(float((x**4).sum()) for x in rest) / count > base.policy.heavy * rho[0] ** 2:
        return np.inf
    once = ((np.abs(np.fft.fft(x)[:, 1 % x.shape[1]]) ** 2).sum() / x.shape[1] for x in rest)
    slow = float(sum(once)) / sum(len(x) for x in rest)
    phi = solve_toeplitz(rho[:-1] + NIL * rho[0] * (np.arange(ORDER) == 0), rho[1:])
    turn = np.exp(-1j * np.outer(np.linspace(0, np.pi, 512), np.arange(1, ORDER + 1)))
    fast = float(rho[0] - phi @ rho[1:]) / float((np.abs(1 - turn @ phi) ** 2).min())
    return max(1.0, fast, slow)


def noise_of_rest(base: Base, runs: Sequence[int]) -> ResidualNoise | None:
    """Return the noise that `base` leaves on `runs`, of a long log on its part; None where they are too short
    to tell."""
    base = base.part
    offsets = {run: base.offsets_in(run) for run in (runs if base.timed else base.log.runs)}
    return noise_left(base.log, base.model, base.p, offsets, base.covariance, base.sigma, base.keep)


def _instants(piece: Piece) -> np.ndarray:
    """Return the time shift that explains each residual, the speed, and the rest squared: (3, n), whitened.

    Smooth changes are a gap of the model and not of samples: a running median removes them. The shift is
    along the tangent of the motion, or along a chord where that is nearer: the reading of a sample that is
    late by several samples is off the tangent, but on the path of the expected readings.
    """
    quick = piece.residual - median_filter(piece.residual, size=(1, WINDOW), mode="nearest")
    size = np.linalg.norm(piece.speed, axis=0)
    z = (piece.speed * quick).sum(axis=0) / np.maximum(size, 1e-150)
    rest, reach, n = (quick**2).sum(axis=0) - z**2, WINDOW // 2, quick.shape[1]
    path = np.pad(piece.expected, ((0, 0), (reach, reach)), mode="edge")
    for lag in range(-reach, reach):
        chord = path[:, reach + lag : reach + lag + n] - piece.expected
        step = np.diff(path[:, reach + lag : reach + lag + n + 1])
        share = ((quick - chord) * step).sum(axis=0) / np.maximum((step**2).sum(axis=0), 1e-300)
        chord = chord + share.clip(0.0, 1.0) * step
        left = ((quick - chord) ** 2).sum(axis=0)
        z = np.where(left < rest, np.sign(lag + 0.5) * np.linalg.norm(chord, axis=0), z)
        rest = np.minimum(rest, left)
    return np.array([z, size, rest])


def _step(v: np.ndarray, policy: Policy) -> tuple[float, float]:
    """Step between the ascending values of a channel, 0 for none, and its probability by chance.

    Of values without steps a distance is near a whole number of any step with probability 2 TOLERANCE.
    """
    gaps = np.diff(v)
    gaps = gaps[gaps > 1e-13]
    if len(gaps) < FEWEST_SAMPLES:
        return 0.0, 1.0
    q = float(np.quantile(gaps, 0.05))
    q = float(np.median(gaps[gaps < 1.5 * q]))
    steps = np.round(gaps / q)
    whole = np.abs(gaps / q - steps) < TOLERANCE
    p = as_often(int(whole.sum()), len(gaps), 2 * TOLERANCE)
    if whole.mean() <= 1 - policy.minor:
        return 0.0, p
    return float(gaps[whole].sum() / steps[whole].sum()), p  # also where the log rounds each value


# -- hum of the mains ----------------------------------------------------------------------------------------


def hum(times: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Return the strongest frequency near each one of the mains; none of blocks too short to tell.

    `times`: (n,) [s] of each block, evenly spaced; `rest`: its residual, (K, n). The power of the blocks
    tells where it is, and their phases where exactly. In differences of neighbouring samples slow changes
    have no power.
    """
    known = [(0.5 * (t[1:] + t[:-1]), np.diff(r)) for t, r in zip(times, rest, strict=True)]
    known = [(t, x) for t, x in known if len(t) >= 2 * FEWEST_SAMPLES]
    if not known:
        return ()
    lengths = [t[-1] - t[0] for t, _ in known]
    longest, every, out = max(lengths), np.concatenate([t for t, _ in known]), list[float]()
    whole, span = np.hstack([x for _, x in known]), max(float(np.ptp(every)), longest)
    for hz in MAINS_HZ:
        powers = [_power(t, x, hz, MAINS_REACH_HZ, longest) for t, x in known]
        total = sum(power / length for (_, power), length in zip(powers, lengths, strict=True))
        f, power = _power(every, whole, powers[0][0][np.argmax(total)], 0.5 / longest, span)
        k = int(np.argmax(power))
        low, top, high = (float(power[(k + j) % len(f)]) for j in (-1, 0, 1))
        beside = 0.5 * (high - low) / max(2 * top - low - high, 1e-300)  # of a parabola through the three
        out.append(float(f[k]) + beside * abs(f[1] - f[0]))
    return tuple(out)


def _power(
    t: np.ndarray, x: np.ndarray, centre: float, reach: float, span: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies within `reach` of `centre` [Hz], a quarter of 1 / `span` apart, and the power there.

    Of values x (K, n) at times t: multiplied by a wave of the frequency `centre`, and summed over a 32nd
    of a period of `reach`.
    """
    step = 1 / (32 * reach)
    size = next_fast_len(1 + int(4 * span / step))
    wave, at = np.exp(-2j * np.pi * centre * t), ((t - t[0]) / step).astype(int)
    near = np.arange(-(size // 32), size // 32 + 1)
    power, slow = np.zeros(len(near)), np.empty(size, dtype=complex)
    for values in x:  # one channel at a time: a long recording has a million of those sums
        slow.real = np.bincount(at, values * wave.real, size)
        slow.imag = np.bincount(at, values * wave.imag, size)
        power += np.abs(fft(slow, overwrite_x=True)[near]) ** 2
    return centre + near / (size * step), power
