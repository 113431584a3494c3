"""Polynomials of a model's columns: coefficients as expressions of the parameters, by differentiation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import factorial

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.model import Model

MOST_TERMS = 200
MOST_DEGREE = 8
NEGLIGIBLE = 1e-13
"""Size [m, rad, 1] below which a term of a Taylor series is left out."""

Row = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Terms of one scalar: exponents over `variables` -> coefficient, an SX of the parameters."""

    variables: tuple[str, ...]
    terms: Mapping[Row, ca.SX]

    @property
    def constant(self) -> ca.SX:
        """The term that no variable enters."""
        return self.terms.get((0,) * len(self.variables), ca.SX(0))

    @property
    def rest(self) -> list[Row]:
        """Exponents of the other terms, the highest degree, so the smallest, first."""
        return sorted((row for row in self.terms if sum(row)), key=lambda row: (-sum(row), row))

    @property
    def rows(self) -> list[Row]:
        """Exponents of all terms, the constant one last."""
        return [*self.rest, *([] if self.constant.is_zero() else [(0,) * len(self.variables)])]

    def label(self, row: Row) -> str:
        """Name of a monomial, such as `z_m*z_m`."""
        return "*".join(name for name, power in zip(self.variables, row, strict=True) for _ in range(power))

    def of(self, symbols: ca.SX) -> ca.SX:
        """Return the polynomial of `symbols` (n_variables,)."""
        total = ca.SX(0)
        for row, coefficient in self.terms.items():
            term = coefficient
            for v, power in enumerate(row):
                for _ in range(power):
                    term = term * symbols[v]
            total = total + term
        return total


def polynomial(expression: ca.SX, symbols: ca.SX, variables: Sequence[str], what: str) -> Polynomial:
    """Return the terms of a scalar `expression` of `symbols` (v,), named `variables`.

    Raises `InputError` where there is no end to them; whether they reproduce it is for the caller to check.
    """
    origin = ca.SX.zeros(symbols.numel())
    level: dict[Row, ca.SX] = {(0,) * len(variables): expression}
    terms: dict[Row, ca.SX] = {}
    while level:
        higher: dict[Row, ca.SX] = {}
        for row, derivative in level.items():
            scale = 1
            for power in row:
                scale *= factorial(power)
            value = ca.substitute(derivative, symbols, origin) / scale
            if not value.is_zero():
                terms[row] = value
            slopes = ca.jacobian(derivative, symbols)
            last = max((v for v, power in enumerate(row) if power), default=0)
            for v in range(last, len(variables)):
                if slopes[:, v].nnz() and not ca.SX(slopes[:, v]).is_zero():
                    higher[tuple(k + (i == v) for i, k in enumerate(row))] = slopes[:, v]
        level = higher
        if len(terms) > MOST_TERMS or any(sum(row) > MOST_DEGREE for row in level):
            raise InputError(
                f"C is generated for polynomials of the pose and the state only; {what} is none. Give a "
                "quantity of one column that is not polynomial, such as sin Rz, through Signals.derive."
            )
    return Polynomial(tuple(variables), terms)


def without_derived(model: Model, expression: ca.SX, reach: Mapping[str, float]) -> ca.SX:
    """Return `expression` with each derived quantity, such as sin Rz, as its Taylor series.

    `reach`: largest magnitude of each column. No libm at run time: the series ends where its terms do not
    count any more.
    """
    s = model.symbols
    columns = dict(zip((*model.pose, *model.state), ca.vertsplit(ca.vertcat(s.pose, s.state)), strict=True))
    for k in range(s.derived.numel()):
        series = _taylor(s.derived_as[k], columns, reach, str(s.derived[k]))
        expression = ca.substitute(expression, s.derived[k], series)
    return expression


def _taylor(expression: ca.SX, columns: Mapping[str, ca.SX], reach: Mapping[str, float], name: str) -> ca.SX:
    of = [column for column, symbol in columns.items() if ca.depends_on(expression, symbol)]
    if len(of) != 1:
        raise InputError(
            f"C is generated for derived quantities of one column; {name!r} depends on {len(of)} columns."
        )
    symbol, most = columns[of[0]], reach[of[0]]
    series, derivative, small = ca.SX(0), expression, 0
    for n in range(2 * MOST_DEGREE):
        factor = float(ca.evalf(ca.substitute(derivative, symbol, 0))) / factorial(n)
        if not np.isfinite(factor):
            break
        small = small + 1 if abs(factor) * most**n < NEGLIGIBLE else 0
        if small == 3:
            return series
        if factor and not small:
            series = series + factor * symbol**n
        derivative = ca.jacobian(derivative, symbol)
    raise InputError(f"Derived quantity {name!r} has no short Taylor series over {of[0]} within +-{most:g}.")
