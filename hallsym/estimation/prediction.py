"""The pose that a calibration decodes from readings, and its errors, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import decoder, logged_columns, nominal_variance
from hallsym.estimation.evaluate import evaluate
from hallsym.families.recording import as_read
from hallsym.log import Block, Log, as_log
from hallsym.log.derived import extended
from hallsym.log.phase import designed


class Decoder:
    """Pose of a block by the nominal or by the fitted parameters, (n_pose, samples) each."""

    def __init__(self, fit: Fit) -> None:
        """Compile the decoder of the fit's model."""
        self.fit, self.model = fit, fit.model
        self._nominal = designed(fit.model, fit.values)
        variance = np.array([fit.noise[c].value ** 2 for c in fit.model.channels])
        self._decode_nominal = decoder(fit.model, nominal_variance(fit.model, variance))
        self._decode = decoder(fit.model, variance)

    def offsets(self, run: int, first_state: np.ndarray) -> np.ndarray:
        """Return the displacements delta / phi(0) of one run, Eq. (31)."""
        delta = self.fit.offsets.get(run)
        if delta is None or not len(self.model.offsets):
            return np.zeros(len(self.model.offsets))
        return np.asarray(delta) / self.model.zero_scale(self.fit.values, first_state)

    def pose(self, block: Block, offsets: np.ndarray | None) -> np.ndarray:
        """Return the pose by the fitted parameters and `offsets` of the run; without offsets by the nominal.

        Near the reference where the block has one and the pose repeats.
        """
        model = self.model
        readings, state = ([block.data[c] for c in names] for names in (model.channels, model.state))
        known = set(model.references) <= set(block.data)
        reference = np.array([block.data[c] for c in model.references]) if known else None
        if offsets is None:
            return self._decode_nominal(
                self._nominal, np.zeros(len(model.offsets)), readings, state, reference
            )
        return self._decode(self.fit.values, offsets, readings, state, reference)


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
    return _decoded(known, read, model.references if referenced else (), errors=False)


def residuals_on(fit: Fit, frame: Any) -> dict[str, np.ndarray]:
    """Return `{"run": (n,), x_m: (n,), ...}`: what `Fit.residuals` says."""
    log = as_log(frame, fit.columns, fit.read_with)
    if is_own(fit, log):
        return _decoded(fit, as_read(log, fit.model, fit.corrections), fit.model.references, errors=True)
    seen = evaluate(fit, log)
    return _decoded(seen.applied, seen.decoded, fit.model.references, errors=True)


def _decoded(fit: Fit, log: Log, references: Sequence[str], *, errors: bool) -> dict[str, np.ndarray]:
    """Return the run and the decoded pose of every sample, or its errors."""
    model, decode = fit.model, Decoder(fit)
    sigma = {c: s.value for c, s in fit.noise.sigmas.items()}
    offsets: dict[int, np.ndarray] = {}
    found: list[np.ndarray] = []
    wide = extended(log, model, sigma, model.named(fit.values))
    for block in wide.blocks((*references, *model.state, *model.channels)):
        if block.run not in offsets:
            offsets[block.run] = decode.offsets(block.run, np.array([block.data[c][0] for c in model.state]))
        pose = decode.pose(block, offsets[block.run])
        pose = pose - np.array([block.data[c] for c in references]) if errors else pose
        found.append(np.vstack([np.full(pose.shape[1], block.run), pose]))
    if not found:
        raise InputError(f"{log.name} holds no samples; there is nothing to decode.")
    run, *each = np.concatenate(found, axis=1)
    return {"run": run.astype(np.int64), **dict(zip(model.pose, each, strict=True))}
