"""What a person reads of a plan, in um and urad."""

import numpy as np

from hallsym.experiment import Plan, Worst
from hallsym.report.tables import grid
from hallsym.units import readable


def plan_text(plan: Plan) -> str:
    """Return what `hallsym plan` prints: chosen runs and what they determine."""
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
    return "\n".join(lines)


def runs(n: int) -> str:
    """Return `1 run`, `2 runs`."""
    return f"{n} run" if n == 1 else f"{n} runs"


def worst_text(worst: Worst) -> str:
    """Return the combination and how well it is known."""
    if worst.std is None:
        return f"{worst.text} (each over its bound width), not determined"
    return f"{worst.text} (each over its bound width), +- {100 * worst.std:.2g} % of it (1 sigma)"


def _position(plan: Plan, values: np.ndarray) -> str:
    parts = []
    for coordinate, value in zip(plan.study.model.pose, values, strict=True):
        factor, unit, short = readable(coordinate, plan.study.model.period)
        parts.append(f"{short} {value * factor:.3g} {unit}")
    return ", ".join(parts)
