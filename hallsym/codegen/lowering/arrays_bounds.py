"""Rounding error bound of six coordinates from several arrays: by parts, then by intervals.

Vectors, arctangents and logarithms are bounded as for one wave; what follows is straight, so intervals bound
it, each step within what poses of the box can make of it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Step, Whole, short
from hallsym.codegen.intervals import Enclosure, constant, enclose, half_ulp
from hallsym.codegen.lowering.arrays_fit import Arrays
from hallsym.codegen.lowering.wave_bounds import SHORT, Values, height_error, place_error, vector_error
from hallsym.codegen.lowering.wave_steps import Wave
from hallsym.codegen.operations import TESTS, graph
from hallsym.model.arrays import on_arrays

ROOM = 1.5
"""Times what trial poses make of a step: the range in which intervals take it."""
POSES = 2000
OF_ARCTANGENT = ("across", "up", "turned", "turned_square", "quadrant", "beyond", "half")
"""Steps of an arctangent, whose bound is of the whole."""
CROSS = ("cross_real", "cross_imaginary", "cross", "cross_square", "held_cross", "bound")
"""Steps of the turn of one phasor from another."""
ROUNDINGS = 64
"""Roundings of that turn, each a share of it: two products, their sums, quotient and polynomial."""
POWERS = ((2, 0), (4, 4), (6, 4), (4, 0))
"""Of each kind of term: how often the phasor is a factor, and the power of its length."""
CHOSEN = ("held_", "next_", "along_")
"""Steps that choose between values, and do not jump."""


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of each coordinate, flags clear, zeros at zero."""

    found: Arrays
    waves: Sequence[Wave]
    names: Sequence[str]
    steps: tuple[Step, ...]
    values: Values
    nears: tuple[str, ...]
    drawn: Callable[[np.random.Generator, int], np.ndarray]
    """Random inputs (n_inputs, s) of poses in the box."""

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each coordinate."""
        dtype = np.float32 if digits == 24 else np.float64
        known: dict[str, Enclosure] = {}
        for name, value in self.values.items():
            if isinstance(value, tuple):
                known[name] = Enclosure(float(dtype(value[0])), float(dtype(value[1])))
            else:
                known[name] = constant(value, digits)
        pose = self.found.model.pose
        known |= {f"zero_{c.rpartition('_')[0]}": Enclosure(0.0, 0.0) for c in pose}
        ranges = self._ranges()
        known |= self._functions(digits)
        known |= self._ratios(digits, ranges)
        for step in self.steps:
            if step.name in known:
                continue
            if isinstance(step, Whole):
                low, high = ranges[step.name]
                known[step.name] = Enclosure(low, high)
                continue
            if step.name.startswith(CHOSEN) and _branches(step):
                known[step.name] = _chosen(step, known, ranges[step.name], digits)
                continue
            needs = {s.name(): known[s.name()] for s in ca.symvar(step.expression)}
            (made,) = enclose([step.expression], needs, digits)
            low, high = ranges[step.name]
            known[step.name] = Enclosure(max(float(made.low), low), min(float(made.high), high), made.error)
        last = [known[step.name] for step in self.steps[-6:]]
        low, high = np.array([ranges[step.name] for step in self.steps[-6:]]).T
        return {c: Enclosure(low[k], high[k], float(last[k].error)) for k, c in enumerate(pose)}

    def _functions(self, digits: int) -> dict[str, Enclosure]:
        """Arctangents, logarithms and what leads to them, each with the rounding of its vector."""
        made: dict[str, Enclosure] = {}
        for wave, group, name in zip(self.waves, self.found.groups, self.names, strict=True):
            own = _of_vector(self.steps, name)
            vector = vector_error(wave, own, self.values, digits)
            lc = group.phasor.lc
            for (
                step
            ) in own:  # terms of tilt take powers of the first round: as far off as the vector, at most
                made[step.name] = Enclosure(-wave.outer, wave.outer, vector)
            made |= {f"{step}_{name}": Enclosure(0.0, 0.0) for step in OF_ARCTANGENT}
            made[f"log_{name}"] = Enclosure(
                *_sides(-np.log(wave.least)), height_error(wave, vector, digits) / lc
            )
            made[f"phase_{name}"] = Enclosure(*_sides(np.pi), place_error(wave, vector, digits) / lc)
        return made

    def _ratios(self, digits: int, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Enclosure]:
        """Quotients of parts of phasors: as a phasor turns and stretches by a share of itself, so do its
        powers."""
        moved: dict[str, float] = {}
        u = 2.0**-digits
        made: dict[str, Enclosure] = {}
        for wave, name in zip(self.waves, self.names, strict=True):
            vector = vector_error(wave, _of_vector(self.steps, name), self.values, digits)
            moved[name] = vector / (wave.least * SHORT - vector)
            for kind, (power, size) in enumerate(POWERS):
                off = wave.outer**size * (1.1 * power * moved[name] + 4 * power * u)
                ends = wave.outer**size
                made |= {f"kind{kind}_{name}_{part}": Enclosure(-ends, ends, off) for part in ("re", "im")}
            made |= {s.name: Enclosure(0.0, 0.0) for s in self.steps if s.name.endswith(f"_of_{name}")}
            made[f"held_size_{name}"] = Enclosure(0.0, 0.0)
        for members in self.found.axes.values():
            for k in members[1:]:
                name, first = self.names[k], self.names[members[0]]
                low, high = ranges[f"turn_{name}"]
                most = max(abs(low), abs(high))
                off = 1.1 * (moved[first] + moved[name]) + ROUNDINGS * u * max(most, 1e-3)
                made[f"turn_{name}"] = Enclosure(low, high, off)
                made |= {f"{n}_{name}": Enclosure(0.0, 0.0) for n in CROSS}
        return made

    def _ranges(self) -> dict[str, tuple[float, float]]:
        inputs = self.drawn(np.random.default_rng(6), POSES)
        columns = (*self.found.model.channels, *self.nears)
        return ranges_of(self.steps, columns, inputs, self.values, self.found.model.pose)


def ranges_of(
    steps: Sequence[Step],
    columns: Sequence[str],
    inputs: np.ndarray,
    values: Values,
    pose: Sequence[str],
) -> dict[str, tuple[float, float]]:
    """Return what trial inputs (n_inputs, s) make of each step, and some room; zeros are 0."""
    count = inputs.shape[1]
    value: dict[str, Any] = {short(c): row for c, row in zip(columns, inputs, strict=True)}
    value |= {name: v for name, v in values.items() if not isinstance(v, tuple)}
    value |= {f"zero_{short(c)}": 0.0 for c in pose}
    out = {}
    for step in steps:
        symbols = ca.symvar(step.expression)
        given = [np.broadcast_to(value[s.name()], count) for s in symbols]
        run = on_arrays(ca.Function("step", [ca.vertcat(*symbols)], [step.expression]))
        made = np.asarray(run(given)[0])[0]
        value[step.name] = np.floor(made) if isinstance(step, Whole) else made
        low, high = float(value[step.name].min()), float(value[step.name].max())
        room = (ROOM - 1) * max(high - low, 1e-3 * max(abs(low), abs(high)))
        out[step.name] = low - room, high + room
    return out


def _branches(step: Step) -> bool:
    return any(operation.op in TESTS for operation in graph([step.expression]).operations)


def _chosen(step: Step, known: Mapping[str, Enclosure], ends: tuple[float, float], digits: int) -> Enclosure:
    """A choice between values that are equal where it turns, or that poses of the box do not turn.

    No further off than either, and the least is one of the table where one is chosen for it.
    """
    taken = [known[s.name()] for s in ca.symvar(step.expression)]
    error = max(float(e.error) for e in taken)
    numbers = [float(e.low) for e in taken if e.low == e.high]
    if not step.name.startswith("held_"):  # a whole wavelength on or back rounds once more
        return Enclosure(*ends, error + constant(max(numbers), digits).error + half_ulp(max(numbers), digits))
    return Enclosure(max(ends[0], min(numbers)), ends[1], error)


def _of_vector(steps: Sequence[Step], name: str) -> tuple[Step, ...]:
    """The steps from the readings to the vector of an array: those before its logarithm."""
    own = []
    for step in steps:
        if step.name == f"size_{name}" or step.name == f"size_seen_{name}":
            break
        if step.name.endswith(f"_{name}"):
            own.append(step)
    return tuple(own)


def _sides(most: float) -> tuple[float, float]:
    return -float(most), float(most)
