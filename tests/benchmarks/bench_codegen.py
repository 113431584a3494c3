"""The generated decoupler beside what else writes C of it: instructions, cycles, bytes, stack, error.

Cortex-M4F in QEMU, arm-none-eabi-gcc -O2 -std=c99 -ffp-contract=off; cycles by Arm's tables,
memory without wait states (`test/cycles.awk` of a generated folder). Code is the function alone; libraries
are counted while they run. Errors against the model in double, over random inputs in the box that float holds
exactly, on this machine. None of the others checks its inputs, or has a table that can be replaced.
"""

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import _rivals as rivals

import hallsym
from hallsym.codegen import Generated, generate
from hallsym.codegen.templates import ROOT, template

CORE = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
FLAGS = ("-w", "-std=c99", "-O2", "-ffp-contract=off")
SAMPLES = 100_000
TESTS = Path(__file__).parents[1]
CALLER = """
{declared}
static const {real} in[] = {{{inputs}}};
static {real} out[8];
int main(void)
{{
{before}    {call}
    return 0;
}}
"""
BATCH = """
{declared}
void batch(const {real} *in, {real} *out, int count, int inputs, int outputs);
void batch(const {real} *in, {real} *out, int count, int inputs, int outputs)
{{
    for (int k = 0; k < count; k++, in += inputs, out += outputs)
    {{
{before}    {call}
    }}
}}
"""


@dataclass(frozen=True)
class Row:
    """What is measured of one function; `instructions` and `cycles` typical and, where they differ, worst."""

    label: str
    instructions: str
    cycles: str
    code: str
    table: str
    stack: str
    errors: tuple[float, ...]

    @property
    def count(self) -> int:
        """Instructions of an input within its range."""
        return int(self.instructions.split()[0])


def main() -> int:
    """Print a table for each decoder."""
    tools = ("arm-none-eabi-gcc", "qemu-system-arm", "gcc", "make", "awk")
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if missing:
        print(f"not run: {', '.join(missing)} not installed (make tools, as root on Debian and Ubuntu)")
        return 0
    for title, rows, units in tables():
        print(f"\n{title}\n")
        print(f"| | instructions | cycles | code | table | stack | {' | '.join(units)} |")
        print("|---|---:|---:|---:|---:|---:|" + "---:|" * len(units))
        for row in rows:
            errors = " | ".join(f"{1e9 * error:.{2 if error < 1e-8 else 0}f}" for error in row.errors)
            cells = (row.label, row.instructions, row.cycles, row.code, row.table, row.stack, errors)
            print(f"| {' | '.join(cells)} |")
        print("| MATLAB Coder | not run | | | | | " + " | ".join("" for _ in units) + " |")
    return 0


def tables() -> Iterator[tuple[str, Iterator[Row], tuple[str, ...]]]:
    """Yield title, rows and errors of each decoder."""
    stage = hallsym.load_fit(TESTS / "golden/calib.json")
    yield "stage31, bundled campaign", stage_rows(stage), ("x, y in nm", "Rz in nrad")
    encoder = hallsym.load_fit(TESTS / "goldens/calibrations/rotary_volts.json")
    yield "rotary, two voltages", encoder_rows(encoder), ("angle in nrad",)


def stage_rows(fit: hallsym.Fit) -> Iterator[Row]:
    """Measure decoders of the stage."""
    others = [rivals.by_hand(fit), rivals.sympy_stage(fit)]
    others += [rivals.casadi(fit, real, given) for given in (False, True) for real in ("float", "double")]
    for row in rows_of(fit, others):
        x, y, rz = row.errors
        yield Row(**{**vars(row), "errors": (max(x, y), rz)})


def encoder_rows(fit: hallsym.Fit) -> Iterator[Row]:
    """Measure decoders of an encoder."""
    others = [rivals.encoder_by_hand(fit), rivals.sympy_encoder(fit)]
    yield from rows_of(fit, [*others, *(rivals.casadi(fit, real) for real in ("float", "double"))])


def rows_of(fit: hallsym.Fit, others: list[rivals.Rival]) -> Iterator[Row]:
    """Measure our code with and without fused multiply-add, and the others."""
    with tempfile.TemporaryDirectory() as place:
        for fma in (False, True):
            yield from ours(generate(fit, fma=fma), Path(place) / f"ours{fma}", " --fma" if fma else "")
        made = generate(fit)
        for number, other in enumerate(others):
            folder = Path(place) / str(number)
            folder.mkdir()
            yield measured(other, made, folder)


def ours(made: Generated, folder: Path, option: str) -> Iterator[Row]:
    """Measure a generated folder by its own `make count`."""
    made.write(folder)
    said = run("make", "-C", str(folder), "count")
    errors = tuple(made.backend.errors(SAMPLES).values())
    stack = re.search(r"decoupler_step=(\d+)", said)
    for label, name in (("range test and status", "decoupler_step"), ("arithmetic alone", "decoupler_bare")):
        size, counts, cycles = counted(said, name)
        table = f"{len(made.backend.binary)} B"
        pushed = f"{stack[1] if stack and name == 'decoupler_step' else 0} B"
        yield Row(f"hallsym{option}, {label}", both(counts), both(cycles), f"{size} B", table, pushed, errors)


def counted(said: str, name: str) -> tuple[int, list[str], list[str]]:
    """Return bytes, instructions and cycles of each call from what `test/cycles.awk` says."""
    count = re.search(rf"^{name}, (\d+) bytes, instructions per call: (.*)$", said, re.MULTILINE)
    cycles = re.search(rf"^cycles of {name} per call, .*: (.*)$", said, re.MULTILINE)
    if count is None or cycles is None:
        raise SystemExit(said)
    return int(count[1]), count[2].split(), cycles[1].split()


def both(counts: list[str]) -> str:
    """Return the first, which is typical, and the largest where there are several."""
    worst = max(counts, key=lambda text: int(text.rpartition("-")[2]))
    return counts[0] if worst == counts[0] else f"{counts[0]} / {worst}"


def measured(rival: rivals.Rival, made: Generated, folder: Path) -> Row:
    """Compile a rival, run it in QEMU and on this machine."""
    d = made.decoupler
    (folder / "function.c").write_text(rival.source)
    low, high = np.array([d.ends(c) for c in d.inputs]).T
    inputs = rivals.numbers(0.5 * (low + high) + 0.2 * (high - low), rival.real)
    declared, _, before = rival.before.partition("@")
    fields = {
        "declared": declared,
        "before": before,
        "call": rival.call,
        "real": rival.real,
        "inputs": inputs,
    }
    (folder / "caller.c").write_text(CALLER.format(**fields))
    (folder / "batch.c").write_text(BATCH.format(**fields))
    _, counts, cycles = counted(in_qemu(rival.name, folder), rival.name)
    size = code_of(rival.name, folder)
    stack = max(int(line.split("\t")[1]) for line in (folder / "function.su").read_text().splitlines())
    table = f"{rival.table} B" if rival.table else ""
    errors = tuple(errors_of(rival, made, folder))
    return Row(rival.label, both(counts), both(cycles), f"{size} B", table, f"{stack} B", errors)


def in_qemu(name: str, folder: Path) -> str:
    """Run function.c and caller.c of a folder on a Cortex-M4F; what the script says of one function."""
    elf, log = folder / "program.elf", folder / "program.log"
    for part in ("startup.c", "cortex_m.ld"):
        (folder / part).write_text(template(f"common/test/{part}"))
    compiler = ("arm-none-eabi-gcc", *FLAGS, *CORE)
    run(*compiler, "-fstack-usage", "-c", str(folder / "function.c"), "-o", str(folder / "function.o"))
    link = ("-nostartfiles", "--specs=rdimon.specs", "-T", str(folder / "cortex_m.ld"))
    sources = [str(folder / file) for file in ("startup.c", "caller.c", "function.o")]
    run(*compiler, *link, *sources, "-lm", "-o", str(elf))
    qemu = ("qemu-system-arm", "-M", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none")
    help_text = subprocess.run(
        ["qemu-system-arm", "-help"], capture_output=True, text=True, check=False
    ).stdout
    step = ("-accel", "tcg,one-insn-per-tb=on") if "one-insn" in help_text else ("-singlestep",)
    semihosting = ("-semihosting-config", "enable=on,target=native")
    run(*qemu, *step, "-d", "exec,nochain", "-D", str(log), *semihosting, "-kernel", str(elf))
    (folder / "listing").write_text(run("arm-none-eabi-objdump", "-d", str(elf)))
    symbols = dict.fromkeys(("main", name), ("0", "0"))
    for line in run("arm-none-eabi-nm", "-S", str(elf)).splitlines():
        start, *size, _, symbol = line.split()
        if symbol in symbols and size:
            symbols[symbol] = (start, size[0])
    of = {
        "core": "cortex-m4", "name": name, "start": symbols[name][0], "size": symbols[name][1],
        "caller": symbols["main"][0], "caller_size": symbols["main"][1],
    }  # fmt: skip
    options = [text for pair in of.items() for text in ("-v", "=".join(pair))]
    script = str(ROOT / "common/test/cycles.awk")
    return run("awk", *options, "-f", script, str(folder / "listing"), str(log))


def code_of(name: str, folder: Path) -> int:
    """Return the bytes of a function and of the static ones that it calls."""
    listed = (line.split() for line in run("arm-none-eabi-nm", "-S", str(folder / "function.o")).splitlines())
    sized = [parts for parts in listed if len(parts) == 4]
    return sum(
        int(size, 16) for _, size, kind, symbol in sized if kind == "t" or (kind == "T" and symbol == name)
    )


def errors_of(rival: rivals.Rival, made: Generated, folder: Path) -> np.ndarray:
    """Return the largest error of each pose coordinate, over inputs that float holds exactly."""
    library, d = folder / "library.so", made.decoupler
    files = [str(folder / name) for name in ("function.c", "batch.c")]
    run("gcc", *FLAGS, "-shared", "-fPIC", *files, "-lm", "-o", str(library))
    dtype = np.float32 if rival.real == "float" else np.float64
    low, high = np.array([d.ends(c) for c in d.inputs]).T[:, :, None]
    share = np.random.default_rng(0).random((len(low), SAMPLES))
    inputs = (low + (high - low) * share).astype(np.float32)
    clear = made.backend.step(inputs.astype(made.backend.real.dtype))[1] == 0
    given = np.ascontiguousarray(inputs[:, clear].T, dtype=dtype)
    found = np.zeros((len(given), len(d.pose)), dtype)
    call = ctypes.CDLL(str(library)).batch
    call(
        *(a.ctypes.data_as(ctypes.c_void_p) for a in (given, found)),
        len(given),
        given.shape[1],
        found.shape[1],
    )
    difference = d.difference(found.T.astype(float), d.exact(inputs[:, clear].astype(float)))
    return np.abs(difference).max(axis=1)


def run(*command: str) -> str:
    """Return what a command prints; it must succeed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
