"""What generated C costs, counted from its steps without a compiler."""

from dataclasses import dataclass

import numpy as np

from hallsym.codegen.decoupler import Bits, Box, Decoupler, Lookup, Whole, unit
from hallsym.codegen.lowering import check_columns, lowered
from hallsym.errors import InputError
from hallsym.model import Model

TYPICAL = {"m": 5e-4, "rad": 5e-4, "degC": 10.0}
"""Reach of a column by its unit where no box is given: a fine stroke, some ten degrees of temperature."""
HEAD = 28
"""Bytes of a table beside its entries: two CRC, version, layout, length, calibration."""


@dataclass(frozen=True)
class Cost:
    """Of one call: arithmetic operations, numbers it reads and writes, and bytes of its float table."""

    operations: int
    moves: int
    table: int

    @property
    def instructions(self) -> int:
        """About how many instructions the arithmetic takes on a Cortex-M4F: one per operation and move."""
        return self.operations + self.moves


def firmware_cost(d: Decoupler) -> Cost:
    """Return the cost of a decoupler's arithmetic, range test and status apart."""
    operations, read = 0, set()
    for step in d.steps:
        found = step.graph
        operations += found.count + 3 * isinstance(step, Lookup) + isinstance(step, Whole | Bits)
        read |= {o.symbol for o in found.operations if o.op == "input"}
    entries = {e.name for e in (*d.table, *d.offsets)}
    moves = len(read & entries) + len(d.inputs) + len(d.pose)
    return Cost(
        operations,
        moves,
        HEAD + 4 * len(d.entries) + sum((2 if a.integers else 4) * len(a.values) for a in d.arrays),
    )


def cost_of(model: Model, p: np.ndarray | None = None) -> Cost:
    """Return what the C of a model would cost, at parameters `p` (default nominal) over a typical box.

    Raises `InputError` for a model that C cannot be generated from.
    """
    check_columns(model)
    reach = {c: TYPICAL.get(unit(c), 1.0) for c in (*model.pose, *model.state)}
    about = dict(zip(model.pose, np.mean(model.typical, axis=0), strict=True)) if model.typical else {}
    middle = {c: 0.0 if c in model.period else about.get(c, 0.0) for c in reach}
    box = Box({c: (middle[c] - most, middle[c] + most) for c, most in reach.items()})
    return firmware_cost(lowered(model, model.nominal if p is None else p, np.ones(len(model.channels)), box))


def price(before: Model, after: Model, p: np.ndarray) -> str:
    """Return in words what the step from one model to another adds to the C of the controller.

    `p`: parameters of `after`, (n,), which decide how often a non-linear model is iterated.
    """
    shared = before.vector({n: v for n, v in after.named(p).items() if n in before.names})
    try:
        old, new = cost_of(before, shared), cost_of(after, p)
    except InputError:
        return "no C is generated with it"
    work = f"C about {old.instructions} -> {new.instructions} instructions"
    return f"{work}, parameter table {old.table} -> {new.table} B"
