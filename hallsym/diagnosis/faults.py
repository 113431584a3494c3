"""Faults of samples, which no model equation describes: spikes, stale samples, jitter, steps of values.

They are tested on the residual of the best model. The cost of each is the decrease of the gap without it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import factorial, pi, tau

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import brentq
from scipy.special import chdtrc, fdtrc, fdtri, gammainc, stdtr

from hallsym.diagnosis.p_values import as_often, beyond, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Estimate
from hallsym.diagnosis.residual_table import sums
from hallsym.diagnosis.residuals import NIL, Base, pieces
from hallsym.diagnosis.survey import TOLERANCE, WINDOW, Survey
from hallsym.diagnosis.words import shown
from hallsym.estimation.decoding import residuals
from hallsym.estimation.factors import pseudo_inverse
from hallsym.families.cordic import CHIP_STEPS, Levels, levels
from hallsym.families.faults import FAULTS, RecordingFault
from hallsym.log import Block, Log
from hallsym.log.batches import CACHED_ROWS, Weigh
from hallsym.log.quality.scan import FEWEST_SAMPLES


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of samples: `power` is its share of the whitened residual's variance, `p_value` uncorrected."""

    name: str
    text: str
    power: float
    parameters: dict[str, Estimate]
    p_value: float

    @property
    def record(self) -> RecordingFault:
        """The record of this fault."""
        return FAULTS[self.name]


def faults(base: Base, found: Survey, tested: int) -> list[Fault]:
    """Return the faults that `found`, a survey of all samples, shows, largest first.

    Each must be certain after correction for all that was `tested`.
    """

    def certain(fault: Fault | None) -> bool:
        return fault is not None and fault.p_value * tested < base.policy.certain

    # of single samples the largest: a few spikes beside jitter do not cause its scatter
    first = max(filter(certain, of_samples(found, base.policy)), key=lambda f: f.power, default=None)
    chip = _chip(base, found)
    out = [f for f in (first, chip, _steps(base, found, chip)) if f is not None and certain(f)]
    return sorted(out, key=lambda f: -f.power)


def of_samples(found: Survey, policy: Policy) -> Iterator[Fault]:
    """Yield faults of single samples, by precedence, each with its uncorrected p-value.

    The residual is split into the part that a time shift explains (z) and the rest, each into body and tail.
    The body is measured by quartiles, which are robust to rare samples: its growth with speed is jitter. The
    excess of the mean square is the tail: late samples, or spikes. The number of either is compared with the
    number expected from the body, that of late samples also with that of early ones: noise has both, however
    heavy its tails.
    """
    (z, size, rest), K = found.instants, len(found.adc_step)
    n, bins, across = len(z), 2 * policy.fewest, max(K - 1, 1)
    if n < bins * FEWEST_SAMPLES:
        return

    def fault(name: str, text: str, power: float, p: float, size: Estimate) -> Fault:
        of = "share" if size.unit == "1" else "jitter"
        return Fault(name, text, power / K / max(found.variance, NIL), {of: size}, p)

    white, beside = _filtered(1), _filtered(across)
    body, slope, error = _growth(z, size, bins, float(np.quantile(white, 0.75)))
    growth = max(slope, 0.0)
    expected = float(white.mean()) * np.maximum(body + growth * size**2, NIL)
    quiet = max(float(np.median(rest) / np.median(beside)), NIL)
    limit, far_z = quiet * far_from(across, n, policy), far_from(1, n, policy)
    spikes = rest > limit
    late = (z**2 > far_z * expected) & ~spikes
    far = spikes | late
    near = np.convolve(far, np.ones(2 * WINDOW + 1), "same") > WINDOW
    if far.any() and (far & near).sum() < policy.half * far.sum():  # each by itself
        of_spikes = float((rest[spikes] + z[spikes] ** 2).sum()) / n
        of_late = max(float(np.mean(np.where(spikes, 0.0, z**2 - expected))), 0.0) if late.any() else 0.0
        tail, share = of_spikes + of_late, 100 * float(spikes.mean())
        early, old = (late & (z * sign > 0) for sign in (-1, 1))
        # a late sample is off along the motion only, and never early: as many early as late ones are spikes
        balanced = 2 * min(float((z[side] ** 2).sum()) for side in (early, old)) / n
        if of_spikes + balanced > policy.half * tail:
            p = _as_many(spikes, exceeds(rest, across, limit, beside), policy)
            text = f"{share:.2g} % of the samples are spikes"
            yield fault("outliers", text, tail, p, Estimate(share / 100, None, "1"))
        share, sides = 100 * float(late.mean()), (_events(early), _events(old))
        if (signs := 2 * as_often(max(sides), sum(sides), 0.5)) < policy.false_alarm:
            # their number does not depend on their signs, so Fisher's combination is of both
            many = max(_as_many(late, exceeds(z**2 / expected, 1, far_z, white), policy), 1e-300)
            p = float(chdtrc(4, -2 * np.log(signs * many)))
            text = f"{share:.2g} % of the samples are old"
            yield fault("dropped_samples", text, tail, p, Estimate(share / 100, None, "1"))
    if z[1:] @ z[:-1] < policy.smooth * (z @ z):
        rms, power = float(np.sqrt(growth)), growth * float(np.mean(size**2))
        p = float(stdtr(bins - 2, -slope / max(error, 1e-300)))
        text = f"sampling instants scatter by {1e6 * rms:.3g} us rms"
        yield fault("clock_jitter", text, power, p, Estimate(rms, None, "s"))


def exceeds(values: np.ndarray, freedom: int, limit: float, white: np.ndarray) -> float:
    """Return the probability that one of `values` exceeds `limit`, extrapolated from their body.

    `values`: (n,) squared distances with `freedom` directions; `white`: the same of white noise of variance 1
    that went the same way. Median and upper 5 % (the upper end of its 95 % interval) give the scale and the
    weight of the tails of an F distribution (noise of Student's t), so that noise with heavy tails is
    expected to exceed often.
    """
    ends = 0.5, 0.95 + 1.96 * np.sqrt(0.05 * 0.95 / len(values))
    middle, high = np.quantile(values, np.minimum(ends, 1.0)) / np.quantile(white, [0.5, 0.95])
    if middle <= 0.0:
        return 1.0
    middle, high = middle * statistic_at(0.5, freedom), high * statistic_at(0.05, freedom)

    def heavier(logarithm: float) -> float:
        weight = 10.0**logarithm
        return float(fdtri(freedom, weight, 0.95) / fdtri(freedom, weight, 0.5) - high / middle)

    lightest, heaviest = 4.0, 0.0
    if heavier(lightest) >= 0.0:
        return float(chdtrc(freedom, limit * statistic_at(0.5, freedom) / float(middle)))
    weight = 10.0 ** (brentq(heavier, heaviest, lightest) if heavier(heaviest) > 0.0 else heaviest)
    return float(fdtrc(freedom, weight, limit * float(fdtri(freedom, weight, 0.5)) / float(middle)))


def far_from(freedom: int, samples: int, policy: Policy) -> float:
    """Return the chi-square of a sample that is far: none of so many Gaussian samples exceeds it."""
    return statistic_at(policy.certain / samples, freedom)


@cache
def _filtered(directions: int) -> np.ndarray:
    """Squares that the running median leaves of white noise in so many directions, summed over them."""
    white = np.random.default_rng(0).standard_normal((directions, CACHED_ROWS // directions))
    return np.asarray(((white - median_filter(white, size=(1, WINDOW))) ** 2).sum(axis=0))


def _events(far: np.ndarray) -> int:
    """Count groups of neighbouring samples: an event of several samples counts once."""
    return int(np.count_nonzero(np.diff(far.astype(int), prepend=0) > 0))


def _as_many(far: np.ndarray, chance: float, policy: Policy) -> float:
    """Return the probability (Poisson) of as many events as `far` has, of a `chance` at each sample."""
    return float(gammainc(_events(far), max(policy.tails * chance * len(far), 1e-300)))


def _growth(z: np.ndarray, size: np.ndarray, bins: int, quartile: float) -> tuple[float, float, float]:
    """Variance of z at rest, its growth with size^2 and the error of that, from quartiles in bins of speed.

    `quartile`: of z^2 at unit variance. The error is the scatter of the bins about the line.
    """
    parts = np.array_split(np.argsort(size), bins)
    x = np.array([np.mean(size[b] ** 2) for b in parts])
    y = np.array([np.quantile(z[b] ** 2, 0.75) for b in parts]) / quartile
    weight = 1 / np.maximum(y, NIL)  # the error of a quartile grows with it
    A = np.column_stack([np.ones(bins), x]) * weight[:, None]
    covariance = pseudo_inverse(A.T @ A)
    body, slope = covariance @ A.T @ (y * weight)
    scatter = float(((y * weight - A @ [body, slope]) ** 2).sum()) / (bins - 2)
    return float(body), float(slope), float(np.sqrt(covariance[1, 1] * scatter))


def _steps(base: Base, found: Survey, chip: Fault | None) -> Fault | None:
    """The fault that readings come in steps."""
    steps = found.adc_step
    # a chip's levels are nearly as even as steps; they are reported as levels of the chip
    half = base.policy.half
    if not steps.any() or (chip and steps.max() > half * chip.parameters["distance"].value):
        return None
    power = float(np.diag(np.linalg.inv(base.covariance)) @ steps**2) / 12 / len(steps) / found.variance
    if power * half > 1:  # no rounding: readings as even as their knots
        return None
    sized = list(zip(base.model.channels, steps.tolist(), strict=True))
    units = {c: c.rpartition("_")[2] for c, _ in sized}
    widest, step = max(sized, key=lambda one: one[1])
    return Fault(
        "adc_quantisation",
        f"readings come in steps of {shown(step, units[widest])}",
        power,
        {f"step_{c}": Estimate(q, None, units[c].replace("v", "V")) for c, q in sized},
        found.step_p,
    )


def _chip(base: Base, found: Survey) -> Fault | None:
    """The fault that a decoded angle takes only values that few steps of CORDIC give."""
    if base.model.channels != base.model.pose or found.values is None:
        return None
    sigma = float(np.sqrt(base.covariance[0, 0]))
    spread, step = sigma * float(np.sqrt(found.variance)), float(found.adc_step[0])
    seen = cordic(found.values, base.policy, spread, step)
    if seen is None:
        return None
    chip, p = seen
    fine = {
        "steps": Estimate(float(chip.steps), None, "1"),
        "distance": Estimate(chip.distance, None, "rad"),
        "error": Estimate(chip.rms, None, "rad"),
    }
    many, worst = 2 * len(chip.angles), np.degrees(chip.worst)
    text = f"{chip.steps} steps of CORDIC: {many} angles a turn, up to {worst:.2g} deg off"
    power = (chip.rms / sigma) ** 2 / found.variance
    return Fault("cordic_steps", text, power, fine, p)


# -- few steps of CORDIC: a decoded angle takes certain values only ------------------------------------------


def cordic(
    values: np.ndarray, policy: Policy, spread: float, step: float = 0.0
) -> tuple[Levels, float] | None:
    """Return the fewest steps of CORDIC that explain the distinct `values` [rad] of an angle, None for none.

    With them, how likely it is that as many values are levels of any that were tried.

    The zero register of a chip may shift all of them by any angle. `spread`: rms of the residual [rad].
    `step`: equal steps between the values, if any: levels at a distance of less than two steps look like
    rounding and are not searched. Nor are levels that equal steps of some size fit better: rounding, or a
    stepper.
    """
    v = np.unique(np.round(np.mod(values, tau) / NIL)) * NIL
    tried = [
        k
        for k in map(levels, CHIP_STEPS)
        if k.rms**2 > policy.negligible * spread**2
        and (1 - policy.minor) * len(v) <= 4 * len(k.angles)  # rounded to counts a level has two at most
        and not 2 * TOLERANCE < step / k.distance < 1 - TOLERANCE
    ]
    for k in tried:
        near, off, bins = _hits(v, k)
        p = min(1.0, as_often(near, len(v), 2 * TOLERANCE) * bins * len(tried))
        if near >= (1 - policy.minor) * len(v) and p < 1.0 and off < _off_even(v, k.distance, bins):
            return k, p
    return None


def _hits(v: np.ndarray, k: Levels) -> tuple[int, float, int]:
    """Values near a level at the best offset, their rms distance [rad], and how many offsets were tried."""
    bins = int(2 ** np.ceil(np.log2(tau / (TOLERANCE**2 * k.distance))))
    width, reach = tau / bins, TOLERANCE * k.distance
    at = np.sort(np.mod(np.concatenate([k.angles, k.angles + pi]), tau))  # all of a turn
    centres = (np.arange(bins) + 0.5) * width
    cost = np.minimum(_distance(centres, at) ** 2, reach**2)
    total = np.fft.irfft(np.fft.rfft(_held(v, bins)) * np.conj(np.fft.rfft(cost)), bins)
    best = float(np.argmin(total)) * width
    for _ in range(2):  # offsets between those tried
        off = _distance(np.mod(v - best, tau), at)
        near = np.abs(off) <= reach
        if not near.any():
            return 0, reach, bins
        best -= float(np.median(off[near]))
    return int(near.sum()), float(np.sqrt(np.mean(off[near] ** 2))), bins


def _off_even(v: np.ndarray, distance: float, bins: int) -> float:
    """Rms distance of the values from the equal steps that suit them best, `distance` or more [rad]."""
    waves = np.arange(bins + 1) / 2  # per turn; the steps need not divide it
    size = np.abs(np.fft.rfft(_held(v, bins), 2 * bins))
    asked = (waves >= 4) & (waves <= tau / ((1 - TOLERANCE) * distance))
    best = float(waves[asked][np.argmax(size[asked])])
    near = best + np.linspace(-0.5, 0.5, 51)
    length = np.abs(np.exp(1j * np.outer(near, v)).mean(axis=1))
    at = int(np.argmax(length))
    return float(np.sqrt(max(-2 * np.log(max(length[at], 1e-300)), 0.0)) / near[at])


def _held(v: np.ndarray, bins: int) -> np.ndarray:
    return np.bincount((v / tau * bins).astype(int) % bins, minlength=bins).astype(float)


def _distance(angles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Signed distance of each angle within a turn from the nearest of `at`."""
    round_ = np.concatenate([at[-1:] - tau, at, at[:1] + tau])
    after = np.clip(np.searchsorted(round_, angles), 1, len(round_) - 1)
    above, below = round_[after] - angles, round_[after - 1] - angles
    return np.where(above < -below, above, below)


# -- repairs -------------------------------------------------------------------------------------------------


def without_tail(base: Base) -> Weigh:
    """Return weights 0 for samples far off the model, in addition to those left out already.

    Of those left out in a block at most `Policy.false_alarm` are expected to be noise (Benjamini and Hochberg
    1995): a limit that no sample of noise exceeds would keep most spikes of a few standard deviations.
    """
    residual = residuals(base.model, base.p, base.offsets)
    whiten, K, level = base.whiten, len(base.model.channels), base.policy.false_alarm

    def weigh(block: Block) -> np.ndarray:
        distance = ((whiten @ residual(block)) ** 2).sum(axis=0)
        typical = max(float(np.median(distance)) / statistic_at(0.5, K), base.policy.half)
        p = chdtrc(K, distance / typical)
        allowed = level * np.arange(1, len(p) + 1) / max(len(p), 1)
        within = np.sort(p) <= allowed
        near = (p > allowed[within].max(initial=0.0)).astype(float)
        return near if base.keep is None else near * base.keep(block)

    return weigh


def assignments(channels: int) -> int:
    """Return how many other orders and signs of the channels were compared with the nominal ones."""
    return factorial(channels) * 2**channels - 1


def assignment_p(base: Base, log: Log, runs: Sequence[int]) -> float:
    """Return the p-value, over `runs`, of the nominal channel assignment of the readings of `log`.

    `base` holds the log with corrected assignment. The score of a run is the product of the change of its
    readings by the correction with their residual before it; its noise, the product with the residual after.
    """
    wanted, whiten, found = frozenset(runs), base.whiten, []
    for now, was in zip(pieces(base, wanted), pieces(replace(base, log=log), wanted), strict=True):
        moved = (whiten @ (was.readings - now.readings)) * now.used
        found.append((now.run, (moved * was.residual).sum(), (moved * now.residual).sum()))
    run, score, noise = np.array(found).T
    return beyond(sums(score, run), sums(noise, run))
