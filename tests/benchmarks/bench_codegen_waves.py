"""Generated decoders of magnet arrays beside CasADi's own C and SymPy's: instructions, bytes, stack, error.

Cortex-M4F in QEMU, arm-none-eabi-gcc -O2 -std=c99 -ffp-contract=off, as `bench_codegen`; integers on a
Cortex-M0. Place and height from three sums, absolute ones over a longer board, then six coordinates of a
mover over four arrays (tests/waves.py); `--quick`: the first row and its rivals. SymPy's code is the closed
form of the first harmonic with numbers. CasADi's is that of `model.decoded` (a start by arctangent and
logarithm where the model has one, then weighted least-squares steps) in float with the parameters as
constants. Both call libm, whose instructions count, and check nothing.
"""

import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import _rivals as rivals
import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "codegen"))

from bench_codegen import code_of, counted, in_qemu, run
from test_codegen_movers import fit_of as longer_rows
from waves import calibrated, calibrated_planar

import hallsym
from hallsym import Fit
from hallsym.codegen import generate
from hallsym.families.halbach import models
from hallsym.families.halbach.effects.ends import array_edges
from hallsym.families.halbach.layout import columns

CALLER = """
int {name}(const float **arg, float **res, long long *iw, float *w, int mem);
static const float m[] = {{{readings}}};
static const float start[] = {{0.0f, 0.0f, 0.0075f, 1e-3f, 1e-3f, 1e-3f}};
static float q[6], w[{work}];
int main(void)
{{
    const float *arg[8] = {{m, start}};
    float *res[4] = {{q}};
    volatile int status = {name}(arg, res, 0, w, 0);
    return status;
}}
"""
SYMPY_CALLER = """
void sympy_function(const float *in, float *out);
static const float in[] = {{{readings}}};
static float out[6];
int main(void)
{{
    sympy_function(in, out);
    return 0;
}}
"""
LEVEL = {"count": 3, "gaps": (0.0065, 0.0085), "tilt": 0.003, "travel": 0.0135}
TILTED = {**LEVEL, "count": 6, "tilt": 0.01}
AMPLITUDES = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4}


def main() -> int:
    """Print the table."""
    missing = [t for t in ("arm-none-eabi-gcc", "qemu-system-arm", "gcc", "make") if shutil.which(t) is None]
    if missing:
        print(f"not run: {', '.join(missing)} not installed (make tools, as root on Debian and Ubuntu)")
        return 0
    one = calibrated(models.halbach(), AMPLITUDES, gaps=(0.0042, 0.0062))
    quick = "--quick" in sys.argv
    rows: list[tuple[str, Fit, float | None]] = [
        ("halbach, 3 sums, gaps 4.2 to 6.2 mm", one, None),
        ("3 sums, gaps 4 to 10 mm", calibrated(), None),
        ("3 sums, gaps 4 to 10 mm, 0.1 um", calibrated(), 1e-7),
        ("6-DOF, 12 sums, closed form", calibrated_planar(**LEVEL), 1e-4),
        ("6-DOF, 12 sums, 5 um", calibrated_planar(**LEVEL), 5e-6),
        ("6-DOF, 24 sums, 10 mrad, 1 um", calibrated_planar(**TILTED), 1e-6),
        ("30 columns, 300 mm, array of 120 mm", travelling(), None),
        ("6-DOF, 24 sums, rows longer than arrays", longer_rows(), 5e-6),
    ]
    named = ((0, "q31: the first"), (1, "q31: 4 to 10 mm"), (4, "q31: 12 sums"), (5, "q31: 24"),
             (6, "q31: 30 columns, 300 mm"), (7, "q31: rows longer than arrays"))  # fmt: skip
    integers = [(rows[k], name) for k, name in named]
    if quick:
        rows, integers = rows[:1], integers[:1]
    print(
        f"{'':38s}{'instructions':>14s}{'code':>8s}{'table':>8s}{'stack':>7s}{'place':>10s}{'bound':>10s}{'tilt':>12s}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, fit, accuracy) in enumerate(rows):
            _ours(name, fit, Path(folder) / f"ours{k}", accuracy=accuracy)
        for k, ((_, fit, accuracy), name) in enumerate(integers):
            _ours(name, fit, Path(folder) / f"integers{k}", accuracy=accuracy, arithmetic="q31")
        _sympy("SymPy, halbach, 3 sums, no harmonics", one, Path(folder))
        _casadi(
            "CasADi, halbach, 3 sums", one, Path(folder), lambda m, r, w, _: m.decoded(*_given(one, r), [], w)
        )
        if quick:
            return 0
        single = calibrated_planar(**TILTED, across=1)
        _casadi("CasADi, one step, 24 single sensors", single, Path(folder), _one_step(single))
    print(
        "instructions: within range / worst; errors: largest met of places, its bound, largest of rotations"
    )
    return 0


def _given(fit: Fit, readings: ca.SX) -> tuple:
    return fit.values, np.zeros(0), readings


def _one_step(fit: Fit) -> Callable[..., ca.SX]:
    """One weighted least-squares step from a given pose, as generated from the model's expressions."""

    def step(model: hallsym.Model, readings: ca.SX, weight: np.ndarray, pose: ca.SX) -> ca.SX:
        seen = model.reading(fit.values, [], pose, [])
        slopes = ca.jacobian(seen, pose)
        scaled = slopes.T @ ca.diag(weight)
        return pose + ca.solve(scaled @ slopes, scaled @ (readings - seen))

    return step


def travelling() -> Fit:
    """Thirty columns at 10 mm, an array of four periods that half leaves the board at its ends."""
    places = [(j - 14.5) * 0.01 for j in range(30)]
    values = {**AMPLITUDES, "edges": 1.0}
    fit = calibrated(array_edges(models.halbach(columns(places, length_m=0.12))), values, sigma=1e-3)
    return replace(fit, log={**fit.log, "span": {"x_ref_m": [-0.145, 0.145], "z_ref_m": [0.004, 0.007]}})


def _sympy(name: str, fit: Fit, folder: Path) -> None:
    rival = rivals.sympy_array(fit)
    (folder / "function.c").write_text(rival.source)
    readings = ", ".join(f"{v:g}f" for v in np.linspace(0.2, 0.3, len(fit.model.channels)))
    (folder / "caller.c").write_text(SYMPY_CALLER.format(readings=readings))
    _, counts, _ = counted(in_qemu(rival.name, folder), rival.name)
    stack = max(int(line.split("\t")[1]) for line in (folder / "function.su").read_text().splitlines())
    print(f"{name:38s}{counts[0]:>14s}{code_of(rival.name, folder):7d}B{0:7d}B{stack:6d}B")


def _ours(name: str, fit: Fit, folder: Path, **options: Any) -> None:
    made = generate(fit, **options)
    made.write(folder)
    said = run("make", "-C", str(folder), "count")
    step = re.search(r"decoupler_step, (\d+) bytes, instructions per call: (.*)", said)
    stack = re.search(r"decoupler_step=(\d+)", said)
    if step is None or stack is None:
        raise SystemExit(said)
    counts, bound = [int(n) for n in step[2].split()], made.backend.error_bound
    lengths = [c for c in made.errors if c.endswith("_m")]
    turns = [made.errors[c] for c in made.errors if c not in lengths]
    print(
        f"{name:38s}{f'{counts[0]} / {max(counts)}':>14s}{step[1]:>7s}B{len(made.backend.binary):7d}B"
        f"{stack[1]:>6s}B"
        f"{1e6 * max(made.errors[c] for c in lengths):8.3f}um{1e6 * max(bound[c] for c in lengths):8.3f}um"
        + (f"{1e6 * max(turns):8.2f}urad" if turns else "")
    )


def _casadi(name: str, fit: Fit, folder: Path, decoded: Callable[..., ca.SX]) -> None:
    model, n = fit.model, len(fit.model.channels)
    readings, code = ca.SX.sym("readings", n), "casadi_decoded"
    start = ca.SX.sym("start", 6)
    f = ca.Function(code, [readings, start], [ca.densify(decoded(model, readings, np.ones(n), start))])
    generator = ca.CodeGenerator(f"{code}.c", {"casadi_real": "float"})
    generator.add(f)
    (folder / "function.c").write_text(generator.dump())
    (folder / "caller.c").write_text(
        CALLER.format(name=code, work=f.sz_w() + 1, readings=", ".join(["0.3f"] * n))
    )
    _, counts, _ = counted(in_qemu(code, folder), code)
    size = code_of(code, folder)
    stack = max(int(line.split("\t")[1]) for line in (folder / "function.su").read_text().splitlines())
    print(f"{name:38s}{counts[0]:>14s}{size:7d}B{0:7d}B{stack:6d}B")


if __name__ == "__main__":
    sys.exit(main())
