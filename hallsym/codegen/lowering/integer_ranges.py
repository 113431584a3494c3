"""Integers of a decoder whose errors intervals say little of: ranges of what is computed, errors by pose.

Where weights multiply readings and what they are compared with, an interval takes the errors of both as
independent, and an error that grows takes bits of every number after it. Here a range is that of the integers
themselves, rounding included, so that nothing overflows whatever the readings. The error of the pose is the
sum of what every operation rounds, times the derivative of the pose by it (`lowering.adjoints`), for many
poses.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.entries import short
from hallsym.codegen.fixed_point import Fixed, Program
from hallsym.codegen.integer_c import planned
from hallsym.codegen.lowering.adjoints import rounding
from hallsym.codegen.lowering.wave_integers import Waves
from hallsym.codegen.operations import Operation, graph

POSES = 1000
"""Poses for which errors are bounded, one by one."""
ROOM = 1.5
"""Times the largest bound of these poses."""


class Ranged(Waves):
    """Keeps ranges of computed integers, and by step what each of its operations rounds by."""

    def __init__(
        self, d: Decoupler, plan: Sequence[int] | None, least: Mapping[str, float], accuracy: float
    ) -> None:
        super().__init__(d, plan, least, accuracy)
        self.rounds: dict[str, list[float]] = {}

    def _operation(self, operation: Operation, args: Sequence[Fixed], step: str) -> Fixed:
        found = super()._operation(operation, args, step)
        self.rounds.setdefault(step, []).append(found.error)
        return _computed(found)

    def _constant(self, name: str, value: float, e: int | None = None) -> Fixed:
        return _computed(super()._constant(name, value, e))


def _computed(v: Fixed) -> Fixed:
    return replace(v, low=v.low - v.error, high=v.high + v.error, error=0.0)


@dataclass(frozen=True)
class Integers:
    """What operations of integers round by, where no flag is set; see `adjoints.Rounds`."""

    rounds: Mapping[str, Sequence[float]]
    """By step, in the order of its operations."""
    table: Mapping[str, tuple[int, int]]

    def operation(self, step: str, k: int, operation: Operation, value: Any) -> Any:
        """Of the compiler."""
        return self.rounds[step][k]

    def entry(self, name: str, value: float) -> float:
        """Half a unit of the last bit at most."""
        q, e = self.table[name]
        return abs(value - q * 2.0**-e)


def program(
    d: Decoupler,
    least: Mapping[str, float],
    accuracy: float,
    drawn: Callable[[np.random.Generator, int], np.ndarray],
    plan: Sequence[int] | None = None,
) -> Program:
    """Return the integer program of steps as `wave_integers.program`, its errors bounded pose by pose.

    `drawn`: random inputs (n_inputs, s) of poses of the box.
    """
    made: list[Ranged] = []

    def compiler(given: Sequence[int] | None) -> Ranged:
        made.append(Ranged(d, given, least, accuracy))
        return made[-1]

    found = planned(compiler, plan)
    values, errors = _by_pose(d, found, made[-1].rounds, drawn)
    for c, value, error in zip(d.pose, values, errors, strict=True):
        _, _, left = found.bounds[c]
        ends = float(value.min()), float(value.max())
        found.bounds[c] = (*ends, left + ROOM * float(error.max()))
    return found


def _by_pose(
    d: Decoupler,
    found: Program,
    rounds: Mapping[str, Sequence[float]],
    drawn: Callable[[np.random.Generator, int], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and errors (n_pose, s) of random poses."""
    entries = {e.name: e.value for e in (*d.table, *d.zeros)}
    inputs = dict(zip(map(short, d.inputs), drawn(np.random.default_rng(6), POSES), strict=True))
    by_number = {}
    for step in d.steps:
        operations, own = graph([step.expression]).operations, iter(rounds.get(step.name, ()))
        by_number[step.name] = [0.0 if o.op == "input" else next(own) for o in operations]
    return rounding(d.steps, inputs, entries, Integers(by_number, found.table), len(d.pose))
