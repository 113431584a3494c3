"""How golden results are made: by the public names of `hallsym` and the command line, nothing else.

A result is JSON: what `--json` printed, with prose replaced by "<text>" (words may change, numbers and names
may not), and with what is never the same taken out (seconds, paths, versions).
"""

import hashlib
import inspect
import io
import json
import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from golden_logs import LOGS, ROOT, folder_of, workspace

import hallsym

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
"""What C is generated with: OpenBLAS chooses its kernels by the processor, and the last bit of a constant in
a parameter table, or of a self-test vector, follows. These run on every x86-64."""


@dataclass(frozen=True)
class Golden:
    """A result: how it is made, which tolerances apply, whether it takes long."""

    make: Callable[[], Any]
    kind: str
    slow: bool = False


def run(*arguments: str | Path) -> str:
    """Return what `python -m hallsym` prints; it must succeed, or leave parameters undetermined (code 3)."""
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["hallsym", *map(str, arguments)]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            runpy.run_module("hallsym", run_name="__main__")
        code = 0
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.argv = before
    assert code in (0, 3), f"hallsym {' '.join(map(str, arguments))}: code {code}, {err.getvalue()}"
    return out.getvalue()


def printed(*arguments: str | Path) -> Any:
    """Return the object that a command prints with `--json`."""
    return json.loads(run(*arguments, "--json"))


# -- what is kept of it ------------------------------------------------------------------------------------


def kept(value: Any, key: str = "") -> Any:
    """Return a result without prose and without what is never the same."""
    if key in OMITTED:
        return "<omitted>"
    if isinstance(value, Mapping):
        if key == "tried":  # recordings by what they are called
            return sorted(float(v) for v in value.values())
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
    log = LOGS[name]
    found = printed("fit", folder_of(name), *log.fit)
    matrix = np.array(found["covariance"].pop("matrix"))
    for parameter in log.loose:
        found["parameters"][parameter].update(std="<loose>", determined="<loose>")
        found["structural"] = [n for n in found["structural"] if n != parameter]
        found["combinations"] = [c for c in found["combinations"] if parameter not in c["expression"]]
    if not log.loose:
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
    found = kept(printed("diagnose", folder_of(name), *LOGS[name].diagnose))
    for key in ("where", "remaining"):
        found[key] = sorted(found[key], key=lambda s: (s["by"], s["at"], -s["share"]))
    return found


# -- commands ----------------------------------------------------------------------------------------------


def command(*arguments: str | Path) -> Callable[[], Any]:
    """Return what makes the record of a command."""
    return lambda: kept(printed(*arguments))


def on_log(*arguments: str | Path, log: str) -> Callable[[], Any]:
    """Return what makes the record of a command that ends with a log."""
    return lambda: kept(printed(*arguments, folder_of(log)))


def planned() -> Any:
    """Return a plan and the campaign file that it writes, as a reader finds it."""
    path = Path(workspace().name) / "plan.toml"
    record = kept(printed("plan", "--like-paper", "--runs", "8", "-o", path))
    campaign = hallsym.read_campaign(path)
    return {"record": record, "runs": len(campaign.runs), "rows": campaign.rows}


def simulated(*options: str) -> Any:
    """Return a summary of every column that `simulate` writes with noise."""
    path = Path(workspace().name) / "simulated.parquet"
    record = kept(printed("simulate", "-o", path, *options))
    log = hallsym.read_log(path)
    columns = {c: np.asarray(log.array(c), dtype=float) for c in log.columns}
    weight = {c: float(np.mean(v * np.cos(np.arange(len(v))))) for c, v in columns.items()}
    return {
        "record": record,
        "rms": {c: float(np.sqrt(np.mean(v**2))) for c, v in columns.items()},
        "weighted": weight,
    }


def names() -> Any:
    """Return the public names, and the parameters of those that are functions."""
    public = {name: getattr(hallsym, name) for name in sorted(hallsym.__all__)}
    return {
        n: list(inspect.signature(f).parameters) if inspect.isfunction(f) else "" for n, f in public.items()
    }


def decoupled() -> Any:
    """Return what the decoupler of each stored calibration makes of a few readings."""
    found = {}
    for path in (STAGE31, *sorted(CALIBRATIONS.glob("*.json"))):
        fit = hallsym.load_fit(path)
        function = hallsym.decouple(fit)
        k = 1 + np.arange(len(fit.model.channels))
        level = 0.9 if str(fit.model.family) == "rotary" else 1e-4
        poses = [
            function(level * np.cos(k * n), 1e-4 * np.sin(n + np.arange(len(fit.model.state))))
            for n in (1, 2, 3)
        ]
        found[path.stem] = [np.asarray(pose).ravel().tolist() for pose in poses]
    return found


# -- generated C -------------------------------------------------------------------------------------------

CODE: dict[str, tuple[str, tuple[str, ...]]] = {
    "stage31": ("stage31", ()),
    "stage31_double": ("stage31", ("--double",)),
    "stage31_jacobian": ("stage31", ("--jacobian",)),
    "stage31_slopes": ("stage31", ("--jacobian", "reading,state")),
    "stage31_fma": ("stage31", ("--fma",)),
    "stage31_q31": ("stage31", ("--arithmetic", "q31")),
    "stage31_range": ("stage31", ("--range", "z_um=-200:200", "--range", "x_um=-250:250")),
    "stage30_holdout": ("stage30_table6", ()),
    "stage30_holdout_q31": ("stage30_table6", ("--arithmetic", "q31")),
    "stage31_tied": ("stage31_tied", ()),
    "four_probes": ("stage31_four_probes", ()),
    "exact_rotation": ("stage31_turning", ()),
    "rotary_volts": ("rotary_volts", ()),
    "rotary_volts_q31": ("rotary_volts", ("--arithmetic", "q31")),
    "rotary_angle": ("rotary_angle", ()),
    "rotary_angle_q31": ("rotary_angle", ("--arithmetic", "q31")),
    "homed_volts": ("rotary_homed", ()),
    "homed_volts_q31": ("rotary_homed", ("--arithmetic", "q31")),
    "homed_angle": ("rotary_homed_angle", ()),
    "homed_angle_q31": ("rotary_homed_angle", ("--arithmetic", "q31")),
    "meng_volts": ("meng_volts", ()),
    "meng_angle_table": ("meng_angle", ("--correction", "table", "--accuracy", "angle_mrad=1")),
    "third_wave_series": ("rotary_third_wave", ("--correction", "series")),
}
"""Folders of C by name: the calibration, and options of `codegen`."""
FAST_CODE = {"stage31_q31", "rotary_angle"}
"""Both arithmetics and both kinds of decoder; the others are generated with the slow tests."""
FAST_EFFECTS = {"stage31_bent", "stage31_rails"}
"""Logs that are fitted with an effect in every run: one with linear parameters, one with a saturation."""
TEXTS = {
    "stage31_fma",
    "stage31_double", "stage31_q31", "stage31_jacobian", "rotary_volts", "rotary_volts_q31", "rotary_angle",
    "rotary_angle_q31", "homed_angle", "meng_angle_table", "third_wave_series",
}  # fmt: skip
"""Folders of which `decoupler.c` and `decoupler.h` are kept as they are, to be read side by side."""


def calibration(name: str) -> Path:
    """Return a stored calibration: C follows from its bytes, not from a fit anew."""
    return STAGE31 if name == "stage31" else CALIBRATIONS / f"{name}.json"


def generated(name: str) -> dict[str, bytes]:
    """Return the generated files of a folder by path."""
    which, options = CODE[name]
    folder = Path(workspace().name) / "code" / name
    done = subprocess.run(
        [sys.executable, "-m", "hallsym", "codegen", calibration(which), "-o", folder, "--force", *options],
        cwd=ROOT, env={**os.environ, **KERNELS}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 3), done.stderr
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def code_of(name: str) -> Any:
    """Return the SHA-256 of every generated file, and the text of two where it is kept."""
    files = generated(name)
    texts = [p for p in files if Path(p).name in ("decoupler.c", "decoupler.h")] if name in TEXTS else []
    return {
        "sha256": {path: hashlib.sha256(content).hexdigest() for path, content in files.items()},
        "texts": {path: files[path].decode().splitlines() for path in texts},
    }


def save_calibrations() -> None:
    """Fit and write the calibrations that C is generated from, anew."""
    CALIBRATIONS.mkdir(exist_ok=True)
    for name in sorted({which for which, _ in CODE.values()} - {"stage31"}):
        path, log = CALIBRATIONS / f"{name}.json", folder_of(name)
        run("fit", log, *LOGS[name].fit, "-o", path)
        path.write_text(path.read_text().replace(f"{log}/", ""))


# -- the list ----------------------------------------------------------------------------------------------


def _of_logs() -> dict[str, Golden]:
    found: dict[str, Golden] = {}
    for name, log in LOGS.items():
        found[f"fit/{name}"] = Golden(
            lambda n=name: fit_of(n), "fit", "--effect" in log.fit and name not in FAST_EFFECTS
        )
        if log.diagnosed != "never":
            found[f"diagnosis/{name}"] = Golden(
                lambda n=name: diagnosis_of(n), "diagnosis", log.diagnosed == "slow"
            )
    return found


ENCODER = ROOT / "data" / "encoder"
COMMANDS: dict[str, Golden] = {
    "names": Golden(names, "exact"),
    "decouple": Golden(decoupled, "close"),
    "info": Golden(command("info"), "exact"),
    "info_log": Golden(on_log("info", log="bundled_campaign"), "close"),
    "info_calibration": Golden(command("info", STAGE31), "close"),
    "info_campaign": Golden(command("info", ENCODER / "campaign.toml"), "close"),
    "evaluate": Golden(on_log("evaluate", STAGE31, log="bundled_campaign"), "close"),
    "sensitivity": Golden(on_log("sensitivity", STAGE31, log="bundled_campaign"), "json"),
    "sensitivity_encoder": Golden(
        on_log("sensitivity", CALIBRATIONS / "rotary_volts.json", log="rotary_volts"), "json"
    ),
    "sensitivity_plan": Golden(command("sensitivity", "--model", "stage31", "--plan"), "json"),
    "plan": Golden(planned, "json"),
    "budget": Golden(command("budget", STAGE31, "--at", "x_um=100", "--at", "z_um=150"), "json"),
    "budget_split": Golden(command("budget", STAGE31, "--split"), "json", slow=True),
    "budget_monte_carlo": Golden(command("budget", STAGE31, "--monte-carlo", "20000"), "json", slow=True),
    "budget_file": Golden(
        command("budget", ROOT / "data" / "micromachines2019" / "table2_budget.toml"), "close"
    ),
    "tolerances": Golden(command("tolerances", "--samples", "64"), "json"),
    "selftest": Golden(
        command("selftest", ENCODER, "--effects", "hysteresis,time_skew", "--sizes", "1.5", "--quick"),
        "diagnosis", slow=True,
    ),
    "selftest_stage": Golden(
        on_log(
            "selftest", "--effects", "time_skew", "--sizes", "1.3", "--rows", "3000", "--quick",
            log="stage31_mixed",
        ),
        "diagnosis", slow=True,
    ),
    "simulate": Golden(lambda: simulated("--seed", "5", "--step", "0.05"), "close"),
    "simulate_encoder": Golden(
        lambda: simulated(
            "--model", "rotary_meng", "--seed", "6", "--outliers", "0.01", "--correlation", "0.003"
        ),
        "close",
    ),
    "demo": Golden(lambda: kept(printed("demo", "-o", Path(workspace().name) / "demo")), "json", slow=True),
}  # fmt: skip

GOLDENS: dict[str, Golden] = {
    **_of_logs(),
    **{f"json/{name}": golden for name, golden in COMMANDS.items()},
    **{f"code/{name}": Golden(lambda n=name: code_of(n), "exact", name not in FAST_CODE) for name in CODE},
}
