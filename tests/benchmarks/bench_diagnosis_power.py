"""How often does a diagnosis name a gap that is hardly larger than the noise?

    python tests/benchmarks/bench_diagnosis_power.py --logs 32
    python tests/benchmarks/bench_diagnosis_power.py --quick

Each log has one effect that the model lacks, which leaves 1.07 or 1.15 times the noise floor, in white or in
autoregressive noise. `named`: the effect, or the group that it is in, is the first cause. `noticed`: any
verdict but "no gap". Bounds are those of Clopper and Pearson, 95 %.
"""

from __future__ import annotations

import argparse
import json
from itertools import product

from _noisy_logs import log_of
from bench_diagnosis_coverage import GAPS, sized
from scipy.stats import binomtest

from hallsym.diagnosis import QUIET, diagnose

TIMES, NOISE, RUNS = (1.07, 1.15), ("white", "ar3"), (12, 24)


def tried(times: float, kind: str, seed: int) -> dict:
    """Diagnose one log."""
    machine, effect, start = GAPS[seed % len(GAPS)]
    runs = RUNS[seed // len(GAPS) % len(RUNS)]
    make, parameters = sized(machine, effect, start, runs, seed, times)
    d = diagnose(log_of(machine, kind, runs, seed, make=make, parameters=parameters))
    alike = {d.ranked[0]}.union(*(g for g in d.groups if d.ranked[0] in g)) if d.ranked else set()
    return {"times": times, "kind": kind, "effect": effect, "runs": runs, "seed": seed, "verdict": d.verdict,
            "ranked": d.ranked[:3], "named": effect in alike, "noticed": d.verdict not in QUIET}  # fmt: skip


def rate(rows: list[dict], what: str) -> str:
    """Return how many of so many, with bounds."""
    found = sum(row[what] for row in rows)
    low, high = binomtest(found, len(rows)).proportion_ci()
    return f"{what} {found:2d} of {len(rows)} ({low:.0%} to {high:.0%})"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=32, help="logs of each size and kind of noise")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--out", help="file for the rows as JSON lines")
    parser.add_argument("--quick", action="store_true", help="one log of each, to see that everything runs")
    arguments = parser.parse_args()
    for times, kind in product(TIMES, NOISE):
        rows = []
        for seed in range(arguments.first, arguments.first + (1 if arguments.quick else arguments.logs)):
            rows.append(tried(times, kind, seed))
            if arguments.out:
                with open(arguments.out, "a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
        print(f"{times:.2f} x, {kind:>5}: {rate(rows, 'named')}, {rate(rows, 'noticed')}", flush=True)


if __name__ == "__main__":
    main()
