"""Model (31) written by hand for other people's solvers: one unknown per parameter and per zero of each run.

Everyone gets the same residual in reading space, (reading - model) / sigma, the same start and the same
bounds. Unknowns: the 21 parameters in the model's order, then three zero displacements per run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import casadi as ca
import numpy as np
from scipy import optimize, sparse

from hallsym.log import Log
from hallsym.model import Model

ZERO_UNIT = 1e-6
"""What a zero is divided by [m], as parameters are by the width of their bounds, for solvers that need it."""


@dataclass(frozen=True, eq=False)
class Task:
    """The samples as arrays, and where to start.

    `columns`: (6, samples) x, y, rz, z, rx, ry. `readings`: (3, samples). `run`: (samples,) from 0 on.
    `sigma`: (3,). `start`, `lower`, `upper`, `unit`: (21 + 3 runs,).
    """

    model: Model
    columns: np.ndarray
    readings: np.ndarray
    run: np.ndarray
    sigma: np.ndarray
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    unit: np.ndarray

    @property
    def runs(self) -> int:
        return int(self.run[-1]) + 1

    @property
    def first(self) -> np.ndarray:
        """Row of each run's first sample."""
        return np.flatnonzero(np.diff(self.run, prepend=-1))

    @property
    def n_parameters(self) -> int:
        return len(self.model.names)


@dataclass(frozen=True, eq=False)
class Answer:
    """What a peer found: unknowns, its cost (sum of squares), seconds to set up and to solve."""

    x: np.ndarray
    cost: float
    build: float
    solve: float
    message: str

    @property
    def seconds(self) -> float:
        return self.build + self.solve


def task_of(log: Log, model: Model, sigma: np.ndarray, p: np.ndarray, zeros: np.ndarray) -> Task:
    """The task for a log; `p` (21,) and `zeros` (runs, 3) are the start."""
    run = log.array("run").astype(int)
    lower, upper = model.bounds
    free = np.full(zeros.size, np.inf)
    return Task(
        model,
        np.array([log.array(c) for c in (*model.references, *model.state)]),
        np.array([log.array(c) for c in model.channels]),
        np.searchsorted(np.unique(run), run),
        sigma,
        np.concatenate([p, zeros.ravel()]),
        np.concatenate([lower, -free]),
        np.concatenate([upper, free]),
        np.concatenate([upper - lower, np.full(zeros.size, ZERO_UNIT)]),
    )


def designed(task: Task) -> Task:
    """The same task from the designed values, for those who have no closed form."""
    lower, upper = task.lower, task.upper
    start = np.zeros_like(task.start)
    start[: len(task.model.names)] = task.model.nominal
    return replace(task, start=np.clip(start, lower + 1e-6 * task.unit, upper - 1e-6 * task.unit))


# -- the model by hand, as someone with numpy would write it -----------------------------------------------


class ByHand:
    """Residuals (3 samples,) and their sparse Jacobian, probe by probe."""

    def __init__(self, task: Task) -> None:
        self.task = task
        index = {name: k for k, name in enumerate(task.model.names)}
        self.where = [
            [
                index[n]
                for n in (f"H{k}x", f"H{k}y", *(f"{q}_{probe.label}" for q in ("eta", "theta", *"abc")))
            ]
            for k, probe in enumerate(task.model.layout, start=1)
        ]
        samples, n = len(task.run), task.n_parameters
        columns = [
            np.column_stack([np.tile(w, (samples, 1)), n + 3 * task.run + k])
            for k, w in enumerate(self.where)
        ]
        self.indices = np.concatenate(columns).ravel()
        self.indptr = np.arange(0, 8 * 3 * samples + 1, 8)

    def residual(self, x: np.ndarray) -> np.ndarray:
        t = self.task
        parts = [self._probe(k, x)[0] for k in range(3)]
        return np.concatenate([(r - m) / s for r, m, s in zip(parts, t.readings, t.sigma, strict=True)])

    def jacobian(self, x: np.ndarray) -> sparse.csr_matrix:
        data = np.concatenate([self._probe(k, x)[1] / self.task.sigma[k] for k in range(3)])
        return sparse.csr_matrix((data.ravel(), self.indices, self.indptr), (len(self.indptr) - 1, len(x)))

    def _probe(self, k: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reading (samples,) of probe k and its slopes (samples, 8)."""
        t, probe = self.task, self.task.model.layout[k]
        X, Y, Rz, Z, Rx, Ry = t.columns
        hx, hy, eta, theta, a, b, c = x[self.where[k]]
        sx, sy = np.sign(probe.position)
        (sense_x, sense_y), cos, sin = probe.senses, np.cos(theta), np.sin(theta)
        nx, ny = sense_x * cos - sense_y * sin, sense_y * cos + sense_x * sin
        zero = x[t.n_parameters :].reshape(-1, 3)[t.run, k]
        moved = nx * X + ny * Y + (sx * hx * ny - sy * hy * nx) * Rz + zero
        turned = -ny * X + nx * Y + (sx * hx * nx + sy * hy * ny) * Rz
        gain = eta + a * Z + b * Rx + c * Ry
        slopes = (gain * sx * ny * Rz, -gain * sy * nx * Rz, moved, gain * turned, moved * Z, moved * Rx,
                  moved * Ry, gain)  # fmt: skip
        return gain * moved, np.column_stack(slopes)


def cost(task: Task, x: np.ndarray) -> float:
    """Sum of squares over all samples."""
    r = ByHand(task).residual(x)
    return float(r @ r)


# -- the peers ---------------------------------------------------------------------------------------------


def casadi_loop(task: Task) -> Answer:
    """CasADi as the equations read: one call of the model and one square per sample, summed in a loop."""

    def total(u: ca.MX) -> ca.MX:
        p, zeros = u[: task.n_parameters], ca.vertsplit(u[task.n_parameters :], 3)
        squares = []
        for run, columns, reading in zip(task.run, task.columns.T, task.readings.T, strict=True):
            expected = task.model.reading(p, zeros[run], columns[:3], columns[3:])
            squares.append(ca.sumsqr((reading - expected) / task.sigma))
        return ca.sum(ca.vertcat(*squares))

    return _ipopt(task, total)


def casadi_mapped(task: Task) -> Answer:
    """CasADi with one function per sample, mapped over the samples of each run."""

    def total(u: ca.MX) -> ca.MX:
        p, zeros = u[: task.n_parameters], ca.vertsplit(u[task.n_parameters :], 3)
        parts = [
            ca.SX.sym(name, n) for name, n in (("p", len(task.model.names)), ("z", 3), ("q", 6), ("m", 3))
        ]
        expected = task.model.reading(parts[0], parts[1], parts[2][:3], parts[2][3:])
        sample = ca.Function("sample", parts, [ca.sumsqr((parts[3] - expected) / task.sigma)])
        squares = []
        for run in range(task.runs):
            pick = task.run == run
            mapped = sample.map(int(pick.sum()))
            squares.append(ca.sum2(mapped(p, zeros[run], task.columns[:, pick], task.readings[:, pick])))
        return ca.sum(ca.vertcat(*squares))

    return _ipopt(task, total)


def casadi_vectorised(task: Task) -> Answer:
    """CasADi with the model rewritten by hand in whole columns: the fastest form we know of."""

    def total(u: ca.MX) -> ca.MX:
        p = dict(zip(task.model.names, ca.vertsplit(u[: task.n_parameters]), strict=True))
        zeros = ca.vertsplit(u[task.n_parameters :])
        squares = []
        for run in range(task.runs):
            pick = task.run == run
            x, y, rz, z, rx, ry = (ca.DM(column[pick]) for column in task.columns)
            for k, probe in enumerate(task.model.layout):
                (sx, sy), (sense_x, sense_y), q = np.sign(probe.position), probe.senses, probe.label
                cos, sin = ca.cos(p[f"theta_{q}"]), ca.sin(p[f"theta_{q}"])
                nx, ny = sense_x * cos - sense_y * sin, sense_y * cos + sense_x * sin
                lever = sx * p[f"H{k + 1}x"] * ny - sy * p[f"H{k + 1}y"] * nx
                gain = p[f"eta_{q}"] + p[f"a_{q}"] * z + p[f"b_{q}"] * rx + p[f"c_{q}"] * ry
                expected = gain * (nx * x + ny * y + lever * rz + zeros[3 * run + k])
                squares.append(ca.sumsqr((task.readings[k, pick] - expected) / task.sigma[k]))
        return ca.sum(ca.vertcat(*squares))

    return _ipopt(task, total)


def _ipopt(task: Task, total: Callable[[ca.MX], ca.MX]) -> Answer:
    """IPOPT with the exact sparse Hessian of `total(unknowns)`, unknowns and cost scaled to about one."""
    began, samples = perf_counter(), task.readings.size
    u = ca.MX.sym("u", len(task.start))
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    solver = ca.nlpsol("raw", "ipopt", {"x": u, "f": total(u * task.unit) / samples}, options)
    built = perf_counter()
    answer = solver(x0=task.start / task.unit, lbx=task.lower / task.unit, ubx=task.upper / task.unit)
    ended = perf_counter()
    x, stats = np.asarray(answer["x"]).ravel() * task.unit, solver.stats()
    message = f"{stats['return_status']}, {stats['iter_count']} iterations"
    return Answer(x, float(answer["f"]) * samples, built - began, ended - built, message)


def scipy_sparse(task: Task) -> Answer:
    """`scipy.optimize.least_squares`, trust region with LSMR on the analytic sparse Jacobian."""
    began = perf_counter()
    hand = ByHand(task)
    built = perf_counter()
    answer = optimize.least_squares(
        hand.residual, task.start, hand.jacobian, bounds=(task.lower, task.upper), method="trf",
        tr_solver="lsmr", x_scale="jac",
    )  # fmt: skip
    return Answer(
        answer.x,
        2.0 * answer.cost,
        built - began,
        perf_counter() - built,
        f"{answer.nfev} evaluations: {answer.message}",
    )


def lmfit_leastsq(task: Task) -> Answer:
    """`lmfit.minimize` as its manual shows it: named parameters, MINPACK, numerical Jacobian."""
    import lmfit

    began = perf_counter()
    hand = ByHand(task)
    names = [*task.model.names, *(f"zero_{run}_{k}" for run in range(task.runs) for k in "abc")]
    parameters = lmfit.Parameters()
    for name, value, low, high in zip(names, task.start, task.lower, task.upper, strict=True):
        parameters.add(name, value, min=low, max=high)
    built = perf_counter()
    answer = lmfit.minimize(
        lambda values: hand.residual(np.array([values[n].value for n in names])), parameters, calc_covar=False
    )
    x = np.array([answer.params[n].value for n in names])
    return Answer(
        x,
        float(answer.chisqr),
        built - began,
        perf_counter() - built,
        f"{answer.nfev} evaluations: {answer.message}",
    )
