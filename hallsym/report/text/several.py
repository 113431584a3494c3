"""What `hallsym fit` of several logs prints besides: errors log by log, parameters that each log has."""

from hallsym.estimation.calibration import Fit
from hallsym.model import Parameter
from hallsym.report.tables import concise, error_rows, grid
from hallsym.units import parameter_unit


def several_text(fit: Fit) -> list[str]:
    """Return errors by log and each log's own parameters; nothing for a fit of one log."""
    if not fit.logs:
        return []
    rows = {}
    for log in fit.logs:
        for kind, said in (("fitted", ""), ("holdout", ", held out")):
            if log["errors"].get(kind):
                rows[f"{log['name']}{said}"] = log["errors"][kind]
    parts = [error_rows(fit.model.pose, rows, None, turning=fit.model.period).replace("errors", "by log", 1)]
    own = list(fit.logs[0]["parameters"])
    for name in own:
        parts += ["", _own_text(fit, next(p for p in fit.model.parameters if p.name == name))]
    return parts


def _own_text(fit: Fit, parameter: Parameter) -> str:
    """Return one parameter log by log, with how it changed since the first."""
    factor, unit = parameter_unit(parameter.unit)
    logs = [log for log in fit.logs if parameter.name in log["parameters"]]
    change = fit.joint is not None
    rows = [[f"{parameter.name} by log", "value", "unit", *(["since the first"] if change else [])]]
    for log in logs:
        value, std = (log["parameters"][parameter.name][key] for key in ("value", "std"))
        row = [log["name"], concise(factor * value, None if std is None else factor * std), unit]
        if fit.joint is not None:
            first, name = logs[0]["name"], log["name"]
            moved, sigma = fit.joint.change(parameter.name, first, name) if name != first else (0.0, 0.0)
            row.append(concise(factor * moved, factor * sigma) if name != first else "")
        rows.append(row)
    return grid(rows)
