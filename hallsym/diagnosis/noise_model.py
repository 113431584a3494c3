"""Noise that looks like the residuals of a log: as large as stated, correlated in time as they are.

What the catalogue can explain is taken out first, so that a gap does not pass for correlated noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_toeplitz

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Effect, Facts
from hallsym.diagnosis.normal_equations import Accumulator
from hallsym.diagnosis.scores import candidates

ORDERS = 12
"""Highest order of the autoregression that is tried."""
SETTLE = 400
"""Samples for which a simulated noise runs before it counts."""


SPIKE = 5.0
"""Standard deviations at which a residual is clipped: a spike is no noise."""
ALIKE = 1e-7
"""Eigenvalue of the products of columns of unit length, over the largest, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Gaussian autoregressive noise: `coefficients` (order,), empty for white noise.

    `colour`: (K, K), turns K independent noises of unit variance into noise of the readings. `excess`:
    variance of the residuals over the stated one; `lag_one`: their autocorrelation at one sample.
    """

    coefficients: np.ndarray
    drive: float
    colour: np.ndarray
    excess: float
    lag_one: float

    def draw(self, run: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return noise of the readings, (K, rows); every run begins anew."""
        white = rng.standard_normal((len(self.colour), len(run)))
        if len(self.coefficients):
            from scipy.signal import lfilter

            edges = [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(run)]
            for first, last in pairwise(edges):
                settle = rng.standard_normal((len(white), SETTLE))
                driven = np.hstack([settle, white[:, first:last]]) * self.drive
                shaped = lfilter([1.0], np.concatenate([[1.0], -self.coefficients]), driven, axis=1)
                white[:, first:last] = shaped[:, SETTLE:]
        return self.colour @ white

    @property
    def text(self) -> str:
        """What the noise is, in words."""
        if not len(self.coefficients):
            return "white Gaussian noise of the stated size (the residuals show no correlation in time)"
        return (
            f"Gaussian noise of the stated size, autoregressive of order {len(self.coefficients)} as the "
            f"residuals (correlation of neighbouring samples {self.lag_one:.2f})"
        )


def residual_noise(base: Base, catalogue: Sequence[Effect], facts: Facts) -> ResidualNoise:
    """Return noise like the residuals of `base` on its log, what the catalogue explains taken out."""
    correlation, variance, count = _autocorrelation(base, catalogue, facts)
    coefficients, drive = _autoregression(correlation, count)
    colour = np.linalg.cholesky(base.covariance)
    return ResidualNoise(coefficients, drive, colour, variance, float(correlation[1]))


def _autocorrelation(base: Base, catalogue: Sequence[Effect], facts: Facts) -> tuple[np.ndarray, float, int]:
    """Autocorrelation (ORDERS + 1,) and variance of the whitened residual, and how many values it is from."""
    tried, _ = candidates(base, catalogue, facts)
    plain = {key: (model, new) for key, (_, _, model, new) in tried.items()}
    work = Accumulator(base, plain)

    def whitened() -> Iterator[np.ndarray]:
        """Columns [parameters | effects | residual] of each block, (c, K, samples), its zeros taken out."""
        for batch in work.batches():
            A = work.whitened(batch, None)
            for _, at in batch.parts():
                W = A[:, :, at].reshape(len(A), -1)
                zeros, rest = np.linalg.qr(W[: work.z].T)[0], W[work.z :]
                yield (rest - (rest @ zeros) @ zeros.T).reshape(len(rest), len(work.whiten), -1)

    M: np.ndarray = np.zeros((work.size - work.z,) * 2)
    for W in whitened():
        flat = W.reshape(len(W), -1)
        M += flat @ flat.T
    v = np.concatenate([-_explained(M), [1.0]])
    sums, squares, count = np.zeros(ORDERS + 1), 0.0, 0
    for W in whitened():
        r = np.einsum("cks,c->ks", W, v)
        squares, count = squares + float((r**2).sum()), count + r.size
        r = np.clip(r, -SPIKE, SPIKE)
        r = r - r.mean(axis=1, keepdims=True)
        for lag in range(min(ORDERS + 1, r.shape[1])):
            sums[lag] += float((r[:, lag:] * r[:, : r.shape[1] - lag]).sum())
    return sums / max(sums[0], 1e-300), squares / max(count - len(M), 1), count


def _explained(M: np.ndarray) -> np.ndarray:
    """Coefficients of all columns that explain the last; what is nearly alike is taken together."""
    A, b = M[:-1, :-1], M[:-1, -1]
    d = np.sqrt(np.maximum(np.diag(A), 0.0))
    d = np.where(d > 0, d, 1.0)
    size, basis = np.linalg.eigh(A / np.outer(d, d))
    keep = size > ALIKE * size[-1]
    return basis[:, keep] @ ((basis[:, keep].T @ (b / d)) / size[keep]) / d


def _autoregression(correlation: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Yule-Walker coefficients of the order that BIC prefers, and the deviation of what drives them."""
    best: tuple[float, np.ndarray, float] = (0.0, np.zeros(0), 1.0)
    for order in range(1, ORDERS + 1):
        try:
            a = solve_toeplitz(correlation[:order], correlation[1 : order + 1])
        except np.linalg.LinAlgError:
            break
        rest = 1.0 - float(a @ correlation[1 : order + 1])
        if not 1e-6 < rest <= 1.0:
            break
        score = count * float(np.log(rest)) + order * float(np.log(count))
        if score < best[0]:
            best = (score, a, float(np.sqrt(rest)))
    return best[1], best[2]
