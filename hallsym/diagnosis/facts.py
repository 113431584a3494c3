"""What effects may know of a log before they are tried: length, columns, rails, hum, instants of slips."""

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.change_points import MAX_SEGMENTS, instants, switched_runs
from hallsym.diagnosis.effect import Facts
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.survey import MAINS, SEGMENT, Survey
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.model import Model

QUANTILES = (0.998, 0.99, 0.97, 0.93)
"""Quantiles of the readings that are tried as rails, each high and low."""
SAMPLED = 50_000
"""Samples that those quantiles are taken from."""


def facts_of(base: Base, found: Survey) -> Facts:
    """Return what effects may know of the log; searched numbers come from the residual of `base`."""
    model, log = base.model, base.log
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        columns=tuple(c for c in log.columns if base.timed or c != "t_s"),
        temperature=_mean(log, "temperature_degc") if "temperature_degc" in log.columns else None,
        extremes=_extremes(log, model),
        rails=rails_of(log, model),
        lines_hz=found.lines_hz,
        lines_tried=max(1, round(sum(b - a for a, b in MAINS) * found.duration_s)),
        instants=instants(base, log.runs, log.rows),
        instants_tried=len(model.layout) * min(MAX_SEGMENTS, -(-log.rows // SEGMENT) + len(log.runs)),
        on_runs=switched_runs(base) if len(model.channels) > len(model.pose) and not model.zeros else (),
    )


def _mean(log: Log, column: str) -> float:
    sums = [(b.data[column].sum(), len(b)) for b in batches(log, (column,))]
    return float(sum(s for s, _ in sums) / sum(n for _, n in sums))


def rails_of(log: Log, model: Model) -> tuple[tuple[float, float], ...]:
    """Return lowest and highest value of each channel where it repeats exactly; -inf and inf where not."""
    low, high = np.full(len(model.channels), np.inf), np.full(len(model.channels), -np.inf)
    at_low, at_high = np.zeros(len(low)), np.zeros(len(low))
    for batch in batches(log, model.channels):
        values = np.array(batch.columns(model.channels))
        lowest, highest = values.min(axis=1), values.max(axis=1)
        at_low = np.where(lowest < low, 0, at_low)
        at_high = np.where(highest > high, 0, at_high)
        low, high = np.minimum(low, lowest), np.maximum(high, highest)
        at_low += (values == low[:, None]).sum(axis=1)
        at_high += (values == high[:, None]).sum(axis=1)
    return tuple(
        (a if n >= POLICY.rail_repeats else -np.inf, b if m >= POLICY.rail_repeats else np.inf)
        for a, b, n, m in zip(low.tolist(), high.tolist(), at_low, at_high, strict=True)
    )


def _extremes(log: Log, model: Model) -> np.ndarray:
    """Return quantiles of the readings, high and low in turn: (2 n_quantiles, n_channels)."""
    thin = max(1, log.rows // SAMPLED)
    values = np.hstack([np.array(b.columns(model.channels))[:, ::thin] for b in batches(log, model.channels)])
    return np.vstack([np.quantile(values, [a, 1 - a], axis=1) for a in QUANTILES])
