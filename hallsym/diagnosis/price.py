"""What an effect costs on the controller: operations of the decoded pose before and after."""

import casadi as ca

from hallsym.model import Model

NO_WORK = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)


def operations(model: Model) -> int:
    """Return the count of arithmetic operations of one decoded pose, common subexpressions counted once.

    This is the expression that C is generated from, each sine or division one operation.
    """
    f = model.decoded
    inputs = f.sx_in()
    (pose,) = f.call(inputs)
    lean = ca.Function("lean", inputs, [ca.cse(pose)])
    return sum(lean.instruction_id(k) not in NO_WORK for k in range(lean.n_instructions()))


def price(before: Model, after: Model) -> str:
    """Return in words what the step from one model to another adds: parameters, operations, columns."""
    new = len(after.parameters) - len(before.parameters)
    columns = [c.name for c in after.computed if c.name not in before.state]
    work = f"decoding {operations(before)} -> {operations(after)} operations"
    text = f"{new} parameter{'s' if new != 1 else ''}; {work}"
    if columns:
        text += f" and {len(columns)} signal{'s' if len(columns) != 1 else ''} to compute ({_some(columns)})"
    return text


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
