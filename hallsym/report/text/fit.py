"""What `hallsym fit` prints, in um and urad where SI is unwieldy."""

from collections.abc import Mapping
from typing import Any

from hallsym.errors import counted
from hallsym.estimation import Fit
from hallsym.report.data import parameter_rows
from hallsym.report.tables import concise, error_rows, grid
from hallsym.units import readable

TOO_SMALL = 0.1
"""Cost per degree of freedom below which the noise is more than three times what is left."""


def fit_text(fit: Fit) -> str:
    """Return what `hallsym fit` prints: errors, parameters, identifiable combinations, notes."""
    log = fit.log
    used = log["runs"] - len(log["holdout"])
    parts = [
        f"{fit.model.name} on {log['path'] or 'a log in memory'}: {counted(log['rows'], 'sample')}, "
        + (f"{counted(used, 'run')} fitted" if log["runs"] > 1 else "fitted")
        + (f", {len(log['holdout'])} held out" if log["holdout"] else "")
        + f"; {fit.status} in {fit.seconds:.2f} s",
        "",
        error_rows(fit.model.pose, _labelled(fit.error_rows), fit.noise_floor, turning=fit.model.period),
        "",
        parameter_text(fit),
    ]
    if fit.combinations:
        parts += ["", combination_text(fit)]
    parts += ["", *circumstances(fit)]
    parts += [f"note: {note}" for note in fit.notes]
    return "\n".join(parts)


def _labelled(rows: Mapping[str, Any]) -> dict[str, Any]:
    labels = {"designed": "nominal", "fitted": "fitted", "holdout": "held out"}
    return {labels.get(k, k): v for k, v in rows.items()}


def parameter_text(fit: Fit) -> str:
    """Return the parameter table: value(std), bounds, and what is to be said of each, else what it means."""
    head = ["parameter", "value", "unit", "nominal", "bounds"]
    rows, last = [head], ["", ""]
    for p in parameter_rows(fit):
        value = concise(p.value, p.std) if p.determined else f"({p.value:.4g})"
        bounds = "fixed" if p.fixed else f"{p.lower:.4g} .. {p.upper:.4g}"
        rows.append([p.name, value, p.unit, f"{p.nominal:.4g}", bounds])
        last.append(p.remark or p.meaning)
    lines = grid(rows).split("\n")
    return "\n".join(f"{line}  {words}".rstrip() for line, words in zip(lines, last, strict=True))


def combination_text(fit: Fit) -> str:
    """Return the combinations that the data determine although they do not determine their parameters."""
    rows = [["identifiable combinations", "value", "unit"]]
    rows += [[c.expression, concise(c.value, c.std), c.unit] for c in fit.combinations]
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
        f"solver: {how}; cost per degree of freedom {s['cost_per_degree_of_freedom']:.3f}" + _excess(fit),
        f"uncertainty: {fit.covariance_method} ({fit.covariance_reason})",
        f"noise (1 sigma) {noise}",
    ]


def _excess(fit: Fit) -> str:
    """What a cost per degree of freedom well above or below 1 means."""
    cost = fit.solver["cost_per_degree_of_freedom"]
    guessed = any(sigma.source == "estimated" for sigma in fit.noise.sigmas.values())
    if 0 < cost < TOO_SMALL:
        what = "was estimated" if guessed else "is stated"
        why = ": motion from sample to sample was counted as noise; state it with --noise" if guessed else ""
        return (
            f" (the noise {what} {cost**-0.5:.3g} x as large as what is left{why}; uncertainties and noise "
            "floor are too large by that)"
        )
    if cost < 1.5:
        return ""
    return " (1 is what the noise explains: the machine does more than this model, or the noise is larger)"
