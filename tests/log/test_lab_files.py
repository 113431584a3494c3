"""Files of laboratories: obeying what is printed, at most twice, ends in the right answer or a true sentence.

Each file holds the same recording under another program's names, units and layout. The person who obeys knows
what a column's unit is, and nothing else.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hallsym
from hallsym.cli.main import main
from hallsym.units import UNITS

Columns = dict[str, np.ndarray]
Write = Callable[[Path, Columns], "list[str]"]
STAGE = {
    "run": "Pass", "t_s": "Time", "hall_a_m": "HallA", "hall_b_m": "HallB", "hall_c_m": "HallC",
    "z_m": "Height", "rx_rad": "Roll", "ry_rad": "Pitch",
    "x_ref_m": "IFM_X", "y_ref_m": "IFM_Y", "rz_ref_rad": "IFM_Yaw",
}  # fmt: skip
UNIT = {"m": "um", "rad": "urad", "s": "s", "v": "mv"}


@dataclass(frozen=True)
class Lab:
    """A file of a laboratory.

    `write`: writes it and returns the words behind `hallsym fit`; `units`: what its owner knows, by SI unit;
    `counts`: scale and offset of counts, by our stem; `says`: what must be printed where no fit can be made;
    `within`: standard deviations by which values may differ; of `scaled` readings volts are no volts.
    """

    write: Write
    units: Mapping[str, str] = field(default_factory=lambda: dict(UNIT))
    counts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    says: str = ""
    within: float = 1e-3
    recorded: str = "stage"
    scaled: bool = False


def unit_of(column: str, units: Mapping[str, str]) -> tuple[str, float]:
    si = column.rpartition("_")[2]
    unit = units.get(si, si)
    return (unit, 1 / UNITS[unit].factor) if unit in UNITS else ("", 1.0)


def theirs(
    data: Columns, units: Mapping[str, str] = UNIT, names: Mapping[str, str] = STAGE, form: str = "{name}"
) -> Columns:
    """Columns under a laboratory's names, in its units; `form` says how a unit stands beside a name."""
    out = {}
    for column, values in data.items():
        unit, factor = ("", 1.0) if column == "run" else unit_of(column, units)
        name = names.get(column, column.rpartition("_")[0] or column)
        out[form.format(name=name, unit=unit) if unit else name] = values * factor if unit else values
    return out


def text(path: Path, columns: Columns, by: str = ",", above: str = "", decimal: str = ".") -> list[str]:
    """Write a table of text; NaN is an empty cell."""

    def cell(value: Any) -> str:
        return (
            ""
            if value != value
            else str(value)
            if isinstance(value, str)
            else f"{value:.12g}".replace(".", decimal)
        )

    rows = [by.join(map(cell, row)) for row in zip(*(list(v) for v in columns.values()), strict=True)]
    path.write_text("\n".join([above + by.join(columns), *rows, ""]), encoding="utf-8")
    return [str(path)]


def by_run(data: Columns) -> dict[int, Columns]:
    return {
        int(run): {c: v[data["run"] == run] for c, v in data.items() if c != "run"}
        for run in np.unique(data["run"])
    }


def german(path: Path, data: Columns) -> list[str]:
    return text(path / "lab.csv", theirs(data, form="{name} [{unit}]"), ";", "Stage 3\n\n", ",")


def unitless(unit: str) -> Write:
    return lambda path, data: text(path / "lab.csv", theirs(data, UNIT | {"m": unit}))


def two_rows(path: Path, data: Columns) -> list[str]:
    columns = theirs(data)
    units = ["" if c == "run" else unit_of(c, UNIT)[0] for c in data]
    return text(
        path / "lab.txt",
        {n: [u, *v.tolist()] for (n, v), u in zip(columns.items(), units, strict=True)},
        "\t",
    )


def wide(form: str, names: Mapping[str, str], short: bool = False) -> Write:
    def write(path: Path, data: Columns) -> list[str]:
        runs = by_run(data)
        longest = max(len(part["t_s"]) for part in runs.values())
        table = {"t_s": runs[min(runs)]["t_s"]}
        for run, part in runs.items():
            for column, values in part.items():
                if column == "t_s":
                    continue
                stem = column.rpartition("_")[0]
                unit, factor = unit_of(column, UNIT)
                kept = values[:-7] if short and run == 2 else values
                padded = np.r_[kept, np.full(longest - len(kept), np.nan)]
                table[form.format(name=names.get(column, stem), run=run, unit=unit)] = padded * factor
        return text(path / "wide.csv", table)

    return write


def folder(names: Mapping[str, str], form: str, words: Callable[[Path], str]) -> Write:
    def write(path: Path, data: Columns) -> list[str]:
        (path / "scans").mkdir()
        for run, part in by_run(data).items():
            text(path / "scans" / f"scan_{run}.csv", theirs(part, names=names, form=form))
        return [words(path / "scans")]

    return write


def workbook(path: Path, data: Columns) -> list[str]:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(path / "lab.xlsx"))
    for sheet in ("Notes", "Log"):
        page = book.add_worksheet(sheet)
        columns = theirs(data, form="{name} ({unit})") if sheet == "Log" else {"Operator": np.arange(2)}
        for k, (name, values) in enumerate(columns.items()):
            page.write_column(0, k, [name, *values.tolist()])
    book.close()
    return [str(path / "lab.xlsx")]


def hdf5(path: Path, data: Columns) -> list[str]:
    import h5py

    with h5py.File(path / "lab.h5", "w") as file:
        for column, values in data.items():
            unit, factor = ("", 1.0) if column == "run" else unit_of(column, UNIT)
            group = "sensors" if column.startswith("hall") else "reference" if "ref" in column else "stage"
            file[f"{group}/{STAGE[column]}"] = values * factor
            if unit:
                file[f"{group}/{STAGE[column]}"].attrs["units"] = unit.replace("u", "µ")
    return [str(path / "lab.h5")]


def hdf5_runs(path: Path, data: Columns) -> list[str]:
    import h5py

    with h5py.File(path / "lab.h5", "w") as file:
        for run, part in by_run(data).items():
            for column, values in part.items():
                unit, factor = unit_of(column, UNIT)
                name = f"measurement/run{run:02d}/{column.rpartition('_')[0]}"
                file[name] = values * factor
                file[name].attrs["unit"] = unit
    return [str(path / "lab.h5")]


def labview(path: Path, data: Columns) -> list[str]:
    columns = {"X_Value" if n == "Time" else n: v for n, v in theirs(data).items()}
    columns = {"X_Value": columns.pop("X_Value"), **columns}
    units = {"Pass": ""} | {STAGE[c]: unit_of(c, UNIT)[0] for c in data if c not in ("run", "t_s")}
    labels = "\t".join(["Y_Unit_Label", *(units[n] for n in columns if n != "X_Value")])
    head = (
        "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nDate\t2026/01/05\n"
        "***End_of_Header***\t\n\t\n"
        f"Channels\t{len(columns) - 1}\n{labels}\nX_Dimension\tTime\nDelta_X\t0.01\n***End_of_Header***\t\t\n"
    )
    made = text(path / "lab.lvm", columns, "\t", head)
    whole = Path(made[0]).read_text().replace("\t".join(columns), "\t".join([*columns, "Comment"]))
    Path(made[0]).write_text(whole)
    return made


def paths(path: Path, data: Columns) -> list[str]:
    groups = {c: "Hall/" + c[5].upper() if c.startswith("hall") else f"Ref/{STAGE[c]}" for c in data}
    return text(path / "export.csv", theirs(data, names={c: f"Root/{g}" for c, g in groups.items()}))


def matrix(path: Path, data: Columns) -> list[str]:
    from scipy.io import savemat

    named = theirs({c: v for c, v in data.items() if not c.startswith("hall")}, form="{name}_{unit}")
    halls = np.stack([data[f"hall_{k}_m"] * 1e6 for k in "abc"], axis=1)
    savemat(path / "lab.mat", {"hall_um": halls, **named})
    return [str(path / "lab.mat")]


def struct_array(path: Path, data: Columns) -> list[str]:
    from scipy.io import savemat

    parts = [theirs(part, form="{name}_{unit}") for part in by_run(data).values()]
    kind = [(name, object) for name in parts[0]]
    savemat(path / "lab.mat", {"runs": np.array([tuple(p.values()) for p in parts], dtype=kind)})
    return [str(path / "lab.mat")]


def counts(path: Path, data: Columns) -> list[str]:
    columns = theirs(data)
    for name in ("HallA", "HallB", "HallC"):
        columns[name] = np.round((columns[name] + 1000) / 0.02)
    return text(
        path / "lab.csv",
        {n if "Hall" in n or n == "Pass" else f"{n} [{UNITS_BY_NAME[n]}]": v for n, v in columns.items()},
    )


UNITS_BY_NAME = {name: unit_of(column, UNIT)[0] for column, name in STAGE.items() if column != "run"}


def two_files(moments: bool = False, names: Mapping[str, str] | None = None, apart: float = 0.0) -> Write:
    """Halls at 100 Hz beside a reference at 200 Hz, which begins a little later."""

    def write(path: Path, data: Columns) -> list[str]:
        runs = by_run(data)
        halls: dict[str, list[Any]] = {}
        reference: dict[str, list[Any]] = {}
        for k, (run, part) in enumerate(runs.items()):
            begin = 5.0 * k
            fine = np.arange(0, 2 * len(part["t_s"]) - 1) * np.median(np.diff(part["t_s"])) / 2 - 1e-4
            halls.setdefault("run", []).append(np.full(len(part["t_s"]), run))
            halls.setdefault("t_s", []).append(begin + part["t_s"] - part["t_s"][0])
            reference.setdefault("t_s", []).append(begin + fine + apart)
            for column, values in part.items():
                if column == "t_s":
                    continue
                if "ref" in column:
                    smooth = np.interp(fine, part["t_s"] - part["t_s"][0], values)
                    reference.setdefault(column, []).append(smooth)
                else:
                    halls.setdefault(column, []).append(values)
        form = "{name}" if names else "{name}_{unit}"
        tables = [
            theirs({c: np.concatenate(v) for c, v in t.items()}, names=names or {}, form=form)
            for t in (halls, reference)
        ]
        words = []
        for table, name in zip(tables, ("halls", "laser"), strict=True):
            time = next(n for n in table if n in ("t_s", "Time"))
            if moments:
                start = np.datetime64("2026-01-05T08:00:00", "us")
                stamps = start + np.round(table.pop(time) * 1e6).astype("timedelta64[us]")
                table = {"Stamp": np.array([str(s).replace("T", " ") for s in stamps]), **table}
            words += text(path / f"{name}.csv", table)
        return [words[0], "--join", words[1]]

    return write


def arrow(suffix: str) -> Write:
    def write(path: Path, data: Columns) -> list[str]:
        columns = theirs(data, form="{name}_{unit}")
        file = path / f"lab{suffix}"
        if suffix == ".npz":
            np.savez(file, **columns)
        elif suffix == ".feather":
            import pyarrow as pa
            from pyarrow import feather

            feather.write_feather(pa.table(columns), file)
        else:
            rows = zip(*(v.tolist() for v in columns.values()), strict=True)
            file.write_text("".join(json.dumps(dict(zip(columns, row, strict=True))) + "\n" for row in rows))
        return [str(file)]

    return write


def another_suffix(path: Path, data: Columns) -> list[str]:
    made = text(path / "lab.log", theirs(data, form="{name} in {unit}"), ";", decimal=",")
    return [*made, "--format", "csv"]


def without_height(path: Path, data: Columns) -> list[str]:
    return text(
        path / "lab.csv", theirs({c: v for c, v in data.items() if c not in ("z_m", "rx_rad", "ry_rad")})
    )


def with_meta(path: Path, data: Columns) -> list[str]:
    (path / "rig").mkdir()
    text(path / "rig" / "log.csv", data)
    noise = {"hall_m": 5e-7, "channel_v": 1e-3}
    (path / "rig" / "meta.json").write_text(json.dumps({"noise_1sigma": noise}))
    return [str(path / "rig")]


def blocks(path: Path, data: Columns) -> list[str]:
    """Runs behind each other, each with a clock from 0, between empty lines; a micro sign in the names."""
    parts = []
    for part in by_run(data).values():
        part = part | {"t_s": part["t_s"] - part["t_s"][0]}
        named = {n.replace("_u", "_µ"): v for n, v in theirs(part, form="{name}_{unit}").items()}
        parts.append(Path(text(path / "lab.dat", named, " ")[0]).read_text(encoding="utf-8"))
    head, _, first = parts[0].partition("\n")
    rest = [part.partition("\n")[2] for part in parts[1:]]
    (path / "lab.dat").write_text("\n\n".join([f"# {head}\n{first}", *rest]), encoding="utf-8")
    return [str(path / "lab.dat")]


def names_of_runs(path: Path, data: Columns) -> list[str]:
    columns = theirs(data, form="{name} [{unit}]")
    return text(path / "lab.csv", columns | {"Pass": np.array([f"R{int(run):02d}" for run in data["run"]])})


def line_breaks(path: Path, data: Columns) -> list[str]:
    made = text(path / "lab.csv", theirs(data))
    head, _, body = Path(made[0]).read_text().partition("\n")
    units = [unit_of(c, UNIT)[0] for c in data]
    names = [f'"{n}\n[{u}]"' if u and n != "Pass" else n for n, u in zip(head.split(","), units, strict=True)]
    Path(made[0]).write_text(f"{','.join(names)}\n{body}")
    return made


def objects(path: Path, data: Columns) -> list[str]:
    """Lines of JSON with an object in each object."""
    columns = theirs(data, names={c: c.rpartition("_")[0] for c in data}, form="{name}_{unit}")
    lines = []
    for k in range(len(data["run"])):
        line: dict[str, Any] = {"run": int(data["run"][k]), "hall_um": {}}
        for name, values in columns.items():
            if name.startswith("hall"):
                line["hall_um"][name[5]] = values[k]
            elif name and name != "run":
                line[name] = values[k]
        lines.append(json.dumps(line))
    (path / "lab.jsonl").write_text("\n".join(lines) + "\n")
    return [str(path / "lab.jsonl")]


def four_columns(path: Path, data: Columns) -> list[str]:
    """A board of four column sums, which stand elsewhere than where they are assumed."""
    x = 60 * data["x_ref_m"]
    phase = 2 * np.pi * (x[:, None] / 0.03 + np.arange(4) / 3.7)
    sums = {f"col_{k}_v": 0.3 * np.cos(phase[:, k]) for k in range(4)}
    known = {"run": data["run"], "t_s": data["t_s"], "x_ref_m": x, "z_ref_m": 0.003 + data["z_m"]}
    return text(path / "lab.csv", known | sums)


def no_names(path: Path, data: Columns) -> list[str]:
    made = text(path / "lab.csv", theirs(data))
    Path(made[0]).write_text(Path(made[0]).read_text().partition("\n")[2])
    return made


def odd_folder(path: Path, data: Columns) -> list[str]:
    made = folder({}, "{name}_{unit}", str)(path, data)
    text(path / "scans" / "summary.csv", {"gain": np.arange(4.0)})
    return made


# -- encoders --------------------------------------------------------------------------------------------


def averaged_counts(path: Path, data: Columns) -> list[str]:
    """A maker's table: the mean of some counts at each full step."""
    steps = np.arange(len(data["angle_ref_rad"]))
    columns = {"step_index": steps, "ref_angle_deg": np.degrees(data["angle_ref_rad"])}
    return text(
        path / "table.csv", columns | {"raw_count": np.round(data["angle_rad"] / (2 * np.pi) * 16384, 2)}
    )


def converter(path: Path, data: Columns) -> list[str]:
    """Both voltages as counts of twelve bits."""
    volts = {f"adc_{n}": np.round(2048 + 1600 * data[f"v_{n}_v"]) for n in ("sin", "cos")}
    return text(
        path / "adc.csv",
        {"time [s]": data["t_s"], **volts, "Winkel [°]": np.degrees(data["angle_ref_rad"])},
        ";",
    )


def unitless_turn(path: Path, data: Columns) -> list[str]:
    columns = {
        "t": data["t_s"],
        "sin": data["v_sin_v"],
        "cos": data["v_cos_v"],
        "theta": data["angle_ref_rad"] % (2 * np.pi),
    }
    return text(path / "turn.dat", columns, " ")


LABS = {
    "decimal commas, units in brackets": Lab(german),
    "no units, micrometres": Lab(unitless("um")),
    "no units, millimetres": Lab(unitless("mm"), UNIT | {"m": "mm"}),
    "a row of units": Lab(two_rows),
    "runs side by side": Lab(wide("{name}_run{run}_{unit}", {})),
    "runs side by side, one shorter": Lab(wide("Run {run} {name} [{unit}]", STAGE, short=True), within=3.0),
    "runs side by side, no units": Lab(wide("{name}_run{run}", STAGE)),
    "one file a run": Lab(folder({}, "{name}_{unit}", str)),
    "a pattern of runs": Lab(folder({}, "{name}_{unit}", lambda path: str(path / "scan_*.csv"))),
    "one file a run, names of their own": Lab(folder(STAGE, "{name} [{unit}]", str)),
    "one file a run, no units": Lab(folder(STAGE, "{name}", lambda path: str(path / "*.csv"))),
    "a workbook with notes": Lab(workbook),
    "HDF5 with units as attributes": Lab(hdf5),
    "HDF5 with a group for each run": Lab(hdf5_runs),
    "LabVIEW measurement": Lab(labview),
    "paths as names": Lab(paths),
    "a matrix of three sensors": Lab(matrix),
    "an array of structs": Lab(struct_array),
    "counts of a converter": Lab(counts, counts={f"hall_{k}": (0.02, -1000.0) for k in "abc"}, within=1.0),
    "two files": Lab(two_files(), within=3.0),
    "two files with moments": Lab(two_files(moments=True), within=3.0),
    "two files, names of their own": Lab(two_files(names=STAGE), within=3.0),
    "two files of other hours": Lab(two_files(apart=4e6), says="overlap in time"),
    "NumPy arrays": Lab(arrow(".npz")),
    "Feather": Lab(arrow(".feather")),
    "lines of JSON": Lab(arrow(".jsonl")),
    "another suffix": Lab(another_suffix),
    "no height, no tilts": Lab(without_height),
    "noise of a channel that is not there": Lab(with_meta, says="noise of channel_v, which the log"),
    "blocks with clocks of their own": Lab(blocks),
    "names of runs": Lab(names_of_runs),
    "line breaks in names": Lab(line_breaks),
    "objects in lines of JSON": Lab(objects),
    "a board of another layout": Lab(four_columns, says="layout is assumed: columns a third of"),
    "no names": Lab(no_names, says="must hold column names"),
    "a folder with another table": Lab(odd_folder, says="must have the same columns to be runs; summary"),
    "averaged counts beside a step index": Lab(averaged_counts, recorded="table", within=0.5),
    "voltages as counts": Lab(converter, recorded="encoder", within=1.0, scaled=True),
    "an encoder without units": Lab(unitless_turn, {"rad": "rad", "v": "v", "s": "s"}, recorded="encoder"),
}  # fmt: skip


@pytest.fixture(scope="module")
def recordings() -> dict[str, Columns]:
    """Runs of the bundled campaign, an encoder, and a maker's table of one."""
    log = hallsym.bundled_campaign()
    run = log.array("run").astype(int)
    chosen = np.isin(run, log.runs[::4])
    stage = {c: run[chosen] if c == "run" else log.array(c)[chosen] for c in log.columns}
    stage["run"] = np.unique(stage["run"], return_inverse=True)[1]
    rng = np.random.default_rng(4)
    t = np.arange(4000) * 1e-3
    angle = 2 * np.pi * (1.5 * t + 0.1 * np.sin(2 * t))
    readings = {"v_sin_v": 0.95 * np.sin(angle) + 0.01, "v_cos_v": np.cos(angle + 0.01) - 0.02}
    encoder = {
        "t_s": t,
        **{c: v + 1e-3 * rng.normal(size=len(t)) for c, v in readings.items()},
        "angle_ref_rad": angle,
    }
    knots = np.arange(200) * 2 * np.pi / 200
    error = 0.01 * np.sin(knots + 0.3) + 0.004 * np.cos(2 * knots) + 2e-4 * rng.normal(size=200)
    table = {"angle_rad": (knots + error + 1.0) % (2 * np.pi), "angle_ref_rad": knots}
    return {"stage": stage, "encoder": encoder, "table": table}


def run_command(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(list(words))
    shown = capsys.readouterr()
    return code, shown.out, shown.err


def completed(path: Path, lab: Lab) -> None:
    """Choose what a column file leaves open, as somebody who knows the units would."""
    lines = []
    for line in path.read_text(encoding="utf-8").split("\n"):
        match = re.match(r"# (\w+?)_([a-z]+) = (.*)", line)
        if match and match[2] in UNITS and match[2] == lab.units.get(UNITS[match[2]].si):
            stem, entry = match[1], match[3]
            if ("scale = 1.0" in entry) == (stem in lab.counts):
                numbers = "scale = {}, offset = {}".format(*lab.counts.get(stem, ("", "")))
                line = f"{stem}_{match[2]} = {entry.replace('scale = 1.0, offset = 0.0', numbers)}"
        lines.append(line)
    path.write_text("\n".join(lines), encoding="utf-8")


def next_words(out: str) -> list[str]:
    return shlex.split(" ".join(out[out.index("next: hallsym ") :].split())[len("next: hallsym ") :])


SLOW = ("no height, no tilts", "a board of another layout")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in LABS]
)
def test_obeying_twice_ends_in_the_right_answer(
    name: str,
    tmp_path: Path,
    recordings: dict[str, Columns],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "10000")
    lab, data = LABS[name], recordings[LABS[name].recorded]
    words = lab.write(tmp_path, data)
    code, out, err = run_command(capsys, "fit", *words, "--solver", "direct", "--json")
    messages = [err]
    if code == 2:
        code, out, err = run_command(capsys, "info", *words, "--write", "columns.toml")
        messages.append(out + err)
        if "--sheet" in err:  # it names the first one; its owner knows which
            code, out, err = run_command(capsys, "info", *words, "--sheet", "Log", "--write", "columns.toml")
        if code == 0:
            completed(tmp_path / "columns.toml", lab)
            code, out, err = run_command(capsys, *next_words(out), "--solver", "direct", "--json")
            messages.append(err)
    if code == 2 and "--drop-bad" in err:
        words = next_words(messages[-2]) if len(messages) > 2 else ["fit", *words]
        code, out, err = run_command(capsys, *words, "--drop-bad", "--solver", "direct", "--json")
        messages.append(err)
    if lab.says:
        assert lab.says in "\n".join([*messages, out])
        return
    assert code in (0, 3, 4), "\n".join(messages)
    found = json.loads(out)
    wanted = hallsym.fit(data, found["model"], solver="direct")
    entries = found["parameters"]
    for parameter, value, std in zip(wanted.model.names, wanted.values, wanted.std, strict=True):
        if np.isfinite(std) and std > 0 and entries[parameter]["determined"] and not lab.scaled:
            assert abs(entries[parameter]["value"] - value) <= lab.within * std + 1e-9, parameter
    errors = wanted.to_dict()["errors"]["fitted"]["rmse"]
    assert found["errors"]["fitted"]["rmse"] == pytest.approx(errors, rel=0.02 * lab.within + 1e-5)
