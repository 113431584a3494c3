"""A control chart of logs against their calibration as a person reads it in a terminal."""

import shlex
from collections.abc import Sequence

from hallsym.report.tables import grid
from hallsym.report.text.comparison import parameters_text
from hallsym.watching import Watch, WatchedLog

SHOWN = 6
"""Parameters without an answer that a line names."""


def watch_text(found: Watch, words: Sequence[str] = ()) -> str:
    """Return what `hallsym watch` prints: a line a log, and what changed in those that do not belong.

    `words`: of the command, which its next step needs too.
    """
    parts = [_head(found), "", _chart(found)]
    parts += [
        "score: distance from the calibration in standard deviations; beyond the limit in 1 of"
        f" {1 / found.false_alarm:.0f} logs that belong"
    ]
    shown = found.changed or tuple(log for log in found.logs if log.tests)[-1:]
    for log in shown:
        parts += ["", f"{log.name}: {log.sentence}"]
        parts += [parameters_text(log.changes)] if log.changes else []
        parts += _left(log)
        if log.beyond and found.calibration.endswith(".json"):
            command = ["hallsym", "diagnose", log.name, "--model", found.calibration, *words]
            parts.append(f"next: {shlex.join(command)}")
    parts += [f"not judged: {log.reason}" for log in found.not_judged]
    notes = [f"note: {note}" for note in found.notes]
    notes += [f"note: {log.name}: {note}" for log in found.logs for note in log.notes]
    return "\n".join([*parts, *notes])


def _head(found: Watch) -> str:
    judged = len(found.logs) - len(found.not_judged)
    said = f"{len(found.changed)} of {judged} logs do not belong" if found.changed else "every log belongs"
    if len(found.logs) == 1:
        said = "the log does not belong" if found.changed else "the log belongs"
    elif found.not_judged:
        which = f"{len(found.changed)} of them do not belong" if found.changed else "all of them belong"
        said = f"{judged} of {len(found.logs)} logs could be judged; {which}"
    if not judged:
        return f"no log could be judged against the calibration {found.calibration} ({found.model})"
    return f"{said} to the calibration {found.calibration} ({found.model})"


def _chart(found: Watch) -> str:
    head = ["log", "runs", "residual/noise", "after a fit", "calibration", "largest score", "of", "limit", ""]
    rows = [head]
    for log in found.logs:
        if not log.tests:
            rows.append([log.name, *[""] * 7, log.verdict])
            continue
        worst = max(log.tests, key=lambda test: test.distance)
        numbers = (log.residual, log.refitted, log.floor)
        rows.append(
            [log.name, str(log.runs), *("" if v is None else f"{v:.3f}" for v in numbers),
             f"{worst.score:+.2f}", worst.name, f"{worst.limit:.2f}", log.verdict]
        )  # fmt: skip
    return grid(rows)


def _left(log: WatchedLog) -> list[str]:
    """Say of which parameters the log tells nothing, by reason."""
    lines = []
    for why in dict.fromkeys(log.not_identified.values()):
        names = [name for name, said in log.not_identified.items() if said == why]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        lines.append(f"not compared, {why}: {', '.join(names[:SHOWN])}{more}")
    return lines
