"""What a person reads of a plan, in um and urad."""

import numpy as np

from hallsym.experiment import Comparison, Plan, Worst
from hallsym.report.tables import grid
from hallsym.units import readable

WORTH = 1.02
"""Curves that gain less than 2 % in the criterion are not worth the trouble."""


def plan_text(plan: Plan) -> str:
    """Return what `hallsym plan` prints: chosen runs, what they determine, the comparison."""
    study, n = plan.study, len(plan.campaign.runs)
    each, resets = study.ranges.seconds_per_run, study.ranges.reset_s
    time = f"{plan.minutes:.3g} min" + ("" if resets is not None else " without resets")
    lines = [
        f"{study.model.name}: {runs(n)} of {each:g} s ({time}), criterion "
        f"{study.criterion.name}, from {len(study.candidates)} candidates in {plan.seconds:.1f} s",
        "",
        grid([["runs", "setting", "trajectory"], *([str(k), s, t] for k, s, t in plan.groups())], left=3),
        "",
        f"criterion: {100 * plan.choice.efficiency:.1f} % of what no plan of {runs(n)} exceeds",
    ]
    if plan.before is not None:
        lines.append(
            f"worst-determined combination of the {runs(plan.recorded)} recorded: {worst_text(plan.before)}"
        )
    lines.append(f"worst-determined combination with the plan: {worst_text(plan.after)}")
    lines.append(f"worst u (1 sigma) of the position over the ranges: {_position(plan, plan.position)}")
    if study.criterion.name == "max-u":
        lines[-1] += f" (counted in {_position(plan, study.ranges.references(study.model.pose))})"
    if plan.sines is not None:
        lines += ["", curves_text(plan, plan.sines)]
    if plan.comparison is not None:
        lines += ["", comparison_text(plan, plan.comparison)]
    return "\n".join(lines)


def runs(n: int) -> str:
    """Return `1 run`, `2 runs`."""
    return f"{n} run" if n == 1 else f"{n} runs"


def worst_text(worst: Worst) -> str:
    """Return the combination and how well it is known."""
    if worst.std is None:
        return f"{worst.text} (each over its bound width), not determined"
    return f"{worst.text} (each over its bound width), +- {100 * worst.std:.2g} % of it (1 sigma)"


def curves_text(plan: Plan, sines: Comparison) -> str:
    """Return whether curves are worth it, and by how much against a plan of sines only."""
    n, name = len(plan.campaign.runs), plan.study.criterion.name
    if sines.other is None or sines.planned is None:
        return f"curves: {plan.curves} of {runs(n)} follow one; {runs(n)} of sines only determine less"
    gain, times = plan.choice.value / sines.other.value, sines.other.std / sines.planned.std
    if not plan.curves or gain < WORTH:
        reached = f"{100 / gain:.1f} % of the same {name}"
        return f"curves are not worth it here: {runs(n)} of sines only reach {reached}"
    as_good = f"; the same {name} in {runs(sines.runs_same_value)}" if sines.runs_same_value else ""
    return (
        f"curves are worth it: {plan.curves} of {runs(n)} follow one. Against {runs(n)} of sines only {name} "
        f"is {gain:.2f} times as large{as_good};\nstandard uncertainties are smaller by {times.min():.2f} to "
        f"{times.max():.2f}, median {np.median(times):.2f}"
    )


def comparison_text(plan: Plan, c: Comparison) -> str:
    """Return the table of a plan beside another campaign of as many runs."""
    name, a, b = plan.study.criterion.name, c.other, c.planned
    if a is None or b is None:
        return f"compared with {c.name}: {runs(c.runs)} that cannot determine {plan.study.model.name}"
    rows = [["", c.name, f"plan, {runs(c.runs)}", "smaller by"]]
    for coordinate, one, two in zip(plan.study.model.pose, a.position, b.position, strict=True):
        factor, unit, short = readable(coordinate, plan.study.model.period)
        sizes = (f"{one * factor:.3g}", f"{two * factor:.3g}", f"{one / two:.2f}")
        rows.append([f"worst u of {short}, 1 sigma [{unit}]", *sizes])
    if a.worst.std and b.worst.std:
        shares = (f"{100 * a.worst.std:.2g}", f"{100 * b.worst.std:.2g}")
        rows.append(["worst combination, 1 sigma [% of width]", *shares, f"{a.worst.std / b.worst.std:.2f}"])
    times = a.std / b.std
    rows.append(["standard uncertainties, median", "", "", f"{np.median(times):.2f}"])
    lines = [f"each with the {runs(plan.recorded)} recorded already:"] if plan.recorded else []
    lines += [
        grid(rows),
        f"each of the {len(times)} standard uncertainties: smaller by {times.min():.2f} to {times.max():.2f}",
    ]
    for what, n in ((f"the same {name}", c.runs_same_value), ("every uncertainty as small", c.runs_same_std)):
        lines.append(f"{what}: in {runs(n)}" if n else f"{what}: not in {runs(c.runs)}")
    return "\n".join(lines)


def _position(plan: Plan, values: np.ndarray) -> str:
    parts = []
    for coordinate, value in zip(plan.study.model.pose, values, strict=True):
        factor, unit, short = readable(coordinate, plan.study.model.period)
        parts.append(f"{short} {value * factor:.3g} {unit}")
    return ", ".join(parts)
