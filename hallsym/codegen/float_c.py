"""CasADi expressions as C statements: +, -, *, /, magnitude, comparison, choice; nothing that needs libm."""

from collections import Counter
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Bits, Lookup, Step, Whole
from hallsym.codegen.operations import TESTS, chosen
from hallsym.errors import InputError
from hallsym.output import commented


def constant(value: float) -> str:
    """Return a literal that is read back as the same float32 number."""
    text = f"{float(np.float32(value)):.9g}"
    return text + ("f" if "." in text or "e" in text else ".0f")


def statements(steps: Sequence[Step], names: Mapping[str, str], results: Mapping[str, str]) -> list[str]:
    """Return one C statement per step, and one per value that a step uses twice.

    `names`: C text of each symbol by its SX name (others stand for themselves). `results`: C lvalue of the
    steps that are results; the others become constants.
    """
    lines: list[str] = []
    names = dict(names)
    for step in steps:
        before, text = _text(step, names)
        lines += before
        left = results.get(step.name, f"const float {step.name}")
        lines += [f"/* {commented(step.remark)} */"] if step.remark else []
        if isinstance(step, Whole | Bits):
            source = step.expression.name()
            left, text = f"const uint32_t {step.name}", f"(uint32_t){source}"
            if isinstance(step, Bits):
                cut = f"& 0x{(1 << step.first) - 1:X}U" if step.below else f">> {step.first}U"
                text = f"{source} {cut}"
            names[step.name] = f"(float){step.name}"
        elif isinstance(step, Lookup):  # p->name[cell & 63U]: an index within the array whatever the cell
            cell, size = step.expression.name(), len(step.array.values)
            place = f"({cell} + {step.ahead % size}U)" if step.ahead else cell
            text = f"p->{step.array.name}[{place} & {size - 1}U]"
            text = f"(float){text}" if step.array.integers else text
        lines.append(f"{left} = {text};")
    return lines


def _text(step: Step, names: Mapping[str, str]) -> tuple[list[str], str]:
    """Return statements of the values that a step uses twice, and its text."""
    found, operations = step.graph, step.graph.operations
    uses = Counter(k for o in operations for k in o.args)
    uses.update(found.results)
    before: list[str] = []
    text: list[str] = []
    for k, o in enumerate(operations):
        if o.op == "input":
            text.append(names.get(o.symbol, o.symbol))
            continue
        if o.op == "const":
            text.append(constant(o.value))
            continue
        choice = chosen(o, operations)
        parts = [text[j] for j in choice or o.args]
        text.append("({} ? {} : {})".format(*parts) if choice else _operation(o.op, parts))
        if o.op in (*TESTS, "not"):
            continue
        if uses[k] > 1 or (o.op == "sq" and "(" in text[o.args[0]]):
            name = f"{step.name}_t{len(before)}"
            before.append(f"const float {name} = {_bare(text[k])};")
            text[k] = name
    return before, _bare(text[found.results[0]])


_TEXTS = {
    **{op: f"({{}} {sign} {{}})"
       for op, sign in {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<="}.items()},
    "not": "(!{})",
    "neg": "(-{})",
    "sq": "({0} * {0})",
    "twice": "({0} + {0})",
    "inv": "(1.0f / {})",
    "if_else_zero": "({} ? {} : 0.0f)",
    "fabs": "MAGNITUDE({})",
}  # fmt: skip
"""The C text of each operation, in parentheses where it needs them."""


def _operation(op: str, a: Sequence[str]) -> str:
    if op not in _TEXTS:
        raise InputError(f"Operation {op} of the model has no C without libm; write it as a polynomial.")
    return _TEXTS[op].format(*(map(_bare, a) if op == "fabs" else a))


def _bare(text: str) -> str:
    """Return `a + b` for `(a + b)`."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for k, sign in enumerate(text):
        depth += (sign == "(") - (sign == ")")
        if depth == 0 and k < len(text) - 1:
            return text
    return text[1:-1]


def shared_steps(expression: ca.SX) -> list[Step]:
    """Return the steps of a vector: what its rows share comes first, then `result_0`, `result_1`, ..."""
    (rest,), symbols, values = ca.shared([expression], "shared_", "")
    steps: list[Step] = []
    waiting = {s.name(): e for s, e in zip(symbols, values, strict=True)}
    needs = {n: {v.name() for v in ca.symvar(e)} & waiting.keys() for n, e in waiting.items()}
    while waiting:  # CasADi lists them in any order; C needs a value before its use
        ready = [n for n in waiting if not needs[n] & waiting.keys()]
        steps += [Step(name, waiting.pop(name)) for name in ready]
    return steps + [Step(f"result_{k}", rest[k]) for k in range(rest.numel())]
