"""Faults of single samples, which no equation of a model holds: spikes, stale samples, jitter, ADC steps.

They are judged on what the best model leaves. What each costs is what the gap would lose without it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from hallsym.diagnosis.cordic import cordic
from hallsym.diagnosis.p_values import beyond, statistic_at
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import Estimate
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.survey import FAR, Survey
from hallsym.estimation.outliers import residuals
from hallsym.families.faults import FAULTS
from hallsym.log import Block, Log
from hallsym.log.batches import Weigh

TAILS = ("outliers", "dropped_samples")
"""Faults of few samples, which can be left out."""
OF_VALUES = ("cordic_steps",)
"""Faults that the values of the readings tell, whatever a model leaves: their error is known."""
SPIKES = 0.3
"""Part of the power of far samples from which on spikes, which no delay explains, are the cause.

A stale sample is off along the direction of motion only and leaves none; a spike of one of K readings has
1 - 1/K of its power in the others on average (2/3 for three). Half of that."""
SMOOTH = 0.25
"""Correlation of neighbouring time shifts from which on they are no jitter, which has none.

White noise has -0.09 after the running median; a gap of the model that is sampled finely comes near 1."""


KINDS = 6
"""Faults that every log is asked for: those of samples here, and exchanged and inverted channels."""


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of samples: `power` is its share of the whitened residual's variance, `p_value` uncorrected."""

    name: str
    text: str
    power: float
    parameters: dict[str, Estimate]
    p_value: float

    @property
    def link(self) -> str:
        """Link of the chain that the fault belongs to."""
        return FAULTS[self.name].link


def faults(base: Base, found: Survey, tested: int) -> list[Fault]:
    """Return the faults that `found`, a survey of all samples, shows, largest first.

    Each must be certain after correction for all that was `tested`.
    """

    def certain(p: float) -> bool:
        return p * tested < POLICY.certain

    out = []
    variance = max(found.variance, 1e-12)
    tail = found.spike_power + found.stale_power
    rare = found.bursts < POLICY.half
    if rare and certain(found.spike_p) and found.spike_power > SPIKES * tail:
        out.append(
            Fault("outliers", f"{100 * found.spike_share:.2g} % of the samples are spikes",
                  tail / variance, {"share": Estimate(found.spike_share, None, "1")}, found.spike_p)
        )  # fmt: skip
    elif rare and certain(found.stale_p):
        out.append(
            Fault("dropped_samples", f"{100 * found.stale_share:.2g} % of the samples are old",
                  tail / variance, {"share": Estimate(found.stale_share, None, "1")}, found.stale_p)
        )  # fmt: skip
    elif certain(found.jitter_p) and found.smooth < SMOOTH:
        out.append(
            Fault("clock_jitter", f"sampling instants scatter by {1e6 * found.jitter_s:.3g} us rms",
                  found.jitter_power / variance, {"jitter": Estimate(found.jitter_s, None, "s")},
                  found.jitter_p)
        )  # fmt: skip
    chip = _chip(base, found)
    if chip and certain(chip.p_value):
        out.append(chip)
    steps = found.adc_step
    # a chip's levels lie as evenly as steps nearly everywhere, and are named by what makes them
    if chip and steps.max() > 0.5 * chip.parameters["distance"].value:
        steps = np.zeros_like(steps)
    if steps.size and steps.max() > 0 and certain(found.step_p):
        whiten = np.linalg.inv(base.covariance)
        power = float(np.diag(whiten) @ steps**2) / 12 / len(steps)
        fine = {
            f"step_{c}": Estimate(float(q), None, _unit(c))
            for c, q in zip(base.model.channels, steps, strict=True)
        }
        out.append(
            Fault("adc_quantisation", _steps(base.model.channels, steps),
                  power / variance, fine, found.step_p)
        )  # fmt: skip
    return sorted(out, key=lambda f: -f.power)


def _chip(base: Base, found: Survey) -> Fault | None:
    """The fault that a decoded angle takes only values that few steps of CORDIC give."""
    if base.model.channels != base.model.pose or len(found.values) != 1:
        return None
    sigma = float(np.sqrt(base.covariance[0, 0]))
    seen = cordic(found.values[0], sigma * float(np.sqrt(found.variance)), float(found.adc_step[0]))
    if seen is None:
        return None
    chip = seen.levels
    fine = {
        "steps": Estimate(float(chip.steps), None, "1"),
        "distance": Estimate(seen.distance, None, "rad"),
        "error": Estimate(chip.rms, None, "rad"),
    }
    many, worst = 2 * len(chip.angles), np.degrees(chip.worst)
    text = f"{chip.steps} steps of CORDIC: {many} angles a turn, up to {worst:.2g} deg off"
    power = (chip.rms / sigma) ** 2 / found.variance
    return Fault("cordic_steps", text, power, fine, seen.p_value)


def _unit(channel: str) -> str:
    return {"v": "V"}.get(channel.rpartition("_")[2], channel.rpartition("_")[2])


def _steps(channels: Sequence[str], steps: np.ndarray) -> str:
    unit = _unit(channels[int(np.argmax(steps))])
    factor, name = {"V": (1e3, "mV"), "rad": (1e6, "urad")}.get(unit, (1e6, "um"))
    return f"readings come in steps of {factor * steps.max():.3g} {name}"


def without_tail(base: Base) -> Weigh:
    """Return weights 0 for samples that are far off the model, on top of those left out already."""
    residual = residuals(base.model, base.p, base.zeros)
    whiten = base.whiten

    def weigh(block: Block) -> np.ndarray:
        distance = ((whiten @ residual(block)) ** 2).sum(axis=0)
        typical = max(float(np.median(distance)) / statistic_at(0.5, len(whiten)), 0.5)
        near = (distance < FAR * typical).astype(float)
        return near if base.keep is None else near * base.keep(block)

    return weigh


def wirings(channels: int) -> int:
    """Return how many other orders and signs of the channels were compared with the nominal ones."""
    return factorial(channels) * 2**channels - 1


def wiring_p(base: Base, log: Log, runs: Sequence[int]) -> float:
    """Return the p-value of the readings of `log` being wired as the model has them, across `runs`.

    `base` holds the log as rewired. The score of a run is what its readings differ by from the rewired ones,
    times what the model leaves of them; its noise is the same times what is left after rewiring.
    """
    wanted = frozenset(runs)
    scores: dict[int, float] = {}
    noise: dict[int, float] = {}
    whiten = base.whiten
    for now, was in zip(pieces(base, wanted), pieces(replace(base, log=log), wanted), strict=True):
        moved = (whiten @ (was.readings - now.readings)) * now.used
        scores[now.run] = scores.get(now.run, 0.0) + float((moved * was.residual).sum())
        noise[now.run] = noise.get(now.run, 0.0) + float((moved * now.residual).sum())
    return beyond(np.array(list(scores.values())), np.array(list(noise.values())))
