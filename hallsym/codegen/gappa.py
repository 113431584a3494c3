"""Gappa's script of the rounding error bound of each pose coordinate, inputs in the box."""

import casadi as ca

from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import Decoupler, Step
from hallsym.codegen.entries import short
from hallsym.codegen.float_c import DOUBLE, Real, statements
from hallsym.codegen.operations import graph
from hallsym.codegen.templates import MARK


def gappa(d: Decoupler, real: Real, found: Bounds) -> str:
    """Return the Gappa script: |computed - exact| of each pose coordinate, table rounding included."""
    kind = "ieee_32" if real.size == 4 else "ieee_64"
    lines = [f"@rnd = float<{kind}, ne>;", ""]
    for e in (*d.table, *d.zeros):
        lines.append(f"{_name(e.name)} = {_decimal(float(real.dtype(e.value)))};")
        lines.append(f"{_name(e.name)}_exact = {e.value:.12e};")
    lines.append("")
    inputs = {d.symbols[c].name(): _name(short(c)) for c in d.inputs}
    lines += [f"{name} = rnd({name}_in);" for name in inputs.values()]
    for exact in (False, True):
        names = dict(inputs)
        tail = "_exact" if exact else ""
        names |= {e.name: f"{_name(e.name)}{tail}" for e in (*d.table, *d.zeros)}
        for step in d.steps:
            if real.fused:
                text = _fused_text(step.expression, names, "" if exact else "rnd")
                lines.append(f"{_name(step.name)}{tail} = {text};")
            else:
                text = _gappa_text(step.expression, names)
                lines.append(f"{_name(step.name)}{tail} {'' if exact else 'rnd'}= {text};")
            names[step.name] = f"{_name(step.name)}{tail}"
    lines.append("")
    hypotheses = []
    for c in d.inputs:
        low, high = (float(real.dtype(v)) for v in d.ends(c))
        hypotheses.append(f"{_name(short(c))}_in in [{_decimal(low)}, {_decimal(high)}]")
    goals = [
        f"|{_name(short(c))} - {_name(short(c))}_exact| <= {_decimal(float(f'{found.error[c]:.3e}') * 1.05)}"
        for c in d.pose
    ]
    lines.append("{ " + "\n  /\\ ".join(hypotheses) + "\n  -> " + "\n  /\\ ".join(goals) + " }")
    return "\n".join([f"# {MARK}: rounding bound for Gappa.", *lines, ""])


def _name(name: str) -> str:
    return f"v_{name}"


def _decimal(value: float) -> str:
    return f"{value:.20e}"


def _gappa_text(expression: ca.SX, names: dict[str, str]) -> str:
    (line,) = statements([Step("g", expression)], names, DOUBLE, {"g": "g"})
    return line.removeprefix("g = ").removesuffix(";")


TEXTS = {
    "add": "{rnd}({0} + {1})", "sub": "{rnd}({0} - {1})", "mul": "{rnd}({0} * {1})", "sq": "{rnd}({0} * {0})",
    "div": "{rnd}({0} / {1})", "inv": "{rnd}(1 / {0})", "twice": "({0} + {0})", "neg": "(-{0})",
    "fma": "{rnd}({0} * {1} + {2})", "fms": "{rnd}({0} * {1} - {2})", "fnma": "{rnd}({2} - {0} * {1})",
}  # fmt: skip
"""Each rounding by name: Gappa's `rnd=` rounds every operation of a line, and a fused one rounds once."""


def _fused_text(expression: ca.SX, names: dict[str, str], rnd: str) -> str:
    """Return the text with roundings, or without any, in the same order: so Gappa matches the two."""
    found = graph([expression], fused=True)
    text: list[str] = []
    for o in found.operations:
        if o.op == "input":
            text.append(names.get(o.symbol, o.symbol))
        elif o.op == "const":
            text.append(f"({DOUBLE.constant(o.value)})")
        else:
            text.append(TEXTS[o.op].format(*(text[k] for k in o.args), rnd=rnd))
    return text[found.results[0]]
