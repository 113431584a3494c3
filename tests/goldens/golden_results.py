"""How golden results are made: by the public names of `hallsym` and the command line, nothing else.

A result is JSON: what `--json` printed, with prose replaced by "<text>" (words may change, numbers and names
may not), and with what is never the same taken out (seconds, paths, versions).
"""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from golden_logs import LOGS, ROOT, folder_of, workspace

HERE = Path(__file__).resolve().parent
CALIBRATIONS = HERE / "calibrations"
STAGE31 = ROOT / "tests" / "golden" / "calib.json"
"""Model (31) on the bundled campaign; its generated folder is kept in full beside it."""

OMITTED = {
    "seconds", "versions", "sha256", "path", "bytes", "message", "calibration", "recorded", "report",
    "output",     "evaluations", "starts", "share_at_optimum",
}  # fmt: skip
"""Keys whose values are up to the machine, the place or the path of an optimiser: they must be there."""
SAID = {"verdict", "outcome", "status", "expression", "format"}
"""Keys whose values are compared word for word even where they hold spaces."""
KERNELS = {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Nehalem"}
"""What everything runs with: OpenBLAS chooses its kernels by the processor, and the last bit of a constant in
a parameter table, or of a self-test vector, follows. These run on every x86-64."""


@dataclass(frozen=True)
class Golden:
    """A result: how it is made, which tolerances apply, whether it takes long."""

    make: Callable[[], Any]
    kind: str
    slow: bool = False


def run(*arguments: str | Path) -> str:
    """Return what `python -m hallsym` prints; it may leave parameters undetermined (code 3)."""
    done = subprocess.run(
        [sys.executable, "-m", "hallsym", *arguments],
        cwd=ROOT, env={**os.environ, **KERNELS}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 3), done.stderr
    return done.stdout


# -- what is kept of it ------------------------------------------------------------------------------------


def kept(value: Any, key: str = "") -> Any:
    """Return a result without prose and without what is never the same."""
    if key in OMITTED:
        return "<omitted>"
    if isinstance(value, Mapping):
        return {k: kept(v, k) for k, v in value.items()}
    if isinstance(value, list):
        if len(value) > 12 and all(isinstance(v, float) for v in value):
            return {
                "numbers": len(value),
                "mean": float(np.mean(value)),
                "rms": float(np.sqrt(np.mean(np.square(value)))),
            }
        return [kept(v, key) for v in value]
    if isinstance(value, str) and (" " in value or "\n" in value) and key not in SAID:
        return "<text>"
    if isinstance(value, str) and Path(value).is_absolute():
        return "<omitted>"
    return value


def fit_of(name: str) -> Any:
    """Return the fit of a log: values, uncertainties, what is determined, errors, cost, zero deviations."""
    found = json.loads(run("fit", folder_of(name), *(LOGS[name].fit or ()), "--json"))
    matrix = np.array(found["covariance"].pop("matrix"))
    found["covariance"]["correlation"] = summed_correlation(matrix)
    found["zero_deviations"] = {run: list(d.values()) for run, d in found["zero_deviations"].items()}
    return kept(found)


def summed_correlation(matrix: np.ndarray) -> float | None:
    """Return one number that changes with every correlation coefficient: a weighted sum of them."""
    std = np.sqrt(np.diag(matrix))
    some = np.flatnonzero(std > 0)
    if len(some) == 0:
        return None
    correlation = matrix[np.ix_(some, some)] / np.outer(std[some], std[some])
    weight = np.cos(np.arange(len(some)))
    return float(weight @ correlation @ weight)


def diagnosis_of(name: str) -> Any:
    """Return the diagnosis of a log. Places are in the order of their names: equal shares have no order."""
    found = kept(json.loads(run("diagnose", folder_of(name), "--json")))
    for key in ("where", "remaining"):
        found[key] = sorted(found[key], key=lambda s: (s["by"], s["at"], -s["share"]))
    return found


# -- generated C -------------------------------------------------------------------------------------------

CODE: dict[str, tuple[str, tuple[str, ...]]] = {
    "stage31": ("stage31", ()),
    "stage31_slopes": ("stage31", ("--jacobian",)),
    "stage31_q31": ("stage31", ("--arithmetic", "q31")),
    "rotary_volts": ("rotary_volts", ()),
    "rotary_angle": ("rotary_angle", ()),
    "rotary_angle_q31": ("rotary_angle", ("--arithmetic", "q31")),
    "meng_angle_table": ("meng_angle", ("--accuracy", "angle_mrad=1")),
}
"""Folders of C by name: the calibration, and options of `codegen`."""
FAST_CODE = {"stage31_q31", "rotary_angle"}
"""Both arithmetics and both kinds of decoder; the others are generated with the slow tests."""
KEPT = ("*.[ch]", "table/*")
"""What a firmware is built from."""


def code_of(name: str) -> Any:
    """Return the SHA-256 of every file of a firmware. C follows from a stored calibration, not from a fit."""
    which, options = CODE[name]
    calibration = STAGE31 if which == "stage31" else CALIBRATIONS / f"{which}.json"
    folder = Path(workspace().name) / "code" / name
    run("codegen", calibration, "-o", folder, "--force", *options)
    files = sorted(p for part in KEPT for p in folder.glob(part))
    return {str(p.relative_to(folder)): hashlib.sha256(unversioned(p)).hexdigest() for p in files}


def unversioned(path: Path) -> bytes:
    """Return a generated file without the version of hallsym that it names."""
    return re.sub(rb"hallsym [0-9][0-9a-z.+]*", b"hallsym", path.read_bytes())


GOLDENS: dict[str, Golden] = {
    **{
        f"fit/{name}": Golden(lambda n=name: fit_of(n), "fit")
        for name, log in LOGS.items()
        if log.fit is not None
    },
    **{
        f"diagnosis/{name}": Golden(lambda n=name: diagnosis_of(n), "diagnosis", log.diagnosed == "slow")
        for name, log in LOGS.items()
    },
    **{f"code/{name}": Golden(lambda n=name: code_of(n), "code", name not in FAST_CODE) for name in CODE},
}
