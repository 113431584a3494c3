"""The pose that a calibration decodes from readings, and its errors, sample by sample."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import (
    ErrorTable,
    columns_of,
    error_tables,
    logged_columns,
    nominal_variance,
    pose_errors,
)
from hallsym.estimation.evaluate import evaluate
from hallsym.families.recording import as_read
from hallsym.log import Block, Log, Weigh, as_log
from hallsym.log.batches import SIZE
from hallsym.log.derived import extended
from hallsym.log.phase import designed
from hallsym.model import Model

NOMINAL, FITTED = "nominal", "fitted"


@dataclass(frozen=True, eq=False)
class Decoded:
    """A log and versions of a model that decode it: parameters (n,), offsets by run, variance of readings.

    `sigma`: noise by column and `values`: parameters (n,), for the columns that are computed. Samples to
    which `keep` gives weight 0 (outliers) do not count.
    """

    log: Log
    model: Model
    versions: Mapping[str, tuple[np.ndarray, Mapping[int, np.ndarray], np.ndarray]]
    sigma: Mapping[str, float]
    values: np.ndarray
    keep: Weigh | None = None

    def tables(self) -> dict[str, ErrorTable]:
        """Return the errors of each version by run, from one pass."""
        versions = [(p, offsets) for p, offsets, _ in self.versions.values()]
        variances = np.array([variance for *_, variance in self.versions.values()])
        found = error_tables(
            self.log, self.model, versions, variances, self.keep, sigma=self.sigma, computed_at=self.values
        )
        return dict(zip(self.versions, found, strict=True))

    def blocks(self, *more: str) -> Iterator[tuple[Block, np.ndarray]]:
        """Yield each block, with `more` columns, and its errors (versions, n_pose, samples) in SI.

        Errors are nan where a sample does not count.
        """
        model, none = self.model, np.zeros(len(self.model.offsets))
        each = [(pose_errors(model, variance), p, own) for p, own, variance in self.versions.values()]
        wide = extended(self.log, model, self.sigma, model.named(self.values))
        for block in wide.blocks(tuple(dict.fromkeys((*columns_of(model), *more))), size=SIZE):
            found = [errors(p, own.get(block.run, none), block.data) for errors, p, own in each]
            kept = True if self.keep is None else self.keep(block) > 0
            yield block, np.where(kept, found, np.nan)


def decoded(
    log: Log, fit: Fit, keep: Weigh | None = None, *, label: str = FITTED, nominal: bool = True
) -> Decoded:
    """Return a log, as the model reads it, decoded by nominal parameters and by those of a fit, `label`."""
    model, variance = fit.model, reading_variance(fit)
    none = dict[int, np.ndarray]()
    plain = {NOMINAL: (designed(model, fit.values), none, nominal_variance(model, variance))}
    versions = (plain if nominal else {}) | {label: (fit.values, read_offsets(fit, log), variance)}
    return Decoded(log, model, versions, fit.noise.std, fit.values, keep)


def reading_variance(fit: Fit) -> np.ndarray:
    """Return the variance of the noise of each channel, (K,)."""
    return np.array([fit.noise[c].value ** 2 for c in fit.model.channels])


def read_offsets(fit: Fit, log: Log) -> dict[int, np.ndarray]:
    """Return what the zero deviations of each run add to its readings, delta / phi(0) of Eq. (31)."""
    model, first = fit.model, dict[int, np.ndarray]()
    if not model.offsets or not fit.offsets:
        return {}
    wide = extended(log, model, fit.noise.std, model.named(fit.values))
    for block in wide.blocks(model.state or model.channels[:1]):
        first.setdefault(block.run, np.array([block.data[c][0] for c in model.state]))
    return {
        run: np.asarray(fit.offsets[run]) / model.zero_scale(fit.values, state)
        for run, state in first.items()
        if fit.offsets.get(run) is not None
    }


def is_own(fit: Fit, log: Log) -> bool:
    """Return whether a log is the one that was fitted."""
    return bool(log.sha256 == fit.sha256)


def predicted(fit: Fit, frame: Any) -> dict[str, np.ndarray]:
    """Return `{"run": (n,), x_m: (n,), ...}`: what `Fit.predict` says."""
    model, log = fit.model, as_log(frame, fit.columns, fit.read_with)
    log.table.require([c for c in logged_columns(model) if c not in model.references])
    referenced = set(model.references) <= set(log.columns)
    if fit.corrections and not referenced:
        raise InputError(
            f"The calibration undoes mistakes of its log, so {log.name} must have the columns "
            f"{', '.join(model.references)} too."
        )
    known = fit if is_own(fit, log) else fit.changed(zero_deviations={})
    read = as_read(log, model, fit.corrections) if referenced else log
    weight, offsets = 1 / reading_variance(fit), read_offsets(known, read)
    none = np.zeros(len(model.offsets))
    wide = extended(read, model, fit.noise.std, model.named(fit.values))

    def poses() -> Iterator[tuple[Block, np.ndarray]]:
        for block in wide.blocks((*(model.references if referenced else ()), *model.state, *model.channels)):
            readings, state, near = (
                [block.data[c] for c in names if c in block.data]
                for names in (model.channels, model.state, model.references)
            )
            own = offsets.get(block.run, none)
            yield block, model.decode(fit.values, own, readings, state, weight, near or None)

    return _by_sample(log, model, poses())


def residuals_on(fit: Fit, frame: Any) -> dict[str, np.ndarray]:
    """Return `{"run": (n,), x_m: (n,), ...}`: what `Fit.residuals` says."""
    log = as_log(frame, fit.columns, fit.read_with)
    read = as_read(log, fit.model, fit.corrections)
    if not is_own(fit, log):
        seen = evaluate(fit, log)
        fit, read = seen.applied, seen.decoded
    found = decoded(read, fit, nominal=False)
    return _by_sample(log, fit.model, ((block, errors) for block, (errors,) in found.blocks()))


def _by_sample(log: Log, model: Model, found: Iterable[tuple[Block, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the run of every sample, and its pose or error."""
    parts = [np.vstack([np.full(values.shape[1], block.run), values]) for block, values in found]
    if not parts:
        raise InputError(f"{log.name} holds no samples; there is nothing to decode.")
    run, *each = np.concatenate(parts, axis=1)
    return {"run": run.astype(np.int64), **dict(zip(model.pose, each, strict=True))}
