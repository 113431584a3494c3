"""An SX graph as typed operations: what C in floats, C in integers, intervals and costs walk over."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca

NAMES: dict[int, str] = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}
"""CasADi's operations by code: "add", "sq" (square), "twice", "if_else_zero" (x ? y : 0), ..."""
TESTS = ("lt", "le")
"""Comparisons: 1 or 0."""
FUSED = {"fma": "a b + c", "fms": "a b - c", "fnma": "c - a b"}
"""Fused multiply-add: the exact value rounded once. Not CasADi's; `graph(..., fused=True)` makes them."""
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


def graph(expressions: Sequence[ca.SX], fused: bool = False) -> Graph:
    """Return the graph of scalar expressions; what they share is computed once.

    `fused`: a product that only a sum or difference takes becomes one operation with it.
    """
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
    found = Graph(tuple(operations), tuple(results))
    return _fused(found) if fused else found


def _fused(plain: Graph) -> Graph:
    """Return the graph with products taken into sums: never more operations, each rounded once.

    Of two products the right one is taken: sums have their small terms first, so the rounding that is left is
    the smaller one's.
    """
    uses = Counter(k for o in plain.operations for k in o.args)
    uses.update(plain.results)
    taken = dict(_pairs(plain.operations, uses))
    inside = {product for product, _ in taken.values()}
    made: list[Operation] = []
    place: dict[int, int] = {}
    for k, o in enumerate(plain.operations):
        if k in inside:
            continue
        if k in taken:
            product, op = taken[k]
            factors = plain.operations[product].args  # one of a square
            o = Operation(op, (factors[0], factors[-1], o.args[o.args[0] == product]))
        place[k] = len(made)
        made.append(replace(o, args=tuple(place[j] for j in o.args)))
    return Graph(tuple(made), tuple(place[k] for k in plain.results))


def _pairs(operations: Sequence[Operation], uses: Counter[int]) -> Iterator[tuple[int, tuple[int, str]]]:
    """Yield the number of each sum that takes a product, the product's number, and what they are together."""
    for k, o in enumerate(operations):
        if o.op not in ("add", "sub"):
            continue
        for j in reversed(o.args):
            if operations[j].op in ("mul", "sq") and uses[j] == 1:
                yield k, (j, "fma" if o.op == "add" else "fms" if j == o.args[0] else "fnma")
                break
