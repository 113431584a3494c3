"""Proof obligations of a generated folder, for the tools that can discharge them.

- `exhaustive.c` needs a compiler only: every bit pattern of every input through the range test, which is all that
  stands between an input and the arithmetic. With the interval bounds of the arithmetic over the box
  (`hallsym.codegen.bounds`) it shows that outputs are finite and bounded and that status is 0 iff inputs are in
  the box.
- `eva.c` is for Frama-C EVA: no run-time error and the stated range of the outputs, inputs in the box.
- `cbmc.c` is for CBMC: the same statement about decoupler_step() itself, for any bits.
- `rounding.g` is for Gappa: the rounding bound of each pose coordinate, inputs in the box.
"""

import casadi as ca
import numpy as np

from hallsym.codegen.bounds import Bounds
from hallsym.codegen.entries import short
from hallsym.codegen.parts import Step, flag_bit
from hallsym.codegen.printer import DOUBLE, statements
from hallsym.codegen.source import BANNER, Source, bit, ends


def _outward(value: float, source: Source) -> str:
    """A literal a little beyond a bound."""
    return source.real.constant(float(np.float32(value * 1.0001)) + (1e-12 if value > 0 else -1e-12))


def exhaustive(source: Source) -> str:
    """Return the program that tries every bit pattern of every input (float only)."""
    d, t = source.d, source.real.name
    tests = []
    for c in d.inputs:
        low, high = (text.replace("p->", "decoupler_params.") for text in ends(d, c))
        tests.append(
            f"    bad += all_within({high});"
            if source.by_size(c)
            else f"    bad += all_limited({low}, {high});"
        )
    both = []
    if any(source.by_size(c) for c in d.inputs):
        both.append(_every(t, "within", f"{t} high", f"{t} low = -high;", "high, 1U, &status"))
    if not all(source.by_size(c) for c in d.inputs):
        both.append(_every(t, "limited", f"{t} low, {t} high", "", "low, high, 1U, &status"))
    return f"""{BANNER}/* Every bit pattern of every input through the range test: the result lies in the range, is the input itself
   where that does, and the status bit says which. */
#include <stdio.h>
#include <string.h>

#include "../src/decoupler.c"
#include "decoupler_params.h"

{chr(10).join(both)}
int main(void)
{{
    unsigned long bad = 0UL;
{chr(10).join(tests)}
    (void)printf("exhaustive: %lu of {len(d.inputs)} x 2^32 bit patterns fail\\n", bad);
    return (bad == 0UL) ? 0 : 1;
}}
"""


def _every(t: str, by: str, parameters: str, declared: str, arguments: str) -> str:
    extra = f"    const {declared}\n" if declared else ""
    return f"""static unsigned long all_{by}({parameters})
{{
{extra}    unsigned long bad = 0UL;
    uint32_t bits = 0U;
    do
    {{
        {t} value;
        uint32_t status = 0U;
        (void)memcpy(&value, &bits, sizeof(value));
        const {t} held = {by}(value, {arguments});
        const uint32_t inside = ((value >= low) && (value <= high)) ? 1U : 0U;
        const uint32_t good = ((held >= low) && (held <= high)) ? 1U : 0U;
        const uint32_t same = ((inside == 0U) || (held == value)) ? 1U : 0U;
        bad += ((good & same & (status ^ inside)) == 1U) ? 0UL : 1UL;
        bits++;
    }} while (bits != 0U);
    return bad;
}}
"""


def eva(source: Source, found: Bounds) -> str:
    """Return the driver for Frama-C EVA."""
    d, real = source.d, source.real
    interval = "Frama_C_float_interval" if real.size == 4 else "Frama_C_double_interval"
    given = []
    for c in d.inputs:
        low, high = (text.replace("p->", "decoupler_params.") for text in ends(d, c))
        given.append(f"    in.{c} = {interval}({low}, {high});")
    said = [
        f"    //@ assert {short(c)}_bounded: {_outward(found.low[c], source)} <= out.{c} <= "
        f"{_outward(found.high[c], source)};"
        for c in d.pose
    ]
    flags = sum(flag_bit(k) for k in range(len(d.flags)))
    weak = f"status == 0 || status == 0x{flags:08X}" if d.flags else "status == 0"
    slopes = ""
    if source.jacobian:
        slopes = """
    decoupler_jacobian_t slopes;
    const uint32_t slope_status = decoupler_jacobian(&decoupler_params, &in, &slopes);
    //@ assert slope_status_zero: slope_status == 0;"""
    return f"""{BANNER}/* Frama-C EVA: every input in the box. No alarm means no run-time error, no NaN, no infinity. */
#include "__fc_builtin.h"

#include "decoupler.h"
#include "decoupler_params.h"

int main(void)
{{
    decoupler_in_t in;
    decoupler_out_t out;
{chr(10).join(given)}
    const uint32_t status = decoupler_step(&decoupler_params, &in, &out);
    //@ assert status_zero: {weak};
{chr(10).join(said)}{slopes}
    return (int)status;
}}
"""


def cbmc(source: Source, found: Bounds) -> str:
    """Return the harness for CBMC: any bits of any input."""
    d, t = source.d, source.real.name
    flags = f" & ~({' | '.join(f'DECOUPLER_{f.name}' for f in d.flags)})" if d.flags else ""
    given = "\n".join(f"    in.{c} = nondet_{t}();" for c in d.inputs)
    inside = []
    for c in d.inputs:
        low, high = (text.replace("p->", "decoupler_params.") for text in ends(d, c))
        inside.append(f"    wanted |= ((in.{c} >= {low}) && (in.{c} <= {high})) ? 0U : {bit(c)};")
    said = "\n".join(
        f"    __CPROVER_assert((out.{c} >= {_outward(found.low[c], source)}) && "
        f'(out.{c} <= {_outward(found.high[c], source)}), "{c} bounded");'
        for c in d.pose
    )
    return f"""{BANNER}/* CBMC: for every bit pattern of every input, NaN and infinity included. */
#include "decoupler.h"
#include "decoupler_params.h"

{t} nondet_{t}(void);

int main(void)
{{
    decoupler_in_t in;
    decoupler_out_t out;
    uint32_t wanted = 0U;
{given}
    const uint32_t status = decoupler_step(&decoupler_params, &in, &out){flags};
{chr(10).join(inside)}
    __CPROVER_assert(status == wanted, "status is 0 iff every input is in the box");
{said}
    return 0;
}}
"""


def gappa(source: Source, found: Bounds) -> str:
    """Return the Gappa script: |computed - exact| of each pose coordinate, table rounding included."""
    d, real = source.d, source.real
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
            lines.append(
                f"{_name(step.name)}{tail} {'' if exact else 'rnd'}= {_gappa_text(step.expression, names)};"
            )
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
    return "\n".join(["# Generated by hallsym codegen: rounding bound for Gappa.", *lines, ""])


def _name(name: str) -> str:
    return f"v_{name}"


def _decimal(value: float) -> str:
    return f"{value:.20e}"


def _gappa_text(expression: ca.SX, names: dict[str, str]) -> str:
    (line,) = statements([Step("g", expression)], names, DOUBLE, {"g": "g"})
    return line.removeprefix("g = ").removesuffix(";")
