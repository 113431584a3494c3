"""What the engine costs, each piece of work beside a peer in the same process.

    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_engine.py
    python tests/benchmarks/bench_engine.py --only diagnosis

`s`: processor seconds, the least of several turns where a turn is short. `peer`: what it is compared with, in
processor seconds of the same process: for a fit from a file reading that file alone; for a diagnosis and for
a fit of a fleet a direct fit of the same log. `MB`: peak memory of the process once work is done, of a
diagnosis before its peer; it holds the log, numpy, scipy and CasADi too. Each row is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from _noisy_logs import log_of, moving
from bench_fit import MODEL, SIGMA, in_memory, least

from hallsym import diagnose, fit, read_log, write_log
from hallsym.families import effect_named, published
from hallsym.families.halbach.layout import Sensor
from hallsym.families.halbach.planar import halbach_planar, pinwheel
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import NoiseModel, paper_campaign, simulate

LATE_S = 1e-3
HALBACH = Path(__file__).parents[2] / "data" / "halbach"
Row = tuple[float, float, str, float]
"""Processor seconds, those of the peer, what the peer is, and peak memory [MB]."""


def peak() -> float:
    """Peak memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def campaign(samples: int) -> dict[str, np.ndarray]:
    """The paper's campaign with so many samples in each of its 57 runs."""
    values = published.values("table7_estimates")
    return simulate(MODEL, values, paper_campaign(step_s=1.0 / samples), NoiseModel(SIGMA), seed=872)


def long_log(runs: int, samples: int, speed: float, step_s: float) -> Log:
    """Runs that move every axis at once."""
    path = moving(runs, samples * step_s, speed, step_s, np.random.default_rng(0))
    columns = simulate(MODEL, published.values("table7_estimates"), path, NoiseModel(SIGMA), seed=1)
    return in_memory(columns)


def from_file(samples: int, suffix: str, fitted: bool) -> Row:
    """Read a file, and fit what it holds."""
    columns = campaign(samples)
    import pyarrow.csv
    import pyarrow.parquet

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"log.{suffix}")
        write_log(in_memory(columns), path)
        Path(folder, "meta.json").write_text(json.dumps({"noise_1sigma": SIGMA}))

        def bare() -> Any:
            if suffix == "csv":
                return pyarrow.csv.read_csv(path, pyarrow.csv.ReadOptions(use_threads=False))
            return pyarrow.parquet.read_table(path, use_threads=False)

        def ours() -> Any:
            log = read_log(folder if fitted else path)
            return (
                fit(log, MODEL, solver="direct") if fitted else sum(len(b.data["t_s"]) for b in log.blocks())
            )

        ours()
        return least(7, ours)[0], least(7, bare)[0], "reading alone", peak()


def diagnosed(log: Log) -> Row:
    """A diagnosis, the first of its process, beside a direct fit of the same log."""
    (seconds, _), most = least(1, lambda: diagnose(log)), peak()
    return seconds, least(3, lambda: fit(log, solver="direct"))[0], "direct", most


def skewed(runs: int) -> Log:
    """The paper's machine with references that are late, at 1.2 times the noise floor."""
    late = effect_named("time_skew", MODEL)
    made = {"make": lambda model: late.added(model, "time_skew"), "parameters": {"tau_time_skew": LATE_S}}
    return log_of("stage", "white", runs, 5, **made)


def mover() -> Log:
    """A planar mover over 72 single sensors, 1,700 samples of smooth motion in all six coordinates."""
    sums = [one for one in pinwheel() if isinstance(one, Sensor)]
    arrays = [one for one in pinwheel() if not isinstance(one, Sensor)]
    single = [
        Sensor(f"hall_{k}_{j}_v", (place,), one.array)
        for k, one in enumerate(sums)
        for j, place in enumerate(one.positions)
    ]
    model, rng, runs, n = halbach_planar((*single, *arrays)), np.random.default_rng(2), 10, 170
    turns = rng.uniform(0.5, 2.0, (runs, 6, 1)) * np.linspace(0, 2 * np.pi, n) + rng.uniform(
        0, 6, (runs, 6, 1)
    )
    stroke = np.array([0.0125, 0.0125, 2e-3, 0.01, 0.01, 0.01])[:, None]
    poses = np.hstack([*(np.sin(turns) * stroke)]) + np.array([0, 0, 6.5e-3, 0, 0, 0])[:, None]
    sigma = dict.fromkeys(model.channels, 1e-4) | dict.fromkeys(model.references, 1e-7)
    volts = model.readings(model.nominal, poses)
    columns = dict(zip((*model.references, *model.channels), (*poses, *volts), strict=True))
    columns = {c: v + sigma[c] * rng.standard_normal(len(v)) for c, v in columns.items()}
    clock = {"run": np.repeat(np.arange(runs), n), "t_s": 1e-2 * np.arange(runs * n)}
    known, probes = Noise.given(sigma, tuple(columns)), [dict(part.entry) for part in model.layout]
    return Log.from_arrays(clock | columns, known, Meta(base_model=model.name, probes=probes))


def quick_fit(machine: str) -> Row:
    """One fit of a fleet, of a log in memory, beside a direct fit with error tables."""
    log = log_of(machine, "white", 57 if machine == "stage" else 8, 5)
    fit(log, solver="direct", quick=True)
    peer, _ = least(7, lambda: fit(log, solver="direct"))
    return least(7, lambda: fit(log, solver="direct", quick=True))[0], peer, "direct", peak()


def of_machine(make: Callable[..., Log], *how: Any) -> Row:
    """A diagnosis of a log that is made in the process."""
    return diagnosed(make(*how))


def of_file(*how: Any) -> Row:
    """A diagnosis of the runs that `long_log` makes, in a file: another process makes it."""
    with tempfile.TemporaryDirectory() as folder:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            pool.submit(written, folder, how).result()
        return diagnosed(read_log(folder))


def written(folder: str, how: tuple) -> None:
    """Write the runs that `long_log` makes as a log with its noise."""
    write_log(long_log(*how), Path(folder, "log.parquet"))
    meta = {"noise_1sigma": SIGMA, "base_model": MODEL.name}
    Path(folder, "meta.json").write_text(json.dumps(meta))


WORK: dict[str, tuple[str, Callable[..., Row], tuple]] = {
    "57 x 5000 from Parquet": ("3.5", from_file, (5000, "parquet", True)),
    "62 MB of CSV, read": ("450 ms", from_file, (6000, "csv", False)),
    "fleet, one encoder": ("11 ms", quick_fit, ("rotary",)),
    "fleet, one stage": ("17 ms", quick_fit, ("stage",)),
    "diagnosis, no effect": ("1.5 s", of_machine, (log_of, "stage", "white", 57, 5)),
    "diagnosis, one effect": ("3 s", of_machine, (skewed, 57)),
    "diagnosis of an array, 2,400 rows": ("5 s", of_machine, (read_log, HALBACH)),
    "diagnosis of a mover, 72 sensors": ("40 s, 1 GB", of_machine, (mover,)),
    "diagnosis, 2,000 runs of 50": ("8 s, 400 MB", of_file, (2000, 50, 20.0, 4e-3)),
    "diagnosis, long: 57 x 88,000": ("30 s, 400 MB", of_file, (57, 88_000, 2.0, 1e-3)),
}
"""Name of each piece of work: what is wanted of it (a ratio to its peer, or a time), what measures it."""


def measured(name: str) -> Row:
    """Measure one piece of work."""
    _, action, how = WORK[name]
    return action(*how)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows whose name holds this")
    asked = parser.parse_args()
    print("| work | s | peer | s | x | wanted | MB |\n|---|---|---|---|---|---|---|")
    for name in (name for name in WORK if asked.only in name):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            seconds, peer, what, most = pool.submit(measured, name).result()
        ratio = f"{what} | {peer:.3g} | {seconds / peer:.3g}"
        print(f"| {name} | {seconds:.3g} | {ratio} | {WORK[name][0]} | {most:.0f} |", flush=True)
