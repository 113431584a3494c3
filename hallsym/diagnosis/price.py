"""What an effect costs on the controller: the C that is generated for it, before and after."""

import casadi as ca
import numpy as np

from hallsym.codegen import cost_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

NO_WORK = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)


def operations(model: Model) -> int:
    """Return the count of arithmetic operations of one decoded pose, common subexpressions counted once.

    Of the model's own expression, each sine or division one operation: for models that have no C.
    """
    f = model.decoded
    inputs = f.sx_in()
    (pose,) = f.call(inputs)
    lean = ca.Function("lean", inputs, [ca.cse(pose)])
    return sum(lean.instruction_id(k) not in NO_WORK for k in range(lean.n_instructions()))


def price(before: Model, after: Model, p: np.ndarray | None = None) -> str:
    """Return in words what the step from one model to another adds: parameters, instructions, columns.

    `p`: parameters of `after`, which say how often a non-linear model is iterated; nominal by default.
    """
    new = len(after.parameters) - len(before.parameters)
    columns = [c.name for c in after.computed if c.name not in before.state]
    text = f"{counted(new, 'parameter')}; {_work(before, after, p)}"
    if columns:
        text += f" and {counted(len(columns), 'signal')} to compute ({_some(columns)})"
    return text


def _work(before: Model, after: Model, p: np.ndarray | None) -> str:
    try:
        shared = None if p is None else {n: v for n, v in after.named(p).items() if n in before.names}
        old = cost_of(before, None if shared is None else before.vector(shared))
        new = cost_of(after, p)
    except InputError:
        return f"decoding {operations(before)} -> {operations(after)} operations, no C"
    return (
        f"C about {old.instructions} -> {new.instructions} instructions, "
        f"parameter table {old.table} -> {new.table} B"
    )


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
