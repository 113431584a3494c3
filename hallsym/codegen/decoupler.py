"""What a decoupler is made of, whatever the family: steps over inputs and table, margins, the whole.

A family's own file makes a `Decoupler` (`hallsym.codegen.lowering`); source, table, self-test, bounds, proofs
and reports are made from it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.naming import identifier
from hallsym.codegen.operations import NAMES, Graph, graph
from hallsym.log.phase import wrapped
from hallsym.model import Model
from hallsym.model.arrays import BINARY, UNARY


@dataclass(frozen=True, eq=False)
class Entry:
    """One number of the parameter table: `value` in SI, and what it means."""

    name: str
    value: float
    unit: str
    meaning: str
    holds: str = ""
    """What no recalibration changes: its "sign", as of a length, its "value", or that it is a "share", 0 to
    1."""


def short(column: str) -> str:
    """Return `hall_a` of `hall_a_m`, as a C identifier."""
    return identifier(column.rpartition("_")[0] or column)


def unit(column: str) -> str:
    """Return the SI unit of a column."""
    ending = column.rpartition("_")[2]
    return {"degc": "degC", "v": "V"}.get(ending, ending if ending in ("m", "rad", "s", "count") else "1")


def offsets_of(model: Model) -> tuple[Entry, ...]:
    """Return what a reset adds to each pose coordinate."""
    return tuple(
        Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()") for c in model.pose
    )


@dataclass(frozen=True)
class Box:
    """Least and greatest value of each column, in SI: state, pose and, where given, readings.

    `one_limit`: whether one limit says both ends of a column, where code that is there already says so.
    """

    ends: Mapping[str, tuple[float, float]]
    one_limit: Mapping[str, bool] = field(default_factory=dict)

    def reach(self) -> dict[str, float]:
        """Return the largest magnitude of each column."""
        return {column: max(abs(low), abs(high)) for column, (low, high) in self.ends.items()}

    def symmetric(self, column: str) -> bool:
        """Whether one limit says it."""
        low, high = self.ends[column]
        return low == -high and self.one_limit.get(column, True)

    def over(self, ends: Mapping[str, tuple[float, float]]) -> "Box":
        """Return the box of these columns: a reading that has one limit gets the wider one of its ends."""
        found = dict(ends)
        for column in found.keys() & self.one_limit.keys():
            if self.one_limit[column]:
                most = max(map(abs, found[column]))
                found[column] = (-most, most)
        return replace(self, ends=found)


def limits(inputs: Sequence[str], box: Box) -> tuple[Entry, ...]:
    """Return the table entries of the ends of each input: one limit where it is symmetric."""
    out = []
    for column in inputs:
        low, high = box.ends[column]
        if box.symmetric(column):
            out.append(Entry(f"limit_{short(column)}", high, unit(column), f"largest |{column}| of the box"))
        else:
            out.append(Entry(f"low_{short(column)}", low, unit(column), f"least {column} of the box"))
            out.append(Entry(f"high_{short(column)}", high, unit(column), f"greatest {column} of the box"))
    return tuple(out)


ENOUGH = 2e-11
"""Change of the pose [m, rad] below which an iteration of a non-linear model ends."""

TRIED = 100_000
FAULT, AGREEMENT = "FAULT", "agreement"
"""Flag of readings that contradict one another, and the step that it looks at."""
ROOT = "root"
"""Row of the table by which what is left of each reading is compared with the others."""
OF_ROOT = "by which what is left of a reading is compared; below 0: not to be told from another"
"""What the table says of it."""
FLAG_BITS = 31
"""Bits of the status of a step: inputs from below, flags from above; the last is of a refused zero."""


@dataclass(frozen=True, eq=False)
class Step:
    """`name` = `expression` of the symbols of inputs, table entries and earlier steps."""

    name: str
    expression: ca.SX
    remark: str = ""
    most: ca.SX | float | None = field(default=None, kw_only=True)
    """Magnitude, of entries, that the value does not exceed whatever it is computed from."""
    follows: tuple[str, float] | None = field(default=None, kw_only=True)
    """Of what is looked up: the step of the place, and how much it moves with that at most."""

    @cached_property
    def graph(self) -> Graph:
        """The operations of its expression."""
        return graph([self.expression])


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

    `column`: the input it belongs to. The least and greatest values of a table leave a tenth of `rest` where
    the terms are at their largest within the limits.
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
class Watched:
    """What is left of a reading after the decode: the step `left`, of the readings (numbers) it may be; of
    none, where it tells these from one another.

    `error`: the step whose product with `left` is its part of the sum that the flag of a fault looks at;
    `left` itself where readings count equally.
    """

    left: str
    readings: tuple[int, ...]
    error: str = ""


@dataclass(frozen=True)
class Redundancy:
    """What readings say beyond the unknowns, so that they can contradict one another.

    The step "agreement" is less the sum of squares of what is left of the readings, the entry
    "least_agreement" the least of it that noise and approximations explain. With several `watched` the
    largest, each times its entry of the row "root", names the suspect; `mended`: the pose is decoded again
    without it, by the reading at which nothing of it is left. `unseen`: by pose column what a fault that
    raises no bit moves it by at most [its unit]; `without`: the same of a pose without its suspect.
    """

    watched: tuple[Watched, ...] = ()
    mended: bool = False
    unseen: Mapping[str, float] = field(default_factory=dict)
    without: Mapping[str, float] = field(default_factory=dict)

    @property
    def steps(self) -> tuple[str, ...]:
        """Names of the steps that it looks at."""
        return (AGREEMENT, *(name for w in self.watched for name in (w.left, w.error) if name))


@dataclass(frozen=True, eq=False)
class Decoupler:
    """The arithmetic from inputs to pose: `steps` in order; the last `len(pose)` of them are the pose.

    `inputs`: readings, then state. `table`: coefficients; `limits`: ends of the box of each input; `offsets`:
    what a reset adds to each pose coordinate. `exact`: inputs (n_inputs, s) -> pose (n_pose, s) of the model
    itself in double, offsets 0.
    """

    model: Model
    inputs: tuple[str, ...]
    table: tuple[Entry, ...]
    limits: tuple[Entry, ...]
    offsets: tuple[Entry, ...]
    steps: tuple[Step, ...]
    box: Box
    exact: Callable[[np.ndarray], np.ndarray]
    symbols: Mapping[str, ca.SX]
    margins: tuple[Margin, ...] = ()
    at_pose: tuple[Step, ...] = ()
    """Non-linear models: the same with the pose given, for the zero; empty for the others."""
    flags: tuple[Flag, ...] = ()
    approximation: float = 0.0
    """What polynomials and series in place of functions leave in the pose [m, rad]."""
    leaves: Mapping[str, float] = field(default_factory=dict)
    """The same by pose column [its unit], where they differ."""
    drawn: "Callable[[np.random.Generator, int], np.ndarray] | None" = None
    """Random inputs (n_inputs, s) of poses in the box, of a decoder that claims nothing of readings that
    belong to no pose; any within the limits otherwise."""
    cut: float = 0.0
    """What bits that whole steps cut off add to the pose [m, rad]; bounds count it as rounding."""
    sampled: bool = False
    """Whether its rounding is bounded pose by pose: too much depends on one another for intervals."""
    listed: tuple[tuple[float, ...], ...] = ()
    """Inputs that the self-test shall list, beside its own."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What the choices of a family came to: given again, they make the same code."""
    integers: "Callable[..., Any] | None" = None
    """The program of integers, of a family that brings one of its own."""
    arrays: tuple[Array, ...] = ()
    """Rows of numbers that steps look up; in the table after the limits."""
    redundancy: Redundancy | None = None
    """None where there are no more readings than unknowns."""
    evident: bool = True
    """Whether an analysis that relates no two values, such as Frama-C EVA, sees that the pose is finite."""
    said: tuple[str, ...] = ()
    """Sentences for header and report: approximations, and what they may leave."""
    observed: bool = False
    """Whether an observer of position and speed stands behind it; its numbers are in the table."""
    of_faults: tuple[str, ...] = ()
    """Sentences on how readings check one another, and what a fault can do."""

    @property
    def pose(self) -> tuple[str, ...]:
        """Columns of the output."""
        return self.model.pose

    @property
    def slack(self) -> float:
        """What series and iterations of a non-linear model may leave [m, rad]; 0 of a linear one."""
        return ENOUGH if self.at_pose else max(self.leaves.values(), default=self.approximation)

    @property
    def input_bits(self) -> tuple[int, ...]:
        """Status bit of each input, below those of the flags; of more inputs, neighbours share one."""
        own, count = FLAG_BITS - len(self.flags) - self.mends, len(self.inputs)
        return tuple(1 << (k if count <= own else k * own // count) for k in range(count))

    @property
    def watched(self) -> tuple[Watched, ...]:
        """What names a suspect."""
        return () if self.redundancy is None else self.redundancy.watched

    @property
    def mends(self) -> bool:
        """Whether a pose is decoded without a suspect."""
        return self.redundancy is not None and self.redundancy.mended

    @property
    def suspects(self) -> bool:
        """Whether a suspect is named: there is more than one thing left to name it by."""
        return len(self.watched) > 1

    @property
    def degraded_bit(self) -> int:
        """Status bit of a pose without its suspect: the one below the flags."""
        return flag_bit(len(self.flags))

    @property
    def fault_bit(self) -> int:
        """Status bit of readings that contradict one another."""
        return sum(flag_bit(k) for k, flag in enumerate(self.flags) if flag.name == FAULT)

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
        """Random inputs that errors are met over, unless stated: fewer through an iterated model."""
        return TRIED if self.drawn is None else TRIED // 10

    def left(self, column: str) -> float:
        """Return `slack` of one pose coordinate."""
        return self.leaves.get(column, self.slack)

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
        """Coefficients, limits and offsets, in the order of the table."""
        return (*self.table, *self.limits, *self.offsets)

    def ends(self, column: str) -> tuple[float, float]:
        """Return least and greatest value of an input."""
        return self.box.ends[column]

    @cached_property
    def folded(self) -> ca.SX:
        """The pose as one expression of inputs, table and offsets."""
        return ca.vertcat(*(self._done[step.name] for step in self.steps[-len(self.pose) :]))

    @cached_property
    def _done(self) -> dict[str, ca.SX]:
        """Each step as an expression of inputs, table and offsets."""
        done: dict[str, ca.SX] = {}
        for step in self.steps:
            if not isinstance(step, Lookup):  # its symbol stays: a number that is looked up
                made, known = step.expression, [n for n in done if n in self.symbols]
                if known:
                    earlier = ca.vertcat(*(self.symbols[n] for n in known))
                    made = ca.substitute(made, earlier, ca.vertcat(*(done[n] for n in known)))
                done[step.name] = _whole(step, made, ca.floor)
        return done

    def raised(self, seen: np.ndarray) -> np.ndarray:
        """Return the bits (s,) of the flags that their values (n_flags, s) raise."""
        values = {e.name: seen.dtype.type(e.value) for e in self.table}
        bits = np.zeros(seen.shape[1:], dtype=np.uint32)
        for k, flag in enumerate(self.flags):
            bits |= np.where(seen[k] >= values[flag.least], 0, flag_bit(k)).astype(np.uint32)
        return bits

    @property
    def constants(self) -> list[float]:
        """Values of coefficients and offsets."""
        return [e.value for e in (*self.table, *self.offsets)]


def flag_bit(k: int) -> int:
    """Return the status bit of the flag of that number; bits of inputs begin at the other end."""
    return 1 << (FLAG_BITS - 1 - k)


def _whole(step: Step, value: Any, floor: Callable[[Any], Any]) -> Any:
    """Return what a step makes of its value: integers where it holds bits, exact in any type."""
    if isinstance(step, Whole):
        return floor(value)
    if isinstance(step, Bits):
        upper = floor(value * 2.0**-step.first)
        return value - upper * 2.0**step.first if step.below else upper
    return value


TERMS = 3
"""Terms of a sum that one step adds."""


@dataclass(eq=False, kw_only=True)
class Collected:
    """Entries, symbols and steps of one decoupler."""

    table: list[Entry] = field(default_factory=list)
    symbols: dict[str, ca.SX] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    named: set[str] = field(default_factory=set)
    """Names of entries and steps."""

    def begin(self, model: Model, inputs: Sequence[str]) -> None:
        """Add the symbols of inputs and offsets."""
        self.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        self.symbols |= {z.name: ca.SX.sym(z.name) for z in offsets_of(model)}

    def finished(self, model: Model, inputs: tuple[str, ...], ends: Box, **given: Any) -> Decoupler:
        """Return the decoupler of what is collected; `given`: its other fields."""
        return Decoupler(
            model=model, inputs=inputs, table=tuple(self.table), limits=limits(inputs, ends),
            offsets=offsets_of(model), steps=tuple(self.steps), box=ends, symbols=self.symbols, **given,
        )  # fmt: skip

    def whole(self, name: str, value: ca.SX) -> ca.SX:
        """Add the whole part of a number that is no negative one."""
        return self.add(Whole(name, value))

    def add(self, step: Step) -> ca.SX:
        """Add a step, once; returns its symbol."""
        if step.name not in self.named:
            self.named.add(step.name)
            self.steps.append(step)
        return self.symbols.setdefault(step.name, ca.SX.sym(step.name))

    def entry(self, name: str, value: float, unit: str, meaning: str, holds: str = "") -> ca.SX:
        """Add an entry of the table, once; returns its symbol. `holds`: see `Entry`."""
        if name not in self.named:
            self.named.add(name)
            self.table.append(Entry(name, float(value), unit, meaning, holds))
            self.symbols[name] = ca.SX.sym(name)
        return self.symbols[name]

    def step(self, name: str, expression: ca.SX, remark: str = "", **known: Any) -> ca.SX:
        """Add a step, once; returns its symbol. `known` of it: see `Step`."""
        return self.add(Step(name, expression, remark, **known))

    def total(self, name: str, terms: Sequence[ca.SX], remark: str = "") -> ca.SX:
        """Add a sum, some terms at a time: compilers take it as one, and readers can read it."""
        total, rest, k = terms[0], list(terms[1:]), 0
        while len(rest) > TERMS:
            k += 1
            total = self.step(f"{name}_part_{k}", sum(rest[:TERMS], start=total))
            rest = rest[TERMS:]
        return self.step(name, sum(rest, start=total), remark)

    def keep(self, wanted: Sequence[str]) -> None:
        """Leave out the steps that none of the wanted ones needs."""
        self.steps = needed(self.steps, wanted)


def needed(steps: Sequence[Step], wanted: Sequence[str]) -> list[Step]:
    """Return the steps that some of the wanted ones need."""
    names, kept = set(wanted), []
    for step in reversed(steps):
        if step.name in names:
            kept.append(step)
            names |= {s.name() for s in ca.symvar(step.expression)}
    return kept[::-1]


# -- steps on arrays of samples, statement by statement as C runs them: so the same bits

OPERATIONS: Mapping[str, Callable[..., np.ndarray]] = {
    NAMES[code]: run for code, run in (UNARY | BINARY).items()
}
"""Each operation of a graph on arrays, in the type that they have."""


def steps_on_arrays(d: Decoupler, real: type = float) -> Callable[..., list[np.ndarray]]:
    """Return `run(inputs, coefficients + offsets)`: pose (n_pose, s), what flags look at, if any, and what is
    left of each reading that is watched, if any.

    `inputs` (n_inputs, s) and the constants (n,) or (n, 1) are of the type `real`.
    """
    names = [*d.inputs, *(e.name for e in (*d.table, *d.offsets))]
    symbols = [d.symbols[name].name() for name in names]
    results = [step.name for step in d.steps[-len(d.pose) :]]

    def run(inputs: Sequence, constants: Sequence) -> list[np.ndarray]:
        values = dict(zip(symbols, (*inputs, *constants), strict=True))
        for step in d.steps:
            run_step(step, values, real)
        shape = np.broadcast_shapes(*(np.shape(row) for row in inputs))
        return [
            np.array([np.broadcast_to(values[name], shape) for name in group], dtype=real)
            for group in (results, [flag.step for flag in d.flags], [w.left for w in d.watched])
            if group
        ]

    return run


def computed(found: Graph, values: Mapping[str, Any], real: type = float) -> list[Any]:
    """Return the value of each operation of a graph; `values` by symbol."""
    made: list[Any] = []
    for o in found.operations:
        if o.op == "input":
            made.append(values[o.symbol])
        elif o.op == "const":
            made.append(real(o.value))
        else:
            made.append(OPERATIONS[o.op](*(made[k] for k in o.args)))
    return made


def run_step(step: Step, values: dict[str, Any], real: type = float) -> list[Any]:
    """Add the value of a step to those by symbol; returns those of its operations.

    Whole numbers and bits are exact in any type.
    """
    made = computed(step.graph, values, real)
    value = made[step.graph.results[0]]
    if isinstance(step, Lookup):
        entries: np.ndarray = np.array(step.array.values, dtype=real)
        values[step.name] = entries[(value.astype(np.int64) + step.ahead) % len(entries)]
    else:
        values[step.name] = _whole(step, value, np.floor)
    return made


class Trial:
    """Values of the steps of a decoupler in double at trial inputs, while steps are added.

    `inputs`: values (s,) by column; offsets are 0.
    """

    def __init__(self, made: Collected, inputs: Mapping[str, np.ndarray]) -> None:
        self.made, self.done = made, 0
        self.values: dict[str, Any] = {made.symbols[c].name(): v for c, v in inputs.items()}
        self.values |= {name: 0.0 for name in made.symbols if name.startswith("zero_")}

    def __call__(self, names: Sequence[str]) -> np.ndarray:
        """Return the values (names, s) of some steps."""
        made = self.made
        self.values |= {e.name: e.value for e in made.table}
        with np.errstate(all="ignore"):
            for step in made.steps[self.done :]:
                run_step(step, self.values)
        self.done = len(made.steps)
        return np.array(np.broadcast_arrays(*(self.values[n] for n in names)))

    def only(self, some: np.ndarray) -> None:
        """Keep some samples (s,) alone."""
        self.values = {n: v[some] if np.ndim(v) else v for n, v in self.values.items()}
