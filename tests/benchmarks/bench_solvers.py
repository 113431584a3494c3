"""Which global method reaches the optimum of a calibration, how often, and at what cost.

    python tests/benchmarks/bench_solvers.py --seeds 30

Model (31) on the merged run statistics of the bundled campaign, inside the bounds of Tables 3 and 5, printed
as the Markdown table of docs/solvers.md. A global method gets 20 100 evaluations, a class of 100; its best
three points that are apart are then refined. Success: a cost within 1e-6 of the best known one.
"""

import argparse

import numpy as np

import hallsym
import solvers
from hallsym.estimation.factors import summarise
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.optimum import closed_form, linear_fit
from hallsym.estimation.task import noise_of

BUDGET, SIZE, KEEP, SAME = 20_100, 100, 3, 1e-6


def problem_on(log: hallsym.Log, model: hallsym.Model) -> tuple[solvers.Problem, np.ndarray]:
    """Return the merged cost per sample in units of the bounds, and its closed-form start."""
    cost = cost_of(summarise(log, model).merged(), noise_of(log, model).std)
    first = np.clip(closed_form(cost, linear_fit(cost)), *model.bounds)
    held = determine(cost, first).fixed
    first[list(held)] = np.clip(model.nominal, *model.bounds)[list(held)]
    free = np.array([k for k in range(len(first)) if k not in held])
    lower, upper = (bound[free] for bound in model.bounds)
    width, samples = upper - lower, float(cost.summary.counts.sum())

    def full(x: np.ndarray) -> np.ndarray:
        p = np.tile(first, (*x.shape[:-1], 1)) if x.ndim > 1 else first.copy()
        p[..., free] = lower + x * width
        return p

    def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        f, g, H = cost.at(full(x)).derivatives()
        scaled = H[np.ix_(free, free)] * np.outer(width, width)
        return f / samples, g[free] * width / samples, scaled / samples

    box = np.zeros(len(free)), np.ones(len(free))
    problem = solvers.Problem(lambda x: cost.population(full(x)) / samples, *box, derivatives)
    return problem, (first[free] - lower) / width


def row(method: str, problem: solvers.Problem, seeds: int, best: float) -> list[str]:
    """One method alone, and refined."""
    found = [
        solvers.hybrid(problem, seed=seed, keep=KEEP, budget=BUDGET, global_solver=method, size=SIZE)
        for seed in range(seeds)
    ]
    alone, after = ([f.explored.cost for f in found], [f.cost for f in found])
    good = [f"{sum(cost <= best * (1 + SAME) for cost in costs)} of {seeds}" for costs in (alone, after)]
    seconds = [np.median([f.explored.seconds for f in found]), np.median([f.seconds for f in found])]
    return [
        method,
        good[0],
        f"{np.median(alone) / best - 1:.2g}",
        f"{max(alone) / best - 1:.2g}",
        good[1],
        *(f"{s:.2g}" for s in seconds),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=30)
    seeds = parser.parse_args().seeds
    problem, first = problem_on(hallsym.bundled_campaign(), hallsym.build("stage31"))
    direct = solvers.ipopt(problem, first)
    head = [
        "solver",
        "success alone",
        "median above the optimum",
        "worst",
        "refined",
        "s alone",
        "s in all",
    ]
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    print(f"| closed form (`direct`) | | | | 1 of 1 | | {direct.seconds:.2g} |")
    for method in solvers.EXPLORERS:
        print("| " + " | ".join(row(method, problem, seeds, direct.cost)) + " |", flush=True)


if __name__ == "__main__":
    main()
