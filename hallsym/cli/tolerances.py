"""`hallsym tolerances`: which tolerance of a machine is worth money, before any data."""

from argparse import Namespace
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import campaign_of, command, model_options, plots_options, plots_place, say, seed
from hallsym.families import build
from hallsym.families.machine_file import read_machine
from hallsym.log import Meta
from hallsym.model import Model
from hallsym.simulation.paper import DESIGNED


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "tolerances", run,
        "Draw machines with every parameter in its tolerance, read them with the nominal decoder, and say\n"
        "how much of the error each tolerance makes: fall of the rms error if it is exact or halved, Sobol\n"
        "indices with 95 % intervals, and what a calibration would remove. Needs SALib:\n"
        "pip install 'hallsym[sobol]'.",
        "examples:\n"
        "  hallsym tolerances                                 Table 1 with the ranges of Table 3\n"
        "  hallsym tolerances --model halbach                 usual tolerances of sensors and boards\n"
        "  hallsym tolerances --ranges drawing.toml --machine mystage.toml --plots pictures\n"
        "\n"
        "a tolerance file:\n"
        "  [tolerance]\n"
        "  H1x_um = 20                                        rectangular, half width\n"
        '  H1y_um = { half_width = 20, distribution = "triangular" }\n'
        "  theta_A_deg = { std = 0.1 }                        normal\n"
        "  eta_A_percent = 2                                  of the nominal value",
    )  # fmt: skip
    parser.add_argument(
        "campaign", metavar="TOML", nargs="?",
        help="campaign over which errors count (default: the paper's campaign)",
    )  # fmt: skip
    parser.add_argument(
        "--ranges",
        metavar="TOML",
        help="tolerances; if not given, the usual ones of such machines with their effects, else the "
        "model's bounds about the nominal values",
    )
    parser.add_argument(
        "--samples", type=int, default=1024, metavar="N",
        help="base samples, a power of two (default 1024)",
    )  # fmt: skip
    parser.add_argument("--seed", type=seed, default=0, help="of the machines drawn (default 0)")
    plots_options(parser, "save a picture of the indices")
    parser.set_defaults(step=None, duration=None)
    model_options(parser, DESIGNED)


def run(options: Namespace) -> int:
    """Carry the command out."""
    from hallsym.report.text.tolerances import tolerances_text
    from hallsym.uncertainty.tolerances import read_tolerances, tolerances

    machine = read_machine(options.machine)

    def made(*effects: str) -> Model:
        name, meta = options.model or DESIGNED, machine.applied(Meta())
        return build(name, meta=meta, added=effects, parameters=machine.parameters)

    model = made(*options.effect)
    if not options.effect and options.ranges is None:
        model = made(*filter(None, model.family.tolerances))
    ranges = None if options.ranges is None else read_tolerances(options.ranges, model)
    found = tolerances(model, campaign_of(options), ranges=ranges, samples=options.samples, seed=options.seed)
    pictures = []
    if options.plots:
        from hallsym.report.figures.tolerances import save_tolerances

        pictures = save_tolerances(found, plots_place(options, options.ranges, model.name))
    say(options, found.to_dict(), lambda: tolerances_text(found), wrote=pictures)
    return OK
