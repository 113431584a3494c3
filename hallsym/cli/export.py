"""`hallsym export`: a calibration as the table of a maker's firmware.

Write the calibration of an encoder as the correction table of a maker's firmware, in its bytes,
and print the error over a turn before and after. 'hallsym fit' reads such tables as logs.
"""

from argparse import Namespace

from hallsym.cli import NOT_DETERMINED, OK
from hallsym.cli.common import chosen, own_effects, say
from hallsym.codegen.table import export_table
from hallsym.estimation.calibration import load_fit
from hallsym.log.maker_tables import BY_NAME

EPILOG = """\
examples:
  hallsym export calib.json --table simplefoc -o table.h             for CalibratedSensor, 200 entries
  hallsym export calib.json --table mechaduino --like Parameters.cpp -o Parameters.new.cpp
                                       the numbers of that file replaced; its zero and all else stay
  hallsym export calib.json --table klipper --motor-steps 200 -o angle.cfg
  hallsym export calib.json --table csv --entries 360 -o table.csv   readings and angles, for any other
"""


OPTIONS = f"""
calibration CALIB               a calibration saved by 'hallsym fit -o'
--table FORMAT <required>       one of {", ".join(BY_NAME)}
-o, --output FILE <required>    file to write
--like FILE                     the maker's own file: its layout, number of entries, zero, sense and
    all else are kept, and the error with its old table is printed too
--entries N <int>               entries of the table (default: as the firmware has)
--motor-steps N <int>           full steps in a turn of the stepper that was the reference: its
    waves, N/4 a turn and multiples, are left out; tables by full steps have N entries (default:
    200)
--keep-reference                include the error of the reference that the calibration estimated
    (default: left out)
--allow-undetermined            use values that the log does not determine
@own
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    fit = load_fit(options.calibration, own_effects(options))
    made = export_table(fit, options.table, **chosen(options, export_table))
    made.write(options.output)
    say(options, made, notes=made.notes, wrote=[options.output], more={"output": options.output})
    return NOT_DETERMINED if made.undetermined else OK
