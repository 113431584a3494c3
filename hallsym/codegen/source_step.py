"""src/decoupler.c: scaffolding as text, every line of mathematics printed from expressions."""

from collections.abc import Sequence

import casadi as ca

from hallsym.codegen.entries import short
from hallsym.codegen.parts import Step
from hallsym.codegen.printer import Real, codes, statements
from hallsym.codegen.source import BANNER, Source, function, lines, no_contraction


def step(source: Source) -> str:
    """Return the code of every sample."""
    d, real = source.d, source.real
    results = {s.name: f"out->{c}" for s, c in zip(d.steps[-len(d.pose) :], d.pose, strict=True)}
    body = [*source.saturated(d.folded), *statements(d.steps, source.names, real, results)]
    for flag in d.flags:
        body += [f"if (!({flag.step} >= p->{flag.least}))", "{", f"    status |= DECOUPLER_{flag.name};", "}"]
    body.append("return status;")
    parts = [
        function(
            "uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)",
            ["uint32_t status = 0U;", *body],
        ),
    ]
    if source.jacobian:
        parts.append(_slopes(source))
    parts.append(_zero(source))
    return lines(
        BANNER.rstrip(),
        '#include "decoupler.h"',
        "",
        "#include <math.h> /* fabs only, which is one instruction: nothing of libm is linked */",
        "",
        *no_contraction(),
        _LIKELY,
        function(
            f"static inline {real.name} limited({real.name} value, {real.name} low, {real.name} high, "
            "uint32_t bit, uint32_t *status)",
            [
                f"{real.name} result = value;",
                "if (UNLIKELY(!(value <= high))) /* NaN goes here too */",
                "{",
                "    result = high;",
                "    *status += bit; /* each bit once */",
                "}",
                "else if (UNLIKELY(value < low))",
                "{",
                "    result = low;",
                "    *status += bit; /* each bit once */",
                "}",
                "else",
                "{",
                "    /* within its range */",
                "}",
                "return result;",
            ],
        ),
        *([_within(source)] if any(source.by_size(c) for c in d.inputs) else []),
        *parts,
    )


def _within(source: Source) -> str:
    """The same for a symmetric range: quicker inside it, slower outside."""
    t, size = source.real.name, "fabsf" if source.real.size == 4 else "fabs"
    return function(
        f"static inline {t} within({t} value, {t} limit, uint32_t bit, uint32_t *status)",
        [
            f"{t} result = value;",
            f"if (UNLIKELY(!({size}(value) <= limit)))",
            "{",
            f"    result = (value < {source.real.constant(0.0)}) ? -limit : limit;",
            "    *status += bit;",
            "}",
            "return result;",
        ],
    )


def bare(source: Source) -> str:
    """Return the arithmetic alone, without limits and status, to count its instructions."""
    d, real = source.d, source.real
    results = {s.name: f"out->{c}" for s, c in zip(d.steps[-len(d.pose) :], d.pose, strict=True)}
    used = [c for c in d.inputs if ca.depends_on(d.folded, d.symbols[c])]
    loads = [f"const {real.name} {short(c)} = in->{c};" for c in used]
    signature = (
        "void decoupler_bare(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)"
    )
    prototype = signature.replace("void", "extern void") + ";"
    body = [*loads, *statements(d.steps, source.names, real, results)]
    body += [f"(void){flag.step};" for flag in d.flags]
    math = ["#include <math.h>", ""] if ca.OP_FABS in codes(d.steps) else []
    return lines(
        BANNER.rstrip(), '#include "decoupler.h"', "", *math, prototype, "", function(signature, body)
    )


def _slopes(source: Source) -> str:
    """The Jacobian by CasADi's own differentiation of the printed expressions."""
    d, real = source.d, source.real
    flat = ca.vertcat(*d.slopes.values())
    lines = graph(flat, source.names, real, [f"slopes->{n}" for n in d.slopes])
    return function(
        "uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,\n"
        "                            decoupler_jacobian_t *slopes)",
        ["uint32_t status = 0U;", *source.saturated(flat), *lines, "return status;"],
    )


def _zero(source: Source) -> str:
    d, real = source.d, source.real
    most = {c: real.constant(d.known(c)) for c in d.pose}
    tests = [f"(pose->{c} >= -{most[c]}) && (pose->{c} <= {most[c]})" for c in d.pose]
    test = "\n    && ".join(f"({x})" for x in tests)
    zeros = [f"p->{z.name}" for z in d.zeros]
    if not d.at_pose:
        before = [f"const {real.name} before_{short(c)} = {z};" for c, z in zip(d.pose, zeros, strict=True)]
        inner = [
            *before,
            "decoupler_out_t seen;",
            *[f"{z} = {real.constant(0.0)};" for z in zeros],
            "status = decoupler_step(p, in, &seen);",
            "if (status == 0U)",
            "{",
            *[f"    {z} = pose->{c} - seen.{c};" for c, z in zip(d.pose, zeros, strict=True)],
            "}",
            "else",
            "{",
            *[f"    {z} = before_{short(c)};" for c, z in zip(d.pose, zeros, strict=True)],
            "}",
        ]
    else:
        loads = [f"const {real.name} {short(c)} = pose->{c};" for c in d.pose]
        seen = [s.name for s in d.at_pose[-len(d.pose) :]]
        inner = [
            "status = 0U;",
            *source.saturated(),
            *loads,
            *statements(d.at_pose, source.names, real, {}),
            "if (status == 0U)",
            "{",
            *[f"    {z} = pose->{c} - {s};" for c, z, s in zip(d.pose, zeros, seen, strict=True)],
            "}",
        ]
    return function(
        "uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose)",
        [
            "uint32_t status = DECOUPLER_POSE;",
            f"if ({test})",
            "{",
            *[f"    {line}" for line in inner],
            "}",
            "return status;",
        ],
    )


_LIKELY = """\
#if defined(__GNUC__)
#define UNLIKELY(condition) (__builtin_expect((condition) ? 1 : 0, 0) != 0)
#else
#define UNLIKELY(condition) (condition)
#endif
"""


def graph(expression: ca.SX, names: dict[str, str], real: Real, results: Sequence[str]) -> list[str]:
    """Return statements of a vector whose rows share subexpressions: a value used twice becomes a constant."""
    (rest,), symbols, values = ca.shared([expression], "shared_", "")
    steps: list[Step] = []
    waiting = {s.name(): e for s, e in zip(symbols, values, strict=True)}
    needs = {n: {v.name() for v in ca.symvar(e)} & waiting.keys() for n, e in waiting.items()}
    while waiting:  # CasADi lists them in any order; C needs a value before its use
        ready = [n for n in waiting if not needs[n] & waiting.keys()]
        steps += [Step(name, waiting.pop(name)) for name in ready]
    steps += [Step(f"result_{k}", rest[k]) for k in range(rest.numel())]
    return statements(steps, names, real, {f"result_{k}": name for k, name in enumerate(results)})
