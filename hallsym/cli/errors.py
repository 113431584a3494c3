"""`hallsym errors`: what known causes make of the decoded position along a coordinate."""

from argparse import Namespace
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import (
    column_numbers,
    column_ranges,
    command,
    model_options,
    plots_options,
    plots_place,
    say,
)
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.families.machine_file import read_machine
from hallsym.log import Meta
from hallsym.model import Model
from hallsym.simulation.paper import DESIGNED


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "errors", run,
        "Read a machine with known deviations over a period, or a range, of one coordinate, decode it\n"
        "without knowing them, and print the error by cause: each effect alone, then all together.",
        "examples:\n"
        "  hallsym errors --model halbach --effect gain_mismatch --set gain_0_percent=1\n"
        "  hallsym errors --model rotary --effect gain_mismatch --set mismatch_percent=0.3 --plots pictures\n"
        "  hallsym errors --over x_um=-500:500 --set theta_A_deg=0.1",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE",
        help="value of a parameter of the machine, in SI or with a unit in the name: --set gain_0_percent=1 "
        "(repeat); what decodes it has the nominal values",
    )  # fmt: skip
    parser.add_argument(
        "--over", action="append", default=[], metavar="COLUMN=FROM:TO",
        help="coordinate that moves, with a unit in the name: x_mm=0:30 (default: a period)",
    )  # fmt: skip
    parser.add_argument(
        "--at", action="append", default=[], metavar="COLUMN=VALUE",
        help="where another coordinate rests: z_mm=4.2 (repeat)",
    )  # fmt: skip
    parser.add_argument(
        "--decoder", default="least-squares", metavar="NAME",
        help="least-squares over all channels (default), closed-form, or a formula of the model",
    )  # fmt: skip
    parser.add_argument("--samples", type=int, default=360, metavar="N", help="places (default 360)")
    plots_options(parser, "save a picture of the errors")
    model_options(parser, DESIGNED)


def run(options: Namespace) -> int:
    """Carry the command out."""
    from hallsym.report.text.errors import errors_text
    from hallsym.uncertainty import error_model
    from hallsym.uncertainty.tolerances import read_value

    machine = read_machine(options.machine)
    model = build(
        options.model or DESIGNED,
        meta=machine.applied(Meta()),
        added=tuple(options.effect),
        parameters=machine.parameters,
    )
    values = {}
    for text in options.set:
        name, value = read_value(model, text, "--set")
        if name in values:
            raise InputError(f"Parameter {name} has two values in --set; keep one.")
        values[name] = value
    columns = (*model.pose, *model.state)
    found = error_model(
        model,
        values,
        over=_range(options, model),
        at=dict(_place(text, columns) for text in options.at),
        decoder=options.decoder,
        samples=options.samples,
    )
    pictures = []
    if options.plots:
        from hallsym.report.figures.along import save_errors

        pictures = save_errors(found, plots_place(options, found.model.name))
    say(options, found.to_dict(), lambda: errors_text(found), wrote=pictures)
    return OK


def _place(text: str, columns: tuple[str, ...]) -> tuple[str, float]:
    column, (value,) = column_numbers(text, columns, "--at", f"{text.partition('=')[0]}=1")
    return column, value


def _range(options: Namespace, model: Model) -> tuple[str, float, float] | None:
    from hallsym.uncertainty import usual_range

    found = column_ranges(options.over, (*model.pose, *model.state), "--over")
    if len(found) > 1:
        raise InputError(f"--over takes one coordinate; instead received {', '.join(found)}.")
    if found:
        ((column, (low, high)),) = found.items()
        return column, low, high
    if usual_range(model) is None:
        raise InputError(
            f"No coordinate of {model.name} repeats: state the range with --over, such as "
            f"--over {model.pose[0].rpartition('_')[0]}_um=-500:500."
        )
    return None
