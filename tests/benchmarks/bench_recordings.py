"""How often a mistake of recording is noticed, named with its remedy, or believed; and false alarms.

    python tests/benchmarks/bench_recordings.py --seed 1
    python tests/benchmarks/bench_recordings.py --seed 1 --families rotary chip --kinds "sign of a reading, run"
    python tests/benchmarks/bench_recordings.py --seed 1 --part 1/4 --json part1.json
    python tests/benchmarks/bench_recordings.py --only "sign of a reading, run/rotary/1.0"
    python tests/benchmarks/bench_recordings.py --healthy

`right`: the first correction that is named undoes the mistake; `rival`: it is said to be one of several that
the log cannot tell apart; `wrong`: another one is named first; `noticed`: refused, or exit code 3 or a claim
without a correction; `silent`: exit 0 and no claim although the calibration decodes a healthy log with more
than three times the noise; `consist.`: the same, but right where a controller reads the same columns with the
same mistake; `harmless`: nothing is said and nobody is hurt; `legal`: another machine records just that.
Rates are over mistakes that are neither harmless nor legal.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import recordings
from recording_scores import Outcome, judged_mistake

VERDICTS = ("right", "rival", "wrong", "noticed", "silent", "consistent", "harmless", "legal")


def table(rows: Iterable[Outcome], by: str) -> None:
    """Print how many cases of each kind or family came to which end."""
    groups: dict[str, Counter] = {}
    for row in rows:
        groups.setdefault(getattr(row, by), Counter())[row.verdict] += 1
    print(f"\n{by:38}" + "".join(f"{v[:8]:>10}" for v in VERDICTS))
    for name, count in groups.items():
        print(f"{name:38}" + "".join(f"{count[v] or '':>10}" for v in VERDICTS))


def rates(rows: list[Outcome]) -> str:
    """Return the rates in one line."""
    count = Counter(row.verdict for row in rows)
    felt = sum(count[v] for v in ("right", "rival", "wrong", "noticed", "silent", "consistent"))
    share = lambda *names: sum(count[n] for n in names) / max(1, felt)  # noqa: E731
    return (
        f"{len(rows)} mistakes, {felt} of them felt: right {share('right'):.1%}, right or rival "
        f"{share('right', 'rival'):.1%}, noticed {1 - share('silent', 'consistent'):.1%}, silent and wrong "
        f"{share('silent'):.1%} (and {share('consistent'):.1%} consistent), wrong remedies {count['wrong']}"
    )


def listing(rows: list[Outcome]) -> None:
    """Print each case that came to no good end, so that it can be made again."""
    for kind in ("silent", "consistent", "wrong"):
        for row in (r for r in rows if r.verdict == kind):
            numbers = "" if row.harm is None else f" harm {row.harm:.3g}, own {row.own:.3g};"
            print(f"{kind}: --only {row.case!r};{numbers} right: {' or '.join(row.right[:3])}; "
                  f"said: {row.first or row.said[:150]}")  # fmt: skip


def chosen(options: argparse.Namespace) -> list[tuple[str, str, str]]:
    """Return the cases that the options choose."""
    if options.only:
        return [tuple(case.rsplit("/", 2)) for case in options.only]  # type: ignore[misc]
    found = recordings.cases(options.seed, options.repeat)
    found = [c for c in found if c[1] in (options.families or recordings.FAMILIES)]
    if options.kinds:
        found = [c for c in found if any(k in c[0] for k in options.kinds)]
    part, parts = map(int, options.part.split("/"))
    return found[part - 1 :: parts]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=1, help="cases of each kind and family")
    parser.add_argument("--kinds", nargs="+", help="parts of the names of kinds")
    parser.add_argument("--families", nargs="+", choices=recordings.FAMILIES)
    parser.add_argument("--part", default="1/1", help="k/m: the k-th of m parts of the cases")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="KIND/FAMILY/SEED, as a listing names it")
    parser.add_argument("--json", metavar="OUT", help="file for the outcomes, one a line")
    options = parser.parse_args()
    rows = []
    for case in chosen(options):
        m = recordings.mistaken(*case)
        try:
            row = judged_mistake(m)
        except Exception as error:  # a bug of hallsym is an outcome, the others are wanted all the same
            print(f"FAILED: --only {m.case!r}: {error!r}", flush=True)
            continue
        rows.append(row)
        if options.json:
            with open(options.json, "a", encoding="utf-8") as file:
                file.write(json.dumps(row.record, default=str) + "\n")
        if options.only:
            print(json.dumps(row.record, indent=1, default=str))
    table(rows, "kind")
    table(rows, "family")
    listing(rows)
    print(f"\n{rates(rows)}; CPU {sum(r.seconds for r in rows):.0f} s")


if __name__ == "__main__":
    main()
