"""The generated decoupler beside CasADi's own C of the same expressions: instructions, bytes, stack, error.

Cortex-M4F in QEMU, arm-none-eabi-gcc -O2 -std=c99 -ffp-contract=off. CasADi's code is generated from
`decouple(fit)` (parameters as constants) and from the model with its parameters as inputs, in double and with
`casadi_real = float`; errors over 100000 random inputs on this machine. Neither checks its inputs.
"""

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

import hallsym
from hallsym.codegen import decouple, generate
from hallsym.codegen.templates import template

FLAGS = [
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfloat-abi=hard",
    "-mfpu=fpv4-sp-d16",
]
SAMPLES = 100_000
CALLER = """
typedef {real} real;
int {name}(const real **arg, real **res, long long *iw, real *w, int mem);
static const real p[] = {{{p}}};
static const real m[] = {{1e-4, -1e-4, 2e-4}};
static const real s[] = {{1e-4, 1e-4, -2e-4}};
static real q[3], w[200];
int main(void)
{{
    const real *arg[8] = {{{arguments}}};
    real *res[4] = {{q}};
    volatile int status = {name}(arg, res, 0, w, 0);
    return status;
}}
"""


def main() -> int:
    """Print the table."""
    missing = [t for t in ("arm-none-eabi-gcc", "qemu-system-arm", "gcc", "make") if shutil.which(t) is None]
    if missing:
        print(f"not run: {', '.join(missing)} not installed (make tools, as root on Debian and Ubuntu)")
        return 0
    fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
    print(f"{'':34s}{'instructions':>14s}{'code':>8s}{'table':>7s}{'stack':>7s}{'x, y':>10s}{'Rz':>11s}")
    with tempfile.TemporaryDirectory() as folder:
        _ours(fit, Path(folder) / "ours")
        for symbolic in (False, True):
            for real in ("float", "double"):
                _casadi(fit, Path(folder), symbolic, real)
    print("instructions: within range / worst; code: without libm; errors: largest met")
    return 0


def _row(name: str, count: str, code: int, table: int, stack: str, error: np.ndarray) -> None:
    x_y, rz = 1e9 * max(error[:2]), 1e9 * error[2]
    print(f"{name:34s}{count:>14s}{code:7d}B{table:6d}B{stack:>6s}B{x_y:8.2g}nm{rz:7.2g}nrad")


def _ours(fit: hallsym.Fit, folder: Path) -> None:
    made = generate(fit)
    made.write(folder)
    said = ran("make", "-C", str(folder), "count")
    bare = re.search(r"decoupler_bare, (\d+) bytes, instructions per call: (\d+)", said)
    step = re.search(r"decoupler_step, (\d+) bytes, instructions per call: (.*)", said)
    if bare is None or step is None:
        raise SystemExit(said)
    counts = [int(n) for n in step[2].split()]
    error = np.array(list(made.backend.errors(SAMPLES).values()))
    table = len(made.backend.binary)
    _row("hallsym, range test and status", f"{counts[0]} / {max(counts)}", int(step[1]), table, "0", error)
    _row("hallsym, bare arithmetic", f"{bare[2]}", int(bare[1]), table, "0", error)


def _casadi(fit: hallsym.Fit, folder: Path, symbolic: bool, real: str) -> None:
    name = f"casadi_{'symbolic' if symbolic else 'constants'}_{real}"
    model = fit.model
    p, m, s = (ca.SX.sym(n, k) for n, k in (("p", len(model.names)), ("m", 3), ("s", 3)))
    if symbolic:
        f = ca.Function(name, [p, m, s], [model.decoded(p, np.zeros(3), m, s, np.ones(3))])
    else:
        f = ca.Function(name, [m, s], [decouple(fit)(m, s)])
    generator = ca.CodeGenerator(f"{name}.c", {"casadi_real": real})
    generator.add(f)
    generator.generate(f"{folder}/")
    numbers = ", ".join(f"{v:.17g}" for v in fit.values)
    (folder / "caller.c").write_text(
        CALLER.format(real=real, name=name, p=numbers, arguments="p, m, s" if symbolic else "m, s")
    )
    (folder / "startup.c").write_text(template("common/test/startup.c"))
    (folder / "m.ld").write_text(template("common/test/cortex_m.ld"))
    elf = folder / f"{name}.elf"
    files = [str(folder / f) for f in ("startup.c", "caller.c", f"{name}.c")]
    link = ["-nostartfiles", "--specs=rdimon.specs", "-T", str(folder / "m.ld"), "-Wl,--gc-sections"]
    compiler = ("arm-none-eabi-gcc", "-w", *FLAGS)
    ran(*compiler, "-fstack-usage", "-c", files[2], "-o", str(folder / "f.o"))
    ran(*compiler, *link, *files, "-lm", "-o", str(elf))
    size = int(ran("arm-none-eabi-size", str(folder / "f.o")).splitlines()[1].split()[0])
    stack = max(int(line.split("\t")[1]) for line in (folder / "f.su").read_text().splitlines())
    count = counted_instructions(elf, name, folder / "trace.log")
    _row(name.replace("_", ", "), str(count), size, 0, str(stack), _error(fit, folder, name, real, symbolic))


def counted_instructions(elf: Path, name: str, log: Path) -> int:
    """Executed from the call to the return, library functions included."""
    symbols = ran("arm-none-eabi-nm", str(elf)).splitlines()
    start = next(int(line.split()[0], 16) for line in symbols if line.endswith(f" {name}"))
    back = re.search(rf"bl\s+\w+ <{name}>\n\s*(\w+):", ran("arm-none-eabi-objdump", "-d", str(elf)))
    qemu = ("qemu-system-arm", "-M", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none")
    step = ("-singlestep", "-d", "exec,nochain", "-D", str(log))
    semihosting = ("-semihosting-config", "enable=on,target=native")
    subprocess.run([*qemu, *step, *semihosting, "-kernel", str(elf)], check=False)
    pcs = [int(m[1], 16) for m in re.finditer(r"\[[0-9a-f]+/([0-9a-f]+)/", log.read_text())]
    first = pcs.index(start)
    if back is None:
        raise SystemExit(f"no call of {name} found")
    return pcs.index(int(back[1], 16), first) - first


def _error(fit: hallsym.Fit, folder: Path, name: str, real: str, symbolic: bool) -> np.ndarray:
    """Largest error against the model in double, over inputs that float holds exactly."""
    library = folder / f"{name}.so"
    ran(
        "gcc",
        "-w",
        "-std=c99",
        "-O2",
        "-shared",
        "-fPIC",
        str(folder / f"{name}.c"),
        "-lm",
        "-o",
        str(library),
    )
    call = getattr(ctypes.CDLL(str(library)), name)
    dtype = np.float32 if real == "float" else np.float64
    d = generate(fit).decoupler
    low, high = np.array([d.ends(c) for c in d.inputs]).T[:, :, None]
    inputs = (low + (high - low) * np.random.default_rng(0).random((6, SAMPLES // 10))).astype(np.float32)
    expected = d.exact(inputs.astype(float))
    p, worst_error, q = fit.values.astype(dtype), np.zeros(3), np.zeros(3, dtype)
    work = np.zeros(400, dtype)
    for k, column in enumerate(inputs.T.astype(dtype)):
        parts = (
            [p, column[:3].copy(), column[3:].copy()] if symbolic else [column[:3].copy(), column[3:].copy()]
        )
        arg = (ctypes.c_void_p * 8)(*(a.ctypes.data for a in parts))
        res = (ctypes.c_void_p * 4)(q.ctypes.data)
        call(arg, res, None, work.ctypes.data_as(ctypes.c_void_p), 0)
        worst_error = np.maximum(worst_error, np.abs(q - expected[:, k]))
    return worst_error


def ran(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
