"""What a decoupler is made of, whatever the family: steps over inputs and table, margins, the whole.

A family's own file makes a `Decoupler` (`hallsym.codegen.lowering`); source, table, self-test, bounds, proofs
and reports are made from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box
from hallsym.codegen.entries import Entry, unit
from hallsym.codegen.intervals import Enclosure
from hallsym.log.phase import wrapped
from hallsym.model import Model

ENOUGH = 2e-11
"""Change of the pose [m, rad] below which an iteration of a non-linear model ends."""

TRIED = 100_000
FLAG_BITS = 31
"""Bits of the status of a step: of inputs from below, of flags from above; the last one is of a refused
zero."""


@dataclass(frozen=True, eq=False)
class Step:
    """`name` = `expression` of the symbols of inputs, table entries and earlier steps."""

    name: str
    expression: ca.SX
    remark: str = ""
    within: tuple[float, int] | None = field(default=None, kw_only=True)
    """Of a part of a power of a phasor: factor and power of its length that are not exceeded."""


@dataclass(frozen=True, eq=False)
class Whole(Step):
    """`name` = the whole part of `expression`, a symbol, as 32 bits: 0 <= expression < 2^32."""


@dataclass(frozen=True, eq=False)
class Bits(Step):
    """`name` = bits of `expression`, the symbol of a `Whole`: those from `first` on, or those below it."""

    first: int = 0
    below: bool = False


@dataclass(frozen=True, eq=False)
class Array:
    """A row of numbers in the table, a power of two of them; `integers`: of 16 bits."""

    name: str
    values: tuple[float, ...]
    unit: str
    meaning: str
    integers: bool = False


NONE = Array("none", (0.0,), "1", "nothing")


@dataclass(frozen=True, eq=False)
class Lookup(Step):
    """`name` = entry `expression` + `ahead` of `array`, counted round; `expression`: the symbol of `Bits`."""

    array: Array = NONE
    ahead: int = 0


@dataclass(frozen=True)
class Margin:
    """What must not come near zero in the box: entry `rest` plus, for each of `terms`, entry * columns.

    `column`: the input it belongs to. `decoupler_check()` refuses a table whose terms, at their largest
    within the limits, leave less than a tenth of `rest`.
    """

    column: str
    rest: str
    terms: tuple[tuple[str, tuple[str, ...]], ...] = ()


@dataclass(frozen=True)
class Flag:
    """A status bit beyond the ranges: set where the value of step `step` is below entry `least`.

    Nothing is claimed of the pose then, but that it is finite.
    """

    name: str
    step: str
    least: str
    meaning: str


@dataclass(frozen=True, eq=False)
class Decoupler:
    """The arithmetic from inputs to pose: `steps` in order; the last `len(pose)` of them are the pose.

    `inputs`: readings, then state. `table`: coefficients; `limits`: ends of the box of each input; `zeros`:
    what a reset adds to each pose coordinate. `exact`: inputs (n_inputs, s) -> pose (n_pose, s) of the model
    itself in double, zeros 0.
    """

    model: Model
    inputs: tuple[str, ...]
    table: tuple[Entry, ...]
    limits: tuple[Entry, ...]
    zeros: tuple[Entry, ...]
    steps: tuple[Step, ...]
    at_pose: tuple[Step, ...]
    """Non-linear models: the same with the pose given, for the zero; empty for the others."""
    margins: tuple[Margin, ...]
    box: Box
    exact: Callable[[np.ndarray], np.ndarray]
    symbols: Mapping[str, ca.SX]
    flags: tuple[Flag, ...] = ()
    approximation: float = 0.0
    """What polynomials and series in place of functions leave in the pose [m, rad]."""
    leaves: Mapping[str, float] = field(default_factory=dict)
    """The same by pose column [its unit], where they differ."""
    drawn: "Callable[[np.random.Generator, int], np.ndarray] | None" = None
    """Random inputs (n_inputs, s) of poses in the box, of a decoder that claims nothing of readings that
    belong to no pose; any within the limits otherwise."""
    cut: float = 0.0
    """What bits that whole steps cut off add to the pose [m, rad]; `bounded` counts it as rounding."""
    bounded: "Callable[[int], Mapping[str, Enclosure]] | None" = None
    """Digits of the significand -> range and rounding of each pose coordinate, flags clear; interval
    arithmetic on the whole of the steps where there is none."""
    listed: tuple[tuple[float, ...], ...] = ()
    """Inputs that the self-test shall list, beside its own."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What the choices of a family came to: given again, they make the same code."""
    integers: "Callable[..., Any] | None" = None
    """The program of integers (`hallsym.codegen.fixed_point`), of a family that brings one of its own."""
    arrays: tuple[Array, ...] = ()
    """Rows of numbers that steps look up; in the table after the limits."""
    evident: bool = True
    """Whether an analysis that relates no two values, such as Frama-C EVA, sees that the pose is finite."""
    said: tuple[str, ...] = ()
    """Sentences for header and report: approximations, and what they may leave."""

    @property
    def pose(self) -> tuple[str, ...]:
        """Columns of the output."""
        return self.model.pose

    @property
    def slack(self) -> float:
        """What series and iterations of a non-linear model may leave [m, rad]; 0 of a linear one."""
        return ENOUGH if self.at_pose else self.approximation

    @property
    def input_bits(self) -> tuple[int, ...]:
        """Status bit of each input, below those of the flags; of more inputs, neighbours share one."""
        own, count = FLAG_BITS - len(self.flags), len(self.inputs)
        return tuple(1 << (k if count <= own else k * own // count) for k in range(count))

    @property
    def shared(self) -> bool:
        """Whether inputs share status bits."""
        return len(set(self.input_bits)) < len(self.inputs)

    @property
    def quantity(self) -> str:
        """What its output is: a pose, or an angle or a position where that is all of it."""
        names = {"rad": "angle", "m": "position"}
        return names.get(unit(self.pose[0]), "pose") if len(self.pose) == 1 else "pose"

    @property
    def tried(self) -> int:
        """Random inputs that errors are met over, where nothing else is said: fewer through an iterated
        model."""
        return TRIED if self.drawn is None else TRIED // 10

    def left(self, column: str) -> float:
        """Return `slack` of one pose coordinate."""
        return self.leaves.get(column, self.slack)

    def trials(self, rng: np.random.Generator, count: int, ends: np.ndarray) -> np.ndarray:
        """Return random inputs (n_inputs, count) for trials; `ends`: least and greatest (2, n_inputs, 1)."""
        if self.drawn is not None:
            return np.clip(self.drawn(rng, count), *ends)
        share = rng.random((len(self.inputs), count))
        return np.asarray(ends[0] + (ends[1] - ends[0]) * share)

    def known(self, column: str) -> float:
        """Return the largest magnitude of a known pose coordinate, for a zero: half its period, or 1."""
        return self.model.period.get(column, 2.0) / 2

    def difference(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return a - b of poses (n_pose, s), coordinates that repeat within half a period of zero."""
        out = np.array(a, dtype=float) - b
        for k, column in enumerate(self.pose):
            if column in self.model.period:
                out[k] = wrapped(out[k], self.model.period[column])
        return out

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Coefficients, limits and zeros, in the order of the table."""
        return (*self.table, *self.limits, *self.zeros)

    def ends(self, column: str) -> tuple[float, float]:
        """Return least and greatest value of an input."""
        return self.box.ends[column]

    @cached_property
    def folded(self) -> ca.SX:
        """The pose as one expression of inputs, table and zeros."""
        return ca.vertcat(*(self._done[step.name] for step in self.steps[-len(self.pose) :]))

    @cached_property
    def _done(self) -> dict[str, ca.SX]:
        """Each step as an expression of inputs, table and zeros."""
        done: dict[str, ca.SX] = {}
        for step in self.steps:
            if isinstance(step, Lookup):
                continue  # its symbol stays: a number that is looked up
            earlier = {n: (self.symbols[n], e) for n, e in done.items() if n in self.symbols}
            made = _replaced(step.expression, earlier)
            done[step.name] = _whole(step, made)
        return done

    def raised(self, seen: np.ndarray, dtype: type = float) -> np.ndarray:
        """Return the bits (s,) of the flags that their values (n_flags, s) raise."""
        values = {e.name: dtype(e.value) for e in self.table}
        bits = np.zeros(seen.shape[1:], dtype=np.uint32)
        for k, flag in enumerate(self.flags):
            bits |= np.where(seen[k] >= values[flag.least], 0, flag_bit(k)).astype(np.uint32)
        return bits

    @property
    def constants(self) -> list[float]:
        """Values of coefficients and zeros."""
        return [e.value for e in (*self.table, *self.zeros)]


def flag_bit(k: int) -> int:
    """Return the status bit of the flag of that number; bits of inputs begin at the other end."""
    return 1 << (FLAG_BITS - 1 - k)


def _whole(step: Step, value: ca.SX) -> ca.SX:
    """Return what a step makes of its value: integers where it holds bits, exact in any type."""
    if isinstance(step, Whole):
        return ca.floor(value)
    if isinstance(step, Bits):
        upper = ca.floor(value * 2.0**-step.first)
        return value - upper * 2.0**step.first if step.below else upper
    return value


def _replaced(expression: ca.SX, pairs: Mapping[str, tuple[ca.SX, ca.SX]]) -> ca.SX:
    if not pairs:
        return expression
    return ca.substitute(
        expression, ca.vertcat(*(a for a, _ in pairs.values())), ca.vertcat(*(b for _, b in pairs.values()))
    )
