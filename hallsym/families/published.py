"""The published tables of the 6-DOF stage and of the rotary encoder, in SI units.

Chen, Liu, Fu, Song, Tan, "Calibration of the Hall Measurement System for a 6-DOF Precision Stage Using
Self-Adaptive Hybrid TLBO", Sensors 2016, 16(6), 872, https://doi.org/10.3390/s16060872. Meng, Wang, Sun,
Yuan, "A Novel Diagnosis Method for a Hall Plates-Based Rotary Encoder with a Magnetic Concentrator", Sensors
2014, 14(8), 13980, https://doi.org/10.3390/s140813980. The files and what was restored in them are described
in `data/README.md`.

>>> values("table7_estimates")["a_A"]
-188.1873
"""

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hallsym.errors import require

_TEXT = {"parameter", "quantity", "axis", "unit", "printed", "factor"}  # every other column holds numbers


def data_folder() -> Path:
    """Return the folder of published data: `hallsym/data` once installed, `data` in a source checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "data", package.parent / "data"):
        if (folder / "chen2016").is_dir():
            return folder
    raise FileNotFoundError(
        f"Published data must lie in {package / 'data'} or {package.parent / 'data'}; "
        "instead found neither. Install hallsym again."
    )


@cache
def table(name: str) -> Mapping[str, tuple[Any, ...]]:
    """Return one table as its columns, in the order of the file: `table("table6_settings")["z_m"]`.

    The unit is in the column name (`_m`, `_rad`), or row by row in a column `unit` (`m`, `rad`, `1/m`,
    `1/rad`, `1`). Numbers are floats, `setting` is an int, the rest is text.
    """
    files = {path.stem: path for path in data_folder().glob("*20??/*.csv")}
    if name not in files:
        wanted = "a file data/<publication>/<table>.csv"
        require(False, "A published table", wanted, name, sorted(files))
    with files[name].open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(line for line in file if not line.startswith("#"))
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    return MappingProxyType({column: _typed(column, cells) for column, cells in columns.items()})


def values(name: str) -> dict[str, float]:
    """Return parameter -> value in SI of a table of values: `table1_designed` or `table7_estimates`."""
    columns = table(name)
    if not {"parameter", "value"} <= columns.keys():
        wanted = "one with the columns parameter and value"
        require(False, f"Published table {name}", wanted, list(columns))
    return dict(zip(columns["parameter"], columns["value"], strict=True))


def bounds() -> dict[str, tuple[float, float]]:
    """Return parameter -> (lower, upper) in SI: Table 3 (H, eta, theta) and Table 5 (a, b, c).

    The signs in Table 5 belong to this layout of probes and to where Z is measured.
    """
    tables = map(table, ("table3_bounds", "table5_bounds_vertical"))
    rows = (zip(t["parameter"], t["lower"], t["upper"], strict=True) for t in tables)
    return {parameter: (lower, upper) for own in rows for parameter, lower, upper in own}


def _typed(column: str, cells: tuple[str, ...]) -> tuple[Any, ...]:
    if column in _TEXT:
        return cells
    return tuple(map(int if column == "setting" else float, cells))
