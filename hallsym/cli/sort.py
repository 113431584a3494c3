"""`hallsym sort`: sensors by gain, in bins and in sets for arrays.

Sort sensors by gain, from the readings of each in two or more known fields: gain with uncertainty,
its bin and the probability of the wrong one, and the repeatability. With --model, choose the sets
of sensors whose gains disturb the decoded position least.
"""

from argparse import Namespace
from pathlib import Path

from hallsym.cli import OK
from hallsym.cli.common import FILE_OPTIONS, built, progress_of, refuse, say
from hallsym.errors import InputError, require
from hallsym.estimation import load_fit
from hallsym.families import build
from hallsym.families.machine_file import read_machine
from hallsym.files import write_json
from hallsym.log import Foreign, parse_column_option
from hallsym.records import named
from hallsym.report.results.sorting import save_table, sorting_content
from hallsym.sorting import WIDTH, Matching, Sorting, match_sensors, read_readings, sort_sensors
from hallsym.sorting.readings import SENSOR
from hallsym.units import with_unit

EPILOG = """\
examples:
  hallsym sort bench.csv -o sorted.csv
  hallsym sort bench.csv --field 0mT,475mT --column reading_0_v=Zero --column reading_1_v=Field
  hallsym sort bench.csv --model halbach --sets 12 -o sets.csv

a table, one row a reading (or one row a measurement: field_0_t, reading_0_v, reference_0_v, field_1_t, ...):
  sensor,t_s,field_mt,reading_v,reference_v
  R1-0001,0,0,0.0021,0.0010
  R1-0001,9,475,0.9513,0.8817
"""
OPTIONS = f"""
table FILE                      readings of the sensors: csv, parquet, hdf5 or mat
--bin PERCENT <float={100 * WIDTH}>  width of a bin (default .5 %% of the gain)
--nominal GAIN <float>          middle of bin 0 (default: the median gain)
--repeatability PERCENT <float>  of one measurement (1 sigma); found from sensors that were measured
    again where not given
--field LIST                    fields of reading_0, reading_1, ..., such as 0mT,475mT, where the
    table has none
-o, --output FILE               csv: a row a sensor; json: everything
@table
@model none: no sets are chosen
[sets for arrays, with --model]
--sets N <int>                  how many (default: as many as there are sensors for)
--per-channel N <int=1>         sensors summed into each channel (default 1)
--values JSON                   calibration of the array (default: nominal values)
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    _check(options)
    show = progress_of(options)
    show("reading")
    readings = read_readings(
        options.table,
        columns=dict(map(_column, options.column)),
        fields=_fields(options.field),
        **{name: getattr(options, name) for name in FILE_OPTIONS if name != "clock"},
    )
    show("sorting")
    found = sort_sensors(
        readings,
        width=options.bin / 100,
        nominal=options.nominal,
        repeatability=None if options.repeatability is None else options.repeatability / 100,
    )
    matching = _matching(options, found) if options.model else None
    record = found.to_dict() | ({"matching": matching.to_dict()} if matching else {})
    if options.output and Path(options.output).suffix == ".json":
        write_json(options.output, record)
    elif options.output:
        save_table(options.output, found, matching)
    say(options, record, lambda: sorting_content(found, matching), wrote=[options.output])
    return OK


def _check(options: Namespace) -> None:
    own = ("machine", "effect")
    if not options.model:
        per_channel = ["per_channel"] if options.per_channel != 1 else []
        names = ("sets", "values", *own, *per_channel)
        refuse(options, names, "says how sets are chosen; give the array's --model too")
    if options.values:
        refuse(options, own, "is part of the model that --values holds; leave it out")
    kind = Path(options.output).suffix if options.output else ".csv"
    require(kind in (".csv", ".json"), "--output", "a .csv (a row a sensor) or .json (everything)", kind)


def _column(text: str) -> tuple[str, str | Foreign]:
    ours, _, theirs = (part.strip() for part in text.partition("="))
    return (ours, theirs) if ours == SENSOR and theirs else parse_column_option(text)


def _fields(text: str | None) -> list[float]:
    """Read `0mT,475mT` in T."""
    found = [with_unit(part.lower()) for part in text.split(",")] if text else []
    values = [value for value in found if value is not None and (value[1] == "t" or value == (0.0, ""))]
    require(len(values) == len(found), "--field", "fields with their unit, such as 0mT,475mT", text)
    return [value for value, _ in values]


def _matching(options: Namespace, found: Sorting) -> Matching:
    machine = read_machine(options.machine)
    if options.values:
        known = load_fit(options.values)
        if known.model.name != build(options.model).name:
            raise InputError(f"--values holds a {known.model.name}; give --model {known.model.name}.")
        model, values = known.model, named(known.model.names, known.values)
    else:
        model, values = built(options.model, machine, options.effect), None
    return match_sensors(found, model, sets=options.sets, members=options.per_channel, values=values)
