"""What a person reads of a plan, in um and urad."""

from hallsym.errors import counted
from hallsym.experiment import Plan, Worst
from hallsym.log import as_log
from hallsym.report.content import Content, Section, Table
from hallsym.report.figures.plan import coverage
from hallsym.report.results.shared import each
from hallsym.report.words import number


def plan_content(plan: Plan) -> Content:
    """Return what is said of a plan: what it determines, and the runs."""
    study, n = plan.study, len(plan.campaign.runs)
    long, resets = study.ranges.seconds_per_run, study.ranges.reset_s
    time = f"{number(plan.minutes)} min" + ("" if resets is not None else " without resets")
    pose, period = study.model.pose, study.model.period
    worst = dict(zip(pose, plan.position, strict=True))
    uncertain = f"worst u (1 sigma) of the position over the ranges: {each(worst, period)}"
    if study.criterion.name == "max-u":
        counted_in = dict(zip(pose, study.ranges.references(pose), strict=True))
        uncertain += f" (counted in {each(counted_in, period)})"
    before: list[str] = []
    if plan.before is not None:
        recorded = counted(plan.recorded, "run")
        before = [f"worst-determined combination of the {recorded} recorded: {worst_text(plan.before)}"]
    rows = [[str(k), setting, trajectory] for k, setting, trajectory in plan.groups()]
    return Content(
        f"Plan for {study.model.name}",
        f"{counted(n, 'run')} of {long:g} s ({time}); worst-determined combination with the plan: "
        f"{worst_text(plan.after)}.",
        [Section("runs", "Runs", [Table(["runs", "setting", "trajectory"], rows, "runs to record", left=3)])],
        [
            f"{study.model.name}: criterion {study.criterion.name}, from {len(study.candidates)} candidates",
            *before,
            uncertain,
        ],
        picture=lambda log: coverage(plan, None if log is None else as_log(log)),
        seconds=plan.seconds,
        columns={
            "runs": [k for k, _, _ in plan.groups()],
            "setting": [setting for _, setting, _ in plan.groups()],
            "trajectory": [trajectory for _, _, trajectory in plan.groups()],
        },
    )


def worst_text(worst: Worst) -> str:
    """Return the combination and how well it is known."""
    if worst.std is None:
        return f"{worst.text} (each over its bound width), not determined"
    return f"{worst.text} (each over its bound width), +- {number(100 * worst.std, 2)} % of it (1 sigma)"
