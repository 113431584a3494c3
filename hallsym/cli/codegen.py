"""`hallsym codegen`: a calibration as C for the controller.

Write the decoupler of a calibration as a folder of C99: no heap, no libm, same bits everywhere,
with a parameter table that a recalibration replaces, a self-test and proofs.
"""

from argparse import Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import NOT_DETERMINED, OK
from hallsym.cli.common import chosen, column_numbers, column_ranges, say
from hallsym.codegen import Generated, generate
from hallsym.codegen.folder import name_of
from hallsym.codegen.generation import sha256
from hallsym.codegen.naming import PREFIX
from hallsym.codegen.observer import Observer, observer_of
from hallsym.codegen.templates import LICENSE
from hallsym.errors import InputError, counted, few
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.log import read_log

EPILOG = """\
examples:
  hallsym codegen calib.json -o firmware                      C99, float32, parameters, self-test, proofs
  hallsym codegen new.json -o firmware --params-only          recalibrated: the parameters alone
  hallsym codegen calib.json -o firmware --range z_um=-200:200   the box within which status is 0
  hallsym codegen angle.json -o firmware --accuracy angle_mrad=1   an encoder: the smallest code within it
then: make -C firmware check qemu misra prove
"""


OPTIONS = f"""
calibration CALIB               a calibration saved by 'hallsym fit -o'
-o, --output FOLDER <required>  folder to write
--params-only                   replace the parameters of a generated folder, not its code
--force                         replace generated files that are there
--range COLUMN=LOW:HIGH <repeat>  box of a pose, state or reading column: --range z_um=-200:200
    (repeat; default: as recorded)
--arithmetic ARITHMETIC <float|q31>  float (default), or q31: 32-bit integers, for a controller
    without a floating-point unit
--accuracy COLUMN=ANGLE         encoders: largest error of the correction of the angle besides
    rounding, as angle_mrad=1 (default: angle_nrad=30, of q31 angle_urad=10); a coarser one takes
    a smaller table; magnet arrays: of a place, as x_um=0.1
--name NAME                     prefix of symbols and files, such as enc_left (default: decoupler):
    several decouplers then fit in one image
--license SPDX                  SPDX expression in every file, such as MIT (default: {LICENSE},
    yours to license)
--predict LOG                   with decoupler_predict(): position and speed at a time that the
    controller states, by an observer whose bandwidth has the least error on this log
--bandwidth HZ <float>          of --predict, in place of the log's
--latency SECONDS <float=0.0>   of --predict: from the pose to the timestamp of its sample, which a
    prediction adds (default: 0)
--jacobian                      with derivatives of the pose with respect to the readings, for
    Kalman filters
--allow-undetermined            use values that the log does not determine
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    fit = load_fit(options.calibration)
    made = _made(fit, options)
    made.write(options.output, force=options.force, params_only=options.params_only)
    files = sorted(made.params if options.params_only else made.files)
    wrote = f"{counted(len(files), 'file')} to {options.output}: {few(files)}"
    say(options, made, notes=made.notes, wrote=[wrote])
    return NOT_DETERMINED if fit.undetermined_by_log else OK


def _made(fit: Fit, options: Namespace) -> Generated:
    digest = sha256(Path(options.calibration).read_bytes())
    columns = (*fit.model.pose, *fit.model.state, *fit.model.channels)
    folder, accuracy = Path(options.output), None
    if options.accuracy is not None:
        example = "angle_mrad=1"
        accuracy = column_numbers(options.accuracy, fit.model.pose, "--accuracy", example)[1][0]
    given: dict[str, Any] = chosen(options, generate) | {
        "ranges": column_ranges(options.range, columns),
        "accuracy": accuracy,
        "calibration_sha256": digest,
        "name": options.name or (name_of(folder) if options.params_only else PREFIX),
        "observer": _observer(fit, options),
        "like": folder if options.params_only else None,
    }
    return generate(fit, **given)


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
