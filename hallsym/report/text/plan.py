"""What a person reads of a plan, in um and urad."""

import numpy as np

from hallsym.errors import counted
from hallsym.experiment import Plan, Worst
from hallsym.report.tables import grid
from hallsym.units import readable


def plan_text(plan: Plan) -> str:
    """Return what `hallsym plan` prints: chosen runs and what they determine."""
    study, n = plan.study, len(plan.campaign.runs)
    each, resets = study.ranges.seconds_per_run, study.ranges.reset_s
    time = f"{plan.minutes:.3g} min" + ("" if resets is not None else " without resets")
    lines = [
        f"{study.model.name}: {counted(n, 'run')} of {each:g} s ({time}), criterion "
        f"{study.criterion.name}, from {len(study.candidates)} candidates in {plan.seconds:.1f} s",
        "",
        grid([["runs", "setting", "trajectory"], *([str(k), s, t] for k, s, t in plan.groups())], left=3),
        "",
    ]
    if plan.before is not None:
        lines.append(
            f"worst-determined combination of the {counted(plan.recorded, 'run')} recorded: "
            f"{worst_text(plan.before)}"
        )
    lines.append(f"worst-determined combination with the plan: {worst_text(plan.after)}")
    lines.append(f"worst u (1 sigma) of the position over the ranges: {_position(plan, plan.position)}")
    if study.criterion.name == "max-u":
        lines[-1] += f" (counted in {_position(plan, study.ranges.references(study.model.pose))})"
    return "\n".join(lines)


def worst_text(worst: Worst) -> str:
    """Return the combination and how well it is known."""
    if worst.std is None:
        return f"{worst.text} (each over its bound width), not determined"
    return f"{worst.text} (each over its bound width), +- {100 * worst.std:.2g} % of it (1 sigma)"


def _position(plan: Plan, values: np.ndarray) -> str:
    model = plan.study.model
    shown = [(*readable(c, model.period), v) for c, v in zip(model.pose, values, strict=True)]
    return ", ".join(f"{name} {value * factor:.3g} {unit}" for factor, unit, name, value in shown)
