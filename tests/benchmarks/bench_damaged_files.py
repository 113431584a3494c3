"""Damaged files of every reader: how many are tried, refused, and read as another file.

    python tests/benchmarks/bench_damaged_files.py [CASES]

Each case damages one file (bytes, text, values, keys, columns; tests/mutations.py) and runs the command that
reads it. The table of docs/logs.md is what this prints for 10,000 cases (the default). Memory: 8 GB at most.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from damaged_files import KINDS, Workshop, targets

MEMORY = 8_000_000_000


def main() -> int:
    """Print the table; returns 1 where a command did what it must not do."""
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    readers = targets()
    each, more = divmod(wanted, len(readers))
    counts: Counter[tuple[str, str]] = Counter()
    faults, slowest = [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        for k, target in enumerate(readers):
            for seed in range(each + (k < more)):
                outcome = workshop.case(target, seed)
                counts[target.name, outcome.kind] += 1
                slowest = max(slowest, outcome.seconds)
                faults += [(seed, outcome)] if outcome.fault else []
    print("| reader | tried | " + " | ".join(KINDS) + " |")
    print("|---|" + "--:|" * (1 + len(KINDS)))
    for name in [*(t.name for t in readers), "all"]:
        row = [sum(n for (t, kind), n in counts.items() if name in (t, "all") and kind == k) for k in KINDS]
        print(f"| {name} | {sum(row)} | " + " | ".join(map(str, row)) + " |")
    print(f"{len(faults)} faults; the slowest took {slowest:.1f} s")
    for seed, outcome in faults:
        print(f"seed {seed}: {outcome}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
