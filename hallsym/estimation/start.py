"""Starts and checks that linear least squares gives before any optimiser runs."""

from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.likelihood import Cost
from hallsym.model import Model

MOVED = 4.0
"""A column counts as moved when its energy is more than this many times its noise's (rms twice the noise)."""


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Unconstrained coefficients of a merged cost, shape (n_features, n_channels).

    `moved`: which features moved. `unexplained`: (n_channels,) share of each channel's variance that the
    features leave, 0 for a channel that hears only noise.
    """

    coefficients: np.ndarray
    moved: np.ndarray
    unexplained: np.ndarray


def linear_fit(cost: Cost) -> LinearFit:
    """Solve for the coefficients of features that moved; the others keep their nominal value."""
    model = cost.summary.model
    R_f, R_m = (part[0] for part in cost.triangles)
    energy = np.einsum("ij,ij->j", R_f, R_f)
    noise = cost.summary.counts[0] * np.einsum("jj->j", cost.noise_in_features[0])
    moved = energy > MOVED * noise
    nominal = cost.coefficients.first(model.nominal)[0][0]
    size = np.sqrt(np.where(moved, energy, 1.0))
    target = R_m - R_f @ nominal
    change, *_ = np.linalg.lstsq((R_f / size)[:, moved], target, rcond=1e-9)
    coefficients = nominal.copy()
    coefficients[moved] += change / size[moved, None]
    left = target - (R_f / size)[:, moved] @ change
    total = np.einsum("ij,ij->j", R_m, R_m)
    heard = total > MOVED * cost.summary.counts[0] * cost.reading_variance
    share = np.einsum("ij,ij->j", left, left) / np.maximum(total, 1e-300)
    return LinearFit(coefficients, moved, np.where(heard, share, 0.0))


def closed_form(cost: Cost, linear: LinearFit) -> np.ndarray:
    """Return the family's closed-form start (nominal values if it has none), shape (n,)."""
    features = cost.summary.features
    if features.model.closed_form is None:
        return features.model.nominal
    # a family thinks of columns that start at zero, not at the centre of the log
    at_zero = features.shift(-cost.coefficients.centre) @ linear.coefficients
    named = {features.label(j): at_zero[j] for j in range(features.size)}
    return features.model.closed_form(features.model, named)


def check_reference(model: Model, unexplained: np.ndarray, where: str) -> None:
    """Raise `InputError` when the reference explains less than half of a channel's variance."""
    for channel, share in zip(model.channels, unexplained, strict=True):
        if share > 0.5:
            explained = 100 * max(1 - share, 0)
            raise InputError(
                f"The reference of {where} explains only {explained:.0f} % of the variation of {channel} "
                "(expected more than 90 %); it does not belong to these readings, or outliers hide that it "
                "does: check file, clock and columns, or fit with --loss auto."
            )
