"""Throughput of a fleet: what a quick fit leaves out, what a second worker brings, what a cluster costs.

    python tests/benchmarks/bench_fleet.py
    python tests/benchmarks/bench_fleet.py --devices 400 --cluster
    python tests/benchmarks/bench_fleet.py --devices 20

Logs of 20 runs x 500 samples in Parquet, of encoders and of stages; direct fits. Ratios carry over between
machines and times do not, so the table is of ratios: of processor time, and of wall-clock time between one
worker and two, the start of the processes left out. `unit` is the processor time that numpy takes for the
run statistics' main operation on one log (QR of 10 000 x 22), by which the speed of the machine is told.

`--cluster` also starts a Dask scheduler and two workers and prints where their processor time goes: what
they take by time alone, for a task that does nothing, and for a log. Rows of both must be the same.
"""

from __future__ import annotations

import argparse
import os
import resource
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from bench_fleet_many import ENCODERS, RUNS, SAMPLES, STAGES, Columns

from hallsym.estimation import fit
from hallsym.families import build
from hallsym.fleets import completed, devices_of
from hallsym.fleets.row import Job, Settings, row_of
from hallsym.log import Noise, read_log, write_log
from hallsym.simulation import table8_noise

IDLE = 10.0
"""Time [s] for which a cluster is watched while it waits."""
Rows = dict[str, dict[str, Any]]


def encoder(seed: int) -> tuple[Columns, dict[str, float]]:
    """Return the log of one encoder, and the noise of its columns."""
    model = build("rotary")
    assert model.family.example is not None
    noise = dict(Noise.given(model.family.example.noise, (*model.channels, *model.references)).std)
    return ENCODERS.record(ENCODERS.truth(seed), seed), noise


def stage(seed: int) -> tuple[Columns, dict[str, float]]:
    """Return the log of one stage, and the noise of its columns."""
    truth = STAGES.truth(seed)
    return STAGES.record(truth, seed), dict(table8_noise(build(STAGES.model), truth).sigma)


def least(call: Callable[[], object], turns: int = 5) -> float:
    """Return the least processor time [s] of several turns."""
    times = []
    for _ in range(turns):
        began = process_time()
        call()
        times.append(process_time() - began)
    return min(times)


def unit() -> float:
    """Return the processor time [s] of the QR of one log's features."""
    rows = np.random.default_rng(0).standard_normal((RUNS, SAMPLES, 22))
    return least(lambda: np.linalg.qr(rows, mode="r"), 20)


def one_core(kind: str, model: str, folder: Path, noise: dict[str, float]) -> None:
    """Print the processor time of a fit, in full and quick, with noise that is stated and estimated."""
    paths, one = sorted(folder.glob(f"{kind}*.parquet"))[:12], unit()
    print(f"{model:10s} {'':18s} {'ms':>7s} {'fits/s':>8s} {'units':>7s}")
    for said, given in (("noise stated", noise), ("noise estimated", None)):
        for how, quick in (("in full", False), ("quick", True)):

            def every(given: dict[str, float] | None = given, quick: bool = quick) -> None:
                for path in paths:
                    fit(read_log(path, noise=given), model, solver="direct", quick=quick)

            every()
            time = least(every, 3) / len(paths)
            print(f"{'':10s} {said + ', ' + how:25s} {1e3 * time:7.1f} {1 / time:8.0f} {time / one:7.1f}")


def pool(jobs: list[Job], workers: int) -> tuple[float, float, Rows]:
    """Return wall-clock time [s] of all rows after the first, processor time [s], and the rows."""
    first, spent, rows = 0.0, _spent(), {}
    for done in completed(row_of, jobs, workers=workers):
        first = first or perf_counter()
        rows[done.work.device.name] = _row(done.result)
    return perf_counter() - first, _spent() - spent, rows


def _spent() -> float:
    """Return the processor time [s] of this process and of those that it has ended."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(used.ru_utime + used.ru_stime for used in both)


def _row(result: Any) -> dict[str, Any]:
    """Return a row without the time that it took."""
    return {name: value for name, value in result.items() if name != "seconds"}


def cluster(jobs: list[Job], local: float, rows: Rows) -> bool:
    """Print the processor time of a Dask cluster beside `local` [s] a log; return whether it gives `rows`."""
    import psutil
    from distributed import Client

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address, common = f"tcp://127.0.0.1:{port}", ["--host", "127.0.0.1", "--no-dashboard"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    calls = [[sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", str(port)], worker, worker]
    running = [subprocess.Popen([*call, *common], stderr=subprocess.DEVNULL) for call in calls]
    try:
        with Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
        known = [*(psutil.Process(process.pid) for process in running), psutil.Process()]

        def spent() -> np.ndarray:
            return np.array([sum(process.cpu_times()[:2]) for process in known])

        def told(what: str, before: np.ndarray, over: float, unit: str) -> None:
            scheduler, one, two, client = (spent() - before) / over
            shares = f"workers {one + two:6.2f}, scheduler {scheduler:5.2f}, client {client:5.2f}"
            print(f"{what:26s} {shares} {unit}", flush=True)

        list(completed(row_of, jobs[:20], scheduler=address))  # imports, and expressions made once
        before = spent()
        sleep(IDLE)
        told("Dask, waiting", before, IDLE / 100, "% of a core")
        before, count = spent(), 5 * len(jobs)
        list(completed(repr, jobs * 5, scheduler=address))
        told("a task that does nothing", before, count / 1e3, "ms")
        before = spent()
        found = {d.work.device.name: _row(d.result) for d in completed(row_of, jobs, scheduler=address)}
        told("a log", before, len(jobs) / 1e3, f"ms; with two local processes {1e3 * local:.2f} ms")
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()
    return found == rows


def main() -> None:
    """Write the logs, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--devices", type=int, default=200)
    parser.add_argument("--cluster", action="store_true", help="a Dask scheduler of two processes too")
    asked = parser.parse_args()
    same = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, make in (("encoder", encoder), ("stage", stage)):
            for k in range(12 if kind == "stage" else asked.devices):
                columns, noise = make(k)
                write_log(columns, folder / f"{kind}{k:04d}.parquet")
            one_core(kind, "rotary" if kind == "encoder" else "stage31", folder, noise)
        jobs = [Job(d, Settings("rotary")) for d in devices_of(str(folder / "encoder*.parquet"))]
        one, _, rows = pool(jobs, 1)
        two, once, again = pool(jobs, 2)
        print(
            f"{asked.devices} encoders: {len(jobs) / one:.0f} /s with one worker, two are {one / two:.2f} x",
            flush=True,
        )
        same = rows == again
        if asked.cluster:
            thrice = pool(jobs * 3, 2)[1]  # what processes take before their first row is in both
            same = same and cluster(jobs, (thrice - once) / (2 * len(jobs)), rows)
    if not same:
        raise SystemExit("Rows depend on who made them.")


if __name__ == "__main__":
    main()
