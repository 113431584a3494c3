"""Does a new log still belong to a calibration? Its residual error and each of its parameters are tested.

Each log is fitted anew from the calibration. What it leaves is compared with what the calibration left (F
test), its parameters with the calibrated ones, each (Student's t) and together (Hotelling's T squared). The
limits share one probability of a false alarm over all tests of a log (Sidak, J. Am. Stat. Assoc. 62 (1967)
626, doi:10.1080/01621459.1967.10482935).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hallsym.errors import InputError
from hallsym.estimation import Evaluation, Fit, evaluate, fit, load_fit, rewired
from hallsym.log import Log, Noise, Sigma, as_log
from hallsym.watching.hypotheses import colour_of, compared, goodness
from hallsym.watching.result import BELONGS, CHANGED, NOT_JUDGED, Watch, WatchedLog

FALSE_ALARM = 1 / 500
"""Probability that a log which belongs to the calibration is called changed: one log in 500."""
LEAST_FALSE_ALARM, MOST_FALSE_ALARM = 1e-6, 0.5
"""Range of that probability: below it, the tails of the distributions are not known so well."""
_CORRELATED = "Noise of neighbouring samples is correlated ({:.2f}); the tests allow for it"


def watch(
    calibration: Fit | str | Path,
    logs: Any,
    *,
    false_alarm: float = FALSE_ALARM,
    drop_bad: bool = False,
    read: Callable[[Any], Log] | None = None,
    name: str = "",
    on_progress: Callable[[str], None] | None = None,
) -> Watch:
    """Say of each log whether it still belongs to a calibration, and what changed where it does not.

    `calibration`: a fit, or the path of a saved one. `logs`: one log or several, each as `fit` takes it, in
    the order of time. `false_alarm`: probability, per log and over all its tests, that one which belongs is
    called changed. `drop_bad`: leave out bad samples. `read`: how a log is opened; by default with the names
    of columns and the options that the calibration knows. `name`: what to call the calibration; by default
    its path.

    The noise of the calibration holds for each log, unless the log states its own. A log that cannot be read,
    or that is not of this machine, is in the result with the reason, and the others are judged.

    Raises `InputError` for a calibration that cannot be read and for no logs, and for a log given twice.
    """
    known = calibration if isinstance(calibration, Fit) else load_fit(calibration)
    if not LEAST_FALSE_ALARM <= false_alarm <= MOST_FALSE_ALARM:
        raise InputError(
            f"The probability of a false alarm must be {LEAST_FALSE_ALARM:g} to {MOST_FALSE_ALARM:g}; instead"
            f" received {false_alarm!r}."
        )
    say = on_progress or (lambda _: None)
    given = _several(logs)
    found = []
    for k, log in enumerate(given):
        say(f"log {k + 1} of {len(given)}")
        try:
            opened = read(log) if read else as_log(log, known.columns, known.read_with)
            found.append(_watched(known, opened, false_alarm, drop_bad))
        except InputError as error:
            found.append(WatchedLog(_named(log), NOT_JUDGED, reason=str(error)))
    named = str(calibration) if isinstance(calibration, str | Path) else "of this session"
    return Watch(name or named, known.model.name, false_alarm, tuple(found), _notes(known))


def _several(logs: Any) -> list[Any]:
    """Return the logs that were given; raise `InputError` for none, and for one that is there twice."""
    several = isinstance(logs, Iterable) and not isinstance(logs, str | Mapping | Log)
    several = several and not hasattr(logs, "__arrow_c_stream__")
    given = list(logs) if several else [logs]
    if not given:
        raise InputError("There must be a log to watch; instead received none.")
    paths = [Path(log).resolve() for log in given if isinstance(log, str | Path)]
    twice = next((path for path in paths if paths.count(path) > 1), None)
    if twice is not None:
        raise InputError(f"Log {twice} is given twice; name each log once, in the order of time.")
    return given


def _named(log: Any) -> str:
    if isinstance(log, Log):
        return log.name
    return str(log) if isinstance(log, str | Path) else "The table"


def _notes(known: Fit) -> tuple[str, ...]:
    """Return what weakens every comparison with a calibration."""
    if known.goodness is None:
        return (
            "The calibration is of an earlier version and does not say what it left; residual errors are held"
            " against its noise alone.",
        )
    if known.log["runs"] - len(known.log["holdout"]) == 1:
        return (
            "The calibration is of one run, which cannot show whether its noise is white; it is taken for"
            " granted.",
        )
    return ()


def _watched(known: Fit, log: Log, false_alarm: float, drop_bad: bool) -> WatchedLog:
    read = rewired(log, known.model.channels, known.wiring)
    stated = replace(read, noise=read.noise.merged(_given(known.noise)))
    seen = evaluate(replace(known, wiring=None), stated, drop_bad=drop_bad)
    after = fit(
        stated,
        known.model.with_parameters({n: {"nominal": known.value(n)} for n in known.model.names}),
        solver="direct",
        holdout=(),
        loss=known.solver["loss"],
        start=known.values,
        drop_bad=drop_bad,
    )
    colour = colour_of(after)
    found = compared(known, after, colour, false_alarm)
    verdict = CHANGED if any(test.beyond for test in found.tests) else BELONGS
    said = (f"{_CORRELATED.format(colour.correlation)}.",) if colour.memory > 1 else ()
    return WatchedLog(
        name=log.name,
        verdict=verdict,
        rows=log.rows,
        runs=len(log.runs),
        residual=seen.goodness.residual_over_noise,
        refitted=goodness(after).residual_over_noise,
        floor=1.0 if known.goodness is None else known.goodness.residual_over_noise,
        errors=_rmse(seen),
        tests=found.tests,
        changes=found.changes,
        not_identified=found.left,
        notes=tuple(dict.fromkeys((*seen.notes, *after.notes, *said))),
    )


def _given(noise: Noise) -> Noise:
    """Return noise as it is stated, so that one scale holds for the calibration and every log."""
    return Noise({column: Sigma(sigma.value, "given") for column, sigma in noise.sigmas.items()})


def _rmse(seen: Evaluation) -> dict[str, float]:
    errors = seen.table.over()
    return {} if errors is None else {name: float(v) for name, v in errors["rmse"].items()}
