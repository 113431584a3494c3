"""Covariance from the scatter between runs, with the degrees of freedom it has.

Bias-reduced linearisation, CR2: R. M. Bell and D. F. McCaffrey, Survey Methodology 28 (2002) 169; with the
offsets of the runs as absorbed effects: J. E. Pustejovsky and E. Tipton, J. Bus. Econ. Stat. 36 (2018) 672,
doi:10.1080/07350015.2016.1247004.

Coordinates are those in which the information of all runs together is the unit matrix: K K^T is the
covariance by the likelihood, J_g = K^T I_g K is the leverage of run g, and the J_g add up to 1. If noise
alone acts, the score t_g of a run at the optimum has the covariance J_g - J_g^2; (1 - J_g)^(-1/2) t_g has
J_g, what the errors of that run bring into the estimate. The squares of those add up to the covariance of
the estimate, whatever acts on a run as a whole.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

ALONE = 1e-3
"""1 - leverage below which a run determines a direction alone: its scores say nothing of its errors there."""


@dataclass(frozen=True, eq=False)
class RunScatter:
    """Scores of r runs about n parameters.

    `root`: (n, n) K. `leverage`: (r, n, n) J. `scores`: (r, n) t. `known`: (r, n, n) covariance by the
    noise of what each run's errors bring into the estimate, J itself where all samples of a run are alike.
    """

    root: np.ndarray
    leverage: np.ndarray
    scores: np.ndarray
    known: np.ndarray

    @staticmethod
    def of(runs: np.ndarray, scores: np.ndarray, known: np.ndarray, naive: np.ndarray) -> "RunScatter":
        """Change to the coordinates from those of the parameters: `runs`, `known` (r, n, n), `scores` (r, n).

        `naive`: (n, n) inverse of the sum of `runs`.
        """
        scale = np.sqrt(np.diag(naive))
        K = scale[:, None] * np.linalg.cholesky(naive / np.outer(scale, scale))
        J = K.T @ runs @ K
        return RunScatter(K, J, scores @ K, J if known is runs else K.T @ known @ K)

    @cached_property
    def by_noise(self) -> np.ndarray:
        """Covariance by noise of what all runs bring into the estimate, (n, n): 1 where samples are alike."""
        return np.asarray(self.known.sum(axis=0))

    @cached_property
    def _squares(self) -> np.ndarray:
        return self.leverage @ self.leverage

    @cached_property
    def expected(self) -> float:
        """Sum of squares of all scores that noise alone predicts."""
        n = float(np.trace(self.by_noise))
        lost = 2.0 * np.einsum("rij,rji->", self.leverage, self.known)
        return n - float(lost) + float(np.einsum("rij,ji->", self._squares, self.by_noise))

    @cached_property
    def ratio(self) -> float:
        """Sum of squares of all scores over what noise predicts; 1 where there is nothing to compare."""
        squares = float(np.einsum("ri,ri->", self.scores, self.scores))
        return squares / self.expected if self.expected > ALONE * len(self.root) else 1.0

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Of `ratio`: 2 mean^2 / variance, for leverages as they are."""
        total = self._squares.sum(axis=0)
        cubes = np.einsum("rij,rji->", self._squares, self.leverage)
        variance = float(np.trace(total) - 2.0 * cubes + np.einsum("ij,ji->", total, total))
        mean = len(self.root) - float(np.trace(total))
        return max(mean**2 / variance, 1.0) if variance > ALONE**2 else 1.0

    @cached_property
    def _adjusted(self) -> tuple[np.ndarray, np.ndarray]:
        """(1 - J)^(-1/2) without the directions that a run determines alone (r, n, n); those, (n, n)."""
        share, axes = np.linalg.eigh(self.leverage)
        seen = 1.0 - share > ALONE
        grow = np.where(seen, 1.0 / np.sqrt(np.where(seen, 1.0 - share, 1.0)), 0.0)
        turned = np.swapaxes(axes, 1, 2)
        alone = np.einsum("rik,rk,rjk->ij", axes, np.where(seen, 0.0, share), axes)
        return (axes * grow[:, None, :]) @ turned, alone

    def covariance(self, least: float) -> np.ndarray:
        """Return the covariance of the parameters, (n, n).

        A direction that one run determines alone has the scatter of all directions together, times what noise
        predicts for it, and no less than `least` times that.
        """
        adjust, alone = self._adjusted
        grown = np.einsum("rij,rj->ri", adjust, self.scores)
        inner = grown.T @ grown + max(self.ratio, least) * alone
        return self.root @ inner @ self.root.T

    def degrees_of_freedom_of(self, gradients: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (m,) of the variances of linear combinations (m, n) of parameters.

        Bell and McCaffrey's: of the chi-square with the mean and the variance that noise alone gives the
        estimate of that variance. Where one run determines a part alone, that part has those of `ratio`.
        """
        adjust, alone = self._adjusted
        along = gradients @ self.root
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0, size, 1.0)
        w = np.einsum("rij,mj->rmi", adjust, along)
        y = np.einsum("rmi,rij->rmj", w, self.leverage)
        own = np.einsum("rmi,rmi->rm", w, y)
        mean = own.sum(axis=0) - np.einsum("rmi,rmi->m", y, y)
        across = np.einsum("rmi,rmj->mij", y, y)
        variance = (own**2).sum(axis=0) - 2.0 * np.einsum("rm,rmi,rmi->m", own, y, y)
        variance += np.einsum("mij,mij->m", across, across)
        pooled = np.einsum("mi,ij,mj->m", along, alone, along)
        spread = variance + pooled**2 / self.degrees_of_freedom
        return np.maximum((mean + pooled) ** 2 / np.maximum(spread, 1e-300), 1.0)
