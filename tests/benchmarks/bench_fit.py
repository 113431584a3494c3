"""Fit Model (31) to the paper's campaign: hallsym beside general solvers, and what its uncertainty costs.

    python tests/benchmarks/bench_fit.py
    python tests/benchmarks/bench_fit.py --quick

192 unknowns: 21 parameters and three zero deviations in each of 57 runs. 500 samples per run, noise of Table
8, the log in memory and its noise given. Processor times, the least of several turns, ours with a fresh log
each.
The peers get the same residual in reading space, (reading - model) / sigma, our closed form as a start and
the same bounds; they take the reference as exact, so their cost is compared with a fit of ours that does too.
pyPESTO profiles the same likelihood with our exact gradient on run statistics, by scipy's L-BFGS-B.
"""

import argparse
import os
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

import casadi as ca
import numpy as np
from scipy import optimize, sparse

from hallsym.estimation import Fit, fit
from hallsym.estimation.factors import summarise
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.optimum import closed_form, linear_fit, refit
from hallsym.families import build, published
from hallsym.inference import identify
from hallsym.inference.profiles import profile, tangent
from hallsym.log import Log, Noise
from hallsym.model.model import combination, parameter
from hallsym.simulation import NoiseModel, paper_campaign, simulate, table8_noise

MODEL = build("stage31")
RZ_NOISE = 5e-8
"""Noise of the reference's rotation [rad], which Table 8 does not give."""
SIGMA = {**table8_noise(MODEL).sigma, "rz_ref_rad": RZ_NOISE}
ZERO_UNIT = 1e-6
"""What a zero is divided by [m], as parameters are by the width of their bounds."""
PEER = ("eta_A", "a_B", "theta_C")
"""Parameters that pyPESTO profiles: all would take it minutes."""


def in_memory(columns: dict[str, np.ndarray], *, exact: bool = False) -> Log:
    """`exact`: only readings have noise, as the peers take it."""
    sigma = {c: s if not exact or c.startswith("hall") else 0.0 for c, s in SIGMA.items()}
    return Log.from_arrays(columns, Noise.given(sigma, tuple(columns)))


def least(turns: int, action: Callable[[], Any]) -> tuple[float, Any]:
    """Least processor time [s] over several turns, and what the last one returned."""
    seconds = []
    for _ in range(turns):
        began = process_time()
        answer = action()
        seconds.append(process_time() - began)
    return min(seconds), answer


class ByHand:
    """The model as someone with numpy would write it: 21 parameters, then three zeros per run.

    `columns`: (6, samples) x, y, rz, z, rx, ry. `readings`: (3, samples). `run`: (samples,) from 0 on.
    """

    def __init__(self, log: Log) -> None:
        self.columns = np.array([log.array(c) for c in (*MODEL.references, *MODEL.state)])
        self.readings = np.array([log.array(c) for c in MODEL.channels])
        self.run = np.unique(log.array("run"), return_inverse=True)[1]
        self.sigma = np.array([log.noise[c].value for c in MODEL.channels])
        cost = cost_of(summarise(log, MODEL), log.noise.std)
        merged = cost_of(cost.summary.merged(), log.noise.std)
        p = np.clip(closed_form(merged, linear_fit(merged)), *MODEL.bounds)
        zeros = cost.at(p).offsets
        free = np.full(zeros.size, np.inf)
        lower, upper = MODEL.bounds
        self.lower, self.upper = np.concatenate([lower, -free]), np.concatenate([upper, free])
        self.unit = np.concatenate([upper - lower, np.full(zeros.size, ZERO_UNIT)])
        self.start, n = np.concatenate([p, zeros.ravel()]), len(p)
        designed = np.concatenate([MODEL.nominal, np.zeros(zeros.size)])
        self.designed = np.clip(designed, self.lower + 1e-6 * self.unit, self.upper - 1e-6 * self.unit)
        index = {name: k for k, name in enumerate(MODEL.names)}
        self.where = [
            [
                index[f"H{k}x"],
                index[f"H{k}y"],
                *(index[f"{q}_{probe.label}"] for q in ("eta", "theta", *"abc")),
            ]
            for k, probe in enumerate(MODEL.layout, start=1)
        ]
        samples = len(self.run)
        parts = [
            np.column_stack([np.tile(w, (samples, 1)), n + 3 * self.run + k])
            for k, w in enumerate(self.where)
        ]
        self.indices = np.concatenate(parts).ravel()
        self.indptr = np.arange(0, 8 * 3 * samples + 1, 8)

    def residual(self, x: np.ndarray) -> np.ndarray:
        seen = zip(range(3), self.readings, self.sigma, strict=True)
        return np.concatenate([(self.probe(k, x)[0] - m) / s for k, m, s in seen])

    def jacobian(self, x: np.ndarray) -> sparse.csr_matrix:
        data = np.concatenate([self.probe(k, x)[1] / self.sigma[k] for k in range(3)])
        return sparse.csr_matrix((data.ravel(), self.indices, self.indptr), (len(self.indptr) - 1, len(x)))

    def probe(self, k: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reading (samples,) of probe k and its slopes (samples, 8)."""
        probe, (X, Y, Rz, Z, Rx, Ry) = MODEL.layout[k], self.columns
        hx, hy, eta, theta, a, b, c = x[self.where[k]]
        sx, sy = np.sign(probe.position)
        (sense_x, sense_y), cos, sin = probe.senses, np.cos(theta), np.sin(theta)
        nx, ny = sense_x * cos - sense_y * sin, sense_y * cos + sense_x * sin
        zero = x[len(MODEL.names) :].reshape(-1, 3)[self.run, k]
        moved = nx * X + ny * Y + (sx * hx * ny - sy * hy * nx) * Rz + zero
        turned = -ny * X + nx * Y + (sx * hx * nx + sy * hy * ny) * Rz
        gain = eta + a * Z + b * Rx + c * Ry
        slopes = (gain * sx * ny * Rz, -gain * sy * nx * Rz, moved, gain * turned, moved * Z, moved * Rx,
                  moved * Ry, gain)  # fmt: skip
        return gain * moved, np.column_stack(slopes)


def casadi_mapped(task: ByHand) -> float:
    """IPOPT with the exact sparse Hessian of one function per sample, mapped over each run; the cost."""
    samples, u = task.readings.size, ca.MX.sym("u", len(task.start))
    unknown, n = u * task.unit, len(MODEL.names)
    parts = [ca.SX.sym(name, size) for name, size in (("p", n), ("z", 3), ("q", 6), ("m", 3))]
    expected = MODEL.reading(parts[0], parts[1], parts[2][:3], parts[2][3:])
    sample = ca.Function("sample", parts, [ca.sumsqr((parts[3] - expected) / task.sigma)])
    squares = []
    for run, zeros in enumerate(ca.vertsplit(unknown[n:], 3)):
        pick = task.run == run
        mapped = sample.map(int(pick.sum()))
        squares.append(ca.sum2(mapped(unknown[:n], zeros, task.columns[:, pick], task.readings[:, pick])))
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    solver = ca.nlpsol("raw", "ipopt", {"x": u, "f": ca.sum(ca.vertcat(*squares)) / samples}, options)
    answer = solver(x0=task.start / task.unit, lbx=task.lower / task.unit, ubx=task.upper / task.unit)
    return float(answer["f"]) * samples


def scipy_sparse(task: ByHand, start: np.ndarray) -> float:
    """`scipy.optimize.least_squares`, trust region with LSMR on the analytic sparse Jacobian; the cost."""
    answer = optimize.least_squares(
        task.residual, start, task.jacobian, bounds=(task.lower, task.upper), tr_solver="lsmr", x_scale="jac"
    )
    return 2.0 * float(answer.cost)


def gauss_newton(task: ByHand) -> float:
    """Gauss-Newton steps as someone with numpy would write them, each run's zeros eliminated; the cost.

    From our start, clipped at the bounds, until a step gains less than 1e-9 of the cost.
    """
    x, before = task.start.copy(), np.inf
    n, first = len(MODEL.names), np.flatnonzero(np.diff(task.run, prepend=-1))
    while True:
        normal, right, cost, eliminated = np.zeros((n, n)), np.zeros(n), 0.0, []
        for k, where in enumerate(task.where):
            seen, slopes = task.probe(k, x)
            J = slopes * (task.unit[np.append(where, n)] / task.sigma[k])
            left, own = (task.readings[k] - seen) / task.sigma[k], J[:, 7]
            square, along, load = (
                np.add.reduceat(own[:, None] * part, first) for part in (J[:, 7:], J[:, :7], left[:, None])
            )
            normal[np.ix_(where, where)] += J[:, :7].T @ J[:, :7] - along.T @ (along / square)
            right[where] += J[:, :7].T @ left - (along.T @ (load / square))[:, 0]
            eliminated.append((square[:, 0], along, load[:, 0]))
            cost += left @ left
        if before - cost <= 1e-9 * cost:
            return float(cost)
        step = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        step = (np.clip(x[:n] + step * task.unit[:n], *MODEL.bounds) - x[:n]) / task.unit[:n]
        x[:n] += step * task.unit[:n]
        for k, (square, along, load) in enumerate(eliminated):
            x[n + k :: 3] += ZERO_UNIT * (load - along @ step[task.where[k]]) / square
        before = cost


def refits(found: Fit, draws: int) -> float:
    """Mean seconds of a refit to runs drawn with replacement."""
    cost, runs = found.likelihood.anchored(found.values), len(found.likelihood.weights)
    weights = np.random.default_rng(57).multinomial(runs, np.full(runs, 1.0 / runs), size=draws)
    held = [MODEL.names.index(name) for name in found.fixed]
    refit(cost, found.values, held)
    began = perf_counter()
    for row in weights:
        refit(cost.weighted(row), found.values, held)
    return (perf_counter() - began) / draws


def compare(samples: int, turns: int) -> None:
    """Print both tables of docs/performance.md."""
    columns = simulate(
        MODEL,
        published.values("table7_estimates"),
        paper_campaign(step_s=1.0 / samples),
        NoiseModel(SIGMA),
        seed=872,
    )
    first, _ = least(1, lambda: fit(in_memory(columns), MODEL, solver="direct"))
    direct, found = least(turns, lambda: fit(in_memory(columns), MODEL, solver="direct"))
    hybrid, _ = least(turns, lambda: fit(in_memory(columns), MODEL))
    unstated, _ = least(turns, lambda: fit(Log.from_arrays(columns), MODEL, solver="direct"))
    exact = fit(in_memory(columns, exact=True), MODEL, solver="direct", loss="none")
    task = ByHand(in_memory(columns, exact=True))
    by_hand, cost_by_hand = least(turns, lambda: gauss_newton(task))
    rows = [
        ("direct", direct, None), ("direct, first in the process", first, None), ("hybrid", hybrid, None),
        ("direct, noise not stated", unstated, None), ("refit, mean of 200", refits(found, 200), None),
        ("Gauss-Newton in numpy by hand, from our start", by_hand, cost_by_hand),
        ("CasADi + IPOPT, mapped over samples", *least(1, lambda: casadi_mapped(task))),
        ("scipy, from the nominal values", *least(1, lambda: scipy_sparse(task, task.designed))),
        ("scipy, from our start", *least(turns, lambda: scipy_sparse(task, task.start))),
    ]  # fmt: skip
    print(
        f"| 57 x {samples}, cost {exact.solver.cost:.6f} | s | x by hand | x direct | cost above |\n"
        "|---|---|---|---|---|"
    )
    for name, seconds, cost in rows:
        above = "" if cost is None else f"{cost - exact.solver.cost:.1e}"
        print(f"| {name} | {seconds:.3g} | {seconds / by_hand:.3g} | {seconds / direct:.3g} | {above} |")
    uncertainty(found, hybrid, turns)


def uncertainty(found: Fit, hybrid: float, turns: int) -> None:
    """Print what a report, refits and profiles cost beside a default fit, and how pyPESTO's compare."""
    cost, p = found.likelihood, found.values
    determined, known = determine(cost, p), {c.expression: c for c in MODEL.combinations}
    stated = [(parameter(MODEL, n), found.std[k]) for k, n in enumerate(MODEL.names) if found.determined[k]]
    stated += [(combination(MODEL, known[c.expression]), c.std) for c in found.combinations]
    anchored = cost.anchored(p)

    def profiles() -> dict[str, Any]:
        return {q.name: profile(anchored, p, q, found=determined, std=s) for q, s in stated}

    seconds, ours = least(turns, profiles)
    rows = [
        ("identify without profiles", least(turns, lambda: identify(found, profiles="none"))[0]),
        (f"profiles of {len(stated)} quantities", seconds),
    ]
    print("\n| | s | x a default fit |\n|---|---|---|")
    for name, taken in rows:
        print(f"| {name} | {taken:.3g} | {taken / hybrid:.3g} |")
    try:
        taken, ends = pypesto_profiles(cost, p, determined)
    except ImportError:
        print("\npyPESTO: not installed: skipped")
        return
    print(f"\npyPESTO: {taken / len(PEER):.3g} s a profile")
    for name, theirs in ends.items():
        std = tangent(cost, p, ours[name].quantity, determined).std
        off = np.abs((np.array(ours[name].interval) - ours[name].value) / std - theirs).max()
        print(f"{name}: ends differ by {off:.1e} standard uncertainties")


def pypesto_profiles(
    cost: Cost, p: np.ndarray, determined: Determination
) -> tuple[float, dict[str, np.ndarray]]:
    """Seconds that pyPESTO takes for the profiles of `PEER`, and their ends in units of std."""
    import pypesto
    from pypesto.optimize import ScipyOptimizer
    from pypesto.profile import parameter_profile

    free = np.array([k for k in range(len(p)) if k not in determined.fixed])
    std = np.array([tangent(cost, p, parameter(MODEL, MODEL.names[k]), determined).std for k in free])
    base = cost.at(p).value

    def at(x: np.ndarray) -> np.ndarray:
        out = p.copy()
        out[free] += np.asarray(x) * std
        return out

    objective = pypesto.Objective(
        fun=lambda x: 0.5 * (cost.at(at(x)).value - base),
        grad=lambda x: 0.5 * std * (cost.weights @ cost.at(at(x)).run_gradients)[free],
    )
    problem = pypesto.Problem(objective, lb=-8.0 * np.ones(len(free)), ub=8.0 * np.ones(len(free)))
    result, zero = pypesto.Result(problem), np.zeros(len(free))
    result.optimize_result.append(pypesto.OptimizerResult(id="0", x=zero, fval=0.0, x0=zero))
    index = [free.tolist().index(MODEL.names.index(name)) for name in PEER]
    optimizer = ScipyOptimizer(method="L-BFGS-B", options={"ftol": 1e-11, "gtol": 1e-7, "maxiter": 2000})
    began = perf_counter()
    parameter_profile(problem, result, optimizer, profile_index=index, progress_bar=False)
    seconds, ends = perf_counter() - began, {}
    for k, name in zip(index, PEER, strict=True):
        path = result.profile_result.list[0][k]
        x, ratio = path.x_path[k], np.minimum(path.ratio_path, 1.0)
        ends[name] = np.interp([-1.959964, 1.959964], np.sqrt(-2.0 * np.log(ratio)) * np.sign(x), x)
    return seconds, ends


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples, one turn")
    quick = parser.parse_args().quick
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    compare(50 if quick else 500, 1 if quick else 7)
