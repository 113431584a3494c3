"""What goes to a controller: generated C, and the correction table of a maker's firmware."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from hallsym.report.content import Block, Content, Table
from hallsym.report.words import name, number, sized
from hallsym.units import readable

if TYPE_CHECKING:
    from hallsym.codegen import Exported, Generated


def generated_content(made: Generated) -> Content:
    """Return the largest error of the code, then the errors and the box of each column."""
    record, tried = made.to_dict(), made.decoupler.tried
    bounds, sizes, errors = record.get("error_bound", {}), [], []
    for c, met in record["error_met"].items():
        unit, bound = c.rpartition("_")[2], bounds.get(c)
        turns = readable(c)[1] == "deg"
        most = "" if bound is None else sized(bound, unit, turns=turns)
        sizes.append(f"{name(c)} {most or sized(met, unit, turns=turns)}")
        errors.append([c, most, sized(met, unit, turns=turns)])
    how = "at most" if bounds else "in tests"
    box = [[c, f"{low:g}", f"{high:g}"] for c, (low, high) in record["box"].items()]
    return Content(
        "Decoder",
        f"{record['model']} in {record['type']}, table of {record['table_bytes']} bytes: error of the code "
        f"{how} {', '.join(sizes)}.",
        first=[
            Table(["error", "at most over the box", f"met over {tried} random inputs"], errors, "errors"),
            Table(["box", "from", "to"], box, "box"),
        ],
        columns={"column": list(record["error_met"]), "error_met": list(record["error_met"].values())},
    )


def exported_content(made: Exported) -> Content:
    """Return the error of the angle over the turn, without a table and with it."""
    tables = [("without a table", made.before)]
    tables += [(f"with the table in {made.like}", made.old)] if made.old else []
    tables.append((f"with the new table, {made.entries} entries", made.after))
    head = ["error of the angle over the turn, by the calibration", "rms [deg]", "peak [deg]"]
    rows = [[label, number(degrees(e.rms)), number(degrees(e.peak))] for label, e in tables]
    blocks: list[Block | str] = [Table(head, rows, "error over the turn")]
    if made.calibrated is not None:
        rest = number(degrees(made.calibrated))
        blocks.append(f"the residual error of the calibration on its log adds to it: rms {rest} deg")
    return Content(
        "Correction table",
        f"The new table of {made.entries} entries lowers the error over the turn from "
        f"{number(degrees(made.before.rms))} to {number(degrees(made.after.rms))} deg rms.",
        first=blocks,
        columns={"table": [label for label, _ in tables]}
        | {f"{key}_rad": [getattr(e, key) for _, e in tables] for key in ("rms", "peak")},
    )
