"""The median of short arrays, thousands of times: `np.median` takes four times as long on 50 numbers.

Numbers are sorted: numpy sorts with vector instructions, and `np.partition` about three places of each row of
a matrix takes four times as long.
"""

import numpy as np


def median(values: np.ndarray) -> float:
    """Return the median of numbers (n,), nan where there is none or one of them is nan.

    >>> median(np.array([3.0, 1.0, 2.0, 10.0]))
    2.5
    """
    n = len(values)
    if n == 0:
        return np.nan
    half = n // 2
    ordered = np.sort(values)
    if np.isnan(ordered[-1]):  # nan sorts to the end
        return np.nan
    return float(ordered[half]) if n % 2 else float(0.5 * (ordered[half - 1] + ordered[half]))


def medians(rows: np.ndarray) -> np.ndarray:
    """Return the median of each row (c, n), n at least 1; nan where one of its numbers is nan.

    >>> medians(np.array([[3.0, 1.0, 2.0, 10.0], [1.0, 1.0, 1.0, 9.0]]))
    array([2.5, 1. ])
    """
    return middles(np.sort(rows, axis=1))


def middles(ordered: np.ndarray) -> np.ndarray:
    """Return the median of each row (c, n) of ascending numbers; nan where one of them, the last, is nan."""
    half, odd = ordered.shape[1] // 2, ordered.shape[1] % 2
    middle = ordered[:, half] if odd else 0.5 * (ordered[:, half - 1] + ordered[:, half])
    return np.where(np.isnan(ordered[:, -1]), np.nan, middle)
