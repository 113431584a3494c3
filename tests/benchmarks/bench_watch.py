"""How often `watch` calls a log changed that belongs: many simulated encoders, by kind of noise.

    python tests/benchmarks/bench_watch.py --logs 2000

`alarms`: logs called changed; 1 in 500 is stated. `p < .05`: logs whose smallest p-value, times the number of
its tests, is below .05. Every ten logs have a calibration of their own, so that its errors are averaged.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "watching"))

from watched_logs import alarms

KINDS: dict[str, dict[str, float | bool]] = {
    "white, stated": {},
    "white, estimated": {"stated": False},
    "correlated, stated": {"correlation": 3.0},
    "correlated, estimated": {"correlation": 3.0, "stated": False},
}


def main() -> None:
    """Print one line a kind of noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    for kind, how in KINDS.items():
        began = process_time()
        logs = parser.parse_args().logs
        found, least = alarms(logs, **how)
        below = np.mean(least < 0.05)
        print(f"{kind:>22}: {found} alarms of {logs} ({found / logs:.2%}), p < .05 {below:.1%}, "
              f"{(process_time() - began) / logs:.3f} s each", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
