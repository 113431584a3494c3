"""CasADi expressions as C statements: +, -, *, /, magnitude, comparison, choice; nothing that needs libm."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Bits, Lookup, Step, Whole
from hallsym.codegen.operations import TESTS, chosen
from hallsym.errors import InputError
from hallsym.output import commented


@dataclass(frozen=True)
class Real:
    """A C type of real numbers: its name, the suffix of its constants, digits of its significand, bytes.

    `fabs`: the compiler's own function of a magnitude; `most`: the largest number; `word`, `size_mask`,
    `sign_mask`: the bits of a number, of its size and its sign; `cast`: of NAN and INFINITY, which are float;
    `fpu`: options of a compiler for a Cortex-M4F, which has no double.
    """

    name: str
    suffix: str
    digits: int
    dtype: type
    size: int
    fabs: str
    most: str
    word: str
    size_mask: str
    sign_mask: str
    cast: str
    fpu: str

    def constant(self, value: float) -> str:
        """Return a literal that is read back as the same number."""
        text = f"{float(self.dtype(value)):.{9 if self.digits == 24 else 17}g}"
        if "." not in text and "e" not in text:
            text += ".0"
        return text + self.suffix


FLOAT = Real(
    "float", "f", 24, np.float32, 4, "__builtin_fabsf", "FLT_MAX", "uint32_t", "0x7FFFFFFFUL", "0x80000000UL",
    "", "-mfloat-abi=hard -mfpu=fpv4-sp-d16",
)  # fmt: skip
DOUBLE = Real(
    "double", "", 53, np.float64, 8, "__builtin_fabs", "DBL_MAX", "uint64_t", "0x7FFFFFFFFFFFFFFFULL",
    "0x8000000000000000ULL", "(double)", "-mfloat-abi=soft",
)  # fmt: skip


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
        lines += [f"/* {commented(step.remark)} */"] if step.remark else []
        if isinstance(step, Whole | Bits):
            source = step.expression.name()
            left, text = f"const uint32_t {step.name}", f"(uint32_t){source}"
            if isinstance(step, Bits):
                cut = f"& 0x{(1 << step.first) - 1:X}U" if step.below else f">> {step.first}U"
                text = f"{source} {cut}"
            names[step.name] = f"({real.name}){step.name}"
        elif isinstance(step, Lookup):  # p->name[cell & 63U]: an index within the array whatever the cell
            cell, size = step.expression.name(), len(step.array.values)
            place = f"({cell} + {step.ahead % size}U)" if step.ahead else cell
            text = f"p->{step.array.name}[{place} & {size - 1}U]"
            text = f"({real.name}){text}" if step.array.integers else text
        lines.append(f"{left} = {text};")
    return lines


def _text(step: Step, names: Mapping[str, str], real: Real) -> tuple[list[str], str]:
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
            text.append(real.constant(o.value))
            continue
        choice = chosen(o, operations)
        parts = [text[j] for j in choice or o.args]
        text.append("({} ? {} : {})".format(*parts) if choice else _operation(o.op, parts, real))
        if o.op in (*TESTS, "not"):
            continue
        if uses[k] > 1 or (o.op in ("sq", "sign") and "(" in text[o.args[0]]):
            name = f"{step.name}_t{len(before)}"
            before.append(f"const {real.name} {name} = {_bare(text[k])};")
            text[k] = name
    return before, _bare(text[found.results[0]])


_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<="}


def _operation(op: str, a: Sequence[str], real: Real) -> str:
    """Return the C text of one operation, in parentheses where it needs them."""
    if op in _SIGNS:
        return f"({a[0]} {_SIGNS[op]} {a[1]})"
    none, one = real.constant(0.0), real.constant(1.0)
    texts = {
        "not": "(!{0})",
        "neg": "(-{0})",
        "sq": "({0} * {0})",
        "twice": "({0} + {0})",
        "inv": f"({one} / {{0}})",
        "sign": f"(({{0}} > {none}) ? {one} : (({{0}} < {none}) ? -{one} : {none}))",
        "if_else_zero": f"({{0}} ? {{1}} : {none})",
        "fabs": f"MAGNITUDE({_bare(a[0])})",
    }
    if op not in texts:
        raise InputError(f"Operation {op} of the model has no C without libm; write it as a polynomial.")
    return texts[op].format(*a)


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
