"""Which determined parameters are traded off against each other, in the order in which they are shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from hallsym.estimation import Fit
from hallsym.inference.verdict import TRADED


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation of estimated parameters, `values` (n, n); those that hang together stand side by side."""

    names: tuple[str, ...]
    values: np.ndarray


def correlation_of(fit: Fit) -> Correlation:
    """Return the correlation of the free parameters that the data of a fit determine."""
    spread = np.sqrt(np.diag(fit.covariance))
    known = np.asarray(fit.determined) & (spread > 0)
    scale = np.where(known, spread, np.nan)
    every = fit.covariance / np.outer(scale, scale)
    order = [k for group in blocks(every) for k in group]
    return Correlation(tuple(fit.model.names[k] for k in order), every[np.ix_(order, order)])


def blocks(correlation: np.ndarray, least: float = TRADED) -> list[list[int]]:
    """Return the estimated parameters, (n, n) correlation not nan, in groups that hang together.

    Two are in one group when a chain of correlations of at least `least` joins them.
    """
    known = np.flatnonzero(np.isfinite(np.diag(correlation)))
    joined = np.abs(correlation[np.ix_(known, known)]) >= least
    _, label = connected_components(joined, directed=False)
    return [[int(k) for k in known[label == group]] for group in dict.fromkeys(label.tolist())]
