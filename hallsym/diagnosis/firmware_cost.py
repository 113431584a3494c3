"""What an effect costs on the controller: the C that is generated for it, before and after."""

import casadi as ca
import numpy as np

from hallsym.codegen import cost_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

NO_WORK = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)
SHOWN = 3
"""Computed signals that are named; of more the text says '...'."""


def operations(model: Model) -> int:
    """Return the count of arithmetic operations of one decoded pose, common subexpressions counted once.

    Each sine or division of the model's own expression is one operation: for models that have no C.
    """
    f = model.decoded
    inputs = f.sx_in()
    (pose,) = f.call(inputs)
    lean = ca.Function("lean", inputs, [ca.cse(pose)])
    return sum(lean.instruction_id(k) not in NO_WORK for k in range(lean.n_instructions()))


def firmware_cost(before: Model, after: Model, p: np.ndarray | None = None) -> str:
    """Return in words what the step from one model to another adds: parameters, instructions, signals.

    `p`: parameters of `after`, which decide how often a non-linear model is iterated; nominal by default.
    """
    added = counted(len(after.parameters) - len(before.parameters), "parameter")
    signals = [c.name for c in after.computed if c.name not in before.state]
    text = f"{added}; {_work(before, after, p)}"
    if signals:
        some = ", ".join(signals[:SHOWN]) + (", ..." if len(signals) > SHOWN else "")
        text += f" and {counted(len(signals), 'signal')} to compute ({some})"
    return text


def _work(before: Model, after: Model, p: np.ndarray | None) -> str:
    shared = None
    if p is not None:
        shared = before.vector({n: v for n, v in after.named(p).items() if n in before.names})
    try:
        old, new = cost_of(before, shared), cost_of(after, p)
    except InputError:
        return f"decoding {operations(before)} -> {operations(after)} operations, no C"
    return (
        f"C about {old.instructions} -> {new.instructions} instructions, "
        f"parameter table {old.table} -> {new.table} B"
    )
