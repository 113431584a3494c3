"""What a diagnosis says of logs that have no gap: how often it names something, and whether p is uniform.

    python tests/benchmarks/bench_diagnosis_nulls.py --logs 60
    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_diagnosis_nulls.py --logs 600 --workers 2
    python tests/benchmarks/bench_diagnosis_nulls.py --logs 160 --kinds pink --runs 8 12
    python tests/benchmarks/bench_diagnosis_nulls.py --logs 120 --runs 1
    python tests/benchmarks/bench_diagnosis_nulls.py --quick

`named`: logs with a verdict other than "no gap"; where the noise is stated 1.5 times too small, "noise larger
than stated" is right and is not one of these. `p < .05`: logs whose smallest p-value, corrected for all
that was tried, is below .05; 5 % are right. `KS`: p-value of Kolmogorov and Smirnov's test that these are
uniform. `listed`: logs with a smaller finding. `where`: logs with a statement of where something lies, which
is right in 5 % at most. `places < .05`: the same of the smallest p-value of all places, of the logs in which
places were tried at all: a log without any excess has none. The table is by kind of noise, number of runs,
machine and source of noise. The last line says the share of p < .05 of all logs with its 95 % interval
(Clopper and Pearson), and how many logs have a named effect and another verdict than the right one.
"""

from __future__ import annotations

from collections import Counter
from itertools import product
from time import process_time

import numpy as np
from _noisy_logs import EVERY, KINDS, MACHINES, WRONGLY_STATED, done, log_of, options
from scipy.stats import binomtest, kstest

from hallsym.diagnosis import diagnose
from hallsym.diagnosis.record import LARGER

RUNS = (8, 12, 24, 57)
PRIME = 7919


def settings(count: int, first: int, kinds=tuple(KINDS), runs=RUNS) -> list[tuple]:
    """So many settings: each kind of noise with each number of runs, machine and source of noise.

    A single run is one of an encoder: of a stage, whose runs have zeros of their own, none can be held out.
    Noise that is stated wrongly is always stated.
    """
    every = [
        s
        for s in product(kinds, MACHINES, runs, (True, False))
        if (s[1] == "rotary" or s[2] > 1) and (s[3] or s[0] not in WRONGLY_STATED)
    ]
    return [(*every[PRIME * (first + k) % len(every)], first + k) for k in range(count)]


def tried(kind: str, machine: str, runs: int, stated: bool, seed: int) -> dict:
    """Diagnose one log."""
    log = log_of(machine, kind, runs, seed, stated=stated)
    began = process_time()
    d = diagnose(log)
    return {
        "kind": kind, "machine": machine, "runs": runs, "stated": stated, "seed": seed,
        "verdict": d.verdict, "right": LARGER if kind == "understated" else "no gap",
        "effects": [e.name for e in d.effects],
        "smaller": [s.name for s in d.smaller_findings],
        "p": d.significance.p_value, "where": [s.text for s in d.where],
        "place": min((s.p_value for s in d.where), default=1.0),
        "cpu": process_time() - began,
    }  # fmt: skip


def table(rows: list[dict], by: str) -> None:
    """Print the rates of one grouping."""
    for value in dict.fromkeys(row[by] for row in rows):
        own = [row for row in rows if row[by] == value]
        p = np.array([row["p"] for row in own])
        places = np.array([row["place"] for row in own])
        named = sum(r["verdict"] not in ("no gap", r["right"]) for r in own)
        print(f"{value!s:>11} {len(own):4d} logs: named {named:3d}, "
              f"p < .05 {np.mean(p < 0.05):6.1%}, KS {kstest(p, 'uniform').pvalue:.2g}, "
              f"listed {sum(bool(r['smaller']) for r in own):3d}, "
              f"where {sum(bool(r['where']) for r in own):3d}, "
              f"places < .05 {np.sum(places < 0.05)} of {len(places)}")  # fmt: skip


def summary(rows: list[dict]) -> str:
    """Return the rates of all logs in one line."""
    below = sum(row["p"] < 0.05 for row in rows)
    low, high = binomtest(below, len(rows)).proportion_ci()
    named = sum(bool(row["effects"]) for row in rows)
    wrong = sum(row["verdict"] != row["right"] for row in rows)
    return (
        f"p < .05 in {below} of {len(rows)} ({below / len(rows):.1%}; {low:.1%} to {high:.1%}); "
        f"with a named effect {named}; with another verdict than the right one {wrong}"
    )


def main():
    chosen = options(
        __doc__, 24,
        lambda p: p.add_argument("--kinds", nargs="+", choices=EVERY, default=EVERY, help="kinds of noise"),
        lambda p: p.add_argument(
            "--runs", nargs="+", type=int, choices=(1, *RUNS), default=RUNS, help="numbers of runs"
        ),
    )  # fmt: skip
    rows = list(done(tried, settings(chosen.logs, chosen.first, chosen.kinds, chosen.runs), chosen))
    for row in rows:
        row["all"] = "all"
    for by in ("kind", "machine", "runs", "stated", "all"):
        table(rows, by)
    names = Counter(name for row in rows for name in row["effects"])
    print(f"named: {dict(names) or 'none'}; CPU {np.median([row['cpu'] for row in rows]):.2f} s a log")
    print(summary(rows))


if __name__ == "__main__":
    main()
