"""`hallsym demo`: the paper's calibration, step by step, on the bundled campaign: Tables 2, 4 and 8.

Calibrate the bundled 6-DOF stage campaign as Chen et al. (Sensors 2016, 16, 872) do: nominal
parameters, Model (30), Model (31), each beside the paper's own error table.
"""

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.cli import OK
from hallsym.cli.common import plots, progress_of, say
from hallsym.estimation import Fit, fit
from hallsym.families import published
from hallsym.log import Log
from hallsym.report.content import Content, Table
from hallsym.report.results.shared import errors_by
from hallsym.report.tables import cells
from hallsym.report.views import content
from hallsym.simulation import bundled_campaign
from hallsym.units import readable

HEIGHT = 250e-6
POSE = ("x_m", "y_m", "rz_rad")


OPTIONS = """
-o, --output FOLDER <=demo>     where calib.json and pictures go (default: demo)
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    log, result, steps = reproduce(on_progress=progress_of(options))
    result.save(folder / "calib.json")
    pictures = plots(options, result, log.path, result.model.name, folder=folder, log=log)
    record = {"steps": steps, "calibration": result.to_dict(), "pictures": [str(p) for p in pictures]}
    wrote = [folder / "calib.json", *pictures]
    say(options, record, lambda: demonstration(steps, result), wrote=wrote)
    return OK


def reproduce(on_progress: Callable[[str], None] | None = None) -> tuple[Log, Fit, list[dict[str, Any]]]:
    """Calibrate the bundled campaign as Section 5 of the paper does.

    Returns the log, the fit of Model (31), and one record per step: `step`, `paper` and `here`, each with
    rmse and peak by pose coordinate.
    """
    log = bundled_campaign()
    heights = {block.run: float(np.mean(block.data["z_m"])) for block in log.blocks(("z_m",))}
    both = [run for run, z in heights.items() if abs(abs(z) - HEIGHT) < 20e-6]
    full = fit(log, "stage31", on_progress=on_progress)
    assert full.errors is not None
    steps = [_step("nominal values, Model (15), Z = +-250 um", 2, 15, full.errors.designed.over(both))]
    steps.append(_step("Model (30), both heights in one fit", 4, 30, _fitted(log, both)))
    each = [_fitted(log, [r for r in both if heights[r] * sign > 0]) for sign in (-1, 1)]
    steps.append(_step("Model (30), each height by itself", 4, 30, _joined(each)))
    rows = full.errors.rows()
    steps.append(_step("Model (31), fitted runs", 8, 31, rows["fitted"]))
    steps.append(_step("Model (31), holdout runs", 8, 31, rows["holdout"]))
    return log, full, steps


def demonstration(steps: list[dict[str, Any]], result: Fit) -> Content:
    """Return how near the last step comes to the paper, the steps beside the paper's numbers, and the fit."""
    here, theirs = (
        cells([steps[-1][of]["rmse"][c] for c in POSE], POSE, digits=4) for of in ("here", "paper")
    )
    units = [readable(c)[1:] for c in POSE]
    sizes = ", ".join(
        f"{name} {a} {unit} ({b} in the paper)"
        for (unit, name), a, b in zip(units, here, theirs, strict=True)
    )
    said = content(result)
    return replace(
        said,
        answer=f"On holdout runs Model (31) decodes to {sizes}.",
        first=[beside_paper(steps), said.answer, *said.first],
    )


def beside_paper(steps: list[dict[str, Any]]) -> Table:
    """Return the steps beside the paper's numbers."""
    # the paper's row is printed once for the steps that share a table
    shown = {}
    for k, step in enumerate(steps):
        shown[step["step"]] = step["here"]
        if k + 1 == len(steps) or steps[k + 1]["table"] != step["table"]:
            shown[f"  paper, Table {step['table']}"] = step["paper"]
    return errors_by("errors", shown, POSE)


def _fitted(log: Log, runs: list[int]) -> dict[str, dict[str, float]]:
    result = fit(log, "stage30", solver="direct", holdout=[run for run in log.runs if run not in runs])
    assert result.errors is not None
    return result.errors.fitted.over(runs) or {}


def _joined(parts: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    return {
        "rmse": {c: float(np.sqrt(np.mean([p["rmse"][c] ** 2 for p in parts]))) for c in POSE},
        "peak": {c: max(p["peak"][c] for p in parts) for c in POSE},
    }


def _step(step: str, table: int, model: int, here: Any) -> dict[str, Any]:
    columns = published.table(f"table{table}_errors_model{model}")
    quantity = columns["quantity"]
    theirs = {what: {c: columns[c][quantity.index(what)] for c in POSE} for what in ("rmse", "peak")}
    return {"step": step, "table": table, "paper": theirs, "here": here}
