"""References that are recorded late or early, by whole samples: what residuals that follow the speed tell."""

from collections.abc import Mapping

import numpy as np

from hallsym.estimation.likelihood import Cost
from hallsym.estimation.outliers import residuals
from hallsym.log import Log
from hallsym.log.quality.findings import Fault
from hallsym.model import Model

MISFIT = 1.5
"""Mean square of residuals over noise from which on it is asked for."""
SAMPLES = 0.5
"""Delay in samples from which on a logger is to blame; less is a lag, a matter of diagnosis."""
MOST, ALIKE = 0.8, 0.2
"""Share of the misfit that a delay must explain; relative difference of the channels' delays, at most."""


def lateness(
    log: Log, model: Model, p: np.ndarray, zeros: Mapping[int, np.ndarray], cost: Cost
) -> str | None:
    """Return a note where the readings follow references of another time; None where they do not.

    One parameter by channel: residuals r against the rate of the model's reading m, delay = r.m' / m'.m'.
    """
    counts = float(cost.summary.counts.sum())
    noise = cost.at(p).covariance.mean(axis=0).diagonal()
    if "t_s" not in log.columns or cost.at(p).value < MISFIT * counts * len(noise):
        return None
    residual, used = residuals(model, p, zeros), set(cost.summary.runs)
    sums, ticks, rows = np.zeros((3, len(model.channels))), list[float](), 0
    for block in log.blocks((*model.references, *model.state, *model.channels, "t_s")):
        t = block.data["t_s"]
        if block.run not in used or len(t) < 3 or not np.all(np.diff(t) > 0):
            continue
        left = residual(block)
        rate = np.gradient(np.array([block.data[c] for c in model.channels]) - left, t, axis=1)
        left = left - left.mean(axis=1, keepdims=True)
        sums += np.array([(left * left).sum(axis=1), (left * rate).sum(axis=1), (rate * rate).sum(axis=1)])
        ticks.append(float(np.median(np.diff(t))))
        rows += len(t)
    tick = float(np.median(ticks)) if ticks else 0.0
    # a rate by central differences holds half the variance of the references' own noise, per tick squared
    sums[2] -= rows * (noise - cost.reading_variance) / max(2 * tick**2, 1e-300)
    if not ticks or not np.all(sums[2] > 0):
        return None
    delay = sums[1] / sums[2]
    excess = sums[0] - rows * noise
    explained = (sums[1] ** 2 / sums[2]).sum() / max(excess.sum(), 1e-300)
    middle = float(np.median(delay))
    if explained < MOST or abs(middle) < SAMPLES * tick or np.ptp(delay) > ALIKE * abs(middle):
        return None
    when = "late" if middle > 0 else "early"
    return Fault(
        f"References of {log.name} look {abs(middle) / tick:.2g} samples ({abs(middle):.3g} s) {when} beside "
        f"the readings, which explains {100 * min(explained, 1.0):.0f} % of what the model leaves: check how "
        "columns were put together; hallsym diagnose compares a delay with a lag and hysteresis."
    )
