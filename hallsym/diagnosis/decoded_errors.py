"""Decoded errors of a model on some samples, and their waves per period."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.record import Gap, Waves
from hallsym.diagnosis.residuals import Base
from hallsym.estimation.calibration import rmse_interval
from hallsym.estimation.decoding import error_tables, nominal_variance, pose_errors
from hallsym.log import Block
from hallsym.log.batches import Weigh
from hallsym.log.phase import decoding, designed
from hallsym.records import named


@dataclass(frozen=True, eq=False)
class DecodedErrors:
    """Decoded errors of `count` samples: `rms` and `peak` of each coordinate, (pose,) each, in SI.

    `weights`: (pose,) of the pose metric. `interval`: 95 %, of the rms by coordinate, from
    the scatter of runs.
    """

    pose: tuple[str, ...]
    weights: np.ndarray
    count: int
    rms: np.ndarray
    peak: np.ndarray
    interval: Mapping[str, tuple[float, float]]

    @property
    def metric(self) -> float:
        """The gap metric: root of the summed mean squares in the pose metric."""
        return float(np.linalg.norm(self.rms * self.weights))

    @property
    def gap(self) -> Gap:
        """Rmse and peak per pose coordinate."""
        return Gap(named(self.pose, self.rms), named(self.pose, self.peak), dict(self.interval))


def errors_of(base: Base) -> Callable[[Block], np.ndarray]:
    """Return `block -> (n_pose, samples)` errors of the decoded pose; the block needs the model's columns."""
    errors = pose_errors(base.model, np.diag(base.covariance))
    return lambda block: errors(base.p, base.offsets_in(block.run), block.data)


def decoded_errors(base: Base, runs: Iterable[int], keep: Weigh | None = None) -> DecodedErrors:
    """Return the decoded errors of some runs, without samples that `keep` leaves out."""
    (found,) = error_tables(
        base.log, base.model, [(base.p, base.offsets)], np.diag(base.covariance), keep,
        sigma=base.sigma, among=frozenset(runs),
    )  # fmt: skip
    count, peak = int(found.count.sum()), found.peak.max(axis=0, initial=0.0)
    rms = np.sqrt(found.squares.sum(axis=0) / max(count, 1))
    return DecodedErrors(found.pose, base.pose_weights, count, rms, peak, rmse_interval(found))


FIRST = 12
"""Largest order of the waves per period that are fitted, beside those that effects declare.

A log covers a period if samples lie in each half of the shortest wave."""


def waves(model: Base, after: Base | None) -> tuple[Waves, ...]:
    """Return the waves of the error of each periodic coordinate; none for a pose that has no such coordinate.

    `model`, `after`: without and with the found effects.
    """
    pose, known = model.model.pose, model.model.family.waves
    plain_covariance = np.diag(nominal_variance(model.model, np.diag(model.covariance)))
    plain = replace(model, p=designed(model.model, model.p), covariance=plain_covariance)
    bases = [base for base in (plain, model, after) if base is not None]
    orders = [n for n in sorted({*range(1, FIRST + 1), *known}) if 2 * n <= model.log.rows]
    periodic = [k for k, c in enumerate(pose) if c in model.model.period]
    found = [_amplitudes(base, periodic, orders) for base in bases] if periodic else []
    out = []
    for j, k in enumerate(periodic):
        plainly = decoding(found[0][1][j], found[1][1][j])
        sizes = np.array([size[j] for size, _ in found[0 if plainly else 1 :]])
        largest = float(sizes.max(initial=0.0))
        for n, amplitudes in zip(orders, sizes.T.tolist(), strict=True):
            if max(amplitudes) >= model.policy.negligible * largest > 0:
                own, left, *rest = amplitudes if plainly else (None, *amplitudes)
                name = pose[k] if len(pose) > 1 else ""
                out.append(Waves(n, own, left, rest[0] if rest else None, known.get(n, ()), name))
    return tuple(out)


def _amplitudes(base: Base, periodic: Sequence[int], orders: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of waves of the decoded error of each periodic coordinate over its own period; the rest, SI.

    Amplitudes (periodic, orders), fitted together, over all samples of the log; 0 where the log does not
    cover the period. Rest (periodic,): rms of the error without them.
    """
    model, count = base.model, len(periodic)
    errors = pose_errors(model, np.diag(base.covariance))
    products = np.zeros((count, 2 + 2 * len(orders), 2 + 2 * len(orders)))
    seen = np.zeros((count, 2 * FIRST), dtype=bool)
    for batch in base.batches():
        weights = batch.weights(base.keep)
        error = errors(base.p, base.offsets_of(batch), batch.data)
        for j, k in enumerate(periodic):
            periods = batch.data[model.references[k]] / model.period[model.references[k]]
            seen[j, (periods % 1 * 2 * FIRST).astype(int) % (2 * FIRST)] = True
            turn = np.outer(orders, 2 * np.pi * periods)
            x = np.vstack([np.ones(len(batch)), np.cos(turn), np.sin(turn), error[k]])
            products[j] += (x if weights is None else x * weights) @ x.T
    out, rest = np.zeros((count, len(orders))), np.zeros(count)
    for j, M in enumerate(products):
        if seen[j].all():
            solved = np.linalg.lstsq(M[:-1, :-1], M[:-1, -1], rcond=1e-9)[0]
            out[j] = np.hypot(*solved[1:].reshape(2, -1))
            rest[j] = np.sqrt(max(M[-1, -1] - M[-1, :-1] @ solved, 0.0) / M[0, 0])
    return out, rest
