"""The noise that a diagnosed model leaves: by how much it is larger than stated, where, and whether white.

It is the noise of a fit (`hallsym.estimation.residual_noise`), taken from the best model that was found.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.words import plain
from hallsym.estimation import noise_left
from hallsym.estimation.residual_noise import ResidualNoise

LARGER: Final = "noise larger than stated"
"""The verdict of a log whose excess over the stated noise is noise."""


def noise_of_rest(base: Base, runs: Sequence[int]) -> ResidualNoise | None:
    """Return the noise that `base` leaves on `runs`; None where they are too short to tell."""
    zeros = {run: base.zeros_in(run) for run in (runs if base.timed else base.log.runs)}
    return noise_left(base.log, base.model, base.p, zeros, base.covariance, base.sigma, base.keep)


def with_noise(base: Base, noise: ResidualNoise) -> Base:
    """Return a fit whose residual is held against the noise that is there and not the one that was stated."""
    larger = np.array([max(noise.by_sensor[c], 1.0) for c in base.model.channels])
    return replace(base, covariance=base.covariance * np.outer(larger, larger))


def noise_text(noise: ResidualNoise, stated: bool) -> str:
    """Return the noise in words."""
    low, high = noise.interval
    said = (
        f"{noise.ratio:.3g} x the {'stated' if stated else 'estimated'} noise (95 %: {low:.3g} to {high:.3g})"
    )
    if noise.larger and len(noise.by_sensor) > 1:
        everywhere = len(noise.larger_in) == len(noise.by_sensor)
        names = " and ".join(plain(c) for c in noise.larger_in)
        said += ", in every sensor" if everywhere else f", in {names} alone" if names else ""
    if noise.white:
        return f"{said}, white"
    return (
        f"{said}, correlated in time (neighbouring samples by {noise.correlation:.2f}; a slow average varies "
        f"{noise.memory:.3g} x as much as that of white noise)"
    )
