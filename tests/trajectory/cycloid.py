"""The cycloid of the article, and curves through its points."""

from functools import cache

import numpy as np

from hallsym.trajectory import Curve, Nominal, nominal
from hallsym.trajectory.choose import Target, method_named

TEXT = "x = r*(t - sin(t)); y = r*(1 - cos(t))"
WHOLE = 2 * np.pi


@cache
def cycloid() -> Nominal:
    """r = 1 mm, one arch."""
    return nominal(TEXT, ("t", "0", "2*pi"), {"r": 1e-3})


@cache
def through(method: str, count: int, control: int = 0) -> Curve:
    return Target(cycloid()).made(method_named(method), count, control)


def sampled(curve: Curve, first: float = 0.0, last: float = WHOLE, samples: int = 20001) -> float:
    """Largest distance at the same parameter [um]."""
    t = np.linspace(first, last, samples)
    return 1e6 * float(np.linalg.norm(curve(t) - cycloid()(t), axis=1).max())
