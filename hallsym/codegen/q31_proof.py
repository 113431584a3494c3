"""Proof obligations of an integer folder, for the tools that can discharge them.

- `exhaustive.c` needs a compiler only: every bit pattern of every input through the range test, and every
  divisor in its range through its reciprocal, with overflow trapped.
- `eva.c` is for Frama-C EVA: no overflow and the stated range of the outputs, inputs in the box; EVA cannot
  follow that b * (1 / b) is 1, so it takes each reciprocal within what `exhaustive.c` showed of it.
- `cbmc.c` is for CBMC: decoupler_step() itself, for any bits.
"""

from math import ceil, floor

from hallsym.codegen.entries import short
from hallsym.codegen.parts import flag_bit
from hallsym.codegen.q31_program import UPPER, Reciprocal
from hallsym.codegen.q31_source import IntegerSource
from hallsym.codegen.source import BANNER, bit, ends, function, lines


def _integers(r: Reciprocal) -> tuple[int, int, int, int]:
    """Return least and greatest integer of divisor and reciprocal."""
    b, least, most = r.b, r.r.low - r.r.error, r.r.high + r.r.error
    return (
        floor(b.low * 2.0**b.e),
        ceil(b.high * 2.0**b.e),
        floor(least * 2.0**r.r.e),
        ceil(most * 2.0**r.r.e),
    )


def exhaustive(source: IntegerSource) -> str:
    """Return the program that tries every input and every divisor."""
    p, d = source.program, source.program.d
    names = {n: f"decoupler_params.{n}" for n, _, _ in source.entries}
    text, calls = p.c(names), []
    functions = []
    for r in p.reciprocals:
        low, high, least, most = _integers(r)
        body = [
            *text[r.first : r.last],
            f"const double share = ((double){r.b.text} * {2.0**-r.b.e!r}) * ((double){r.r.text} * {2.0**-r.r.e!r});",
            f"const double off = ((share > 1.0) ? (share - 1.0) : (1.0 - share)) / ((double){r.b.text} * {2.0**-r.b.e!r});",
            "const double size = (off < 0.0) ? -off : off;",
            f"return ((size <= {float(r.r.error)!r}) && ({r.r.text} >= {least}) && ({r.r.text} <= {most})) ? 0UL : 1UL;",
        ]
        functions.append(function(f"static unsigned long wrong_{r.b.text}(int32_t {r.b.text})", body))
        calls.append(
            f"for (int32_t b = {low}; b <= {high}; b++) {{ bad += wrong_{r.b.text}(b); divisors++; }}"
        )
    if p.angles & set(d.inputs):
        return _every_angle(source)
    tests = []
    for c in d.inputs:
        low_text, high_text = (side.replace("p->", "decoupler_params.") for side in ends(d, c))
        tests.append(f"bad += all_limited({low_text}, {high_text});")
    return lines(
        BANNER.rstrip(),
        "/* Every bit pattern of every input through the range test; every divisor in its range through its",
        "   reciprocal, which is as near to 1 / divisor as stated. Compiled to stop where an integer overflows. */",
        "#include <stdio.h>",
        "",
        '#include "../src/decoupler.c"',
        '#include "decoupler_params.h"',
        "",
        *functions,
        function(
            "static unsigned long all_limited(int32_t low, int32_t high)",
            [
                "unsigned long bad = 0UL;",
                "uint32_t bits = 0U;",
                "do",
                "{",
                "    const int32_t value = (int32_t)bits;",
                "    uint32_t status = 0U;",
                "    const int32_t held = limited(value, low, high, 1U, &status);",
                "    const uint32_t inside = ((value >= low) && (value <= high)) ? 1U : 0U;",
                "    const uint32_t good = ((held >= low) && (held <= high)) ? 1U : 0U;",
                "    const uint32_t same = ((inside == 0U) || (held == value)) ? 1U : 0U;",
                "    bad += ((good & same & (status ^ inside)) == 1U) ? 0UL : 1UL;",
                "    bits++;",
                "} while (bits != 0U);",
                "return bad;",
            ],
        ),
        function(
            "int main(void)",
            [
                "unsigned long bad = 0UL;",
                "unsigned long divisors = 0UL;",
                *tests,
                *calls,
                f'(void)printf("exhaustive: %lu of {len(d.inputs)} x 2^32 bit patterns and %lu divisors fail\\n", bad, divisors);',
                "return (bad == 0UL) ? 0 : 1;",
            ],
        ),
    )


def eva(source: IntegerSource) -> str:
    """Return the driver for Frama-C EVA."""
    p, d = source.program, source.program.d
    if p.angles:
        return _eva_of_step(source)
    names = {n: f"decoupler_params.{n}" for n, _, _ in source.entries}
    text = p.c(names)
    for r in p.reciprocals:
        _, _, least, most = _integers(r)
        text[r.first : r.last] = [""] * (r.last - r.first)
        text[r.last - 1] = f"const int32_t {r.r.text} = Frama_C_interval({least}, {most});"
    body = []
    for c in d.inputs:
        low, high = (side.replace("p->", "decoupler_params.") for side in ends(d, c))
        body.append(f"const int32_t {short(c)} = Frama_C_interval({low}, {high});")
    body += [line for line in text if line]
    for c, (name, e) in p.outputs.items():
        from_value, to_value, error = p.bounds[c]
        room = ceil((to_value - from_value) * 2.0**e * 0.01) + 8  # EVA rounds each step outwards
        body.append(f"const int32_t out_{short(c)} = {name};")
        body.append(
            f"//@ assert {short(c)}_bounded: {floor((from_value - error) * 2.0**e) - room} <= out_{short(c)} <= "
            f"{ceil((to_value + error) * 2.0**e) + room};"
        )
    body.append("return 0;")
    return lines(
        BANNER.rstrip(),
        "/* Frama-C EVA: every input in the box, each reciprocal within its range (exhaustive.c). No alarm means",
        "   no overflow. */",
        '#include "__fc_builtin.h"',
        "",
        '#include "decoupler.h"',
        '#include "decoupler_params.h"',
        "",
        UPPER,
        function("int main(void)", body),
    )


def cbmc(source: IntegerSource) -> str:
    """Return the harness for CBMC: any bits of any input."""
    p, d = source.program, source.program.d
    body = ["decoupler_in_t in;", "decoupler_out_t out;", "uint32_t wanted = 0U;"]
    body += [f"in.{p.member(c)} = {'(uint32_t)' if c in p.angles else ''}nondet_int32();" for c in d.inputs]
    flags = f" & ~({' | '.join(f'DECOUPLER_{f.name}' for f in d.flags)})" if d.flags else ""
    body.append(f"const uint32_t status = decoupler_step(&decoupler_params, &in, &out){flags};")
    for c in source.limited:
        low, high = (side.replace("p->", "decoupler_params.") for side in ends(d, c))
        body.append(f"wanted |= ((in.{c} >= {low}) && (in.{c} <= {high})) ? 0U : {bit(c)};")
    body.append('__CPROVER_assert(status == wanted, "status is 0 iff every input is in the box");')
    for c, (_, e) in p.outputs.items() if not p.angles else ():
        low_value, high_value, error = p.bounds[c]
        least, most = floor((low_value - error) * 2.0**e), ceil((high_value + error) * 2.0**e)
        body.append(f'__CPROVER_assert((out.{c} >= {least}) && (out.{c} <= {most}), "{c} bounded");')
    body.append("return 0;")
    return lines(
        BANNER.rstrip(),
        "/* CBMC: for every bit pattern of every input. */",
        '#include "decoupler.h"',
        '#include "decoupler_params.h"',
        "",
        "int32_t nondet_int32(void);",
        "",
        function("int main(void)", body),
    )


def _every_angle(source: IntegerSource) -> str:
    """Every angle through decoupler_step(): the correction is no larger than an entry of the table."""
    p = source.program
    (read,), (pose,) = p.d.inputs, p.d.pose
    most = max((int(abs(a.values).max()) << a.shift for a in p.arrays.values()), default=0)
    shift = "decoupler_params.shift" if "shift" in p.unsigned else "0U"
    return lines(
        BANNER.rstrip(),
        "/* Every angle through decoupler_step(), compiled to stop where an integer overflows: the angle moves by no",
        "   more than the largest entry of the table. */",
        "#include <stdio.h>",
        "",
        '#include "../src/decoupler.c"',
        '#include "decoupler_params.h"',
        "",
        function(
            "int main(void)",
            [
                f"const int64_t most = {most};",
                "unsigned long bad = 0UL;",
                "decoupler_in_t in;",
                "decoupler_out_t out;",
                f"in.{p.member(read)} = 0U;",
                "do",
                "{",
                "    const uint32_t status = decoupler_step(&decoupler_params, &in, &out);",
                f"    const uint32_t moved = out.{p.member(pose)} - in.{p.member(read)} - {shift};",
                "    const int64_t by = (moved < 0x80000000U) ? (int64_t)moved : ((int64_t)moved - 4294967296);",
                "    bad += ((status == 0U) && (by <= most) && (by >= -most)) ? 0UL : 1UL;",
                f"    in.{p.member(read)}++;",
                f"}} while (in.{p.member(read)} != 0U);",
                '(void)printf("exhaustive: %lu of 2^32 angles fail\\n", bad);',
                "return (bad == 0UL) ? 0 : 1;",
            ],
        ),
    )


def _eva_of_step(source: IntegerSource) -> str:
    """decoupler_step() itself, which has no reciprocal that EVA could not follow."""
    p, d = source.program, source.program.d
    body = ["decoupler_in_t in;", "decoupler_out_t out;"]
    for c in d.inputs:
        if c in p.angles:
            body.append(f"in.{p.member(c)} = Frama_C_unsigned_int_interval(0U, 0xFFFFFFFFU);")
            continue
        low, high = (side.replace("p->", "decoupler_params.") for side in ends(d, c))
        body.append(f"in.{c} = Frama_C_interval({low}, {high});")
    body.append("const uint32_t status = decoupler_step(&decoupler_params, &in, &out);")
    flags = sum(flag_bit(k) for k in range(len(d.flags)))
    weak = f"status == 0 || status == 0x{flags:08X}" if d.flags else "status == 0"
    body += [f"//@ assert status_zero: {weak};", "return (int)(status & 1U);"]
    return lines(
        BANNER.rstrip(),
        "/* Frama-C EVA: every input in the box. No alarm means no overflow and no entry beyond the table. */",
        '#include "__fc_builtin.h"',
        "",
        '#include "../src/decoupler.c"',
        '#include "decoupler_params.h"',
        "",
        function("int main(void)", body),
    )
