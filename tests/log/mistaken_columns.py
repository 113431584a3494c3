"""Mistakes that only a model shows: units, signs and order of columns, and runs that do not belong."""

from __future__ import annotations

from typing import Literal

import numpy as np
from mistakes import READINGS, REFERENCES, Arrays, Make, Mistake, both, of_run, scale

DEGREE = 180 / np.pi


def seen(
    name: str, make: Make, says: str, ends: Literal["refusal", "note"] = "refusal", on: tuple[str, ...] = ()
) -> Mistake:
    """Return a mistake that a fit finds, in both logs unless it says in which."""
    return Mistake(name, make, says, ends, "fit", on or ("57 runs", "6 runs"))


def scaled(columns: tuple[str, ...], factor: float) -> Make:
    """Record columns in another unit or with another sign."""
    return both(*(scale(c, factor) for c in columns))


def swapped(one: str, other: str) -> Make:
    """Exchange two columns."""
    return lambda arrays: {**arrays, one: arrays[other], other: arrays[one]}


def in_run(run: int, make: Make) -> Make:
    """Make a mistake in one run only."""

    def changed(arrays: Arrays) -> None:
        rows = of_run(run)(arrays)
        part = {name: values[rows].copy() for name, values in arrays.items()}
        for name, values in (make(part) or part).items():
            arrays[name][rows] = values

    return changed


def resampled(columns: tuple[str, ...], source: int, to: int) -> Make:
    """Put columns of one run, interpolated on another clock, in the place of another run's."""

    def make(arrays: Arrays) -> None:
        for name in columns:
            values, rows = arrays[name][of_run(source)(arrays)], of_run(to)(arrays)
            at = np.linspace(0.37, len(values) - 1.21, rows.stop - rows.start)
            arrays[name][rows] = np.interp(at, np.arange(len(values)), values)

    return make


def late(columns: tuple[str, ...], samples: int) -> Make:
    """Record columns some samples late, run by run."""

    def make(arrays: Arrays) -> None:
        for run in np.unique(arrays["run"]):
            rows = of_run(int(run))(arrays)
            for name in columns:
                x = arrays[name][rows]
                arrays[name][rows] = np.concatenate([np.full(samples, x[0]), x[:-samples]])

    return make


UNITS = (
    seen("x in mm", scale("x_ref_m", 1e3), r"x_ref_m looks like mm.*--column x_ref_mm=x_ref_m"),
    seen("Rz in degrees", scale("rz_ref_rad", DEGREE), r"rz_ref_rad looks like deg.*rz_ref_deg=rz_ref_rad"),
    seen("a reading in mm", scale("hall_a_m", 1e3), r"hall_a_m looks like mm.*hall_a_mm=hall_a_m"),
    seen("all readings in mm", scaled(READINGS, 1e3), r"hall_a_m, hall_b_m and hall_c_m look like mm.*say"),
    seen(
        "x, y in mm and Rz in degrees",
        both(scaled(("x_ref_m", "y_ref_m"), 1e3), scale("rz_ref_rad", DEGREE)),
        r"x_ref_m and y_ref_m look like mm and rz_ref_rad looks like deg.*--column x_ref_mm=x_ref_m"
        r"|y_ref_m .*looks like mm.*--column y_ref_mm=y_ref_m",
    ),
    seen("converted twice", scale("x_ref_m", 1e-3), r"x_ref_m looks 1000 times too small"),
)
SIGNS = (
    *(
        seen(f"{c} inverted", scale(c, -1), rf"the sign of {c} looks inverted.*column file")
        for c in REFERENCES
    ),
    *(seen(f"{c} inverted", scale(c, -1), rf"the sign of {c} looks inverted.*wiring") for c in READINGS),
    seen(
        "x and y exchanged", swapped("x_ref_m", "y_ref_m"), r"x_ref_m and y_ref_m look swapped.*column file"
    ),
    seen("A and B exchanged", swapped("hall_a_m", "hall_b_m"), r"hall_a_m and hall_b_m look swapped.*wiring"),
    seen(
        "all readings inverted",
        scaled(READINGS, -1),
        r"hall_a_m, hall_b_m and hall_c_m looks inverted; or the sign of x_ref_m, y_ref_m and rz_ref_rad",
    ),
    seen(
        "x inverted, Rz in degrees",
        both(scale("x_ref_m", -1), scale("rz_ref_rad", DEGREE)),
        r"the sign of x_ref_m looks inverted and rz_ref_rad looks like deg",
    ),
)
RUNS = (
    seen(
        "a channel inverted in a run",
        in_run(3, scale("hall_a_m", -1)),
        r"In run 3 .*the sign of hall_a_m looks inverted.*--holdout 3",
    ),
    seen(
        "a reference inverted in a run",
        in_run(3, scale("y_ref_m", -1)),
        r"In run 3 .*the sign of y_ref_m looks inverted.*--holdout 3",
    ),
    seen(
        "a unit in a run", in_run(4, scale("x_ref_m", 1e3)), r"In run 4 .*x_ref_m looks like mm.*correct it"
    ),
    seen(
        "two channels exchanged in a run",
        in_run(3, swapped("hall_a_m", "hall_c_m")),
        r"In run 3 .*hall_a_m and hall_c_m look swapped.*correct it",
    ),
    seen(
        "references of another run",
        resampled(REFERENCES, 1, 3),
        r"In run 3 .* per \w+ where .* is usual.*correct it",
        on=("57 runs",),
    ),
)
CLOCKS = tuple(
    seen(
        f"references {n} samples late",
        late(REFERENCES, n),
        rf"look ({n}|{n - 1}\.9\d?) samples \(0\.00\d+ s\) late.*hallsym diagnose",
        "note",
    )
    for n in (1, 2, 3)
)
COLUMNS = (*UNITS, *SIGNS, *RUNS, *CLOCKS)
