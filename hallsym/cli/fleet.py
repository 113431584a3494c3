"""`hallsym fleet`: calibrate many devices.

Calibrate every device of a fleet, as many at once as there are cores, and write one row a device:
parameters, uncertainties, verdict, and the reason where a log could not be fitted. The same
command resumes a fleet that was interrupted. Prints how parameters
spread between devices beyond the uncertainty of a fit, and which devices differ. The exit code is
3 where a device is not good.
"""

from argparse import Namespace
from dataclasses import replace
from typing import Any

from hallsym.cli import NOT_DESCRIBED, OK
from hallsym.cli.common import chosen, progress_of, reading_of, refuse, say
from hallsym.errors import require
from hallsym.estimation.self_calibration import REFERENCES
from hallsym.families.machine_file import read_machine
from hallsym.files import atomic_write
from hallsym.fleets import Fleet, RingFleet, devices_of, fleet, machine_file, ring_fleet, tolerance_file
from hallsym.fleets.row import GOOD
from hallsym.log import Drop, read_log, without
from hallsym.report.views import page_of

EPILOG = """\
examples:
  hallsym fleet logs/ --model rotary -o fleet.parquet
  hallsym fleet logs/*.parquet -o fleet.parquet --page fleet.html --next-machine next.toml
  hallsym fleet devices.csv --diagnose -o fleet.parquet    a table: log,device,supplier
  hallsym fleet logs/ -o fleet.parquet --scheduler tcp://host:8786
"""
OPTIONS = f"""
logs LOGS <several>             a folder of logs, logs, or a table with columns log, device, ...
-o, --output TABLE              the table: .parquet or .csv
--page HTML                     write a page with distributions
--next-machine TOML             write nominal values and bounds for the next batch
--tolerances TOML               write the spread for 'hallsym tolerances --ranges'
@model the logs' base_model, else by their columns
[fleet]
--diagnose                      diagnose each log too; takes seconds a device
--workers N <int>               processes that fit devices (default: one a core)
--reference REFERENCE <{"|".join(REFERENCES)}>  rings of one jig whose logs have no reference: what
    is known of the motion instead; heads and drive are taken as common to all
--each-run                      with --reference: each run of a log is a device
--scheduler ADDRESS             Dask scheduler to use instead: tcp://host:8786
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    if options.reference:
        return _rings(options)
    require(not options.each_run, "--each-run", "given with --reference", "--each-run")
    given: dict[str, Any] = chosen(options, fleet) | {
        "effects": options.effect,
        "reading": {key: value for key, value in reading_of(options).items() if value},
        "on_progress": progress_of(options),
    }
    found = fleet(options.logs, options.model, **given)
    for path, make in ((options.next_machine, machine_file), (options.tolerances, tolerance_file)):
        if path:
            atomic_write(path, make(found))
    return _said(options, found, found)


def _said(options: Namespace, found: Fleet | RingFleet, devices: Fleet) -> int:
    """Write the page of the result and print its report; 3 where a device is not good."""
    if options.page:
        atomic_write(options.page, page_of(found))
    say(options, found, wrote=[options.output, options.next_machine, options.tolerances, options.page])
    return OK if set(devices.verdicts) <= {GOOD} else NOT_DESCRIBED


def _rings(options: Namespace) -> int:
    """Calibrate rings of one jig without a reference."""
    own = ("diagnose", "scheduler", "next_machine", "tolerances")
    refuse(options, own, "is not for logs without a reference; leave it out")
    machine, reading = read_machine(options.machine), reading_of(options)
    logs = {}
    for device in devices_of(options.logs):
        log = read_log(device.log, drop_bad=options.drop_bad, **{k: v for k, v in reading.items() if v})
        log = replace(log, meta=machine.applied(log.meta))
        runs = log.runs
        if not options.each_run:
            logs[device.name] = log
            continue
        for run in runs:
            rest = Drop(runs=frozenset(r for r in runs if r != run))
            logs[str(run) if len(options.logs) == 1 else f"{device.name} {run}"] = without(log, rest)
    found = ring_fleet(
        logs, options.model, options.reference, effects=options.effect, parameters=machine.parameters,
        workers=options.workers, on_progress=progress_of(options),
    )  # fmt: skip
    if options.output:
        found.save(options.output)
    return _said(options, found, found.fleet)
