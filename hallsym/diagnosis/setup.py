"""What a diagnosis starts from: the log, its fit, the runs that fit and those that judge, the catalogue."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Effect
from hallsym.diagnosis.faults import KINDS
from hallsym.diagnosis.policy import Policy
from hallsym.estimation.calibration import Fit
from hallsym.estimation.channel_assignment import Wiring, as_read
from hallsym.estimation.gauss_newton import cost_near
from hallsym.log import Log
from hallsym.log.batches import remembered


@dataclass(frozen=True)
class Floor:
    """The gap metric that noise leaves [m or rad], and whether all noise was stated by the user."""

    metric: float
    stated: bool


@dataclass(frozen=True, eq=False)
class Setup:
    """What every stage of a diagnosis reads and none changes.

    `log`: as it was fitted, with the channels as they were logged. `base`: the fit as the point where
    tangents are taken, channels assigned. `runs` are fitted, `holdout` judge. `threshold`: relative decrease
    of the gap metric that counts. `split`: whether the runs are pieces of one recording. `say`: reports
    progress.
    """

    log: Log
    fit: Fit
    base: Base
    runs: list[int]
    holdout: tuple[int, ...]
    threshold: float
    split: bool
    floor: Floor
    catalogue: tuple[Effect, ...]
    policy: Policy
    say: Callable[[str], None]
    began: float

    @property
    def tested(self) -> int:
        """Hypotheses that every p-value is corrected for: effects of the catalogue and faults."""
        return len(self.catalogue) + KINDS

    @property
    def miswired(self) -> Wiring | None:
        """The channel assignment that was found, where channels are exchanged or inverted; else None."""
        model, wiring = self.fit.model, self.fit.wiring
        if wiring is None or len(model.channels) == 1:  # the sign of one channel is a direction, not a wire
            return None
        wrong = any(source != c or sign < 0 for c, (source, sign) in zip(model.channels, wiring, strict=True))
        return wiring if wrong else None

    def as_logged(self, base: Base) -> Base:
        """Return `base` on all samples, with the channels as they were logged."""
        return replace(base, keep=None, log=self.log) if self.miswired else replace(base, keep=None)


def base_of(log: Log, result: Fit) -> Base:
    """Return a fit as the point at which tangents are taken."""
    wired = as_read(log, result.model, result.wiring)
    sigma = result.noise.std
    cost = cost_near(wired, result.model, result.values, sigma, result.keep)
    point = cost.at(result.values)
    return Base(
        log=wired,
        model=result.model,
        p=np.array(result.values, dtype=float),
        zeros=dict(zip(cost.summary.runs, point.zeros, strict=True)),
        covariance=point.covariance.mean(axis=0),
        free=tuple(k for k, n in enumerate(result.model.names) if n not in result.held),
        pose_weights=result.model.family.pose_metric.weights(result.model.pose, log.meta.gap_length_scale_m),
        apart=frozenset(result.log["holdout"]),
        sigma=sigma,
        keep=remembered(result.keep, wired.rows),
    )


def floor_of(result: Fit, weights: np.ndarray) -> Floor:
    """Return the gap metric that noise alone leaves; `weights`: (n_pose,) of the pose metric."""
    metric = float(np.linalg.norm(weights * np.array(list(result.noise_floor.values()))))
    return Floor(metric, all(s.source == "given" for s in result.noise.sigmas.values()))
