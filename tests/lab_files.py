"""Files as laboratories have them, each with the right answer, and a person who obeys what is printed.

Every file holds a recording of `recordings`, as another instrument or program writes it, and what its owner
knows: of each column their name and unit, of counts their scale and offset. `obeyed` does what the messages
of `hallsym fit` and `hallsym info --write` say, at most twice, and tells whether the calibration is that of
the recording itself.

    python tests/lab_files.py            every file, one line each
    python tests/lab_files.py NAME...    these, with all that was printed
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
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from recordings import Recording, Size, machine

import hallsym
from hallsym.log import Log, Meta
from hallsym.units import UNITS

Columns = dict[str, np.ndarray]
SHORT = Size(8, 120, 5e-3)


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


@dataclass(frozen=True)
class LabFile:
    """A file: which recording it holds, how it is written, and how exactly.

    `says`: where no program can know, the words that a true sentence has, one of them.
    """

    write: Callable[[Path, Columns], Written]
    family: str = "stage31"
    within: float = 0.05
    says: tuple[str, ...] = ()
    effects: tuple[str, ...] = field(default=())


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
UNIT = {
    "t_s": "ms", **dict.fromkeys(("hall_a_m", "hall_b_m", "hall_c_m"), "um"), "z_m": "um",
    "rx_rad": "urad", "ry_rad": "urad", "x_ref_m": "um", "y_ref_m": "um", "rz_ref_rad": "urad",
}  # fmt: skip


def theirs(
    data: Columns,
    form: str = "{name} [{unit}]",
    names: Mapping[str, str] = NAMES,
    units: Mapping[str, str] = UNIT,
) -> tuple[Columns, dict[str, Known]]:
    """Return columns under other names and in other units, and what is known of them."""
    out, known = {}, {}
    for column, values in data.items():
        unit = units.get(column, "")
        name = form.format(name=names[column], unit=SYMBOL.get(unit, unit)) if unit else names[column]
        out[name] = within(values, unit)
        known[column] = Known(names[column], unit)
    return out, known


SYMBOL = {"um": "µm", "urad": "µrad", "deg": "°", "v": "V", "mv": "mV"}


def table(
    path: Path,
    columns: Mapping[str, Sequence],
    by: str = ",",
    *,
    head: str | None = None,
    above: str = "",
    number: Callable[[float], str] = "{:.10g}".format,
    encoding: str = "utf-8",
    end: str = "\n",
    last: str = "",
) -> str:
    """Write a table of text. `head`: in place of the line of names; `last`: what ends each line."""
    lines = [by.join(columns) if head is None else head]
    lines += [by.join(map(number, row)) + last for row in zip(*columns.values(), strict=True)]
    path.write_bytes((above + end.join(lines) + end).encode(encoding))
    return str(path)


def runs_of(data: Columns) -> list[Columns]:
    """Return the recording run by run, without `run`, each with a clock that begins at 0."""
    parts = []
    for run in np.unique(data["run"]):
        part = {c: x[data["run"] == run] for c, x in data.items() if c != "run"}
        parts.append({**part, "t_s": part["t_s"] - part["t_s"][0]})
    return parts


# -- text --------------------------------------------------------------------------------------------------


def comma_decimals(path: Path, data: Columns) -> Written:
    """Semicolons and decimal commas, as Excel writes in most of Europe; Latin-1 and words of German."""
    names = dict(NAMES) | {"t_s": "Zeit", "z_m": "Höhe", "x_ref_m": "Interferometer X",
                           "y_ref_m": "Interferometer Y", "rz_ref_rad": "Interferometer Rz"}  # fmt: skip
    columns, known = theirs(data, "{name} ({unit})", names)

    def number(x):
        return f"{x:.9g}".replace(".", ",")

    return Written([table(path / "Messung.csv", columns, ";", number=number, encoding="latin-1", end="\r\n")],
                   known)  # fmt: skip


def excel_text(path: Path, data: Columns) -> Written:
    """Excel's Unicode text: UTF-16 with a byte order mark, tabs."""
    columns, known = theirs(data)
    return Written([table(path / "export.txt", columns, "\t", encoding="utf-16", end="\r\n")], known)


def separator_line(path: Path, data: Columns) -> Written:
    """A hint for Excel in the first line, a byte order mark, and a separator behind the last column."""
    columns, known = theirs(data, "{name} / {unit}")
    file = table(path / "log.csv", columns, ";", above="\ufeffsep=;\r\n", head=";".join(columns) + ";",
                 last=";", end="\r\n")  # fmt: skip
    return Written([file], known)


def units_below(path: Path, data: Columns) -> Written:
    """Units in parentheses in a second row, tabs, remarks above."""
    columns, known = theirs(data, "{name}")
    units = "\t".join(f"({k.unit})" if k.unit else "" for k in known.values())
    above = "# stage 12, probes re-seated on Monday\n# operator: M.\n"
    return Written(
        [table(path / "stage12.tsv", columns, "\t", head="\t".join(columns) + "\n" + units, above=above)],
        known,
    )


def comment_header(path: Path, data: Columns) -> Written:
    """numpy.savetxt: blanks, the names in the last line that begins with #."""
    names = {c: NAMES[c].replace(" ", "_") for c in NAMES}
    columns, known = theirs(data, "{name}_{unit}", names, UNIT)
    plain = {n.replace("µ", "u"): x for n, x in columns.items()}
    head = "# saved by rig.py\n# " + " ".join(plain)
    return Written([table(path / "run.dat", plain, " ", head=head, number="{:.12e}".format)], known)


def unitless(path: Path, data: Columns) -> Written:
    """Micrometres and microradians that nothing states."""
    columns, known = theirs(data, "{name}", units={**UNIT, "t_s": "s"})
    return Written([table(path / "plain.csv", columns)], known)


def quoted_names(path: Path, data: Columns) -> Written:
    """Names in quotes that hold a line break before the unit, blanks behind commas."""
    columns, known = theirs(data, '"{name}\n[{unit}]"')
    return Written([table(path / "quoted.csv", columns, ", ")], known)


def clock_times(path: Path, data: Columns) -> Written:
    """The time of day in each row, to the microsecond."""
    start = np.datetime64("2026-03-02T23:59:58", "us")
    stamps = start + np.round(data["t_s"] * 1e6).astype("timedelta64[us]")
    columns, known = theirs({c: x for c, x in data.items() if c != "t_s"})
    whole = {"Timestamp": np.array([str(s).replace("T", " ") for s in stamps]), **columns}
    file = table(path / "logger.csv", whole, number=lambda x: x if isinstance(x, str) else f"{x:.10g}")
    return Written([file], {**known, "t_s": Known("Timestamp")})


def compressed(path: Path, data: Columns) -> Written:
    """CSV that gzip made smaller."""
    columns, known = theirs(data)
    file = Path(table(path / "log.csv", columns))
    (path / "log.csv.gz").write_bytes(gzip.compress(file.read_bytes()))
    file.unlink()
    return Written([str(path / "log.csv.gz")], known)


def gnuplot_blocks(path: Path, data: Columns) -> Written:
    """A block of lines for each run, an empty line or two between them."""
    columns, known = theirs({c: x for c, x in data.items() if c != "run"}, "{name}_{unit}",
                            {c: NAMES[c].replace(" ", "_") for c in NAMES})  # fmt: skip
    lines = ["# " + " ".join(columns)]
    for part in runs_of(data):
        values = zip(*(within(x, UNIT[c]) for c, x in part.items()), strict=True)
        lines += [" ".join(f"{x:.10g}" for x in row) for row in values] + ["", ""]
    (path / "blocks.dat").write_text("\n".join(lines), encoding="utf-8")
    return Written([str(path / "blocks.dat")], known)


def scope(path: Path, data: Columns) -> Written:
    """Two lines of names: what a column is, then its unit, as oscilloscopes write."""
    known = {"t_s": Known("x-axis", "s"), "v_sin_v": Known("SIN", "v"), "v_cos_v": Known("COS", "v"),
             "angle_ref_rad": Known("REF", "deg")}  # fmt: skip
    parts = runs_of(data)
    values = {c: np.concatenate([p[c] for p in parts[:1]]) for c in known}
    columns = {k.name: within(values[c], k.unit) for c, k in known.items()}
    file = table(path / "scope.csv", columns, head="x-axis,SIN,COS,REF\nsecond,Volt,Volt,deg",
                 number="{:.10E}".format)  # fmt: skip
    return Written([file], known, values)


def labview(path: Path, data: Columns) -> Written:
    """A LabVIEW measurement file with decimal commas, a header, and X_Value for the time."""
    columns, known = theirs({c: x for c, x in data.items() if c != "t_s"}, "{name}")
    units = "\t".join(k.unit for k in known.values())
    seconds = {"X_Value": data["t_s"], **columns, "Comment": [""] * len(data["run"])}
    head = (
        "LabVIEW Measurement\t\r\nWriter_Version\t2\r\nReader_Version\t2\r\nSeparator\tTab\r\n"
        "Decimal_Separator\t,\r\nMulti_Headings\tNo\r\nX_Columns\tOne\r\nTime_Pref\tRelative\r\n"
        "***End_of_Header***\t\r\n\t\r\n"
        f"Channels\t{len(columns)}\r\nSamples\t{len(data['run'])}\r\nY_Unit_Label\t{units}\r\n"
        "X_Dimension\tTime\r\nX0\t0,0000000000000000E+0\r\nDelta_X\t0,005000\r\n***End_of_Header***\t\t\r\n"
    )

    def number(x):
        return x if isinstance(x, str) else f"{x:.9g}".replace(".", ",")

    file = table(path / "stage.lvm", seconds, "\t", above=head, number=number, end="\r\n")
    return Written([file], {**known, "t_s": Known("X_Value", "s")})


def group_paths(path: Path, data: Columns) -> Written:
    """Names that are paths of groups: `Root/Hall/A` is no ampere."""
    names = {c: f"Root/Hall/{n[-1]}" if c.startswith("hall") else f"Root/{n.replace(' ', '/')}"
             for c, n in NAMES.items()}  # fmt: skip
    columns, known = theirs(data, "{name}", names)
    return Written([table(path / "export.csv", columns)], known)


def counts(path: Path, data: Columns) -> Written:
    """Readings as counts of a converter, its scale and offset in a remark above."""
    columns, known = theirs(data)
    for c in ("hall_a_m", "hall_b_m", "hall_c_m"):
        del columns[f"{NAMES[c]} [µm]"]
        columns[NAMES[c] + " [counts]"] = np.round((1e6 * data[c] + 1500) / 0.05)
        known[c] = Known(NAMES[c], "um", 0.05, -1500.0)
    return Written(
        [table(path / "adc.csv", columns, above="# Hall: 0.05 um per count, offset -1500 um\n")], known
    )


# -- runs --------------------------------------------------------------------------------------------------


def wide(path: Path, data: Columns) -> Written:
    """Runs side by side, with a clock in common."""
    parts = runs_of(data)
    columns: dict[str, np.ndarray] = {"t_ms": 1e3 * parts[0]["t_s"]}
    for run, part in enumerate(parts):
        for c, x in part.items():
            if c != "t_s":
                stem, si = c.rpartition("_")[::2]
                columns[f"{stem}_run{run}_u{si}"] = 1e6 * x
    return Written(
        [table(path / "wide.csv", columns)], {c: Known(c.rpartition("_")[0], UNIT[c]) for c in parts[0]}
    )


def wide_clocks(path: Path, data: Columns) -> Written:
    """Runs side by side, each with a clock of its own, units in brackets."""
    columns = {}
    for run, part in enumerate(runs_of(data), 1):
        for c, x in part.items():
            columns[f"{NAMES[c]} #{run} [{SYMBOL.get(UNIT[c], UNIT[c])}]"] = within(x, UNIT[c])
    return Written([table(path / "sheet.csv", columns, ";")], {c: Known(NAMES[c], UNIT[c]) for c in UNIT})


def folder_of_runs(path: Path, data: Columns) -> Written:
    """One file a run, numbered without leading zeros; a note beside them."""
    folder = path / "session 3"
    folder.mkdir()
    for run, part in enumerate(runs_of(data)):
        columns, known = theirs(part)
        table(folder / f"run{run + 4}.csv", columns, above=f"# run {run + 4}\n")
    (folder / "README.md").write_text("Probes re-seated before run 4.\n")
    return Written([str(folder)], known)


def pattern_of_runs(path: Path, data: Columns) -> Written:
    """One file a run, named by the day and hour; chosen by a pattern."""
    for run, part in enumerate(runs_of(data)):
        columns, known = theirs(part, "{name}_{unit}", {c: NAMES[c].replace(" ", "") for c in NAMES})
        table(path / f"2026-02-0{run // 4 + 1}_1{run % 4}h30.csv", columns)
    return Written([str(path / "2026-*.csv")], known)


def run_names(path: Path, data: Columns) -> Written:
    """Runs that have names instead of numbers."""
    columns, known = theirs(data)
    columns["Run"] = np.array([f"R{int(k) + 1:02d}" for k in data["run"]])
    file = table(path / "named.csv", columns, number=lambda x: x if isinstance(x, str) else f"{x:.10g}")
    return Written([file], known)


def two_rates(path: Path, data: Columns) -> Written:
    """Halls in one file, the reference in another, twice as fast and from another start."""
    halls: dict[str, list] = {}
    laser: dict[str, list] = {}
    for run, part in enumerate(runs_of(data)):
        begin = 3.0 * run + 100
        step = float(part["t_s"][1])
        fine = np.arange(-4, 2 * len(part["t_s"]) + 4) * step / 2 + 0.1 * step
        for c, x in part.items():
            if c.endswith("ref_m") or c.endswith("ref_rad"):
                laser.setdefault(NAMES[c] + f" [{UNIT[c]}]", []).append(1e6 * np.interp(fine, part["t_s"], x))
            elif c != "t_s":
                halls.setdefault(NAMES[c] + f" [{UNIT[c]}]", []).append(1e6 * x)
        halls.setdefault("Run", []).append(np.full(len(part["t_s"]), run))
        halls.setdefault("Time [s]", []).append(begin + part["t_s"])
        laser.setdefault("Time [s]", []).append(begin + fine)
    words = [table(path / f"{name}.csv", {c: np.concatenate(x) for c, x in columns.items()})
             for name, columns in (("halls", halls), ("laser", laser))]  # fmt: skip
    known = {c: Known(NAMES[c], "s" if c == "t_s" else u) for c, u in UNIT.items()}
    return Written([words[0], "--join", words[1]], known | {"run": Known("Run")})


# -- binary ------------------------------------------------------------------------------------------------


def workbook(path: Path, data: Columns) -> Written:
    """A sheet whose table begins in B4 under a title, with a row of units; notes on another sheet."""
    import xlsxwriter

    columns, known = theirs(data, "{name}")
    book = xlsxwriter.Workbook(str(path / "stage.xlsx"))
    notes, page = book.add_worksheet("Notes"), book.add_worksheet("Data")
    notes.write_column(0, 0, ["Operator", "M.", "Room 12"])
    page.write(0, 1, "Stage 12, calibration")
    for k, ((name, x), about) in enumerate(zip(columns.items(), known.values(), strict=True), 1):
        page.write_column(3, k, [name, f"[{about.unit}]" if about.unit else "", *x.tolist()])
    book.close()
    return Written([str(path / "stage.xlsx"), "--sheet", "Data"], known)


def hdf5_groups(path: Path, data: Columns) -> Written:
    """HDF5 of an acquisition program: a group a channel, its values in `data`, the unit an attribute."""
    import h5py

    columns, known = theirs(data, "{name}")
    with h5py.File(path / "daq.h5", "w") as file:
        file.attrs["operator"] = "M."
        for (name, x), about in zip(columns.items(), known.values(), strict=True):
            made = file.create_dataset(f"channels/{name}", data=x, compression="gzip", shuffle=True)
            if about.unit:
                made.attrs["Unit"] = np.bytes_(about.unit)
    return Written([str(path / "daq.h5")], known)


def hdf5_table(path: Path, data: Columns) -> Written:
    """HDF5 with one dataset of records, as PyTables and LabVIEW write."""
    import h5py

    columns, known = theirs(data, "{name}_{unit}", {c: NAMES[c].replace(" ", "") for c in NAMES})
    plain = {n.replace("µ", "u"): x for n, x in columns.items()}
    record = np.rec.fromarrays(list(plain.values()), names=list(plain))
    with h5py.File(path / "records.h5", "w") as file:
        file["measurement/log"] = record
    return Written([str(path / "records.h5")], known)


def tdms(path: Path, data: Columns) -> Written:
    """TDMS: a group Hall with the channels A, B, C, units as properties, a rate as a property."""
    from nptdms import ChannelObject, TdmsWriter

    groups = {c: ("Hall", n[-1]) if c.startswith("hall") else ("Stage", n) for c, n in NAMES.items()}
    with TdmsWriter(str(path / "daq.tdms")) as writer:
        for c, x in data.items():
            unit = UNIT.get(c, "")
            about = {"wf_increment": 5e-3, "wf_start_offset": 0.0} | ({"unit_string": unit} if unit else {})
            writer.write_segment([ChannelObject(*groups[c], within(x, unit), properties=about)])
    return Written([str(path / "daq.tdms")], {c: Known("/".join(groups[c]), UNIT.get(c, "")) for c in data})


def mdf(path: Path, data: Columns) -> Written:
    """MDF 4 of a data logger, units of the channels stated."""
    from asammdf import MDF, Signal

    columns, known = theirs(data, "{name}")
    signals = [Signal(x, data["t_s"] - data["t_s"][0], name=n.replace(" ", "_"), unit=known[c].unit)
               for (n, x), c in zip(columns.items(), known, strict=True) if c != "t_s"]  # fmt: skip
    with MDF(version="4.10") as file:
        file.append(signals, comment="stage")
        file.save(path / "logger.mf4", overwrite=True)
    return Written(
        [str(path / "logger.mf4")], {c: Known(k.name.replace(" ", "_"), k.unit) for c, k in known.items()}
    )


def matrices(path: Path, data: Columns) -> Written:
    """MATLAB: N x 3 matrices, a row vector of times, no unit in any name."""
    from scipy.io import savemat

    def inside(*cs):
        return np.stack([within(data[c], UNIT[c]) for c in cs], axis=1)

    savemat(path / "stage.mat", {
        "run": data["run"][None, :].astype(float), "t": 1e3 * data["t_s"][None, :],
        "hall": inside("hall_a_m", "hall_b_m", "hall_c_m"), "ref": inside("x_ref_m", "y_ref_m", "rz_ref_rad"),
        "vertical": inside("z_m", "rx_rad", "ry_rad"),
    })  # fmt: skip
    known = {"run": Known("run"), "t_s": Known("t", "ms")}
    matrices_of = {
        "hall": ("hall_a_m", "hall_b_m", "hall_c_m"),
        "vertical": ("z_m", "rx_rad", "ry_rad"),
        "ref": ("x_ref_m", "y_ref_m", "rz_ref_rad"),
    }
    for name, cs in matrices_of.items():
        known |= {c: Known(f"{name}_{k}", UNIT[c]) for k, c in enumerate(cs)}
    return Written([str(path / "stage.mat")], known)


def matlab_struct(path: Path, data: Columns) -> Written:
    """MATLAB: one struct with a field for each column."""
    from scipy.io import savemat

    columns, known = theirs(data, "{name}_{unit}", {c: NAMES[c].replace(" ", "_") for c in NAMES})
    savemat(
        path / "log.mat",
        {"log": {n.replace("µ", "u"): x[:, None] for n, x in columns.items()}, "rate": 200.0},
    )
    return Written([str(path / "log.mat")], known)


def numpy_arrays(path: Path, data: Columns) -> Written:
    """npz with names of variables, one of them a matrix."""
    halls = np.stack([1e6 * data[f"hall_{k}_m"] for k in "abc"], axis=1)
    others = [c for c in UNIT if not c.startswith("hall")]
    rest = {f"{stem(c)}_{UNIT[c]}": within(data[c], UNIT[c]) for c in others}
    np.savez(path / "log.npz", run=data["run"], hall_um=halls, **rest, sample_rate=200.0)
    known = {"run": Known("run")} | {c: Known(stem(c), UNIT[c]) for c in others}
    known |= {f"hall_{k}_m": Known(f"hall_um_{i}", "um") for i, k in enumerate("abc")}
    return Written([str(path / "log.npz")], known)


def feather(path: Path, data: Columns) -> Written:
    """Feather of a data frame, whose index is written too."""
    import pyarrow as pa
    from pyarrow import feather as arrow

    columns, known = theirs(data, "{name} ({unit})")
    whole = {**columns, "__index_level_0__": np.arange(len(data["run"]))}
    arrow.write_feather(pa.table(whole), path / "frame.feather")
    return Written([str(path / "frame.feather")], known)


def json_lines(path: Path, data: Columns) -> Written:
    """JSON lines, with objects in objects."""
    lines = []
    for k in range(len(data["run"])):
        at = {c: float(within(x[k], UNIT.get(c, ""))) for c, x in data.items()}
        lines.append(json.dumps({
            "run": int(at["run"]), "t_ms": at["t_s"], "hall_um": {i: at[f"hall_{i}_m"] for i in "abc"},
            "ref": {"x_um": at["x_ref_m"], "y_um": at["y_ref_m"], "rz_urad": at["rz_ref_rad"]},
            "z_um": at["z_m"], "rx_urad": at["rx_rad"], "ry_urad": at["ry_rad"],
        }))  # fmt: skip
    (path / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    known = {c: Known(c.rpartition("_")[0], u) for c, u in UNIT.items()}
    return Written([str(path / "log.jsonl")], known | {"run": Known("run")})


def parquet(path: Path, data: Columns) -> Written:
    """Parquet with the units in the metadata of its columns."""
    import pyarrow as pa
    from pyarrow import parquet as arrow

    columns, known = theirs(data, "{name}")
    fields = [pa.field(n, pa.float64(), metadata={"unit": k.unit} if k.unit else None)
              for n, k in zip(columns, known.values(), strict=True)]  # fmt: skip
    values = [pa.array(x, pa.float64()) for x in columns.values()]
    arrow.write_table(pa.table(values, schema=pa.schema(fields)), path / "lake.parquet")
    return Written([str(path / "lake.parquet")], known)


# -- encoders and arrays of magnets -------------------------------------------------------------------------


def maker_table(path: Path, data: Columns) -> Written:
    """The mean of some counts at each step of a motor: a step index, averaged counts, degrees."""
    part = runs_of(data)[0]
    order = np.argsort(np.mod(part["angle_ref_rad"], 2 * np.pi))
    values = {c: part[c][order] for c in ("angle_rad", "angle_ref_rad")}
    values["angle_ref_rad"] = np.mod(values["angle_ref_rad"], 2 * np.pi)
    raw = np.round(values["angle_rad"] / (2 * np.pi) * 16384, 2)
    columns = {
        "step_index": np.arange(len(raw)),
        "raw_count": raw,
        "ref_angle_deg": np.degrees(values["angle_ref_rad"]),
    }
    known = {"angle_rad": Known("raw_count", "count", 16384), "angle_ref_rad": Known("ref_angle_deg", "deg")}
    return Written([table(path / "lut.csv", columns)], known, values)


def counts_of_both(path: Path, data: Columns) -> Written:
    """Two voltages as counts of 12 bits about 2048, milliseconds that are whole, degrees that wrap."""
    known = {"run": Known("pass"), "t_s": Known("millis", "ms"), "angle_ref_rad": Known("encoder_deg", "deg")}
    known |= {f"v_{k}_v": Known(f"adc_{k}", "v", 1e-3, -2.048) for k in ("sin", "cos")}
    columns = {
        "pass": data["run"], "millis": np.round(1e3 * data["t_s"]),
        "adc_sin": np.round(1e3 * data["v_sin_v"] + 2048), "adc_cos": np.round(1e3 * data["v_cos_v"] + 2048),
        "encoder_deg": np.degrees(data["angle_ref_rad"]) % 360,
    }  # fmt: skip
    return Written([table(path / "serial.csv", columns)], known)


def bracketed(about: Known) -> str:
    return f"{about.name} [{SYMBOL.get(about.unit, about.unit)}]" if about.unit else about.name


def wrapped_degrees(path: Path, data: Columns) -> Written:
    """A chip's angle and a reference, both in degrees that wrap."""
    known = {"run": Known("run"), "t_s": Known("t", "s"), "angle_rad": Known("sensor", "deg"),
             "angle_ref_rad": Known("reference", "deg")}  # fmt: skip
    columns = {bracketed(k): within(data[c], k.unit) for c, k in known.items()}
    columns = {name: x % 360 if "°" in name else x for name, x in columns.items()}
    return Written([table(path / "angles.csv", columns, "\t")], known)


def millivolts(path: Path, data: Columns) -> Written:
    """Column sums of a Halbach board in mV, travel and gap in mm."""
    known = {"run": Known("scan"), "t_s": Known("time", "s")}
    known |= {c: Known(f"col {c.split('_')[1]}", "mv") for c in data if c.startswith("col")}
    known |= {"x_ref_m": Known("x stage", "mm"), "z_ref_m": Known("gap", "mm")}
    columns = {bracketed(k): within(data[c], k.unit) for c, k in known.items()}
    file = table(path / "board.csv", columns, ";")
    (path / "board.toml").write_text(
        "\n".join(
            f"[[probes]]\nchannel = {p['channel']!r}\npositions_m = {p['positions_m']}"
            for p in _machine("halbach").probes if "channel" in p
        )
    )  # fmt: skip
    return Written([file, "--machine", str(path / "board.toml")], known)


def board_alone(path: Path, data: Columns) -> Written:
    """The same without the places of the sums."""
    made = millivolts(path, data)
    return Written(made.words[:1], made.known)


# -- more dialects -----------------------------------------------------------------------------------------


def unit_words(path: Path, data: Columns) -> Written:
    """Units as words."""
    words = {"um": "micrometers", "urad": "microradians", "ms": "milliseconds"}
    columns, known = theirs(data, "{name} ({unit})", units=UNIT)
    spelt = {n.replace("µm", words["um"]).replace("µrad", words["urad"]).replace("(ms)", "(milliseconds)"): x
             for n, x in columns.items()}  # fmt: skip
    return Written([table(path / "words.csv", spelt)], known)


def unnamed_index(path: Path, data: Columns) -> Written:
    """A data frame written with its index, whose name is empty."""
    columns, known = theirs(data)
    whole = {"": np.arange(len(data["run"])), **columns}
    return Written([table(path / "frame.csv", whole)], known)


def pandas_doubles(path: Path, data: Columns) -> Written:
    """Three columns of one name, numbered by pandas: Hall, Hall.1, Hall.2."""
    names = {**NAMES, "hall_a_m": "Hall [um]", "hall_b_m": "Hall [um].1", "hall_c_m": "Hall [um].2"}
    columns, known = theirs(data, "{name}", names)
    columns = {n if "Hall" in n or n == "Run" else f"{n} [{known[c].unit}]": x
               for (n, x), c in zip(columns.items(), known, strict=True)}  # fmt: skip
    known |= {
        f"hall_{k}_m": Known(n, "um")
        for k, n in zip("abc", ("Hall", "Hall [um].1", "Hall [um].2"), strict=True)
    }
    return Written([table(path / "merged.csv", columns)], known)


def status_column(path: Path, data: Columns) -> Written:
    """A column of words beside the numbers, and lost samples marked by words."""
    columns, known = theirs(data)
    cells = {n: [f"{v:.10g}" for v in x] for n, x in columns.items()}
    for n in cells:
        if n.startswith("Hall"):
            cells[n][37] = "n/a"
    cells["Status"] = ["OK"] * len(data["run"])
    return Written([table(path / "status.csv", cells, number=str)], known)


def thousands(path: Path, data: Columns) -> Written:
    """German numbers with points between thousands, in nanometres."""
    units = {c: {"um": "nm", "urad": "nrad"}.get(u, u) for c, u in UNIT.items()}
    columns, known = theirs(data, units=units)
    swap = str.maketrans(".,", ",.")

    def number(x):
        return f"{x:,.3f}".translate(swap)

    columns["Run"] = data["run"].astype(float)
    return Written([table(path / "tausend.csv", columns, ";", number=number)], known)


def german_dates(path: Path, data: Columns) -> Written:
    """Dates as Germans write them."""
    start = np.datetime64("2026-03-02T08:00:00", "us")
    moments = start + np.round(data["t_s"] * 1e6).astype("timedelta64[us]")
    stamps = [f"{m.day:02d}.{m.month:02d}.{m.year} {m.strftime('%H:%M:%S,%f')}" for m in moments.tolist()]
    columns, known = theirs({c: x for c, x in data.items() if c != "t_s"})
    cells = {"Datum": stamps} | {n: [f"{v:.9g}".replace(".", ",") for v in x] for n, x in columns.items()}
    return Written([table(path / "datum.csv", cells, ";", number=str)], {**known, "t_s": Known("Datum")})


def long_preamble(path: Path, data: Columns) -> Written:
    """Forty lines of settings before the table, some with commas and numbers."""
    columns, known = theirs(data)
    lines = [f"Channel {k}, gain, {1.5 + k}, coupling, DC" for k in range(12)]
    lines += ["Instrument: DAQ-3, serial 4711", "Samples: 960, Rate: 200 Hz", "", "[Data]"]
    return Written([table(path / "daq3.csv", columns, above="\n".join(lines) + "\n")], known)


def tektronix(path: Path, data: Columns) -> Written:
    """Settings of an oscilloscope beside the samples, in columns of their own."""
    part = runs_of(data)[0]
    known = {"t_s": Known("TIME", "s"), "v_sin_v": Known("CH1", "v"), "v_cos_v": Known("CH2", "v"),
             "angle_ref_rad": Known("CH3", "rad")}  # fmt: skip
    lines = ["Model,MSO44", "Firmware,1.20", "Sample Interval,5e-3", "Record Length,120", "", "Labels,,,",
             "TIME,CH1,CH2,CH3"]  # fmt: skip
    lines += [",".join(f"{x:.10g}" for x in row) for row in zip(*(part[c] for c in known), strict=True)]
    (path / "tek.csv").write_text("\n".join(lines) + "\n")
    return Written([str(path / "tek.csv")], known, {c: part[c] for c in known})


def microsteps(path: Path, data: Columns) -> Written:
    """A chip of 14 bits and a stepper that counts 51200 microsteps a turn."""
    known = {"run": Known("run"), "t_s": Known("us", "us"), "angle_rad": Known("as5047", "count", 16384),
             "angle_ref_rad": Known("microsteps", "rad", 2 * np.pi / 51200)}  # fmt: skip
    columns = {
        "run": data["run"], "us": np.round(1e6 * data["t_s"]),
        "as5047": np.floor(data["angle_rad"] / (2 * np.pi) * 16384) % 16384,
        "microsteps": np.round(data["angle_ref_rad"] / (2 * np.pi) * 51200),
    }  # fmt: skip
    return Written([table(path / "stepper.csv", columns)], known)


def columns_of_json(path: Path, data: Columns) -> Written:
    """One JSON object, a list for each column."""
    columns, known = theirs(data, "{name}_{unit}", {c: NAMES[c].replace(" ", "_") for c in NAMES})
    lists = {n.replace("µ", "u"): x.tolist() for n, x in columns.items()}
    (path / "log.json").write_text(json.dumps(lists))
    return Written([str(path / "log.json"), "--format", "json"], known)


def folder_of_hdf5(path: Path, data: Columns) -> Written:
    """One HDF5 file a run, units as attributes."""
    import h5py

    (path / "runs").mkdir()
    for run, part in enumerate(runs_of(data)):
        columns, known = theirs(part, "{name}")
        with h5py.File(path / "runs" / f"run_{run}.h5", "w") as file:
            for (name, x), about in zip(columns.items(), known.values(), strict=True):
                file[name] = x
                file[name].attrs["units"] = about.unit
    return Written([str(path / "runs")], known)


def folder_of_mat(path: Path, data: Columns) -> Written:
    """One MATLAB file a run."""
    from scipy.io import savemat

    (path / "runs").mkdir()
    for run, part in enumerate(runs_of(data)):
        columns, known = theirs(part, "{name}_{unit}", {c: NAMES[c].replace(" ", "_") for c in NAMES})
        savemat(path / "runs" / f"run{run}.mat", {n.replace("µ", "u"): x for n, x in columns.items()})
    return Written([str(path / "runs")], known)


def matlab_73(path: Path, data: Columns) -> Written:
    """MATLAB 7.3, which is HDF5: vectors are rows, a matrix stands on its side."""
    import h5py

    with h5py.File(path / "v73.mat", "w", userblock_size=512) as file:
        for c, x in data.items():
            if not c.startswith("hall"):
                file[f"{stem(c)}_{UNIT[c]}" if c in UNIT else c] = within(x, UNIT.get(c, ""))[None, :]
        file["hall_um"] = np.stack([1e6 * data[f"hall_{k}_m"] for k in "abc"])
        for name in file:
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with open(path / "v73.mat", "r+b") as raw:
        raw.write(head)
    known = {c: Known(stem(c), UNIT.get(c, "")) for c in data}
    known |= {f"hall_{k}_m": Known(f"hall_um_{i}", "um") for i, k in enumerate("abc")}
    return Written([str(path / "v73.mat")], known)


def structured_array(path: Path, data: Columns) -> Written:
    """One structured array, saved by numpy."""
    columns, known = theirs(data, "{name}_{unit}", {c: NAMES[c].replace(" ", "_") for c in NAMES})
    record = np.rec.fromarrays(list(columns.values()), names=[n.replace("µ", "u") for n in columns])
    np.savez(path / "record.npz", log=record)
    return Written([str(path / "record.npz")], known)


def open_document(path: Path, data: Columns) -> Written:
    """Two tables on one sheet, side by side: settings, then the log."""
    import xlsxwriter

    columns, known = theirs(data)
    book = xlsxwriter.Workbook(str(path / "mixed.xlsx"))
    page = book.add_worksheet("Sheet1")
    page.write_column(0, 0, ["Setting", "gain", "rate"])
    page.write_column(0, 1, ["Value", 1.5, 200])
    for k, (name, x) in enumerate(columns.items(), 3):
        page.write_column(0, k, [name, *x.tolist()])
    book.close()
    return Written([str(path / "mixed.xlsx")], known)


def sheets_of_runs(path: Path, data: Columns) -> Written:
    """A sheet of a workbook for each run, behind one of remarks."""
    import xlsxwriter

    columns, known = theirs({c: x for c, x in data.items() if c != "run"})
    with xlsxwriter.Workbook(str(path / "runs.xlsx")) as book:
        book.add_worksheet("Notes").write_column(0, 0, ["Stage 4", "warmed up for 2 h"])
        for run in np.unique(data["run"]):
            sheet = book.add_worksheet(f"Pass {int(run) + 1}")
            for k, (name, values) in enumerate(columns.items()):
                sheet.write_column(0, k, [name, *values[data["run"] == run].tolist()])
    return Written([str(path / "runs.xlsx")], known)


def archive(path: Path, data: Columns) -> Written:
    """A folder of runs as a zip archive."""
    columns, known = theirs({c: x for c, x in data.items() if c != "run"})
    with zipfile.ZipFile(path / "runs.zip", "w", zipfile.ZIP_DEFLATED) as out:
        for run in np.unique(data["run"]):
            own = {name: values[data["run"] == run] for name, values in columns.items()}
            file = table(path / "part.csv", own)
            out.write(file, f"export/run_{int(run)}.csv")
            Path(file).unlink()
    return Written([str(path / "runs.zip")], known)


def database(path: Path, data: Columns) -> Written:
    """A table of an SQLite database."""
    names = {c: NAMES[c].replace(" ", "_") for c in NAMES}
    columns, known = theirs(data, "{name}_{unit}", names)
    with contextlib.closing(sqlite3.connect(path / "log.sqlite")) as base:
        fields = ", ".join(f'"{name}" real' for name in columns)
        base.execute(f"create table samples ({fields})")
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        base.executemany(f"insert into samples values ({','.join('?' * len(columns))})", rows)
        base.commit()
    return Written([str(path / "log.sqlite")], known)


def fortran(path: Path, data: Columns) -> Written:
    """Columns of a fixed width whose exponents have a D."""
    names = {c: NAMES[c].replace(" ", "_") for c in NAMES}
    columns, known = theirs(data, "{name}_{unit}", names)
    rows = [
        "  ".join(f"{x:20.12E}".replace("E", "D") for x in row) for row in zip(*columns.values(), strict=True)
    ]
    head = "  ".join(f"{name.replace('µ', 'u'):>20}" for name in columns)
    (path / "out.dat").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    return Written([str(path / "out.dat")], known)


def units_in_cells(path: Path, data: Columns) -> Written:
    """A unit behind each number."""
    columns = {
        NAMES[c]: [
            f"{x:.10g} {SYMBOL.get(UNIT[c], UNIT[c])}" if c in UNIT else f"{x:g}"
            for x in within(v, UNIT.get(c, ""))
        ]
        for c, v in data.items()
    }
    known = {c: Known(NAMES[c], UNIT.get(c, "")) for c in data}
    return Written([table(path / "cells.csv", columns, number=str)], known)


def one_behind_another(path: Path, data: Columns) -> Written:
    """Files of runs that were put one behind another, names and all."""
    columns, known = theirs({c: x for c, x in data.items() if c != "run"})
    lines = []
    for part in runs_of(data):
        lines.append(",".join(columns))
        values = zip(*(within(x, UNIT[c]) for c, x in part.items()), strict=True)
        lines += [",".join(f"{x:.10g}" for x in row) for row in values]
    (path / "all.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    return Written([str(path / "all.csv")], known)


def row_per_value(path: Path, data: Columns) -> Written:
    """Time, name and value in each row, as databases of time series export them."""
    names = {c: NAMES[c].replace(" ", "_").lower() for c in NAMES}
    columns, known = theirs({c: x for c, x in data.items() if c != "t_s"}, "{name}_{unit}", names)
    rows = [
        f"{t:.9g},{name.replace('µ', 'u')},{values[k]:.10g}"
        for k, t in enumerate(data["t_s"])
        for name, values in columns.items()
    ]
    (path / "series.csv").write_text("\n".join(["time_s,channel,value", *rows, ""]), encoding="utf-8")
    return Written([str(path / "series.csv")], {**known, "t_s": Known("time_s")})


# -- what no program can know --------------------------------------------------------------------------------


def same_names(path: Path, data: Columns) -> Written:
    """Two columns with one name."""
    columns, known = theirs(data)
    head = ",".join(columns).replace("Hall B", "Hall A")
    return Written([table(path / "twice.csv", columns, head=head)], known)


def no_names(path: Path, data: Columns) -> Written:
    """Numbers alone."""
    columns, known = theirs(data)
    return Written([table(path / "numbers.csv", columns, head="0,0,0,0,0,0,0,0,0,0,0")], known)


def no_reference(path: Path, data: Columns) -> Written:
    """Readings without a reference."""
    columns, known = theirs({c: x for c, x in data.items() if "ref" not in c})
    return Written([table(path / "readings.csv", columns)], known)


FILES: dict[str, LabFile] = {
    "decimal commas": LabFile(comma_decimals),
    "UTF-16 of Excel": LabFile(excel_text),
    "sep= and trailing separators": LabFile(separator_line),
    "units in a second row": LabFile(units_below),
    "names in a comment": LabFile(comment_header),
    "no units": LabFile(unitless),
    "line breaks in names": LabFile(quoted_names),
    "times of day": LabFile(clock_times),
    "gzip": LabFile(compressed),
    "blocks of gnuplot": LabFile(gnuplot_blocks),
    "oscilloscope": LabFile(scope, "rotary"),
    "LabVIEW measurement": LabFile(labview),
    "paths as names": LabFile(group_paths),
    "counts with scale and offset": LabFile(counts, within=2.0),
    "runs side by side": LabFile(wide),
    "runs side by side, own clocks": LabFile(wide_clocks),
    "folder of runs": LabFile(folder_of_runs),
    "pattern of runs": LabFile(pattern_of_runs),
    "names of runs": LabFile(run_names),
    "two files, two rates": LabFile(two_rates, within=6.0),
    "workbook": LabFile(workbook),
    "HDF5, attributes": LabFile(hdf5_groups),
    "HDF5, records": LabFile(hdf5_table),
    "TDMS": LabFile(tdms),
    "MDF": LabFile(mdf),
    "MATLAB matrices": LabFile(matrices),
    "MATLAB struct": LabFile(matlab_struct),
    "npz": LabFile(numpy_arrays),
    "feather": LabFile(feather),
    "JSON lines": LabFile(json_lines),
    "parquet": LabFile(parquet),
    "averaged counts": LabFile(maker_table, "chip", within=0.2),
    "voltages in counts": LabFile(counts_of_both, "rotary", within=2.0),
    "wrapped degrees": LabFile(wrapped_degrees, "chip"),
    "millivolts": LabFile(millivolts, "halbach"),
    "units as words": LabFile(unit_words),
    "unnamed index": LabFile(unnamed_index),
    "columns numbered by pandas": LabFile(pandas_doubles),
    "points between thousands": LabFile(thousands),
    "German dates": LabFile(german_dates),
    "a long preamble": LabFile(long_preamble),
    "labels above names": LabFile(tektronix, "rotary"),
    "counts and microsteps": LabFile(microsteps, "chip", within=3.0),
    "JSON of lists": LabFile(columns_of_json),
    "folder of HDF5": LabFile(folder_of_hdf5),
    "folder of MATLAB": LabFile(folder_of_mat),
    "MATLAB 7.3": LabFile(matlab_73),
    "structured array": LabFile(structured_array),
    "a sheet with two tables": LabFile(open_document),
    "a sheet for each run": LabFile(sheets_of_runs),
    "zip": LabFile(archive),
    "SQLite": LabFile(database),
    "a row per value": LabFile(row_per_value),
    "exponents with D": LabFile(fortran),
    "units in cells": LabFile(units_in_cells),
    "names come again": LabFile(one_behind_another),
    "a column of words, lost samples": LabFile(status_column, says=("--drop-bad",)),
    "two columns of one name": LabFile(same_names, says=("twice", "different names")),
    "no names": LabFile(no_names, says=("column names", "names")),
    "a board of unknown layout": LabFile(board_alone, "halbach", says=("layout", "places")),
    "no reference": LabFile(no_reference, says=("reference", "x_ref")),
}
"""The last five have no answer without a decision: a true sentence is right."""


# -- a person who obeys --------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """Whether it ended right, after how many messages; lines put right and columns added by the owner."""

    name: str
    right: bool
    steps: int
    changed: int
    added: int
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


def completed(path: Path, known: Mapping[str, Known]) -> tuple[int, int]:
    """Choose the lines of a column file that are right, add scale, offset and missing columns.

    Return how many lines in force named another column than the owner's, or another unit, and were put right;
    and how many columns were added.
    """
    lines, wrong, added, have = [], 0, 0, set()
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
            wrong += not offered and own not in have
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
            added += 1
    path.write_text("\n".join(lines), encoding="utf-8")
    return wrong, added


def stem(column: str) -> str:
    """Return hallsym's name without its unit."""
    return column if column == "run" else column.rpartition("_")[0]


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
    printed, changed, added, steps = [], 0, 0, 0
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
                changed, added = completed(file, written.known)
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
        right = any(word in everything for word in lab.says)
        return Outcome(name, right, steps, changed, added, "" if right else why, everything)
    return Outcome(name, not why, steps, changed, added, why, everything)


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


def main() -> None:
    """Print how each file ends."""
    chosen = sys.argv[1:] or list(FILES)
    done = []
    for name in chosen:
        with tempfile.TemporaryDirectory() as folder:
            try:
                done.append(obeyed(name, Path(folder)))
            except Exception as error:
                done.append(Outcome(name, False, 0, 0, 0, repr(error)[:200], ""))
        o = done[-1]
        ends = "right" if o.right else "WRONG"
        print(
            f"{ends}  {o.steps} steps, {o.changed} lines put right, {o.added} added  {name}",
            o.why,
            flush=True,
        )
        if len(chosen) < len(FILES):
            print(o.printed)
    print(f"{sum(o.right for o in done)} of {len(done)} right")


if __name__ == "__main__":
    main()
