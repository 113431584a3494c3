"""What a diagnosis says of causes that the catalogue does not hold: none of them may be "explained".

    python tests/benchmarks/bench_diagnosis_foreign.py
    python tests/benchmarks/bench_diagnosis_foreign.py --runs 24 --size 8
    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_diagnosis_foreign.py --workers 2
    python tests/benchmarks/bench_diagnosis_foreign.py --quick

Each kind disturbs the readings of a stage and of an encoder, by so many times their noise before the model's
own parameters take their part. The table says the gap over the noise floor, the verdict, and what was named.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
from _noisy_logs import MACHINES, done, log_of, options
from scipy.signal import chirp, lfilter

from hallsym.diagnosis import diagnose


def rate(x: np.ndarray, order: int = 1) -> np.ndarray:
    """Return a derivative of rows of x by the sample."""
    for _ in range(order):
        x = np.gradient(x, axis=1)
    return x


def scaled(x: np.ndarray) -> np.ndarray:
    """Return rows of x between -1 and 1."""
    low, high = x.min(axis=1, keepdims=True), x.max(axis=1, keepdims=True)
    return (2 * x - low - high) / np.maximum(high - low, 1e-300)


def switching(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a signal that switches between two levels, after 30 samples on average."""
    return np.where(np.cumsum(rng.random(n) < 1 / 30) % 2, 1.0, -1.0)


def rings(rng: np.random.Generator, n: int, every: int = 120) -> np.ndarray:
    """Return decaying oscillations that start now and then."""
    knocks = np.where(rng.random(n) < 1 / every, rng.choice([-1.0, 1.0], n), 0.0)
    return np.asarray(lfilter([1.0], [1.0, -2 * 0.97 * np.cos(0.9), 0.97**2], knocks))


def levels(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the error of a converter whose 64 levels are off, each by its own amount."""
    return np.array([rng.standard_normal(65)[((row + 1) * 32).astype(int)] for row in scaled(v)])


def relaxed(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a creep from the start of a run, of either sign."""
    return rng.standard_normal() * np.exp(-np.arange(n) / (n / 6))


# readings v (K, n) and pose x (P, n) of a run, generator of it, generator of the machine
KINDS = {
    "triangle over the reading": lambda v, x, of_run, of_machine: np.abs((3.5 * scaled(v)) % 2 - 1),
    "square wave over the reading": lambda v, x, of_run, of_machine: np.sign(np.sin(9 * scaled(v))),
    "uneven levels": lambda v, x, of_run, of_machine: levels(v, of_machine),
    "dead band": lambda v, x, of_run, of_machine: np.clip(scaled(v), -0.1, 0.1),
    "fine grating over the pose": lambda v, x, of_run, of_machine: np.sin(37 * np.pi * scaled(x)[:1]) + 0 * v,
    "product of readings": lambda v, x, of_run, of_machine: scaled(v) * np.roll(scaled(v), 1, axis=0) ** 3,
    "delay that follows the place": lambda v, x, of_run, of_machine: rate(v) * np.sin(5 * scaled(x)[:1]),
    "squared speed": lambda v, x, of_run, of_machine: rate(v) ** 2 * np.sign(scaled(v)),
    "acceleration times speed": lambda v, x, of_run, of_machine: rate(x)[:1] * rate(x, 2)[:1] + 0 * v,
    "Stribeck friction": lambda v, x, of_run, of_machine: (
        np.sign(rate(x))[:1] * np.exp(-np.abs(scaled(rate(x))[:1]) * 4) + 0 * v
    ),
    "root of the speed": lambda v, x, of_run, of_machine: np.sign(rate(v)) * np.sqrt(np.abs(rate(v))),
    "largest value so far": lambda v, x, of_run, of_machine: np.maximum.accumulate(scaled(v), axis=1),
    "switching offset": lambda v, x, of_run, of_machine: np.array([switching(of_run, v.shape[1]) for _ in v]),
    "random walk": lambda v, x, of_run, of_machine: np.cumsum(of_run.standard_normal(v.shape), axis=1),
    "knocks that ring": lambda v, x, of_run, of_machine: np.array([rings(of_run, v.shape[1]) for _ in v]),
    "ringing of all sensors": lambda v, x, of_run, of_machine: rings(of_run, v.shape[1])[None] + 0 * v,
    "creep of either sign": lambda v, x, of_run, of_machine: np.array(
        [relaxed(of_run, v.shape[1]) for _ in v]
    ),
    "a rising tone": lambda v, x, of_run, of_machine: (
        chirp(np.arange(v.shape[1]), 0.01, v.shape[1], 0.2) + 0 * v
    ),
    "a sawtooth in time": lambda v, x, of_run, of_machine: np.arange(v.shape[1]) % 50 + 0.0 * v,
    "hum that follows the speed": lambda v, x, of_run, of_machine: (
        np.abs(scaled(rate(x)))[:1] * np.sin(0.9 * np.arange(v.shape[1])) + 0 * v
    ),
}


def disturbed(kind: str, size: float, seed: int):
    """Return what adds a kind to the noise-free columns of a log."""

    def make(columns: dict[str, np.ndarray], model, sigma: dict[str, float]) -> dict[str, np.ndarray]:
        edges = np.flatnonzero(np.diff(columns["run"], prepend=-1, append=-1))
        v, x = (np.array([columns[c] for c in names]) for names in (model.channels, model.references))
        found = [
            KINDS[kind](v[:, a:b], x[:, a:b], np.random.default_rng([seed, a]), np.random.default_rng(seed))
            for a, b in pairwise(edges)
        ]
        e = np.hstack(found)
        e = e - e.mean(axis=1, keepdims=True)
        e = e / np.maximum(e.std(axis=1, keepdims=True), 1e-300)
        return columns | {c: v[k] + size * sigma[c] * e[k] for k, c in enumerate(model.channels)}

    return make


def tried(machine: str, kind: str, runs: int, size: float, seed: int) -> dict:
    """Diagnose one log."""
    d = diagnose(log_of(machine, "white", runs, seed, disturbed=disturbed(kind, size, seed)))
    names = ", ".join(f"{e.name} {e.share:.0%}" for e in d.effects)
    gap = d.metric.before / d.metric.floor
    return {"machine": machine, "kind": kind, "gap": gap, "verdict": d.verdict, "named": names}


def main():
    chosen = options(
        __doc__, 2 * len(KINDS),
        lambda p: p.add_argument("--runs", type=int, default=12, help="runs of each log"),
        lambda p: p.add_argument("--size", type=float, default=4.0, help="disturbance over the noise"),
    )  # fmt: skip
    cases = [(m, k) for k in KINDS for m in MACHINES][: chosen.logs]
    settings = [(*case, chosen.runs, chosen.size, chosen.first + n) for n, case in enumerate(cases)]
    verdicts = Counter()
    for row in done(tried, settings, chosen):
        verdicts[row["verdict"]] += 1
        print("{machine:>6} {kind:<30} {gap:6.2f} x  {verdict:<25} {named}".format(**row), flush=True)
    print(f'{len(cases)} logs: "explained" {verdicts["explained"]}, "no gap" {verdicts["no gap"]}')


if __name__ == "__main__":
    main()
