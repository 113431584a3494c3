"""Global methods side by side: how low they get on an equal budget, and what they cost themselves.

    python tests/benchmarks/bench_metaheuristics.py --seeds 30
    python tests/benchmarks/bench_metaheuristics.py --quick

Six 30-dimensional functions, the optimum moved to a seeded random place inside the bounds: TLBO is drawn to
the origin, because (16) subtracts one or two times the mean from the teacher, so unmoved functions flatter
it. The first row is the sphere unmoved, to show that. 20 100 evaluations each, a class of 100. The
reported cost is above the optimum. Needs scipy; `cma` and `mealpy` (extra "bench") are skipped when absent.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from solvers import Problem, minimize

DIM, BUDGET, SIZE = 30, 20_100, 100


def sphere(z):
    return (z**2).sum(axis=-1)


def rosenbrock(z):
    z = z + 1.0
    return (100.0 * (z[..., 1:] - z[..., :-1] ** 2) ** 2 + (1.0 - z[..., :-1]) ** 2).sum(axis=-1)


def rastrigin(z):
    return (z**2 - 10.0 * np.cos(2.0 * np.pi * z) + 10.0).sum(axis=-1)


def ackley(z):
    rms, wave = np.sqrt((z**2).mean(axis=-1)), np.cos(2.0 * np.pi * z).mean(axis=-1)
    return -20.0 * np.exp(-0.2 * rms) - np.exp(wave) + 20.0 + np.e


def griewank(z):
    product = np.cos(z / np.sqrt(np.arange(1, z.shape[-1] + 1))).prod(axis=-1)
    return (z**2).sum(axis=-1) / 4000.0 - product + 1.0


SCHWEFEL_AT = 420.96874635998199


def schwefel(z):
    z = z + SCHWEFEL_AT
    inside = np.clip(z, -500.0, 500.0)  # beyond its usual domain the function would fall without end
    lowest = SCHWEFEL_AT * np.sin(np.sqrt(SCHWEFEL_AT))
    return (lowest - inside * np.sin(np.sqrt(np.abs(inside))) + (z - inside) ** 2 / 100.0).sum(axis=-1)


@dataclass
class Case:
    """A function, zero and lowest at zero; searched within +-bound, its optimum moved to `optimum`.

    The move is uniform within +-shift bounds around `centre`.
    """

    name: str
    function: Callable[[np.ndarray], np.ndarray]
    bound: float
    shift: float = 0.5
    centre: float = 0.0
    seconds: float = 0.0
    evaluations: int = 0
    optimum: np.ndarray = field(default_factory=lambda: np.zeros(DIM))

    def __post_init__(self):
        places = np.random.default_rng(2016).uniform(-1.0, 1.0, DIM)
        self.optimum = self.centre + self.shift * self.bound * places

    def __call__(self, x):
        """Cost of rows (n, dim) or of one point (dim,); keeps its own time."""
        began = perf_counter()
        cost = self.function(np.asarray(x) - self.optimum)
        self.evaluations += 1 if np.ndim(x) == 1 else len(x)
        self.seconds += perf_counter() - began
        return cost


CASES = (
    ("sphere, not moved", sphere, 100.0, 0.0),
    ("sphere", sphere, 100.0),
    ("Rosenbrock", rosenbrock, 30.0),
    ("Rastrigin", rastrigin, 5.12),
    ("Ackley", ackley, 32.0),
    ("Griewank", griewank, 600.0),
    ("Schwefel", schwefel, 500.0, 0.15, SCHWEFEL_AT),  # near a corner of the box, as usual
)


def ours(name, **options):
    def run(case, seed):
        bound = np.full(DIM, case.bound)
        return minimize(Problem(case, -bound, bound), name, seed=seed, budget=BUDGET, **options).cost

    return run


def scipy_de():
    from scipy.optimize import differential_evolution

    def run(case, seed):
        result = differential_evolution(
            lambda x: case(x.T),
            [(-case.bound, case.bound)] * DIM,
            popsize=5,  # 5 x 30 = 150 rows, 134 times
            maxiter=BUDGET // 150 - 1,
            tol=0.0,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=seed,
        )
        return result.fun

    return run


def cma_es():
    import cma

    def run(case, seed):
        first = np.random.default_rng(seed).uniform(-case.bound, case.bound, DIM)
        options = {
            "bounds": [-case.bound, case.bound],
            "maxfevals": BUDGET,
            "seed": seed + 1,  # it takes 0 for the clock
            "verbose": -9,
        }
        strategy = cma.CMAEvolutionStrategy(first, 0.3 * 2.0 * case.bound, options)
        while not strategy.stop():
            x = np.array(strategy.ask())
            strategy.tell(list(x), list(case(x)))
        return strategy.result.fbest

    return run


def mealpy_tlbo():
    from mealpy import TLO, FloatVar

    def run(case, seed):
        bounds = FloatVar(lb=(-case.bound,) * DIM, ub=(case.bound,) * DIM)
        problem = {"bounds": bounds, "minmax": "min", "obj_func": case, "log_to": None}
        return TLO.OriginalTLO(epoch=SIZE, pop_size=SIZE).solve(problem, seed=seed).target.fitness

    return run


METHODS = {
    "TLBO": lambda: ours("tlbo"),
    "GBTLBO": lambda: ours("gbtlbo"),
    "SHTLBO, decline": lambda: ours("shtlbo"),
    "SHTLBO, success": lambda: ours("shtlbo", p_rule="success"),
    "PSO": lambda: ours("pso"),
    "modified PSO": lambda: ours("mpso"),
    "scipy DE": scipy_de,
    "CMA-ES": cma_es,
    "mealpy TLBO": mealpy_tlbo,
}


def available():
    """The methods whose package is installed."""
    ready = {}
    for name, make in METHODS.items():
        try:
            ready[name] = make()
        except ImportError as missing:
            print(f"{name}: {missing.name} is not installed: skipped\n")
    return ready


def measure(method, args, seeds):
    """Costs (seeds,), and microseconds per candidate that the method itself takes."""
    case, began = Case(*args), perf_counter()
    costs = np.array([method(case, seed) for seed in range(seeds)])
    return costs, 1e6 * (perf_counter() - began - case.seconds) / case.evaluations


def quartiles(costs):
    low, median, high = np.quantile(costs, (0.25, 0.5, 0.75))
    return f"{median:.2e} ({low:.1e}, {high:.1e})"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30, help="runs of each method on each function")
    parser.add_argument("--quick", action="store_true", help="2 seeds, to see that everything runs")
    arguments = parser.parse_args()
    seeds = 2 if arguments.quick else arguments.seeds
    warnings.filterwarnings("ignore", module="cma|mealpy")
    methods = available()
    print(f"Cost above the optimum after {BUDGET} evaluations, {DIM} dimensions, {seeds} seeds:")
    print("median (quartiles)\n")
    print("| function | " + " | ".join(methods) + " |")
    print("|---" * (1 + len(methods)) + "|")
    own = {name: [] for name in methods}
    for args in CASES:
        cells = []
        for name, method in methods.items():
            costs, microseconds = measure(method, args, seeds)
            cells.append(quartiles(costs))
            own[name].append(microseconds)
        print(f"| {args[0]} | " + " | ".join(cells) + " |", flush=True)
    overhead = {name: np.median(values) for name, values in own.items()}
    yardstick = overhead.get("mealpy TLBO", np.nan)
    print("\nTime of the method itself, outside the cost, per candidate:\n")
    print("| method | us per candidate | of mealpy's |\n|---|---|---|")
    for name, value in overhead.items():
        print(f"| {name} | {value:.2f} | {value / yardstick:.4f} |")


if __name__ == "__main__":
    main()
