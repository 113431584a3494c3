"""Slopes of the pose by readings and state, of the printed expressions: `decoupler_jacobian()`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.bounds import step_errors
from hallsym.codegen.decoupler import Decoupler, Step
from hallsym.codegen.entries import short, unit
from hallsym.codegen.float_c import Real, shared_steps
from hallsym.codegen.naming import commented
from hallsym.errors import InputError, quoted
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

KINDS = ("reading", "state")
"""Inputs by which the pose can be differentiated."""


def kinds_of(given: bool | str | Sequence[str], model: Model) -> tuple[str, ...]:
    """Return the kinds of slopes that are asked for: True stands for readings, a text may list several.

    Raises `InputError` for others, and for the state of a model that has none.
    """
    if isinstance(given, bool):
        return KINDS[:1] if given else ()
    wanted = [name.strip() for name in given.split(",")] if isinstance(given, str) else list(given)
    for name in wanted:
        if name not in KINDS:
            raise InputError(
                f"--jacobian takes {', '.join(KINDS)} or both with a comma between; instead received "
                f"{quoted(name)}."
            )
    if "state" in wanted and not model.state:
        raise InputError(f"--jacobian state: model {model.name} reads no state; leave it out.")
    return tuple(kind for kind in KINDS if kind in wanted)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of the pose of a decoupler by the columns of some kinds of input."""

    d: Decoupler
    kinds: tuple[str, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Inputs by which the pose is differentiated."""
        by_kind = {"reading": self.d.model.channels, "state": self.d.model.state}
        return tuple(column for kind in self.kinds for column in by_kind[kind])

    @cached_property
    def expressions(self) -> dict[str, ca.SX]:
        """By name: `x_hall_a`, by CasADi's differentiation of the printed expressions."""
        d, columns = self.d, self.columns
        jacobian = ca.jacobian(d.folded, ca.vertcat(*(d.symbols[c] for c in columns)))
        flat = [jacobian[i, k] for i in range(len(d.pose)) for k in range(len(columns))]
        names = [f"{short(c)}_{short(m)}" for c in d.pose for m in columns]
        return dict(zip(names, ca.vertsplit(ca.densify(ca.cse(ca.vertcat(*flat)))), strict=True))

    @property
    def whole(self) -> ca.SX:
        """All of them (n,)."""
        return ca.vertcat(*self.expressions.values())

    @cached_property
    def steps(self) -> list[Step]:
        """What they share, then one step each."""
        return shared_steps(self.whole)

    @property
    def stored(self) -> dict[str, str]:
        """C lvalue of each step that is a slope."""
        return {f"result_{k}": f"slopes->{name}" for k, name in enumerate(self.expressions)}

    def records(self) -> list[dict[str, Any]]:
        """Return what templates say of each slope."""
        pairs = [(c, m) for c in self.d.pose for m in self.columns]
        return [
            {"name": name, "index": k, "unit": f"{unit(c)}/{unit(m)}", "of": commented(c), "by": commented(m)}
            for k, (name, (c, m)) in enumerate(zip(self.expressions, pairs, strict=True))
        ]

    def fields(self) -> dict[str, str]:
        """Return what templates say of all of them."""
        plural = {"reading": "readings", "state": "state"}
        units = dict.fromkeys(record["unit"] for record in self.records())
        return {
            "quantity": self.d.quantity,
            "by_kinds": " and ".join(f"the {plural[kind]}" for kind in self.kinds),
            "by_kind": ", ".join(f"d {self.d.quantity} / d {kind}" for kind in self.kinds),
            "slope_units": ", ".join(units),
        }

    def of(self, held: np.ndarray) -> np.ndarray:
        """Return the slopes (n, s) in double of inputs (n_inputs, s) in their ranges."""
        d = self.d
        given = [ca.vertcat(*(d.symbols[n] for n in d.inputs))]
        given.append(ca.vertcat(*(d.symbols[e.name] for e in (*d.table, *d.zeros))))
        return on_arrays(ca.Function("slopes", given, [self.whole]))(list(held), d.constants)[0]

    def errors(self, real: Real) -> list[float]:
        """Return how far each computed slope can be from its expression over the box, table included."""
        return step_errors(self.d, self.steps, real.digits)[-len(self.expressions) :]
