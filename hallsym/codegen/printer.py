"""CasADi expressions as C statements: +, -, *, /, magnitude, comparison, choice; nothing that needs libm."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.codegen.parts import Bits, Lookup, Step, Whole
from hallsym.errors import InputError

_SIGNS = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_TESTS = {ca.OP_LT: "<", ca.OP_LE: "<="}
_CONDITIONS = (*_TESTS, ca.OP_NOT)
_CALLS = {ca.OP_FMIN: "lesser", ca.OP_FMAX: "greater"}


@dataclass(frozen=True)
class Real:
    """A C type of real numbers: its name, the suffix of its constants, digits of its significand."""

    name: str
    suffix: str
    digits: int
    dtype: type

    @property
    def size(self) -> int:
        """Bytes."""
        return int(np.dtype(self.dtype).itemsize)

    def constant(self, value: float) -> str:
        """Return a literal that is read back as the same number."""
        text = f"{float(self.dtype(value)):.{9 if self.digits == 24 else 17}g}"
        if "." not in text and "e" not in text:
            text += ".0"
        return text + self.suffix


FLOAT = Real("float", "f", 24, np.float32)
DOUBLE = Real("double", "", 53, np.float64)


def statements(
    steps: Sequence[Step], names: Mapping[str, str], real: Real, results: Mapping[str, str]
) -> list[str]:
    """Return one C statement per step, and one per value that a step uses twice.

    `names`: C text of each symbol by its SX name (others stand for themselves). `results`: C lvalue of the
    steps that are results; the others become constants.
    """
    lines: list[str] = []
    names = dict(names)
    for step in steps:
        before, text = _text(step, names, real)
        lines += before
        left = results.get(step.name, f"const {real.name} {step.name}")
        lines += [f"/* {step.remark} */"] if step.remark else []
        if isinstance(step, Whole | Bits):
            left, text = f"const uint32_t {step.name}", _bits(step)
            names[step.name] = f"({real.name}){step.name}"
        elif isinstance(step, Lookup):
            text = _entry(step, real)
        lines.append(f"{left} = {text};")
    return lines


def _bits(step: Whole | Bits) -> str:
    source = step.expression.name()
    if isinstance(step, Whole):
        return f"(uint32_t){source}"
    return f"{source} & 0x{(1 << step.first) - 1:X}U" if step.below else f"{source} >> {step.first}U"


def _entry(step: Lookup, real: Real) -> str:
    """Return `p->name[cell & 63U]`: an index that lies within the array whatever the cell."""
    cell, size = step.expression.name(), len(step.array.values)
    place = f"({cell} + {step.ahead % size}U)" if step.ahead else cell
    entry = f"p->{step.array.name}[{place} & {size - 1}U]"
    return f"({real.name}){entry}" if step.array.integers else entry


def _text(step: Step, names: Mapping[str, str], real: Real) -> tuple[list[str], str]:
    symbols = ca.symvar(step.expression)
    function = ca.Function("step", symbols, [ca.densify(step.expression)])
    uses: dict[int, int] = {}
    program = []
    producer: dict[int, int] = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        i, o = function.instruction_input(k), function.instruction_output(k)
        sources = [] if code in (ca.OP_INPUT, ca.OP_CONST) else [producer[j] for j in i]
        for source in sources:
            uses[source] = uses.get(source, 0) + 1
        program.append((code, i, sources, k))
        if code != ca.OP_OUTPUT:
            producer[o[0]] = k
    before: list[str] = []
    made = {k: (code, sources) for code, _, sources, k in program}
    text: dict[int, str] = {}
    result = ""
    for code, i, sources, k in program:
        if code == ca.OP_OUTPUT:
            result = text[sources[0]]
            continue
        if code == ca.OP_INPUT:
            name = symbols[i[0]].name()
            text[k] = names.get(name, name)
            continue
        if code == ca.OP_CONST:
            text[k] = real.constant(function.instruction_constant(k))
            continue
        text[k] = _choice(code, sources, made, text) or operation(code, [text[j] for j in sources], real)
        if code in _CONDITIONS:
            continue
        if uses.get(k, 0) > 1 or (code in (ca.OP_SQ, ca.OP_SIGN) and "(" in text[sources[0]]):
            name = f"{step.name}_t{len(before)}"
            before.append(f"const {real.name} {name} = {_bare(text[k])};")
            text[k] = name
    return before, _bare(result)


def _choice(
    code: int, sources: list[int], made: Mapping[int, tuple[int, list[int]]], text: Mapping[int, str]
) -> str:
    """`(c ? a : b)` for CasADi's (c ? a : 0) + (!c ? b : 0), else nothing."""
    if code != ca.OP_ADD or any(made[j][0] != ca.OP_IF_ELSE_ZERO for j in sources):
        return ""
    (yes, a), (no, b) = (made[j][1] for j in sources)
    if made[no][0] != ca.OP_NOT or made[no][1] != [yes]:
        return ""
    return f"({text[yes]} ? {text[a]} : {text[b]})"


def codes(steps: Sequence[Step]) -> set[int]:
    """Return the operations that steps hold."""
    found: set[int] = set()
    for step in steps:
        f = ca.Function("step", ca.symvar(step.expression), [ca.densify(step.expression)])
        found |= {f.instruction_id(k) for k in range(f.n_instructions())}
    return found


def straight(steps: Sequence[Step]) -> bool:
    """Whether steps hold arithmetic only: no magnitude, comparison or choice."""
    return not codes(steps) & {*_CONDITIONS, *_CALLS, ca.OP_FABS, ca.OP_SIGN, ca.OP_IF_ELSE_ZERO}


def operation(code: int, a: Sequence[str], real: Real) -> str:
    """Return the C text of one operation, in parentheses where it needs them."""
    if code in _SIGNS:
        return f"({a[0]} {_SIGNS[code]} {a[1]})"
    if code in _CALLS:
        return f"{_CALLS[code]}({_bare(a[0])}, {_bare(a[1])})"
    if code in _TESTS:
        return f"({a[0]} {_TESTS[code]} {a[1]})"
    if code == ca.OP_NOT:
        return f"(!{a[0]})"
    if code == ca.OP_IF_ELSE_ZERO:
        return f"({a[0]} ? {a[1]} : {real.constant(0.0)})"
    if code == ca.OP_SIGN:
        none, one = real.constant(0.0), real.constant(1.0)
        return f"(({a[0]} > {none}) ? {one} : (({a[0]} < {none}) ? -{one} : {none}))"
    if code == ca.OP_FABS:
        return f"{'fabsf' if real.size == 4 else 'fabs'}({_bare(a[0])})"
    if code == ca.OP_SQ:
        return f"({a[0]} * {a[0]})"
    if code == ca.OP_TWICE:
        return f"({a[0]} + {a[0]})"
    if code == ca.OP_NEG:
        return f"(-{a[0]})"
    if code == ca.OP_INV:
        return f"({real.constant(1.0)} / {a[0]})"
    raise InputError(f"Operation {code} of the model has no C without libm; write it as a polynomial.")


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
