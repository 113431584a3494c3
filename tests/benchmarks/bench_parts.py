"""A log in parts that is larger than memory: run statistics made by two workers of 1 GB, beside one pass.

    python tests/benchmarks/bench_parts.py                      200 million samples: 3.4 GB on the disk
    python tests/benchmarks/bench_parts.py --samples 50000000 --keep dataset

`hallsym simulate --part-rows` writes an encoder's log. It is fitted in one pass, then by two workers; every
process of the second fit may have 1 GB of data (RLIMIT_DATA), and the largest resident set of a worker is
printed. Values, uncertainties and errors of both must agree to 1e-10.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

RUN_SAMPLES, PART_SAMPLES = 200_000, 10_000_000
STEP_S = 1e-4
LIMIT = 1 << 30
"""Bytes of data that a process may have."""
AGREE = 1e-10
NOISE = {"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5}
FIT = """
import json, resource, sys
from time import perf_counter, process_time
import hallsym
from hallsym.workers import Workers

def main(folder, workers, limit, noise):
    if limit:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    began = perf_counter()
    log = hallsym.read_log(folder, noise=noise, workers=Workers(workers) if workers else None)
    fit = hallsym.fit(log, "rotary", solver="direct")
    own, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(json.dumps({
        "seconds": perf_counter() - began, "cpu": process_time(),
        "workers_cpu": theirs.ru_utime + theirs.ru_stime,
        "own_mb": own.ru_maxrss / 1e3, "worker_mb": theirs.ru_maxrss / 1e3, "values": fit.values.tolist(),
        "std": fit.std.tolist(), "rows": fit.log["rows"], "cost": fit.solver["cost"],
        "rmse": [list(row["rmse"].values()) for row in fit.error_rows.values() if row],
        "peak": [list(row["peak"].values()) for row in fit.error_rows.values() if row],
    }))

if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
"""


def write(folder: Path, samples: int) -> None:
    """Write the log of an encoder that turns to and fro, in parts of whole runs."""
    runs = -(-samples // RUN_SAMPLES)
    words = [f"step_s = {STEP_S}", "[noise]", *(f"{c} = {s}" for c, s in NOISE.items())]
    for k in range(runs):
        words += ["[[run]]", f"duration_s = {STEP_S * RUN_SAMPLES}", "[run.angle_rad]", 'kind = "ramp"',
                  f"rate = {13.0 - 26.0 * (k % 2)}", f"about = {0.7 * k % 6.28:.2f}"]  # fmt: skip
    campaign = folder.with_suffix(".toml")
    campaign.write_text("\n".join(words))
    call = [sys.executable, "-m", "hallsym", "simulate", str(campaign), "--model", "rotary", "--seed", "1",
            "--part-rows", str(min(PART_SAMPLES, max(samples // 4, 1))), "-o", str(folder)]  # fmt: skip
    subprocess.run(call, check=True)


def fitted(folder: Path, workers: int | None, limit: int) -> dict[str, Any]:
    """Return what a fit in a process of its own gave, and what it took."""
    with tempfile.NamedTemporaryFile("w", suffix=".py") as script:
        script.write(FIT)
        script.flush()
        asked = json.dumps([str(folder), workers, limit, NOISE])
        env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, script.name, asked], stdout=subprocess.PIPE, text=True, check=True, env=env
        )
    return dict(json.loads(done.stdout))


def apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Return the largest relative difference of what two fits gave."""
    found = [0.0]
    for what in ("values", "std", "cost", "rmse", "peak"):
        a, b = (np.atleast_1d(np.asarray(fit[what], dtype=float)).ravel() for fit in (one, other))
        found.append(float(np.nanmax(np.abs(a - b) / np.maximum(np.abs(b), 1e-300))))
    return max(found)


def compared(folder: Path, limit: int = LIMIT) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Return the fits of one pass and of two workers, and by how much they differ."""
    found = []
    for said, workers, most in (("one pass", None, 0), ("two workers", 2, limit)):
        fit = fitted(folder, workers, most)
        print(
            f"{said:12s} {fit['rows'] / 1e6:.0f} M samples, {fit['seconds']:.0f} s, CPU {fit['cpu']:.0f} s + "
            f"workers {fit['workers_cpu']:.0f} s; peak {fit['own_mb']:.0f} MB, of a worker "
            f"{fit['worker_mb']:.0f} MB",
            flush=True,
        )
        found.append(fit)
    one, two = found
    return one, two, apart(two, one)


def main() -> None:
    """Write the log, fit it twice, and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=200_000_000)
    parser.add_argument("--keep", metavar="FOLDER", help="write the log there, or take the one that is there")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(asked.keep or Path(name) / "dataset")
        if not folder.exists():
            began = perf_counter()
            write(folder, asked.samples)
            print(f"written in {perf_counter() - began:.0f} s", flush=True)
        _, _, difference = compared(folder)
    print(f"largest relative difference of values, uncertainties, cost and errors: {difference:.1e}")
    if not difference <= AGREE:
        raise SystemExit("The fits differ.")


if __name__ == "__main__":
    main()
