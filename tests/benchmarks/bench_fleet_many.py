"""A production: 2,000 encoders and 500 stages, five of each broken in different ways; killed once, resumed.

    python tests/benchmarks/bench_fleet_many.py
    python tests/benchmarks/bench_fleet_many.py --encoders 200 --stages 60

Each log has 20 runs x 500 samples. Every device must have its row, each broken one a reason, and no other may
be called failed; the spread of each parameter must be that of the devices within 5 % (and, of a fleet this
size, within three standard errors of what they were drawn from); the command is killed when two fifths are
done, and what was done then is not done again.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, sleep

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hallsym.families import build, published
from hallsym.fleets import Fleet, load_fleet
from hallsym.fleets.journal import journal_of
from hallsym.log import write_log
from hallsym.simulation import paper_campaign, simulate, table8_noise

sys.path.append(str(Path(__file__).resolve().parents[1] / "fleets"))

from fleet_work import recorded

RUNS, SAMPLES = 20, 500
WITHIN = 0.05
"""What a spread may differ by from that of the devices."""
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Kind:
    """What is produced: truth and log of device k, standard deviations of what differs, and what breaks."""

    model: str
    spread: Mapping[str, float]
    record: Callable[[Mapping[str, float], int], Columns]
    broken: tuple[Callable[[Columns, Path], str], ...]
    """Each writes the log of a broken device and returns a word of the reason."""

    def truth(self, k: int) -> dict[str, float]:
        """Return the parameters of device k."""
        model, rng = build(self.model), np.random.default_rng(k)
        example = model.family.example
        known = published.values("table7_estimates") if example is None else example.values
        found = {n: v for n, v in known.items() if n in model.names}
        return found | {n: found[n] + s * rng.standard_normal() for n, s in self.spread.items()}


def encoder(truth: Mapping[str, float], seed: int) -> Columns:
    """Return the log of an encoder that turns to and fro."""
    return recorded(dict(truth), seed, runs=RUNS, samples=SAMPLES)


def stage(truth: Mapping[str, float], seed: int) -> Columns:
    """Return the log of a stage: 20 of the paper's runs, of all its trajectories and settings."""
    model, whole = build("stage31"), paper_campaign(1.0 / SAMPLES, 1.0)
    some = (17 * np.arange(RUNS)) % len(whole.runs)
    campaign = replace(whole, runs=tuple(whole.runs[k] for k in some))
    return simulate(model, truth, campaign, table8_noise(model, dict(truth)), seed=seed)


def cut_short(columns: Columns, path: Path) -> str:
    """Write the beginning of the file."""
    write_log(columns, path)
    path.write_bytes(path.read_bytes()[:9000])
    return "Parquet"


def without(column: str) -> Callable[[Columns, Path], str]:
    """Return what leaves a column out."""

    def write(columns: Columns, path: Path) -> str:
        write_log({n: v for n, v in columns.items() if n != column}, path)
        return column

    return write


def changed(
    column: str, word: str, change: Callable[[Columns], np.ndarray]
) -> Callable[[Columns, Path], str]:
    """Return what writes another column in place of one."""

    def write(columns: Columns, path: Path) -> str:
        write_log({**columns, column: change(columns)}, path)
        return word

    return write


ENCODERS = Kind(
    "rotary",
    {"Vx": 2e-3, "Vy": 2e-3, "Ax": 5e-3, "Ay": 5e-3, "beta": 2e-3},
    encoder,
    (
        cut_short,
        without("v_cos_v"),
        changed("v_sin_v", "v_sin_v", lambda c: np.full_like(c["v_sin_v"], 0.5)),
        changed("v_sin_v", "noise", lambda c: c["v_sin_v"] + 0.05 * np.sin(3 * c["angle_ref_rad"])),
        changed("v_cos_v", "Ax", lambda c: 1.2 * c["v_cos_v"]),
    ),
)
STAGES = Kind(
    "stage31",
    {"eta_A": 4e-3, "eta_B": 4e-3, "eta_C": 4e-3, "theta_A": 0.01, "theta_B": 0.01, "theta_C": 0.01,
     "a_A": 30.0, "a_B": 25.0, "a_C": 6.0},
    stage,
    (
        cut_short,
        without("rz_ref_rad"),
        changed("hall_a_m", "hall_a_m", lambda c: np.zeros_like(c["hall_a_m"])),
        changed("x_ref_m", "x_ref_m", lambda c: 1e3 * c["x_ref_m"]),
        changed("hall_c_m", "noise", lambda c: c["hall_c_m"] + 400.0 * c["x_ref_m"] ** 2),
    ),
)  # fmt: skip


def write(kind: Kind, folder: Path, devices: int) -> tuple[list[dict[str, float]], dict[str, str]]:
    """Write the logs; return what the devices are, and of broken ones a word of the reason by name."""
    folder.mkdir()
    known, reasons = [kind.truth(k) for k in range(devices)], {}
    places = {devices // 7 + j * (devices // 6): j for j in range(len(kind.broken))}
    for k, truth in enumerate(known):
        columns, path = kind.record(truth, k), folder / f"dev{k}.parquet"
        if k in places:
            reasons[f"dev{k}"] = kind.broken[places[k]](columns, path)
        else:
            write_log(columns, path)
    return known, reasons


def killed_and_resumed(kind: Kind, folder: Path, table: Path, devices: int) -> tuple[int, float]:
    """Run the command, kill it, run it again; return the devices that were done, and the time of the rest."""
    words = [sys.executable, "-m", "hallsym", "fleet", str(folder), "--model", kind.model, "-o", str(table),
             "--workers", "2", "--json"]  # fmt: skip
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, start_new_session=True)
    journal = journal_of(table)
    while not (journal.exists() and journal.read_bytes().count(b"\n") > 0.4 * devices):
        if process.poll() is not None:
            raise SystemExit("The fleet ended before it was killed.")
        sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    done = {}
    for line in journal.read_text().splitlines()[1:]:
        try:
            entry = json.loads(line)
        except ValueError:
            continue  # cut short
        done[entry["stamp"]] = entry["row"]["seconds"]
    began = perf_counter()
    subprocess.run(words, stdout=subprocess.DEVNULL, check=False)
    seconds = perf_counter() - began
    kept = {row["seconds"] for row in load_fleet(table).rows}
    if not set(done.values()) <= kept:
        raise SystemExit("What was done before the kill was done again.")
    return len(done), seconds


def judged(kind: Kind, found: Fleet, known: list[dict[str, float]], reasons: Mapping[str, str]) -> list[str]:
    """Return what is wrong, after printing what was found."""
    wrong = []
    if found.devices != tuple(f"dev{k}" for k in range(len(known))):
        wrong.append("not every device has its row")
    for device, word in reasons.items():
        said = found.outlying.get(device, "")
        print(f"  {device}: {said[:150]}")
        if word not in said:
            wrong.append(f"{device} is not named for {word}")
    others = {d: said for d, said in found.outlying.items() if d not in reasons}
    print(f"  {len(others)} others are named: {'; '.join(f'{d} {s[:60]}' for d, s in others.items())}")
    good = [k for k, row in enumerate(found.rows) if row["verdict"] == "good" and f"dev{k}" not in reasons]
    if len(good) < 0.98 * (len(known) - len(reasons)):
        wrong.append(f"only {len(good)} devices are good")
    for spread in found.spreads:
        if spread.name not in kind.spread:
            continue
        drawn, true = kind.spread[spread.name], float(np.std([known[k][spread.name] for k in good], ddof=1))
        error, chance = spread.std / true - 1.0, spread.std / drawn - 1.0
        sigma = (1 + (spread.typical_std / drawn) ** 2) / np.sqrt(2 * len(good))
        print(
            f"  {spread.name:8s} spread {spread.std:.4g} +- {100 * sigma:.1f} %, of the devices {true:.4g} "
            f"({100 * error:+.1f} %), drawn from {drawn:.4g} ({100 * chance:+.1f} %), of a fit "
            f"{spread.typical_std:.2g}"
        )
        if abs(error) > WITHIN or abs(chance) > max(WITHIN, 3 * sigma):
            wrong.append(f"the spread of {spread.name} is off by {100 * error:.1f} %")
    if missing := set(kind.spread) - {s.name for s in found.spreads}:
        wrong.append(f"{', '.join(sorted(missing))} have no spread")
    return wrong


def main() -> None:
    """Write both productions, run their fleets, and judge them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--encoders", type=int, default=2000)
    parser.add_argument("--stages", type=int, default=500)
    asked, wrong = parser.parse_args(), []
    with tempfile.TemporaryDirectory() as name:
        for kind, devices in ((ENCODERS, asked.encoders), (STAGES, asked.stages)):
            folder, table = Path(name) / kind.model, Path(name) / f"{kind.model}.parquet"
            began = perf_counter()
            known, reasons = write(kind, folder, devices)
            print(f"{kind.model}: {devices} logs written in {perf_counter() - began:.0f} s", flush=True)
            done, seconds = killed_and_resumed(kind, folder, table, devices)
            print(
                f"  killed with {done} done; the other {devices - done} took {seconds:.0f} s, "
                f"{(devices - done) / seconds:.0f} /s with two workers"
            )
            wrong += judged(kind, load_fleet(table), known, reasons)
    if wrong:
        raise SystemExit("\n".join(wrong))


if __name__ == "__main__":
    main()
