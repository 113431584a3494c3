"""What `hallsym fit` and `hallsym evaluate` print, in um and urad where SI is unwieldy."""

from typing import Any

from hallsym.errors import counted
from hallsym.estimation import Evaluation, Fit
from hallsym.estimation.calibration import MANY
from hallsym.log import Log
from hallsym.model import Parameter
from hallsym.report.data.fit import parameter_rows
from hallsym.report.data.periodic import periodic_of
from hallsym.report.tables import concise, error_rows, grid, in_units
from hallsym.report.text.periodic import periodic_text
from hallsym.units import parameter_unit, readable

TOO_SMALL = 0.1
"""Cost per degree of freedom below which the noise is more than three times what is left."""


def fit_text(fit: Fit) -> str:
    """Return what `hallsym fit` prints: errors, parameters, identifiable combinations, notes."""
    parts = [
        *fit_head(fit),
        "",
        *([] if fit.logs else periodic_lines(fit)),
        *([*several_text(fit), ""] if fit.logs else []),
        parameter_text(fit),
    ]
    if fit.combinations:
        rows = [["identifiable combinations", "value (1 sigma)", "unit"]]
        rows += [[c.expression, *in_units(c.value, c.std, c.unit)] for c in fit.combinations]
        parts += ["", grid(rows)]
    parts += ["", *circumstances(fit)]
    parts += [f"note: {note}" for note in fit.notes]
    return "\n".join(parts)


def fit_head(fit: Fit) -> list[str]:
    """Return the verdict and the errors."""
    log = fit.log
    used = log["runs"] - len(log["holdout"])
    fitted = [each["name"] for each in fit.logs if not each["held_out"]]
    name = counted(len(fitted), "log") if fitted else log["path"] or "a log in memory"
    labels = {"designed": "nominal", "holdout": "held out"}
    rows = {labels.get(k, k): v for k, v in fit.error_rows.items()}
    return [
        *(f"claim: {one.text}" for one in fit.claims),
        *([fit.goodness.verdict, ""] if fit.goodness else []),
        f"{fit.model.name} on {name}: {counted(log['rows'], 'sample')}, "
        + (f"{counted(used, 'run')} fitted" if log["runs"] > 1 else "fitted")
        + (f", {len(log['holdout'])} held out" if log["holdout"] else "")
        + f"; {fit.status} in {fit.seconds:.2f} s",
        "",
        error_rows(fit.model.pose, rows, fit.noise_floor, turning=fit.model.period),
    ]


def periodic_lines(fit: Fit, log: Log | None = None) -> list[str]:
    """Return what is said of errors that repeat, then an empty line; nothing without a log or such errors."""
    found = periodic_of(fit, log)
    return [periodic_text(found, fit.model.family), ""] if found else []


def parameter_text(fit: Fit) -> str:
    """Return the parameter table: value(std), bounds, and what is to be said of each, else what it means."""
    head = ["parameter", "value (1 sigma)", "unit", "nominal", "bounds"]
    rows = [[*head, ""]]
    for p in parameter_rows(fit):
        value = concise(p.value, p.std) if p.determined else f"({p.value:.4g})"
        bounds = "fixed" if p.fixed else f"{p.lower:.4g} .. {p.upper:.4g}"
        rows.append([p.name, value, p.unit, f"{p.nominal:.4g}", bounds, p.remark or p.meaning])
    return grid(rows, words=True)


def circumstances(fit: Fit) -> list[str]:
    """Return the sentences on solver, uncertainty and noise."""
    s = fit.solver
    how = f"{s['name']}: {s['evaluations']} evaluations"
    if s["starts"] > 1:
        same = round(s["share_at_optimum"] * s["starts"])
        how += f"; {same} of {s['starts']} refined starts reached this optimum"
    by_source: dict[str, list[str]] = {}
    for channel, sigma in fit.noise.sigmas.items():
        factor, unit, name = readable(channel, fit.model.period)
        by_source.setdefault(sigma.source, []).append(f"{name} {sigma.value * factor:.3g} {unit}")
    known = fit.degrees_of_freedom[fit.determined]
    free = ""
    if len(known) and known.min() < MANY:
        fewest = fit.model.names[fit.degrees_of_freedom.tolist().index(known.min())]
        most = f" to {known.max():.2g}" if known.max() > known.min() else ""
        free = f"; degrees of freedom {known.min():.2g} (of {fewest}){most}, for Student's t"
    noise = "; ".join(f"{source}: {', '.join(values)}" for source, values in by_source.items())
    return [
        f"solver: {how}{_bounded(fit)}",
        _goodness(fit),
        f"uncertainty: {fit.covariance_method} ({fit.covariance_reason}){free}",
        f"noise (1 sigma) {noise}",
    ]


def _bounded(fit: Fit) -> str:
    """How near the cost is to what no parameters can undercut."""
    bound = fit.solver.get("lower_bound")
    if not bound:
        return ""
    told = (
        f"; cost {bound['ratio']:.4g} x the lower bound, a linear fit with {bound['coefficients']} free "
        f"coefficients ({bound['expected']:.4g} by their number alone)"
    )
    if bound["near"]:
        return told
    held = f", or the bounds of {', '.join(fit.at_bound)}, cost" if fit.at_bound else " costs"
    return f"{told}: the form of the model{held} that much, whatever the start"


def _goodness(fit: Fit) -> str:
    """Cost per degree of freedom with its expected scatter, and where most is left."""
    cost, fitted = fit.solver["cost_per_degree_of_freedom"], fit.goodness
    said = f"goodness of fit: cost per degree of freedom {cost:.3f}"
    if fitted is not None:
        more = ", more than noise" if fitted.significant else ""
        said += f" (expected 1 +- {fitted.scatter:.2g}, 1 sigma){more}; "
        said += f"most is left in {fitted.where}: {fitted.worst:.2f} x the noise"
    if not 0 < cost < TOO_SMALL:
        return said
    guessed = any(sigma.source == "estimated" for sigma in fit.noise.sigmas.values())
    what = "was estimated" if guessed else "is stated"
    why = ": motion from sample to sample was counted as noise; state it with --noise" if guessed else ""
    return (
        f"{said} (the noise {what} {cost**-0.5:.3g} x as large as what is left{why}; uncertainties and noise "
        "floor are too large by that)"
    )


# -- a fit of several logs -------------------------------------------------------------------------------


def several_text(fit: Fit) -> list[str]:
    """Return errors by log and each log's own parameters."""
    rows = {}
    for log in fit.logs:
        for kind, said in (("fitted", ""), ("holdout", ", held out")):
            if log["errors"].get(kind):
                rows[f"{log['name']}{said}"] = log["errors"][kind]
    parts = [error_rows(fit.model.pose, rows, None, turning=fit.model.period).replace("errors", "by log", 1)]
    for name in fit.logs[0]["parameters"]:
        parts += ["", _own_text(fit, next(p for p in fit.model.parameters if p.name == name))]
    return parts


def _own_text(fit: Fit, parameter: Parameter) -> str:
    """Return one parameter log by log, with how it changed since the first."""
    factor, unit = parameter_unit(parameter.unit)
    logs = [log for log in fit.logs if parameter.name in log["parameters"]]
    since = [] if fit.joint is None else ["since the first (1 sigma)"]
    rows = [[f"{parameter.name} by log", "value (1 sigma)", "unit", *since]]
    for log in logs:
        value, std = (log["parameters"][parameter.name][key] for key in ("value", "std"))
        row = [log["name"], concise(factor * value, None if std is None else factor * std), unit]
        if fit.joint is not None and log is not logs[0]:
            moved, sigma = fit.joint.change(parameter.name, logs[0]["name"], log["name"])
            row.append(concise(factor * moved, factor * sigma))
        rows.append([*row, *[""] * (len(rows[0]) - len(row))])
    return grid(rows)


# -- a calibration on another log ------------------------------------------------------------------------


def evaluation_text(found: Evaluation, *, by_run: bool = False) -> str:
    """Return the verdict, then the table of errors with the noise floor; `by_run`: with one line per run."""
    periodic = periodic_lines(found.calibration, found.log)[:-1]
    return "\n".join([*evaluation_head(found, by_run=by_run), *([""] if periodic else []), *periodic])


def evaluation_head(found: Evaluation, *, by_run: bool = False) -> list[str]:
    """Return the verdict and the errors."""
    rows: dict[str, Any] = {"all runs" if len(found.table.runs) > 1 else "all samples": found.table.over()}
    if by_run:
        rows |= {f"run {run}": found.table.over([run]) for run in found.table.runs}
    samples = int(found.table.count.sum())
    runs = f" in {counted(len(found.table.runs), 'run')}" if len(found.table.runs) > 1 else ""
    source = "" if {s.source for s in found.noise.sigmas.values()} == {"given"} else "estimated"
    return [
        found.goodness.verdict,
        "",
        f"{found.model.name} on {found.log.name}: {counted(samples, 'sample')}{runs}",
        "",
        error_rows(found.model.pose, rows, found.noise_floor, source, turning=found.model.period),
    ]
