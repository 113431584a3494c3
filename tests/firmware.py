"""Calibrations to generate C from, and the tools that compile, run and prove it."""

import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import hallsym
from hallsym import Fit, Model, Parameter
from hallsym.codegen import Generated
from hallsym.estimation.calibration import CovarianceRecord, FittedParameter
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.families.stage import models as stage
from hallsym.log import Noise, Sigma

GOLDEN = Path(__file__).parent / "golden"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror", "-O2")


@cache
def calibration() -> Fit:
    """The calibration of the golden folder: stage31 on the bundled campaign."""
    return hallsym.load_fit(GOLDEN / "calib.json")


def with_effect(effect: Callable[[Model], Model], value: float = 0.0) -> Fit:
    """Return that calibration with an effect whose parameters all have one value."""
    base = calibration()
    model = effect(base.model)
    values = np.append(base.values, np.full(len(model.names) - len(base.values), value))
    return known(model, values)


def known(model: Model, values: np.ndarray, **fields: Any) -> Fit:
    """Return that calibration with another model, whose parameters are known exactly."""
    parameters = {
        p.name: FittedParameter(
            float(value), p.unit, 0.0, True, False, False, p.nominal, p.lower, p.upper
        )
        for p, value in zip(model.parameters, values, strict=True)
    }  # fmt: skip
    exact = CovarianceRecord(list(model.names), "", "", np.zeros((len(values), len(values))).tolist())
    return calibration().changed(
        model=model, parameters=parameters, covariance_record=exact, zero_deviations={}, **fields
    )


def height_quadratic(model: Model) -> Model:
    """A user's effect: e_k Z^2 in the gain of every probe (docs/extend.md)."""
    names = [f"e_{probe.label}" for probe in model.layout]

    def step(s, p):
        s["gain"] = s["gain"] + ca.vertcat(*(p[name] for name in names)) * s["z_m"] ** 2

    bends = tuple(Parameter(name, 0.0, -1e6, 1e6, "1/m2", "bend of the gain with height") for name in names)
    return model.with_step("transducer", step, effect="height_quadratic", parameters=bends)


def four_probes() -> Fit:
    """Four probes, two readings more noisy than the others."""
    layout = (
        *stage.paper_layout(),
        stage.Probe("hall_d_m", (-0.2, -0.33), (0.8, 0.6)),
    )
    model = stage.stage31(layout)
    rng = np.random.default_rng(7)
    given = {"theta_A": 0.01, "theta_D": -0.02, "eta_A": 0.87, "eta_B": 0.7, "eta_C": 0.86, "eta_D": 0.95}
    given |= {f"a_{k}": float(rng.uniform(-200, 0)) for k in "ABCD"}
    given |= {f"{q}_{k}": float(rng.uniform(-70, 70)) for q in "bc" for k in "ABCD"}
    sigmas = {c: Sigma(s, "given") for c, s in zip(model.channels, (5e-7, 1e-6, 5e-7, 2e-6), strict=True)}
    return known(model, model.vector(given), noise=Noise(sigmas))


def plain(name: str, **values: float) -> Fit:
    """A stage model at gains, and couplings, that are not nominal."""
    model = hallsym.build(name)
    given = {"eta_A": 0.87, "eta_B": 0.7, "eta_C": 0.86, "theta_A": 0.01, "theta_C": -0.02} | values
    return known(model, model.vector(given))


STAGES: dict[str, Callable[[], Fit]] = {
    "stage31": calibration,
    "stage15": lambda: plain("stage15"),
    "stage31_tied": lambda: plain("stage31_tied", a_A=-190.0, a_B=-150.0, a_C=-180.0, x0=0.12, y0=-0.03),
    "four probes": four_probes,
    "user's height_quadratic": lambda: with_effect(height_quadratic, 3e5),
    "exact_rotation": lambda: with_effect(stage.exact_rotation),
    "vertical_offset_coupling": lambda: with_effect(effects(STAGE_FAMILY)["vertical_offset_coupling"], 0.01),
    "cubic": lambda: with_effect(effects(STAGE_FAMILY)["odd_nonlinearity"], 0.01),
}


def written(code: Generated, folder: Path) -> Path:
    """Write generated code into a folder; returns it."""
    code.write(folder)
    return folder


def need(*tools: str) -> None:
    """Skip, and say why, without these tools; in continuous integration they must be there."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if missing and os.environ.get("CI") == "true":
        pytest.fail(f"{', '.join(missing)} must be installed in continuous integration")
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed; on Debian, Ubuntu 'make test' does it for root")


def ran(folder: Path, *command: str) -> str:
    """Run a command in a folder; its output, or the test fails with it."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PWD": str(folder)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


COUNTED = """
#include <math.h>
#include "decoupler.h"
#include "decoupler_params.h"
static const decoupler_in_t in[] = {INPUTS};
int main(void)
{
    decoupler_out_t out;
    for (unsigned k = 0U; k < sizeof(in) / sizeof(in[0]); k++)
    {
        (void)decoupler_step(&decoupler_params, &in[k], &out);
    }
    return 0;
}
"""


def instructions(code: Generated, folder: Path) -> list[int]:
    """Instructions of decoupler_step() on the Cortex-M of a written folder, stepped one by one in QEMU.

    One call with all inputs in range, of a pose where readings of none contradict one another, all above,
    all below, above and below in turn, and all NaN of floats.
    """
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    low, high = (side[:, 0].astype(float) for side in code.backend.span)
    above, below = high + 2 * (high - low), low - 2 * (high - low)
    rows = [0.7 * high + 0.3 * low, above, below, np.where(np.arange(len(low)) % 2, below, above)]
    if code.decoupler.drawn is not None:
        rows[0] = code.decoupler.drawn(np.random.default_rng(0), 30)[:, -1] / [
            p.scale for p in code.backend.inputs
        ]
    if code.backend.type == "q31":
        unsigned = code.backend.inputs[0].type == "uint32_t"
        whole = [[int(v) for v in np.clip(row, -(2**31) + 1, 2**31 - 1)] for row in rows]
        texts = [[f"{v % 2**32}U" if unsigned else str(v) for v in row] for row in whole]
    else:
        suffix = "F" if code.backend.type == "float" else ""
        texts = [[f"{v!r}{suffix}" for v in row.tolist()] for row in rows] + [["NAN"] * len(low)]
    listed = ", ".join("{" + ", ".join(row) + "}" for row in texts)
    (folder / "count.c").write_text(COUNTED.replace("INPUTS", listed))
    sources = "decoupler.c decoupler_check.c decoupler_params.c count.c"
    stepping = "-accel tcg,one-insn-per-tb=on" if "one-insn" in _qemu_help() else "-singlestep"
    machine = re.search(r"^MACHINE \?= (.*)$", (folder / "Makefile").read_text(), re.MULTILINE)[1]
    qemu = f"qemu-system-arm -M {machine} -nographic -monitor none -serial none {stepping} -d exec,nochain"
    qemu += " -D build/log -semihosting-config enable=on,target=native"
    ran(folder, "make", "-B", "qemu", f"TESTED={sources}", f"QEMU={qemu}")
    symbols = ran(folder, "arm-none-eabi-nm", "-S", "build/selftest.elf").splitlines()
    place = {line.split()[-1]: line.split() for line in symbols}
    first, caller = (int(place[name][0], 16) for name in ("decoupler_step", "main"))
    end = caller + int(place["main"][1], 16)
    counts: list[int] = []
    inside = False
    for text in re.findall(r"\[[0-9a-f]+/([0-9a-f]+)/", (folder / "build/log").read_text()):
        at = int(text, 16)
        if at == first and not inside:
            inside = True
            counts.append(0)
        inside = inside and not caller <= at < end
        if inside:
            counts[-1] += 1
    assert len(counts) == len(texts)
    return counts


@cache
def _qemu_help() -> str:
    return subprocess.run(["qemu-system-arm", "-help"], capture_output=True, text=True, check=False).stdout


def undefined_symbols(folder: Path) -> set[str]:
    """What the compiled code needs of others; nothing static of it may be in RAM."""
    ran(folder, "make", "size")
    found = [line.split()[-2:] for line in ran(folder, "arm-none-eabi-nm", "build/decoupler.o").splitlines()]
    assert {kind for kind, _ in found} <= {"T", "t", "r", "U"}
    return {name for kind, name in found if kind == "U"}


TESTED = (
    "decoupler.c", "decoupler_check.c", "decoupler_params.c", "test/selftest.c",
    "test/faults.c", "test/main.c",
)  # fmt: skip
PATHS = ("-I.", "-Itest")
SANITIZED = ("-fsanitize=undefined,float-divide-by-zero,float-cast-overflow", "-fno-sanitize-recover=all")


def passes(folder: Path, *options: str, compiler: str = "gcc") -> None:
    """Compile a folder with warnings as errors and run its self-test: vectors, both hashes, faults, zeros."""
    need(compiler)
    ran(folder, compiler, *STRICT, "-pedantic", *options, *PATHS, *TESTED, "-o", "selftest")
    said = ran(folder, "./selftest")
    assert "table good, 0 of" in said
    assert said.count("as stated") == 2
    assert "0 faults of a table not found, 0 zeros wrong" in said


def proved_by_eva(folder: Path, *, integers: bool = False) -> None:
    """Frama-C EVA raises no alarm about a folder and proves what its driver asserts."""
    need("frama-c")
    floats = [] if integers else ["-warn-special-float", "non-finite"]
    sources = ["proof/eva.c", *([] if integers else ["decoupler.c"]), "decoupler_params.c"]
    said = ran(
        folder, "frama-c", "-eva", "-eva-precision", "3", "-machdep", "gcc_x86_64", *floats,
        "-cpp-extra-args=-I.", *sources,
    )  # fmt: skip
    assert "  0 alarms generated" in said
    assert "100% of the logical properties" in said


def every_input(folder: Path) -> None:
    """Every bit pattern of an input, and divisors over their whole range, pass a folder's exhaustive proof.

    The proof tries each input by the same function with another limit, and all divisors, which takes half a
    minute: here it tries one input, and one divisor of 16.
    """
    need("gcc")
    proof = (folder / "proof/exhaustive.c").read_text()
    for line in re.findall(r"    bad \+= all_.*\n", proof)[1:]:
        proof = proof.replace(line, "", 1)
    (folder / "proof/some.c").write_text(proof.replace("; b++)", "; b += 16)"))
    overflow = ("-fsanitize=signed-integer-overflow", "-fsanitize-undefined-trap-on-error")
    sources = ("proof/some.c", "decoupler_check.c", "decoupler_params.c")
    ran(folder, "gcc", "-std=c99", "-O3", *overflow, *PATHS, *sources, "-o", "exhaustive")
    assert "exhaustive: 0 of" in ran(folder, "./exhaustive")


BATCH = """
#include "decoupler.h"
void batch(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out, uint32_t *status,
           uint32_t count);
void batch(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out, uint32_t *status,
           uint32_t count)
{
    for (uint32_t k = 0U; k < count; k++)
    {
        status[k] = decoupler_step(p, &in[k], &out[k]);
    }
}
"""
NUMBERS = {"float": "f4", "int32_t": "i4", "uint32_t": "u4"}


class Library:
    """A generated folder compiled for this machine: `step`, `zero` and `check` on arrays of its type."""

    def __init__(self, folder: Path, code: Generated) -> None:
        sources = ["decoupler.c", "decoupler_check.c", "decoupler_params.c", "build/batch.c"]
        path = folder / "build" / "decoupler.so"
        path.parent.mkdir(exist_ok=True)
        (folder / "build/batch.c").write_text(BATCH)
        ran(folder, "gcc", *STRICT, "-shared", "-fPIC", "-I.", *sources, "-o", str(path))
        self.library = ctypes.CDLL(str(path))
        self.dtype, self.d = np.dtype(NUMBERS[code.backend.inputs[0].type]), code.decoupler
        self.fields = [(port.column, NUMBERS[port.type]) for port in code.backend.outputs]
        self.fields += [("suspect", "u4")] * self.d.suspects  # it lies behind the pose
        size = len((folder / "table/decoupler_params.bin").read_bytes())
        table = (ctypes.c_ubyte * size).in_dll(self.library, "decoupler_params")
        self.table = np.frombuffer(bytes(table), dtype=np.uint8).copy()

    def steps(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose (n_pose, s), status (s,) and suspects (s,) of samples (n, s)."""
        given = np.ascontiguousarray(inputs.T, self.dtype)
        out, status = np.zeros(len(given), self.fields), np.zeros(len(given), np.uint32)
        self.call("batch", self.table, given, out, status, ctypes.c_uint32(len(given)))
        suspects = out["suspect"] if self.d.suspects else np.zeros(len(given), int)
        return np.array([out[c] for c in self.d.pose]), status, suspects

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, int]:
        """Return pose and status of one sample."""
        pose, status, _ = self.steps(np.asarray(inputs, self.dtype)[:, None])
        return pose[:, 0], int(status[0])

    def zero(self, inputs: np.ndarray, pose: np.ndarray) -> int:
        """Take the zero; the table changes."""
        given = np.ascontiguousarray(inputs, self.dtype)
        return self.call("decoupler_zero", self.table, given, np.ascontiguousarray(pose, self.dtype))

    def check(self) -> int:
        """Return the findings about the table as it is now."""
        return self.call("decoupler_check", self.table)

    def call(self, name: str, *given: Any) -> int:
        """Call a function of the library with arrays and numbers of C."""
        pointers = [g.ctypes.data_as(ctypes.c_void_p) if isinstance(g, np.ndarray) else g for g in given]
        function = getattr(self.library, name)
        function.restype = ctypes.c_uint32
        return function(*pointers)
