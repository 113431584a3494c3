"""Calibrations to generate C from, and the tools that compile, run and prove it."""

import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import hallsym
from hallsym import Fit, Model, Parameter
from hallsym.codegen import Decoupler, Generated
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
    return _fitted(model, values)


def _fitted(model: Model, values: np.ndarray) -> Fit:
    n = len(values)
    return replace(
        calibration(), model=model, values=values, std=np.zeros(n), determined=np.ones(n, bool),
        covariance=np.zeros((n, n)), zeros={},
    )  # fmt: skip


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
    known = {"theta_A": 0.01, "theta_D": -0.02, "eta_A": 0.87, "eta_B": 0.7, "eta_C": 0.86, "eta_D": 0.95}
    known |= {f"a_{k}": float(rng.uniform(-200, 0)) for k in "ABCD"}
    known |= {f"{q}_{k}": float(rng.uniform(-70, 70)) for q in "bc" for k in "ABCD"}
    sigmas = {c: Sigma(s, "given") for c, s in zip(model.channels, (5e-7, 1e-6, 5e-7, 2e-6), strict=True)}
    return replace(_fitted(model, model.vector(known)), noise=Noise(sigmas), zeros={})


def plain(name: str, **values: float) -> Fit:
    """A stage model at gains, and couplings, that are not nominal."""
    model = hallsym.build(name)
    known = {"eta_A": 0.87, "eta_B": 0.7, "eta_C": 0.86, "theta_A": 0.01, "theta_C": -0.02} | values
    return _fitted(model, model.vector(known))


CASES: dict[str, Callable[[], Fit]] = {
    "stage31": calibration,
    "stage15": lambda: plain("stage15"),
    "stage31_tied": lambda: plain("stage31_tied", a_A=-190.0, a_B=-150.0, a_C=-180.0, x0=0.12, y0=-0.03),
    "four probes": four_probes,
    "user's height_quadratic": lambda: with_effect(height_quadratic, 3e5),
    "exact_rotation": lambda: with_effect(stage.exact_rotation),
    "vertical_offset_coupling": lambda: with_effect(effects(STAGE_FAMILY)["vertical_offset_coupling"], 0.01),
    "cubic": lambda: with_effect(effects(STAGE_FAMILY)["odd_nonlinearity"], 0.01),
}


@cache
def made(case: str, **variant: bool | str) -> Generated:
    """Generated code of a case, once per process."""
    return hallsym.generate(CASES[case](), **variant)


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


def most_instructions(folder: Path) -> int:
    """Return the instructions of the longest call on a Cortex-M0, counted by `make count`."""
    said = ran(folder, "make", "count")
    found = re.search(r"decoupler_step, \d+ bytes, instructions per call: (.*)", said)
    assert found, said
    return max(map(int, found[1].split()))


def proved_by_eva(folder: Path, *, integers: bool = False) -> None:
    """Frama-C EVA raises no alarm about a folder and proves what its driver asserts."""
    need("frama-c")
    floats = [] if integers else ["-warn-special-float", "non-finite"]
    sources = ["proof/eva.c", *([] if integers else ["src/decoupler.c"]), "params/decoupler_params.c"]
    said = ran(
        folder, "frama-c", "-eva", "-eva-precision", "3", "-machdep", "gcc_x86_64", *floats,
        "-cpp-extra-args=-Iinclude -Iparams", *sources,
    )  # fmt: skip
    assert "  0 alarms generated" in said
    assert "100% of the logical properties" in said


class Library:
    """A generated folder compiled for this machine: `step`, `zero` and `check` on arrays of its type."""

    def __init__(self, folder: Path, d: Decoupler, dtype: type) -> None:
        sources = ["src/decoupler.c", "src/decoupler_check.c", "params/decoupler_params.c"]
        path = folder / "build" / "decoupler.so"
        path.parent.mkdir(exist_ok=True)
        ran(folder, "gcc", *STRICT, "-shared", "-fPIC", "-Iinclude", "-Iparams", *sources, "-o", str(path))
        self.library = ctypes.CDLL(str(path))
        self.dtype, self.d = dtype, d
        for name in ("decoupler_step", "decoupler_zero", "decoupler_check"):
            getattr(self.library, name).restype = ctypes.c_uint32
        size = len((folder / "params/decoupler_params.bin").read_bytes())
        table = (ctypes.c_ubyte * size).in_dll(self.library, "decoupler_params")
        self.table = np.frombuffer(bytes(table), dtype=np.uint8).copy()

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, int]:
        """Return pose and status of one sample."""
        given, out = (
            np.ascontiguousarray(inputs, self.dtype),
            np.full(len(self.d.pose), 99).astype(self.dtype),
        )
        return out, self._call("decoupler_step", self.table, given, out)

    def zero(self, inputs: np.ndarray, pose: np.ndarray) -> int:
        """Take the zero; the table changes."""
        given = np.ascontiguousarray(inputs, self.dtype)
        return self._call("decoupler_zero", self.table, given, np.ascontiguousarray(pose, self.dtype))

    def check(self) -> int:
        """Return the findings about the table as it is now."""
        return self._call("decoupler_check", self.table)

    def _call(self, name: str, *arrays: np.ndarray) -> int:
        return getattr(self.library, name)(*(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
