"""`hallsym plan`: what to record next.

Choose vertical settings and trajectories with most information about parameters, from the ranges,
frequencies and time that you state, and write them as a campaign file that a lab can follow and
'hallsym simulate' runs.
"""

from argparse import Namespace
from typing import Any

from hallsym.cli import OK, common
from hallsym.errors import InputError, require
from hallsym.estimation import fit, load_fit
from hallsym.estimation.self_calibration import REFERENCES, seen, waves_of
from hallsym.estimation.task import noise_of
from hallsym.estimation.without_reference import fit_without_reference, terms_of, usual_model
from hallsym.experiment import CRITERIA, Ranges, paper_ranges, plan, read_ranges
from hallsym.experiment.turns import TurnPlan
from hallsym.families.machine_file import Machine, read_machine
from hallsym.log import Log
from hallsym.model import Model
from hallsym.records import named
from hallsym.simulation import is_the_papers, table8_noise, write_campaign
from hallsym.units import read_quantity

EPILOG = """\
examples:
  hallsym plan ranges.toml -o next.toml --runs 20
  hallsym plan ranges.toml -o next.toml --minutes 30 --criterion max-u --values calib.json
  hallsym plan ranges.toml -o next.toml --runs 10 --after log.parquet --plots pictures
  hallsym plan --like-paper -o next.toml
  hallsym plan --reference constant-speed --model rings3 --machine ring.toml   open waves of its Halls
  hallsym plan --reference constant-speed --after ring.csv --accuracy 0.01deg   and turns to record
"""
OPTIONS = f"""
ranges TOML <optional>          ranges file (docs/plan.md)
--like-paper                    the ranges of the paper's campaign instead of a file: 57 runs of 1
    s, 1, 2 and 3 Hz
-o, --output TOML               campaign file to write
@plots save pictures
--criterion NAME <=D>           {", ".join(CRITERIA)}: volume of the uncertainty ellipsoid, or worst
    position uncertainty over the ranges (default D)
--runs N <int>                  at most so many runs
--minutes M <float>             at most so long, with resets
--after LOG                     a log that is recorded already, which the plan complements
--values JSON                   calibration to plan for (default: fitted to the log of --after, else
    the published or example values)
--reference REFERENCE <{"|".join(REFERENCES)}>  an encoder of several Halls without a reference:
    list the waves that its Halls leave open, and the turns for an accuracy
--accuracy ANGLE                of such a table, rms of the mechanical angle: 0.01deg
@model stage31
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    if options.reference:
        return _turns(options)
    require(options.accuracy is None, "--accuracy", "given with --reference", options.accuracy)
    ranges, machine, show = _ranges(options), read_machine(options.machine), common.progress_of(options)
    ranges.allowed(options.runs, options.minutes)  # before a log is read and fitted
    log = None
    if options.after:
        known = load_fit(options.values) if options.values else None
        log = common.open_log(options, machine, known, options.after)
    show("finding values")
    model, values, known_by = _truth(options, machine, log)
    noise, source = _noise(options, ranges, model, values, log)
    show("choosing runs")
    given: dict[str, Any] = common.chosen(options, plan) | {"after": log}
    found = plan(ranges, model, values, noise, **given)
    settings = len({setting for _, setting, _ in found.groups()})
    advice = (
        f"the settings ({settings}) are best for {model.name} as it is: record a few runs elsewhere too, and "
        "hold them out of the fit, to see whether the model is right between them."
    )
    notes = [known_by, source, advice]
    if options.output:
        groups = [f"{n} x {setting}; {trajectory}" for n, setting, trajectory in found.groups()]
        head = f"{len(found.campaign.runs)} runs for {model.name}, criterion {found.study.criterion.name}"
        comment = "\n".join([f"Planned by hallsym: {head}.", *groups])
        write_campaign(found.campaign, options.output, comment=comment)
    drawn = common.plots(options, found, options.ranges, model.name, log=log)
    wrote = [options.output, *drawn]
    common.say(options, found, notes=notes, wrote=wrote, more={"notes": notes})
    return OK


def _ranges(options: Namespace) -> Ranges:
    if options.like_paper == (options.ranges is not None):
        raise InputError(
            "Give either a ranges file or --like-paper; nothing is assumed for what may be recorded."
        )
    return paper_ranges() if options.like_paper else read_ranges(options.ranges)


def _truth(options: Namespace, machine: Machine, log: Log | None) -> tuple[Model, dict[str, float], str]:
    """Model, values that the plan is made for, and the sentence that says where they come from."""
    if log is None or options.values:
        model, values = common.truth_of(options, machine)
        known = "Table 7" if is_the_papers(model) else f"the example of {model.family.name}"
        own = machine.probes is not None or bool(machine.tables)
        where = options.values or ("the machine file" if own else known)
        return model, values, f"planned for the values of {where}; other values make other plans."
    fitted = fit(log, options.model, solver="direct", parameters=machine.parameters, effects=options.effect)
    values = named(fitted.model.names, fitted.values)
    return fitted.model, values, f"planned for values fitted to {log.name}."


def _noise(
    options: Namespace, ranges: Ranges, model: Model, values: dict[str, float], log: Log | None
) -> tuple[dict[str, float] | None, str]:
    """Noise by column: the file's own, else the log's, the calibration's, Table 8's; and where it is from."""
    if ranges.noise:
        return None, "noise as the ranges file states it."
    if log is not None:
        return noise_of(log, model).std, f"noise as in {log.name}."
    if options.values:
        known = load_fit(options.values).noise
        return known.std, f"noise as in {options.values}."
    if is_the_papers(model):
        return dict(table8_noise(model, values).sigma), "noise that reproduces Table 8."
    return None, ""


def _turns(options: Namespace) -> int:
    """Plan a recording without a reference."""
    if options.ranges or options.output or options.like_paper or options.runs or options.minutes:
        raise InputError(
            "With --reference the plan is of turns: give --model, --machine, and --after LOG with --accuracy."
        )
    machine, density, lasting = read_machine(options.machine), None, None
    model = common.built(options.model or usual_model(), machine)
    if options.after:
        log = common.open_log(options, machine, path=options.after)
        result = fit_without_reference(log, options.model, options.reference)
        model, density, lasting = result.fit.model, result.found.line.density, result.found.lasting
    pairs, _, _ = terms_of(model)
    target = None
    if options.accuracy:
        target = read_quantity(options.accuracy, "--accuracy", "rad", "0.01deg")
    places = [float(h.place_rad) for h in model.layout]
    if options.after and result.found.closure is not None:  # which period they stand in is known now
        places = [0.0, *result.found.closure.jig.places.tolist()]
    found = TurnPlan(pairs, tuple(places), seen(places, waves_of(pairs)), target, density, lasting)
    common.say(options, found)
    return OK
