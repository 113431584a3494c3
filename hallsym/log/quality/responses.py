"""The record by which a log is judged against a model: what readings answered to references, by run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Responses:
    """Slopes d reading / d reference of each run, by linear least squares, and what they leave.

    `slopes`, `std`: (runs, n_pose, n_channels), 0 for a reference that did not move apart from others.
    `moved`: (runs, n_pose). `together`: the slopes with all references, each of which may mean nothing alone.
    `unexplained`: (runs, n_channels) share of a reading's variance that the references leave, 0 where a
    channel hears only noise. `signal`: (runs, n_channels) variance of a reading over that of its noise.
    `products`: (runs, n_pose, n_pose) of the references, `total`: (runs, n_channels) sums of squares of the
    readings, means taken out.
    """

    model: Model
    runs: tuple[int, ...]
    slopes: np.ndarray
    std: np.ndarray
    moved: np.ndarray
    unexplained: np.ndarray
    signal: np.ndarray
    products: np.ndarray
    total: np.ndarray
    together: np.ndarray

    def misfit(self, slopes: np.ndarray) -> np.ndarray:
        """Return what other slopes (n_pose, n_channels) leave of each run's readings, (runs, n_channels).

        As a share of their variance, beside what the run's own slopes leave.
        """
        off = self.together - slopes
        left = np.einsum("rjk,rjl,rlk->rk", off, self.products, off)
        return np.asarray(left / np.maximum(self.total, 1e-300))


@dataclass(frozen=True, eq=False)
class Products:
    """Products of columns by run: features (runs, f, f), with readings (runs, f, K), of readings (runs, K).

    `counts`: samples (runs,). `variance`: (K,) of a residual, by the noise of readings and references;
    `of_references`: the part of the latter.
    """

    runs: tuple[int, ...]
    features: np.ndarray
    readings: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    variance: np.ndarray
    of_references: np.ndarray

    def coefficients(self, weights: np.ndarray) -> np.ndarray:
        """Return least squares of weighted runs, (m, runs) -> (m, f, K)."""
        square = np.tensordot(weights, self.features, axes=1)
        right = np.tensordot(weights, self.readings, axes=1)
        scale = 1.0 / np.sqrt(np.maximum(np.einsum("...jj->...j", square), 1e-300))
        outer = scale[..., :, None] * scale[..., None, :]
        inverse = np.linalg.pinv(square * outer, rcond=1e-10, hermitian=True)
        return np.asarray(scale[..., :, None] * (inverse @ (scale[..., :, None] * right)))

    def chi_squares(self, coefficients: np.ndarray) -> np.ndarray:
        """Return chi-square of each run and channel, (m, f, K) -> (m, runs, K)."""
        cross = np.einsum("mfk,rfk->mrk", coefficients, self.readings)
        inner = self.features @ coefficients[:, None]
        square = np.einsum("mfk,mrfk->mrk", coefficients, inner)
        return np.maximum(self.squares - 2 * cross + square, 0.0) / self.variance
