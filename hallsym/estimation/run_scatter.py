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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hallsym.estimation.normal_equations import inverse

TOGETHER = 128
"""Runs that are computed at once: intermediate matrices of more cost memory and no time."""
ALONE = 1e-3
"""1 - leverage below which a run determines a direction alone: its scores say nothing of its errors there."""


@dataclass(frozen=True, eq=False)
class RunScatter:
    """Scores of r runs about n parameters.

    `root`: (n, n) K. `leverage`: (r, n, n) J. `scores`: (r, n) t. `by_noise`: (n, n) covariance by the noise
    of what all runs bring into the estimate, 1 where all samples of a run are alike; `lost`: sum over runs of
    the trace of J times what that run brings, by which scores are smaller.
    """

    root: np.ndarray
    leverage: np.ndarray
    scores: np.ndarray
    by_noise: np.ndarray
    lost: float

    @staticmethod
    def of(runs: np.ndarray, scores: np.ndarray, known: np.ndarray | None = None) -> "RunScatter":
        """Change to the coordinates from those of the parameters.

        `runs`: (r, n, n) information, which becomes the leverage in its place. `scores`: (r, n). `known`:
        (r, n, n) covariance of the scores by the noise, None where it is the information.
        """
        naive = inverse(runs.sum(axis=0))
        scale = np.sqrt(np.diag(naive))
        K = scale[:, None] * np.linalg.cholesky(naive / np.outer(scale, scale))
        by_noise, lost = np.zeros_like(naive), 0.0
        for some in _parts(len(runs)):
            J = runs[some] = K.T @ runs[some] @ K
            brought = J if known is None else K.T @ known[some] @ K
            by_noise += brought.sum(axis=0)
            lost += float(np.einsum("rij,rji->", J, brought))
        return RunScatter(K, runs, scores @ K, by_noise, lost)

    @cached_property
    def _powers(self) -> tuple[np.ndarray, float]:
        """Sum over runs of J^2, (n, n), and of the trace of J^3."""
        squares, cubes = np.zeros_like(self.root), 0.0
        for J in self._leverages():
            square = J @ J
            squares += square.sum(axis=0)
            cubes += float(np.einsum("rij,rji->", square, J))
        return squares, cubes

    def _leverages(self) -> Iterator[np.ndarray]:
        return (self.leverage[some] for some in _parts(len(self.leverage)))

    @cached_property
    def expected(self) -> float:
        """Sum of squares of all scores that noise alone predicts."""
        squares, _ = self._powers
        return float(np.trace(self.by_noise)) - 2.0 * self.lost + float(np.sum(squares * self.by_noise))

    @cached_property
    def ratio(self) -> float:
        """Sum of squares of all scores over what noise predicts; 1 where there is nothing to compare."""
        squares = float(np.einsum("ri,ri->", self.scores, self.scores))
        return squares / self.expected if self.expected > ALONE * len(self.root) else 1.0

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Of `ratio`: 2 mean^2 / variance, for leverages as they are."""
        squares, cubes = self._powers
        variance = float(np.trace(squares)) - 2.0 * cubes + float(np.sum(squares * squares))
        mean = len(self.root) - float(np.trace(squares))
        return max(mean**2 / variance, 1.0) if variance > ALONE**2 else 1.0

    def _adjusted(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield for some runs at a time J (r, n, n), and (1 - J)^(-1/2) without the directions that a run
        determines alone (r, n, n)."""
        for J in self._leverages():
            share, axes = np.linalg.eigh(J)
            seen = 1.0 - share > ALONE
            grow = np.where(seen, 1.0 / np.sqrt(np.where(seen, 1.0 - share, 1.0)), 0.0)
            yield J, (axes * grow[:, None, :]) @ np.swapaxes(axes, 1, 2)

    @cached_property
    def _alone(self) -> np.ndarray:
        """Leverage in the directions that a run determines alone, of all runs, (n, n)."""
        out = np.zeros_like(self.root)
        for J in self._leverages():
            share, axes = np.linalg.eigh(J)
            share = np.where(1.0 - share > ALONE, 0.0, share)
            out += np.einsum("rik,rk,rjk->ij", axes, share, axes)
        return out

    def covariance(self, least: float) -> np.ndarray:
        """Return the covariance of the parameters, (n, n).

        A direction that one run determines alone has the scatter of all directions together, times what noise
        predicts for it, and no less than `least` times that.
        """
        parts = zip(_parts(len(self.scores)), self._adjusted(), strict=True)
        grown = np.concatenate(
            [np.einsum("rij,rj->ri", adjust, self.scores[some]) for some, (_, adjust) in parts]
        )
        inner = grown.T @ grown + max(self.ratio, least) * self._alone
        return self.root @ inner @ self.root.T

    def degrees_of_freedom_of(self, gradients: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (m,) of the variances of linear combinations (m, n) of parameters.

        Bell and McCaffrey's: of the chi-square with the mean and the variance that noise alone gives the
        estimate of that variance. Where one run determines a part alone, that part has those of `ratio`.
        """
        along = gradients @ self.root
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0, size, 1.0)
        m, n = along.shape
        mean, variance, across = np.zeros(m), np.zeros(m), np.zeros((m, n, n))
        for J, adjust in self._adjusted():
            w = np.einsum("rij,mj->rmi", adjust, along)
            y = np.einsum("rmi,rij->rmj", w, J)
            own = np.einsum("rmi,rmi->rm", w, y)
            mean += own.sum(axis=0) - np.einsum("rmi,rmi->m", y, y)
            across += np.einsum("rmi,rmj->mij", y, y)
            variance += (own**2).sum(axis=0) - 2.0 * np.einsum("rm,rmi,rmi->m", own, y, y)
        variance += np.einsum("mij,mij->m", across, across)
        pooled = np.einsum("mi,ij,mj->m", along, self._alone, along)
        spread = variance + pooled**2 / self.degrees_of_freedom
        return np.maximum((mean + pooled) ** 2 / np.maximum(spread, 1e-300), 1.0)


def _parts(runs: int) -> Iterator[slice]:
    return (slice(start, start + TOGETHER) for start in range(0, runs, TOGETHER))
