"""An SX graph as typed operations: what C in floats, C in integers, intervals and costs walk over."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

NAMES: dict[int, str] = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}
"""CasADi's operations by code: "add", "sq" (square), "twice", "if_else_zero" (x ? y : 0), ..."""
TESTS = ("lt", "le")
"""Comparisons: 1 or 0."""
BRANCHES = frozenset({*TESTS, "not", "if_else_zero", "fmin", "fmax", "fabs", "sign"})
"""Operations beyond +, -, * and /."""


@dataclass(frozen=True)
class Operation:
    """`op` of the earlier operations numbered `args`.

    An "input" has the name of its symbol, a "const" its value.
    """

    op: str
    args: tuple[int, ...] = ()
    symbol: str = ""
    value: float = 0.0


@dataclass(frozen=True)
class Graph:
    """Operations in an order in which they can be computed, and the numbers of those that are results."""

    operations: tuple[Operation, ...]
    results: tuple[int, ...]

    @property
    def count(self) -> int:
        """Operations that compute something."""
        return sum(o.op not in ("input", "const") for o in self.operations)


def chosen(operation: Operation, operations: Sequence[Operation]) -> tuple[int, int, int] | None:
    """Return (c, x, y) where an operation is CasADi's c ? x : y: (c ? x : 0) + (!c ? y : 0)."""
    if operation.op != "add" or any(operations[k].op != "if_else_zero" for k in operation.args):
        return None
    (yes, x), (no, y) = (operations[k].args for k in operation.args)
    return (yes, x, y) if operations[no] == Operation("not", (yes,)) else None


def graph(expressions: Sequence[ca.SX]) -> Graph:
    """Return the graph of scalar expressions; what they share is computed once."""
    symbols = ca.symvar(ca.vertcat(*expressions))
    function = ca.Function("graph", symbols, [ca.densify(e) for e in expressions])
    operations: list[Operation] = []
    results = [0] * function.n_out()
    slot: dict[int, int] = {}
    for k in range(function.n_instructions()):
        op = NAMES[function.instruction_id(k)]
        read, written = function.instruction_input(k), function.instruction_output(k)
        if op == "output":
            results[written[0]] = slot[read[0]]
            continue
        args = [slot[j] for j in read] if op not in ("input", "const") else []
        slot[written[0]] = len(operations)
        if op == "input":
            operations.append(Operation(op, symbol=symbols[read[0]].name()))
        elif op == "const":
            operations.append(Operation(op, value=function.instruction_constant(k)))
        else:
            operations.append(Operation(op, tuple(args)))
    return Graph(tuple(operations), tuple(results))
