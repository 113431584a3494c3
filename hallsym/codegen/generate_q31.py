"""From a calibration to the files of an integer decoupler, for a controller without a floating-point unit."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.codegen import q31_proof, q31_selftest
from hallsym.codegen.bounds import bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.checks import check, check_gains, check_same, digest_of, notes_of
from hallsym.codegen.entries import short, unit
from hallsym.codegen.families import OPTIONS, decoupler
from hallsym.codegen.folder import BINARY, replace_params, write_folder
from hallsym.codegen.generate import given, recorded
from hallsym.codegen.printer import FLOAT
from hallsym.codegen.project import MARK, template
from hallsym.codegen.q31 import program
from hallsym.codegen.q31_source import CPU, MACHINE, IntegerSource
from hallsym.codegen.source import BANNER, Source
from hallsym.codegen.source_header import params_header
from hallsym.codegen.table import Table
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit

REPLACED = (
    "params/",
    "test/selftest_vectors.h",
    "proof/exhaustive.c",
    "proof/eva.c",
    "proof/cbmc.c",
    "doc/report.md",
)


SHIFTS = "misra-c2012-10.1:src/decoupler.c\n"
TRIED, AS_PROVED = "range test, all bit patterns, and reciprocals, all divisors", ", reciprocals as proved"


@dataclass(frozen=True, eq=False)
class Integers:
    """What `generate_q31` made: files by path, largest errors met, notes."""

    source: IntegerSource
    files: Mapping[str, str | bytes]
    errors: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def params(self) -> dict[str, str | bytes]:
        """The files that a recalibration replaces."""
        return {name: content for name, content in self.files.items() if name.startswith(REPLACED)}

    def write(self, folder: str | Path, *, force: bool = False, params_only: bool = False) -> None:
        """Write the folder, or only its parameters. Raises `InputError` before anything is written."""
        if params_only:
            replace_params(Path(folder), self.params, self.source.layout)
        else:
            write_folder(Path(folder), self.files, force=force)

    def to_dict(self) -> dict[str, Any]:
        """Return the readable record."""
        p = self.source.program
        return {
            "model": p.d.model.name,
            "type": "q31",
            "layout": f"0x{self.source.layout:08x}",
            "table_bytes": len(self.source.binary),
            "calibration_sha256": self.source.source["calibration_sha256"],
            "box": {c: list(p.d.ends(c)) for c in p.d.inputs},
            "exponents": p.exponents,
            "error_bound": {c: error for c, (_, _, error) in p.bounds.items()},
            "error_met": dict(self.errors),
            "files": sorted(self.files),
            "notes": list(self.notes),
        }


def generate_q31(
    fit: Fit,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    accuracy: float | None = None,
    correction: str | None = None,
    allow_undetermined: bool = False,
    calibration_sha256: str | None = None,
) -> Integers:
    """Generate the integer decoupler of a calibration whose model is linear in the pose, or of an encoder.

    `ranges`: least and greatest value by column [SI] in place of what the log recorded. Encoders: `accuracy`
    is what the table of the correction may leave [rad], default 1e-5.
    """
    check(fit, allow_undetermined)
    options = given(accuracy, correction)
    d = decoupler(fit, box_of(fit, ranges), _unseen(fit, ranges, options))
    check_gains(bounds(d))
    check_same(d)
    digest = calibration_sha256 or digest_of(fit)
    made = program(d, **options)
    record = {"model": fit.model.name, "calibration_sha256": digest, **recorded(made.options, accuracy)}
    source = IntegerSource(made, record)
    errors, notes = q31_selftest.errors(source), notes_of(fit)
    return Integers(source, _files(source, errors, notes), errors, notes)


def _unseen(
    fit: Fit, ranges: Mapping[str, tuple[float, float]] | None, options: Mapping[str, Any]
) -> Mapping[str, Any]:
    """Return options for the float code, of which an encoder's integers take the model and the box alone."""
    if fit.model.family.decoder not in OPTIONS:
        return options
    for column in ranges or {}:
        if column in fit.model.channels and column in fit.model.period:
            raise InputError(
                f"--range {column} does not go with --arithmetic q31, where every bit pattern of {column} is an "
                "angle; leave it out."
            )
    return {"accuracy": np.pi, "correction": "series:0"}


def _files(source: IntegerSource, errors: dict[str, float], notes: tuple[str, ...]) -> dict[str, str | bytes]:
    header = params_header(Source(Table(source.program.d, FLOAT, source.source)))
    return {
        "include/decoupler.h": source.header(),
        "src/decoupler.c": source.step(),
        "src/decoupler_check.c": source.check(),
        "params/decoupler_params.h": header,
        "params/decoupler_params.c": source.params(),
        "params/decoupler_params.json": source.json(),
        BINARY: source.binary,
        "test/selftest.h": template("selftest.h"),
        "test/selftest.c": q31_selftest.selftest(source),
        "test/selftest_vectors.h": q31_selftest.vectors(source),
        "test/main.c": q31_selftest.main(source),
        "test/bare.c": source.bare(),
        "test/count.c": _count(source),
        "test/count.sh": template("count.sh").replace(", all NaN", ""),
        "test/startup.c": template("startup.c"),
        "test/cortex_m.ld": template("cortex_m.ld"),
        "proof/exhaustive.c": q31_proof.exhaustive(source),
        "proof/eva.c": q31_proof.eva(source),
        "proof/cbmc.c": q31_proof.cbmc(source),
        "proof/prove.sh": _prove(source),
        "doc/report.md": _report(source, errors, notes),
        "doc/misra.txt": template("misra.txt") + (SHIFTS if source.program.shifts else ""),
        "CMakeLists.txt": template("CMakeLists.txt"),
        "Makefile": _makefile(),
    }


def _prove(source: IntegerSource) -> str:
    p, text = source.program, template("prove_q31.sh")
    if not p.angles:
        return text
    read = (
        "every angle, through all of the code"
        if p.angles & set(p.d.inputs)
        else "range test, all bit patterns"
    )
    return text.replace(TRIED, read).replace(AS_PROVED, "").replace(", outputs within the stated bounds", "")


def _makefile() -> str:
    return template("Makefile").replace("-mcpu=cortex-m4 -mthumb @FPU@", CPU).replace("mps2-an386", MACHINE)


def _count(source: IntegerSource) -> str:
    p = source.program
    rows = []
    for share in (0.7, 3.0, -3.0):
        ends = [max(abs(v) for v in p.d.ends(c)) / p.unit(c) for c in p.d.inputs]
        if p.angles & set(p.d.inputs):
            ends = [2.0**29 for _ in ends]
        rows.append(", ".join(str(max(min(int(share * v), 2**31 - 1), 1 - 2**31)) for v in ends))
    rows.append(", ".join(part if k % 2 else f"-{part}" for k, part in enumerate(rows[1].split(", "))))
    if p.angles & set(p.d.inputs):
        rows = [f"{int(row) % 2**32}U" for row in rows]
    lines = "\n".join(f"    {{{row}}}," for row in rows)
    return f"""{BANNER}/* Calls whose instructions test/count.sh counts. */
#include "decoupler.h"
#include "decoupler_params.h"

extern void decoupler_bare(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out);

static const decoupler_in_t in[4] = {{
{lines}
}};

int main(void)
{{
    decoupler_out_t out;
    for (int k = 0; k < 4; k++)
    {{
        (void)decoupler_step(&decoupler_params, &in[k], &out);
    }}
    decoupler_bare(&decoupler_params, &in[0], &out);
    return 0;
}}
"""


def _report(source: IntegerSource, errors: dict[str, float], notes: tuple[str, ...]) -> str:
    p = source.program
    box = "\n".join(
        f"| {c} | {low:.6g} | {high:.6g} | {p.scale(c)} |" for c in p.d.inputs for low, high in [p.d.ends(c)]
    )
    pose = "\n".join(
        f"| {c} | {p.scale(c)} | {p.bounds[c][0]:.6g} | {p.bounds[c][1]:.6g} | "
        f"{1e9 * p.bounds[c][2]:.3g} n{unit(c)} | {1e9 * errors[c]:.3g} n{unit(c)} |"
        for c in p.outputs
    )
    said = "\n".join(f"- {note}" for note in (*p.said, *notes))
    products = sum(line.operation == "mul" for line in p.lines)
    names = ", ".join(short(c) for c in p.d.pose)
    return f"""\
# Integer decoupler of {p.d.model.name}

{MARK} from calibration {source.source["calibration_sha256"]}. Table layout 0x{source.layout:08x}, \
{len(source.binary)} bytes.

{said}

| input | least | greatest | value of the last bit |
|---|---:|---:|---|
{box}

| pose | value of the last bit | least | greatest | error | met |
|---|---|---:|---:|---:|---:|
{pose}

`error` bounds |computed - model| over the whole box, with every rounding and every table entry counted, by interval
arithmetic; `met` is the largest over 100000 random inputs. An input out of its range is brought back to the nearer end.

{len(p.lines)} integer operations, {products} of them products of three 16-bit ones, give {names}. The exponent of every
value comes from its range over the box, with a bit to spare for what rounding adds. `>>` of a negative number must be
arithmetic, as it is with gcc, clang, IAR and Arm compilers (MISRA C:2012 rule 10.1, a deviation).

`make check` and `make qemu` compare listed vectors with the model and 100000 samples bit by bit; `make count` counts
instructions and writes them, with code size and stack, to doc/instructions.txt; `make misra` runs cppcheck.

`make prove` runs what is installed and writes doc/proof.txt; a proof that was not run is said to be not run. Until then
none was run here, apart from the interval bounds above.
"""
