"""`hallsym trajectory`: a curve for the machine to follow, within a tolerance.

Make the curve that the machine follows: from points, or from the nominal curve as an expression.
Tries every method (Bernstein and trigonometric curves of high relative accuracy, through points
or by least squares, splines) and says which holds the tolerance with the fewest numbers. Errors
are bounded between the points where the curve is an expression; else they are those at the points.
"""

from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hallsym import trajectory
from hallsym.cli import OK
from hallsym.cli.common import chosen, progress_of, refuse, say
from hallsym.errors import InputError
from hallsym.files import atomic_write
from hallsym.report.content import Content, Table
from hallsym.report.words import number
from hallsym.trajectory.export import gcode, times, write_table
from hallsym.trajectory.nominal import read_span, read_value
from hallsym.units import read_quantity, reading_unit

EPILOG = """\
examples:
  hallsym trajectory points.csv --tolerance 0.05um -o curve.json
  hallsym trajectory --curve "x = r*(t - sin(t)); y = r*(1 - cos(t))" --range t=0:2*pi --value r=1mm \\
      --tolerance 0.05um -o curve.json
  hallsym trajectory curve.json --duration 10s --step 1ms -o table.csv
  hallsym trajectory points.csv --method quintic --chord 0.1um --duration 10s -o path.ngc

points.csv has columns such as x_um, y_um, rz_urad, and t if the points have a parameter (else the length of
their chords). Functions of --curve: sin cos tan asin acos atan sinh cosh tanh exp log sqrt.
What a saved curve adds to the uncertainty of a position: hallsym budget FILE --curve curve.json.
"""
GCODE = (".ngc", ".nc", ".gcode")
OUTPUTS = (".json", ".csv", *GCODE)


OPTIONS = """
points_file POINTS <optional>   points (.csv), or a saved curve (.json)
--tolerance LENGTH              largest error of the curve, such as 0.05um
[nominal curve]
--curve TEXT                    such as "x = r*cos(t); y = r*sin(t)", in m and rad
--range NAME=A:B                parameter and its range: t=0:2*pi
--value NAME=NUMBER <repeat>    a number of the curve: r=1mm (repeat)
[method]
--points N <int>                points taken from --curve (default: the fewest)
--control N <int>               control points of a least-squares fit
--method NAME                   only this method of the table (of POINTS: cubic if not stated)
[output]
-o, --output FILE <repeat>      the curve as .json, .csv at a clock, or .ngc (G-code) (repeat)
--duration TIME                 that the path takes, such as 10s
--step TIME                     of a .csv: the clock, such as 1ms
--chord LENGTH                  of G-code: G1 blocks within this distance of the curve
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    _check(options)
    if options.points_file and Path(options.points_file).suffix.lower() == ".json":
        return _saved(options)
    choice, notes = _choice(options)
    written = _write(choice.curve, options)
    record = choice.to_dict() | _shape(choice.curve) | {"written": list(map(str, written)), "notes": notes}
    said = choice_content(choice, _shape_text(record))
    say(options, record, lambda: said, notes=notes, wrote=written)
    return OK


def _check(options: Namespace) -> None:
    """Refuse incompatible options before anything is computed."""
    if (options.points_file is None) == (options.curve is None):
        raise InputError("Give either a file of POINTS or the nominal --curve.")
    if not options.curve:
        refuse(options, ("range", "value", "points"), f"belongs to --curve; {options.points_file} is a file")
    if options.curve and not options.range:
        raise InputError("--curve needs the range of its parameter, such as --range t=0:2*pi.")
    kinds = {Path(name).suffix.lower() for name in options.output}
    if not kinds <= {*OUTPUTS}:
        raise InputError(f"An output must end with one of {', '.join(OUTPUTS)}.")
    if len(set(options.output)) != len(options.output):
        raise InputError("An output file is given twice; give each its own name.")
    if (".csv" in kinds) != bool(options.step) or (options.step and not options.duration):
        raise InputError("A .csv at a clock needs --duration and --step, such as --duration 10s --step 1ms.")
    if bool(kinds & {*GCODE}) != bool(options.chord):
        raise InputError("G-code needs both --chord and -o, such as --chord 0.1um -o path.ngc.")
    if options.duration and not kinds - {".json"}:
        raise InputError("--duration belongs to a .csv or to G-code; give one with -o.")


def _saved(options: Namespace) -> int:
    made = f"is for making a curve; {options.points_file} is made already"
    refuse(options, ("tolerance", "control", "method"), made)
    curve = trajectory.read_curve(options.points_file)
    written = _write(curve, options)
    record, text = about_curve(curve)
    say(options, record | {"written": list(map(str, written))}, lambda: text, wrote=written)
    return OK


def about_curve(curve: trajectory.Curve) -> tuple[dict[str, Any], str]:
    """Return the description of a saved curve, as a record and in words."""
    record = {
        "method": curve.method,
        "control_points": curve.control_points,
        "max_error_m": curve.max_error_m,
        "error_kind": curve.error_kind,
        **_shape(curve),
    }
    error = curve.max_error_m
    known = "error not known" if error is None else f"error {number(1e6 * error, 4)} um ({curve.error_kind})"
    said = f"{curve.method}, {curve.control_points} control points, {known}"
    return record, f"{said}\n{_shape_text(record)}"


def _choice(options: Namespace) -> tuple[trajectory.Choice, list[str]]:
    """Return the curve that is chosen, and notes on the file of points."""
    data: trajectory.Nominal | trajectory.Points
    if options.curve:
        pairs = [read_value(text) for text in options.value]
        if len({name for name, _ in pairs}) != len(pairs):
            raise InputError("--value gives a name twice; keep one.")
        data = trajectory.nominal(options.curve, read_span(options.range), dict(pairs))
    else:
        data = trajectory.read_points(options.points_file)
    given = chosen(options, trajectory.choose_curve) | {"progress": progress_of(options)}
    choice = trajectory.choose_curve(data, _length(options, "tolerance"), **given)
    return choice, list(getattr(data, "notes", ()))


def _length(options: Namespace, name: str) -> float | None:
    text = getattr(options, name)
    return read_quantity(text, f"--{name}", "m", "0.05um") if text else None


def _write(curve: trajectory.Curve, options: Namespace) -> list[Path]:
    """Write the outputs, none if one of them cannot be made; returns the files written."""
    paths = [Path(name) for name in options.output]
    for write in [_made(curve, path, options) for path in paths]:
        write()
    return paths


def _made(curve: trajectory.Curve, path: Path, options: Namespace) -> Callable[[], object]:
    """Make one output by its suffix; returns a function that writes it."""
    kind = path.suffix.lower()
    if kind == ".json":
        return partial(curve.save, path)
    duration = read_quantity(options.duration, "--duration", "s", "10s") if options.duration else None
    if kind == ".csv":
        clock = {"duration_s": duration or 0.0, "step_s": read_quantity(options.step, "--step", "s", "1ms")}
        times(**clock)  # refuses a clock of too many steps
        return partial(write_table, curve, path, **clock)
    text = gcode(curve, chord_m=_length(options, "chord") or 0.0, duration_s=duration)
    return partial(atomic_write, path, text)


def choice_content(choice: trajectory.Choice, shape: str) -> Content:
    """Return the chosen curve in a sentence, then the methods beside each other, the chosen one marked."""
    best, limit = choice.best, choice.tolerance_m
    within = "" if limit is None else f", within the tolerance of {number(1e6 * limit, 4)} um"
    why = "; the most exact" if limit is None else "; fewest numbers to store"
    why = why if len(choice.candidates) > 1 else ""
    how = "bounded over the whole range" if choice.curve.error_kind == "bounded" else "at the points"
    answer = (
        f"{best.method.words}: {choice.curve.control_points} control points, error "
        f"{number(1e6 * best.error_m, 4)} um ({how}){within}{why}."
    )
    head = ["", "method", "points", "control", "numbers", "max error [um]", "why not"]
    table = Table(head, [_row(choice, c) for c in choice.candidates], "methods", left=2, wordy=(6,))
    rotation = choice.curve.source.get("max_error_rad")
    angle = [] if rotation is None else [f"largest error of an angle: {number(1e6 * rotation, 4)} urad"]
    return Content("Curve", answer, first=[*angle, shape, table])


def _row(choice: trajectory.Choice, c: trajectory.Candidate) -> list[str]:
    if c.curve is None:
        return ["x", c.method.name, str(c.points or "-"), "-", "-", "-", c.reason]
    mark = ">" if c is choice.best else "" if choice.meets(c) else "x"
    numbers = (c.points, c.curve.control_points, c.curve.form.numbers)
    return [mark, c.method.name, *map(str, numbers), number(1e6 * c.error_m, 4), ""]


def _shape(curve: trajectory.Curve) -> dict[str, Any]:
    return {"length_m": curve.length(), "extent": {name: list(ends) for name, ends in curve.extent().items()}}


def _shape_text(record: dict[str, Any]) -> str:
    parts = [f"length of path {number(1e3 * record['length_m'], 6)} mm"]
    for name, (low, high) in record["extent"].items():
        stem, _, si = name.rpartition("_")
        factor, unit = (1e3, "mm") if si == "m" else reading_unit(si)
        parts.append(f"{stem} {number(factor * low, 6)} .. {number(factor * high, 6)} {unit}")
    return "; ".join(parts)
