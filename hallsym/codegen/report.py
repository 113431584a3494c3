"""doc/report.md of a generated folder: what is computed, how exactly, and what was proved."""

from hallsym.codegen.bounds import Bounds
from hallsym.codegen.cost import cost
from hallsym.codegen.entries import unit
from hallsym.codegen.project import MARK, template
from hallsym.codegen.source import Source


def report(source: Source, bounds: Bounds, errors: dict[str, float], notes: tuple[str, ...]) -> str:
    """Return the report. `errors`: largest errors met over random inputs, by pose column."""
    d, table = source.d, source.table
    box = "\n".join(
        f"| {c} | {low:.6g} | {high:.6g} | {unit(c)} |" for c in d.inputs for low, high in [d.ends(c)]
    )
    pose = "\n".join(
        f"| {c} | {bounds.low[c]:.6g} | {bounds.high[c]:.6g} | {_small(bounds.error[c] + d.slack, c)} | {_small(errors[c], c)} |"
        for c in d.pose
    )
    gains = "\n".join(f"| {c} | {share:.4f} |" for c, share in bounds.least_gain.items())
    said = "\n".join(f"- {note}" for note in (*d.said, *notes))
    work = cost(d)
    uses = (
        "\n".join(f"    {s.name} = {s.expression}" for s in d.steps)
        if len(d.steps) <= 20
        else (f"    {len(d.steps)} steps, see src/decoupler.c")
    )
    return f"""\
# Decoupler of {d.model.name}

{MARK} from calibration {table.source["calibration_sha256"]}. Table layout 0x{table.layout:08x}, \
{len(table.binary)} bytes, type {source.real.name}.

{said}

## Box

Status is 0 if every input is finite and within these ends; an input that is not is brought back to the nearer end
(NaN to the upper one) and its bit is set.

| input | least | greatest | unit |
|---|---:|---:|---|
{box}

## Outputs

Over the box, whatever else the inputs are, the pose lies within these bounds (plus what `decoupler_zero()` added).
`error` bounds |computed - model| with every rounding and every table entry counted, by interval arithmetic; `met` is
the largest over 100000 random inputs.

| pose | least | greatest | error | met |
|---|---:|---:|---:|---:|
{pose}

Least gain of each probe within the box, as a share of its gain at rest:

| reading | share |
|---|---:|
{gains}

## Arithmetic

{uses}

## Instructions, stack, memory

No static data, no heap, no recursion, no loop: {work.operations} operations, and {work.moves} numbers that are read or written, so about
{work.instructions} instructions on a Cortex-M4F without range test and status, counted here without a compiler. `make count` counts the instructions of each call in QEMU and writes
them, with code size and stack, to doc/instructions.txt; `make size` prints sizes alone.

## Proofs

`make prove` runs what is installed and writes doc/proof.txt; a proof that was not run is said to be not run. Until
then none was run here, apart from the interval bounds above.

## MISRA C:2012

`make misra` runs cppcheck with its MISRA addon over the sources. Deviations:

{template("misra.md")}
The self-test and what surrounds it is not part of the product and not checked.

## Bits

Floating point without contraction (`-std=c99` or `-ffp-contract=off`) gives the same bits on every IEEE 754 target;
`make check` and `make qemu` compare them, over 1000000 samples, with those that were computed at generation. With
contraction the last bits differ; the error bound holds all the same.
"""


def _small(value: float, column: str) -> str:
    return f"{value * 1e9:.3g} n{unit(column)}" if value > 1e-13 else f"{value:.2g} {unit(column)}"
