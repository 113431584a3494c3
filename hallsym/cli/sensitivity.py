"""`hallsym sensitivity`: what a log, or a plan, determines of each parameter.

State for each parameter: value, standard uncertainty, 95 % interval, strongest correlations,
effect on the decoded pose, and a verdict: determined, weak, at bound, not determined (and which
combinations are), no effect. Null directions are listed, structural ones and those of this
recording. With --plan: the same before any recording.
"""

from argparse import Namespace
from pathlib import Path

from hallsym.cli import NOT_DETERMINED, OK, common
from hallsym.errors import InputError, few
from hallsym.estimation import load_fit
from hallsym.families import build
from hallsym.families.machine_file import read_machine
from hallsym.files import write_json
from hallsym.inference import Identifiability, identify

PAPER = "the paper's campaign"


EPILOG = """\
examples:
  hallsym sensitivity calib.json LOG --plots pictures
  hallsym sensitivity --model stage31 --plan                  the paper's campaign, before data
  hallsym sensitivity calib.json --plan next.toml             what a planned campaign would determine
"""
OPTIONS = """
calibration CALIB <optional>    saved by 'hallsym fit -o'
log LOG <optional>              the log it was fitted to, or another one
--plan TOML <alone>             a campaign file instead of a log (no file: Table 6)
@own
-o, --output JSON               save the report
@plots save a picture of the correlation
[intervals]
--profiles PROFILES <=auto, auto|all|none>  profile likelihood where a normal interval is not good
    enough (default), of all, or of none
@model the calibration's, or stage31
@correct
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    report = _planned(options) if options.plan is not None else _recorded(options)
    if options.output:
        write_json(options.output, report.to_dict())
    drawn = common.plots(options, report, report.evidence.recorded, report.model.name)
    common.say(options, report, wrote=[options.output, *drawn])
    return _exit_code(report)


def _recorded(options: Namespace) -> Identifiability:
    if options.calibration is None or options.log is None:
        raise InputError(
            "hallsym sensitivity needs a calibration and its log, or --plan with a campaign file; see --help."
        )
    if options.model or options.effect or options.machine:
        raise InputError("--model, --effect and --machine belong to --plan; a calibration has its own.")
    known = load_fit(options.calibration, common.own_effects(options))
    log, show = common.open_log(options, known=known, correct=options.correct), common.progress_of(options)
    return identify(known, log, profiles=options.profiles, on_progress=show)


def _planned(options: Namespace) -> Identifiability:
    if options.log is not None:
        raise InputError("Give a log or --plan, not both: a plan is not recorded yet.")
    options.campaign = options.plan or None
    campaign, own = common.campaign_of(options), options.model and build(options.model).family.example
    name = Path(options.plan).name if options.plan else f"the example of {options.model}" if own else PAPER
    if options.calibration is not None:
        known = load_fit(options.calibration, common.own_effects(options))
        noise = common.levels(campaign, known.model, {}) if campaign.noise else None
        return identify(known, campaign, noise=noise, name=name)
    model, values = common.truth_of(options, read_machine(options.machine))
    return identify(model, campaign, values=values, noise=common.levels(campaign, model, values), name=name)


def _exit_code(report: Identifiability) -> int:
    """0, or 3 with one sentence when this recording leaves something undetermined or a result is missing."""
    lost = report.evidence.uncertainty.undetermined_by_log
    if lost:
        common.warn(
            f"{report.evidence.recorded} does not determine {few(lost)} of {report.model.name}; record "
            "runs that move what they belong to ('hallsym plan' chooses them)."
        )
    for sentence in report.partial:
        common.warn(sentence)
    return NOT_DETERMINED if lost or report.partial else OK
