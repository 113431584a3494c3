"""What a person reads of a plan, in um and urad."""

import numpy as np

from hallsym.experiment import Comparison, Plan, Worst
from hallsym.report.tables import grid
from hallsym.units import readable


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
    ]
    if plan.before is not None:
        lines.append(
            f"worst-determined combination of the {runs(plan.recorded)} recorded: {worst_text(plan.before)}"
        )
    lines.append(f"worst-determined combination with the plan: {worst_text(plan.after)}")
    lines.append(f"worst u (1 sigma) of the position over the ranges: {_position(plan, plan.position)}")
    if study.criterion.name == "max-u":
        lines[-1] += f" (counted in {_position(plan, study.ranges.references(study.model.pose))})"
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
