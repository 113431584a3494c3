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

from hallsym.errors import InputError, nearest

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
        known = sorted(files)
        raise InputError(
            f"No published table is called {name!r}{nearest(name, known)}; there are {len(known)}, the files "
            "data/<publication>/<table>.csv."
        )
    with files[name].open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(line for line in file if not line.startswith("#"))
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    return MappingProxyType({column: _typed(column, cells) for column, cells in columns.items()})


def values(name: str) -> dict[str, float]:
    """Return parameter -> value in SI of a table of values: `table1_designed` or `table7_estimates`."""
    columns = table(name)
    if not {"parameter", "value"} <= columns.keys():
        raise InputError(
            f"Published table {name!r} must have the columns parameter and value; "
            f"instead it has {', '.join(columns)}. Read it with table({name!r})."
        )
    return dict(zip(columns["parameter"], columns["value"], strict=True))


def bounds() -> dict[str, tuple[float, float]]:
    """Return parameter -> (lower, upper) in SI: Table 3 (H, eta, theta) and Table 5 (a, b, c).

    The signs in Table 5 belong to this layout of probes and to where Z is measured.
    """
    return {
        parameter: (lower, upper)
        for name in ("table3_bounds", "table5_bounds_vertical")
        for parameter, lower, upper in zip(
            *(table(name)[column] for column in ("parameter", "lower", "upper")), strict=True
        )
    }


def _typed(column: str, cells: tuple[str, ...]) -> tuple[Any, ...]:
    if column in _TEXT:
        return cells
    return tuple(map(int if column == "setting" else float, cells))
