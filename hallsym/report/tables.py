"""What a person reads: tables of parameters and errors, in um and urad where SI is unwieldy."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.errors import counted
from hallsym.estimation.calibration import Fit
from hallsym.report.data import parameter_rows
from hallsym.units import readable

TOO_SMALL = 0.1
"""Cost per degree of freedom below which the noise is more than three times what is left."""


def grid(rows: Sequence[Sequence[str]], *, left: int = 1, rule_after: int = 1) -> str:
    """Return rows as aligned text: the first `left` columns left-aligned, a rule after the header."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(
            c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    lines.insert(rule_after, "-" * (sum(widths) + 2 * (len(widths) - 1)))
    return "\n".join(lines)


def concise(value: float, std: float | None) -> str:
    """Return value with its standard uncertainty in parentheses, on the last two digits: `0.86712(41)`."""
    if std is None or not np.isfinite(std) or std <= 0:
        return f"{value:.6g}"
    decimals = 1 - int(np.floor(np.log10(std)))
    if round(std, decimals) >= 10 ** (2 - decimals):  # .0999 rounds up to .10: two digits, not three
        decimals -= 1
    if decimals <= 0:
        return f"{value:.0f}({std:.0f})"
    return f"{value:.{decimals}f}({round(std * 10**decimals):d})"


def error_rows(
    pose: Sequence[str],
    rows: Mapping[str, Mapping[str, Mapping[str, float]] | None],
    floor: Mapping[str, float] | None,
    source: str = "",
) -> str:
    """Return a table of rmse and peak per pose coordinate, one line per entry of `rows`.

    `source`: whether the noise floor is stated or estimated, where that is to be said.
    """
    shown = [readable(c) for c in pose]
    head = ["errors", *(f"{what} {name} [{unit}]" for what in ("rmse", "peak") for _, unit, name in shown)]
    body = [
        [
            label,
            *(
                _fixed(row[what][c] * factor)
                for what in ("rmse", "peak")
                for c, (factor, _, _) in zip(pose, shown, strict=True)
            ),
        ]
        for label, row in rows.items()
        if row is not None
    ]
    if floor:
        noise = [_fixed(floor[c] * factor) for c, (factor, _, _) in zip(pose, shown, strict=True)]
        body.append([f"noise floor, {source}" if source else "noise floor", *noise, *[""] * len(noise)])
    return grid([head, *body])


def _fixed(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.3e}"


def fit_text(fit: Fit) -> str:
    """Return what `hallsym fit` prints: errors, parameters, identifiable combinations, notes."""
    log = fit.log
    used = log["runs"] - len(log["holdout"])
    parts = [
        f"{fit.model.name} on {log['path'] or 'a log in memory'}: {counted(log['rows'], 'sample')}, "
        + f"{counted(used, 'run')} fitted"
        + (f", {len(log['holdout'])} held out" if log["holdout"] else "")
        + f"; {fit.status} in {fit.seconds:.2f} s",
        "",
        error_rows(fit.model.pose, _labelled(fit.error_rows), fit.noise_floor),
        "",
        parameter_text(fit),
    ]
    if fit.combinations:
        parts += ["", combination_text(fit)]
    parts += ["", *evidence(fit)]
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
    """Return what the data determine instead of the parameters that they do not."""
    rows = [["identifiable combination", "value", "unit"]]
    rows += [[c.expression, concise(c.value, c.std), c.unit] for c in fit.combinations]
    return grid(rows)


def evidence(fit: Fit) -> list[str]:
    """Return the sentences on solver, uncertainty and noise."""
    s = fit.solver
    how = f"{s['name']}: {s['evaluations']} evaluations"
    if s["starts"] > 1:
        same = round(s["share_at_optimum"] * s["starts"])
        how += f"; {same} of {s['starts']} refined starts reached this optimum"
    by_source: dict[str, list[str]] = {}
    for channel, sigma in fit.noise.sigmas.items():
        factor, unit, name = readable(channel)
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
