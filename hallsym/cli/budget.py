"""`hallsym budget`: the uncertainty of a decoded position, and any other budget by the GUM."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.cli import NOT_DETERMINED, OK
from hallsym.cli.common import (
    FILE_OPTIONS,
    assignment,
    column_numbers,
    column_ranges,
    command,
    log_options,
    open_log,
    plots_options,
    plots_place,
    say,
    seed,
)
from hallsym.errors import InputError
from hallsym.estimation import Fit, load_fit
from hallsym.log import Noise, check_noise_keys
from hallsym.report.text.budget import (
    along_text,
    budget_text,
    comparison_text,
    curve_cost_text,
    position_words,
    recorded_text,
)
from hallsym.trajectory import Curve, CurveCost, curve_cost, read_curve
from hallsym.uncertainty import (
    AlongCurve,
    Budget,
    Comparison,
    Recorded,
    Settings,
    UncertaintyMap,
    along_curve,
    budget_monte_carlo,
    map_axes,
    notes,
    over_log,
    position_budget,
    position_monte_carlo,
    read_budget,
    read_model_error,
    read_settings,
    uncertainty_map,
    with_curve,
)

LOG_OPTIONS = ("column", "column_file", *FILE_OPTIONS, "drop_bad")
EPILOG = """\
examples:
  hallsym budget budget.toml                          any budget: one [[source]] table for each input
  hallsym budget calib.json --at x_um=100 --at z_um=250   of the position decoded there
  hallsym budget calib.json LOG --plots pictures      over the recorded workspace, with a map of U
  hallsym budget calib.json --curve curve.json        along a curve of 'hallsym trajectory'
"""


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "budget", run,
        "State the uncertainty of a decoded position: fit, Hall noise, vertical sensors, reference, ADC and\n"
        "zeroing, propagated through the model; or evaluate a budget stated in a TOML file.", EPILOG,
    )  # fmt: skip
    parser.add_argument("file", metavar="FILE", help="a calibration (.json), or a budget (.toml)")
    parser.add_argument("log", metavar="LOG", nargs="?", help="log whose workspace is evaluated")
    parser.add_argument(
        "--curve", metavar="JSON",
        help="a curve that the machine follows: its error joins the budget, worst part and number of points",
    )  # fmt: skip
    _position_options(parser)
    parser.add_argument(
        "--monte-carlo", nargs="?", const=0, type=int, metavar="N",
        help="confirm by propagating distributions (JCGM 101): N trials, or until stable",
    )  # fmt: skip
    parser.add_argument("--seed", type=seed, default=0, help="of the Monte Carlo trials (default 0)")
    plots_options(parser, "save budget bars, map and U along the curve")
    log_options(parser)


def _position_options(parser: ArgumentParser) -> None:
    group = parser.add_argument_group("of a calibration")
    group.add_argument(
        "--at", action="append", default=[], metavar="COLUMN=VALUE",
        help="pose and vertical state of the budget: --at x_um=100 --at z_um=250 (repeat; default 0)",
    )  # fmt: skip
    group.add_argument(
        "--settings", metavar="TOML", help="averaging, ADC, zeroing, vertical sensors, scale of the reference"
    )
    group.add_argument(
        "--diagnosis", metavar="JSON",
        help="what 'hallsym diagnose LOG -o FILE.json' saved: what the model leaves, and which models the "
        "log does not exclude, join the budget",
    )  # fmt: skip
    group.add_argument(
        "--split", action="store_true", help="one line for each fitted parameter instead of one for the fit"
    )
    group.add_argument(
        "--map",
        action="store_true",
        help="map U over two pose coordinates and the first state, such as x, y and Z (with LOG or --range)",
    )
    group.add_argument(
        "--range", action="append", default=[], metavar="COLUMN=LOW:HIGH",
        help="what the map covers: --range x_um=-300:300 (repeat; default: what LOG recorded)",
    )  # fmt: skip


def run(options: Namespace) -> int:
    """Carry the command out."""
    if Path(options.file).suffix.lower() == ".toml":
        return _stand_alone(options)
    return _position(options)


# -- a budget file ---------------------------------------------------------------------------------------


def _stand_alone(options: Namespace) -> int:
    for name in ("log", "at", "settings", "diagnosis", "split", "map", "range", "noise", *LOG_OPTIONS):
        if getattr(options, name):
            what = "A LOG" if name == "log" else f"--{name.replace('_', '-')}"
            raise InputError(f"{what} belongs to a calibration; {options.file} is a budget file.")
    budget, shown = read_budget(options.file)
    cost = None
    if options.curve:
        curve = read_curve(options.curve)
        cost, budget = curve_cost(curve, budget.expanded, budget.factor), with_curve(budget, curve)
    found = []
    if options.monte_carlo is not None:
        found = [budget_monte_carlo(budget, _rng(options), trials=options.monte_carlo or None)]
    pictures = _pictures(options, {budget.quantity: budget})
    record: dict[str, Any] = {"budget": budget.to_dict()}
    if cost:
        record["curve"] = {"file": options.curve, **cost.to_dict()}
    if found:
        record["monte_carlo"] = found[0].to_dict()
    text = [budget_text(budget, shown), *(["", comparison_text(found)] if found else [])]
    text += ["", curve_cost_text(cost)] if cost else []
    say(options, record, lambda: "\n".join(text), wrote=pictures)
    return OK


# -- a calibration ---------------------------------------------------------------------------------------


def _position(options: Namespace) -> int:
    fit = _with_noise(load_fit(options.file), options.noise)
    for name in LOG_OPTIONS:
        if getattr(options, name) and not options.log:
            raise InputError(f"--{name.replace('_', '-')} is about reading a LOG; give one.")
    settings = read_settings(options.settings, fit.model) if options.settings else Settings()
    if options.diagnosis:
        settings = replace(settings, model_error=read_model_error(options.diagnosis, fit.model))
    at = _at(options.at, fit)
    if options.curve:
        return _followed(options, fit, settings, at)
    said = notes(fit, settings)
    log = open_log(options, known=fit) if options.log else None
    recorded = None if log is None else over_log(fit, log, settings)
    beyond = recorded.outside(at) if recorded else []
    if beyond:
        said.append(f"{', '.join(beyond)} of the budget is outside the recorded workspace.")
    budgets = position_budget(fit, at, settings, split=options.split)
    found = {}
    if options.monte_carlo is not None:
        found = position_monte_carlo(fit, at, settings, rng=_rng(options), trials=options.monte_carlo or None)
    mapped = options.map or options.range or (options.plots and recorded)
    grid = _map(options, fit, settings, at, recorded) if mapped else None
    worst = _worst(fit, settings, recorded, grid, options.split)
    record = {
        "calibration": str(options.file),
        "log": None if log is None else str(options.log),
        "model": fit.model.name,
        "covariance": fit.covariance_method,
        "at": fit.model.rest | at,
        "budgets": {c: b.to_dict() for c, b in budgets.items()},
        "monte_carlo": {c: v.to_dict() for c, v in found.items()} or None,
        "recorded": recorded.to_dict() if recorded else None,
        "map": grid.to_dict() if grid else None,
        "notes": said,
    }
    pictures = _pictures(options, worst or budgets, grid, worst=log is not None or grid is not None)
    shown = grid if options.map or options.range else None
    parts = _position_text(budgets, list(found.values()), recorded, shown, settings)
    place = position_words(fit.model.rest | at, fit.model.period)
    parts.insert(0, f"position at {place}; fit covariance: {fit.covariance_method}")
    parts += [""] if said else []
    say(options, record, lambda: "\n".join(parts), notes=said, wrote=pictures)
    return NOT_DETERMINED if fit.undetermined_by_log else OK


def _followed(options: Namespace, fit: Fit, settings: Settings, at: Mapping[str, float]) -> int:
    """The budget of a machine that follows a curve: along its path, and where each coordinate is worst."""
    given = {"monte-carlo": options.monte_carlo is not None, "map": options.map, "range": options.range}
    for name in given:
        if given[name]:
            raise InputError(f"--{name} is for one position or a map; leave --curve out.")
    curve, said = read_curve(options.curve), notes(fit, settings)
    along = along_curve(fit, curve, at, settings)
    if options.log:
        recorded = over_log(fit, open_log(options, known=fit), settings)
        ends = [{c: span[k] for c, span in along.spans().items()} for k in (0, 1)]
        beyond = list(dict.fromkeys(c for end in ends for c in recorded.outside(end)))
        if beyond:
            said.append(f"the curve leaves the recorded workspace in {', '.join(beyond)}.")
    budgets = {}
    for c in fit.model.pose:
        budget = position_budget(fit, along.position(along.worst(c)), settings, split=options.split)[c]
        budgets[c] = with_curve(budget, curve, c) if c in curve.coordinates else budget
    cost = _cost_at_best(along, curve, budgets)
    record = {
        "calibration": str(options.file),
        "log": None if options.log is None else str(options.log),
        "model": fit.model.name,
        "covariance": fit.covariance_method,
        "at": {c: at.get(c, 0.0) for c in along.at if c not in curve.coordinates},
        "budgets": {c: b.to_dict() for c, b in budgets.items()},
        "curve": {"file": options.curve, **(cost.to_dict() if cost else {})},
        "along_curve": along.to_dict(),
        "notes": said,
    }
    pictures = _pictures(options, budgets, worst=True, along=along)
    coverage = f"{100 * settings.level:g} %" if settings.level else f"k = {settings.coverage:g}"
    parts = [
        f"position along {options.curve}; fit covariance: {fit.covariance_method}",
        f"\n{along_text(along, f'U ({coverage}) along the curve')}",
        "\nwhere each coordinate is known worst:",
        *(f"\n{budget_text(budget)}" for budget in budgets.values()),
    ]
    parts += [f"\n{curve_cost_text(cost, ' where the machine is known best')}"] if cost else []
    parts += [""] if said else []
    say(options, record, lambda: "\n".join(parts), notes=said, wrote=pictures)
    return NOT_DETERMINED if fit.undetermined_by_log else OK


def _cost_at_best(along: AlongCurve, curve: Curve, budgets: Mapping[str, Budget]) -> CurveCost | None:
    """What the curve adds where a length that it moves is known best: there it counts most."""
    lengths = [c for c in along.pose if c in curve.coordinates and c.endswith("_m")]
    least = {c: float(along.machine[along.pose.index(c)].min()) for c in lengths}
    best = min(least, key=least.__getitem__, default=None)
    return curve_cost(curve, least[best], budgets[best].factor) if best else None


def _position_text(
    budgets: Mapping[str, Budget],
    found: Sequence[Comparison],
    recorded: Recorded | None,
    grid: UncertaintyMap | None,
    settings: Settings,
) -> list[str]:
    """The tables that a person reads, an empty line before each."""
    coverage = f"{100 * settings.level:g} %" if settings.level else f"k = {settings.coverage:g}"
    parts = [f"\n{budget_text(budget)}" for budget in budgets.values()]
    parts += [f"\n{comparison_text(found)}"] if found else []
    parts += [f"\n{recorded_text(recorded, f'U ({coverage}), recorded workspace')}"] if recorded else []
    parts += [f"\n{recorded_text(grid.over(), f'U ({coverage}), map')}"] if grid else []
    return parts


def _with_noise(fit: Fit, given: Sequence[str]) -> Fit:
    """Return the calibration with the stated noise in place of that of its log."""
    values = dict(map(assignment, given))
    columns = (*fit.model.channels, *fit.model.state, *fit.model.references)
    check_noise_keys(values, columns, "--noise")
    return replace(fit, noise=Noise.given(values, columns).merged(fit.noise))


def _at(given: Sequence[str], fit: Fit) -> dict[str, float]:
    """`x_um=100` as column -> SI value."""
    at: dict[str, float] = {}
    for text in given:
        column, (value,) = column_numbers(text, (*fit.model.pose, *fit.model.state), "--at", "x_um=100")
        if column in at:
            raise InputError(f"--at gives {column} twice; keep one.")
        at[column] = value
    return at


def _map(
    options: Namespace, fit: Fit, settings: Settings, at: Mapping[str, float], recorded: Recorded | None
) -> UncertaintyMap:
    ranges = column_ranges(options.range, map_axes(fit.model))
    spans = recorded.span if recorded else {}
    axes = {c: ranges.get(c) or spans.get(c) for c in map_axes(fit.model)}
    for column, span in axes.items():
        if span is None:
            raise InputError(
                f"A map needs to know what it shall cover: give a LOG, or --range {column}=LOW:HIGH "
                f"(a calibration does not hold its workspace)."
            )
    turn = fit.model.period
    lines = {
        c: (0.0, turn[c]) if c in turn and span[1] - span[0] > turn[c] else sorted(set(span))
        for c, span in axes.items()
        if span
    }  # one turn of what went round more often; one height, where Z never moved
    return uncertainty_map(fit, lines, settings, fixed={c: v for c, v in at.items() if c not in axes})


def _worst(
    fit: Fit, settings: Settings, recorded: Recorded | None, grid: UncertaintyMap | None, split: bool
) -> dict[str, Budget]:
    """Budget of each coordinate where it is known worst; none without a workspace."""
    worst = {}
    for column in fit.model.pose:
        if recorded:
            spot = recorded.where[column]
        elif grid:
            spot = grid.worst(column)[0]
        else:
            return {}
        worst[column] = position_budget(fit, spot, settings, split=split)[column]
    return worst


def _pictures(
    options: Namespace,
    budgets: Mapping[str, Budget],
    grid: UncertaintyMap | None = None,
    *,
    worst: bool = False,
    along: AlongCurve | None = None,
) -> list[Path]:
    """Save the pictures asked for."""
    if not options.plots:
        return []
    from hallsym.report.figures.uncertainty import save_budget_pictures

    return save_budget_pictures(plots_place(options, options.file), budgets, grid, worst=worst, along=along)


def _rng(options: Namespace) -> np.random.Generator:
    return np.random.default_rng(options.seed)
