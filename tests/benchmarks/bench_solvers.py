"""Which solver reaches the optimum of a calibration, how often, and at what cost.

    python tests/benchmarks/bench_solvers.py --seeds 30
    python tests/benchmarks/bench_solvers.py --quick

Four problems on the paper's stage, each printed as a Markdown table (docs/solvers.md quotes them):
(a) Model (31) on the merged run statistics of the bundled campaign, inside the bounds of Tables 3 and 5;
(b) the same with the channels in random order and with random signs, angles anywhere;
(c) one sample in ten of every reading and reference off by up to 1 mm or 1 mrad; judged on a noise-free log,
    success: the parameters add less than 5 % to the noise floor of every axis;
(d) local solvers from random starts, on the reading-space cost and on the error of the decoded pose.
A global method gets 20 100 evaluations, a class of 100. Success: a cost within 1e-6 of the best known one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import hallsym
import solvers
from hallsym.estimation import (
    Cost,
    LinearFit,
    closed_form,
    cost_of,
    determine,
    find_wiring,
    judge,
    linear_fit,
    noise_of,
    rewired,
    summarise,
)
from hallsym.families.published import values
from hallsym.log import Log, Noise, Sigma
from hallsym.model import Model, on_arrays
from hallsym.simulation import NoiseModel, paper_campaign, table8_noise

BUDGET, SIZE, KEEP, SAME = 20_100, 100, 3, 1e-6
EVERY = 5
"""The decoded-space cost uses every fifth sample of the bundled campaign, to save time."""
METHODS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("TLBO", "tlbo", {}),
    ("GBTLBO", "gbtlbo", {}),
    ("SHTLBO, decline", "shtlbo", {"p_rule": "decline"}),
    ("SHTLBO, success", "shtlbo", {"p_rule": "success"}),
    ("PSO", "pso", {}),
    ("screening", "screening", {}),
)


@dataclass(frozen=True, eq=False)
class Task:
    """A merged cost as a problem in units of the bounds; `held` parameters stay as in `base`."""

    cost: Cost
    base: np.ndarray
    held: tuple[int, ...] = ()

    @property
    def model(self) -> Model:
        return self.cost.summary.model

    @property
    def free(self) -> np.ndarray:
        return np.array([k for k in range(len(self.base)) if k not in self.held])

    def unit(self, p: np.ndarray) -> np.ndarray:
        lower, upper = (b[self.free] for b in self.model.bounds)
        return (p[self.free] - lower) / (upper - lower)

    def full(self, x: np.ndarray) -> np.ndarray:
        lower, upper = (b[self.free] for b in self.model.bounds)
        p = np.tile(self.base, (*x.shape[:-1], 1)) if x.ndim > 1 else self.base.copy()
        p[..., self.free] = lower + x * (upper - lower)
        return p

    def problem(self) -> solvers.Problem:
        lower, upper = (b[self.free] for b in self.model.bounds)
        width, samples, free = upper - lower, float(self.cost.summary.counts.sum()), self.free

        def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            f, g, H = self.cost.at(self.full(x)).derivatives()
            scaled = H[np.ix_(free, free)] * np.outer(width, width)
            return f / samples, g[free] * width / samples, scaled / samples

        return solvers.Problem(
            lambda x: self.cost.population(self.full(x)) / samples,
            np.zeros(len(free)),
            np.ones(len(free)),
            derivatives=derivatives,
        )


def task_on(log: Log, model: Model, *, hold: bool) -> tuple[Task, np.ndarray, LinearFit]:
    """Return the merged problem of a log and its closed-form start."""
    sigma = noise_of(log, model).std
    merged = cost_of(summarise(log, model).merged(), sigma)
    linear = linear_fit(merged)
    first = np.clip(closed_form(merged, linear), *model.bounds)
    held = determine(merged, first).held if hold else ()
    first[list(held)] = np.clip(model.nominal, *model.bounds)[list(held)]
    return Task(merged, first, held), first, linear


# -- (a), (b) ----------------------------------------------------------------------------------------------


def global_rows(name: str, tasks: list[Task], seeds: int, best: float) -> Iterator[list[str]]:
    """Each method alone and followed by IPOPT from the best three points that are apart."""
    for label, method, options in METHODS:
        size = {} if method == "screening" else {"size": SIZE}
        alone, after, seconds, refined = [], [], [], []
        for seed in range(seeds):
            found = solvers.hybrid(
                tasks[seed % len(tasks)].problem(),
                seed=seed,
                keep=KEEP,
                budget=BUDGET,
                global_solver=method,
                **size,
                **options,
            )
            assert found.explored is not None
            alone.append(found.explored.cost)
            seconds.append(found.explored.seconds)
            after.append(found.cost)
            refined.append(found.seconds - found.explored.seconds)
        yield row(label, alone, seconds, best)
        yield row(f"{label}, then IPOPT", after, list(np.add(seconds, refined)), best)


def row(label: str, costs: list[float], seconds: list[float], best: float) -> list[str]:
    good = sum(cost <= best * (1 + SAME) for cost in costs)
    above = float(np.median(costs)) / best - 1
    text = "below 1e-6" if above <= SAME else f"{above:.2g}"
    return [
        label,
        f"{good} of {len(costs)}",
        text,
        f"{max(costs) / best - 1:.2g}",
        f"{np.median(seconds):.3g}",
    ]


HEAD = ["solver", "success", "median above the optimum", "worst", "seconds"]


def bundled(seeds: int) -> None:
    """(a)."""
    log, model = hallsym.bundled_campaign(), hallsym.build("stage31")
    task, first, _ = task_on(log, model, hold=True)
    began = perf_counter()
    direct = solvers.ipopt(task.problem(), task.unit(first))
    seconds = perf_counter() - began
    table(
        f"(a) Model (31), Tables 3 and 5, {len(task.free)} free parameters",
        HEAD,
        [row("direct: closed form, then IPOPT", [direct.cost], [seconds], direct.cost),
         *global_rows("a", [task], seeds, direct.cost)],
    )  # fmt: skip


def anywhere() -> Model:
    """Model (31) without knowledge of angles, signs and order.

    theta a little beyond +-180 deg, so that an inverted probe does not sit at a bound; eta of either sign.
    """
    model, free = hallsym.build("stage31"), {}
    for name in model.names:
        limit = {"H": 0.5, "e": 1.05, "t": np.radians(190)}.get(name[0], 5000.0)
        free[name] = {"lower": -limit, "upper": limit}
    return model.with_parameters(free)


def miswired(seeds: int) -> None:
    """(b)."""
    log, known, model = hallsym.bundled_campaign(), hallsym.build("stage31"), anywhere()
    best_task, first, _ = task_on(log, known, hold=True)
    best = solvers.ipopt(best_task.problem(), best_task.unit(first)).cost
    tasks, direct, found, times = [], [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        order, signs = rng.permutation(3), rng.choice([-1, 1], 3)
        crossed = rewired(
            log, model.channels, tuple((model.channels[k], int(s)) for k, s in zip(order, signs, strict=True))
        )
        began = perf_counter()
        task, first, _ = task_on(crossed, model, hold=False)
        direct.append(solvers.ipopt(task.problem(), task.unit(first)).cost)
        middle = perf_counter()
        seen = cost_of(summarise(crossed, known), noise_of(crossed, known).std)
        wiring = find_wiring(crossed, seen)
        again, first, _ = task_on(rewired(crossed, model.channels, wiring), known, hold=True)
        found.append(solvers.ipopt(again.problem(), again.unit(first)).cost)
        times.append((middle - began, perf_counter() - middle))
        tasks.append(task)
    table(
        f"(b) order and signs unknown, angles anywhere, {len(model.names)} free parameters",
        HEAD,
        [row("find_wiring, closed form, then IPOPT", found, [t[1] for t in times], best),
         row("direct: closed form, then IPOPT", direct, [t[0] for t in times], best),
         *global_rows("b", tasks, seeds, best)],
    )  # fmt: skip


# -- (c) ---------------------------------------------------------------------------------------------------


def outliers(seeds: int) -> None:
    """(c)."""
    model, truth = hallsym.build("stage31"), values("table7_estimates")
    campaign, noise = paper_campaign(step_s=0.01), table8_noise(model)
    clean = Log.from_arrays(hallsym.simulate(model, truth, campaign, seed=0))
    cases = [(s, "auto") for s in ("direct", "hybrid", "tlbo", "gbtlbo", "pso", "screening")]
    cases += [("direct", "tukey"), ("direct", "none")]
    errors: dict[tuple[str, str], list[np.ndarray]] = {case: [] for case in cases}
    seconds: dict[tuple[str, str], list[float]] = {case: [] for case in cases}
    without: list[np.ndarray] = []
    for seed in range(seeds):
        spoilt = NoiseModel(noise.sigma, outlier_share=0.1)
        stated = Noise({c: Sigma(s, "given") for c, s in noise.sigma.items()})
        log = Log.from_arrays(hallsym.simulate(model, truth, campaign, spoilt, seed=seed), noise=stated)
        good = Log.from_arrays(hallsym.simulate(model, truth, campaign, noise, seed=seed), noise=stated)
        without.append(seen_on(clean, hallsym.fit(good, "stage31", solver="direct", loss="none"), noise))
        for solver, loss in cases:
            began = perf_counter()
            try:
                fit = hallsym.fit(log, "stage31", solver=solver, loss=loss, seed=seed)
            except hallsym.InputError:  # the reference does not seem to belong to the readings
                continue
            errors[solver, loss].append(seen_on(clean, fit, noise))
            seconds[solver, loss].append(perf_counter() - began)
    lines = []
    for case in cases:
        label = "`" + "`, `".join(case) + "`"
        if errors[case]:
            lines.append(judged(label, errors[case], seeds, seconds[case]))
        else:
            lines.append([label, f"refused in {seeds} of {seeds}", "", "", ""])
    lines.append(judged("the same logs without outliers", without, seeds, []))
    head = ["solver, loss", "success", "median x / y / Rz [um, um, urad]", "worst", "seconds"]
    table("(c) 10 % of every reading and reference are gross outliers", head, lines)


FLOOR = np.array([1.386, 1.542, 2.307])
"""Noise floor of x, y [um] and Rz [urad] on the bundled campaign."""
ADDS = np.sqrt(1.05**2 - 1)
"""An error of this many noise floors adds 5 % to the rms."""


def seen_on(clean: Log, fit: hallsym.Fit, noise: NoiseModel) -> np.ndarray:
    """Rms of x, y [um] and Rz [urad] that the parameters alone cause."""
    errors = judge(clean, fit.model, fit.values, noise.sigma).over()
    assert errors is not None
    return np.array(list(errors["rmse"].values())) * 1e6


def judged(label: str, errors: list[np.ndarray], seeds: int, seconds: list[float]) -> list[str]:
    e = np.array(errors)
    good = int(np.sum(np.all(e < ADDS * FLOOR, axis=1)))
    middle, worst = (" / ".join(f"{v:.2g}" for v in part) for part in (np.median(e, axis=0), e.max(axis=0)))
    return [label, f"{good} of {seeds}", middle, worst, f"{np.median(seconds):.2g}" if seconds else ""]


# -- (d) ---------------------------------------------------------------------------------------------------


def decoded(starts: int) -> None:
    """(d): the same random starts, local solvers in reading space and in decoded space."""
    log, model = hallsym.bundled_campaign(), hallsym.build("stage31")
    task, first, _ = task_on(log, model, hold=True)
    problem, rng = task.problem(), np.random.default_rng(0)
    points = rng.random((starts, len(task.free)))
    best = solvers.ipopt(problem, task.unit(first))
    reading = [solvers.ipopt(problem, x) for x in points]
    residual = decoded_residual(log, task)
    optimum = least_squares(residual, best.x, bounds=(0, 1), xtol=1e-12, ftol=1e-12).cost
    ends, seconds = [], []
    for x in points:
        began = perf_counter()
        ends.append(least_squares(residual, x, bounds=(0, 1), x_scale="jac", max_nfev=200).cost)
        seconds.append(perf_counter() - began)
    near = []
    for p in (first, np.clip(model.nominal, *model.bounds)):
        inside = np.clip(task.unit(p), 1e-9, 1 - 1e-9)
        near.append(least_squares(residual, inside, bounds=(0, 1), x_scale="jac", max_nfev=200).cost)
    crossing = np.mean([crosses_zero(log, task, x) for x in points])
    rows = [
        row("reading space, IPOPT", [r.cost for r in reading], [r.seconds for r in reading], best.cost),
        row("decoded space, scipy least_squares", ends, seconds, optimum),
        row("the same from the closed form and from the design", near, [np.nan], optimum),
    ]
    table(f"(d) local solvers from {starts} random starts in the boxes of Tables 3 and 5", HEAD, rows)
    print(f"\n{crossing:.0%} of the starts have a gain that vanishes at some setting of the campaign.")


def decoded_residual(log: Log, task: Task) -> Callable[[np.ndarray], np.ndarray]:
    """Reference minus decoded pose over noise, each run's mean taken out (its zero deviations)."""
    model, blocks = task.model, list(log.blocks())
    decode = on_arrays(model.decoded)
    columns = {c: np.concatenate([b.data[c][::EVERY] for b in blocks]) for c in blocks[0].data}
    edges = np.cumsum([0, *(len(b.data["t_s"][::EVERY]) for b in blocks)])
    readings, states = ([columns[c] for c in names] for names in (model.channels, model.state))
    weight, zero = np.ones(len(model.channels)), np.zeros(len(model.zeros))

    def residual(x: np.ndarray) -> np.ndarray:
        pose = decode(task.full(x), zero, readings, states, weight)[0]
        error = (pose - np.array([columns[c] for c in model.references])) / (FLOOR[:, None] * 1e-6)
        means = np.add.reduceat(error, edges[:-1], axis=1) / np.diff(edges)
        return np.clip(error - np.repeat(means, np.diff(edges), axis=1), -1e9, 1e9).ravel()

    return residual


def crosses_zero(log: Log, task: Task, x: np.ndarray) -> bool:
    """Whether a gain is of different sign at two settings of the campaign: a pole lies between."""
    gains = on_arrays(task.model.gain)
    states = np.array([[np.mean(b.data[c]) for c in task.model.state] for b in log.blocks()]).T
    (phi,) = gains(task.full(x), list(states))
    return bool(np.any(phi.min(axis=1) * phi.max(axis=1) < 0))


def table(title: str, head: list[str], rows: list[list[str]]) -> None:
    print(f"\n{title}\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for line in rows:
        print("| " + " | ".join(line) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=30, help="seeds of (a), (b) and (c)")
    parser.add_argument("--starts", type=int, default=50, help="starts of (d)")
    parser.add_argument("--only", default="abcd", help="which tables, such as ad (default: all)")
    parser.add_argument("--quick", action="store_true", help="two seeds, five starts")
    options = parser.parse_args()
    seeds, starts = (2, 5) if options.quick else (options.seeds, options.starts)
    for letter, run, n in (("a", bundled, seeds), ("b", miswired, seeds), ("c", outliers, seeds)):
        if letter in options.only:
            run(n)
    if "d" in options.only:
        decoded(starts)


if __name__ == "__main__":
    main()
