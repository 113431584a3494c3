"""Scalar functions of the parameters whose uncertainty is asked for: a parameter, a combination of some."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.model.model import Combination, Model


@dataclass(frozen=True, eq=False)
class Quantity:
    """A named scalar g(p) of the n parameters of a model, with exact derivatives.

    `lower`, `upper`: values that it cannot leave; infinite where only the bounds of the parameters count.
    `symbol` (n,) and `expression` (scalar) define it in CasADi.
    """

    name: str
    unit: str
    lower: float
    upper: float
    symbol: ca.SX
    expression: ca.SX

    @cached_property
    def _first(self) -> ca.Function:
        gradient = ca.gradient(self.expression, self.symbol)
        return ca.Function("first", [self.symbol], [ca.densify(self.expression), ca.densify(gradient)])

    @cached_property
    def _hessian(self) -> ca.Function:
        hessian, _ = ca.hessian(self.expression, self.symbol)
        return ca.Function("hessian", [self.symbol], [ca.densify(hessian)])

    @cached_property
    def linear(self) -> bool:
        """Whether the Hessian is zero everywhere."""
        return not any(ca.which_depends(self.expression, self.symbol, 2, False))

    def first(self, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the value and the gradient (n,) at `p` (n,)."""
        value, gradient = self._first(p)
        return float(value), np.asarray(gradient).ravel()

    def at(self, p: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the value, the gradient (n,) and the Hessian (n, n) at `p` (n,)."""
        hessian = np.zeros((len(p), len(p))) if self.linear else np.asarray(self._hessian(p))
        return *self.first(p), hessian

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the values at many points, (m, n) -> (m,)."""
        value, _ = self._first(np.ascontiguousarray(points.T))
        return np.asarray(value).ravel() if len(points) else np.zeros(0)


@lru_cache(maxsize=256)
def parameter(model: Model, name: str) -> Quantity:
    """Return one parameter of `model`, with its unit and bounds."""
    if name not in model.names:
        raise InputError(f"Model {model.name} has no parameter {name!r}{nearest(name, list(model.names))}.")
    k = model.names.index(name)
    p, symbol = model.parameters[k], model.symbols.parameters
    return Quantity(name, p.unit, p.lower, p.upper, symbol, symbol[k])


@lru_cache(maxsize=256)
def combination(model: Model, which: Combination) -> Quantity:
    """Return a named combination of `model`, such as a lever arm."""
    symbols = dict(zip(model.names, ca.vertsplit(model.symbols.parameters), strict=True))
    value = which.value(symbols)
    return Quantity(which.expression, which.unit, -np.inf, np.inf, model.symbols.parameters, value)


def linear(model: Model, gradient: Sequence[float] | np.ndarray, unit: str, name: str = "") -> Quantity:
    """Return the combination gradient . p; its name is what it reads like unless one is given."""
    factors = [float(factor) for factor in gradient]
    involved = [k for k, factor in enumerate(factors) if factor != 0.0]
    text = " + ".join(_term(factors[k], model.names[k]) for k in involved).replace("+ -", "- ")
    symbol = model.symbols.parameters
    value = sum((factors[k] * symbol[k] for k in involved), ca.SX(0))
    return Quantity(name or text, unit, -np.inf, np.inf, symbol, value)


def _term(factor: float, name: str) -> str:
    return name if factor == 1 else f"-{name}" if factor == -1 else f"{factor:.6g}*{name}"
