"""Write a model's reading as a sum of data-only features with parameter-only coefficients.

A reading that is polynomial in the logged columns (and in derived ones such as 1 - cos Rz) is linear in
their monomials: reading = sum_j f_j(data) c_j(parameters, offsets). Features are found by differentiation, so
an effect that adds a term needs to declare none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from math import comb, factorial, prod

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.model.arrays import on_arrays, on_vectors
from hallsym.model.model import Model

MAX_FEATURES = 120
MAX_DEGREE = 6


@dataclass(frozen=True, eq=False)
class Tangent:
    """Coefficients that are linear in offsets and parameters: each feature moves one channel.

    `channel`: of each feature, (n_features,). `value`: coefficient of each at offsets of 0, (n_features,).
    `column`: what each of the first features is multiplied by, (m,), counted in [offsets | parameters]; the
    others have a coefficient of 1.
    """

    channel: np.ndarray
    value: np.ndarray
    column: np.ndarray

    @property
    def size(self) -> int:
        """Products of features."""
        return len(self.channel) ** 2


@dataclass(frozen=True, eq=False)
class Features:
    """Monomials of a model's reading, those that carry the offsets of a run first.

    `exponents`: shape (n_features, n_variables), over pose, state and derived variables.
    `n_zero`: how many of the first features have a coefficient that depends on a run's offsets.
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
    def values(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, centre) -> [features]` on arrays of samples; (n_features, samples)."""
        s, centre = self.model.symbols, self._variables[1]
        return on_arrays(ca.Function("features", [s.pose, s.state, centre], [ca.densify(self._monomials)]))

    @cached_property
    def slopes(self) -> Callable[..., list[np.ndarray]]:
        """`(pose, state, centre) -> [d feature / d column]` on arrays of samples, (entries, samples)."""
        s, centre, (columns, rows) = self.model.symbols, self._variables[1], self.slope_entries
        each = (self._jacobian[int(i), int(k)] for i, k in zip(rows, columns, strict=True))
        moved = ca.vertcat(ca.SX(0, 1), *each)
        return on_arrays(ca.Function("slopes", [s.pose, s.state, centre], [ca.densify(moved)]))

    @cached_property
    def _jacobian(self) -> ca.SX:
        return ca.jacobian(self._monomials, ca.vertcat(self.model.symbols.pose, self.model.symbols.state))

    @cached_property
    def slope_entries(self) -> np.ndarray:
        """Slopes that are not always 0: (column, feature), (2, entries).

        Features that carry offsets are left out: their slope with the state is a second-order weight, and
        without it the weight of a residual does not depend on the offsets.
        """
        rows, columns = np.array(self._jacobian.sparsity().get_triplet(), dtype=int)
        moved = rows >= self.n_zero
        return np.array([columns[moved], rows[moved]])

    @cached_property
    def slope_pairs(self) -> np.ndarray:
        """Pairs of these with one column: (column, i, j), i <= j features, (3, pairs)."""
        columns, rows = self.slope_entries
        first, second = self.entry_pairs
        return np.array([columns[first], rows[first], rows[second]])

    @cached_property
    def entry_pairs(self) -> np.ndarray:
        """The same pairs as numbers of their entries, (2, pairs)."""
        columns, rows = self.slope_entries
        parts = [np.zeros((2, 0), dtype=int)]
        for column in np.unique(columns):
            own = np.flatnonzero(columns == column)
            own = own[np.argsort(rows[own])]
            parts.append(own[np.array(np.triu_indices(len(own)))])
        return np.hstack(parts)

    @cached_property
    def variables(self) -> ca.Function:
        """`(pose, state) -> pose, state and derived` variables, of which the features are monomials."""
        s = self.model.symbols
        return ca.Function("variables", [s.pose, s.state], [s.full(self._variables[0])])

    @cached_property
    def coefficients(self) -> ca.Function:
        """`(parameters, offsets, centre) -> c`, (n_features, n_channels): Taylor terms at the centre."""
        s, (variables, centre) = self.model.symbols, self._variables
        rows = []
        for row in self.exponents:
            term = _derivative(s.reading, variables, row) / prod(factorial(int(k)) for k in row)
            rows.append(ca.substitute(term, variables, centre).T)
        return ca.Function("coefficients", [s.parameters, s.offsets, centre], [ca.densify(ca.vertcat(*rows))])

    @property
    def n_offsets(self) -> int:
        """Offsets of a run that these features carry: all of the model's, or none once projected out."""
        return len(self.model.offsets) if self.n_zero else 0

    @cached_property
    def without_offsets(self) -> "Features":
        """The features that are left once those that carry offsets are projected out."""
        return replace(self, exponents=self.exponents[self.n_zero :], n_zero=0)

    @cached_property
    def expressions(self) -> tuple[ca.Function, ca.Function]:
        """Coefficients with their derivatives, the offsets split off: reading = f . (c + sum_l d_l E_l).

        `(parameters, centre) -> [c, E_1, ...], d / d parameters`, each column flattened by channel, and
        `(parameters, centre, weights) -> Hessian` of the weighted sum of those columns.
        """
        p, centre = self.model.symbols.parameters, self._variables[1]
        offsets = ca.SX.sym("offsets", len(self.model.offsets))
        c = self.coefficients(p, offsets, centre)
        parts = [ca.vec(ca.substitute(c, offsets, ca.SX.zeros(offsets.numel())))]
        slopes = ca.jacobian(ca.vec(c), offsets)
        parts += [slopes[:, k] for k in range(self.n_offsets)]
        stacked = ca.densify(ca.horzcat(*parts))  # (n_features * n_channels, 1 + n_offsets)
        flat = ca.vec(stacked)
        weights = ca.SX.sym("weights", flat.numel())
        hessian, _ = ca.hessian(ca.dot(weights, flat), p)
        first = ca.Function("coefficients", [p, centre], [stacked, ca.densify(ca.jacobian(flat, p))])
        return first, ca.Function("curvature", [p, centre, weights], [ca.densify(hessian)])

    @cached_property
    def _expansion(self) -> tuple[Callable[..., Sequence[np.ndarray]], Callable[..., Sequence[np.ndarray]]]:
        """The same as functions of numbers."""
        first, curvature = (on_vectors(function) for function in self.expressions)
        return first, curvature

    def first(self, p: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return c and E_l, (1 + n_offsets, n_features, n_channels), c first, and their slopes.

        These are (1 + n_offsets, n_features, n, n_channels).
        """
        shape = (1 + self.n_offsets, len(self.model.channels), self.size)
        value, slope = self._expansion[0](p, centre)
        return (
            np.ascontiguousarray(np.swapaxes(value.T.reshape(shape), 1, 2)),
            np.ascontiguousarray(np.transpose(slope.reshape(*shape, -1), (0, 2, 3, 1))),
        )

    def curvature(self, p: np.ndarray, centre: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return sum of weights * d2 coefficient / dp2, (n, n), weights shaped as coefficients of `first`."""
        return self._expansion[1](p, centre, np.swapaxes(weights, 1, 2).ravel())[0]

    def population(self, points: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Return the coefficients c of parameter vectors (m, n), (m, n_features, n_channels)."""
        (flat,) = self._population(np.ascontiguousarray(points.T), centre)
        return np.transpose(flat.reshape(len(self.model.channels), self.size, len(points)), (2, 1, 0))

    @cached_property
    def _population(self) -> Callable[..., list[np.ndarray]]:
        p, centre = self.model.symbols.parameters, self._variables[1]
        c = self.coefficients(p, ca.SX.zeros(len(self.model.offsets)), centre)
        return on_arrays(ca.Function("population", [p, centre], [ca.densify(c)]))

    @property
    def std(self) -> np.ndarray | None:
        """Noise (n_columns,) of the logged columns where it is known: `slope_pairs` are one column then."""
        return None

    @property
    def point(self) -> np.ndarray | None:
        """Parameters (n,) that the features were taken at, if they depend on them."""
        return None

    @property
    def everywhere(self) -> "Features":
        """The features whose slopes do not depend on the point: one for all points of a tangent."""
        return self

    def tangent(self, p: np.ndarray) -> Tangent | None:
        """Return the coefficients at `p` if they are those of a tangent."""
        return None

    def slope_rows(self, p: np.ndarray) -> np.ndarray | None:
        """Return rows (m, n) whose null space no recording determines at `p`; None: use the coefficients."""
        return None

    def label(self, j: int) -> str:
        """Readable name of feature j, such as `x_m*z_m`; `1` for the constant."""
        return self._labels[j]

    @cached_property
    def _labels(self) -> list[str]:
        s = self.model
        names = [*s.pose, *s.state, *(str(d) for d in ca.vertsplit(s.symbols.derived))]
        return [
            "*".join(names[v] for v, power in enumerate(row) for _ in range(power)) or "1"
            for row in self.exponents
        ]

    def shift(self, offset: np.ndarray) -> np.ndarray:
        """Matrix T with c(centre) = T c(centre - offset): the binomial theorem on every monomial."""
        i, j, binomials = self._shifts
        matrix = np.zeros((self.size, self.size))
        powers = self.exponents[j] - self.exponents[i]
        matrix[i, j] = binomials * np.prod(np.asarray(offset, dtype=float) ** powers, axis=1)
        return matrix

    @cached_property
    def _shifts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Monomials i that a shifted monomial j of the same or higher powers contributes to; how often."""
        i, j = np.nonzero((self.exponents[None] >= self.exponents[:, None]).all(axis=2))
        pairs = zip(self.exponents[j].tolist(), self.exponents[i].tolist(), strict=True)
        return i, j, np.array([prod(map(comb, high, low)) for high, low in pairs], dtype=float)


@lru_cache(maxsize=64)
def find_features(model: Model) -> Features:
    """Return the monomials of the model's reading.

    Raises `InputError` when the reading is no polynomial of degree <= 6 in the logged and derived columns.
    """
    s = model.symbols
    variables = ca.vertcat(s.pose, s.state, s.derived)
    if not _of_low_degree(model, variables):
        raise _not_polynomial(model)
    found = derivatives(s.reading, variables, MAX_DEGREE, MAX_FEATURES)
    if found is None:
        raise _not_polynomial(model)
    carries_zero = {row: bool(len(model.offsets) and ca.depends_on(e, s.offsets)) for row, e in found.items()}
    order = sorted(found, key=lambda row: (not carries_zero[row], sum(row), [-k for k in row]))
    features = Features(model, np.array(order, dtype=int), sum(carries_zero.values()))
    if not _reproduces(features):
        raise _not_polynomial(model)
    return features


def _of_low_degree(model: Model, variables: ca.SX) -> bool:
    """Return whether the reading may be a polynomial: cheap, since no derivative is taken.

    Along a line of one variable the difference of order MAX_DEGREE + 1 of a polynomial vanishes. Lines of
    unit size, and of the size of a pose: a field that has faded at a metre is no polynomial near its magnets.
    """
    s, rng, order = model.symbols, np.random.default_rng(0), MAX_DEGREE + 1
    read = ca.Function("along", [s.parameters, s.offsets, variables], [s.reading])
    weights = np.array([(-1.0) ** k * comb(order, k) for k in range(order + 1)])
    p = model.nominal + 0.1 * rng.standard_normal(len(model.nominal))
    offsets, far = (rng.standard_normal(n) for n in (len(model.offsets), variables.numel()))
    near = np.concatenate([model.poses(1, rng)[:, 0], far[len(model.pose) :]])
    for at, v in product((far, near), range(len(far))):
        line = np.repeat(at[:, None], order + 1, axis=1)
        line[v] += (np.abs(near[v]) if at is near else 1.0) * np.linspace(-1.0, 1.0, order + 1)
        terms = np.asarray(read(p, offsets, line)) * weights
        # an exponential that leaves the range of numbers is no polynomial
        if not np.isfinite(terms).all() or not np.all(
            np.abs(terms.sum(axis=1)) <= 1e-9 * np.abs(terms).sum(axis=1)
        ):
            return False
    return True


def _reproduces(features: Features) -> bool:
    """Check the expansion far from its centre: |u| or a step has derivatives but is no polynomial."""
    model, rng = features.model, np.random.default_rng(0)
    s, (variables, _) = model.symbols, features._variables
    read = ca.Function("reading", [s.parameters, s.offsets, variables], [s.reading])
    for _ in range(3):
        p = model.nominal + 0.1 * rng.standard_normal(len(model.nominal))
        offsets, at, centre = (rng.standard_normal(n) for n in (len(model.offsets), *[variables.numel()] * 2))
        expected = np.asarray(read(p, offsets, at)).ravel()
        f = np.prod((at - centre) ** features.exponents, axis=1)
        terms = np.asarray(features.coefficients(p, offsets, centre)) * f[:, None]
        if not np.all(np.abs(terms.sum(axis=0) - expected) <= 1e-9 * np.abs(terms).sum(axis=0)):
            return False
    return True


def _not_polynomial(model: Model) -> InputError:
    return InputError(
        f"Model {model.name} with effects {', '.join(model.effects) or 'none'} has readings that are not a "
        "polynomial of the logged columns, so its runs have no summary; derive the non-polynomial quantity "
        "with Signals.derive."
    )


def derivatives(
    expression: ca.SX, variables: ca.SX, most_degree: int, most: int
) -> dict[tuple[int, ...], ca.SX] | None:
    """Return the derivatives that are not always 0, by the order in each of the variables (v,), itself first.

    None where there are more than `most` or there is one beyond a degree: no polynomial, or too long a one.
    """
    found = level = {(0,) * variables.numel(): expression}
    while level:
        higher = {}
        for row, derivative in level.items():
            slopes = ca.jacobian(derivative, variables)
            last = max((v for v, power in enumerate(row) if power), default=0)  # each once
            for v in range(last, len(row)):
                if slopes[:, v].nnz() and not ca.SX(slopes[:, v]).is_zero():
                    higher[tuple(k + (i == v) for i, k in enumerate(row))] = slopes[:, v]
        found, level = found | higher, higher
        if len(found) > most or any(sum(row) > most_degree for row in level):
            return None
    return found


def _derivative(expression: ca.SX, variables: ca.SX, row: np.ndarray) -> ca.SX:
    for v, power in enumerate(row):
        for _ in range(power):
            expression = ca.jacobian(expression, variables[v])
    return expression
