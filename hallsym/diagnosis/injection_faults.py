"""Faults that can be injected: rails, samples that are wrong, a chip that computes short, wires mixed up."""

from collections.abc import Callable

import numpy as np

from hallsym.diagnosis.effect import Effect
from hallsym.diagnosis.injection import Injection, Noisy, Size
from hallsym.diagnosis.simulated_machine import Truth, goes_round, unit_of
from hallsym.families.cordic import MOST_STEPS, cordic_angle, worst_of
from hallsym.log.phase import wrapped

OUTLIERS = 0.003
"""Share of samples that are spikes."""
HOLD = 3
"""Samples for which a stale reading is held at most."""
FEWEST_STEPS = 4
"""Steps of CORDIC of which an encoder has at least: 7 deg of error."""
MOST_SHARE = 0.3
"""Share of stale or clipped samples beyond which a recording is no longer one."""


def faults(truth: Truth, rng_of: Callable[[str], np.random.Generator]) -> list[Injection]:
    """Return faults of samples, and of the wiring where there are wires."""
    clean, speed = truth.clean, truth.speed
    K, n = clean.shape
    level = float(np.sqrt(np.diag(truth.base.covariance).mean()))
    step = float(np.median(np.diff(truth.columns["t_s"])))
    spikes = rng_of("outliers")
    hit = (spikes.random((K, n)) < OUTLIERS) * spikes.choice([-1.0, 1.0], (K, n))
    old = rng_of("dropped_samples").random((n,))
    length = rng_of("dropped").integers(1, 1 + HOLD, (n,))
    shift = rng_of("clock_jitter").standard_normal((n,))

    def stale(amount: float, noise: Noisy) -> np.ndarray:
        return clean - speed * step * ages(old < amount, length, truth.columns["run"]) + noise

    def adc(amount: float, noise: Noisy) -> np.ndarray:
        return np.round((clean + noise) / amount) * amount

    def one(name: str, unit: str) -> Callable[[float], Size]:
        return lambda amount: {name: (amount, unit)}

    unit, most = unit_of(truth), 1e-2 if unit_of(truth) == "m" else 1.0
    return [
        Injection("outliers", "electronics", f"{100 * OUTLIERS:g} % of the samples",
                  lambda amount, noise: clean + noise + amount * hit, one("spike", unit), most, 10 * level),
        Injection("dropped_samples", "clock", f"held for 1 to {HOLD} samples", stale, one("share", "1"),
                  MOST_SHARE, 0.01),
        Injection("clock_jitter", "clock", "rms of the sampling instants",
                  lambda amount, noise: clean + noise + amount * speed * shift, one("jitter", "s"),
                  10 * step, 0.1 * step),
        Injection("adc_quantisation", "electronics", "one step for all channels", adc, one("step", unit),
                  most / 10, 3 * level),
        *([_chip(truth)] if goes_round(truth) else _wiring(truth, rng_of)),
    ]  # fmt: skip


def rails(truth: Truth, effect: Effect) -> Injection:
    """Return hard clipping; the amount is the share of the samples beyond the rail of each probe."""
    channels = truth.base.model.channels

    def levels(share: float) -> np.ndarray:
        return np.quantile(np.abs(truth.clean), 1 - share, axis=1)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        rail = levels(amount)[:, None]
        return np.clip(truth.clean + noise, -rail, rail)

    def size(amount: float) -> Size:
        return {
            f"rail_{c}": (float(v), unit_of(truth)) for c, v in zip(channels, levels(amount), strict=True)
        }

    return Injection(effect.name, effect.link, "both rails, hard", make, size, MOST_SHARE, 0.03)


def _chip(truth: Truth) -> Injection:
    """An angle computed with whole steps of CORDIC; the amount is its largest error [rad]."""

    def steps(amount: float) -> int:
        """The number whose error is nearest, by ratio."""
        known = range(FEWEST_STEPS, MOST_STEPS + 1)
        return min(known, key=lambda n: abs(float(np.log(worst_of(n) / amount))))

    def make(amount: float, noise: Noisy) -> np.ndarray:
        angle = truth.clean + noise
        return angle + wrapped(cordic_angle(np.sin(angle), np.cos(angle), steps(amount)) - angle, 2 * np.pi)

    def size(amount: float) -> Size:
        return {"steps": (float(steps(amount)), "1"), "error_at_most": (worst_of(steps(amount)), "rad")}

    start = float(np.sqrt(np.diag(truth.base.covariance).mean()))
    most = worst_of(FEWEST_STEPS)
    return Injection("cordic_steps", "electronics", "whole steps", make, size, most, 2 * start)


def _wiring(truth: Truth, rng_of: Callable[[str], np.random.Generator]) -> list[Injection]:
    """Two channels swapped, and one inverted."""
    clean, channels = truth.clean, truth.base.model.channels
    wires = rng_of("wiring")
    a, b = np.sort(wires.choice(len(clean), 2, replace=False)).tolist()
    flipped = int(wires.integers(len(clean)))

    def swap(_: float, noise: Noisy) -> np.ndarray:
        out = clean + noise
        out[[a, b]] = out[[b, a]]
        return out

    def invert(_: float, noise: Noisy) -> np.ndarray:
        out = clean + noise
        out[flipped] *= -1
        return out

    return [
        Injection("channel_swap", "electronics", f"{channels[a]} and {channels[b]}", swap, lambda _: {}, 1.0,
                  sized=False),
        Injection("sign_inversion", "electronics", channels[flipped], invert, lambda _: {}, 1.0,
                  sized=False),
    ]  # fmt: skip


def ages(begins: np.ndarray, length: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the age in samples of each reading: 0 fresh; after a begin it grows until the hold ends."""
    age = np.zeros(len(begins))
    for k in np.flatnonzero(begins):
        n = int(length[k])
        last = min(int(k) + n, len(age))
        aged = np.arange(1, n + 1)[: last - int(k)]
        age[k:last] = np.where(run[k:last] == run[k], aged, age[k:last])
    return age
