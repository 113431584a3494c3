"""`hallsym diagnose`: where the gap lies, which effect causes it, how far it shrinks.

Fit a model on a log, find the residual error above the noise, which effect causes it, and
how far the error shrinks with that effect in the model, judged on holdout runs.
"""

import shlex
from argparse import Namespace
from typing import Any

from hallsym.cli import INTERRUPTED, OK
from hallsym.cli.common import chosen, open_log, own_effects, progress_of, reading_words, say
from hallsym.codegen import price
from hallsym.diagnosis import Examined, examine, model_on, prepare
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.families import default_model
from hallsym.families.machine_file import read_machine
from hallsym.files import atomic_write, write_json
from hallsym.log import Log
from hallsym.log.columns import read_runs
from hallsym.model import Model
from hallsym.power import REPEATS, detection_power
from hallsym.report.content import document
from hallsym.report.data.gather import gather
from hallsym.report.panels import by_groups
from hallsym.report.results.diagnosis import diagnosis_content

EVERY = "all"
"""Word for every effect of the catalogue."""


EPILOG = """\
examples:
  hallsym diagnose LOG --model stage31
  hallsym diagnose LOG --model calib.json --holdout 2,7,12 --json
  hallsym diagnose LOG --effects my_effects.py -o report.html
  hallsym diagnose LOG --power hysteresis,time_skew      from which size on these would be found
"""
OPTIONS = f"""
log LOG                         log, or a folder with log and meta.json
--power EFFECTS <optional, alone={EVERY}>  instead: the detection power behind 'no gap': inject
    effects (by name; all take an hour or two, Ctrl-C keeps the results so far) into its motion and
    noise, and diagnose each simulated log blind
--repeats REPEATS <int={REPEATS}>  trials of each size with --power (default {REPEATS})
--holdout RUNS                  runs to judge on (default: the log's own, else every fifth)
@own
--budget SECONDS <float>        end the search after so long with the result so far and a note
    (default: no limit)
-o, --output FILE <repeat>      save the diagnosis: .html for one page to read and print, anything
    else for JSON (repeat)
@model the log's base_model, else by its columns
@correct
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine, own = read_machine(options.machine), own_effects(options)
    known = load_fit(options.model, own) if str(options.model).endswith(".json") else None
    log = open_log(options, machine, known, correct=options.correct)
    name = options.model or default_model(log.meta)
    holdout = None if options.holdout is None else read_runs(options.holdout, "--holdout")
    if known:
        model: Model | Fit = known
    else:
        given: dict[str, Any] = {"parameters": machine.parameters, "own": own, "holdout": holdout}
        model = model_on(log, name, options.effect, drop_bad=options.drop_bad, **given)
    more = {"holdout": holdout, "effects": tuple(own.values()), "on_progress": progress_of(options)}
    if options.power:
        if options.budget is not None:
            raise InputError("--budget ends one search; --power makes many: choose one of the two.")
        return _power(options, log, model, more)
    seen = examine(prepare(log, model, **(chosen(options, prepare) | more)), price)
    found = seen.diagnosis
    for path in options.output:
        if path.lower().endswith((".html", ".htm")):
            atomic_write(path, _page(options, seen))
        else:
            write_json(path, found.to_dict())
    words = reading_words(options, known)
    say(options, found.to_dict(), lambda: diagnosis_content(found, reading=words), wrote=options.output)
    return OK


def _power(options: Namespace, log: Log, model: Model | Fit, more: dict[str, Any]) -> int:
    """Report which effects a diagnosis of this log would find, and above which size."""
    named = [n.strip() for n in options.power.split(",") if n.strip()]
    given = chosen(options, detection_power) | more | {"names": None if options.power == EVERY else named}
    found = detection_power(log, model, **given)
    for path in options.output:
        write_json(path, found.to_dict())
    say(options, found, wrote=options.output)
    return OK if found.complete else INTERRUPTED


def _page(options: Namespace, seen: Examined) -> str:
    """The page of a diagnosis, with maps and series of the residual error, before and after."""
    first = seen.fit
    shown = gather(seen.before.log, first, label="before", keep=first.keep, after=seen.after)
    content = diagnosis_content(
        seen.diagnosis,
        maps=shown.maps,
        groups=by_groups(first, shown),
        series=shown.series,
        fit=first,
        command=_typed(options, first),
        reading=reading_words(options),
    )
    return document(content)


def _typed(options: Namespace, first: Fit) -> str:
    """Return the command that writes the page again; the name of the page does not change the page."""
    words = ["hallsym", "diagnose", options.log, "--model", options.model or first.model.name]
    words += [word for effect in options.effect for word in ("--effect", effect)]
    words += ["--holdout", options.holdout] if options.holdout else []
    words += [] if options.budget is None else ["--budget", f"{options.budget:g}"]
    return shlex.join([*words, *reading_words(options), "-o", "report.html"])
