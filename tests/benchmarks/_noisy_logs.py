"""Simulated logs of a stage and of an encoder whose noise is of a known kind.

The machine is the model that is diagnosed: without a gap there is nothing to find. A gap is one effect that
the model lacks, at a size that leaves so many times the noise floor.
"""

from __future__ import annotations

import contextlib
import json
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise, starmap
from multiprocessing import get_context

import numpy as np
from scipy.signal import lfilter

from hallsym.families import build, published
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import Campaign, Run, paper_campaign, simulate, sine, table8_noise

STAGE_STEP, PAPER_RUNS = 4e-3, 57
ENCODER = {"v_sin_v": 6e-4, "v_cos_v": 6e-4, "angle_ref_rad": 3e-5}
ENCODER_STEP, ENCODER_SAMPLES = 1e-3, 300
RECORDING_S = 3.0
RESONANCE_HZ, DAMPING = 41.0, 0.03
WANDER = 0.2
"""Share of the thermal wander in the power of the noise: half of the white noise beside it, as a standard
deviation. It remembers for as long as a run lasts. An encoder's offset that wanders for longer drifts through
the recording, and a diagnosis says so."""
UNDERSTATED = 1.5
UNSTATED = {"stage": ("z_m", "rx_rad", "ry_rad"), "rotary": ("v_cos_v",)}


def autoregressive(samples: float):
    """Noise with a correlation length of so many samples."""

    def noise(rng: np.random.Generator, n: int, step_s: float) -> np.ndarray:
        a = np.exp(-1 / samples)
        start = [a * rng.standard_normal()]
        return lfilter([np.sqrt(1 - a * a)], [1.0, -a], rng.standard_normal(n), zi=start)[0]

    return noise


def white(rng: np.random.Generator, n: int, step_s: float) -> np.ndarray:
    """Gaussian noise without correlation."""
    return rng.standard_normal(n)


def student(rng: np.random.Generator, n: int, step_s: float) -> np.ndarray:
    """Student's t with 3 degrees of freedom, of unit variance."""
    return rng.standard_t(3, n) / np.sqrt(3)


def pink(rng: np.random.Generator, n: int, step_s: float) -> np.ndarray:
    """Half white noise and half 1/f noise, in power."""
    f = np.fft.rfftfreq(4 * n)
    f[0] = f[1]
    slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(4 * n)) / np.sqrt(f))[:n]
    spread = np.sqrt(np.mean(1 / f[1:]) / (4 * n) * 4 * n)
    return np.sqrt(0.5) * (rng.standard_normal(n) + slow / spread)


def vibration(rng: np.random.Generator, n: int, step_s: float) -> np.ndarray:
    """White noise, and as much of a resonance that noise excites."""
    w = 2 * np.pi * RESONANCE_HZ * step_s
    r = np.exp(-DAMPING * w)
    ring = lfilter([1.0], [1.0, -2 * r * np.cos(w), r * r], rng.standard_normal(n + 400))[400:]
    a, b = 2 * r * np.cos(w), -r * r
    variance = (1 - b) / ((1 + b) * ((1 - b) ** 2 - a * a))
    return np.sqrt(0.5) * (rng.standard_normal(n) + ring / np.sqrt(variance))


KINDS = {
    "white": white,
    "ar3": autoregressive(3),
    "ar10": autoregressive(10),
    "pink": pink,
    "t3": student,
    "vibration": vibration,
}
WRONGLY_STATED = ("understated", "unstated")
"""Kinds of white noise that is 1.5 times the stated one, or that is not stated in some columns."""
EVERY = (*KINDS, "wander", *WRONGLY_STATED)
"""All kinds; wander: a slow one that all channels have in common, beside white noise of each."""


def moving(runs: int, seconds: float, speed: float, step_s: float, rng: np.random.Generator) -> Campaign:
    """Runs of a stage that move every axis at once, some of them `speed` times in each second."""
    size = {"x_m": 300e-6, "y_m": 500e-6, "rz_rad": 300e-6, "z_m": 1e-4, "rx_rad": 2e-4, "ry_rad": 2e-4}
    made = []
    for _ in range(runs):
        motion = {
            axis: sine(a * rng.uniform(0.5, 1), speed * f * rng.uniform(0.8, 1.2), rng.uniform(0, 6.28))
            for (axis, a), f in zip(size.items(), (1.0, 1.55, 1.25, 0.35, 0.45, 0.3), strict=True)
        }
        made.append(Run(seconds, {}, motion))
    return Campaign(step_s, tuple(made))


def stage(runs: int, rng: np.random.Generator) -> tuple[str, dict[str, float], Campaign, dict[str, float]]:
    """The paper's machine: all of its runs, or fewer that move every axis at once."""
    values = published.values("table7_estimates")
    noise = dict(table8_noise(build("stage31"), values).sigma)
    if runs == PAPER_RUNS:
        return "stage31", values, replace(paper_campaign(STAGE_STEP), step_s=STAGE_STEP), noise
    return "stage31", values, moving(runs, 2.0, 2.0, STAGE_STEP, rng), noise


def encoder(runs: int, rng: np.random.Generator) -> tuple[str, dict[str, float], Campaign, dict[str, float]]:
    """An encoder whose ellipse is known, turned at several speeds in both directions.

    A single run is a recording that rests, turns forward, rests, turns back and rests.
    """
    if runs == 1:
        turn, times = 6.28 * rng.uniform(1, 5), RECORDING_S * np.array([0, 0.2, 0.5, 0.6, 0.9, 1])
        motion = {"angle_rad": lambda t: turn * np.interp(t, times, [0, 0, 1, 1, 0, 0])}
        return "ellipse", {}, Campaign(ENCODER_STEP, (Run(RECORDING_S, {}, motion),)), ENCODER
    speeds = (15.0, -15.0, 40.0, -40.0, 90.0, -90.0, 150.0, -150.0)
    made = []
    for k in range(runs):
        speed, start = speeds[k % len(speeds)] * rng.uniform(0.9, 1.1), rng.uniform(0, 6.28)
        motion = {"angle_rad": lambda t, w=speed, a=start: a + w * t}
        made.append(Run(ENCODER_STEP * ENCODER_SAMPLES, {}, motion))
    return "ellipse", {}, Campaign(ENCODER_STEP, tuple(made)), ENCODER


MACHINES = {"stage": stage, "rotary": encoder}


def log_of(
    machine: str, kind: str, runs: int, seed: int, *, stated: bool = True, make=None, parameters=None,
    fresh: bool = False, again: int = 0, disturbed=None,
) -> Log:  # fmt: skip
    """Return one log. `make(model) -> model` adds the gap, `parameters` its size.

    `disturbed(columns, model, sigma) -> columns`: a gap that is no model. `fresh`: the same machine on as
    many runs that were never seen, with other noise. `again`: the same motion recorded another time; each
    number draws other noise.
    """
    model, values, campaign, sigma = MACHINES[machine](runs, np.random.default_rng([seed, int(fresh)]))
    truth = build(model) if make is None else make(build(model))
    rng = np.random.default_rng([seed, int(fresh), 1 + again])
    known = values | dict(parameters or {})
    columns = simulate(truth, {n: v for n, v in known.items() if n in truth.names}, campaign, seed=seed + 7)
    if disturbed is not None:
        columns = disturbed(columns, truth, sigma)
    edges = np.flatnonzero(np.diff(columns["run"], prepend=-1, append=-1))
    rows, draw = len(columns["run"]), KINDS.get(kind, white)
    memory = rows / (len(edges) - 1)
    slow = autoregressive(memory)(rng, rows, campaign.step_s) if kind == "wander" else None
    for name, s in sigma.items():
        if s:
            e = np.concatenate([draw(rng, b - a, campaign.step_s) for a, b in pairwise(edges)])
            if slow is not None and name in truth.channels:
                e = np.sqrt(1 - WANDER) * e + np.sqrt(WANDER) * slow
            columns[name] = columns[name] + s * e
    noise = Noise.given(said(machine, kind, sigma), tuple(columns)) if stated else Noise()
    return Log.from_arrays(columns, noise, Meta(base_model=model), f"{machine} {kind} {runs} {seed}")


def said(machine: str, kind: str, sigma: dict[str, float]) -> dict[str, float]:
    """Return the noise that is stated where it is `sigma`."""
    if kind == "understated":
        return {c: s / UNDERSTATED for c, s in sigma.items()}
    left_out = UNSTATED[machine] if kind == "unstated" else ()
    return {c: s for c, s in sigma.items() if c not in left_out}


def options(text: str, logs: int, *more: Callable[[ArgumentParser], object]) -> Namespace:
    """Return the options that all benchmarks of a diagnosis have; `more` adds those of one."""
    parser = ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("--logs", type=int, default=logs, help="logs that are diagnosed")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--out", help="file for the rows as JSON lines")
    parser.add_argument("--quick", action="store_true", help="two logs, to see that everything runs")
    for add in more:
        add(parser)
    chosen = parser.parse_args()
    return Namespace(**vars(chosen) | ({"logs": 2} if chosen.quick else {}))


def done(call: Callable[..., dict], settings: Sequence[tuple], chosen: Namespace) -> Iterator[dict]:
    """Yield `call(*setting)` of each setting, in their order, and write it to the file that is asked for."""
    with contextlib.ExitStack() as stack:
        rows: Iterator[dict] = starmap(call, settings)
        if chosen.workers > 1:
            pool = ProcessPoolExecutor(chosen.workers, mp_context=get_context("spawn"))
            rows = stack.enter_context(pool).map(call, *zip(*settings, strict=True))
        for row in rows:
            if chosen.out:
                with open(chosen.out, "a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            yield row
