"""Derivatives written in Python, handed to IPOPT as CasADi callbacks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi
import numpy as np

from solvers.problem import FloatArray, Problem

Buffers = Sequence[memoryview | None]


class Recent:
    """Value, gradient and Hessian at the last point, so that asking for each costs one call in all.

    Works in `u = x / unit`. An exception in the derivatives is kept in `error`, and every later request
    fails at once: CasADi would otherwise swallow it and IPOPT go on.
    """

    def __init__(self, problem: Problem, unit: FloatArray) -> None:
        """Wrap the derivatives of a problem."""
        self.derivatives, self.unit = problem.second_order, unit
        self.lower, self.upper = problem.lower, problem.upper  # for the last bit: IPOPT stays inside
        self.upper_triangle = np.tril_indices(len(unit))  # of H': columns of H
        self.unit2 = unit[:, None] * unit
        self.reset()

    def reset(self) -> None:
        """Forget everything: a new run begins."""
        self.key, self.calls = b"", 0
        self.error: BaseException | None = None
        self.best, self.best_f = self.unit, np.inf

    def at(self, u: memoryview) -> bool:
        """Bring the point up to date; false if that failed, now or before."""
        key = bytes(u)
        if key == self.key and self.error is None:
            return True
        if self.error is not None:
            return False
        x = np.minimum(np.maximum(np.frombuffer(key) * self.unit, self.lower), self.upper)
        try:
            self.calls += 1
            f, gradient, hessian = self.derivatives(x)
            self.f, self.gradient = float(f), gradient * self.unit
            self.hessian = (hessian * self.unit2).T[self.upper_triangle]
        except BaseException as error:
            self.error = error
            return False
        self.key = key
        if self.f < self.best_f:
            self.best, self.best_f = x, self.f
        return True


class _Part(casadi.Callback):
    """One of the functions IPOPT asks for; subclasses say which."""

    inputs = 2

    def __init__(self, name: str, recent: Recent) -> None:
        casadi.Callback.__init__(self)
        self.recent, self.dim = recent, len(recent.unit)
        self.construct(name, {})

    def get_n_in(self) -> int:
        return self.inputs

    def get_sparsity_in(self, i: int) -> casadi.Sparsity:
        return casadi.Sparsity.dense((self.dim, 1, 1, 0)[i], 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, given: Buffers, wanted: Buffers) -> int:
        if given[0] is None or given[1] is None or not self.recent.at(given[0]):
            return 1
        scale = np.frombuffer(given[1])[0]
        for buffer, value in zip(wanted, self.values(given), strict=True):
            if buffer is not None:
                np.frombuffer(buffer)[:] = scale * value
        return 0

    def values(self, given: Buffers) -> tuple[Any, ...]:
        raise NotImplementedError


class _Cost(_Part):
    def get_n_out(self) -> int:
        return 1

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        return casadi.Sparsity.dense(1, 1)

    def values(self, given: Buffers) -> tuple[Any, ...]:
        return (self.recent.f,)


class _Gradient(_Part):
    def get_n_out(self) -> int:
        return 2

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        return casadi.Sparsity.dense((1, self.dim)[i], 1)

    def values(self, given: Buffers) -> tuple[Any, ...]:
        return self.recent.f, self.recent.gradient


class _Hessian(_Part):
    inputs = 4

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        return casadi.Sparsity.upper(self.dim)

    def values(self, given: Buffers) -> tuple[Any, ...]:
        multiplier = 0.0 if given[2] is None else np.frombuffer(given[2])[0]
        return (multiplier * self.recent.hessian,)


class Callbacks:
    """What `nlpsol` needs: keep this alive as long as the solver, CasADi holds no reference to its parts."""

    def __init__(self, recent: Recent) -> None:
        """Build the problem, `u` scaled and `p` the factor of the cost, and the options that go with it."""
        u, scale = casadi.MX.sym("u", len(recent.unit)), casadi.MX.sym("scale")
        self.cost = _Cost("cost", recent)
        self.nlp = {"x": u, "p": scale, "f": self.cost(u, scale)}
        self.options: dict[str, Any] = {
            "grad_f": _Gradient("gradient", recent),
            "hess_lag": _Hessian("hessian", recent),
            "calc_lam_p": False,
            "no_nlp_grad": True,  # the callbacks have no derivatives of their own
        }
