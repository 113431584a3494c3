"""The continuous relaxation: shares instead of whole runs, and a bound that no plan can beat.

Multiplicative algorithm (Silvey, Titterington, Torsney, Commun. Stat. A 7 (1978) 1379,
doi:10.1080/03610927808827719); the bound is the general equivalence theorem (Kiefer & Wolfowitz, Can. J.
Math. 12 (1960) 363, doi:10.4153/CJM-1960-030-4) in the form phi(M') <= tr(G M').
"""

from dataclasses import dataclass

import numpy as np

from hallsym.experiment.criteria import Criterion

ROUNDS, CLOSE = 600, 1e-3


@dataclass(frozen=True, eq=False)
class Relaxed:
    """`shares`: (candidates,) of the runs. `slope`: G (m, m) of the tightest bound that was met."""

    shares: np.ndarray
    slope: np.ndarray

    def bound(self, infos: np.ndarray, base: np.ndarray, runs: int) -> float:
        """Return what no plan of `runs` runs exceeds: tr(G base) + runs * max_i tr(G infos_i)."""
        gains = infos.reshape(len(infos), -1) @ self.slope.ravel()
        return float(np.sum(self.slope * base)) + runs * float(gains.max())


def relax(infos: np.ndarray, base: np.ndarray, runs: int, criterion: Criterion) -> Relaxed:
    """Maximise phi(base + runs * sum_i share_i infos_i) over shares that sum to 1.

    `infos`: (candidates, m, m). `base`: (m, m), positive definite, what is known before.
    """
    flat = infos.reshape(len(infos), -1)
    shares, bound, tightest = np.full(len(infos), 1.0 / len(infos)), np.inf, base
    power = 1.0 if criterion.name == "D" else 0.5
    best, value = shares, 0.0
    for k in range(ROUNDS):
        M = base + runs * (shares @ flat).reshape(base.shape)
        G = criterion.slope(M)
        gains = runs * (flat @ G.ravel())
        here = float(np.sum(G * base)) + float(gains.max())
        if here < bound:
            bound, tightest = here, G
        now = float(criterion.values(M))
        if now > value:
            best, value = shares, now
        if bound <= (1.0 + CLOSE) * value:
            break
        step = power if criterion.name in "DA" else power / (1.0 + k / 60.0)
        shares = shares * (gains / (shares @ gains)) ** step
        shares = shares / shares.sum()
    return Relaxed(best, tightest)
