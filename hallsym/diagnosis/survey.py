"""Survey of a residual: memory, spectrum, and faults of samples (spikes, jitter, old samples, ADC steps).

One pass over the log, block by block. No model holds these findings (an outlier has no equation), or they
are numbers from which effects are searched (a mains frequency).
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.p_values import as_many, as_often, chance, exceeds, statistic_at, student
from hallsym.diagnosis.residuals import Base, Piece, found_once, pieces
from hallsym.estimation import pseudo_inverse
from hallsym.log.quality.runs import FEWEST_SAMPLES

MAINS = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""
MAINS_BAND = 4.0
"""Distance from these up to which a line is looked for [Hz]."""
FINE = 0.125
"""Distance of the frequencies that are tried there [Hz]: half of what runs of 4 s resolve."""
SEGMENT = 64
"""Samples between instants at which a slip is looked for; over which the memory of a residual is added up."""
ENOUGH = 1_000_000
"""Samples that are looked at one by one; of a longer log every 64th block beyond."""
UNCORRELATED = 0.02
"""Autocorrelation below which the residual's memory ends."""
KNOWN_VALUES = 20_000
"""Different readings of a channel that are kept; some more, as a block is added whole."""
FEWEST = 200
"""Samples from which on faults of single ones are judged."""
WAVE_BLOCKS, WAVE_SAMPLES, WAVE_DEGREE = 256, 16, 6
"""Blocks that mains lines are looked for in, samples that each must have, and the number of coefficients of
the polynomial that is taken out of each."""
FAR, QUIETEST = 40.0, 0.25
"""Square of a sample over the median, and the least median, from which on it is far from the others."""
WINDOW = 9
"""Samples of the running median that takes out what changes smoothly: stale stretches of up to 4 stay."""
FILTERED, FILTERED_QUARTILE = 0.945, 0.917
"""What a running median of 9 leaves of white noise: mean square and upper quartile of squares, simulated."""
SPIKE = 6.0
"""Standard deviations beyond which a sample counts as a spike: 2e-9 of Gaussian samples do.

That it is more than the noise's own tails is tested beside it."""
QUARTILE_ERROR = 2.4
"""Standard error of that quartile, over the quartile, of one sample: 2.4 / sqrt(n) of n."""
BINS = 12
"""Bins of speed in which the scatter of the samples is measured, each of as many samples."""
WHOLE, MOSTLY = 0.02, 0.9
"""How near to whole, in steps, the distance of two readings must be, and how many of them, for ADC steps."""


@dataclass(eq=False)
class Survey:
    """Sums over the log; `finish` turns them into findings.

    The p-values of samples say how likely noise alone shows as much, each fault by itself: `spike_p` and
    `stale_p` by how many samples are far off against what the body of the noise makes expect (stale ones also
    by how many are late rather than early), `jitter_p` by the growth of the residual with speed, `step_p` by
    how many distances of neighbouring readings are whole steps.

    `inflation`: variance of a slow average of the residual over that of white noise of the same size.
    `variance`: of the whitened residual (1: the stated noise). `fast`: the same from second differences.
    `colour`: autocorrelation of the residual at lags 0, 1, ...
    `jitter_s`: rms sampling-instant error that explains residual growing with speed. `stale_share`,
    `spike_share`: share of samples, `smooth` the correlation of neighbouring time shifts (0 for jitter),
    `bursts` the share of spikes and stale samples that are within one of many. `adc_step`: (K,) step seen, 0
    for none, among `values`, different readings of each channel (20 000 or little more). `lines_hz`: mains
    lines.
    """

    duration_s: float = 0.0
    variance: float = 1.0
    fast: float = 1.0
    colour: np.ndarray = field(default_factory=lambda: np.array([1.0, 0.0]))
    inflation: float = 1.0
    jitter_s: float = 0.0
    jitter_power: float = 0.0
    stale_share: float = 0.0
    stale_power: float = 0.0
    spike_share: float = 0.0
    spike_power: float = 0.0
    smooth: float = 0.0
    bursts: float = 0.0
    adc_step: np.ndarray = field(default_factory=lambda: np.zeros(0))
    values: tuple[np.ndarray, ...] = ()
    lines_hz: tuple[float, ...] = ()
    spike_p: float = 1.0
    stale_p: float = 1.0
    jitter_p: float = 1.0
    step_p: float = 1.0


@found_once
def survey(base: Base, runs: frozenset[int]) -> Survey:
    """Read the log once and return what the residual of `base` on `runs` shows by itself."""
    work = _Work(len(base.model.channels))
    for piece in pieces(base, runs):
        work.add(piece)
    return work.finish()


class _Work:
    def __init__(self, channels: int) -> None:
        self.K = channels
        self.found = Survey()
        self.squares = self.differences = 0.0
        self.correlation = np.zeros(SEGMENT)
        self.shift: list[np.ndarray] = []
        self.spectra: list[tuple[float, float, np.ndarray]] = []
        self.values: list[set[float]] = [set() for _ in range(channels)]
        self.largest: list[np.ndarray] = []
        self.count = self.seen = self.skipped = 0
        self.wave: list[tuple[np.ndarray, np.ndarray]] = []
        self.neighbours, self.crowd = np.zeros(2), np.zeros(2)
        self.first: float | None = None

    def add(self, piece: Piece) -> None:
        f = self.found
        r = np.where(piece.used, piece.residual, 0.0)
        n = len(piece.t)
        if self.first is None:
            self.first = float(piece.t[0])
        f.duration_s = float(piece.t[-1]) - self.first
        self.count += n
        self.squares += float((r**2).sum())
        if n > 8:
            second = r[:, 2:] - 2 * r[:, 1:-1] + r[:, :-2]
            self.differences += float((second**2).sum()) / 6 * n / (n - 2)
            self._correlate(r)
            self._spectrum(piece.t, r)
        self._instants(piece)
        for k in range(self.K):
            if len(self.values[k]) < KNOWN_VALUES:
                self.values[k].update(piece.readings[k].tolist())

    def _correlate(self, r: np.ndarray) -> None:
        n = r.shape[1]
        x = r - r.mean(axis=1, keepdims=True)
        spectrum = np.abs(np.fft.rfft(x, 2 * n, axis=1)) ** 2
        products = np.fft.irfft(spectrum, axis=1)[:, :SEGMENT].sum(axis=0)
        self.correlation[: len(products)] += products

    def _spectrum(self, t: np.ndarray, r: np.ndarray) -> None:
        """Fourier amplitudes of the mains bands, kept per block with its middle time (blocks <= 8192)."""
        middle = 0.5 * (t[0] + t[-1])
        if len(t) < WAVE_SAMPLES or len(self.spectra) >= WAVE_BLOCKS:
            return
        x = np.arange(len(t)) / len(t) - 0.5
        basis = np.linalg.qr(np.vander(x, WAVE_DEGREE))[0]
        smooth = r - (r @ basis) @ basis.T
        bands = [_waves(hz - MAINS_BAND, FINE, round(2 * MAINS_BAND / FINE), t - middle) for hz in MAINS]
        self.spectra.append((middle, len(t), smooth @ np.vstack(bands).T))
        self.wave.append((t, smooth))

    def _instants(self, piece: Piece) -> None:
        """Time shift of each sample that its residual asks for, in standard deviations.

        What changes smoothly is a gap of the model and not of samples: a running median takes it out.
        """
        if self.seen > ENOUGH:
            self.skipped = (self.skipped + 1) % 64
            if self.skipped:
                return
        self.seen += len(piece.t)
        quick = piece.residual - median_filter(piece.residual, size=(1, WINDOW), mode="nearest")
        information = np.einsum("ks,ks->s", piece.speed, piece.speed)
        along = np.einsum("ks,ks->s", piece.speed, quick)
        size = np.sqrt(np.maximum(information, 1e-300))
        z = along / size
        rest = np.einsum("ks,ks->s", quick, quick) - z**2
        if len(z) > 1:
            self.neighbours += np.array([float(z[1:] @ z[:-1]), float(z @ z) * (len(z) - 1) / len(z)])
        far = np.any([x > FAR * max(np.median(x), QUIETEST) for x in (rest, z**2)], axis=0)
        if far.any() and len(far) > 2 * WINDOW:
            near = np.convolve(far, np.ones(2 * WINDOW + 1), "same") > WINDOW
            self.crowd += np.array([float((far & near).sum()), float(far.sum())])
        self.shift.append(np.array([z, size, rest, piece.used]))

    def finish(self) -> Survey:
        f = self.found
        total = max(self.count * self.K, 1)
        f.variance, f.fast = self.squares / total, self.differences / total
        rho = self.correlation / max(self.correlation[0], 1e-300)
        stop = next((k for k in range(1, SEGMENT) if rho[k] < UNCORRELATED), SEGMENT)
        f.inflation = float(max(1.0, 1.0 + 2.0 * rho[1:stop].sum()))
        f.colour = rho if self.correlation[0] > 0 else f.colour
        if self.shift:
            self._judge_instants()
        f.values = tuple(np.sort(np.fromiter(v, float)) for v in self.values)
        steps = [_step(v) for v in f.values]
        f.adc_step = np.array([q for q, _ in steps])
        # the channels are as many attempts
        f.step_p = min(1.0, self.K * min((p for _, p in steps), default=1.0))
        self._judge_lines()
        return f

    def _judge_instants(self) -> None:
        """Split the residual into what a time shift explains (z) and the rest, each into body and tail.

        The body is judged by quartiles, which rare samples do not move: its growth with speed is jitter. What
        the mean of squares has beyond that is the tail: samples that are late, or spikes.
        """
        f, (z, size, rest, _) = self.found, np.hstack(self.shift)
        if len(z) < FEWEST:
            return
        body, slope, error = _growth(z, size)
        f.jitter_p = student(slope / max(error, 1e-300), BINS - 2)
        slope = max(slope, 0.0)
        f.jitter_s = float(np.sqrt(slope))
        f.jitter_power = float(slope * np.mean(size**2)) / self.K
        expected = FILTERED * (body + slope * size**2)
        quiet = max(float(np.median(rest)) / statistic_at(0.5, max(self.K - 1, 1)), QUIETEST)
        limit = statistic_at(chance(SPIKE**2, 1), max(self.K - 1, 1))  # as rare in as many directions
        spikes = rest > quiet * limit
        late = (z**2 > SPIKE**2 * expected) & ~spikes
        f.smooth = float(self.neighbours[0] / max(self.neighbours[1], 1e-300))
        f.bursts = float(self.crowd[0] / max(self.crowd[1], 1.0))
        f.spike_share, f.stale_share = float(spikes.mean()), float(late.mean())
        tail_z = max(0.0, float(np.mean(np.where(spikes, 0.0, z**2 - expected))))
        f.spike_power = float((rest[spikes] + z[spikes] ** 2).sum()) / (len(z) * self.K)
        f.stale_power = tail_z / self.K if late.any() else 0.0
        one_sided = float(np.sign(z[late]).mean()) if late.any() else 0.0
        far = exceeds(rest, max(self.K - 1, 1), quiet * limit)
        f.spike_p = as_many(_events(spikes), far * len(rest))
        relative = z**2 / expected
        far, events = exceeds(relative, 1, SPIKE**2), _events(late)
        sides = round(0.5 * (1 + abs(one_sided)) * events)
        f.stale_p = max(as_many(events, far * len(z)), min(1.0, 2 * as_often(sides, events, 0.5)))

    def _judge_lines(self) -> None:
        f = self.found
        if not self.spectra:
            return
        around = np.arange(-MAINS_BAND, MAINS_BAND, FINE)
        power = sum((np.abs(a) ** 2).sum(axis=0) / n for _, n, a in self.spectra)
        parts = np.split(power, len(MAINS))
        f.lines_hz = tuple(
            self._refined(float(hz + around[np.argmax(part)]))[0]
            for hz, part in zip(MAINS, parts, strict=True)
        )

    def _refined(self, peak: float) -> tuple[float, float]:
        """Frequency at which all blocks are in phase, near the peak of their mean power."""
        times = np.array([m for m, _, _ in self.spectra])
        total = sum(n for _, n, _ in self.spectra)
        longest = max(t[-1] - t[0] for t, _ in self.wave) or 1.0
        span = max(times[-1] - times[0], longest)
        best = (peak, -1.0)
        offsets = np.arange(-0.07 / longest, 0.07 / longest, 0.2 / span)
        step = 0.125 / longest
        each = [
            s @ _waves(peak - 4 * step, step, 9, t - m).T for (t, s), m in zip(self.wave, times, strict=True)
        ]
        for j, amplitudes in enumerate(np.array(each).transpose(2, 0, 1)):
            centre = peak + (j - 4) * step
            turn = np.exp(-2j * np.pi * np.outer(centre + offsets, times - times[0]))
            together = (np.abs(turn @ amplitudes) ** 2).sum(axis=1) / total
            k = int(np.argmax(together))
            if together[k] > best[1]:
                best = (float(centre + offsets[k]), float(together[k]))
        return best


def _waves(first: float, step: float, count: int, t: np.ndarray) -> np.ndarray:
    """Complex waves exp(-2 pi i f t) of `count` evenly spaced frequencies, (count, samples)."""
    out = np.empty((count, len(t)), dtype=complex)
    out[0] = np.exp(-2j * np.pi * first * t)
    out[1:] = np.exp(-2j * np.pi * step * t)
    return np.multiply.accumulate(out, axis=0)


def _events(far: np.ndarray) -> int:
    """Count groups of neighbouring samples: what lasts for several samples happened once."""
    return int(far[0]) + int((far[1:] & ~far[:-1]).sum()) if len(far) else 0


def _growth(z: np.ndarray, size: np.ndarray) -> tuple[float, float, float]:
    """Variance of z at rest, its growth with size^2 and the error of that, from quartiles in bins.

    The error is at least what white Gaussian noise makes, and what the bins scatter by about the line.
    """
    order = np.argsort(size)
    bins = np.array_split(order, BINS)
    x = np.array([np.mean(size[b] ** 2) for b in bins])
    y = np.array([np.quantile(z[b] ** 2, 0.75) for b in bins]) / (statistic_at(0.25, 1) * FILTERED_QUARTILE)
    error = np.maximum(y, 0.3) * QUARTILE_ERROR / np.sqrt([len(b) for b in bins])
    A = np.column_stack([np.ones(len(x)), x]) / error[:, None]
    covariance = pseudo_inverse(A.T @ A)
    body, slope = covariance @ A.T @ (y / error)
    scatter = float(((y / error - A @ [body, slope]) ** 2).sum()) / (BINS - 2)
    spread = float(np.sqrt(covariance[1, 1] * max(scatter, 1.0)))
    return float(np.clip(body, 0.2, None)), float(slope), spread


def _step(v: np.ndarray) -> tuple[float, float]:
    """Step between the ascending values of a channel, 0 for none, and how likely that is by chance.

    Of values without steps a distance is near a whole number of any step with probability 2 WHOLE.
    """
    gaps = np.diff(v)
    gaps = gaps[gaps > 1e-13]
    if len(gaps) < FEWEST_SAMPLES:
        return 0.0, 1.0
    q = float(np.quantile(gaps, 0.05))
    near = gaps[gaps < 1.5 * q]
    q = float(np.median(near))
    ratio = gaps / q
    whole = np.abs(ratio - np.round(ratio)) < WHOLE
    p = as_often(int(whole.sum()), len(gaps), 2 * WHOLE)
    return (q, p) if whole.mean() > MOSTLY else (0.0, p)
