"""`hallsym fit`: calibrate a model on a log.

Calibrate a model on a log of Hall readings beside a reference. Prints errors before and after,
parameters with standard uncertainties in parentheses (on the last two digits), and what the data
determine in place of parameters that are confusable. Where the model does not describe the log,
the report begins with that, and the exit code is 3; the calibration is written all the same.
"""

import shlex
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from hallsym.cli import INTERRUPTED, NOT_CONVERGED, NOT_DESCRIBED, NOT_DETERMINED, OK, common
from hallsym.errors import InputError, counted, few
from hallsym.estimation.calibration import Fit
from hallsym.estimation.fit import fit
from hallsym.estimation.self_calibration import REFERENCES
from hallsym.estimation.task import model_of
from hallsym.estimation.without_reference import check_referenced, fit_without_reference
from hallsym.families import added_effects, plain
from hallsym.families.machine_file import Machine, read_machine
from hallsym.log import Log
from hallsym.log.columns import read_runs
from hallsym.model import Model

EPILOG = """\
examples:
  hallsym fit campaign.parquet -o calib.json --plots pictures
  hallsym fit log.csv --column hall_a_um=HallA --column x_ref_um=IFM_X ... --holdout 2,7,12
  hallsym fit log.mat --machine mystage.toml --json > calib.json
  hallsym fit campaign.parquet --effect hysteresis    what 'hallsym diagnose' found
  hallsym fit before.csv after.csv --per-log 'eta_*'  one device, gains before and after a repair
  hallsym fit ring.csv --model rings3 --reference none  three Halls over a ring and nothing beside them
"""
OPTIONS = f"""
logs LOG <several>              Parquet, CSV, MATLAB or HDF5 file, or a folder with log and
    meta.json; several logs of one device share their parameters
-o, --output JSON               save the calibration
@plots save pictures
@model the log's base_model, else by its columns
@own
[fit]
--reference REFERENCE <{"|".join(REFERENCES)}>  encoders of several Halls whose log has no
    reference: what is known of the motion instead
--holdout RUNS                  runs to judge on and not to fit, such as 2,7,12 or 40-45
--holdout-log LOG <repeat>      a log to judge on and not to fit (repeat)
--per-log NAMES                 parameters of which each log has its own, such as eta_A,zero or
    'eta_*'
--solver SOLVER <=hybrid>       hybrid (SHTLBO + closed form), direct (closed form), or the global
    search: shtlbo, tlbo, gbtlbo, screening
--loss LOSS <=auto>             auto (take out isolated spikes if there are any), none, reject
@correct
--accept CLAIM <repeat>         overrule a claim by its name, such as delay; 'all' overrules every one
    (repeat)
--seed SEED <seed=0>            of the global search (default 0)
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    common.refuse_twice(options.logs)
    if options.reference:
        return _without_reference(options, machine)
    separate = options.per_log or options.holdout_log
    if not separate and (files := common.runs_in_files(options, options.logs)):
        options.logs, options.join = files[:1], [*files[1:], *options.join]
    several = len(options.logs) > 1 or bool(separate)
    logs, judged = _opened(options, options.logs, machine), _opened(options, options.holdout_log, machine)
    for log in (*logs, *judged):
        check_referenced(log, model_of(log, options.model))
    shared: dict[str, Any] = {
        "own": common.own_effects(options),
        "holdout": None if options.holdout is None else read_runs(options.holdout, "--holdout"),
        "drop_bad": options.drop_bad,
        "on_progress": common.progress_of(options),
    }
    model: Model | str | None = options.model
    effects, parameters = options.effect, machine.parameters
    if effects and not several:
        from hallsym.diagnosis import model_on  # half of the start of a fit, which most do not need

        model = model_on(logs[0], options.model, effects, parameters=parameters, **shared)
        effects, parameters = (), {}
    given = common.chosen(options, fit) | shared | {
        "parameters": parameters, "effects": effects, "corrections": options.correct, "holdout_logs": judged,
        "noise": None,  # the logs have it
        "per_log": [name for name in (options.per_log or "").split(",") if name],
    }  # fmt: skip
    result = fit(logs if several else logs[0], model, **given)
    if result.goodness and not several:
        goodness = replace(result.goodness, next_command=_diagnose(options, result))
        result = result.changed(goodness=goodness)
    wrote = _saved(options, result)
    parts = list(zip([log.name for log in result.logs], logs, result.by_log, strict=False))
    for name, log, part in parts or [("", logs[0], result)]:
        folder = options.plots and Path(options.plots) / name
        wrote += common.plots(options, part, log.path, part.model.name, folder=folder, log=log)
    common.say(options, result, wrote=wrote, then=_next(options, result))
    return exit_code(result, said=not options.json)


def _without_reference(options: Namespace, machine: Machine) -> int:
    """Calibrate an encoder whose log has no reference; 3 where waves of its table are not separated."""
    alone = "cannot stand beside --reference: one log is calibrated, its last turn as holdout; leave it out"
    common.refuse(options, ("holdout", "holdout_log", "per_log", "correct"), alone)
    if len(options.logs) > 1:
        raise InputError("With --reference give one log; its runs may be recordings at several speeds.")
    log = common.open_log(options, machine, path=options.logs[0])
    result = fit_without_reference(
        log, options.model, options.reference, effects=options.effect,
        parameters=machine.parameters,
    )  # fmt: skip
    if options.output:
        result.save(options.output)
    drawn = common.plots(options, result, log.path, result.fit.model.name)
    then = [] if options.output else [*options.typed, "-o", "calib.json"]
    common.say(options, result, wrote=[options.output, *drawn], then=then)
    if result.open and not options.json:
        common.warn(f"{counted(len(result.open), 'wave')} of the table not separated from the motion.")
    return NOT_DETERMINED if result.open else OK


def _opened(options: Namespace, paths: list[str], machine: Machine) -> list[Log]:
    """Return the logs, each of which is given once."""
    common.refuse_twice(paths)
    return [common.open_log(options, machine, path=path) for path in paths]


def _saved(options: Namespace, result: Fit) -> list[str | Path]:
    """Save the calibration, and one of each log where logs have parameters of their own; return the files."""
    if not options.output:
        return []
    result.save(options.output)
    wrote: list[str | Path] = [options.output]
    if result.joint is not None and result.joint.own:
        path = Path(options.output)
        for log, part in zip(result.joint.logs, result.by_log, strict=False):
            wrote.append(path.with_name(f"{path.stem}.{log}{path.suffix}"))
            part.save(wrote[-1])
    return wrote


def _diagnose(options: Namespace, result: Fit) -> str:
    """Return the command that explains the residual: undo what is claimed, else diagnose it."""
    undo = [
        w for one in result.claims if one.explains and one.correction for w in ("--correct", one.correction)
    ]
    if undo:
        return shlex.join([*options.typed, *undo])
    words = ["hallsym", "diagnose", options.logs[0], "--model", plain(result.model).name]
    words += [word for effect in added_effects(result.model) for word in ("--effect", effect)]
    words += ["--holdout", options.holdout] if options.holdout else []
    return shlex.join([*words, *common.reading_words(options)])


def _next(options: Namespace, result: Fit) -> list[str]:
    """Return the words of the command that follows a fit, where its first line does not say one."""
    if (result.goodness and result.goodness.sentence) or result.status != "converged":
        return []
    if not options.output:
        return [*options.typed, "-o", "calib.json"]
    if result.undetermined_by_log:
        return ["hallsym", "sensitivity", options.output, options.logs[0], *common.samples_words(options)]
    words = ["hallsym", "report", options.output, options.logs[0], *common.samples_words(options)]
    return [*words, "-o", "report.html"]


def exit_code(result: Fit, *, said: bool = True) -> int:
    """0, or 3 and 4 with one sentence on stderr that says what is missing, or wrong with the recording.

    `said`: the text that was printed begins with the sentence on a model that does not describe its log.
    """
    for one in result.claims:
        common.warn(one.text)
    if result.status != "converged":
        common.warn(f"the solver did not converge ({result.status}): {result.message}.")
        if result.status == "interrupted":
            return INTERRUPTED
        # a mistake that explains the residual is the cause: correct it first
        return NOT_DESCRIBED if any(one.explains for one in result.claims) else NOT_CONVERGED
    if result.undetermined_by_log:
        what = few(result.undetermined_by_log)
        common.warn(
            f"this log does not determine {what} of {result.model.name}: they are fixed or combined as the "
            "table says; record runs that move what they belong to."
        )
        return NOT_DETERMINED
    amiss = result.goodness and result.goodness.sentence
    if amiss and not said:
        common.warn(amiss)
    return NOT_DESCRIBED if amiss or result.claims else OK
