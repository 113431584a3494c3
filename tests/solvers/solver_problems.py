"""Problems with known optima, shared by the tests of solvers. `known` is (x, cost) of the global optimum."""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np
from nist import MODELS, derivatives, sets

from solvers import Problem


@dataclass(frozen=True, eq=False)
class Known:
    """A problem given once as a casadi expression; cost and derivatives follow from it."""

    name: str
    expression: casadi.Function
    lower: list[float]
    upper: list[float]
    x: list[float]
    cost: float
    start: list[float]

    def problem(self) -> Problem:
        return Problem(self.cost_of, self.lower, self.upper, derivatives(self.expression))

    def cost_of(self, x: np.ndarray) -> np.ndarray:
        return np.array(self.expression(x.T)).ravel()


def _known(name, dim, formula, lower, upper, x, cost, start) -> Known:
    symbol = casadi.SX.sym("x", dim)
    return Known(name, casadi.Function("f", [symbol], [formula(symbol)]), lower, upper, x, cost, start)


def _rosenbrock(x):
    return casadi.sum1(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)


AT = [0.7, -1.3, 2.1, 0.4, -0.2]
SPHERE = _known("sphere", 5, lambda x: casadi.sumsqr(x - AT), [-5.0] * 5, [5.0] * 5, AT, 0.0, [4.0] * 5)
ROSENBROCK = _known("rosenbrock", 2, _rosenbrock, [-2.0, -2.0], [2.0, 2.0], [1.0, 1.0], 0.0, [-1.2, 1.0])

# Hock & Schittkowski, Test Examples for Nonlinear Programming Codes, 1981, problems 1 to 5: bounds only.
HS1 = _known(
    "hs1", 2, _rosenbrock, [-np.inf, -1.5], [np.inf, np.inf], [1.0, 1.0], 0.0, [-2.0, 1.0]
)  # fmt: skip
_a = np.sqrt(598.0 / 1200.0)
_hs2 = 2.0 * _a * np.cos(np.arccos(1.0 / (400.0 * _a**3)) / 3.0)
HS2 = _known(
    "hs2",
    2,
    _rosenbrock,
    [-np.inf, 1.5],
    [np.inf, np.inf],
    [_hs2, 1.5],
    100.0 * (1.5 - _hs2**2) ** 2 + (1.0 - _hs2) ** 2,
    [2.0, 5.0],  # the book's start ends in its second local optimum
)
HS3 = _known(
    "hs3",
    2,
    lambda x: x[1] + 1e-5 * (x[1] - x[0]) ** 2,
    [-np.inf, 0.0],
    [np.inf, np.inf],
    [0.0, 0.0],
    0.0,
    [10.0, 1.0],
)
HS4 = _known(
    "hs4",
    2,
    lambda x: (x[0] + 1) ** 3 / 3 + x[1],
    [1.0, 0.0],
    [99.0, 99.0],
    [1.0, 0.0],
    8 / 3,
    [1.125, 0.125],
)
HS5 = _known(
    "hs5",
    2,
    lambda x: casadi.sin(x[0] + x[1]) + (x[0] - x[1]) ** 2 - 1.5 * x[0] + 2.5 * x[1] + 1,
    [-1.5, -3.0],
    [4.0, 3.0],
    [0.5 - np.pi / 3, -0.5 - np.pi / 3],
    -np.sqrt(3.0) / 2 - np.pi / 3,
    [0.0, 0.0],
)

MISRA = sets()["Misra1a"]
MISRA1A = _known(
    "misra1a",
    2,
    lambda b: casadi.sumsqr(casadi.DM(MISRA.y) - MODELS["Misra1a"](casadi.vertsplit(b), casadi.DM(MISRA.x))),
    [0.0, 0.0],
    [1000.0, 0.01],
    MISRA.values.tolist(),
    MISRA.rss,
    MISRA.starts[0].tolist(),
)

GLOBAL = (SPHERE, ROSENBROCK, HS4, HS5, MISRA1A)
LOCAL = (SPHERE, ROSENBROCK, HS1, HS2, HS3, HS4, HS5, MISRA1A)
