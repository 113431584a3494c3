"""`hallsym evaluate`: errors of a saved calibration on other logs, and whether they belong to it.

Decode logs with a saved calibration, tabulate the errors against the reference, and say of each
log whether it still belongs to the calibration: its residual error and each parameter that it
identifies, from a fit of its own, are tested. The zero deviations of each run are estimated from
that run: a reset is a reset. Several logs are one row each.
"""

import shlex
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from hallsym.cli import BAD_INPUT, CHANGED, NOT_DESCRIBED, OK, common
from hallsym.errors import InputError
from hallsym.estimation import Evaluation, Fit, evaluate, load_fit
from hallsym.inference import FALSE_ALARM, Belonging, belonging, check_false_alarm
from hallsym.log import Fault
from hallsym.report.content import printed, text_of
from hallsym.report.data.periodic import periodic_of
from hallsym.report.results.evaluation import (
    Judged,
    belonging_blocks,
    chart,
    evaluation_content,
)

EPILOG = """\
exit codes: 0 every log belongs; 1 one does not; 2 bad input, or a log could not be decoded; 3 the
calibration does not describe a log, or the recording is at fault

examples:
  hallsym evaluate calib.json other.csv
  hallsym evaluate calib.json week_*.tdms --plots pictures
  hallsym evaluate calib.json today.mf4 --clock Hall || mail -s 'calibrate again' lab
"""
OPTIONS = f"""
calibration CALIB               a calibration saved by 'hallsym fit -o'
logs LOG <several>              logs to judge on, in the order of time
@own
--by-run                        all errors of each log, one line per run
--own-zero                      estimate the zero of a periodic reference from each run too: it was
    homed or coupled anew
--false-alarm P <float={FALSE_ALARM}>  familywise false-alarm rate of the tests of a log (default
    {FALSE_ALARM:g})
@plots save pictures
@correct
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    check_false_alarm(options.false_alarm)
    known, show = load_fit(options.calibration, common.own_effects(options)), common.progress_of(options)
    common.refuse_twice(options.logs)
    logs: dict[str, Judged | str] = {}
    for k, path in enumerate(options.logs):
        if len(options.logs) > 1:
            show(f"log {k + 1} of {len(options.logs)}")
        try:
            logs[path] = _judged(options, known, path)
        except InputError as error:
            if len(options.logs) == 1:
                raise
            logs[path] = str(error)
    judged = {path: one for path, one in logs.items() if not isinstance(one, str)}
    changed = [
        path for path, (_, found) in judged.items() if isinstance(found, Belonging) and not found.belongs
    ]
    record = {
        "calibration": options.calibration, "model": known.model.name, "false_alarm": options.false_alarm,
        "changed": changed,
        "logs": [_record(options, path, *one) if path in judged else {"log": path, "reason": one}
                 for path, one in logs.items()],
    }  # fmt: skip
    faults = [str(n) for seen, _ in judged.values() for n in seen.notes if isinstance(n, Fault)]
    amiss = [seen.goodness.sentence for seen, _ in judged.values() if seen.goodness.sentence]
    wrote = [file for path, (seen, _) in judged.items() for file in _pictured(options, path, seen)]
    then = ["hallsym", "codegen", options.calibration, "-o", "decoupler"]
    if changed and not amiss:
        then = _diagnose(options, changed[0])
    elif amiss or faults or len(judged) < len(logs) or known.model.computed:
        then = []
    common.say(options, record, lambda: _text(options, known, logs), wrote=wrote, then=then)
    for said in (*faults, *(amiss if options.json or len(logs) > 1 else [])):
        common.warn(said)
    for path, one in logs.items():
        if isinstance(one, str):
            common.warn(f"{path} could not be decoded: {one}")
    if changed:
        return CHANGED
    if len(judged) < len(logs):
        return BAD_INPUT
    return NOT_DESCRIBED if amiss or faults else OK


def _judged(options: Namespace, known: Fit, path: str) -> Judged:
    log = common.open_log(options, known=known, path=path, correct=options.correct)
    seen = evaluate(known, log, own_zero=options.own_zero, drop_bad=options.drop_bad)
    next_command = shlex.join(_diagnose(options, path))
    seen = replace(seen, goodness=replace(seen.goodness, next_command=next_command, what="The calibration"))
    try:
        return seen, belonging(seen, false_alarm=options.false_alarm)
    except InputError as error:
        return seen, str(error)


def _diagnose(options: Namespace, path: str) -> list[str]:
    return ["hallsym", "diagnose", path, "--model", options.calibration, *common.reading_words(options)]


def _record(options: Namespace, path: str, seen: Evaluation, found: Belonging | str) -> dict[str, Any]:
    periodic = periodic_of(seen.calibration, seen.log) if options.json else None
    return {
        "log": path, **seen.to_dict(), "periodic_error": periodic.to_dict() if periodic else None,
        "belonging": {"reason": found} if isinstance(found, str) else found.to_dict(),
    }  # fmt: skip


def _pictured(options: Namespace, path: str, seen: Evaluation) -> list[Path]:
    folder = options.plots and Path(options.plots) / (Path(path).stem if len(options.logs) > 1 else "")
    return common.plots(options, seen, path, options.calibration, folder=folder)


def _text(options: Namespace, known: Fit, logs: dict[str, Judged | str]) -> str:
    parts = [] if len(logs) == 1 else [text_of(chart(logs, known.model.pose)).rstrip()]
    for path, one in logs.items():
        if isinstance(one, str):
            continue
        seen, found = one
        if len(logs) == 1 or options.by_run:
            parts.append(printed(evaluation_content(seen, by_run=options.by_run)).rstrip())
        notes = list(seen.notes)
        if isinstance(found, str):
            notes.append(f"Whether {path} belongs to the calibration cannot be said: {found}")
        else:
            notes += found.notes
            if len(logs) == 1 or not found.belongs:
                answer, *rest = belonging_blocks(found)
                answer = answer if len(logs) == 1 else f"{path}: {answer}"
                parts.append(text_of([answer, *rest]).rstrip())
        parts += ["\n".join(f"note: {note}" for note in dict.fromkeys(notes))] if notes else []
    return "\n\n".join(parts)
