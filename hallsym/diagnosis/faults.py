"""Faults of single samples, which no equation of a model holds: spikes, stale samples, jitter, ADC steps.

They are judged on what the best model leaves. What each costs is what the gap would lose without it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.batches import Weigh
from hallsym.diagnosis.chance import statistic_at
from hallsym.diagnosis.record import Estimate
from hallsym.diagnosis.survey import Survey
from hallsym.diagnosis.tangent import Base
from hallsym.log import Block
from hallsym.outliers import residuals

TAILS = ("outliers", "dropped_samples")
"""Faults of few samples, which can be left out."""
FAR = 42.0
"""Squared whitened distance of a sample, over its typical one, from which on it is left out."""
CERTAIN = 8.0
"""Standard deviations that jitter must show by."""
RARE = 2e-5
"""Share of samples from which on a tail is more than chance."""
BURSTS = 0.5
"""Share of far samples that crowd together from which on they are no faults of single samples."""
SMOOTH = 0.25
"""Correlation of neighbouring time shifts from which on they are no jitter, which has none."""
ONE_SIDED = 0.5
"""Mean sign of samples that are late from which on they count as stale: jitter is early as often as late."""


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of samples: `power` is its share of the whitened residual's variance."""

    name: str
    link: str
    text: str
    power: float
    parameters: dict[str, Estimate]
    p_value: float


def faults(base: Base, found: Survey) -> list[Fault]:
    """Return the faults that `found`, a survey of all samples, shows, largest first."""
    out = []
    variance = max(found.variance, 1e-12)
    tail = found.spike_power + found.stale_power
    rare = found.bursts < BURSTS
    if rare and found.spike_share > RARE and found.spike_power > 0.3 * tail:
        out.append(
            Fault("outliers", "electronics", f"{100 * found.spike_share:.2g} % of the samples are spikes",
                  tail / variance, {"share": Estimate(found.spike_share, None, "1")}, 0.0)
        )  # fmt: skip
    elif rare and found.stale_share > RARE and abs(found.one_sided) > ONE_SIDED:
        out.append(
            Fault("dropped_samples", "clock", f"{100 * found.stale_share:.2g} % of the samples are old",
                  tail / variance, {"share": Estimate(found.stale_share, None, "1")}, 0.0)
        )  # fmt: skip
    elif found.jitter_z > CERTAIN and found.smooth < SMOOTH:
        out.append(
            Fault("clock_jitter", "clock", f"sampling instants scatter by {1e6 * found.jitter_s:.3g} us rms",
                  found.jitter_power / variance, {"jitter": Estimate(found.jitter_s, None, "s")}, 1e-12)
        )  # fmt: skip
    steps = found.adc_step
    if steps.size and steps.max() > 0:
        whiten = np.linalg.inv(base.covariance)
        power = float(np.diag(whiten) @ steps**2) / 12 / len(steps)
        fine = {
            f"step_{c}": Estimate(float(q), None, _unit(c))
            for c, q in zip(base.model.channels, steps, strict=True)
        }
        out.append(
            Fault("adc_quantisation", "electronics", _steps(base.model.channels, steps),
                  power / variance, fine, 0.0)
        )  # fmt: skip
    return sorted(out, key=lambda f: -f.power)


def _unit(channel: str) -> str:
    return {"v": "V"}.get(channel.rpartition("_")[2], channel.rpartition("_")[2])


def _steps(channels: Sequence[str], steps: np.ndarray) -> str:
    unit = _unit(channels[int(np.argmax(steps))])
    factor, name = {"V": (1e3, "mV"), "rad": (1e6, "urad")}.get(unit, (1e6, "um"))
    return f"readings come in steps of {factor * steps.max():.3g} {name}"


def without_tail(base: Base) -> Weigh:
    """Return weights 0 for samples that are far off the model, on top of those left out already."""
    residual = residuals(base.model, base.p, base.zeros)
    whiten = np.linalg.cholesky(np.linalg.inv(base.covariance)).T

    def weigh(block: Block) -> np.ndarray:
        distance = ((whiten @ residual(block)) ** 2).sum(axis=0)
        typical = max(float(np.median(distance)) / statistic_at(0.5, len(whiten)), 0.5)
        near = (distance < FAR * typical).astype(float)
        return near if base.keep is None else near * base.keep(block)

    return weigh
