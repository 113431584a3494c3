"""What the effects of every family are made of: free parameters and the step that uses them."""

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from hallsym.model import Model, Parameter, Step
from hallsym.model.derived import Computed

Make = Callable[[Model], Model]
"""An effect."""
P = Mapping[str, ca.SX]
"""Parameters of a step, by name."""


def free(names: Sequence[str], limit: float, unit: str, meaning: str) -> tuple[Parameter, ...]:
    """Return parameters that are 0 where the effect is absent, between -limit and limit."""
    return tuple(Parameter(name, 0.0, -limit, limit, unit, meaning) for name in names)


def column(p: P, names: Sequence[str]) -> ca.SX:
    """Return the values of some parameters as a column."""
    return ca.vertcat(*(p[name] for name in names))


def add(
    model: Model,
    link: str,
    effect: str,
    parameters: tuple[Parameter, ...],
    step: Step,
    *columns: str | Computed,
) -> Model:
    """Return the model with a step on a link, its parameters and the columns it needs."""
    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=parameters)
