"""Logs of one simulated encoder, which belong to its calibration or do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

import hallsym
from hallsym.log import Log, Noise
from hallsym.model import Model
from hallsym.simulation import Campaign, NoiseModel, campaign_from

SEEDS_OF_CALIBRATIONS = 1_000_000


@cache
def machine(name: str = "rotary") -> tuple[Model, Campaign, dict[str, float], dict[str, float]]:
    """Model, campaign, true values and noise of the example of a family."""
    model = hallsym.build(name)
    example = model.family.example
    assert example is not None
    noise = Noise.given(example.noise, (*model.channels, *model.references)).std
    return model, campaign_from(example.campaign, "example"), dict(example.values), dict(noise)


def log_of(
    seed: int,
    changes: Mapping[str, float] | None = None,
    *,
    louder: float = 1.0,
    correlation: float = 0.0,
    stated: bool = True,
    runs: int | None = None,
) -> Log:
    """A log of the encoder; `changes`: what is added to its values; `correlation`: of the noise, samples."""
    model, campaign, values, sigma = machine()
    if runs is not None:
        campaign = replace(campaign, runs=campaign.runs[:runs])
    moved = {n: v + (changes or {}).get(n, 0.0) for n, v in values.items() if n in model.names}
    noise = NoiseModel(
        sigma={c: louder * s for c, s in sigma.items()}, correlation_s=correlation * campaign.step_s
    )
    columns = hallsym.simulate(model, moved, campaign, noise, seed=seed)
    return Log.from_arrays(columns, Noise.given(sigma, tuple(sigma)) if stated else None)


def calibration(seed: int, **how: float | bool) -> hallsym.Fit:
    """A calibration of the encoder."""
    return hallsym.fit(log_of(SEEDS_OF_CALIBRATIONS + seed, **how), machine()[0], solver="direct", holdout=())


def alarms(logs: int, each: int = 10, **how: float | bool) -> tuple[int, np.ndarray]:
    """How many of so many logs that belong are called changed; of each, the smallest p-value, corrected.

    Every `each` logs have a calibration of their own.
    """
    found, least = 0, []
    for first in range(0, logs, each):
        own = calibration(first, **how)
        seen = hallsym.watch(own, [log_of(first + k, **how) for k in range(each)])
        assert not seen.not_judged
        found += len(seen.changed)
        least += [len(log.tests) * min(test.p_value for test in log.tests) for log in seen.logs]
    return found, np.array(least)
