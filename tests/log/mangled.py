"""One log as twenty laboratories and programs would write it: the same numbers in other text."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

UNITS = {
    "run": ("", 1.0), "t_s": ("s", 1.0), "hall_a_m": ("µm", 1e6), "hall_b_m": ("µm", 1e6),
    "hall_c_m": ("µm", 1e6), "z_m": ("mm", 1e3), "rx_rad": ("mrad", 1e3), "ry_rad": ("mrad", 1e3),
    "x_ref_m": ("µm", 1e6), "y_ref_m": ("µm", 1e6), "rz_ref_rad": ("µrad", 1e6),
}  # fmt: skip
"""Unit in which a variant with a row of units writes a column, and its factor."""
FINE = UNITS | {"x_ref_m": ("nm", 1e9), "y_ref_m": ("nm", 1e9)}
"""Units in which numbers have thousands."""
Units = Mapping[str, tuple[str, float]]
Columns = Mapping[str, np.ndarray]


def si_cells(columns: Columns) -> list[list[str]]:
    """Cells of SI values, every digit of them."""
    return [list(map(repr, row)) for row in zip(*(v.tolist() for v in columns.values()), strict=True)]


def cells(
    columns: Columns, form: Callable[[float], str] = lambda v: f"{v:.20f}", units: Units = UNITS
) -> list[list[str]]:
    """Cells in laboratory units."""
    out = []
    for row in zip(*(v.tolist() for v in columns.values()), strict=True):
        pairs = zip(columns, row, strict=True)
        out.append([str(v) if name == "run" else form(v * units[name][1]) for name, v in pairs])
    return out


def stems(columns: Columns) -> list[str]:
    return [name.rpartition("_")[0] or name for name in columns]


def with_units(columns: Columns, left: str = " [", right: str = "]", units: Units = UNITS) -> list[str]:
    """Names with their unit behind them."""
    found = zip(stems(columns), columns, strict=True)
    return [stem + (f"{left}{units[name][0]}{right}" if units[name][0] else "") for stem, name in found]


def rows(names: Sequence[str], body: Sequence[Sequence[str]], by: str = ",", end: str = "\n") -> str:
    return end.join([by.join(names), *(by.join(row) for row in body), ""])


def comma(row: Sequence[str]) -> list[str]:
    return [cell.replace(".", ",") for cell in row]


def grouped(value: float) -> str:
    return f"{value:,.20f}".replace(",", " ").replace(".", ",").replace(" ", ".")


def aligned(names: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    width = max(len(cell) for row in [names, *body] for cell in row) + 2
    return "\n".join("".join(cell.rjust(width) for cell in row) for row in [names, *body]) + "\n"


def variants(columns: Columns) -> dict[str, tuple[str, bytes]]:
    """Name of a file and its bytes, by what is mangled."""
    names, si, lab = list(columns), si_cells(columns), cells(columns)
    german = [comma(row) for row in lab]
    units = [UNITS[name][0] for name in columns]
    brackets = [f"[{unit}]" if unit else "-" for unit in units]
    head, named, fine = stems(columns), with_units(columns), with_units(columns, units=FINE)
    two = rows(head, [units, *german], ";")
    above = "Device: stage 3\nOperator;Meier\n\n"
    quotes = [[f'"{cell}"' for cell in row] for row in german]
    texts = {
        "semicolons": ("log.csv", rows(names, si, ";").encode()),
        "tabs": ("log.txt", rows(names, si, "\t").encode()),
        "tabs in a .csv": ("log.csv", rows(names, si, "\t").encode()),
        "bars": ("log.csv", rows(names, si, "|").encode()),
        "blanks": ("log.txt", aligned(names, si).encode()),
        "blanks, units in brackets": ("log.dat.txt", aligned(head, [brackets, *lab]).encode()),
        "decimal comma": ("log.csv", rows(named, german, ";").encode()),
        "decimal comma, tabs": ("log.csv", rows(named, german, "\t").encode()),
        "two lines of header": ("log.csv", two.encode()),
        "two lines of header, latin-1": ("log.csv", two.encode("latin-1")),
        "utf-16": ("log.csv", two.encode("utf-16")),
        "utf-16 without a mark": ("log.csv", two.encode("utf-16-le")),
        "byte order mark, CRLF": ("log.csv", b"\xef\xbb\xbf" + rows(named, german, ";", "\r\n").encode()),
        "lines that end with CR": ("log.csv", rows(names, si, ",", "\r").encode()),
        "comments": ("log.csv", ("# stage 3\n" + rows(names, [*si[:9], ["# pause"], *si[9:]])).encode()),
        "names in a comment": ("log.txt", ("# " + rows(names, si, " ")).encode()),
        "lines above the names": ("log.csv", (above + rows(named, german, ";")).encode()),
        "words below": ("log.csv", (rows(named, lab) + "\nEnd of measurement: 60 s\n,,\n").encode()),
        "empty rows below": ("log.csv", (rows(names, si) + "," * (len(names) - 1) + "\n").encode()),
        "quotes and decimal commas": ("log.csv", rows([f'"{n}"' for n in named], quotes).encode()),
        "quotes": ("log.csv", rows([f'"{n}"' for n in names], [[f'"{c}"' for c in r] for r in si]).encode()),
        "delimiters at the end": ("log.csv", rows([*names, ""], [[*row, ""] for row in si], ";").encode()),
        "thousands": ("log.csv", rows(fine, cells(columns, grouped, FINE), ";").encode()),
        "blanks beside commas": ("log.csv", rows(names, si, " , ").encode()),
        "sep= of a spreadsheet": ("log.csv", ("sep=;\n" + rows(named, german, ";")).encode()),
        "percent comments": ("log.txt", ("% rig 2\n% 60 s\n" + rows(named, lab, "\t")).encode()),
        "unit behind a slash": ("log.csv", rows(with_units(columns, " / ", ""), lab).encode()),
        "gzip": ("log.csv.gz", gzip.compress(rows(names, si).encode())),
        "gzip of utf-16": ("log.csv.gz", gzip.compress(two.encode("utf-16"))),
    }
    return texts


def write_workbook(path: Path, columns: Columns, *, above: bool = True) -> None:
    """Write a workbook with two lines of names and units, perhaps below a title."""
    import xlsxwriter

    book = xlsxwriter.Workbook(str(path))
    sheet = book.add_worksheet("Log")
    book.add_worksheet("Empty")
    first = 0
    if above:
        sheet.write_row(0, 0, ["Stage 3"])
        first = 2
    sheet.write_row(first, 0, stems(columns))
    sheet.write_row(first + 1, 0, [UNITS[name][0] for name in columns])
    for k, (name, values) in enumerate(columns.items()):
        sheet.write_column(first + 2, k, (values * UNITS[name][1]).tolist())
    book.close()
