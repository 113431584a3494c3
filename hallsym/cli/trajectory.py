"""`hallsym trajectory`: a curve for the machine to follow, within a tolerance."""

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hallsym.cli import OK
from hallsym.cli.common import command, plots_options, plots_place, progress_of, say
from hallsym.errors import InputError
from hallsym.units import read_quantity

if TYPE_CHECKING:
    from hallsym.trajectory import Choice, Curve, Method

EPILOG = """\
examples:
  hallsym trajectory points.csv --tolerance 0.05um -o curve.json
  hallsym trajectory --curve "x = r*(t - sin(t)); y = r*(1 - cos(t))" --range t=0:2*pi --value r=1mm \\
      --tolerance 0.05um -o curve.c -o curve.ngc --plots pictures
  hallsym trajectory curve.json --duration 10s --step 1ms -o table.csv
  hallsym trajectory points.csv --method cubic --chord 0.1um -o path.ngc

points.csv has columns such as x_um, y_um, rz_urad, and t if the points have a parameter (else the length of
their chords). Functions of --curve: sin cos tan asin acos atan sinh cosh tanh exp log sqrt.
What a saved curve adds to the uncertainty of a position: hallsym budget FILE --curve curve.json.
"""
OUTPUTS = (".json", ".csv", ".ngc", ".nc", ".gcode", ".c")


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "trajectory", run,
        "Make the curve that the machine follows: from points, or from the nominal curve as an expression.\n"
        "Tries every method (Bernstein and trigonometric curves of high relative accuracy, Chebyshev nodes,\n"
        "splines, least squares, rational functions) and says which holds the tolerance with the fewest\n"
        "numbers. Errors are bounded between the points where the curve is an expression, else estimated.",
        EPILOG,
    )  # fmt: skip
    parser.add_argument(
        "points_file", metavar="POINTS", nargs="?", help="points (.csv), or a saved curve (.json)"
    )
    parser.add_argument("--tolerance", metavar="LENGTH", help="largest error of the curve, such as 0.05um")
    group = parser.add_argument_group("nominal curve")
    group.add_argument("--curve", metavar="TEXT", help='such as "x = r*cos(t); y = r*sin(t)", in m and rad')
    group.add_argument("--range", metavar="NAME=A:B", help="parameter and its range: t=0:2*pi")
    group.add_argument(
        "--value",
        action="append",
        default=[],
        metavar="NAME=NUMBER",
        help="a number of the curve: r=1mm (repeat)",
    )
    group = parser.add_argument_group("method")
    group.add_argument(
        "--points", type=int, metavar="N", help="points taken from --curve (default: the fewest)"
    )
    group.add_argument(
        "--nodes",
        metavar="NAME",
        help="equidistant, interior or chebyshev (default: what suits; of one method equidistant)",
    )
    group.add_argument("--basis", metavar="NAME", help="only this basis: bernstein or trigonometric")
    group.add_argument("--control", type=int, metavar="N", help="control points of a least-squares fit")
    group.add_argument("--method", metavar="NAME", help="only this method of the table, such as cubic")
    group.add_argument(
        "--rounding", metavar="LENGTH", help="what the digits of POINTS are worth, such as 1nm"
    )
    group = parser.add_argument_group("output")
    group.add_argument(
        "-o", "--output", action="append", default=[], metavar="FILE",
        help="the curve as .json, .csv at a clock, .ngc (G-code) or .c (repeat)",
    )  # fmt: skip
    group.add_argument("--duration", metavar="TIME", help="of a .csv: such as 10s")
    group.add_argument("--step", metavar="TIME", help="of a .csv: the clock, such as 1ms")
    group.add_argument("--steady", action="store_true", help="of a .csv: constant speed along the path")
    group.add_argument(
        "--chord", metavar="LENGTH", help="of G-code: G1 blocks within this distance of the curve"
    )
    group.add_argument(
        "--feed", type=float, default=1.0, metavar="MM_S", help="of G-code in mm/s (default 1)"
    )
    plots_options(group, "save pictures of the curve and of its errors")


def run(options: Namespace) -> int:
    """Carry the command out."""
    _check(options)
    if options.points_file and Path(options.points_file).suffix.lower() == ".json":
        return _saved(options)
    from hallsym.trajectory.text import choice_text

    choice, data = _from_curve(options) if options.curve else _from_points(options)
    curve = choice.curve
    written = _write(curve, options)
    if options.plots:
        from hallsym.report.figures.trajectory import save_trajectory

        written += save_trajectory(choice, data, plots_place(options, options.curve or options.points_file))
    record = choice.to_dict() | _shape(curve) | {"written": [str(path) for path in written]}
    say(options, record, lambda: f"{choice_text(choice)}\n{_shape_text(record)}", wrote=written)
    return OK


def _check(options: Namespace) -> None:
    """Refuse what does not go together, before anything is computed."""
    if (options.points_file is None) == (options.curve is None):
        raise InputError("Give either a file of POINTS or the nominal --curve.")
    for name in ("range", "value", "points", "nodes"):
        if getattr(options, name) not in (None, []) and not options.curve:
            raise InputError(f"--{name} belongs to --curve; {options.points_file} is a file.")
    if options.curve and not options.range:
        raise InputError("--curve needs the range of its parameter, such as --range t=0:2*pi.")
    if options.rounding and options.curve:
        raise InputError("--rounding belongs to a file of points; an expression is exact.")
    if options.basis and options.method:
        raise InputError("Give --basis or --method, not both.")
    kinds = [Path(name).suffix.lower() for name in options.output]
    for name, kind in zip(options.output, kinds, strict=True):
        if kind not in OUTPUTS:
            raise InputError(f"Output {name} must end with one of {', '.join(OUTPUTS)}.")
    if len(set(options.output)) != len(options.output):
        raise InputError("An output file is given twice; give each its own name.")
    if ".csv" in kinds and not (options.duration and options.step):
        raise InputError("A .csv at a clock needs --duration and --step, such as --duration 10s --step 1ms.")
    if ".csv" not in kinds and (options.duration or options.step or options.steady):
        raise InputError("--duration, --step and --steady belong to a .csv output; give one with -o.")
    if options.chord and not {".ngc", ".nc", ".gcode"} & set(kinds):
        raise InputError("--chord belongs to a G-code output; give one with -o, such as -o path.ngc.")


def _saved(options: Namespace) -> int:
    """Export a curve that was made before."""
    from hallsym.trajectory import read_curve

    for name in ("tolerance", "control", "method", "basis", "rounding", "plots"):
        if getattr(options, name):
            raise InputError(f"--{name} is for making a curve; {options.points_file} is made already.")
    curve = read_curve(options.points_file)
    written = _write(curve, options)
    record, text = about_curve(curve)
    say(options, record | {"written": [str(path) for path in written]}, lambda: text, wrote=written)
    return OK


def about_curve(curve: "Curve") -> tuple[dict[str, Any], str]:
    """Return what a saved curve is, as a record and in words."""
    record = {
        "method": curve.method,
        "control_points": curve.control_points,
        "max_error_m": curve.max_error_m,
        "error_kind": curve.error_kind,
        **_shape(curve),
    }
    error = curve.max_error_m
    known = "error not known" if error is None else f"error {1e6 * error:.4g} um ({curve.error_kind})"
    said = f"{curve.method}, {curve.control_points} control points, {known}"
    return record, f"{said}\n{_shape_text(record)}"


def _from_curve(options: Namespace) -> "tuple[Choice, Any]":
    from hallsym.trajectory import nominal, of_nominal
    from hallsym.trajectory.nominal import read_span, read_value

    pairs = [read_value(text) for text in options.value]
    if len({name for name, _ in pairs}) != len(pairs):
        raise InputError("--value gives a name twice; keep one.")
    curve = nominal(options.curve, read_span(options.range), dict(pairs))
    choice = of_nominal(
        curve, _tolerance(options), points=options.points, control=options.control, methods=_methods(options),
        nodes=_nodes(options), progress=progress_of(options),
    )  # fmt: skip
    return choice, curve


def _from_points(options: Namespace) -> "tuple[Choice, Any]":
    from hallsym.trajectory import of_points, read_points

    points = read_points(options.points_file)
    if options.rounding:
        points = replace(points, rounding=_length(options.rounding, "--rounding"))
    choice = of_points(
        points, _tolerance(options), control=options.control, methods=_methods(options),
        progress=progress_of(options),
    )  # fmt: skip
    return choice, points


def _nodes(options: Namespace) -> str | None:
    """Return the spacing asked for; of one stated method equidistant, of all of them whatever suits."""
    stated = options.basis or (options.method and options.method != "chebyshev")
    return options.nodes or ("equidistant" if stated else None)


def _tolerance(options: Namespace) -> float | None:
    return _length(options.tolerance, "--tolerance") if options.tolerance else None


def _length(text: str, option: str) -> float:
    return read_quantity(text, option, "m", "0.05um")


def _methods(options: Namespace) -> "tuple[Method, ...]":
    """Return the methods that the options leave."""
    from hallsym.trajectory.basis import basis_named
    from hallsym.trajectory.methods import METHODS, method_named

    if options.method:
        return (method_named(options.method),)
    if options.basis:
        basis_named(options.basis)
        found = tuple(m for m in METHODS if m.name in (options.basis, f"{options.basis}-ls"))
        return tuple(m for m in found if m.fitted) if options.control is not None else found
    return tuple(m for m in METHODS if m.fitted) if options.control is not None else METHODS


def _write(curve: "Curve", options: Namespace) -> list[Path]:
    """Write the outputs, none if one of them cannot be made; returns the files written."""
    paths = [Path(name) for name in options.output]
    ready = [_made(curve, path, options) for path in paths]
    for write in ready:
        write()
    headers = [path.with_suffix(".h") for path in paths if path.suffix.lower() == ".c"]
    return [*paths, *headers]


def _made(curve: "Curve", path: Path, options: Namespace) -> Callable[[], object]:
    """Make one output, as its suffix says; returns what writes it."""
    from hallsym.files import atomic_write
    from hallsym.trajectory.c_code import c_code
    from hallsym.trajectory.export import gcode, times, write_table

    kind = path.suffix.lower()
    if kind == ".c":
        code = c_code(curve, path.stem)
        return partial(code.save, path)
    if kind == ".json":
        return partial(curve.save, path)
    if kind == ".csv":
        clock = {
            "duration_s": read_quantity(options.duration, "--duration", "s", "10s"),
            "step_s": read_quantity(options.step, "--step", "s", "1ms"),
        }
        times(**clock)  # refuses a clock of too many steps
        return partial(write_table, curve, path, **clock, steady=options.steady)
    chord = _length(options.chord, "--chord") if options.chord else None
    text = gcode(curve, chord_m=chord, feed_m_s=1e-3 * options.feed)
    return partial(atomic_write, path, text)


def _shape(curve: "Curve") -> dict[str, Any]:
    """Length of path and extent; the length is None where a curve has no derivatives."""
    try:
        length: float | None = curve.length()
    except InputError:
        length = None
    return {"length_m": length, "extent": {name: list(ends) for name, ends in curve.extent().items()}}


def _shape_text(record: dict[str, Any]) -> str:
    units = {"m": (1e3, "mm"), "rad": (1e6, "urad")}
    parts = [] if record["length_m"] is None else [f"length of path {1e3 * record['length_m']:.6g} mm"]
    for name, (low, high) in record["extent"].items():
        stem, _, unit = name.rpartition("_")
        factor, shown = units[unit]
        parts.append(f"{stem} {factor * low:.6g} .. {factor * high:.6g} {shown}")
    return "; ".join(parts)
