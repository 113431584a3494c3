"""C of the self-test and of what runs it on a host and in QEMU."""

import casadi as ca
import numpy as np

from hallsym.codegen.bounds import slope_errors
from hallsym.codegen.source import BANNER, Source, ends
from hallsym.codegen.vectors import Emulator, Vectors, vectors
from hallsym.model.arrays import on_arrays

HASHED = (4096, 1_000_000)
"""Samples in the hash of the self-test, and in the long one."""
REFERENCE = 1e-15
"""Rounding [m, rad] of the reference itself, as it is computed in double and written with 13 digits."""


def selftest(source: Source) -> str:
    """Return the self-test; its numbers are in selftest_vectors.h."""
    d, real = source.d, source.real
    t = real.name
    sampled = []
    for k, c in enumerate(d.inputs):
        low, high = (text.replace("p->", "decoupler_params.") for text in ends(d, c))
        sampled.append(f"    in->{c} = input(n, {k + 1}U, {low}, {high});")
    words = "\n".join(
        f"        total += mix(word(out.{c}) ^ mix((n * {len(d.pose) + 1}U) + {k + 1}U));"
        for k, c in enumerate(d.pose)
    )
    compare = "\n".join(
        f"        failed |= differs(out.{c}, wanted->pose[{k}], decoupler_bounds[{k}], &result.worst);"
        for k, c in enumerate(d.pose)
    )
    declared, width = "", ""
    if source.jacobian:
        width = f"\n    double slopes[{len(d.slopes)}];"
        declared = (
            "\n        double slope_worst = 0.0;\n        decoupler_jacobian_t slopes;\n"
            "        const uint32_t status = decoupler_jacobian(&decoupler_params, &wanted->in, &slopes);"
        )
        compare += "\n        failed |= (status == wanted->status) ? 0U : 1U;\n" + "\n".join(
            f"        failed |= differs(slopes.{name}, wanted->slopes[{k}], decoupler_slope_bounds[{k}], &slope_worst);"
            for k, name in enumerate(d.slopes)
        )
    if real.size == 4:
        wild = "        (void)memcpy(&value, &raw, sizeof(value));"
        word = """\
    uint32_t bits = 0U;
    (void)memcpy(&bits, &value, sizeof(bits));
    return bits;"""
    else:
        wild = """\
        const uint64_t bits = ((uint64_t)raw << 32U) | (uint64_t)mix(raw);
        (void)memcpy(&value, &bits, sizeof(value));"""
        word = """\
    uint64_t bits = 0U;
    (void)memcpy(&bits, &value, sizeof(bits));
    return (uint32_t)(bits >> 32U) ^ mix((uint32_t)bits);"""
    scale, four = real.constant(2.0**-24), real.constant(4.0)
    return f"""{BANNER}#include "selftest.h"

#include <string.h>

#include "decoupler.h"
#include "decoupler_params.h"

typedef struct
{{
    decoupler_in_t in;
    double pose[{len(d.pose)}];{width}
    uint32_t status;
}} vector_t;

#include "selftest_vectors.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

static uint32_t mix(uint32_t x)
{{
    x ^= x >> 16U;
    x *= 0x7FEB352DUL;
    x ^= x >> 15U;
    x *= 0x846CA68BUL;
    return x ^ (x >> 16U);
}}

static uint32_t word({t} value)
{{
{word}
}}

/* Most samples lie in the box; every 16th has any bits at all, every 16th is four times too large. */
static {t} input(uint32_t n, uint32_t k, {t} low, {t} high)
{{
    const uint32_t raw = mix((n * {len(d.inputs)}U) + k);
    const uint32_t kind = mix(n ^ 0x9E3779B9UL) & 15U;
    const {t} share = ({t})(raw >> 8U) * {scale};
    const {t} part = (high - low) * share;
    {t} value = low + part;
    if (kind == 0U)
    {{
{wild}
    }}
    else if (kind == 1U)
    {{
        value *= {four};
    }}
    else
    {{
        /* in the box */
    }}
    return value;
}}

static void sample(uint32_t n, decoupler_in_t *in)
{{
{chr(10).join(sampled)}
}}

uint32_t decoupler_hash(uint32_t count)
{{
    uint32_t total = 0U;
    for (uint32_t n = 0U; n < count; n++)
    {{
        decoupler_in_t in;
        decoupler_out_t out;
        sample(n, &in);
        total += mix(decoupler_step(&decoupler_params, &in, &out) ^ mix(n * {len(d.pose) + 1}U));
{words}
    }}
    return total;
}}

static uint32_t differs({t} value, double wanted, double bound, double *worst)
{{
    const double error = ((double)value > wanted) ? ((double)value - wanted) : (wanted - (double)value);
    if (error > *worst)
    {{
        *worst = error;
    }}
    return (error <= bound) ? 0U : 1U;
}}

decoupler_selftest_t decoupler_selftest(void)
{{
    decoupler_selftest_t result = {{0U, 0U, 0.0}};
    for (uint32_t k = 0U; k < DECOUPLER_VECTORS; k++)
    {{
        const vector_t *wanted = &decoupler_vectors[k];
        decoupler_out_t out;{declared}
        uint32_t failed = (decoupler_step(&decoupler_params, &wanted->in, &out) == wanted->status) ? 0U : 1U;
{compare}
        result.vectors++;
        result.failures += failed;
    }}
    return result;
}}
"""


def selftest_vectors(source: Source, bound: dict[str, float]) -> str:
    """Return vectors, bounds and hashes of one table."""
    d, real = source.d, source.real
    found = vectors(d, real)
    emulator = Emulator(d, real)
    rows = []
    slopes, slope_bounds = _slopes(source, found) if source.jacobian else (found.pose, [])
    for k in range(found.inputs.shape[1]):
        inputs = ", ".join(_literal(float(v), source) for v in found.inputs[:, k])
        pose = ", ".join(f"{v:.12e}" for v in found.pose[:, k])
        slope = f"{{{', '.join(f'{v:.12e}' for v in slopes[:, k])}}}, " if source.jacobian else ""
        rows.append(f"    {{{{{inputs}}}, {{{pose}}}, {slope}0x{int(found.status[k]):X}UL}},")
    digest = {n: emulator.hash(n) for n in HASHED}
    limits = ", ".join(f"{bound[c] + d.slack + REFERENCE:.3e}" for c in d.pose)
    return "\n".join(
        [
            BANNER.rstrip(),
            "/* Inputs, the pose that the model gives in double, status. Bounds of the error; hashes. */",
            "#include <math.h>",
            "",
            f"#define DECOUPLER_VECTORS {found.inputs.shape[1]}U",
            "",
            f"static const double decoupler_bounds[{len(d.pose)}] = {{{limits}}};",
            *slope_bounds,
            f"const uint32_t decoupler_hash_short = 0x{digest[HASHED[0]]:08X}UL;",
            f"const uint32_t decoupler_hash_long = 0x{digest[HASHED[1]]:08X}UL;",
            "",
            "static const vector_t decoupler_vectors[DECOUPLER_VECTORS] = {",
            *rows,
            "};",
            "",
        ]
    )


def _slopes(source: Source, found: Vectors) -> tuple[np.ndarray, list[str]]:
    """Return the slopes (n_slopes, s) of the vectors in double, and the line of their bounds."""
    d = source.d
    given = [ca.vertcat(*(d.symbols[n] for n in d.inputs))]
    given.append(ca.vertcat(*(d.symbols[e.name] for e in (*d.table, *d.zeros))))
    run = on_arrays(ca.Function("slopes", given, [ca.vertcat(*d.slopes.values())]))
    slopes = run(list(found.held), d.constants)[0]
    errors = slope_errors(d, source.real.digits)
    # the reference is computed in double and written with 13 digits
    limits = [error + 1e-12 * np.abs(row).max() for error, row in zip(errors.values(), slopes, strict=True)]
    listed = ", ".join(f"{limit:.3e}" for limit in limits)
    return slopes, [f"static const double decoupler_slope_bounds[{len(limits)}] = {{{listed}}};"]


def _literal(value: float, source: Source) -> str:
    cast = "" if source.real.size == 4 else "(double)"  # math.h has them as float
    if np.isnan(value):
        return f"{cast}NAN"
    if np.isinf(value):
        return f"{'' if value > 0 else '-'}{cast}INFINITY"
    return source.real.constant(value)


def main(source: Source) -> str:
    """Return the program that runs the self-test and says what it found."""
    d = source.d
    t, c = source.real.name, source.real.constant
    rest = [c(value) for value in d.rest] or ["at_rest"] * len(d.inputs)
    fields = "\n".join(f"    in.{column} = {value};" for column, value in zip(d.inputs, rest, strict=True))
    at_rest = "" if d.rest else f"\n    const {t} at_rest = {c(2.0**-14)};"
    too_far = c(2.0 * d.known(d.pose[0]))
    known = "\n".join(f"    pose.{column} = at_known;" for column in d.pose)
    back = " || ".join(f"(near(out.{column}, at_known) == 0)" for column in d.pose)
    return f"""{BANNER}/* Exit status 0 if all is well. On a target, semihosting prints. */
#include <stdio.h>

#include "decoupler.h"
#include "decoupler_params.h"
#include "selftest.h"

static int near({t} a, {t} b)
{{
    return ((a - b) < {c(1e-9)}) && ((b - a) < {c(1e-9)});
}}

static int zero_works(void)
{{{at_rest}
    const {t} at_known = {c(2.0**-12)};
    decoupler_params_t table = decoupler_params;
    decoupler_in_t in;
    decoupler_out_t pose;
    decoupler_out_t out;
    int good = 1;
{fields}
{known}
    if ((decoupler_zero(&table, &in, &pose) != 0U) || (decoupler_step(&table, &in, &out) != 0U) ||
        {back})
    {{
        good = 0;
    }}
    in.{d.inputs[0]} = {c(1e30)}; /* no zero is taken out of the box */
    if (decoupler_zero(&table, &in, &pose) == 0U)
    {{
        good = 0;
    }}
    in.{d.inputs[0]} = {rest[0]};
    if ((decoupler_step(&table, &in, &out) != 0U) || {back})
    {{
        good = 0;
    }}
    pose.{d.pose[0]} = {too_far};
    if (decoupler_zero(&table, &in, &pose) != DECOUPLER_POSE)
    {{
        good = 0;
    }}
    return good;
}}

int main(void)
{{
    const uint32_t check = decoupler_check(&decoupler_params);
    const decoupler_selftest_t found = decoupler_selftest();
    const int bits = (decoupler_hash(4096U) == decoupler_hash_short) ? 1 : 0;
    const uint32_t hash = decoupler_hash(1000000U);
    const int zero = zero_works();
    (void)printf("table %s, %u of %u vectors failed, worst error %u pm or prad\\n", (check == 0U) ? "good" : "bad",
                 (unsigned)found.failures, (unsigned)found.vectors, (unsigned)(found.worst * 1e12));
    (void)printf("bits of 4096 samples %s, of 1000000 samples %s (0x%08x), zero %s\\n", bits ? "as stated" : "differ",
                 (hash == decoupler_hash_long) ? "as stated" : "differ", (unsigned)hash, zero ? "works" : "fails");
    return ((check == 0U) && (found.failures == 0U) && bits && (hash == decoupler_hash_long) && zero) ? 0 : 1;
}}
"""
