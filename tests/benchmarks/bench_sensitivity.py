"""What uncertainty costs beside the fit itself: profiles, and refits to resampled runs.

    python tests/benchmarks/bench_sensitivity.py
    python tests/benchmarks/bench_sensitivity.py --quick

Model (31) on the paper's campaign of 57 runs, 500 samples each, noise of Table 8. The peer is pyPESTO, which
profiles the same likelihood, F / 2 with our exact gradient on run statistics, in full-rank coordinates, with
scipy's L-BFGS-B: what differs is the way along the profile, not the time to evaluate a cost.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.estimation import Cost, determine, fit, uncertainty
from hallsym.families import build, published
from hallsym.inference import Profile, bootstrap, identify, profile, skewness, tangent
from hallsym.log import Log, Noise
from hallsym.model import Quantity, combination, parameter
from hallsym.simulation import NoiseModel, paper_campaign, simulate, table8_noise

MODEL = "stage31"
RZ_NOISE = 5e-8
"""Noise of the reference's rotation [rad], which Table 8 does not give."""
REPLICATES = 1000
PEER = ("eta_A", "a_B", "theta_C")
"""Parameters that the peer profiles too: all would take it minutes."""


def recorded(samples: int) -> Callable[[], Log]:
    """Return what hands out the log, fresh each time: what a log keeps is not to be measured twice."""
    model = build(MODEL)
    noise = NoiseModel({**table8_noise(model).sigma, "rz_ref_rad": RZ_NOISE})
    values = published.values("table7_estimates")
    columns = simulate(model, values, paper_campaign(step_s=1.0 / samples), noise, seed=872)
    return lambda: Log.from_arrays(columns, Noise.given(noise.sigma, tuple(columns)))


def least(turns: int, action: Callable[[], Any]) -> tuple[float, Any]:
    """Least seconds over several turns, and what the last one returned."""
    seconds = []
    for _ in range(turns):
        began = perf_counter()
        answer = action()
        seconds.append(perf_counter() - began)
    return min(seconds), answer


def quantities_of(found: Any) -> list[tuple[Quantity, float]]:
    """Determined parameters and lever arms, with their standard uncertainties."""
    model = found.model
    named = [(parameter(model, n), found.std[k]) for k, n in enumerate(model.names) if found.determined[k]]
    known = {c.expression: c for c in model.combinations}
    return named + [(combination(model, known[c.expression]), c.std) for c in found.combinations]


def peer(cost: Cost, p: np.ndarray, held: tuple[int, ...], which: tuple[str, ...]) -> tuple[float, dict]:
    """Seconds that pyPESTO takes for the profiles of `which`, and their ends in units of std."""
    import pypesto
    from pypesto.optimize import ScipyOptimizer
    from pypesto.profile import parameter_profile

    model = cost.summary.model
    free = np.array([k for k in range(len(p)) if k not in held])
    std = np.array([tangent(cost, p, parameter(model, model.names[k]), held).std for k in free])
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
    result = pypesto.Result(problem)
    zero = np.zeros(len(free))
    result.optimize_result.append(pypesto.OptimizerResult(id="0", x=zero, fval=0.0, x0=zero))
    index = [free.tolist().index(model.names.index(name)) for name in which]
    optimizer = ScipyOptimizer(method="L-BFGS-B", options={"ftol": 1e-11, "gtol": 1e-7, "maxiter": 2000})
    began = perf_counter()
    parameter_profile(problem, result, optimizer, profile_index=index, progress_bar=False)
    seconds, ends = perf_counter() - began, {}
    for k, name in zip(index, which, strict=True):
        path = result.profile_result.list[0][k]
        x, ratio = path.x_path[k], np.minimum(path.ratio_path, 1.0)
        root = np.sqrt(-2.0 * np.log(ratio)) * np.sign(x)
        ends[name] = np.interp([-1.959964, 1.959964], root, x)
    return seconds, ends


def compare(samples: int, turns: int) -> None:
    log = recorded(samples)
    fit(log(), MODEL, solver="direct")  # the first one in the process builds what others keep
    direct, found = least(turns, lambda: fit(log(), MODEL, solver="direct"))
    hybrid, _ = least(turns, lambda: fit(log(), MODEL))
    cost, p = found.likelihood, found.values
    what = determine(cost, p)
    stated = quantities_of(found)
    held = what.held

    def profiles() -> list[Profile]:
        anchored = cost.anchored(p)
        return [profile(anchored, p, q, held=held, std=s) for q, s in stated]

    def checks() -> list:
        anchored = cost.anchored(p)
        return [skewness(anchored, p, q, held=held, std=s) for q, s in stated]

    rows = [
        ("report without profiles", *least(turns, lambda: identify(found, profiles="none"))),
        ("standard uncertainties", *least(turns, lambda: uncertainty(cost, p, what))),
        (f"is a normal interval good enough, {len(stated)} quantities", *least(turns, checks)),
        (f"profiles of {len(stated)} quantities", *least(turns, profiles)),
        (
            f"{REPLICATES} refits to resampled runs",
            *least(turns, lambda: bootstrap(cost, p, held, replicates=REPLICATES, seed=1)),
        ),
    ]
    print(f"## Model (31), 57 x {samples} samples\n")
    print("| | s | direct fits | hybrid fits |\n|---|---|---|---|")
    print(f"| direct fit | {direct:.3g} | 1 | |\n| hybrid fit (default) | {hybrid:.3g} | | 1 |")
    for name, seconds, _ in rows:
        print(f"| {name} | {seconds:.3g} | {seconds / direct:.3g} | {seconds / hybrid:.3g} |")
    drawn, whole = rows[4][2], rows[3][2]
    print(
        f"\nRefits: {drawn.refitted} of {REPLICATES} went beyond one Newton step; the others are off by "
        f"{drawn.error:.1e} standard uncertainties at most in the last that were looked at."
    )
    statuses = sorted({side.status for q in whole for side in (q.lower, q.upper)})
    print(f"Profiles: ends {', '.join(statuses)}; {sum(q.evaluations for q in whole)} evaluations in all.")
    compare_peer(cost, p, held, rows[3][1] / len(stated), {q.quantity.name: q for q in whole})


def compare_peer(
    cost: Cost, p: np.ndarray, held: tuple[int, ...], ours: float, profiles: dict[str, Profile]
) -> None:
    try:
        seconds, ends = peer(cost, p, held, PEER)
    except ImportError:
        print("pyPESTO: not installed: skipped")
        return
    each = seconds / len(PEER)
    print(f"\npyPESTO: {each:.3g} s per profile ({', '.join(PEER)}); ours {ours:.3g} s: {each / ours:.3g} x.")
    for name, theirs in ends.items():
        std = tangent(cost, p, profiles[name].quantity, held).std
        mine = (np.array(profiles[name].interval) - profiles[name].value) / std
        print(f"{name}: ends differ by {np.abs(mine - theirs).max():.1e} standard uncertainties.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples, one turn")
    quick = parser.parse_args().quick
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    compare(50 if quick else 500, 1 if quick else 5)


if __name__ == "__main__":
    main()
