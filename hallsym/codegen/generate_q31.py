"""From a calibration to the files of an integer decoupler, for a controller without a floating-point unit."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hallsym.calibration import Fit
from hallsym.codegen.bounds import bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.expressions import check_columns, decoupler
from hallsym.codegen.folder import BINARY, replace_params, write_folder
from hallsym.codegen.generate import check, check_gains, digest_of, notes_of
from hallsym.codegen.parts import short, unit
from hallsym.codegen.printer import FLOAT
from hallsym.codegen.project import MARK, template
from hallsym.codegen.q31 import program
from hallsym.codegen.q31_source import CPU, MACHINE, IntegerSource
from hallsym.codegen.source import BANNER, Source
from hallsym.codegen.table import Table

REPLACED = ("params/", "test/selftest_vectors.h", "doc/report.md")


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
            "exponents": {**p.inputs, **{c: e for c, (_, e) in p.outputs.items()}},
            "error_met": dict(self.errors),
            "files": sorted(self.files),
            "notes": list(self.notes),
        }


def generate_q31(
    fit: Fit,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    allow_undetermined: bool = False,
    calibration_sha256: str | None = None,
) -> Integers:
    """Generate the integer decoupler of a calibration whose model is linear in the pose.

    `ranges`: least and greatest value by column [SI] in place of what the log recorded.
    """
    check_columns(fit.model)
    check(fit, allow_undetermined)
    d = decoupler(fit, box_of(fit, ranges))
    check_gains(bounds(d))
    digest = calibration_sha256 or digest_of(fit)
    source = IntegerSource(program(d), {"model": fit.model.name, "calibration_sha256": digest})
    errors, notes = source.errors(), notes_of(fit)
    return Integers(source, _files(source, errors, notes), errors, notes)


def _files(source: IntegerSource, errors: dict[str, float], notes: tuple[str, ...]) -> dict[str, str | bytes]:
    header = Source(Table(source.program.d, FLOAT, source.source)).params_header()
    return {
        "include/decoupler.h": source.header(),
        "src/decoupler.c": source.step(),
        "src/decoupler_check.c": source.check(),
        "params/decoupler_params.h": header,
        "params/decoupler_params.c": source.params(),
        "params/decoupler_params.json": source.json(),
        BINARY: source.binary,
        "test/selftest_vectors.h": source.vectors(),
        "test/main.c": source.main(),
        "test/count.c": _count(source),
        "test/count.sh": template("count.sh"),
        "test/startup.c": template("startup.c"),
        "test/cortex_m.ld": template("cortex_m.ld"),
        "doc/report.md": _report(source, errors, notes),
        "doc/misra.txt": template("misra.txt") + "misra-c2012-10.1:src/decoupler.c\n",
        "CMakeLists.txt": template("CMakeLists.txt").replace(" test/selftest.c", ""),
        "Makefile": _makefile(),
    }


def _makefile() -> str:
    text = template("Makefile").replace("-mcpu=cortex-m4 -mthumb @FPU@", CPU).replace("mps2-an386", MACHINE)
    text = text.replace(" test/selftest.c", "").replace(" test/bare.c", "")
    before, _, after = text.partition("prove:\n")
    return (
        before.replace(" prove clean", " clean").replace(", `make prove`", "")
        + after[after.index("clean:") :]
    )


def _count(source: IntegerSource) -> str:
    p = source.program
    rows = []
    for share in (0.7, 3.0, -3.0):
        ends = [max(abs(v) for v in p.d.ends(c)) * 2.0 ** p.inputs[c] for c in p.d.inputs]
        rows.append(", ".join(str(max(min(int(share * v), 2**31 - 1), 1 - 2**31)) for v in ends))
    rows.append(", ".join(part if k % 2 else f"-{part}" for k, part in enumerate(rows[1].split(", "))))
    lines = "\n".join(f"    {{{row}}}," for row in rows)
    return f"""{BANNER}/* Calls whose instructions test/count.sh counts. */
#include "decoupler.h"
#include "decoupler_params.h"

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
    return 0;
}}
"""


def _report(source: IntegerSource, errors: dict[str, float], notes: tuple[str, ...]) -> str:
    p = source.program
    box = "\n".join(
        f"| {c} | {low:.6g} | {high:.6g} | 2^-{p.inputs[c]} {unit(c)} |"
        for c in p.d.inputs
        for low, high in [p.d.ends(c)]
    )
    pose = "\n".join(
        f"| {c} | 2^-{e} {unit(c)} | {1e9 * errors[c]:.3g} n{unit(c)} |" for c, (_, e) in p.outputs.items()
    )
    said = "\n".join(f"- {note}" for note in notes)
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

| pose | value of the last bit | largest error met over 100000 random inputs |
|---|---|---:|
{pose}

{len(p.lines)} integer operations, {products} of them products of three 16-bit ones, give {names}. The exponent of every
value comes from its range over the box, by interval arithmetic, with two bits to spare. `>>` of a negative number must
be arithmetic, as it is with gcc, clang, IAR and Arm compilers (MISRA C:2012 rule 10.1, a deviation). `make check` and
`make qemu` compare 100000 samples bit by bit; `make count` counts instructions; `make misra` runs cppcheck. No proof by
Frama-C, CBMC or Gappa was run for integers.
"""
