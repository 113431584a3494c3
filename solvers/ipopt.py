"""IPOPT through CasADi, always with the exact Hessian.

Waechter & Biegler, Mathematical Programming 106 (2006) 25, doi:10.1007/s10107-004-0559-y.

IPOPT sees `u = x / unit` (unit: about the width of the box, 1 where that is infinite) and the cost divided by
its value and slope at the start, so its tolerances are relative, and a cost of 1e-12 square metres does not
count as solved at the start.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from solvers.newton import NEGLIGIBLE, inside, newton, what_is_left
from solvers.problem import INTERRUPTED, FloatArray, Problem, Result, Status

QUIET = {
    "print_time": False, "show_eval_warnings": False, "error_on_fail": False, "calc_lam_p": False,
    "no_nlp_grad": True,  # the callbacks have no derivatives of their own
}  # fmt: skip
STRICT = {"print_level": 0, "sb": "yes", "bound_relax_factor": 0.0}  # never a step outside the bounds
ROUNDS = 4
ROOM = 320 << 20
"""Bytes of address space for IPOPT and the buffer of CasADi's OpenBLAS."""
CTRL_C = ("NonIpopt_Exception_Thrown", "User_Requested_Stop")  # what CasADi >= 3.8 makes of it


Buffers = Sequence[memoryview | None]
Values = Callable[[Buffers], tuple[Any, ...]]


class Recent:
    """Value, gradient and Hessian at the last point, so that asking for each costs one call in all.

    Works in `u = x / unit`. An exception in the derivatives is kept in `error`, and every later request
    fails at once: CasADi would otherwise swallow it and IPOPT go on.
    """

    def __init__(self, problem: Problem, unit: FloatArray) -> None:
        """Wrap the derivatives of a problem."""
        self.derivatives, self.unit = problem.second_order, unit
        self.lower, self.upper = problem.lower, problem.upper  # for the last bit: IPOPT stays inside
        self.unit2 = unit[:, None] * unit
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
            self.hessian = hessian * self.unit2
        except BaseException as error:
            self.error = error
            return False
        self.key = key
        if self.f < self.best_f:
            self.best, self.best_f = x, self.f
        return True


class _Part(casadi.Callback):
    """One of the functions that IPOPT asks for: `values(given)` of `u` and the scale, one per sparsity."""

    def __init__(
        self, name: str, recent: Recent, outputs: list[casadi.Sparsity], values: Values, inputs: int = 2
    ) -> None:
        casadi.Callback.__init__(self)
        self.recent, self.outputs, self.values, self.inputs = recent, outputs, values, inputs
        self.construct(name, {})

    def get_n_in(self) -> int:
        return self.inputs

    def get_n_out(self) -> int:
        return len(self.outputs)

    def get_sparsity_in(self, i: int) -> casadi.Sparsity:
        return casadi.Sparsity.dense((len(self.recent.unit), 1, 1, 0)[i], 1)

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        return self.outputs[i]

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


def ipopt(
    problem: Problem, x0: ArrayLike, *, max_iterations: int = 200, tolerance: float = 1e-8, **options: Any
) -> Result:
    """Refine one point; never returns a worse one than `x0` clipped into the box.

    Needs `problem.derivatives`.
    IPOPT calls a flat stretch far from any optimum solved, and stops within its tolerance elsewhere. So
    Newton's method goes on from its point, and the status is what that ends with.
    tolerance: of IPOPT, relative as said above. max_iterations: of IPOPT, and of Newton's method after it.
    options: further options of IPOPT itself.
    """
    began = perf_counter()
    x, note = inside(problem, x0, "ipopt")
    attempt = _Attempt(problem, x, {"max_iter": max_iterations, "tol": tolerance} | STRICT | options)
    status: Status
    try:
        status, message = attempt.run(max_iterations)
    except KeyboardInterrupt:
        status, message = "interrupted", INTERRUPTED
    evaluations = attempt.recent.calls + attempt.further
    return Result(
        attempt.x, attempt.f, status, message + note, evaluations, attempt.first, perf_counter() - began
    )


class _Attempt:
    """One run of IPOPT from one start."""

    def __init__(self, problem: Problem, x: FloatArray, options: dict[str, Any]) -> None:
        self.problem, self.x, self.f, self.first, self.further = problem, x, np.inf, np.inf, 0
        width = np.where(np.isfinite(problem.width) & (problem.width > 0.0), problem.width, 1.0)
        self.unit = 2.0 ** np.rint(np.log2(width))  # powers of two: dividing by them is exact
        self.lower, self.upper = problem.lower, problem.upper
        self.recent = recent = Recent(problem, self.unit)
        dim, one = problem.dim, casadi.Sparsity.dense(1, 1)
        slope, triangle = casadi.Sparsity.dense(dim, 1), np.tril_indices(dim)  # of H': columns of H

        def hessian(given: Buffers) -> tuple[Any, ...]:
            multiplier = 0.0 if given[2] is None else np.frombuffer(given[2])[0]
            return (multiplier * recent.hessian.T[triangle],)

        u, scale = casadi.MX.sym("u", dim), casadi.MX.sym("scale")
        # CasADi holds no reference to its parts: they must live as long as the solver
        self.cost = _Part("cost", recent, [one], lambda _: (recent.f,))
        self.parts: dict[str, Any] = {
            "grad_f": _Part("gradient", recent, [one, slope], lambda _: (recent.f, recent.gradient)),
            "hess_lag": _Part("hessian", recent, [casadi.Sparsity.upper(dim)], hessian, inputs=4),
        }
        nlp: dict[str, Any] = {"x": u, "p": scale, "f": self.cost(u, scale)}
        try:
            mmap.mmap(-1, ROOM).close()
        except OSError as error:
            raise MemoryError from error
        self.solver = casadi.nlpsol("refine", "ipopt", nlp, QUIET | self.parts | {"ipopt": options})

    def run(self, max_iterations: int) -> tuple[Status, str]:
        """From the start to the verdict; the best point is kept on the way.

        From far away the cost at the start is a poor measure: another round takes that of the point reached.
        """
        slope = self.take(self.x)
        self.first = self.f
        if np.isinf(self.f):
            return "failed", "The cost is not finite at the start: choose another start."
        if (self.lower == self.upper).all():
            return "converged", "Every variable is fixed: there is nothing to refine."
        bounds = {"lbx": self.lower / self.unit, "ubx": self.upper / self.unit}
        for _ in range(ROUNDS):
            before, scale = self.f, abs(self.f) + float(np.abs(slope).max())
            answer = self.solver(x0=self.x / self.unit, p=1.0 / scale if scale > 0.0 else 1.0, **bounds)
            said = str(self.solver.stats()["return_status"])
            self.after_python_error()
            self.take(np.clip(np.array(answer["x"]).ravel() * self.unit, self.lower, self.upper))
            if said in CTRL_C:
                raise KeyboardInterrupt
            slope, u = self.take(self.x), self.x / self.unit
            left, rounding = what_is_left(slope, self.recent.hessian, u, *bounds.values())
            done = rounding or abs(left) <= NEGLIGIBLE * abs(self.f)
            if done or said != "Solve_Succeeded" or self.f == before:
                break
        found = f"IPOPT: {said} at a cost of {self.f:.6e}, then Newton's method."
        further = newton(self.problem, self.x, max_iterations=max_iterations)
        self.further = further.evaluations
        if further.cost < self.f:
            self.x, self.f = further.x, further.cost
        return further.status, f"{found} {further.message}"

    def take(self, x: FloatArray) -> FloatArray:
        """Keep `x` if it is strictly better; return the slope there, the gradient by `u`."""
        there = self.recent
        there.at((x / self.unit).data)
        self.after_python_error()
        if -np.inf < there.f < self.f:
            self.x, self.f = x, there.f
        return there.gradient

    def after_python_error(self) -> None:
        """Raise what Python derivatives raised within IPOPT, after keeping the best point so far."""
        recent = self.recent
        if recent.error is not None:
            if recent.best_f < self.f:
                self.x, self.f = recent.best, recent.best_f
            raise recent.error
