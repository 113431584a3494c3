"""include/decoupler.h and the table as C."""

import textwrap

from hallsym.codegen.bounds import LEAST_GAIN
from hallsym.codegen.entries import short, unit
from hallsym.codegen.parts import Decoupler, flag_bit
from hallsym.codegen.source import BANNER, Source, bit, lines, numbers
from hallsym.codegen.table import VERSION


def header(source: Source) -> str:
    """Return the interface."""
    d, t = source.d, source.real.name
    bits = [
        f"#define {bit(c)} 0x{1 << k:08X}UL /**< {c} outside its range, or not finite */"
        for k, c in enumerate(d.inputs)
    ]
    flags = [
        f"#define DECOUPLER_{f.name} 0x{flag_bit(k):08X}UL /**< {f.meaning} */" for k, f in enumerate(d.flags)
    ]
    units = {what: ", ".join(dict.fromkeys(map(unit, columns))) for what, columns in _groups(d).items()}
    state = f" and state [{units['state']}]" if d.model.state else ""
    known = ", ".join(dict.fromkeys(f"{d.known(c):.6g} {unit(c)}" for c in d.pose))
    table = [f"    {t} {e.name}; /**< [{e.unit}] {e.meaning} */" for e in (*d.table, *d.limits)]
    table += [
        f"    {'int16_t' if a.integers else t} {a.name}[{len(a.values)}]; /**< [{a.unit}] {a.meaning} */"
        for a in d.arrays
    ]
    table += [f"    {t} {e.name}; /**< [{e.unit}] {e.meaning} */" for e in d.zeros]
    pad = ["    uint32_t reserved; /**< 0 */"] if source.real.size == 8 else []
    columns = {c: ("reading" if c in d.model.channels else "measured state") for c in d.inputs}
    jacobian = [
        f"    {t} {short(c)}_{short(m)}; /**< [{unit(c)}/{unit(m)}] d {c} / d {m} */"
        for c in d.pose
        for m in d.model.channels
    ]
    return lines(
        BANNER.rstrip(),
        "/**",
        " * @file decoupler.h",
        f" * @brief From the readings of {len(d.model.channels)} probes to the pose of the {d.model.family}: "
        f"model {d.model.name}.",
        " *",
        f" * Units are SI: {units['all'].replace(', ', ' and ')}. No heap, no libm, no static data; reentrant.",
        *[f" * {line}" for text in d.said for line in textwrap.wrap(text, 110)],
        " */",
        "#ifndef DECOUPLER_H",
        "#define DECOUPLER_H",
        "",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        f"#define DECOUPLER_VERSION {VERSION}UL /**< of interface and table */",
        f"#define DECOUPLER_LAYOUT 0x{source.table.layout:08X}UL /**< of the table this code reads */",
        "",
        "/** @name Status of decoupler_step(): 0, or the inputs that were brought back into their range */",
        "/** @{ */",
        *bits,
        *flags,
        f"#define DECOUPLER_POSE 0x80000000UL /**< decoupler_zero(): known pose not within {known} */",
        "/** @} */",
        "",
        "/** @name Findings of decoupler_check(): 0, or what is wrong with a table */",
        "/** @{ */",
        "#define DECOUPLER_BAD_VERSION 0x01UL /**< made for another interface */",
        "#define DECOUPLER_BAD_LAYOUT 0x02UL /**< made for other code */",
        "#define DECOUPLER_BAD_CRC 0x04UL /**< coefficients or limits have changed */",
        "#define DECOUPLER_BAD_NUMBER 0x08UL /**< an entry is not finite */",
        "#define DECOUPLER_BAD_LIMITS 0x10UL /**< a range is empty */",
        f"#define DECOUPLER_BAD_GAIN 0x20UL /**< a gain falls below {LEAST_GAIN:g} of itself within the limits */",
        "/** @} */",
        "",
        "/** Parameter table: constant, in flash; a copy in RAM where decoupler_zero() is used. */",
        "typedef struct",
        "{",
        "    uint32_t version; /**< DECOUPLER_VERSION */",
        "    uint32_t layout; /**< DECOUPLER_LAYOUT */",
        "    uint32_t crc; /**< CRC-32 of coefficients and limits */",
        *pad,
        *table,
        "} decoupler_params_t;",
        "",
        "/** Input of one sample. */",
        "typedef struct",
        "{",
        *[f"    {t} {c}; /**< [{unit(c)}] {what} */" for c, what in columns.items()],
        "} decoupler_in_t;",
        "",
        "/** Decoupled pose. */",
        "typedef struct",
        "{",
        *[f"    {t} {c}; /**< [{unit(c)}] */" for c in d.pose],
        "} decoupler_out_t;",
        *(
            [
                "",
                "/** Slopes of the pose by the readings. */",
                "typedef struct",
                "{",
                *jacobian,
                "} decoupler_jacobian_t;",
            ]
            if source.jacobian
            else []
        ),
        "",
        "/**",
        " * Decouple one sample.",
        " * @param p table that decoupler_check() found nothing wrong with",
        f" * @param in readings [{units['readings']}]{state}",
        f" * @param out pose [{units['pose']}]: always finite; inputs outside their range are brought back to its end",
        " * @return 0 if every input is finite and within its range, else the bits of those that are not",
        *([f" *         (and {', '.join(f'DECOUPLER_{f.name}' for f in d.flags)})"] if d.flags else []),
        " */",
        "uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out);",
        *(
            [
                "",
                "/**",
                " * Slopes of the pose at one sample, for a Kalman filter: as decoupler_step().",
                " * @param slopes d pose / d reading [m/m, rad/m]",
                " */",
                "uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,",
                "                            decoupler_jacobian_t *slopes);",
            ]
            if source.jacobian
            else []
        ),
        "",
        "/**",
        " * Take the zero at a known pose, after a reset: later poses are counted from it.",
        " * @param p table in RAM; only its zeros change, and only if the result is 0",
        " * @param in sample taken at the known pose",
        f" * @param pose where the machine is [{units['pose']}]; within {known}",
        " * @return as decoupler_step(), or DECOUPLER_POSE",
        " */",
        "uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose);",
        "",
        "/** Check a table when it is loaded: 0, or DECOUPLER_BAD_* bits. */",
        "uint32_t decoupler_check(const decoupler_params_t *p);",
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif /* DECOUPLER_H */",
    )


def _groups(d: Decoupler) -> dict[str, tuple[str, ...]]:
    """Columns whose units the text names together."""
    return {
        "all": (*d.inputs, *d.pose), "readings": d.model.channels, "state": d.model.state, "pose": d.pose,
    }  # fmt: skip


def params_header(source: Source) -> str:
    """Return the declaration of the table."""
    return lines(
        BANNER.rstrip(),
        "#ifndef DECOUPLER_PARAMS_H",
        "#define DECOUPLER_PARAMS_H",
        "",
        '#include "decoupler.h"',
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        "/** SHA-256 of the calibration that the table was made from. */",
        f'#define DECOUPLER_PARAMS_SHA256 "{source.table.source["calibration_sha256"]}"',
        "",
        "extern const decoupler_params_t decoupler_params; /**< the fitted machine */",
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif /* DECOUPLER_PARAMS_H */",
    )


def params(source: Source) -> str:
    """Return the table."""
    real, d = source.real, source.d
    head = [("version", f"{VERSION}UL"), ("layout", f"0x{source.table.layout:08X}UL")]
    head += [("crc", f"0x{source.table.crc:08X}UL")]
    head += [("reserved", "0UL")] if real.size == 8 else []
    rows = [f"    .{name} = {value}," for name, value in head]
    rows += [f"    .{e.name} = {real.constant(e.value)}, /* [{e.unit}] */" for e in (*d.table, *d.limits)]
    for a in d.arrays:
        text = ", ".join(f"{int(v)}" if a.integers else real.constant(v) for v in a.values)
        rows += [f"    .{a.name} = {{ /* [{a.unit}] */", *numbers(text), "    },"]
    rows += [f"    .{e.name} = {real.constant(e.value)}, /* [{e.unit}] */" for e in d.zeros]
    return lines(
        BANNER.rstrip(),
        f"/* Calibration {source.table.source['calibration_sha256']} */",
        '#include "decoupler_params.h"',
        "",
        "const decoupler_params_t decoupler_params = {",
        *rows,
        "};",
    )
