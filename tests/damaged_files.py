"""Every reader, fed with damaged files: what is said, how long it takes, which numbers come out.

`python tests/damaged_files.py 10000` damages so many, each kind of file in turn, and prints what came of it.
"""

from __future__ import annotations

import contextlib
import functools
import gzip
import io
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any
from unittest.mock import patch

import lab_files
import mutations
import numpy as np
from log import bench_files
from twins import bundled

import hallsym
from hallsym.cli.main import main
from hallsym.errors import LONGEST
from hallsym.log.isolated import end_decoders

ADDITIONS = 3e8
"""Additions in Python in the time of the processor that no file may take: 10 s where 3 million take .1 s."""
PATIENCE = 60.0
"""Seconds after which the watchdog ends a command that waits."""
REFUSED, SAME, SAID, OTHER, SILENT = "refused", "same numbers", "said", "another valid file", "SILENT"
KINDS = (REFUSED, SAME, SAID, OTHER)
VOLATILE = ("seconds", "log", "sha256", "file", "calibration", "versions", "written")


class HangError(BaseException):
    """The watchdog: a command takes too long."""


@dataclass(frozen=True)
class Target:
    """A reader: the file it reads, with its good content, and the command that names it.

    `checked`: its format has checksums, so that any damage must be noticed; so must a torn last line of CSV.
    """

    name: str
    file: str
    command: str
    mutations: tuple[Callable[[bytes, random.Random], bytes], ...]
    checked: bool = False
    columns: Callable[[Mapping[str, np.ndarray], io.BytesIO], None] | None = None


@dataclass(frozen=True)
class Outcome:
    """What a command did with a damaged file; `fault` is what it must not do, empty if it did not."""

    target: str
    mutation: str
    kind: str
    seconds: float
    sentence: str
    fault: str = ""


def _parquet(columns: Mapping[str, np.ndarray], stream: io.BytesIO) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table({k: list(v) for k, v in columns.items()}), stream)


def _hdf5(columns: Mapping[str, np.ndarray], stream: io.BytesIO) -> None:
    import h5py

    with h5py.File(stream, "w") as file:
        for name, values in columns.items():
            file[name or "empty"] = values


def _mat(columns: Mapping[str, np.ndarray], stream: io.BytesIO) -> None:
    from scipy.io import savemat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        savemat(
            stream, {re.sub(r"\W", "_", k)[:30] or "e": v for k, v in columns.items()}, do_compression=True
        )


def _csv(columns: Mapping[str, np.ndarray], stream: io.BytesIO) -> None:
    rows = max(map(len, columns.values()), default=0)
    lines = [",".join(columns)]
    lines += [",".join(str(v[k]) if k < len(v) else "" for v in columns.values()) for k in range(rows)]
    stream.write("\n".join([*lines, ""]).encode("utf-8", "replace"))


BUDGET = """quantity = "gap"
unit = "nm"
coverage_factor = 2

[[source]]
name = "laser"
std_nm = 3.0
degrees_of_freedom = 12

[[source]]
name = "temperature"
half_width_k = 0.05
distribution = "rectangular"
sensitivity_nm_per_k = 120

[[source]]
name = "readings"
readings_nm = [1.0, 3.0, 2.0, 4.0]

[[correlation]]
between = ["laser", "temperature"]
coefficient = 0.2
"""
SETTINGS = """level = 0.95
[reading]
averaged = 16
adc_step_nm = 30
[zeroing]
averaged = 64
x_nm = 100
[zeroing.at]
x_um = 100
[state]
z_nm = 50
[reference]
x_scale_ppm = 2
"""
MACHINE = """[[probes]]
channel = "hall_a_m"
position_m = [0.1975, 0.4]
senses = [0, 1]
[[probes]]
channel = "hall_b_m"
position_m = [-0.1975, 0.4]
senses = [0, 1]
[[probes]]
channel = "hall_c_m"
position_m = [0.1975, 0.36]
senses = [1, 0]
[parameters.eta_A]
nominal = 0.9
lower = 0.6
upper = 1.05
[parameters.theta_A]
fixed = true
"""
COLUMN_FILE = """[columns]
hall_a_m = "hall_a_m"
hall_b_m = { name = "hall_b_m", sign = 1, scale = 1.0 }
[noise]
hall_m = 5e-7
x_ref_um = 0.5
"""
CAMPAIGN = """step_s = 0.01
zero_spread_m = 1e-6
[noise]
hall_m = 5e-7
[[setting]]
z_m = -1e-4
[[setting]]
z_m = 1e-4
rx_rad = 1e-4
[[trajectory]]
duration_s = 0.5
x_m = { kind = "sine", amplitude = 1e-4, frequency_hz = 2 }
y_m = { kind = "multi-sine", amplitude = 1e-4, frequencies_hz = [1, 3] }
[[run]]
name = "raster"
duration_s = 0.5
z_m = 5e-5
x_m = { kind = "triangle", amplitude = 1e-4, frequency_hz = 5 }
zero_deviations_m = [1e-6, 0, -1e-6]
[[run]]
duration_s = 0.5
rz_rad = { kind = "steps", levels = [0, 1e-4], dwell_s = 0.1, about = 1e-5 }
curve = "curve.json"
"""
RANGES = """step_s = 0.02
seconds_per_run = 1.0
runs = 4
frequencies_hz = [1.0, 2.0, 3.0]
levels = 2
trajectories = ["combined"]
[range]
x_um = [-300, 300]
y_um = [-500, 500]
rz_urad = [-300, 300]
[noise]
hall_um = 0.5
x_ref_um = 1.0
y_ref_um = 1.5
rz_ref_urad = 0.3
"""
TOLERANCES = """others = "exact"
[tolerance]
H1x_um = 20
H3y_um = { half_width = 20, distribution = "triangular" }
eta_A_percent = 2
eta_C = [0.98, 1.02]
theta_A_deg = { std = 0.1 }
"""


@cache
def targets() -> tuple[Target, ...]:
    """Every reader; `{FILE}` is the damaged file, the other names are good files beside it."""
    m = mutations
    return (
        Target("CSV log", "log.csv", "info {FILE} --json", m.TEXT + m.BYTES, columns=_csv),
        Target("CSV log, fit", "log.csv", "fit {FILE} --json --solver direct", m.TEXT, columns=_csv),
        Target("Parquet log", "log.parquet", "info {FILE} --json", m.BYTES, True, _parquet),
        Target("Parquet log, fit", "log.parquet", "fit {FILE} --json --solver direct",
               m.BYTES, True, _parquet),
        Target("HDF5 log", "log.h5", "info {FILE} --json", m.BYTES, False, _hdf5),
        Target("HDF5 run groups", "runs.h5", "info {FILE} --json", m.BYTES),
        Target("MATLAB log", "log.mat", "info {FILE} --json", m.BYTES, True, _mat),
        Target("MATLAB 7.3 log", "log73.mat", "info {FILE} --json", m.BYTES),
        Target("MDF log", "log.mf4", "info {FILE} --json", m.BYTES),
        Target("MDF log, compressed", "packed.mf4", "info {FILE} --json", m.BYTES),
        Target("MDF 3 log", "old.mdf", "info {FILE} --json", m.BYTES),
        Target("TDMS log", "log.tdms", "info {FILE} --json", m.BYTES),
        Target("MCAP log", "log.mcap", "info {FILE} --json", m.BYTES),
        Target("compressed log", "packed.csv.gz", "info {FILE} --json", m.BYTES, True),
        Target("archive", "runs.zip", "info {FILE} --json", m.BYTES),
        Target("database", "log.sqlite", "info {FILE} --json", m.BYTES),
        Target("workbook", "runs.xlsx", "info {FILE} --json", m.BYTES),
        Target("CSV log, as text", "log.csv", "info {FILE}", m.TEXT),
        Target("column file, suggested", "log.csv", "info {FILE} --write out.csv", m.TEXT),
        Target("sensors, sort", "sensors.csv", "sort {FILE} --field 0mT,475mT --json", m.TEXT),
        Target("calibration", "calib.json", "evaluate {FILE} log.parquet --json", m.JSON),
        Target("calibration, info", "calib.json", "info {FILE} --json", m.JSON),
        Target("calibration, as text", "calib.json", "info {FILE}", m.JSON),
        Target("calibration, page", "calib.json", "report {FILE} log.csv -o out.csv", m.JSON),
        Target("calibration, C", "calib.json", "codegen {FILE} -o other --allow-undetermined --json", m.JSON),
        Target("C, generated again", "c/manifest.json",
               "codegen calib.json -o c --force --allow-undetermined --json", m.JSON),
        Target("C, numbers alone", "c/table/decoupler_params.json",
               "codegen calib.json -o c --params-only --allow-undetermined --json", m.JSON),
        Target("fleet, continued", "fleet.csv.journal", "fleet log.csv -o fleet.csv --workers 1 --json",
               m.TEXT),
        Target("calibration, recording", "calib.json", "sensitivity {FILE} log.parquet", m.JSON),
        Target("calibration, budget", "calib.json", "budget {FILE} --json", m.JSON),
        Target("meta.json", "folder/meta.json", "fit folder --json --solver direct", m.JSON),
        Target("machine file", "machine.toml", "fit log.parquet --machine {FILE} --json --solver direct",
               m.TOML),
        Target("column file", "columns.toml", "info log.csv --column {FILE} --json", m.TOML),
        Target("budget", "budget.toml", "budget {FILE} --json", m.TOML),
        Target("settings", "settings.toml", "budget calib.json --settings {FILE} --json", m.TOML),
        Target("campaign", "campaign.toml", "info {FILE} --json", m.TOML),
        Target("campaign, simulated", "campaign.toml", "simulate {FILE} -o out.csv --seed 1", m.TOML),
        Target("ranges", "ranges.toml", "plan {FILE} --model stage30 --json", m.TOML),
        Target("tolerances", "tolerances.toml",
               "tolerances campaign.toml --ranges {FILE} --samples 16 --json", m.TOML),
        Target("curve", "curve.json", "info {FILE} --json", m.JSON),
        Target("curve, as text", "curve.json", "info {FILE}", m.JSON),
        Target("curve, followed", "curve.json", "simulate campaign.toml -o out.csv --seed 1", m.JSON),
        Target("table of a firmware", "table.h", "info {FILE} --json", m.TEXT),
        Target("points", "points.csv", "trajectory {FILE} --method cubic --json", m.TEXT),
        Target("diagnosis", "diagnosis.json", "budget calib.json --diagnosis {FILE} --json", m.JSON),
    )  # fmt: skip


def make_files(folder: Path) -> None:
    """Write the good files."""
    columns = bundled(slice(0, 12, 2))
    for name in ("log.csv", "log.parquet"):
        hallsym.write_log(columns, folder / name)
    import h5py
    from scipy.io import savemat

    savemat(folder / "log.mat", columns, do_compression=True)
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values, chunks=True, fletcher32=True)
    with h5py.File(folder / "log73.mat", "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[name] = values[None, :]
    group = {"Hall": (0.0, 50.0, {name: values for name, values in columns.items() if name != "t_s"})}
    bench_files.write_tdms(folder / "log.tdms", group)
    bench_files.write_mcap(folder / "log.mcap", group)
    bench_files.write_mdf(folder / "log.mf4", group)
    bench_files.write_mdf(folder / "packed.mf4", group, compression=1)
    bench_files.write_mdf(folder / "old.mdf", group, "3.30")
    (folder / "packed.csv.gz").write_bytes(gzip.compress((folder / "log.csv").read_bytes()))
    runs = {name: values for name, values in columns.items() if name != "run"} | {"Run": columns["run"]}
    lab_files.hdf5("run_{run}/{name}", runs=True)(folder / "runs.h5", dict(runs))
    lab_files.archive(folder / "runs.zip", dict(runs))
    lab_files.sheets_of_runs(folder / "runs.xlsx", dict(runs))
    lab_files.database(folder / "log.sqlite", columns)
    (folder / "folder").mkdir()
    hallsym.write_log(columns, folder / "folder" / "log.parquet")
    meta = {
        "case_id": "six", "base_model": "stage31", "validation_runs": [int(columns["run"][-1])],
        "nominal": {"eta_A": 0.9}, "noise_1sigma": {"hall_m": 5e-7}, "gap_length_scale_m": 0.2,
        "probes": tomllib.loads(MACHINE)["probes"],
    }  # fmt: skip
    (folder / "folder" / "meta.json").write_text(json.dumps(meta, indent=1), encoding="utf-8")
    hallsym.fit(hallsym.read_log(folder / "log.parquet"), "stage31", solver="direct").save(
        folder / "calib.json"
    )
    for name, text in {
        "budget": BUDGET, "settings": SETTINGS, "machine": MACHINE, "columns": COLUMN_FILE,
        "campaign": CAMPAIGN, "ranges": RANGES, "tolerances": TOLERANCES,
    }.items():  # fmt: skip
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    (folder / "sensors.csv").write_text(_sensors(), encoding="utf-8")
    shutil.copy(Path(__file__).parents[1] / "data" / "tables" / "calibration_lut.h", folder / "table.h")
    t = np.linspace(0, 1, 24)
    lines = [f"{a!r},{b!r}" for a, b in zip((100 * t).tolist(), (50 * np.sin(3 * t)).tolist(), strict=True)]
    (folder / "points.csv").write_text("\n".join(["x_um,y_um", *lines, ""]), encoding="utf-8")
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["trajectory", "points.csv", "--method", "cubic", "-o", "curve.json"]) == 0
        with patch.object(Path, "unlink"):  # a journal stays where a fleet was stopped
            assert main(["fleet", "log.csv", "-o", "fleet.csv", "--workers", "1"]) in (0, 3)
        assert main(["codegen", "calib.json", "-o", "c", "--allow-undetermined"]) in (0, 3)
    (folder / "diagnosis.json").write_text(json.dumps(DIAGNOSIS, indent=1), encoding="utf-8")


def _sensors() -> str:
    """Readings of sensors in two fields beside those of one that stays on the bench."""
    rng = np.random.default_rng(0)
    gain = 2.0 * (1 + rng.normal(0, 0.02, 40))
    lines = ["sensor,t_s,reading_0_v,reference_0_v,reading_1_v,reference_1_v"]
    for k, sensor in enumerate([*range(40), 3, 7, 11, 15, 21, 30]):
        read = 0.475 * gain[sensor] * (1 + rng.normal(0, 1e-3))
        lines.append(f"S{sensor},{20 * k},0.001,0.002,{read:.6f},{0.9 * (1 + rng.normal(0, 1e-3)):.6f}")
    return "\n".join([*lines, ""])


DIAGNOSIS = {
    "model": "stage31", "unexplained": {},
    "model_error": {"rest": {"x_m": 2e-6, "y_m": 1e-6}, "shape_counts": False, "candidates": []},
}  # fmt: skip


class Workshop:
    """A folder of good files in which one at a time is damaged and read."""

    def __init__(self, folder: Path) -> None:
        """Make the good files and read each once."""
        self.folder = folder
        with inside(folder):
            make_files(folder)
            self.good = {t.file: (folder / t.file).read_bytes() for t in targets()}
            self.codes: dict[str, int] = {}
            self.said = {t.name: self._numbers(t) for t in targets()}
            self.columns = bundled(slice(0, 12, 2))

    def _numbers(self, target: Target) -> Any:
        code, out, err, _ = self.call(target)
        assert code in (0, 3), (target.name, code, err)
        self.codes[target.name] = code
        return self._read(target, out)

    def call(self, target: Target) -> tuple[int, str, str, float]:
        """Run the command of a target; returns exit code, both outputs and the time."""
        return called(target.command.replace("{FILE}", target.file).split())

    def case(self, target: Target, seed: int) -> Outcome:
        """Damage the file of a target in the way that a seed says, and judge what its command does."""
        rng = random.Random(f"{target.name} {seed}")
        good = self.good[target.file]
        if target.columns and rng.random() < 0.4:
            try:
                name, data = mutations.with_columns(target.columns, self.columns, rng)
            except (ValueError, TypeError, OSError, RuntimeError):  # the library does not write such a file
                name, data = "truncate", mutations.truncate(good, rng)
        else:
            mutation = rng.choice(target.mutations)
            name, data = mutation.__name__, mutation(good, rng)
        with inside(self.folder):
            path = Path(target.file)
            path.write_bytes(data)
            try:
                code, out, err, seconds = self.call(target)
                return self._judged(target, name, data, code, out, err, seconds)
            finally:
                path.write_bytes(good)
                Path("out.csv").unlink(missing_ok=True)

    def _judged(
        self, target: Target, name: str, data: bytes, code: int, out: str, err: str, seconds: float
    ) -> Outcome:
        sentence = err.strip()
        fault = complaint(code, out, err, seconds)
        if code == 2 or fault:
            return Outcome(target.name, name, REFUSED, seconds, sentence, fault)
        found = self._read(target, out)
        if data == self.good[target.file] or same(found, self.said[target.name]):
            return Outcome(target.name, name, SAME, seconds, sentence)
        if code != self.codes[target.name] or _notes(found) != _notes(self.said[target.name]):
            return Outcome(target.name, name, SAID, seconds, sentence)
        read = target.file.endswith(".csv") and "--json" in target.command
        torn = read and not data.endswith((b"\n", b"\r"))
        if (target.checked or torn) and not name.startswith("columns"):
            return Outcome(target.name, name, SILENT, seconds, sentence, "other numbers in silence")
        return Outcome(target.name, name, OTHER, seconds, sentence)

    def _read(self, target: Target, out: str) -> Any:
        if "--json" in target.command:
            return json.loads(out)
        return Path("out.csv").read_text(encoding="utf-8") if "out.csv" in target.command else out


def called(arguments: list[str]) -> tuple[int, str, str, float]:
    """Run a command as a person does (libraries do not warn), under a watchdog."""
    out, err, began = io.StringIO(), io.StringIO(), time.process_time()

    def bark(number: int, frame: FrameType | None) -> None:
        raise HangError

    before = signal.signal(signal.SIGALRM, bark)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                code = main(arguments)
            except SystemExit as end:
                code = int(end.code or 0)
            except HangError:
                code = -1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    return code, out.getvalue(), err.getvalue(), time.process_time() - began


@functools.cache
def longest() -> float:
    """Return the seconds of the processor that `ADDITIONS` take on this machine: the best of three loops."""
    count, times, total = 1_000_000, list[float](), 0
    for _ in range(3):
        began = time.process_time()
        for k in range(count):
            total += k
        times.append(time.process_time() - began)
    return min(times) * ADDITIONS / count


def complaint(code: int, out: str, err: str, seconds: float) -> str:
    """Return what is wrong with how a command ended, empty where nothing is."""
    if code == -1 or seconds > longest():
        return f"took {seconds:.1f} s"
    if code not in (0, 1, 2, 3, 4):
        return f"exit code {code}"
    lines = err.strip().split("\n")
    if "Traceback" in err or "Warning" in err:
        return "a traceback or a warning"
    if code == 2 and (len(lines) != 1 or len(lines[0]) > LONGEST + len("hallsym: ") or not lines[0]):
        return f"{len(lines)} lines of up to {max(map(len, lines))} characters"
    if any(not (c.isprintable() or c == "\n") for c in out + err):
        return "control characters"
    return ""


def same(found: Any, wanted: Any) -> bool:
    """Return whether two records hold the same numbers and words, but times and names of files."""
    if isinstance(wanted, dict):
        if not isinstance(found, dict) or found.keys() != wanted.keys():
            return False
        return all(same(found[k], wanted[k]) for k in wanted if k not in VOLATILE)
    if isinstance(wanted, list):
        return isinstance(found, list) and len(found) == len(wanted) and all(map(same, found, wanted))
    if isinstance(wanted, float) and isinstance(found, int | float):
        return math.isclose(found, wanted, rel_tol=1e-9, abs_tol=1e-300)
    return bool(found == wanted)


def _notes(record: Any) -> Any:
    return record.get("notes", []) if isinstance(record, dict) else []


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Work in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def run(number: int, first: int) -> int:
    """Damage `number` files, seeds from `first` on, and print what came of them; 1 where any is a fault."""
    counts: Counter[str] = Counter()
    faults = 0
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        for k in range(number):
            found = workshop.case(targets()[k % len(targets())], first + k // len(targets()))
            counts[found.kind] += 1
            faults += bool(found.fault)
            if found.fault or k % 500 == 499:
                print(k + 1, found if found.fault else "", flush=True)
    end_decoders()  # only then is their memory counted
    taken = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"{dict(counts)}: {faults} faults in {number} files; at most {taken} kB, here and in decoders")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0))
