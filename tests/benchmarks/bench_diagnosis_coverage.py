"""Does the stated 95 % interval of the shrinkage hold on runs that nobody has seen?

    python tests/benchmarks/bench_diagnosis_coverage.py --logs 40
    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_diagnosis_coverage.py --effects 2 --workers 2
    python tests/benchmarks/bench_diagnosis_coverage.py --times 1.07 1.15
    python tests/benchmarks/bench_diagnosis_coverage.py --quick

Each gap is one effect that the model lacks, at 1.07 to 3 times the noise floor, or two of different links of
the chain, each at 1.6 to 3 times the floor by itself. The machine is diagnosed; then the model before and the
model after decode a fresh campaign of the same kind, and the shrinkage there, that of all that was named, is
held against the interval. `overclaim`: stated less fresh shrinkage. `all named`: each effect, or one that the
log cannot tell from it. The interval of the coverage is that of Clopper and Pearson.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from time import process_time

import numpy as np
from _noisy_logs import done, log_of, options
from scipy.stats import binomtest

from hallsym.diagnosis import examine, prepare
from hallsym.diagnosis.decoded_errors import decoded_errors
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.families import build, effect_named

GAPS = (
    ("stage", "even_nonlinearity", 1e-2),
    ("stage", "odd_nonlinearity", 1e-2),
    ("stage", "time_skew", 1e-4),
    ("rotary", "third_harmonic_distortion", 1e-3),
    ("rotary", "time_skew", 1e-5),
    ("rotary", "magnet_tilt", 1e-3),
)
PAIRS = (
    ("stage", ("even_nonlinearity", 1e-2), ("time_skew", 1e-4)),
    ("stage", ("odd_nonlinearity", 1e-2), ("gain_time_drift:duration_s=60", 1e-3)),
    ("stage", ("height_quadratic", 1e5), ("time_skew", 1e-4)),
    ("rotary", ("third_harmonic_distortion", 1e-3), ("time_skew", 1e-5)),
    ("rotary", ("magnet_tilt", 1e-3), ("third_harmonic_distortion", 1e-3)),
    ("rotary", ("even_nonlinearity", 1e-3), ("time_skew", 1e-5)),
)
MODELS = {"stage": "stage31", "rotary": "ellipse"}
TIMES = (1.07, 1.15, 1.3, 1.6, 2.0, 3.0)
CLEAR = (1.6, 2.0, 3.0)
RUNS = (12, 24, 57)
NOISE = ("white", "ar3")
PRIME = 67


def settings(effects: int, first: int, count: int, times: Sequence[float]) -> list[tuple]:
    """Return so many settings of one effect each, or of two."""
    numbers = range(first, first + count)
    if effects == 2:
        every = [(m, pair, *rest) for *rest, (m, *pair) in product(times, RUNS, NOISE, PAIRS)]
        return [(*every[PRIME * k % len(every)], k) for k in numbers]
    return [
        (machine, [(effect, start)], times[k * 5 // 6 % len(times)], RUNS[k // 2 % 3], NOISE[k // 3 % 2], k)
        for k in numbers
        for machine, effect, start in [GAPS[k % len(GAPS)]]
    ]


def sized(machine: str, effect: str, start: float, runs: int, seed: int, times: float, number: int = 0):
    """The effect's parameters that leave so many times the floor, found by two trials without noise kinds.

    Each number draws other parameters.
    """
    base = build(MODELS[machine])
    make = lambda model: effect_named(effect, model).added(model, effect)  # noqa: E731
    wide = make(base)
    rng = np.random.default_rng([seed, number])
    signs = {
        p.name: rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0)
        for p in wide.parameters
        if p.name not in base.names
    }
    size = start
    for _ in range(2):
        log = log_of(
            machine, "white", runs, seed, make=make, parameters={n: size * s for n, s in signs.items()}
        )
        setup = prepare(log)
        errors = decoded_errors(setup.base, setup.base.log.runs)
        excess = np.sqrt(max((errors.metric / setup.floor.metric) ** 2 - 1, 1e-4))
        size *= np.sqrt(times**2 - 1) / excess
    return make, {n: size * s for n, s in signs.items()}


def all_sized(machine: str, effects, runs: int, seed: int, times: float):
    """The parameters of several effects, of which each leaves so many times the floor by itself."""
    makes, parameters = [], {}
    for number, (effect, start) in enumerate(effects):
        make, own = sized(machine, effect, start, runs, seed, times, number)
        makes.append(make)
        parameters |= own

    def make_all(model):
        for make in makes:
            model = make(model)
        return model

    return make_all, parameters


def shrinkage_on(log, before, after) -> float:
    """Shrinkage of the gap on fresh runs; their zeros are their own."""
    metric = []
    for base in (before, after):
        zeros = dict.fromkeys(log.runs, np.zeros(len(base.model.offsets)))
        there = replace(base, log=log, offsets=zeros, keep=None, holdout=frozenset())
        t = normal_equations(there)
        metric.append(np.sqrt(t.decoded.border[:, -1, -1].sum()))
    return 1 - metric[1] / metric[0]


def tried(machine, effects, times, runs, kind, seed) -> dict:
    """Diagnose one gap."""
    make, parameters = all_sized(machine, effects, runs, seed, times)
    began = process_time()
    found = examine(prepare(log_of(machine, kind, runs, seed, make=make, parameters=parameters)))
    d, cpu = found.diagnosis, process_time() - began
    true, names = [e.partition(":")[0] for e, _ in effects], [e.name for e in d.effects]
    alike = [{e}.union(*(g for g in d.groups if e in g)) for e in true]
    row = {"effect": " and ".join(true), "times": times, "runs": runs, "kind": kind, "seed": seed,
           "verdict": d.verdict, "named": names, "all named": all(a & set(names) for a in alike),
           "groups": d.groups, "cpu": cpu}  # fmt: skip
    if found.after is not None:
        log = log_of(machine, kind, runs, seed + 100_000, make=make, parameters=parameters, fresh=True)
        fresh = float(shrinkage_on(log, found.before, found.after))
        row |= {"stated": d.shrinkage.value, "interval": d.shrinkage.interval, "fresh": fresh}
    return row


def main():
    chosen = options(
        __doc__, 12,
        lambda p: p.add_argument("--effects", type=int, default=1, choices=(1, 2), help="effects at once"),
        lambda p: p.add_argument("--times", nargs="+", type=float, help="gaps over the noise floor"),
    )  # fmt: skip
    times = chosen.times or (TIMES if chosen.effects == 1 else CLEAR)
    rows = list(done(tried, settings(chosen.effects, chosen.first, chosen.logs, times), chosen))
    detected = [r for r in rows if "stated" in r]
    judged = [r for r in detected if r["interval"] is not None]
    held = [r["interval"][0] <= r["fresh"] <= r["interval"][1] for r in judged]
    over = [r["stated"] - r["fresh"] for r in detected]
    low, high = binomtest(sum(held), len(held)).proportion_ci()
    print(f"{len(rows)} gaps, {len(detected)} named, all named {sum(r['all named'] for r in rows)}; "
          f"95 % intervals hold {sum(held)} of {len(held)} ({low:.1%} to {high:.1%}); "
          f"overclaim median {np.median(over):+.3f}, largest {max(over):+.3f}; "
          f"width median {np.median([r['interval'][1] - r['interval'][0] for r in judged]):.3f}; "
          f"CPU {np.median([r['cpu'] for r in rows]):.2f} s")  # fmt: skip
    for large, kind in sorted({(r["times"], r["kind"]) for r in rows}):
        own = [r["all named"] for r in rows if (r["times"], r["kind"]) == (large, kind)]
        low, high = binomtest(sum(own), len(own)).proportion_ci()
        print(f"{large:5.2f} x, {kind:>5}: all named {sum(own)} of {len(own)} ({low:.0%} to {high:.0%})")


if __name__ == "__main__":
    main()
