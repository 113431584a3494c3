"""`hallsym info`: what a file holds, or what hallsym knows."""

from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import command, log_options, noted, open_log, say
from hallsym.cli.trajectory import about_curve
from hallsym.estimation import LOSSES, SOLVERS
from hallsym.estimation.calibration import load_fit
from hallsym.families import build, effects, models
from hallsym.log import Log, check_log, estimate_noise, spans
from hallsym.report.tables import grid
from hallsym.report.text.effect import effect_record, effect_text, is_explained
from hallsym.report.text.fit import fit_text
from hallsym.report.text.model import model_record, model_text
from hallsym.simulation import Campaign, read_campaign
from hallsym.trajectory import is_curve, read_curve
from hallsym.units import readable


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "info", run,
        "Describe a log (columns, runs, motion, noise, what is wrong with it), a saved calibration, a\n"
        "saved curve or a campaign file. A model by name: its chain of links, parameters, zeros, effects it\n"
        "can take. An effect by name: what it means, its numbers, the parameters it adds, what recording\n"
        "separates it from others. Without an argument: the models, effects and solvers there are.\n\n"
        "examples:\n  hallsym info campaign.parquet\n  hallsym info stage31\n  hallsym info hysteresis",
    )  # fmt: skip
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="log, calibration or curve (.json), campaign (.toml), or the name of a model or an effect",
    )
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    if options.file is None:
        record: dict[str, Any] = {
            "models": {name: _first_line(make) for name, make in models().items()},
            "effects": {name: effect.meaning for name, effect in effects().items()},
            "solvers": list(SOLVERS),
            "losses": list(LOSSES),
        }
        say(options, record, lambda: _listing(record))
    elif options.file in models() and not Path(options.file).exists():
        record = model_record(build(options.file))
        say(options, record, lambda: model_text(record))
    elif is_explained(options.file):
        record = effect_record(options.file)
        say(options, record, lambda: effect_text(record))
    elif options.file.endswith(".json") and is_curve(options.file):
        record, text = about_curve(read_curve(options.file))
        say(options, record, lambda: text)
    elif options.file.endswith(".json"):
        known = load_fit(options.file)
        say(options, known.to_dict(), lambda: fit_text(known))
    elif options.file.endswith(".toml"):
        record = _about_campaign(read_campaign(options.file))
        say(options, record, lambda: "\n".join(f"{k}: {v}" for k, v in record.items()))
    else:
        options.log = options.file
        log = open_log(options)
        record, text = _about_log(log, options)
        say(options, record, lambda: text)
    return OK


def _first_line(function: Callable) -> str:
    return (function.__doc__ or "").strip().split("\n")[0]


def _listing(record: Mapping[str, Any]) -> str:
    parts = []
    for kind in ("models", "effects"):
        parts.append(grid([[kind, ""], *([n, text] for n, text in record[kind].items())], left=2))
    parts.append("solvers: " + ", ".join(record["solvers"]))
    parts.append("losses: " + ", ".join(record["losses"]))
    return "\n\n".join(parts)


def _about_campaign(campaign: Campaign) -> dict[str, Any]:
    return {
        "runs": len(campaign.runs),
        "samples": campaign.rows,
        "clock [s]": campaign.step_s,
        "seconds recorded": sum(run.duration_s for run in campaign.runs),
        "noise": dict(campaign.noise or {}),
    }


MOST_ESTIMATED = 256
"""Columns whose noise is estimated for a summary: some ms each, of one run."""


def _about_log(log: Log, options: Namespace) -> tuple[dict[str, Any], str]:
    notes = list(log.notes) if options.drop_bad else check_log(log)
    extent = spans(log)
    columns = [c for c in log.columns if c != "run"]
    sensed = [c for c in columns if c != "t_s" and c in extent.overall]
    unknown = [c for c in sensed if c not in log.noise][:MOST_ESTIMATED]
    noise = log.noise.merged(estimate_noise(log, unknown)) if unknown else log.noise
    if len(sensed) > MOST_ESTIMATED:
        notes.append(f"The noise of the first {MOST_ESTIMATED} columns is estimated.")
    record: dict[str, Any] = {
        "log": log.name,
        "rows": log.rows,
        "runs": list(log.runs),
        "holdout": list(log.meta.holdout),
        "base_model": log.meta.base_model,
        "columns": {
            c: {
                **{k: getattr(extent.overall.get(c), k, None) for k in ("min", "max", "std")},
                "noise": noise[c].value if c in noise else None,
                "noise_source": noise[c].source if c in noise else None,
            }
            for c in columns
        },
        "notes": notes,
    }
    rows = [["column", "min", "max", "std", "noise (1 sigma)", "unit", "noise is"]]
    for c in columns:
        factor, unit, _ = readable(c) if c != "t_s" else (1.0, "s", "t")
        entry = record["columns"][c]
        numbers = ["" if entry[k] is None else f"{entry[k] * factor:.5g}" for k in ("min", "max", "std")]
        sigma = "" if entry["noise"] is None else f"{entry['noise'] * factor:.3g}"
        rows.append([c, *numbers, sigma, unit, entry["noise_source"] or ""])
    head = f"{log.name}: {log.rows} samples in {len(log.runs)} runs"
    if log.meta.holdout:
        head += f"; held out by its meta.json: {', '.join(map(str, log.meta.holdout))}"
    return record, "\n".join([head, "", grid(rows), *noted(notes)])
