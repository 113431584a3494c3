"""How often a mistake of recording is noticed, named with its remedy, or believed; and false alarms.

    python tests/benchmarks/bench_recordings.py                              a tenth of all cases
    python tests/benchmarks/bench_recordings.py --seed 1 --part 1/1          all
    python tests/benchmarks/bench_recordings.py --seed 1 --part 1/1 --families rotary --kinds "sign of"
    python tests/benchmarks/bench_recordings.py --only "sign of a reading, run/rotary/1.0"
    python tests/benchmarks/bench_recordings.py --healthy --part 1/1

`right`: the first correction that is named undoes the mistake; `rival`: it is said to be one of several that
the log cannot tell apart; `equal`: another is named that makes a log which is described and does no harm;
`wrong`: any other is named first; `noticed`: refused, or exit code 3 or a claim without a correction;
`silent`: exit 0 and no claim although the calibration decodes a healthy log with more than three times the
noise; `consiste`: the same, but right where a controller reads the same columns with the same mistake;
`harmless`: nothing is said and nobody is hurt; `legal`: another machine records just that. Rates are over
mistakes that are neither harmless nor legal. Of a healthy log: `ok`; `noted`: exit code 3 or a claim without
a correction; `false`: a claim with a correction, or a refusal.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import recordings
from recording_scores import FELT, Outcome, judged, rates

MISTAKEN = (*FELT, "harmless", "legal")
WITHOUT = ("ok", "noted", "false")
LISTED = ("silent", "consistent", "wrong", "false")


def table(rows: Iterable[Outcome], by: str, verdicts: tuple[str, ...]) -> None:
    """Print how many cases of each kind or family came to which end."""
    groups: dict[str, Counter] = {}
    for row in rows:
        groups.setdefault(getattr(row, by), Counter())[row.verdict] += 1
    print(f"\n{by:38}" + "".join(f"{v[:8]:>10}" for v in verdicts))
    for name, count in groups.items():
        print(f"{name:38}" + "".join(f"{count[v] or '':>10}" for v in verdicts))


def listing(rows: list[Outcome]) -> None:
    """Print each case that came to no good end, so that it can be made again."""
    for kind in LISTED:
        for row in (r for r in rows if r.verdict == kind):
            numbers = "" if row.harm is None else f" harm {row.harm:.3g}, own {row.own:.3g};"
            right = f" right: {' or '.join(row.right[:3])};" if row.right else ""
            print(f"{kind}: --only {row.case!r};{numbers}{right} said: {row.first or row.said[:150]}")


def chosen(options: argparse.Namespace) -> list[tuple[str, str, str]]:
    """Return the cases that the options choose."""
    if options.only:
        return [(kind, family, seed) for kind, family, seed in (case.rsplit("/", 2) for case in options.only)]
    every = recordings.healthy_cases if options.healthy else recordings.cases
    found = [c for c in every(options.seed, options.repeat) if c[1] in options.families]
    found = [c for c in found if any(k in c[0] for k in options.kinds)]
    part, parts = map(int, options.part.split("/"))
    return found[part - 1 :: parts]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=1, help="cases of each kind and family")
    parser.add_argument("--healthy", action="store_true", help="logs without a mistake")
    parser.add_argument("--kinds", nargs="+", default=[""], help="parts of the names of kinds")
    parser.add_argument("--families", nargs="+", choices=recordings.FAMILIES, default=recordings.FAMILIES)
    parser.add_argument("--part", default="1/10", help="k/m: the k-th of m parts of the cases (1/10)")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="KIND/FAMILY/SEED, as a listing names it")
    options = parser.parse_args()
    rows = []
    for case in chosen(options):
        try:
            row = judged(*case)
        except Exception as error:  # a bug of hallsym is an outcome, the others are wanted all the same
            print(f"FAILED: --only {'/'.join(case)!r}: {error!r}", flush=True)
            continue
        rows.append(row)
        if options.only:
            print(json.dumps(asdict(row), indent=1, default=str))
    report(rows)


def report(rows: list[Outcome]) -> None:
    """Print tables by kind and by family, each case that came to no good end, and the rates."""
    verdicts = WITHOUT if all(row.verdict in WITHOUT for row in rows) else MISTAKEN
    table(rows, "kind", verdicts)
    table(rows, "family", verdicts)
    listing(rows)
    print(*(f"{name} {value:.3g}" for name, value in rates(rows).items()), sep=", ")
    print(f"CPU {sum(r.seconds for r in rows):.0f} s")


if __name__ == "__main__":
    main()
