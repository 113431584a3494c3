"""Results as plain numbers for JSON."""

from collections.abc import Iterable
from typing import Any

import numpy as np


def named(names: Iterable[str], values: Any) -> dict[str, Any]:
    """Return `{name: value}` of an array: numbers, or nested lists where it has more than one axis.

    >>> named(("x_m", "y_m"), np.array([1e-6, 2e-6]))
    {'x_m': 1e-06, 'y_m': 2e-06}
    """
    return dict(zip(names, np.asarray(values, dtype=float).tolist(), strict=True))
