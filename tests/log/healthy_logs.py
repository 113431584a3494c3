"""Logs of machines that make no mistake, of many kinds: each must pass in silence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hallsym.families import build, published
from hallsym.log import Meta
from hallsym.simulation import Campaign, NoiseModel, Run, simulate
from hallsym.simulation.signals import AtTimes, Signal, multi_sine, ramp, sine, steps, triangle

Arrays = dict[str, np.ndarray]
AXES = ("x_m", "y_m", "rz_rad")
SHORTEST = 24
"""Samples of the shortest run that is made."""


def healthy(kind: str, seed: int) -> Arrays:
    """Return the columns of a simulated log of a kind, everything else drawn by the seed."""
    return KINDS[kind](np.random.default_rng(seed))


def _setting(rng: np.random.Generator) -> dict[str, float]:
    return {
        "z_m": rng.uniform(-1e-3, 1e-3),
        "rx_rad": rng.uniform(-4e-4, 4e-4),
        "ry_rad": rng.uniform(-4e-4, 4e-4),
    }


def _amplitude(axis: str, rng: np.random.Generator) -> float:
    return float(rng.uniform(1e-4, 6e-4) if axis != "rz_rad" else rng.uniform(1e-4, 4e-4))


def _stage(
    rng: np.random.Generator,
    motions: Sequence[Mapping[str, AtTimes]],
    duration_s: float,
    *,
    quiet: bool = False,
) -> Arrays:
    """Simulate runs with these motions at random settings, with random noise, converter and clock."""
    model, truth = build("stage31"), published.values("table7_estimates")
    samples = int(rng.integers(max(SHORTEST, 60), 800))
    step = duration_s / samples
    runs = tuple(Run(duration_s, _setting(rng), motion) for motion in motions)
    level = 10 ** rng.uniform(-7.5, -5.8)
    sigma = dict.fromkeys(model.channels if quiet else (*model.channels, *model.references), level) | {
        "z_m": 12e-9, "rx_rad": 80e-9, "ry_rad": 80e-9
    }  # fmt: skip
    return simulate(
        model, truth, Campaign(step, runs), _noise(sigma, level, step, rng), seed=int(rng.integers(2**31))
    )


def _noise(sigma: dict[str, float], level: float, step: float, rng: np.random.Generator) -> NoiseModel:
    kind = rng.integers(3)
    return NoiseModel(
        sigma,
        correlation_s=step * rng.uniform(1, 30) if kind == 1 else 0.0,
        degrees_of_freedom=float(rng.uniform(3, 6)) if kind == 2 else None,
        adc_step_m=min(level * rng.choice([0.0, 0.3, 1.0, 3.0, 10.0, 30.0]), 1e-5 if level < 1e-5 else 0.01),
    )


def grid(rng: np.random.Generator) -> Arrays:
    """One axis after the other at each setting, as the paper."""
    motions = [
        {axis: sine(_amplitude(axis, rng), rng.uniform(0.7, 3))}
        for _ in range(int(rng.integers(2, 8)))
        for axis in AXES
    ]
    return _stage(rng, motions, 1.0)


def multisine(rng: np.random.Generator) -> Arrays:
    """All axes together."""
    motions = [
        {axis: multi_sine(_amplitude(axis, rng), rng.uniform(0.5, 9, 3).tolist()) for axis in AXES}
        for _ in range(int(rng.integers(3, 16)))
    ]
    return _stage(rng, motions, 1.5)


def raster(rng: np.random.Generator) -> Arrays:
    """Fast lines along one axis, slow steps along another."""
    fast, slow = rng.permutation(AXES)[:2].tolist()
    line_hz, lines = rng.uniform(2, 8), int(rng.integers(4, 20))
    motion = {
        fast: triangle(_amplitude(fast, rng), line_hz),
        slow: triangle(_amplitude(slow, rng), line_hz / lines),
    }
    return _stage(rng, [motion] * int(rng.integers(3, 12)), lines / line_hz)


def dwell(rng: np.random.Generator) -> Arrays:
    """Points at which the axes rest, the extremes of the travel among them."""
    motions = [
        {
            axis: steps((_amplitude(axis, rng) * rng.choice([-1.0, 0.0, 0.5, 1.0], 12)).tolist(), 0.1)
            for axis in AXES[: int(rng.integers(1, 4))]
        }
        for _ in range(int(rng.integers(3, 10)))
    ]
    return _stage(rng, motions, 1.2)


def resting(rng: np.random.Generator) -> Arrays:
    """Motion that begins late or ends early, and axes that rest without noise of the reference."""

    def between(signal: Signal, start: float, stop: float) -> AtTimes:
        return lambda t: signal(np.clip(t, start, stop))

    motions = [
        {
            axis: between(sine(_amplitude(axis, rng), rng.uniform(0.7, 4)), *sorted(rng.uniform(0, 1, 2)))
            for axis in AXES
        }
        for _ in range(int(rng.integers(3, 10)))
    ]
    return _stage(rng, motions, 1.0, quiet=rng.random() < 0.3)


def turning(rng: np.random.Generator) -> Arrays:
    """An encoder turned both ways at several speeds, read as two voltages or as an angle."""
    meta = Meta(probes=[{"channel": "angle_rad"}]) if rng.random() < 0.3 else Meta()
    model = build("rotary", meta=meta)
    samples = int(rng.integers(200, 1500))
    step = 10 ** rng.uniform(-4, -2)
    speeds = [s * rng.uniform(0.01, 0.4) / step for s in (1, -1, 1, -1)[: int(rng.integers(1, 5))]]
    runs = tuple(Run(samples * step, {}, {"angle_rad": ramp(speed)}) for speed in speeds)
    level = 10 ** rng.uniform(-4, -2.5)
    sigma = dict.fromkeys(model.channels, level) | {"angle_ref_rad": 10 ** rng.uniform(-6, -4)}
    return simulate(
        model, {}, Campaign(step, runs), _noise(sigma, level, step, rng), seed=int(rng.integers(2**31))
    )


def swinging(rng: np.random.Generator) -> Arrays:
    """An encoder that swings about a place, also between the extremes of a voltage."""
    model, step = build("rotary"), 2e-3
    swing = [float(rng.choice([0.3, np.pi / 2, np.pi, 5.0])) for _ in range(int(rng.integers(1, 5)))]
    runs = tuple(Run(2.0, {}, {"angle_rad": sine(a, rng.uniform(0.4, 2.0))}) for a in swing)
    level = 10 ** rng.uniform(-4, -2.5)
    sigma = dict.fromkeys(model.channels, level) | {"angle_ref_rad": 2e-5}
    return simulate(
        model, {}, Campaign(step, runs), _noise(sigma, level, step, rng), seed=int(rng.integers(2**31))
    )


KINDS: dict[str, Callable[[np.random.Generator], Arrays]] = {
    kind.__name__: kind for kind in (grid, multisine, raster, dwell, resting, turning, swinging)
}
