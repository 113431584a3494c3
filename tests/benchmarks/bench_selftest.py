"""Does a self-test predict what a diagnosis finds? Ten kinds of noise, on a stage and an encoder by turns.

    python tests/benchmarks/bench_selftest.py
    python tests/benchmarks/bench_selftest.py --machines rotary --cases pink "t3, estimated"
    python tests/benchmarks/bench_selftest.py --quick

For each kind a log without a gap is self-tested: how often an effect of a size is found, with the bounds of
Clopper and Pearson, and how often a log without one raises an alarm. Then the same motion is recorded as
often again with other noise, with that effect or none, and each log is diagnosed. Both are samples of one
rate if the self-test is right: they are compared by Fisher's exact test at 5 %. The size is one at which
noise decides what is found.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from time import process_time

from _noisy_logs import KINDS, log_of
from scipy.stats import fisher_exact

from hallsym.diagnosis import QUIET, CurvePoint, diagnose, selftest
from hallsym.families import FAMILIES, effects
from hallsym.log import Log, Noise

RATIO, RUNS, LEVEL = 1.07, 12, 0.05
PLANTED = {
    "stage": ("odd_nonlinearity", "time_skew", "cross_axis_sensitivity"),
    "rotary": ("eccentricity", "even_nonlinearity", "third_harmonic_distortion"),
}
"""Effects of each family that are planted, by the kind of noise."""
CASES = {
    **{kind: (kind, True, 1.0) for kind in KINDS},
    "white, 1.3 x stated": ("white", True, 1 / 1.3),
    "ar3, 1.3 x stated": ("ar3", True, 1 / 1.3),
    "ar10, estimated": ("ar10", False, 1.0),
    "t3, estimated": ("t3", False, 1.0),
}
"""Kind of noise, whether it is stated, and what of it is stated."""


def log_for(machine: str, case: str, seed: int, again: int = 0, **gap) -> Log:
    """Return one log of a case; `again`: recorded another time."""
    kind, stated, part = CASES[case]
    log = log_of(machine, kind, RUNS, seed, stated=stated, again=again, **gap)
    sigmas = {c: replace(s, value=part * s.value) for c, s in log.noise.sigmas.items()}
    return replace(log, noise=Noise(sigmas))


def agreement(
    machine: str, case: str, planted: str, ratio: float, repeats: int, seed: int
) -> Iterator[tuple[str, CurvePoint, int]]:
    """Yield what was asked, how often the self-test said so, and how often the diagnosis did."""
    test = selftest(log_for(machine, case, seed), names=[planted], ratios=[ratio], repeats=repeats, seed=seed)
    row = test.effect(planted)
    effect = effects(next(f for f in FAMILIES if f.name == machine))[planted]
    found = 0
    for k, trial in enumerate(row.trials):
        size = {name: value for name, (value, _) in trial.size.items()}
        d = diagnose(log_for(machine, case, seed, 1 + k, make=effect, parameters=size))
        first = d.ranked[0] if d.ranked and d.effects and d.verdict not in QUIET else ""
        found += planted == first or any({planted, first} <= {*g} for g in d.groups)
    quiet = [diagnose(log_for(machine, case, seed, 1 + repeats + k)) for k in range(repeats)]
    yield planted, row.curve[0], found
    yield "an alarm", test.false_alarm_rate, sum(d.verdict not in QUIET for d in quiet)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ratio", type=float, default=RATIO, help="gap over noise floor that is planted")
    parser.add_argument("--machines", nargs="+", choices=PLANTED, default=list(PLANTED), help="by turns")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), help="kinds of noise")
    parser.add_argument("--quick", action="store_true", help="one case, two repeats, to see that it runs")
    arguments = parser.parse_args()
    cases = arguments.cases[: 1 if arguments.quick else None]
    repeats = 2 if arguments.quick else arguments.repeats
    agree = inside = total = 0
    for case, machine in zip(cases, cycle(arguments.machines)):
        began, effects_of = process_time(), PLANTED[machine]
        effect = effects_of[list(CASES).index(case) // 2 % len(effects_of)]
        for what, point, found in agreement(machine, case, effect, arguments.ratio, repeats, arguments.seed):
            told = round(point.found * point.trials)
            p = fisher_exact([[told, point.trials - told], [found, repeats - found]]).pvalue
            agree, total = agree + (p >= LEVEL), total + 1
            inside += point.low <= found / repeats <= point.high
            bounds = f"{100 * point.low:.0f}-{100 * point.high:.0f} %"
            print(
                f"{machine:>6} {case:>19} {what:>25}: self-test {told:2d} of {point.trials} ({bounds}), "
                f"diagnosis {found:2d} of {repeats}; p {p:.2g}"
            )
        print(f"{'':>26} {process_time() - began:.0f} s of CPU", flush=True)
    print(f"agree: {agree} of {total}; inside the bounds: {inside} of {total}")


if __name__ == "__main__":
    main()
