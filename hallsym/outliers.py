"""Gross outliers: samples that neither the motion nor the noise explains."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import gammaincinv

from hallsym.arrays import on_arrays
from hallsym.log import Block
from hallsym.model import Model

WINDOW = 7
SPIKE = 7.0
"""Residuals this many robust standard deviations off their neighbours are spikes (7: 3e-12 of Gaussians)."""
TUKEY = 4.685
"""Tukey's biweight constant: 95 % efficient for Gaussian noise."""

Weigh = Callable[[Block], np.ndarray]


def residuals(model: Model, p: np.ndarray, zeros: Mapping[int, np.ndarray]) -> Callable[[Block], np.ndarray]:
    """Return `block -> (n_channels, samples)`: reading minus the model's at the reference pose, in m."""
    read, none = on_arrays(model.reading), np.zeros(len(model.zeros))

    def residual(block: Block) -> np.ndarray:
        pose = [block.data[c] for c in model.references]
        state = [block.data[c] for c in model.state]
        (expected,) = read(p, zeros.get(block.run, none), pose, state)
        return np.array([block.data[c] for c in model.channels]) - expected

    return residual


def reject_spikes(residual: Callable[[Block], np.ndarray], covariance: np.ndarray) -> Weigh:
    """Return weights 0 for isolated spikes of any channel's residual against a running median, else 1.

    What the model cannot explain but changes smoothly is kept: it is a gap, not an outlier. `covariance`:
    (n_channels, n_channels) of one sample's residual by the stated noise; the scale is the larger of it and
    of what the block itself shows.
    """
    stated = np.sqrt(np.diag(covariance))[:, None]

    def weigh(block: Block) -> np.ndarray:
        r = residual(block)
        jump = np.abs(r - median_filter(r, size=(1, WINDOW), mode="nearest"))
        scale = np.maximum(1.4826 * np.median(jump, axis=1, keepdims=True), stated)
        return np.all(jump <= SPIKE * scale, axis=0).astype(float)

    return weigh


def tukey(residual: Callable[[Block], np.ndarray], covariance: np.ndarray) -> Weigh:
    """Return Tukey's biweight of the residual's Mahalanobis distance, its scale robust over each block.

    `covariance`: (n_channels, n_channels) of one sample's residual.
    """
    whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T
    channels = len(covariance)
    typical = float(np.sqrt(2 * gammaincinv(channels / 2, 0.5) / channels))  # median of Gaussian noise

    def weigh(block: Block) -> np.ndarray:
        distance = np.linalg.norm(whiten @ residual(block), axis=0) / np.sqrt(channels)
        scale = max(float(np.median(distance)) / typical, 1.0)
        u = np.minimum(distance / (TUKEY * scale), 1.0)
        return (1 - u**2) ** 2

    return weigh
