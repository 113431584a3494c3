"""Logs beside their calibration, as a person reads them in a terminal."""

from collections.abc import Mapping, Sequence

from hallsym.estimation import Evaluation
from hallsym.inference import Belonging, ParameterChange
from hallsym.report.tables import cells, grid, heads, in_units


def parameters_text(changes: Sequence[ParameterChange]) -> str:
    """Return the table of parameters before and after."""
    answers = {None: "unknown", True: "yes", False: "no"}
    head = ["parameter", "before (1 sigma)", "after (1 sigma)", "unit", "p of no change", "significant"]
    rows = []
    for p in changes:
        before, unit = in_units(p.before, p.before_std, p.unit)
        after, _ = in_units(p.after, p.after_std, p.unit)
        chance = "" if p.p_value is None else f"{p.p_value:.1g}"
        rows.append([p.name, before, after, unit, chance, answers[p.significant]])
    return grid([head, *rows], left=1)


SHOWN = 6
"""Parameters without an answer that a line names."""


def belonging_text(found: Belonging) -> str:
    """Return whether a log belongs to its calibration, and what changed where it does not."""
    lines = [found.sentence]
    if not found.belongs:
        lines += ["", parameters_text(found.changes)]
    for why in dict.fromkeys(found.not_identified.values()):
        names = [name for name, said in found.not_identified.items() if said == why]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        lines.append(f"not compared, {why}: {', '.join(names[:SHOWN])}{more}")
    return "\n".join(lines)


def chart_text(logs: Mapping[str, tuple[Evaluation, Belonging | str] | str], pose: Sequence[str]) -> str:
    """Return one row a log: errors, residual error, the test that is nearest to its limit, the verdict.

    The reason stands in place of what is not known.
    """
    head = ["log", "runs", *heads(pose, what="rmse"), "residual/noise", "largest score", "of", "limit", ""]
    rows = [head]
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
        rows.append([*row, f"{worst.score:+.2f}", worst.name, f"{worst.limit:.2f}", verdict])
    return grid(rows)
