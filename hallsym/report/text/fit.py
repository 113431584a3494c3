"""What `hallsym fit` prints, in um and urad where SI is unwieldy."""

from collections.abc import Mapping
from typing import Any

from hallsym.errors import counted
from hallsym.estimation import MANY, Fit
from hallsym.log import Log
from hallsym.report.data import parameter_rows
from hallsym.report.data.periodic import periodic_of
from hallsym.report.tables import concise, error_rows, grid, in_units
from hallsym.report.text.periodic import periodic_text
from hallsym.report.text.several import several_text
from hallsym.units import readable

TOO_SMALL = 0.1
"""Cost per degree of freedom below which the noise is more than three times what is left."""


def fit_text(fit: Fit) -> str:
    """Return what `hallsym fit` prints: errors, parameters, identifiable combinations, notes."""
    log = fit.log
    used = log["runs"] - len(log["holdout"])
    parts = [
        *([fit.goodness.verdict, ""] if fit.goodness else []),
        f"{fit.model.name} on {_logs(fit)}: {counted(log['rows'], 'sample')}, "
        + (f"{counted(used, 'run')} fitted" if log["runs"] > 1 else "fitted")
        + (f", {len(log['holdout'])} held out" if log["holdout"] else "")
        + f"; {fit.status} in {fit.seconds:.2f} s",
        "",
        error_rows(fit.model.pose, _labelled(fit.error_rows), fit.noise_floor, turning=fit.model.period),
        "",
        *([] if fit.logs else periodic_lines(fit)),
        *([*several_text(fit), ""] if fit.logs else []),
        parameter_text(fit),
    ]
    if fit.combinations:
        parts += ["", combination_text(fit)]
    parts += ["", *circumstances(fit)]
    parts += [f"note: {note}" for note in fit.notes]
    return "\n".join(parts)


def periodic_lines(fit: Fit, log: Log | None = None) -> list[str]:
    """Return what is said of errors that repeat, then an empty line; nothing without a log or such errors."""
    found = periodic_of(fit, log)
    return [periodic_text(found, fit.model.family), ""] if found else []


def _logs(fit: Fit) -> str:
    """What the log is called, or how many there are."""
    fitted = [log["name"] for log in fit.logs if not log["held_out"]]
    return counted(len(fitted), "log") if fitted else fit.log["path"] or "a log in memory"


def _labelled(rows: Mapping[str, Any]) -> dict[str, Any]:
    labels = {"designed": "nominal", "fitted": "fitted", "holdout": "held out"}
    return {labels.get(k, k): v for k, v in rows.items()}


def parameter_text(fit: Fit) -> str:
    """Return the parameter table: value(std), bounds, and what is to be said of each, else what it means."""
    head = ["parameter", "value (1 sigma)", "unit", "nominal", "bounds"]
    rows = [[*head, ""]]
    for p in parameter_rows(fit):
        value = concise(p.value, p.std) if p.determined else f"({p.value:.4g})"
        bounds = "fixed" if p.fixed else f"{p.lower:.4g} .. {p.upper:.4g}"
        rows.append([p.name, value, p.unit, f"{p.nominal:.4g}", bounds, p.remark or p.meaning])
    return grid(rows, words=True)


def combination_text(fit: Fit) -> str:
    """Return the combinations that the data determine although they do not determine their parameters."""
    rows = [["identifiable combinations", "value (1 sigma)", "unit"]]
    rows += [[c.expression, *in_units(c.value, c.std, c.unit)] for c in fit.combinations]
    return grid(rows)


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
    noise = "; ".join(f"{source}: {', '.join(values)}" for source, values in by_source.items())
    return [
        f"solver: {how}{_bounded(fit)}",
        _goodness(fit),
        f"uncertainty: {fit.covariance_method} ({fit.covariance_reason}){_degrees_of_freedom(fit)}",
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
    if fitted is None:
        return f"goodness of fit: cost per degree of freedom {cost:.3f}{_too_small(fit)}"
    more = ", more than noise" if fitted.significant else ""
    return (
        f"goodness of fit: cost per degree of freedom {cost:.3f} (expected 1 +- {fitted.scatter:.2g}, "
        f"1 sigma){more}; most is left in {fitted.where}: "
        f"{fitted.worst:.2f} x the noise" + _too_small(fit)
    )


def _degrees_of_freedom(fit: Fit) -> str:
    """What of them is worth knowing: where they are few."""
    known = fit.degrees_of_freedom[fit.determined]
    if not len(known) or known.min() >= MANY:
        return ""
    fewest = next(n for n, d in zip(fit.model.names, fit.degrees_of_freedom, strict=True) if d == known.min())
    most = f" to {known.max():.2g}" if known.max() > known.min() else ""
    return f"; degrees of freedom {known.min():.2g} (of {fewest}){most}, for Student's t"


def _too_small(fit: Fit) -> str:
    """What a cost per degree of freedom well below 1 means."""
    cost = fit.solver["cost_per_degree_of_freedom"]
    if not 0 < cost < TOO_SMALL:
        return ""
    guessed = any(sigma.source == "estimated" for sigma in fit.noise.sigmas.values())
    what = "was estimated" if guessed else "is stated"
    why = ": motion from sample to sample was counted as noise; state it with --noise" if guessed else ""
    return (
        f" (the noise {what} {cost**-0.5:.3g} x as large as what is left{why}; uncertainties and noise "
        "floor are too large by that)"
    )
