"""What a decoupler is made of, whatever the family: steps over inputs and table, margins, the whole.

A family's own file makes a `Decoupler` (`hallsym.codegen.families`); source, table, self-test, bounds, proofs
and reports are made from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box
from hallsym.codegen.entries import Entry, short
from hallsym.model import Model

ENOUGH = 2e-11
"""Change of the pose [m, rad] below which an iteration of a non-linear model ends."""


@dataclass(frozen=True, eq=False)
class Step:
    """`name` = `expression` of the symbols of inputs, table entries and earlier steps."""

    name: str
    expression: ca.SX
    remark: str = ""


@dataclass(frozen=True)
class Margin:
    """What must not come near zero in the box: entry `rest` plus, for each of `terms`, entry * columns.

    `column`: the input it belongs to. `decoupler_check()` refuses a table whose terms, at their largest
    within the limits, leave less than a tenth of `rest`.
    """

    column: str
    rest: str
    terms: tuple[tuple[str, tuple[str, ...]], ...] = ()


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

    @property
    def pose(self) -> tuple[str, ...]:
        """Columns of the output."""
        return self.model.pose

    @property
    def slack(self) -> float:
        """What series and iterations of a non-linear model may leave [m, rad]; 0 of a linear one."""
        return ENOUGH if self.at_pose else 0.0

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
        done: dict[str, ca.SX] = {}
        for step in self.steps:
            earlier = {n: (self.symbols[n], e) for n, e in done.items() if n in self.symbols}
            done[step.name] = _replaced(step.expression, earlier)
        return ca.vertcat(*(done[step.name] for step in self.steps[-len(self.pose) :]))

    @cached_property
    def slopes(self) -> dict[str, ca.SX]:
        """d pose / d reading by CasADi's differentiation of the printed expressions, by name: `x_hall_a`."""
        channels, n = self.model.channels, len(self.model.channels)
        jacobian = ca.jacobian(self.folded, ca.vertcat(*(self.symbols[c] for c in channels)))
        flat = ca.cse(ca.vertcat(*(jacobian[i, k] for i in range(len(self.pose)) for k in range(n))))
        names = [f"{short(c)}_{short(m)}" for c in self.pose for m in channels]
        return dict(zip(names, ca.vertsplit(ca.densify(flat)), strict=True))

    @cached_property
    def function(self) -> ca.Function:
        """`(inputs, coefficients and zeros) -> pose`."""
        table = [*self.table, *self.zeros]
        given = [
            ca.vertcat(*(self.symbols[n] for n in names)) for names in (self.inputs, [e.name for e in table])
        ]
        return ca.Function("folded", given, [ca.densify(self.folded)])

    @property
    def constants(self) -> list[float]:
        """Values of coefficients and zeros."""
        return [e.value for e in (*self.table, *self.zeros)]


def _replaced(expression: ca.SX, pairs: Mapping[str, tuple[ca.SX, ca.SX]]) -> ca.SX:
    if not pairs:
        return expression
    return ca.substitute(
        expression, ca.vertcat(*(a for a, _ in pairs.values())), ca.vertcat(*(b for _, b in pairs.values()))
    )
