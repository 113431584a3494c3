"""Problems with known optima, shared by the tests of solvers. `known` is (x, cost) of the global optimum."""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np
from nist import derivatives

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

# NIST StRD, Misra1a: y = b1 (1 - exp(-b2 x)); certified values to 11 digits, the first of NIST's starts.
MISRA_X = [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0]
MISRA_Y = [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78]
MISRA1A = _known(
    "misra1a",
    2,
    lambda b: casadi.sumsqr(casadi.DM(MISRA_Y) - b[0] * (1 - casadi.exp(-b[1] * casadi.DM(MISRA_X)))),
    [0.0, 0.0],
    [1000.0, 0.01],
    [2.3894212918e02, 5.5015643181e-04],
    1.2455138894e-01,
    [500.0, 0.0001],
)

GLOBAL = (SPHERE, ROSENBROCK, HS4, HS5, MISRA1A)
LOCAL = (SPHERE, ROSENBROCK, HS1, HS2, HS3, HS4, HS5, MISRA1A)
