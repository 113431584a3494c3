"""`hallsym sort`: sensors by gain, in bins and in sets for arrays."""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import (
    command,
    file_options,
    model_options,
    plots_options,
    plots_place,
    progress_of,
    say,
    seed,
)
from hallsym.errors import InputError
from hallsym.estimation import load_fit
from hallsym.families import build
from hallsym.families.machine_file import read_machine
from hallsym.log import Meta, parse_column_option
from hallsym.records import named
from hallsym.report.text.sorting import matching_text, save_table, sorting_text
from hallsym.simulation import read_campaign
from hallsym.sorting import METHODS, WIDTH, Matching, Sorting, match_sensors, read_readings, sort_sensors
from hallsym.sorting.readings import NAMES
from hallsym.units import with_unit


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub,
        "sort",
        run,
        "Sort sensors by gain, from the readings of each in two or more known fields beside a reference"
        " sensor\nthat stays on the bench: gain with uncertainty, its bin and the probability of the wrong"
        " one, drift of\nthe bench, repeatability, and sensors that were not seated. With --model, choose"
        " the sets of sensors\nwhose gains disturb the decoded position least.",
        "examples:\n  hallsym sort bench.csv -o sorted.csv --plots pictures\n  hallsym sort bench.csv"
        " --field 0mT,475mT --column reading_0_v=Zero --column reading_1_v=Field\n  hallsym sort bench.csv"
        " --model halbach --sets 12 -o sets.csv\n\na table, one row a reading (or one row a measurement:"
        " field_0_t, reading_0_v, reference_0_v, field_1_t, ...):\n "
        " sensor,t_s,field_mt,reading_v,reference_v\n  R1-0001,0,0,0.0021,0.0010\n "
        " R1-0001,9,475,0.9513,0.8817",
    )
    parser.add_argument("table", metavar="FILE", help="readings of the sensors: csv, parquet, hdf5 or mat")
    parser.add_argument(
        "--bin",
        type=float,
        default=100 * WIDTH,
        metavar="PERCENT",
        help="width of a bin (default .5 %% of the gain)",
    )
    parser.add_argument(
        "--nominal", type=float, metavar="GAIN", help="middle of bin 0 (default: the median gain)"
    )
    parser.add_argument(
        "--repeatability",
        type=float,
        metavar="PERCENT",
        help="of one measurement (1 sigma); found from sensors that were measured again where not given",
    )
    parser.add_argument(
        "--drift",
        default="auto",
        choices=("auto", *METHODS),
        help=(
            "how the reference takes the drift out: smoothed, by each reading, or not (default: what is best)"
        ),
    )
    parser.add_argument(
        "--field",
        metavar="LIST",
        help="fields of reading_0, reading_1, ..., such as 0mT,475mT, where the table has none",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="csv: a row a sensor; json: everything")
    plots_options(parser)
    file_options(parser, "reading the table", "reading_mv=Hall")
    _matching_options(parser)


def _matching_options(parser: ArgumentParser) -> None:
    model_options(parser, "none: no sets are chosen")
    group = parser.add_argument_group("sets for arrays, with --model")
    group.add_argument(
        "--sets", type=int, metavar="N", help="how many (default: as many as there are sensors for)"
    )
    group.add_argument(
        "--per-channel",
        type=int,
        default=1,
        metavar="N",
        help="sensors summed into each channel (default 1)",
    )
    group.add_argument(
        "--campaign", metavar="TOML", help="where errors count (default: a period, or the example)"
    )
    group.add_argument("--values", metavar="JSON", help="calibration of the array (default: nominal values)")
    group.add_argument(
        "--seed", type=seed, default=0, help="of exchanges and of sets drawn to compare (default 0)"
    )


def run(options: Namespace) -> int:
    """Carry the command out."""
    _check(options)
    show = progress_of(options)
    show("reading")
    columns = dict(_column(text) for text in options.column)
    readings = read_readings(
        options.table,
        columns=columns,
        fields=_fields(options.field),
        format=options.format,
        delimiter=options.delimiter,
        decimal=options.decimal,
        sheet=options.sheet,
    )
    show("sorting")
    found = sort_sensors(
        readings,
        width=options.bin / 100,
        nominal=options.nominal,
        drift=options.drift,
        repeatability=None if options.repeatability is None else options.repeatability / 100,
    )
    matching = _matching(options, found) if options.model else None
    written = _written(options, found, matching)
    record = found.to_dict() | ({"matching": matching.to_dict()} if matching else {})
    notes = [*found.notes, *(matching.notes if matching else ())]
    say(options, record, lambda: _text(found, matching), notes=notes, wrote=written)
    return OK


def _check(options: Namespace) -> None:
    names = ("sets", "campaign", "values", "machine", "effect", "seed")
    given = [name for name in names if getattr(options, name)]
    given += ["per-channel"] if options.per_channel != 1 else []
    if given and not options.model:
        raise InputError(f"--{given[0]} says how sets are chosen; give the array's --model too.")
    own = [name for name in ("machine", "effect") if getattr(options, name)]
    if options.values and own:
        raise InputError(f"--values holds a calibrated model with all that it has; leave --{own[0]} out.")
    if options.output and Path(options.output).suffix not in (".csv", ".json"):
        raise InputError(
            f"--output must end with .csv (a row a sensor) or .json (everything); it is {options.output}."
        )


def _column(text: str) -> tuple[str, str]:
    ours, _, theirs = text.partition("=")
    return (
        (ours.strip(), theirs.strip())
        if ours.strip() in NAMES and theirs.strip()
        else parse_column_option(text)
    )


def _fields(text: str | None) -> list[float]:
    """Read `0mT,475mT` in T."""
    found = [with_unit(part.lower()) for part in text.split(",")] if text else []
    values = [value for value in found if value is not None and (value[1] == "t" or value == (0.0, ""))]
    if len(values) != len(found):
        raise InputError(
            f"--field must list fields with their unit, such as 0mT,475mT; instead received {text!r}."
        )
    return [value for value, _ in values]


def _matching(options: Namespace, found: Sorting) -> Matching:
    machine = read_machine(options.machine)
    if options.values:
        known = load_fit(options.values)
        if known.model.name != build(options.model).name:
            raise InputError(f"--values holds a {known.model.name}; give --model {known.model.name}.")
        model, values = known.model, named(known.model.names, known.values)
    else:
        model = build(
            options.model,
            meta=machine.applied(Meta()),
            added=tuple(options.effect),
            parameters=machine.parameters,
        )
        values = None
    where = read_campaign(options.campaign) if options.campaign else None
    return match_sensors(
        found,
        model,
        sets=options.sets,
        members=options.per_channel,
        values=values,
        where=where,
        seed=options.seed,
    )


def _written(options: Namespace, found: Sorting, matching: Matching | None) -> list[str]:
    written = []
    if options.output:
        save_table(options.output, found, matching)
        written.append(options.output)
    if options.plots:
        from hallsym.report.figures import save_sorting

        written += [str(path) for path in save_sorting(found, matching, plots_place(options, options.table))]
    return written


def _text(found: Sorting, matching: Matching | None) -> str:
    parts = [sorting_text(found)]
    if matching:
        parts += ["", matching_text(matching)]
    return "\n".join(parts)
