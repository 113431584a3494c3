"""Does a self-test predict what a diagnosis then finds? Simulated logs of ten kinds of noise.

    python tests/benchmarks/bench_selftest.py --repeats 20
    python tests/benchmarks/bench_selftest.py --quick

For each kind a log without a gap is self-tested: how often an effect of a size is found, with the bounds of
Clopper and Pearson, and how often a log without one raises an alarm. Then as many fresh logs of the same
machine, with that effect or none, are diagnosed. Both are samples of one rate if the self-test is right: they
are compared by Fisher's exact test at 5 %.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import process_time

from _noisy_logs import KINDS, log_of
from scipy.stats import fisher_exact

from hallsym.diagnosis import QUIET, diagnose, selftest
from hallsym.families import effects
from hallsym.families.stage import FAMILY
from hallsym.log import Log, Noise

EFFECT, RATIO, RUNS, LEVEL = "odd_nonlinearity", 1.1, 12, 0.05
CASES = {
    **{kind: (kind, True, 1.0) for kind in KINDS},
    "white, 1.3 x stated": ("white", True, 1 / 1.3),
    "ar3, 1.3 x stated": ("ar3", True, 1 / 1.3),
    "ar10, estimated": ("ar10", False, 1.0),
    "t3, estimated": ("t3", False, 1.0),
}
"""Kind of noise, whether it is stated, and what of it is stated."""


def log_for(case: str, seed: int, **gap) -> Log:
    """Return one log of a case."""
    kind, stated, part = CASES[case]
    log = log_of("stage", kind, RUNS, seed, stated=stated, **gap)
    sigmas = {c: replace(s, value=part * s.value) for c, s in log.noise.sigmas.items()}
    return replace(log, noise=Noise(sigmas))


def agreement(case: str, repeats: int, seed: int) -> list[tuple[str, int, int, float]]:
    """Return what was asked, how often self-test and diagnosis said so, and the p-value of no difference."""
    log = log_for(case, seed)
    test = selftest(log, names=[EFFECT], ratios=[RATIO], repeats=repeats, seed=seed)
    row = test.effect(EFFECT)
    predicted = round(row.curve[0].found * repeats) if row.curve else 0
    effect = next(e for e in effects(FAMILY).values() if e.name == EFFECT)
    found = alarms = 0
    for k, trial in enumerate(row.trials):
        size = {name: value for name, (value, _) in trial.size.items()}
        d = diagnose(log_for(case, 1000 * seed + k, make=effect, parameters=size))
        found += bool(d.ranked) and (
            d.ranked[0] == EFFECT or any({EFFECT, d.ranked[0]} <= {*g} for g in d.groups)
        )
        alarms += diagnose(log_for(case, 1000 * seed + 500 + k)).verdict not in QUIET
    out = []
    for what, one, other in (("found", predicted, found), ("alarms", test.false_alarms, alarms)):
        table = [[one, repeats - one], [other, repeats - other]]
        out.append((what, one, other, float(fisher_exact(table).pvalue)))
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="one case, two repeats, to see that it runs")
    arguments = parser.parse_args()
    repeats = 2 if arguments.quick else arguments.repeats
    agree = total = 0
    for case in list(CASES)[: 1 if arguments.quick else None]:
        began = process_time()
        for what, one, other, p in agreement(case, repeats, arguments.seed):
            agree, total = agree + (p >= LEVEL), total + 1
            print(f"{case:>20} {what:>7}: self-test {one:2d}, diagnosis {other:2d} of {repeats}; p {p:.2g}")
        print(f"{'':>20} {process_time() - began:.0f} s of CPU", flush=True)
    print(f"agree: {agree} of {total}")


if __name__ == "__main__":
    main()
