"""`hallsym codegen`: a calibration as C for the controller."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import NOT_DETERMINED, OK
from hallsym.cli.common import column_numbers, column_ranges, command, say
from hallsym.codegen import Generated, generate
from hallsym.codegen.folder import name_of
from hallsym.codegen.generation import sha256
from hallsym.codegen.lowering.correction import KINDS as CORRECTIONS
from hallsym.codegen.naming import PREFIX
from hallsym.codegen.observer import Observer, observer_of
from hallsym.codegen.templates import LICENSE
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.log import read_log
from hallsym.units import fitting, readable

EPILOG = """\
examples:
  hallsym codegen calib.json -o firmware                      C99, float32, parameters, self-test, proofs
  hallsym codegen new.json -o firmware --params-only          recalibrated: the parameters alone
  hallsym codegen calib.json -o firmware --range z_um=-200:200   the box within which status is 0
  hallsym codegen angle.json -o firmware --accuracy angle_mrad=1   an encoder: the least code that is as near
then: make -C firmware check qemu misra prove
"""


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "codegen", run,
        "Write the decoupler of a calibration as a folder of C99: no heap, no libm, same bits everywhere,\n"
        "with a parameter table that a recalibration replaces, a self-test and proofs.", EPILOG,
    )  # fmt: skip
    parser.add_argument("calibration", metavar="CALIB", help="a calibration saved by 'hallsym fit -o'")
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder to write")
    parser.add_argument(
        "--params-only", action="store_true",
        help="replace the parameters of a generated folder, not its code",
    )  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace generated files that are there")
    parser.add_argument(
        "--range", action="append", default=[], metavar="COLUMN=LOW:HIGH",
        help="box of a pose, state or reading column: --range z_um=-200:200 (repeat; default: as recorded)",
    )  # fmt: skip
    parser.add_argument(
        "--arithmetic", choices=("float", "q31"),
        help="float (default), or q31: 32-bit integers, for a controller without a floating-point unit",
    )  # fmt: skip
    parser.add_argument(
        "--accuracy", metavar="COLUMN=ANGLE",
        help="encoders: what the correction of the angle may leave besides rounding, as angle_mrad=1 "
        "(default: angle_nrad=30, of q31 angle_urad=10); a coarser one takes fewer waves or a "
        "smaller table; magnet arrays: of a "
        "place, as x_um=0.1",
    )  # fmt: skip
    parser.add_argument(
        "--correction", choices=CORRECTIONS,
        help="encoders: a series of waves, or a table of 64 to 1024 entries (default: auto, fewer bytes)",
    )  # fmt: skip
    parser.add_argument(
        "--name", metavar="NAME",
        help="prefix of symbols and files, such as enc_left (default: decoupler): "
        "several decouplers then fit in one image",
    )  # fmt: skip
    parser.add_argument(
        "--license", metavar="SPDX",
        help=f"SPDX expression in every file, such as MIT (default: {LICENSE}, yours to license)",
    )  # fmt: skip
    parser.add_argument(
        "--predict", metavar="LOG",
        help="with decoupler_predict(): position and speed at the time that the controller asks for, by an "
        "observer whose bandwidth leaves least of this log",
    )  # fmt: skip
    parser.add_argument("--bandwidth", metavar="HZ", type=float, help="of --predict, in place of the log's")
    parser.add_argument(
        "--latency", metavar="SECONDS", type=float, default=0.0,
        help="of --predict: from the pose to the timestamp of its sample, which a prediction adds "
        "(default: 0)",
    )  # fmt: skip
    parser.add_argument("--double", action="store_true", help="double instead of float, for hosts")
    parser.add_argument(
        "--jacobian", action="store_true", help="with slopes of the pose by the readings, for Kalman filters"
    )
    parser.add_argument(
        "--allow-undetermined", action="store_true", help="use values that the log does not determine"
    )


def run(options: Namespace) -> int:
    """Carry the command out."""
    fit = load_fit(options.calibration)
    made = _made(fit, options)
    made.write(options.output, force=options.force, params_only=options.params_only)
    say(options, made.to_dict(), lambda: "\n".join(_text(made, options)), notes=made.notes)
    return NOT_DETERMINED if fit.undetermined_by_log else OK


def _made(fit: Fit, options: Namespace) -> Generated:
    digest = sha256(Path(options.calibration).read_bytes())
    columns = (*fit.model.pose, *fit.model.state, *fit.model.channels)
    ranges, allow = column_ranges(options.range, columns), options.allow_undetermined
    folder, accuracy = Path(options.output), None
    if options.accuracy is not None:
        example = "angle_mrad=1"
        accuracy = column_numbers(options.accuracy, fit.model.pose, "--accuracy", example)[1][0]
    name = options.name or (name_of(folder) if options.params_only else PREFIX)
    return generate(
        fit,
        arithmetic=options.arithmetic,
        ranges=ranges,
        double=options.double,
        jacobian=options.jacobian,
        accuracy=accuracy,
        correction=options.correction,
        allow_undetermined=allow,
        calibration_sha256=digest,
        name=name,
        license=options.license,
        observer=_observer(fit, options),
        like=folder if options.params_only else None,
    )


def _observer(fit: Fit, options: Namespace) -> Observer | None:
    if options.predict is None:
        if options.bandwidth is not None or options.latency:
            raise InputError(
                "--bandwidth and --latency belong to --predict LOG, which names the log to follow."
            )
        return None
    return observer_of(
        fit, read_log(options.predict), bandwidth_hz=options.bandwidth, latency=options.latency
    )


def _small(error: float, si: str, turns: bool) -> str:
    """Return an error of `si` as nm, nrad or mdeg, from 1000 on in a larger unit; `turns`: it goes round."""
    factor, unit = fitting(si, error, turns=turns)
    return f"{error * factor:.3g} {unit}"


def _text(made: Generated, options: Namespace) -> list[str]:
    record, tried = made.to_dict(), made.decoupler.tried
    lines = [f"{record['model']} in {record['type']}, table of {record['table_bytes']} bytes"]
    for c, met in record["error_met"].items():
        unit, bound = c.rpartition("_")[2], record.get("error_bound", {}).get(c)
        turns = readable(c)[1] == "deg"
        most = "" if bound is None else f"error at most {_small(bound, unit, turns)} over the box, "
        lines.append(f"  {c}: {most}{_small(met, unit, turns)} met over {tried} random inputs")
    lines += [f"  {c}: {low:g} to {high:g}" for c, (low, high) in record["box"].items()]
    wrote = sorted(made.params) if options.params_only else sorted(made.files)
    lines += [f"wrote {Path(options.output) / name}" for name in wrote]
    return lines
