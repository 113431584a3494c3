"""Files as laboratories have them, each with the right answer, and a person who obeys what is printed.

Every file holds a recording of `recordings`, as another instrument or program writes it, and what its owner
knows: of each column their name and unit, of counts their scale and offset. `obeyed` does what the messages
of `hallsym fit` and `hallsym info --write` say, at most twice, and compares the calibration with that of the
recording itself.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import re
import shlex
import sqlite3
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from recordings import Recording, Size, machine

import hallsym
from hallsym.log import Log, Meta
from hallsym.units import UNITS

Columns = dict[str, np.ndarray]
SHORT = Size(8, 120, 5e-3)
TURN = 2 * np.pi


@dataclass(frozen=True)
class Known:
    """What the owner of a file knows of one column; of counts, `value in unit = scale * count + offset`."""

    name: str
    unit: str = ""
    scale: float | None = None
    offset: float = 0.0


@dataclass(frozen=True)
class Written:
    """The words behind `hallsym fit`, and what the owner knows, by hallsym's own column."""

    words: list[str]
    known: Mapping[str, Known]
    columns: Columns | None = None
    """What the file holds, in SI, where it is not all of the recording."""


Write = Callable[[Path, Columns], Written]
Save = Callable[[Path, Columns], None]


@dataclass(frozen=True)
class LabFile:
    """A file: which recording it holds, how it is written, and how exactly [standard deviations].

    `says`: where no program can know, the words that a true sentence has, one of them.
    """

    write: Write
    family: str = "stage31"
    within: float = 0.05
    says: tuple[str, ...] = ()


@cache
def _machine(family: str) -> Recording:
    return machine(family, "laboratory", SHORT)


def recording(family: str) -> Columns:
    """Return the columns of the recording that files of a family hold, in SI."""
    return {name: values.copy() for name, values in _machine(family).arrays.items()}


def within(values: np.ndarray, unit: str) -> np.ndarray:
    """Return SI values in another unit."""
    return values / UNITS[unit].factor if unit else values


NAMES = {
    "run": "Run", "t_s": "Time", "hall_a_m": "Hall A", "hall_b_m": "Hall B", "hall_c_m": "Hall C",
    "z_m": "Z", "rx_rad": "Rx", "ry_rad": "Ry", "x_ref_m": "Laser X", "y_ref_m": "Laser Y",
    "rz_ref_rad": "Laser Rz",
}  # fmt: skip
UNDER = {c: n.replace(" ", "_") for c, n in NAMES.items()}
JOINED = {c: n.replace(" ", "") for c, n in NAMES.items()}
OURS = {c: c if c == "run" else c.rpartition("_")[0] for c in NAMES} | {"run": "Run"}
CHINESE = {c: n.replace("Hall ", "霍尔").replace("Laser ", "激光") for c, n in NAMES.items()}
CHINESE |= {"run": "次数", "t_s": "时间", "z_m": "高度"}
HALLS, VERTICAL = ("hall_a_m", "hall_b_m", "hall_c_m"), ("z_m", "rx_rad", "ry_rad")
LASER = ("x_ref_m", "y_ref_m", "rz_ref_rad")
UNIT = {"t_s": "ms"} | {c: "um" if c.endswith("_m") else "urad" for c in (*HALLS, *VERTICAL, *LASER)}
SYMBOL = {"um": "µm", "urad": "µrad", "deg": "°", "v": "V", "mv": "mV"}

BRACKETS, ROUND, SNAKE, ASIDE = "{name} [{unit}]", "{name} ({unit})", "{name}_{plain}", "{name}|{plain}"
"""How a unit stands behind a name; `ASIDE`: it is written elsewhere, `named` has it."""


def theirs(
    data: Columns,
    form: str = BRACKETS,
    names: Mapping[str, str] = NAMES,
    units: Mapping[str, str] = UNIT,
) -> tuple[Columns, dict[str, Known]]:
    """Return columns under other names and in other units, and what is known of them."""
    out, known = {}, {}
    for column, values in data.items():
        unit, name = units.get(column, ""), names[column]
        shown = {"unit": SYMBOL.get(unit, unit), "plain": unit}
        out[form.format(name=name, **shown) if unit else name] = within(values, unit)
        known[column] = Known(name, unit)
    return out, known


def named(columns: Columns) -> Iterator[tuple[str, str, np.ndarray]]:
    """Name, unit and values of columns that `theirs` gave with their units aside."""
    for whole, values in columns.items():
        name, _, unit = whole.partition("|")
        yield name, unit, values


def stem(column: str) -> str:
    """Return hallsym's name without its unit."""
    return column if column == "run" else column.rpartition("_")[0]


def runs_of(data: Columns) -> list[Columns]:
    """Return the recording run by run, without `run`, each with a clock that begins at 0."""
    parts = []
    for run in np.unique(data["run"]):
        part = {c: x[data["run"] == run] for c, x in data.items() if c != "run"}
        parts.append({**part, "t_s": part["t_s"] - part["t_s"][0]})
    return parts


def saved(
    file: str,
    save: Save,
    form: str = BRACKETS,
    names: Mapping[str, str] = NAMES,
    units: Mapping[str, str] = UNIT,
    *,
    words: Sequence[str] = (),
    without: Sequence[str] = (),
    clock: tuple[str, Callable[[np.ndarray], Sequence]] | None = None,
    before: Mapping[str, Callable[[int], Sequence]] | None = None,
    after: Mapping[str, Callable[[int], Sequence]] | None = None,
) -> Write:
    """One file, or a folder with one.

    `clock`: the column that stands in the place of `t_s`; `before`, `after`: more columns.
    """

    def write(path: Path, data: Columns) -> Written:
        left_out = (*without, *(["t_s"] if clock else []))
        columns, known = theirs({c: x for c, x in data.items() if c not in left_out}, form, names, units)
        n = len(data["t_s"])
        first = {clock[0]: clock[1](data["t_s"])} if clock else {}
        known |= {"t_s": Known(clock[0])} if clock else {}
        more = ({k: np.array(f(n)) for k, f in (given or {}).items()} for given in (before, after))
        save(path / file, {**next(more), **first, **columns, **next(more)})
        return Written([str(path / file.partition("/")[0]), *words], known)

    return write


def each_run(
    pattern: str, words: str, save: Save, form: str = BRACKETS, names=NAMES, note: str = ""
) -> Write:
    """One file a run, named by its number `k`; `words`: what is fitted; `note`: a file beside them."""

    def write(path: Path, data: Columns) -> Written:
        for k, part in enumerate(runs_of(data)):
            columns, known = theirs(part, form, names)
            file = path / pattern.format(k=k, day=k // 4 + 1, hour=k % 4)
            file.parent.mkdir(exist_ok=True)
            save(file, columns)
        if note:
            (file.parent / note).write_text("gain,offset\n1,2\n1,3\n")
        return Written([str(path / words)], known)

    return write


# -- text --------------------------------------------------------------------------------------------------


def usual(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


def comma(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.9g}".replace(".", ",")


def text(
    by: str = ",",
    *,
    head: Callable[[list[str]], str] | None = None,
    above: str = "",
    number: Callable[[float], str] = usual,
    encoding: str = "utf-8",
    end: str = "\n",
    last: str = "",
) -> Save:
    """A table of text. `head`: makes the lines of names; `last`: what ends each line."""

    def save(file: Path, columns: Columns) -> None:
        lines = [head(list(columns)) if head else by.join(columns)]
        lines += [by.join(map(number, row)) + last for row in zip(*columns.values(), strict=True)]
        content = (above + end.join(lines) + end).encode(encoding)
        file.write_bytes(gzip.compress(content) if file.suffix == ".gz" else content)

    return save


def of_labview(names: list[str]) -> str:
    """The header of a LabVIEW measurement file with decimal commas."""
    units = "\t".join(n.partition("|")[2] for n in names[1:-1])
    return (
        "LabVIEW Measurement\t\r\nWriter_Version\t2\r\nReader_Version\t2\r\nSeparator\tTab\r\n"
        "Decimal_Separator\t,\r\nMulti_Headings\tNo\r\nX_Columns\tOne\r\nTime_Pref\tRelative\r\n"
        "***End_of_Header***\t\r\n\t\r\n"
        f"Channels\t{len(names) - 2}\r\nSamples\t1800\r\nY_Unit_Label\t{units}\r\n"
        "X_Dimension\tTime\r\nX0\t0,0000000000000000E+0\r\nDelta_X\t0,005000\r\n***End_of_Header***\t\t\r\n"
    ) + "\t".join(n.partition("|")[0] for n in names)


def stamps(seconds: np.ndarray, start: str = "2026-03-02T23:59:58") -> list[str]:
    """The time of day in each row, to the microsecond."""
    moments = np.datetime64(start, "us") + np.round(seconds * 1e6).astype("timedelta64[us]")
    return [str(moment).replace("T", " ") for moment in moments]


def counts(path: Path, data: Columns) -> Written:
    """Readings as counts of a converter, its scale and offset in a remark above."""
    columns, known = theirs(data)
    for c in HALLS:
        del columns[f"{NAMES[c]} [µm]"]
        columns[NAMES[c] + " [counts]"] = np.round((1e6 * data[c] + 1500) / 0.05)
        known[c] = Known(NAMES[c], "um", 0.05, -1500.0)
    text(above="# Hall: 0.05 um per count, offset -1500 um\n")(path / "adc.csv", columns)
    return Written([str(path / "adc.csv")], known)


def lost_samples(file: Path, columns: Columns) -> None:
    """A sample of each Hall reading is lost, which a word marks."""
    cells = {n: [usual(v) for v in x] for n, x in columns.items()}
    for n in cells:
        if n.startswith("Hall"):
            cells[n][37] = "n/a"
    text()(file, cells)


def row_per_value(file: Path, columns: Columns) -> None:
    """Time, device, axis and value in each row, and columns that tell nothing, as databases export them."""
    t = columns.pop("time_s")
    rows = [f",{j},{t[k]:.9g},{','.join(name.partition('_')[::2])},{round(9 * x[k])},{x[k]:.10g},stage"
            for k in range(len(t)) for j, (name, x) in enumerate(columns.items())]  # fmt: skip
    head = ",table,time_s,device,AxisName,RawValue,VarValue,_measurement"
    rows.append(f",0,{t[-1] + 1:.9g},$RT_OFF$,,0,0,stage")
    file.write_text("\n".join([head, *rows, ""]), encoding="utf-8")


def annotated_series(file: Path, columns: Columns) -> None:
    """One series after the other below annotations, as InfluxDB exports them."""
    t = columns.pop("_time")
    rows = [f",,{j},{t[0]},{t[-1]},{t[k]},{x[k]:.10g},{name},stage"
            for j, (name, x) in enumerate(columns.items()) for k in range(len(t))]  # fmt: skip
    notes = ["#group,false,false,true,true,false,false,true,true",
             "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string",
             "#default,_result,,,,,,,",
             ",result,table,_start,_stop,_time,_value,_field,_measurement"]  # fmt: skip
    file.write_text("\n".join([*notes, *rows, ""]), encoding="utf-8")


def own_clocks(file: Path, columns: Columns) -> None:
    """A time before each channel, below rows of names, types and units, as TwinCAT exports them."""
    clock, cells = columns.pop("Time|ms"), [*named(columns)]
    rows = [[f"{word}\t{value}" for value in values] for word, values in (
        ("Name", [f"Axis.{name}" for name, _, _ in cells]), ("Data-Type", ["REAL64"] * len(cells)),
        ("SampleTime[ms]", [5] * len(cells)), ("Unit", [unit for _, unit, _ in cells]),
    )]  # fmt: skip
    rows += [[], *([f"{t:.3f}\t{usual(x[k])}" for _, _, x in cells] for k, t in enumerate(clock))]
    file.write_text("\r\n".join(["Name\tProject 3", "", *map("\t".join, rows), ""]))


def own_rows(file: Path, columns: Columns) -> None:
    """A merged log of a bus: readings in one row, the reference in the next, a little later."""
    late = [n for n in columns if n.startswith("Laser")]
    lines = [",".join(columns)]
    for k in range(len(columns["Run"])):
        for mine in (False, True):
            at = {"Time [ms]": columns["Time [ms]"][k] + 1e-4 * mine, "Run": columns["Run"][k]}
            lines.append(",".join(
                usual(at.get(n, x[k])) if n in at or (n in late) == mine else "" for n, x in columns.items()
            ))  # fmt: skip
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")


def segments(path: Path, data: Columns) -> Written:
    """A LabVIEW measurement file with a header before each run, whose values change."""
    parts = []
    for run, part in enumerate(runs_of(data)):
        columns, known = theirs(part, ASIDE, NAMES | {"t_s": "X_Value"}, UNIT | {"t_s": ""})
        _, units, values = zip(*named(columns), strict=True)
        n = len(values) - 1
        head = [["Samples", *[f"{len(values[0])}"] * n], ["Time", *[f"12:0{run}:00"] * n],
                ["Y_Unit_Label", *units[1:]], ["***End_of_Header***"]]  # fmt: skip
        above = "".join("\t".join(cells) + "\n" for cells in head)
        text("\t", above=above)(path / "part.lvm", {name: x for (name, _, x) in named(columns)})
        parts.append((path / "part.lvm").read_text(encoding="utf-8"))
    (path / "segments.lvm").write_text("\n".join(parts), encoding="utf-8")
    return Written([str(path / "segments.lvm")], known | {"t_s": Known("X_Value", "s")})


def file_per_channel(path: Path, data: Columns) -> Written:
    """A file for each channel of an oscilloscope, all with the same names."""
    above = "LECROYWS3000,18446,Waveform\nSegments,1,SegmentSize,120\nSegment,TrigTime,TimeSinceSegment1\n"
    known = {"v_sin_v": Known("C1 Ampl", "v"), "v_cos_v": Known("C2 Ampl", "v"),
             "angle_ref_rad": Known("C3 Ampl", "rad"), "t_s": Known("Time", "s")}  # fmt: skip
    for c in list(known)[:3]:
        text(above=above)(path / f"{known[c].name[:2]}.csv", {"Time": data["t_s"], "Ampl": data[c]})
    return Written(
        [str(path / "C1.csv"), "--join", str(path / "C2.csv"), "--join", str(path / "C3.csv")], known
    )


# -- runs side by side, two files ---------------------------------------------------------------------------


def wide(form: str, names=NAMES, *, clock: str = "", short: int = 0, by: str = ",") -> Write:
    """Runs side by side. `clock`: the name of the one in common, else each run has its own; `short`: samples
    that the third run lacks."""

    def write(path: Path, data: Columns) -> Written:
        parts = runs_of(data)
        columns: dict[str, list[str]] = {clock: list(map(usual, 1e3 * parts[0]["t_s"]))} if clock else {}
        for run, part in enumerate(parts):
            for c, x in part.items():
                if clock and c == "t_s":
                    continue
                lost = short if run == 2 else 0
                name = form.format(name=names[c], run=run, unit=SYMBOL.get(UNIT[c], UNIT[c]), plain=UNIT[c])
                columns[name] = [*map(usual, within(x, UNIT[c])[: len(x) - lost]), *[""] * lost]
        text(by)(path / "wide.csv", columns)
        return Written([str(path / "wide.csv")], {c: Known(names[c], UNIT[c]) for c in parts[0]})

    return write


def two_rates(*, moments: bool = False, later: float = 0.0) -> Write:
    """Halls in one file, the reference in another, twice as fast, from another start and `later` [s]."""

    def write(path: Path, data: Columns) -> Written:
        halls: dict[str, list] = {}
        laser: dict[str, list] = {}
        for run, part in enumerate(runs_of(data)):
            begin, n, step = 3.0 * run + 100, len(part["t_s"]), float(part["t_s"][1])
            fine = np.arange(-4, 2 * n + 4) * step / 2 + 0.1 * step
            for c in LASER:
                x = 1e6 * np.interp(fine, part["t_s"], part[c])
                laser.setdefault(f"{NAMES[c]} [{UNIT[c]}]", []).append(x)
            for c in (*HALLS, *VERTICAL):
                halls.setdefault(f"{NAMES[c]} [{UNIT[c]}]", []).append(1e6 * part[c])
            halls.setdefault("Run", []).append(np.full(n, run))
            halls.setdefault("Time [s]", []).append(begin + part["t_s"])
            laser.setdefault("Time [s]", []).append(begin + fine + later)
        for name, lists in (("halls", halls), ("laser", laser)):
            columns = {c: np.concatenate(x) for c, x in lists.items()}
            if moments:
                columns = {"Stamp": np.array(stamps(columns.pop("Time [s]"))), **columns}
            text()(path / f"{name}.csv", columns)
        known = {c: Known(NAMES[c], u) for c, u in UNIT.items()} | {"run": Known("Run")}
        known["t_s"] = Known("Stamp") if moments else Known("Time", "s")
        return Written([str(path / "halls.csv"), "--join", str(path / "laser.csv")], known)

    return write


# -- binary ------------------------------------------------------------------------------------------------


def book(file: Path, pages: Mapping[str, Sequence[tuple[int, int, Sequence]]]) -> None:
    """Write a workbook: on each sheet columns of cells that begin at (row, column)."""
    import xlsxwriter

    with xlsxwriter.Workbook(str(file)) as made:
        for name, cells in pages.items():
            page = made.add_worksheet(name)
            for row, column, values in cells:
                page.write_column(row, column, values)


def merged_cells(file: Path, columns: Columns) -> None:
    """A sheet on which one cell beside all rows of a run holds its number."""
    import xlsxwriter

    run, others = columns["Run"], [name for name in columns if name != "Run"]
    with xlsxwriter.Workbook(str(file)) as made:
        page = made.add_worksheet("Messung")
        page.write_row(0, 0, ["Run", *others])
        for k in np.unique(run):
            rows = np.flatnonzero(run == k)
            page.merge_range(rows[0] + 1, 0, rows[-1] + 1, 0, int(k))
        for column, name in enumerate(others, 1):
            page.write_column(1, column, columns[name])


def row_per_run(file: Path, columns: Columns) -> None:
    """Parquet with a row per run: its name, and a record of lists."""
    import pyarrow
    from pyarrow import parquet

    rows = [{"run_id": f"2026-01-30_{run:02d}", "data": part} for run, part in parts_by_run(columns)]
    parquet.write_table(pyarrow.Table.from_pylist(rows), file)


def two_tables(file: Path, columns: Columns) -> None:
    """Two tables on one sheet, side by side: settings, then the log."""
    settings = [(0, 0, ["Setting", "gain", "rate"]), (0, 1, ["Value", 1.5, 200])]
    log = [(0, k, [name, *x.tolist()]) for k, (name, x) in enumerate(columns.items(), 3)]
    book(file, {"Sheet1": [*settings, *log]})


def parts_by_run(columns: Columns) -> Iterator[tuple[int, Columns]]:
    run = columns.pop("Run")
    for k in np.unique(run):
        yield int(k), {name: x[run == k] for name, x in columns.items()}


def sheets_of_runs(file: Path, columns: Columns) -> None:
    """A sheet of a workbook for each run, behind one of remarks."""
    pages: dict[str, list] = {"Notes": [(0, 0, ["Stage 4", "warmed up for 2 h"])]}
    for run, part in parts_by_run(columns):
        pages[f"Pass {run + 1}"] = [(0, k, [name, *x.tolist()]) for k, (name, x) in enumerate(part.items())]
    book(file, pages)


def archive(file: Path, columns: Columns) -> None:
    """A folder of runs as a zip archive."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        for run, part in parts_by_run(columns):
            text()(file.with_suffix(".csv"), part)
            out.write(file.with_suffix(".csv"), f"export/run_{run}.csv")
            file.with_suffix(".csv").unlink()


def hdf5(place: str, unit_at: str = "units", runs: bool = False) -> Save:
    """HDF5 with a dataset a column at a place of its own, a group for each run if `runs`."""

    def save(file: Path, columns: Columns) -> None:
        import h5py

        with h5py.File(file, "w") as out:
            out.attrs["operator"] = "M."
            for run, part in parts_by_run(columns) if runs else [(0, columns)]:
                for name, unit, x in named(part):
                    where = place.format(name=name, run=run)
                    made = out.create_dataset(where, data=x, compression="gzip", shuffle=True)
                    if unit:
                        made.attrs[unit_at] = np.bytes_(unit)

    return save


def hdf5_records(file: Path, columns: Columns) -> None:
    """HDF5 with one dataset of records, as PyTables and LabVIEW write."""
    import h5py

    with h5py.File(file, "w") as out:
        out["measurement/log"] = np.rec.fromarrays(list(columns.values()), names=list(columns))


def hdf5_matrix(file: Path, columns: Columns) -> None:
    """HDF5 with one matrix, the names and units of its columns in attributes."""
    import h5py

    names, units, values = zip(*named(columns), strict=True)
    with h5py.File(file, "w") as out:
        out["daq/data"] = np.column_stack(values)
        out["daq/data"].attrs.update(columns=names, units=units, rate_hz=200.0)


def inside(data: Columns, *columns: str, axis: int = 1) -> np.ndarray:
    return np.stack([within(data[c], UNIT[c]) for c in columns], axis=axis)


def matrices(path: Path, data: Columns) -> Written:
    """MATLAB: N x 3 matrices, a row vector of times, no unit in any name."""
    from scipy.io import savemat

    groups = {"hall": HALLS, "vertical": VERTICAL, "ref": LASER}
    savemat(path / "stage.mat", {"run": data["run"][None, :].astype(float), "t": 1e3 * data["t_s"][None, :]}
            | {name: inside(data, *cs) for name, cs in groups.items()})  # fmt: skip
    known = {"run": Known("run"), "t_s": Known("t", "ms")}
    known |= {c: Known(f"{name}_{k}", UNIT[c]) for name, cs in groups.items() for k, c in enumerate(cs)}
    return Written([str(path / "stage.mat")], known)


def matlab(file: Path, columns: Columns) -> None:
    """MATLAB structs of an array, one a run."""
    from scipy.io import savemat

    parts = [part for _, part in parts_by_run(columns)]
    kind = [(name, object) for name in parts[0]]
    savemat(file, {"runs": np.array([tuple(p.values()) for p in parts], dtype=kind)})


def one_matrix(path: Path, data: Columns, save: Callable[[dict], str]) -> Written:
    """Variables by hallsym's names, the Halls as one matrix."""
    others = {c: f"{stem(c)}_{UNIT[c]}" if c in UNIT else c for c in data if c not in HALLS}
    word = save({n: within(data[c], UNIT.get(c, "")) for c, n in others.items()})
    known = {c: Known(stem(c), UNIT.get(c, "")) for c in others}
    return Written([word], known | {c: Known(f"hall_um_{i}", "um") for i, c in enumerate(HALLS)})


def matlab_73(path: Path, data: Columns) -> Written:
    """MATLAB 7.3, which is HDF5: vectors are rows, a matrix stands on its side."""
    import h5py

    def save(others: dict) -> str:
        with h5py.File(path / "v73.mat", "w", userblock_size=512) as file:
            for name, x in others.items():
                file[name] = x[None, :]
            file["hall_um"] = inside(data, *HALLS, axis=0)
            for name in file:
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
        head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
        with open(path / "v73.mat", "r+b") as raw:
            raw.write(head)
        return str(path / "v73.mat")

    return one_matrix(path, data, save)


def arrow(file: Path, columns: Columns) -> None:
    """Parquet with the units in the metadata of its columns, and runs as categories."""
    import pyarrow as pa
    from pyarrow import parquet

    fields = [pa.field(name, pa.float64(), metadata={"unit": unit} if unit else None)
              for name, unit, _ in named(columns)]  # fmt: skip
    made = pa.table([pa.array(x, pa.float64()) for x in columns.values()], schema=pa.schema(fields))
    runs = pa.array([f"R{run:02.0f}" for run in columns["Run"]]).dictionary_encode()
    parquet.write_table(made.set_column(0, "Run", runs), str(file))


def lists_and_records(file: Path, columns: Columns) -> None:
    """Parquet with a list for the readings of a row, and a record for the reference."""
    import pyarrow as pa
    from pyarrow import parquet

    halls = np.column_stack([columns.pop(f"hall_{k}_um") for k in "abc"]).tolist()
    ref = {n.replace("_ref", ""): columns.pop(n) for n in ("x_ref_um", "y_ref_um", "rz_ref_urad")}
    record = pa.StructArray.from_arrays(list(map(pa.array, ref.values())), names=list(ref))
    parquet.write_table(pa.table({**columns, "hall_um": halls, "ref": record}), str(file))


def json_rows(file: Path, columns: Columns) -> None:
    """A JSON object a line."""
    rows = zip(*(np.asarray(x).tolist() for x in columns.values()), strict=True)
    file.write_text("".join(json.dumps(dict(zip(columns, row, strict=True))) + "\n" for row in rows))


def json_runs(file: Path, columns: Columns) -> None:
    """A JSON object a run, with lists of its samples."""
    runs = ({"Run": k, "fs": 200, **{n: x.tolist() for n, x in part.items()}}
            for k, part in parts_by_run(columns))  # fmt: skip
    file.write_text("".join(f"{json.dumps(run)}\n" for run in runs))


def database(file: Path, columns: Columns) -> None:
    """A table of an SQLite database."""
    with contextlib.closing(sqlite3.connect(file)) as base:
        base.execute("create table samples ({})".format(", ".join(f'"{name}" real' for name in columns)))
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        base.executemany(f"insert into samples values ({','.join('?' * len(columns))})", rows)
        base.commit()


# -- encoders and arrays of magnets -------------------------------------------------------------------------


def of_columns(
    file: str,
    columns: Mapping[str, tuple[Known, Callable[[np.ndarray], np.ndarray]]],
    save: Save,
    form: str = "",
) -> Write:
    """A file of some columns: what is known of each, and its values from those in SI."""

    def write(path: Path, data: Columns) -> Written:
        known = {c: about for c, (about, _) in columns.items()}
        shown = {c: form.format(name=k.name, unit=SYMBOL.get(k.unit, k.unit)) if form and k.unit else k.name
                 for c, k in known.items()}  # fmt: skip
        save(path / file, {shown[c]: values(data[c]) for c, (_, values) in columns.items()})
        return Written([str(path / file)], known)

    return write


def one_run(write: Write) -> Write:
    """The same of the first run alone, whose clock begins at 0."""

    def write_one(path: Path, data: Columns) -> Written:
        part = runs_of(data)[0]
        made = write(path, part)
        return Written(made.words, made.known, {c: part[c] for c in made.known})

    return write_one


def as_it_is(x: np.ndarray) -> np.ndarray:
    return x


def wrapped(x: np.ndarray) -> np.ndarray:
    return np.degrees(x) % 360


def millivolt(x: np.ndarray) -> np.ndarray:
    return np.round(1e3 * x + 2048)


def encoder(t, sin, cos, reference, unit="deg", values=np.degrees):
    """Columns of an encoder's voltages under the names of an instrument."""
    as_they_are = {"t_s": Known(t, "s"), "v_sin_v": Known(sin, "v"), "v_cos_v": Known(cos, "v")}
    known = {c: (about, as_it_is) for c, about in as_they_are.items()}
    return known | {"angle_ref_rad": (Known(reference, unit), values)}


SCOPE = encoder("x-axis", "SIN", "COS", "REF")
TEKTRONIX = encoder("TIME", "CH1", "CH2", "CH3", "rad", as_it_is)
CHANNELS = encoder("Time", "Channel 0", "Channel 1", "Channel 2")
UNITLESS_TURN = encoder("t", "sin", "cos", "theta", "rad", lambda x: x % TURN)
RIGOL = TEKTRONIX | {"t_s": (Known("X", "s", 5e-3), lambda t: np.round(t / 5e-3))}
SERIAL = {"run": (Known("pass"), as_it_is), "t_s": (Known("millis", "ms"), lambda t: np.round(1e3 * t)),
          "v_sin_v": (Known("adc_sin", "v", 1e-3, -2.048), millivolt),
          "v_cos_v": (Known("adc_cos", "v", 1e-3, -2.048), millivolt),
          "angle_ref_rad": (Known("encoder_deg", "deg"), wrapped)}  # fmt: skip
STEPPER = {"run": (Known("run"), as_it_is), "t_s": (Known("us", "us"), lambda t: np.round(1e6 * t)),
           "angle_rad": (Known("as5047", "count", 16384), lambda x: np.floor(x / TURN * 16384) % 16384),
           "angle_ref_rad": (Known("microsteps", "rad", TURN / 51200),
                             lambda x: np.round(x / TURN * 51200))}  # fmt: skip


def maker_table(path: Path, data: Columns) -> Written:
    """The mean of some counts at each step of a motor: a step index, averaged counts, degrees."""
    part = runs_of(data)[0]
    order = np.argsort(np.mod(part["angle_ref_rad"], TURN))
    values = {"angle_rad": part["angle_rad"][order], "angle_ref_rad": part["angle_ref_rad"][order] % TURN}
    raw = np.round(values["angle_rad"] / TURN * 16384, 2)
    columns = {"step_index": np.arange(len(raw)), "raw_count": raw,
               "ref_angle_deg": np.degrees(values["angle_ref_rad"])}  # fmt: skip
    text()(path / "lut.csv", columns)
    known = {"angle_rad": Known("raw_count", "count", 16384), "angle_ref_rad": Known("ref_angle_deg", "deg")}
    return Written([str(path / "lut.csv")], known, values)


def board(*, places: bool) -> Write:
    """Column sums of a Halbach board in mV, travel and gap in mm, perhaps with the places of the sums."""

    def write(path: Path, data: Columns) -> Written:
        known = {"run": Known("scan"), "t_s": Known("time", "s")}
        known |= {c: Known(f"col {c.split('_')[1]}", "mv") for c in data if c.startswith("col")}
        known |= {"x_ref_m": Known("x stage", "mm"), "z_ref_m": Known("gap", "mm")}
        names, units = ({c: getattr(k, of) for c, k in known.items()} for of in ("name", "unit"))
        made = saved("board.csv", text(";"), BRACKETS, names, units)(path, {c: data[c] for c in known})
        probes = [p for p in _machine("halbach").probes or () if "channel" in p]
        (path / "board.toml").write_text("\n".join(
            f"[[probes]]\nchannel = {p['channel']!r}\npositions_m = {p['positions_m']}" for p in probes
        ))  # fmt: skip
        return Written([*made.words, *(["--machine", str(path / "board.toml")] if places else [])], known)

    return write


PREAMBLE = [f"Channel {k}, gain, {1.5 + k}, coupling, DC" for k in range(12)]
PREAMBLE += ["Instrument: DAQ-3, serial 4711", "Samples: 960, Rate: 200 Hz", "", "[Data]", ""]
SETTINGS = ["Model,MSO44", "Firmware,1.20", "Sample Interval,5e-3", "Record Length,120", "", "Labels,,,", ""]


def knows(write: Write, **known: Known) -> Write:
    """The same, of which the owner knows more."""

    def more(path: Path, data: Columns) -> Written:
        made = write(path, data)
        return Written(made.words, {**made.known, **known}, made.columns)

    return more


def timeless(file: str, save: Save, words: Sequence[str] = ()) -> Write:
    """One run without times; the file states how far apart samples are."""
    return one_run(knows(saved(file, save, words=words, without=("t_s",)), t_s=Known("t", "s")))


def name_by_name(names: list[str]) -> str:
    """A header of comments, as controllers of PI write: a line for each name."""
    lines = [f"# NAME{k} = {name}" for k, name in enumerate(names)]
    return "\n".join(
        ["# VERSION = 1", f"# DIM = {len(names)}", "# SAMPLE_TIME = 0.005", *lines, "# END_HEADER"]
    )


def reading_buffer(file: Path, columns: Columns) -> None:
    """A row for each reading of a scanning instrument: its channel, value, unit, and times."""
    (_, _, times), *channels = named(columns)
    rows = [(float(t), name, unit, float(x[k])) for k, t in enumerate(times) for name, unit, x in channels]
    text()(file, {"Index": range(1, len(rows) + 1), "Reading": [r[3] for r in rows],
                  "Unit": [r[2] for r in rows], "Digits": [6.5] * len(rows), "Channel": [r[1] for r in rows],
                  "Fractional Seconds": [r[0] % 1 for r in rows],
                  "Relative Time": [r[0] / 1e3 for r in rows]})  # fmt: skip


def json_channels(file: Path, columns: Columns) -> None:
    """An object for each channel, with its name, unit and values."""
    channels = [{"name": name, "unit": unit, "data": x.tolist()} for name, unit, x in named(columns)]
    file.write_text(json.dumps({"header": {"sampleRate": 200}, "channels": channels}))


def scope_structure(file: Path, columns: Columns) -> None:
    """Simulink's structure with time: a struct for each signal, with its label and values."""
    from scipy.io import savemat

    time = columns.pop("time_s")
    signals = [{"label": name, "values": x[:, None], "plotStyle": [0.0, 0.0]} for name, x in columns.items()]
    savemat(file, {"ScopeData": {"time": time[:, None], "signals": signals}})


def stamped(path: Path, data: Columns) -> Written:
    """Messages of ROS as text: whole seconds and nanoseconds, fields of fields, elements of arrays."""
    seconds = np.floor(data["t_s"])
    columns = {
        "header.stamp.sec": 1.8e9 + seconds,
        "header.stamp.nanosec": np.round(1e9 * (data["t_s"] - seconds)),
    }
    columns |= {f"hall[{k}]": within(data[c], "um") for k, c in enumerate(HALLS)}
    fields = ("pose.z", "pose.roll", "pose.pitch", "laser.x", "laser.y", "laser.yaw")
    names = dict(zip((*VERTICAL, *LASER), fields, strict=True))
    text(number="{:.12g}".format)(path / "bag.csv", {**columns, **{n: data[c] for c, n in names.items()}})
    known = {"t_s": Known("header.stamp", "s")} | {c: Known(f"hall {k}", "um") for k, c in enumerate(HALLS)}
    return Written([str(path / "bag.csv")], known | {c: Known(n) for c, n in names.items()}, {
        c: x for c, x in data.items() if c != "run"})  # fmt: skip


def line_protocol(file: Path, columns: Columns) -> None:
    """Lines of InfluxDB: a name and tags, fields, the moment in nanoseconds."""
    run, t = columns.pop("Run"), columns.pop("(column 13)")
    fields = [",".join(f"{n}={usual(x[k])}" for n, x in columns.items()) for k in range(len(t))]
    moments = 18 * 10**17 + np.round(1e9 * (100 * run + t)).astype(np.int64)
    lines = [f"stage,rig=R4,run={run[k]:.0f} {fields[k]} {moments[k]}" for k in range(len(t))]
    file.write_text("\n".join([*lines, ""]))


def words_above_names(file: Path, columns: Columns) -> None:
    """Columns of pandas with several levels: what it is of, its name, its unit."""
    levels = [(*(name.split() if " " in name else ("log", name)), unit) for name, unit, _ in named(columns)]
    head = "\n".join(map(",".join, zip(*levels, strict=True)))
    text(head=lambda _: head)(file, columns)


FILES: dict[str, LabFile] = {
    "a struct for each signal": LabFile(one_run(saved("scope.mat", scope_structure, SNAKE, UNDER | {
        "t_s": "time"}, UNIT | {"t_s": "s"}))),
    "stamps of ROS": LabFile(one_run(stamped)),
    "line protocol": LabFile(saved("influx.txt", line_protocol, SNAKE, UNDER | {"t_s": "(column 13)"},
                                   UNIT | {"t_s": ""})),
    "words above names": LabFile(saved("levels.csv", words_above_names, ASIDE)),
    "no units": LabFile(saved("plain.csv", text(), "{name}", units={**UNIT, "t_s": "s"})),
    "line breaks in names": LabFile(saved("quoted.csv", text(", "), '"{name}\n[{unit}]"')),
    "oscilloscope": LabFile(one_run(of_columns("scope.csv", SCOPE, text(
        head=lambda names: ",".join(names) + "\nsecond,Volt,Volt,deg", number="{:.10E}".format))), "rotary"),
    "LabVIEW measurement": LabFile(knows(saved(
        "stage.lvm", text("\t", head=of_labview, number=comma, end="\r\n"), ASIDE,
        clock=("X_Value", as_it_is), after={"Comment": lambda n: [""] * n}), t_s=Known("X_Value", "s"))),
    "counts with scale and offset": LabFile(counts, within=2.0),
    "runs side by side": LabFile(wide("{name}_run{run}_{plain}", {c: stem(c) for c in UNIT}, clock="t_ms")),
    "runs side by side, own clocks": LabFile(wide("{name} #{run} [{unit}]", by=";")),
    "runs side by side, one shorter": LabFile(wide("Run {run} {name} [{unit}]", clock="t_ms", short=7),
                                              within=3.0),
    "folder of runs": LabFile(each_run("session 3/run{k}.csv", "session 3", text(above="# a run\n"),
                                       note="README.md")),
    "pattern of runs": LabFile(each_run("2026-02-0{day}_1{hour}h30.csv", "2026-*.csv", text(),
                                        "{name}_{unit}", JOINED)),
    "two files, moments": LabFile(two_rates(moments=True), within=6.0),
    "HDF5, attributes": LabFile(saved("daq.h5", hdf5("channels/{name}", "Unit"), ASIDE)),
    "HDF5, records": LabFile(saved("records.h5", hdf5_records, SNAKE, JOINED)),
    "MATLAB matrices": LabFile(matrices),
    "MATLAB array of structs": LabFile(saved("lab.mat", matlab, SNAKE, UNDER)),
    "parquet": LabFile(saved("lake.parquet", arrow, ASIDE)),
    "averaged counts": LabFile(maker_table, "chip", within=0.2),
    "voltages in counts": LabFile(of_columns("serial.csv", SERIAL, text()), "rotary", within=2.0),
    "an encoder without units": LabFile(one_run(of_columns("turn.dat", UNITLESS_TURN, text(" "))), "rotary"),
    "millivolts": LabFile(board(places=True), "halbach"),
    "labels above names": LabFile(one_run(of_columns("tek.csv", TEKTRONIX, text(above="\n".join(SETTINGS)))),
                                  "rotary"),
    "a scope's increment": LabFile(one_run(of_columns("rigol.csv", RIGOL, text(
        head=lambda names: ",".join(names) + ",Start,Increment\nSequence,Volt,Volt,Volt,0.0,5e-3",
        last=",,"))), "rotary"),
    "channels by number": LabFile(one_run(of_columns("analog.csv", CHANNELS, text())), "rotary"),
    "a clock for each channel": LabFile(one_run(saved("scope.csv", own_clocks, ASIDE))),
    "channels in their own rows": LabFile(saved("bus.csv", own_rows), within=0.2),
    "names in a line each": LabFile(timeless("rec0.dat", text(" ", head=name_by_name))),
    "LabVIEW without times": LabFile(one_run(saved(
        "noX.lvm", text("\t", head=of_labview, number=comma), ASIDE,
        clock=("X_Value", lambda t: [""] * len(t)), after={"Comment": lambda n: [""] * n}))),
    "a stated rate, npz": LabFile(timeless("rate.npz", lambda file, columns: np.savez(
        file, fs=200.0, data=np.column_stack([*columns.values()]), labels=np.array([*columns])))),
    "a channel in each row": LabFile(one_run(knows(
        saved("buffer.csv", reading_buffer, ASIDE), t_s=Known("Relative Time", "s")))),
    "JSON, an object a channel": LabFile(timeless("channels.json", json_channels, ("--format", "json"))),
    "JSON, an object a channel with its unit": LabFile(saved("daq.json", json_channels, ASIDE)),
    "segments of LabVIEW": LabFile(segments),
    "a file for each channel": LabFile(one_run(file_per_channel), "rotary"),
    "merged cells": LabFile(saved("merged.xlsx", merged_cells)),
    "a row per run": LabFile(saved("lake.parquet", row_per_run, SNAKE, UNDER)),
    "names behind a word in a comment": LabFile(saved("ids.txt", text(
        " ", above="# axis 1 = x\n", head=lambda names: "# columns: " + ", ".join(names)), SNAKE, UNDER)),
    "Chinese": LabFile(saved("数据.csv", text(encoding="gb18030"), "{name}({plain})", CHINESE)),
    "HDF5, a matrix with names": LabFile(saved("matrix.h5", hdf5_matrix, ASIDE)),
    "lists and records": LabFile(knows(
        saved("lists.parquet", lists_and_records, SNAKE, OURS),
        **{c: Known(f"hall_{k}", "um") for k, c in enumerate(HALLS)})),
    "JSON lines with dates": LabFile(saved("mqtt.jsonl", json_rows, SNAKE, UNDER,
                                           clock=("timestamp", stamps))),
    "JSON, an object a run": LabFile(saved("runs.jsonl", json_runs, SNAKE, OURS)),
    "counts and microsteps": LabFile(of_columns("stepper.csv", STEPPER, text()), "chip", within=3.0),
    "MATLAB 7.3": LabFile(matlab_73),
    "a sheet with two tables": LabFile(saved("mixed.xlsx", two_tables)),
    "zip": LabFile(saved("runs.zip", archive)),
    "a row per value": LabFile(saved("series.csv", row_per_value, SNAKE,
                                     {c: n.lower() for c, n in UNDER.items()}, clock=("time_s", as_it_is))),
    "one series after the other": LabFile(saved("influx.csv", annotated_series, SNAKE, {
        c: n.lower() for c, n in UNDER.items()}, clock=("_time", stamps))),
    "no height, no tilts": LabFile(saved("flat.csv", text(), without=VERTICAL)),
    "a column of words, lost samples": LabFile(saved("status.csv", lost_samples, after={
        "Status": lambda n: ["OK"] * n}), says=("--drop-bad",)),
    "a board of unknown layout": LabFile(board(places=False), "halbach", says=("layout", "places")),
    "no reference": LabFile(saved("readings.csv", text(), without=LASER), says=("reference", "x_ref")),
    "two files of other hours": LabFile(two_rates(later=4e6), says=("overlap in time",)),
    "a folder with another table": LabFile(
        each_run("scans/scan_{k}.csv", "scans", text(), "{name}_{plain}", JOINED, "summary.csv"),
        says=("must have the same columns to be runs; summary",)),
}  # fmt: skip
"""Those that `say` something have no answer without a decision: a true sentence is right."""


# -- a person who obeys --------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """Whether it ended right, else why not, and all that was printed."""

    right: bool
    why: str
    printed: str


def run(words: Sequence[str]) -> tuple[int, str, str]:
    """Run a command in this process -> exit code, what it printed, what it said on stderr."""
    from hallsym.cli.main import main

    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = main(list(words))
        except SystemExit as left:
            code = int(left.code or 0)
    return code, out.getvalue(), err.getvalue()


def completed(path: Path, known: Mapping[str, Known]) -> None:
    """Choose the lines of a column file that are right, add scale, offset and missing columns."""
    lines, have = [], set()
    text = path.read_text(encoding="utf-8")
    for line in text.split("\n"):
        match = re.match(r"(# )?([a-z]\w*) = (.*)", line)
        own = match and next((c for c in known if stem(c) == stem(match[2])), None)
        if not match or own is None:
            lines.append(line)
            continue
        offered, ours, entry = match[1] is not None, match[2], match[3]
        if own not in have and fits(known[own], own, ours, entry):
            have.add(own)
            lines.append(f"{ours} = {in_counts(entry, known[own])}")
        else:
            lines.append(line if offered else f"# {line}")
    as_they_are = next((line for line in lines if line.startswith("# read as they are: ")), "")
    for column, about in known.items():
        if column not in have and not any(stem(w) == stem(column) for w in re.findall(r"\w+", as_they_are)):
            ours = "run" if column == "run" else f"{stem(column)}_{about.unit or column.rpartition('_')[2]}"
            entry = json.dumps(about.name, ensure_ascii=False)
            if about.unit == "count":
                lines.insert(0, f"counts_per_turn = {about.scale}")
            elif about.scale is not None:
                entry = f"{{ name = {entry}, scale = {about.scale!r}, offset = {about.offset!r} }}"
            lines.append(f"{ours} = {entry}")
    path.write_text("\n".join(lines), encoding="utf-8")


def fits(about: Known, own: str, ours: str, entry: str) -> bool:
    """Whether a line names the owner's column in the owner's unit. `t` is what a rate makes of time."""
    quoted = re.search(r'"(.*?)"', entry)
    name, theirs = set(words_in(about.name)), set(words_in(quoted[1] if quoted else ""))
    more = {
        word for word in theirs - name if len(word) == 1 or word.isdigit()
    }  # another one's letter or number
    named = (name <= theirs and not more) or (theirs <= name and theirs) or theirs == {"t"}
    right = about.unit or own.rpartition("_")[2]
    return bool(named) and (own == "run" or ours.rpartition("_")[2] == right or theirs == {"t"})


def in_counts(entry: str, about: Known) -> str:
    """Return an entry with the owner's scale and offset."""
    if about.scale is None or about.unit == "count":
        return entry
    name = re.search(r'"(.*?)"', entry)
    return f'{{ name = "{name[1]}", scale = {about.scale!r}, offset = {about.offset!r} }}' if name else entry


def words_in(text: str) -> list[str]:
    """Return words and numbers of a name, in small letters: `HallA [um]` has hall, a, um."""
    return [w.lower() for w in re.findall(r"[A-ZÄÖÜ]?[^\W\d_A-ZÄÖÜ]+|[A-ZÄÖÜ]|\d+", text)]


def obeyed(name: str, folder: Path) -> Outcome:
    """Write a file, fit it, and do what is printed, at most twice."""
    lab, here = FILES[name], Path.cwd()
    data = recording(lab.family)
    written = lab.write(folder, data)
    truth = written.columns or data
    os.chdir(folder)
    printed, steps = [], 0
    try:
        words = ["fit", *written.words]
        while True:
            json_too = ["--solver", "direct", "--json"] if words[0] == "fit" else []
            code, out, err = run([*words, *json_too])
            text = err if json_too else out + err
            printed.append(f"$ hallsym {shlex.join(words)}  [{code}]\n{text}")
            if words[0] == "fit" and (code in (0, 3, 4) or steps == 2):
                break
            if words[0] == "info":
                if code != 0:
                    break
                file = next((Path(w) for w in words if w.endswith(".toml")), Path("columns.toml"))
                completed(file, written.known)
                printed.append(file.read_text(encoding="utf-8"))
            following = next_command(text, written.words)
            if following is None or steps == 2:
                following = ["info", *info_words(written.words)] if words[0] == "fit" else None
            if following is None:
                break
            if following[0] == "fit" and "--machine" in written.words and "--machine" not in following:
                following = [*following, *written.words[written.words.index("--machine") :]]
            steps, words = steps + 1, following
    finally:
        os.chdir(here)
    everything = "\n".join(printed)
    why = told(lab, truth, out) if words[0] == "fit" and code in (0, 3, 4) else "no fit"
    if lab.says:
        right = any(word in everything + out for word in lab.says)
        return Outcome(right, "" if right else why, everything)
    return Outcome(not why, why, everything)


def next_command(text: str, files: Sequence[str]) -> list[str] | None:
    """Return the words of the command that is printed to be run next, with the files' names put in."""
    found = re.findall(r"next: hallsym ((?:.|\n )+?)(?:\n\S|\n?$)", text)
    found = found or re.findall(r"'hallsym ((?:fit|info) [^\n]*?)'(?=[ .,;)]|$)", text)
    if not found:
        return None
    words = shlex.split(" ".join(found[-1].split()))
    files = info_words(files)[:-2] if words[0] == "info" else files
    return [w for word in words for w in (files if word in ("LOG", "FILE") else [word])]


def info_words(words: Sequence[str]) -> list[str]:
    """Return the words of `hallsym info` for a file, which wants no machine."""
    at = words.index("--machine") if "--machine" in words else len(words)
    return [*words[:at], *words[at + 2 :], "--write", "columns.toml"]


def told(lab: LabFile, truth: Columns, out: str) -> str:
    """Return what is wrong with a calibration, "" if it is that of the recording itself."""
    try:
        found = json.loads(out)
        log = Log.from_arrays(truth, None, Meta(probes=_machine(lab.family).probes))
        wanted = hallsym.fit(log, found["model"], solver="direct")
    except (ValueError, hallsym.InputError) as error:
        return f"{error}"[:200]
    runs, rows = len(np.unique(truth.get("run", [0]))), len(next(iter(truth.values())))
    if found["log"]["runs"] != runs or found["log"]["rows"] < 0.95 * rows:
        return f"{found['log']['rows']} samples in {found['log']['runs']} runs, of {rows} in {runs}"
    off = []
    for name, value, std in zip(wanted.model.names, wanted.values, wanted.std, strict=True):
        entry = found["parameters"].get(name)
        if entry is None:
            return f"no parameter {name}"
        if entry["determined"] and np.isfinite(std) and std > 0:
            off.append((abs(entry["value"] - value) / std, name))
    far, name = max(off, default=(0.0, ""))
    return "" if far <= lab.within else f"{name} is {far:.3g} standard deviations off"
