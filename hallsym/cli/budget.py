"""`hallsym budget`: the uncertainty of a decoded position, and any other budget by the GUM.

State the uncertainty of a decoded position: fit, Hall noise, vertical sensors, reference, ADC and
zeroing, propagated through the model; or evaluate a budget stated in a TOML file.
"""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hallsym import uncertainty
from hallsym.cli import NOT_DETERMINED, OK, common
from hallsym.errors import InputError
from hallsym.estimation import Fit, load_fit
from hallsym.log import Noise, check_noise_keys
from hallsym.report.content import Block
from hallsym.report.results.budget import (
    budget_content,
    comparison_table,
    curve_blocks,
    expanded,
    position_content,
    position_words,
    recorded_table,
)
from hallsym.trajectory import Curve, read_curve
from hallsym.uncertainty import Budget, Recorded, Settings, UncertaintyMap, uncertainty_map, with_curve

LOG_OPTIONS = ("column", *common.FILE_OPTIONS, "drop_bad")
EPILOG = """\
examples:
  hallsym budget budget.toml                          any budget: one [[source]] table for each input
  hallsym budget calib.json --at x_um=100 --at z_um=250   of the position decoded there
  hallsym budget calib.json LOG --plots pictures      over the recorded workspace, with a map of U
  hallsym budget calib.json --curve curve.json        with the error of a curve of 'hallsym trajectory'
"""


OPTIONS = """
file FILE                       a calibration (.json), or a budget (.toml)
log LOG <optional>              log whose workspace is evaluated
--curve JSON                    a curve that the machine follows: its error joins the budget
[of a calibration]
--at COLUMN=VALUE <repeat>      pose and vertical state of the budget: --at x_um=100 --at z_um=250
    (repeat; default 0, or a usual pose)
--settings TOML                 averaging, ADC, zeroing, vertical sensors, scale of the reference
--diagnosis JSON                file of 'hallsym diagnose LOG -o FILE.json': adds the model error, and
    the models that the log does not exclude, to the budget
--range COLUMN=LOW:HIGH <repeat>  map U over two pose coordinates and the first state, such as x, y
    and Z: --range x_um=-300:300 (repeat; default: the range that LOG recorded)
[]
--monte-carlo N <int, alone=0>  confirm by propagating distributions (JCGM 101): N trials, or until
    stable
--seed SEED <seed=0>            of the Monte Carlo trials (default 0)
@plots save budget bars and a map of U
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    if Path(options.file).suffix.lower() == ".toml":
        return _stand_alone(options)
    return _position(options)


# -- a budget file ---------------------------------------------------------------------------------------


def _stand_alone(options: Namespace) -> int:
    own = ("log", "at", "settings", "diagnosis", "range", "noise", *LOG_OPTIONS)
    common.refuse(options, own, f"belongs to a calibration; {options.file} is a budget file")
    budget, shown = uncertainty.read_budget(options.file)
    machine, curve = budget, read_curve(options.curve) if options.curve else None
    if curve:
        budget = with_curve(machine, curve)
    found = []
    if options.monte_carlo is not None:
        found = [uncertainty.budget_monte_carlo(budget, **_trials(options))]
    record: dict[str, Any] = {"budget": budget.to_dict()}
    if curve:
        record["curve"] = {"file": options.curve, "expanded_without_curve_m": machine.expanded}
    if found:
        record["monte_carlo"] = found[0].to_dict()
    more: list[Block | str] = [comparison_table(found)] if found else []
    more += curve_blocks(curve, machine, budget) if curve else []
    said = budget_content(budget, shown, more)
    common.say(options, record, lambda: said, wrote=common.plots(options, said, options.file))
    return OK


# -- a calibration ---------------------------------------------------------------------------------------


def _position(options: Namespace) -> int:
    fit = _with_noise(load_fit(options.file), options.noise)
    if not options.log:
        common.refuse(options, LOG_OPTIONS, "is about reading a LOG; give one")
    settings = uncertainty.read_settings(options.settings, fit.model) if options.settings else Settings()
    if options.diagnosis:
        settings = replace(settings, model_error=uncertainty.read_model_error(options.diagnosis, fit.model))
    at = common.column_values(options.at, (*fit.model.pose, *fit.model.state))
    said = uncertainty.notes(fit, settings)
    log = common.open_log(options, known=fit) if options.log else None
    recorded = None if log is None else uncertainty.over_log(fit, log, settings)
    beyond = recorded.outside(at) if recorded else []
    if beyond:
        said.append(f"{', '.join(beyond)} of the budget is outside the recorded workspace.")
    curve = read_curve(options.curve) if options.curve else None
    budgets = _budgets(fit, at, settings, curve)
    found = {}
    if options.monte_carlo is not None:
        if curve:
            raise InputError("--monte-carlo is for the machine alone; leave --curve out.")
        found = uncertainty.position_monte_carlo(fit, at, settings, **_trials(options))
    mapped = options.range or (options.plots and recorded)
    grid = _map(options, fit, settings, at, recorded) if mapped else None
    spots = recorded.where if recorded else grid.recorded.where if grid else {}
    worst = {c: _budgets(fit, spot, settings, curve)[c] for c, spot in spots.items()}
    record = {
        "calibration": str(options.file),
        "log": None if log is None else str(options.log),
        "model": fit.model.name,
        "covariance": fit.covariance_record.method,
        "at": fit.model.rest | at,
        "budgets": {c: b.to_dict() for c, b in budgets.items()},
        "monte_carlo": {c: v.to_dict() for c, v in found.items()} or None,
        "recorded": recorded.to_dict() if recorded else None,
        "map": grid.to_dict() if grid else None,
        "notes": said,
    }
    coverage = f"{100 * settings.level:g} %" if settings.level else f"k = {settings.coverage:g}"
    place = position_words(fit.model.rest | at, fit.model.period)
    basis = f"fit covariance: {fit.covariance_record.method}"
    if recorded:
        basis = f"{expanded(worst, f'the worst place in {options.log}')}; {basis}"
    more: list[Block | str] = [comparison_table(list(found.values()))] if found else []
    more += [recorded_table(recorded, f"U ({coverage}), recorded workspace")] if recorded else []
    more += [recorded_table(grid.recorded, f"U ({coverage}), map")] if grid and options.range else []
    said_of = position_content(budgets, place, basis, more, worst=worst, grid=grid)
    wrote = common.plots(options, said_of, options.file)
    common.say(options, record, lambda: said_of, notes=said, wrote=wrote)
    return NOT_DETERMINED if fit.undetermined_by_log else OK


def _budgets(fit: Fit, at: Mapping[str, float], settings: Settings, curve: Curve | None) -> dict[str, Budget]:
    """The budget of each pose coordinate, with the error of a curve where one is given."""
    budgets = uncertainty.position_budget(fit, at, settings)
    if curve is None:
        return budgets
    other = [c for c in curve.coordinates if c not in budgets]
    if other:
        raise InputError(f"The curve moves {other[0]}, but a budget of {fit.model.name} is of its pose.")
    return {c: with_curve(b, curve, c) if c in curve.coordinates else b for c, b in budgets.items()}


def _with_noise(fit: Fit, given: Sequence[str]) -> Fit:
    """Return the calibration with the stated noise in place of that of its log."""
    values = dict(map(common.assignment, given))
    columns = (*fit.model.channels, *fit.model.state, *fit.model.references)
    check_noise_keys(values, columns, "--noise")
    return fit.changed(noise=Noise.given(values, columns).merged(fit.noise))


def _map(
    options: Namespace, fit: Fit, settings: Settings, at: Mapping[str, float], recorded: Recorded | None
) -> UncertaintyMap:
    ranges = common.column_ranges(options.range, uncertainty.map_axes(fit.model))
    spans = recorded.span if recorded else {}
    axes = {c: ranges.get(c) or spans.get(c) for c in uncertainty.map_axes(fit.model)}
    for column, span in axes.items():
        if span is None:
            raise InputError(
                f"A map needs a range for each axis: give a LOG, or --range {column}=LOW:HIGH "
                f"(a calibration does not hold its workspace)."
            )
    turn = fit.model.period
    lines = {
        c: (0.0, turn[c]) if c in turn and span[1] - span[0] > turn[c] else sorted(set(span))
        for c, span in axes.items()
        if span
    }  # one turn of what went round more often; one height, where Z never moved
    return uncertainty_map(fit, lines, settings, fixed={c: v for c, v in at.items() if c not in axes})


def _trials(options: Namespace) -> dict[str, Any]:
    return {"rng": np.random.default_rng(options.seed), "trials": options.monte_carlo or None}
