"""CPU of a diagnosis of the bare decoded angle, over that of a fit of the same model to the same log.

    python tests/benchmarks/bench_rotary_diagnosis.py --knots 200
    python tests/benchmarks/bench_rotary_diagnosis.py --quick

A turn of an encoder with three causes that its model leaves out, 0.02 deg of noise, as a table of knots: what
the owner of a motor has. Operations are those of one reading, before and with the effects that were found:
multiplied out into harmonics they grow with every product, evaluated at the sample's angle they add up.
"""

from __future__ import annotations

import argparse
from statistics import median
from time import process_time

import numpy as np

import hallsym
from hallsym.diagnosis import examine, prepare
from hallsym.families import build
from hallsym.log import Log, Noise

NOISE = np.radians(0.02)
RUNS = 5


def knots(count: int, seed: int) -> Log:
    """A turn of an encoder: four waves of the magnet, bent voltages, a pattern of the stepper behind it."""
    rng = np.random.default_rng(seed)
    u = 2 * np.pi * np.arange(count) / count
    reference = u + 2.5e-4 * np.cos(50 * u)
    x = 0.01 + np.cos(u) - 0.002 * np.cos(3 * u)
    y = -0.02 + 1.01 * np.sin(u) + 0.002 * np.sin(3 * u)
    x, y = x + 0.01 * x**2 - 0.01 * x**4, y + 0.004 * y**2 - 0.009 * y**4
    angle = np.unwrap(np.arctan2(y, x)) + NOISE * rng.standard_normal(count)
    return Log.from_arrays({"angle_ref_rad": reference, "angle_rad": angle}, noise=Noise())


def seconds(run) -> float:
    """Median CPU time of a few runs, the first one, which may compile something, left out."""
    taken = []
    for _ in range(RUNS + 1):
        began = process_time()
        run()
        taken.append(process_time() - began)
    return median(taken[1:])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--knots", type=int, default=200)
    parser.add_argument("--quick", action="store_true", help="once each, to see that everything runs")
    arguments = parser.parse_args()
    global RUNS
    RUNS = 1 if arguments.quick else RUNS
    log = knots(arguments.knots, 2014)
    found = []
    fit = seconds(lambda: hallsym.fit(log, build("rotary", meta=log.meta)))
    diagnosis = seconds(lambda: found.append(examine(prepare(log, build("rotary", meta=log.meta)))))
    before, after = found[-1].before.model, (found[-1].after or found[-1].before).model
    named = ", ".join(e.name for e in found[-1].diagnosis.effects) or "no effect"
    print(f"{named}: diagnosis / fit {diagnosis / fit:.1f}, operations of a reading "
          f"{before.reading.n_instructions()} -> {after.reading.n_instructions()}")  # fmt: skip


if __name__ == "__main__":
    main()
