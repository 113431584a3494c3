"""Write a model's reading as a sum of data-only features with parameter-only coefficients.

A reading that is polynomial in the logged columns (and in derived ones such as 1 - cos Rz) is linear in
their monomials: reading = sum_j f_j(data) c_j(parameters, zeros). Found by differentiation, not declared by
the family, so an effect that adds a term adds its features by itself.
"""

from dataclasses import dataclass
from functools import cached_property
from math import comb, factorial, prod

import casadi as ca
import numpy as np

from hallsym.arrays import on_arrays
from hallsym.errors import InputError
from hallsym.model import Model

MAX_FEATURES = 120
MAX_DEGREE = 6


@dataclass(frozen=True, eq=False)
class Features:
    """Monomials of a model's reading, those that carry the zeros of a run first.

    `exponents`: shape (n_features, n_variables), over pose, state and derived variables.
    `n_zero`: how many of the first features have a coefficient that depends on a run's zeros.
    """

    model: Model
    exponents: np.ndarray
    n_zero: int

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.exponents)

    @cached_property
    def _variables(self) -> tuple[ca.SX, ca.SX]:
        s = self.model.symbols
        centre = ca.SX.sym("centre", s.pose.numel() + s.state.numel() + s.derived.numel())
        return ca.vertcat(s.pose, s.state, s.derived), centre

    @cached_property
    def _monomials(self) -> ca.SX:
        variables, centre = self._variables
        shifted = variables - centre
        rows = [
            prod((shifted[v] for v, power in enumerate(row) for _ in range(power)), start=ca.SX(1))
            for row in self.exponents
        ]
        return self.model.symbols.full(ca.vertcat(*rows))

    @cached_property
    def values(self):
        """`(pose, state, centre) -> [features]` on arrays of samples; (n_features, samples)."""
        s, centre = self.model.symbols, self._variables[1]
        return on_arrays(ca.Function("features", [s.pose, s.state, centre], [ca.densify(self._monomials)]))

    @cached_property
    def slopes(self):
        """`(pose, state, centre) -> [d feature / d column]`, (n_columns * n_features, samples)."""
        s, centre = self.model.symbols, self._variables[1]
        jacobian = ca.jacobian(self._monomials, ca.vertcat(s.pose, s.state))
        return on_arrays(ca.Function("slopes", [s.pose, s.state, centre], [ca.densify(jacobian)]))

    @cached_property
    def variables(self) -> ca.Function:
        """`(pose, state) -> pose, state and derived` variables, of which the features are monomials."""
        s = self.model.symbols
        return ca.Function("variables", [s.pose, s.state], [s.full(self._variables[0])])

    @cached_property
    def coefficients(self) -> ca.Function:
        """`(parameters, zeros, centre) -> c`, shape (n_features, n_channels): Taylor terms at the centre."""
        s, (variables, centre) = self.model.symbols, self._variables
        rows = []
        for row in self.exponents:
            term = _derivative(s.reading, variables, row) / prod(factorial(int(k)) for k in row)
            rows.append(ca.substitute(term, variables, centre).T)
        return ca.Function("coefficients", [s.parameters, s.zeros, centre], [ca.densify(ca.vertcat(*rows))])

    def label(self, j: int) -> str:
        """Readable name of feature j, such as `x_m*z_m`; `1` for the constant."""
        s = self.model
        names = [*s.pose, *s.state, *(str(d) for d in ca.vertsplit(s.symbols.derived))]
        return "*".join(names[v] for v, power in enumerate(self.exponents[j]) for _ in range(power)) or "1"

    def shift(self, offset: np.ndarray) -> np.ndarray:
        """Matrix T with c(centre) = T c(centre - offset): the binomial theorem on every monomial."""
        n = self.size
        matrix = np.zeros((n, n))
        for i, low in enumerate(self.exponents):
            for j, high in enumerate(self.exponents):
                if np.all(high >= low):
                    matrix[i, j] = prod(
                        comb(int(h), int(k)) * float(o) ** int(h - k)
                        for h, k, o in zip(high, low, offset, strict=True)
                    )
        return matrix


def find_features(model: Model) -> Features:
    """Return the monomials of the model's reading.

    Raises `InputError` when the reading is no polynomial of degree <= 6 in the logged and derived columns.
    """
    s = model.symbols
    variables = ca.vertcat(s.pose, s.state, s.derived)
    zero = (0,) * variables.numel()
    found, level = {zero: s.reading}, {zero: s.reading}
    while level:
        level = {
            higher: derivative
            for row, expression in level.items()
            for higher, derivative in _higher(row, expression, variables)
        }
        found |= level
        too_high = any(sum(row) > MAX_DEGREE for row in level)
        if too_high or len(found) > MAX_FEATURES:
            raise InputError(
                f"Model {model.name} with effects {', '.join(model.effects) or 'none'} has readings that are "
                "not a polynomial of the logged columns, so its runs have no summary; "
                "derive the non-polynomial quantity with Signals.derive."
            )
    carries_zero = {row: _depends(expression, s.zeros) for row, expression in found.items()}
    order = sorted(found, key=lambda row: (not carries_zero[row], sum(row), [-k for k in row]))
    return Features(model, np.array(order, dtype=int), sum(carries_zero.values()))


def _higher(row: tuple[int, ...], expression: ca.SX, variables: ca.SX):
    jacobian = ca.jacobian(expression, variables)
    for v in range(variables.numel()):
        if jacobian[:, v].nnz() and not ca.SX(jacobian[:, v]).is_zero():
            yield tuple(k + (i == v) for i, k in enumerate(row)), jacobian[:, v]


def _depends(expression: ca.SX, symbols: ca.SX) -> bool:
    return symbols.numel() > 0 and bool(ca.depends_on(expression, symbols))


def _derivative(expression: ca.SX, variables: ca.SX, row: np.ndarray) -> ca.SX:
    for v, power in enumerate(row):
        for _ in range(power):
            expression = ca.jacobian(expression, variables[v])
    return expression
