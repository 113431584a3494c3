"""Mistakes that only a model shows: units, signs and order of columns, and runs that do not belong."""

from __future__ import annotations

import numpy as np
from mistakes import READINGS, REFERENCES, Arrays, Make, Mistake, both, of_run, scale

DEGREE = 180 / np.pi


def seen(name: str, make: Make, says: str) -> Mistake:
    """Return a mistake that a fit finds, in both logs."""
    return Mistake(name, make, says, "claim", "fit")


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


def late(columns: tuple[str, ...], samples: int) -> Make:
    """Record columns some samples late, run by run."""

    def make(arrays: Arrays) -> None:
        for run in np.unique(arrays["run"]):
            rows = of_run(int(run))(arrays)
            for name in columns:
                x = arrays[name][rows]
                arrays[name][rows] = np.concatenate([np.full(samples, x[0]), x[:-samples]])

    return make


def corrected(text: str) -> str:
    """Return what must be said of a mistake: the option that undoes it."""
    return rf"undo it with --correct '{text}'"


UNITS = (
    seen("x in mm", scale("x_ref_m", 1e3), corrected("scale x_ref_m mm")),
    seen("Rz in degrees", scale("rz_ref_rad", DEGREE), corrected("scale rz_ref_rad deg")),
    seen("a reading in mm", scale("hall_a_m", 1e3), corrected("scale hall_a_m mm")),
    seen("all readings in mm", scaled(READINGS, 1e3), corrected("scale hall_a_m,hall_b_m,hall_c_m mm")),
    seen("converted twice", scale("x_ref_m", 1e-3), corrected("scale x_ref_m 1000")),
)
SIGNS = (
    *(seen(f"{c} inverted", scale(c, -1), corrected(f"sign {c}")) for c in (*REFERENCES, *READINGS)),
    seen("x and y exchanged", swapped("x_ref_m", "y_ref_m"), corrected("exchange x_ref_m y_ref_m")),
    seen("A and B exchanged", swapped("hall_a_m", "hall_b_m"), corrected("exchange hall_a_m hall_b_m")),
    seen(
        "all readings inverted",
        scaled(READINGS, -1),
        rf"'sign x_ref_m,.*' would do as well; {corrected('sign hall_a_m,hall_b_m,hall_c_m')}",
    ),
)
RUNS = (
    seen("a channel inverted in a run", in_run(3, scale("hall_a_m", -1)), corrected("sign hall_a_m in 3")),
    seen("a reference inverted in a run", in_run(3, scale("y_ref_m", -1)), corrected("sign y_ref_m in 3")),
    seen("a unit in a run", in_run(4, scale("x_ref_m", 1e3)), corrected("scale x_ref_m mm in 4")),
    seen(
        "two channels exchanged in a run",
        in_run(3, swapped("hall_a_m", "hall_c_m")),
        corrected("exchange hall_a_m hall_c_m in 3"),
    ),
)
CLOCKS = tuple(
    seen(f"references {n} samples late", late(REFERENCES, n), rf"'delay x_ref_m,y_ref_m,rz_ref_rad {n}'")
    for n in (1, 2, 3)
)
COLUMNS = (*UNITS, *SIGNS, *RUNS, *CLOCKS)
