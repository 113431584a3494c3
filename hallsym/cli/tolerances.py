"""`hallsym tolerances`: which tolerance of a machine to tighten, and errors by known deviations.

Draw machines with every parameter in its tolerance, read them with the nominal decoder, and say
how much of the error each tolerance causes: decrease of the rms error if it is exact, Sobol
indices with 95 % intervals. With --along, one machine with known deviations along a coordinate:
the error by cause, each effect alone, then all together.
"""

from argparse import Namespace

from hallsym.cli import OK, common
from hallsym.errors import InputError
from hallsym.families.machine_file import read_machine
from hallsym.model import Model
from hallsym.simulation.paper import DESIGNED
from hallsym.toml import column_of
from hallsym.uncertainty import error_model
from hallsym.uncertainty.ranges import read_tolerances, read_value
from hallsym.uncertainty.tolerances import tolerances

EPILOG = """\
examples:
  hallsym tolerances                                 Table 1 with the ranges of Table 3
  hallsym tolerances --model halbach                 usual tolerances of sensors and boards
  hallsym tolerances --ranges drawing.toml --machine mystage.toml
  hallsym tolerances --along x_um=-500:500 --set theta_A_deg=0.1
  hallsym tolerances --model halbach --along x_m --effect gain_mismatch --set gain_0_percent=1

a tolerance file:
  [tolerance]
  H1x_um = 20                                        rectangular, half width
  H1y_um = { half_width = 20, distribution = "triangular" }
  theta_A_deg = { std = 0.1 }                        normal
  eta_A_percent = 2                                  of the nominal value
"""
OPTIONS = f"""
campaign TOML <optional>        campaign over which errors count (default: the paper's campaign, or the
    example of the model's family)
--ranges TOML                   tolerances; if not given, the usual ones of such machines with their
    effects, else the model's bounds about the nominal values
--samples N <int>               base samples, a power of two; if not given, as many as make every
    interval narrower than +-5 points, 1024 at most
--seed SEED <seed=0>            of the machines drawn (default 0)
@plots save a picture of the errors along a coordinate
[known deviations]
--along COLUMN[=FROM:TO]        coordinate that moves: x_mm=0:30, or one that repeats, over a
    period: x_m
--set NAME=VALUE <repeat>       value of a parameter of the machine, in SI or with a unit in the
    name: --set gain_0_percent=1 (repeat); the decoder keeps the nominal values
--at COLUMN=VALUE <repeat>      where another coordinate rests: z_mm=4.2 (repeat)
@model {DESIGNED}
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    name = options.model or DESIGNED
    model = common.built(name, machine, options.effect)
    if options.along:
        return _along(options, model)
    along = f"is for errors along a coordinate; give --along {model.pose[0]} too"
    common.refuse(options, ("set", "at", "plots"), along)
    if not options.effect and options.ranges is None:
        model = common.built(name, machine, [e for e in model.family.tolerances if e])
    ranges = None if options.ranges is None else read_tolerances(options.ranges, model)
    found = tolerances(
        model, common.campaign_of(options), ranges=ranges, samples=options.samples, seed=options.seed
    )
    common.say(options, found)
    return OK


def _along(options: Namespace, model: Model) -> int:
    given = {"TOML": options.campaign, "--ranges": options.ranges, "--seed": options.seed}
    given["--samples"] = options.samples
    for name in filter(given.get, given):
        raise InputError(f"{name} belongs to machines that are drawn; leave it out beside --along.")
    values = {}
    for text in options.set:
        name, value = read_value(model, text, "--set")
        if name in values:
            raise InputError(f"Parameter {name} has two values in --set; keep one.")
        values[name] = value
    columns = (*model.pose, *model.state)
    if "=" in options.along:
        ((column, (low, high)),) = common.column_ranges([options.along], columns, "--along").items()
    else:
        column = column_of(options.along, columns, "--along")[0]
        low, high = 0.0, model.period.get(column, 0.0)
    if not high > low:
        raise InputError(
            f"{column} does not repeat: state its range, such as --along {columns[0]}=-1e-3:1e-3."
        )
    at = common.column_values(options.at, columns)
    found = error_model(model, values, over=(column, low, high), at=at)
    common.say(options, found, wrote=common.plots(options, found, found.model.name))
    return OK
