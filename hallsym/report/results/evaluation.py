"""Report of a calibration on other logs: its errors, and whether the logs belong to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hallsym.errors import counted, few
from hallsym.estimation import Evaluation
from hallsym.estimation.calibration import rmse_interval
from hallsym.inference import Belonging, ParameterChange
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.results import shared
from hallsym.report.results.fit import fit_figure, periodic_blocks
from hallsym.report.tables import attributes, cells, heads, in_units
from hallsym.report.words import number

Judged = tuple[Evaluation, Belonging | str]
"""The errors of a log, and whether it belongs; or why its own fit, which the tests need, failed."""


def evaluation_content(found: Evaluation, *, by_run: bool = False) -> Content:
    """Return the verdict, then the errors with the noise floor; `by_run`: with one line per run."""
    pose, period, runs = found.model.pose, found.model.period, found.table.runs
    rows: dict[str, Any] = {"all runs" if len(runs) > 1 else "all samples": found.table.over()}
    each: dict[str, Any] = {f"run {run}": found.table.over([run]) for run in runs if by_run}
    source = "" if {s.source for s in found.noise.sigmas.values()} == {"given"} else "estimated"
    samples = counted(int(found.table.count.sum()), "sample")
    where = f" in {counted(len(runs), 'run')}" if len(runs) > 1 else ""
    known = {"": rmse_interval(found.table)}
    errors = shared.error_table(pose, rows, found.noise_floor, source, period, intervals=known)
    return Content(
        f"{found.model.name} on {shared.called(found.log.path)}",
        found.goodness.verdict,
        [Section("repeating", "Errors that repeat", periodic_blocks(found.calibration, found.log))],
        [
            "",
            f"{found.model.name} on {found.log.name}: {samples}{where}",
            errors,
            shared.errors_by("by run", each, pose, period),
        ],
        state="bad" if found.goodness.sentence else "good",
        columns=_columns(found),
        pictures={"errors_by_setting": lambda log: fit_figure(found.decoded, found.applied)},
    )


def _columns(found: Evaluation) -> dict[str, list[Any]]:
    """Return rmse and peak of each run as columns, in SI."""
    by_run = [found.table.over([run]) for run in found.table.runs]
    columns = {
        f"{what}_{c}": [row[what][c] if row else float("nan") for row in by_run]
        for what in ("rmse", "peak")
        for c in found.model.pose
    }
    return {"run": list(found.table.runs), **columns}


def belonging_blocks(found: Belonging) -> list[Block | str]:
    """Return whether a log belongs to its calibration, and what changed where it does not."""
    blocks: list[Block | str] = [found.sentence]
    if not found.belongs:
        blocks.append(changes_table(found.changes))
    for why in dict.fromkeys(found.not_identified.values()):
        names = [name for name, said in found.not_identified.items() if said == why]
        blocks.append(f"not compared, {why}: {few(names)}")
    return blocks


def belonging_content(found: Belonging) -> Content:
    """Return whether a log belongs, what changed where it does not, and each test."""
    answer, *blocks = belonging_blocks(found)
    tests = attributes(found.tests, "name", "p_value", "score", "limit")
    return Content(
        "Belonging", str(answer), first=blocks, state="good" if found.belongs else "bad", columns=tests
    )


def changes_table(changes: Sequence[ParameterChange]) -> Table:
    """Return the parameters before and after."""
    answers = {None: "unknown", True: "yes", False: "no"}
    head = ["parameter", "before (1 sigma)", "after (1 sigma)", "unit", "p of no change", "significant"]
    rows = []
    for c in changes:
        before, unit = in_units(c.before, c.before_std, c.unit)
        after, _ = in_units(c.after, c.after_std, c.unit)
        chance = "" if c.p_value is None else number(c.p_value, 1)
        rows.append([c.name, before, after, unit, chance, answers[c.significant]])
    return Table(head, rows, "parameters before and after")


def chart(logs: Mapping[str, Judged | str], pose: Sequence[str]) -> list[Block | str]:
    """Return how many logs belong, then one row a log: errors, the test nearest to its limit, the verdict.

    Unknown entries state the reason.
    """
    head = ["log", "runs", *heads(pose, what="rmse"), "residual/noise", "largest score", "of", "limit", ""]
    rows, belong = [], 0
    for name, judged in logs.items():
        if isinstance(judged, str):
            rows.append([name, *[""] * (len(head) - 2), "not decoded"])
            continue
        seen, found = judged
        errors = seen.table.over() or {"rmse": dict.fromkeys(pose, float("nan"))}
        rmse = cells([errors["rmse"][c] for c in pose], pose, digits=4)
        row = [name, str(len(seen.table.runs)), *rmse, f"{seen.goodness.residual_over_noise:.3f}"]
        if isinstance(found, str):
            rows.append([*row, "", "", "", "not tested"])
            continue
        worst, verdict = found.worst, "belongs" if found.belongs else "changed"
        belong += found.belongs
        rows.append([*row, f"{worst.score:+.2f}", worst.name, f"{worst.limit:.2f}", verdict])
    answer = f"{belong} of {counted(len(logs), 'log')} belong{'s' * (belong == 1)} to the calibration."
    return [answer, Table(head, rows, "by log")]
