"""NIST StRD nonlinear regression: the 27 models as CasADi expressions, with data and certified values.

`nist_strd.txt` holds what NIST publishes, 11 digits of each certified number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import casadi as ca
import numpy as np

from solvers import Problem

Formula = Callable[[list[ca.SX], ca.DM], ca.SX]


def derivatives(expression: ca.Function) -> Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray]]:
    """Value, gradient and Hessian of a CasADi function of one column."""
    x = expression.sx_in(0)
    hessian, gradient = ca.hessian(expression(x), x)
    both = ca.Function("second_order", [x], [expression(x), ca.densify(gradient), ca.densify(hessian)])

    def at(point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        f, g, H = both(point)
        return float(f), np.array(g).ravel(), np.array(H)

    return at


def _polynomial(b: list[ca.SX], x: ca.DM) -> ca.SX:
    out = 0.0
    for factor in reversed(b):
        out = factor + out * x
    return out


def _gauss(b: list[ca.SX], x: ca.DM) -> ca.SX:
    bell = [b[k] * ca.exp(-((x - b[k + 1]) ** 2) / b[k + 2] ** 2) for k in (2, 5)]
    return b[0] * ca.exp(-b[1] * x) + bell[0] + bell[1]


def _lanczos(b: list[ca.SX], x: ca.DM) -> ca.SX:
    return sum(b[k] * ca.exp(-b[k + 1] * x) for k in (0, 2, 4))


def _enso(b: list[ca.SX], x: ca.DM) -> ca.SX:
    w = 2 * np.pi * x
    waves = [
        b[j] * ca.cos(w / t) + b[k] * ca.sin(w / t) for j, k, t in ((1, 2, 12), (4, 5, b[3]), (7, 8, b[6]))
    ]
    return b[0] + sum(waves)


def _cubic(b: list[ca.SX], x: ca.DM) -> ca.SX:
    return _polynomial(b[:4], x) / _polynomial([1, *b[4:]], x)


def _saturation(b: list[ca.SX], x: ca.DM) -> ca.SX:
    return b[0] * (1 - ca.exp(-b[1] * x))


def _decay(b: list[ca.SX], x: ca.DM) -> ca.SX:
    return ca.exp(-b[0] * x) / (b[1] + b[2] * x)


MODELS: dict[str, Formula] = {
    "Misra1a": _saturation,
    "Chwirut2": _decay,
    "Chwirut1": _decay,
    "Lanczos3": _lanczos,
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** (-2)),
    "Kirby2": lambda b, x: _polynomial(b[:3], x) / _polynomial([1, *b[3:]], x),
    "Hahn1": _cubic,
    "Nelson": lambda b, x: b[0] - b[1] * x[:, 0] * ca.exp(-b[2] * x[:, 1]),
    "MGH17": lambda b, x: b[0] + b[1] * ca.exp(-x * b[3]) + b[2] * ca.exp(-x * b[4]),
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Gauss3": _gauss,
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** (-0.5)),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Roszman1": lambda b, x: b[0] - b[1] * x - ca.atan(b[2] / (x - b[3])) / np.pi,
    "ENSO": _enso,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "Thurber": _cubic,
    "BoxBOD": _saturation,
    "Rat42": lambda b, x: b[0] / (1 + ca.exp(b[1] - b[2] * x)),
    "MGH10": lambda b, x: b[0] * ca.exp(b[1] / (x + b[2])),
    "Eckerle4": lambda b, x: b[0] / b[1] * ca.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Rat43": lambda b, x: b[0] / (1 + ca.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
}


@dataclass(frozen=True, eq=False)
class Certified:
    """One set: `starts` (2, n), certified `values` and `std` (n,), `rss`, and the rows of data."""

    name: str
    starts: np.ndarray
    values: np.ndarray
    std: np.ndarray
    rss: float
    y: np.ndarray
    x: np.ndarray

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX]:
        b = ca.SX.sym("b", len(self.values))
        y = np.log(self.y) if self.name == "Nelson" else self.y
        return b, ca.DM(y) - MODELS[self.name](ca.vertsplit(b), ca.DM(self.x))

    def problem(self, unit: np.ndarray) -> Problem:
        """Residual sum of squares as a function of b / unit, without bounds."""
        b, residual = self._symbols
        rss = ca.Function("rss", [b], [ca.substitute(ca.sumsqr(residual), b, ca.DM(unit) * b)])
        free = np.full(len(self.values), np.inf)
        return Problem(lambda x: np.array(rss(x.T)).ravel(), -free, free, derivatives(rss))

    def residual(self, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (m,) and their exact Jacobian (m, n)."""
        symbol, residual = self._symbols
        both = ca.Function("residual", [symbol], [residual, ca.densify(ca.jacobian(residual, symbol))])
        r, J = both(b)
        return np.asarray(r).ravel(), np.asarray(J)


@cache
def sets() -> dict[str, Certified]:
    """Return all sets by name, in the order of NIST's list."""
    out: dict[str, Certified] = {}
    text = (Path(__file__).parent / "nist_strd.txt").read_text()
    for part in text.split("\n[")[1:]:
        name, *lines = part.splitlines()
        name = name.rstrip("]")
        b = np.array([[float(v) for v in line.split()[1:]] for line in lines if line.startswith("b ")])
        (rss,) = (float(line.split()[1]) for line in lines if line.startswith("rss"))
        data = np.array([[float(v) for v in line.split()] for line in lines if line[0] not in "br"])
        out[name] = Certified(name, b[:, :2].T, b[:, 2], b[:, 3], rss, data[:, 0], np.squeeze(data[:, 1:]))
    return out
