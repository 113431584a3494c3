"""What each command of the command line does; parsing is in `cli`."""

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hallsym import paper, twin
from hallsym.calibration import Fit, load_fit
from hallsym.campaign import Campaign, paper_campaign, read_campaign
from hallsym.decoding import columns_of, judge
from hallsym.errors import InputError
from hallsym.families import build, effects, models
from hallsym.fitting import LOSSES, SOLVERS, fit, noise_of
from hallsym.log import Log, LogWriter, Noise, check_log, parse_column_option, read_log, spans
from hallsym.log.noise import check_noise_keys
from hallsym.machine import Machine, read_machine
from hallsym.published import values as published_values
from hallsym.tables import error_rows, fit_text, grid, readable
from hallsym.wiring import rewired

OK, NOT_DETERMINED, NOT_CONVERGED = 0, 3, 4


def version() -> str:
    """Return "hallsym 0.1.0"."""
    from importlib.metadata import version as installed

    return f"hallsym {installed('hallsym')}"


def fit_log(options: Namespace) -> int:
    """`hallsym fit`."""
    machine = read_machine(options.machine)
    log = _open(options, machine)
    result = fit(
        log,
        options.model,
        solver=options.solver,
        holdout=None if options.holdout is None else _runs(options.holdout),
        loss=options.loss,
        parameters=machine.parameters,
        effects=options.effect,
        resolve_wiring=options.resolve_wiring,
        drop_bad=options.drop_bad,
        seed=options.seed,
        on_progress=_progress(options),
    )
    if options.output:
        result.save(options.output)
    pictures = _pictures(log, result, options.plots)
    _say(options, result.to_dict(), lambda: fit_text(result))
    if not options.json:
        for path in [*([options.output] if options.output else []), *pictures]:
            print(f"wrote {path}")
    return exit_code(result)


def exit_code(result: Fit) -> int:
    """0, or 3 and 4 with one sentence on stderr that says what is missing."""
    if result.status != "converged":
        print(f"hallsym: the solver did not finish ({result.status}): {result.message}", file=sys.stderr)
        return NOT_CONVERGED
    if result.undetermined_by_log:
        what = ", ".join(result.undetermined_by_log)
        print(
            f"hallsym: this log does not determine {what} of {result.model.name}: "
            "they are held or combined as the table says; record runs that move what they belong to.",
            file=sys.stderr,
        )
        return NOT_DETERMINED
    return OK


def evaluate(options: Namespace) -> int:
    """`hallsym evaluate`."""
    known = load_fit(options.calibration)
    log = rewired(_open(options, Machine(None, {})), known.model.channels, known.wiring)
    columns = columns_of(known.model)
    notes = list(log.notes) if options.drop_bad else check_log(log, columns)
    noise = noise_of(log, known.model)
    table = judge(log, known.model, known.values, {c: s.value for c, s in noise.sigmas.items()})
    rows: dict[str, Any] = {"all runs": table.over()}
    if options.by_run:
        rows |= {f"run {run}": table.over([run]) for run in table.runs}
    record = {
        "calibration": str(options.calibration),
        "model": known.model.name,
        "log": str(options.log),
        "errors": rows["all runs"],
        "by_run": {str(run): table.over([run]) for run in table.runs},
        "noise": {c: {"value": s.value, "source": s.source} for c, s in noise.sigmas.items()},
        "notes": notes,
    }
    _say(options, record, lambda: "\n".join([error_rows(known.model.pose, rows, None), *_noted(notes)]))
    return OK


def simulate(options: Namespace) -> int:
    """`hallsym simulate`."""
    machine = read_machine(options.machine)
    campaign = _campaign(options)
    model, values = _truth(options, machine)
    noise = twin.NoiseModel(
        {c: s * options.noise_scale for c, s in _levels(campaign, model, values).items()},
        correlation_s=options.correlation,
        outlier_share=options.outliers,
        adc_step_m=options.adc_step,
    )
    say, done = _progress(options), 0
    with LogWriter(options.output) as writer:
        for block in twin.simulate_blocks(model, values, campaign, noise, seed=options.seed):
            writer.append(block)
            done += len(block["run"])
            say(f"{100 * done / campaign.rows:.0f} % of {campaign.rows} samples")
    record = {
        "log": str(options.output), "rows": campaign.rows, "runs": len(campaign.runs), "model": model.name,
        "values": dict(values), "noise": dict(noise.sigma), "seed": options.seed,
    }  # fmt: skip
    _say(
        options,
        record,
        lambda: f"wrote {options.output}: {campaign.rows} samples in {len(campaign.runs)} runs",
    )
    return OK


def info(options: Namespace) -> int:
    """`hallsym info`."""
    if options.file is None:
        record: dict[str, Any] = {
            "models": {name: _first_line(make) for name, make in models().items()},
            "effects": {name: _first_line(make) for name, make in effects().items()},
            "solvers": list(SOLVERS),
            "losses": list(LOSSES),
        }
        _say(options, record, lambda: _listing(record))
    elif options.file.endswith(".json"):
        known = load_fit(options.file)
        _say(options, known.to_dict(), lambda: fit_text(known))
    elif options.file.endswith(".toml"):
        record = _about_campaign(read_campaign(options.file))
        _say(options, record, lambda: "\n".join(f"{k}: {v}" for k, v in record.items()))
    else:
        options.log = options.file
        log = _open(options, Machine(None, {}))
        record, text = _about_log(log, options)
        _say(options, record, lambda: text)
    return OK


def demo(options: Namespace) -> int:
    """`hallsym demo`."""
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    log, result, steps = paper.reproduce(on_progress=_progress(options))
    result.save(folder / "calib.json")
    pictures = _pictures(log, result, str(folder))
    record = {"steps": steps, "calibration": result.to_dict(), "pictures": [str(p) for p in pictures]}
    _say(options, record, lambda: paper.text(steps) + "\n\n" + fit_text(result))
    if not options.json:
        print("\n".join(f"wrote {path}" for path in [folder / "calib.json", *pictures]))
    return OK


# -- pieces ----------------------------------------------------------------------------------------------


def _open(options: Namespace, machine: Machine) -> Log:
    from dataclasses import replace

    columns = dict(parse_column_option(text) for text in options.column)
    log = read_log(
        options.log,
        columns=columns,
        column_file=options.column_file,
        format=options.format,
        delimiter=options.delimiter,
        drop_bad=options.drop_bad,
        noise=dict(_assignment(text) for text in options.noise),
    )
    return replace(log, meta=machine.applied(log.meta))


def _assignment(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        sigma = float(value)
    except ValueError:
        sigma = -1.0
    if not name or not 0 < sigma < float("inf"):
        raise InputError(
            f"--noise must be COLUMN=SIGMA with a positive number in SI, such as hall_m=5e-7; got {text!r}."
        )
    return name, sigma


def _runs(text: str) -> list[int]:
    """`2,7,12` or `40-45` as run numbers."""
    runs: list[int] = []
    try:
        for part in filter(None, text.split(",")):
            first, _, last = part.strip().partition("-")
            span = range(int(first), int(last or first) + 1)
            if not span:
                raise ValueError(part)
            runs += span
    except ValueError:
        raise InputError(
            f"--holdout must be run numbers such as 2,7,12 or 40-45; instead received {text!r}."
        ) from None
    return runs


def _progress(options: Namespace) -> Callable[[str], None]:
    """One line on a terminal's stderr, overwritten; silent elsewhere."""
    if options.json or not sys.stderr.isatty():
        return lambda _: None

    def say(text: str) -> None:
        print(f"\r\033[K{text} ...", end="", file=sys.stderr, flush=True)

    return say


def _say(options: Namespace, record: Mapping[str, Any], text: Callable[[], str]) -> None:
    if not options.json and sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    print(json.dumps(record, indent=1) if options.json else text())


def _pictures(log: Log, result: Fit, folder: str | None) -> list[Path]:
    if folder is None:
        return []
    from hallsym.plots import save_pictures

    return save_pictures(log, result, Path(folder), keep=result.keep)


def _noted(notes: list[str]) -> list[str]:
    return [f"note: {note}" for note in notes]


def _campaign(options: Namespace) -> Campaign:
    for name in ("step", "duration"):
        value = getattr(options, name)
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"--{name} must be a positive number of seconds; instead received {value:g}.")
    if options.campaign is None:
        return paper_campaign(options.step or 2e-3, options.duration or 1.0)
    if options.step or options.duration:
        raise InputError(
            "--step and --duration belong to the paper's campaign; a campaign file states its own."
        )
    return read_campaign(options.campaign)


def _truth(options: Namespace, machine: Machine) -> tuple[Any, dict[str, float]]:
    """Model and values of the twin: a calibration's, else Table 7's as far as the model has them."""
    if options.values:
        known = load_fit(options.values)
        if options.model and options.model != known.model.name:
            raise InputError(f"--values holds a {known.model.name}; leave --model out or give that name.")
        return known.model, dict(zip(known.model.names, known.values.tolist(), strict=True))
    from hallsym.log import Meta

    model = build(
        options.model or "stage31",
        meta=machine.applied(Meta()),
        added=tuple(options.effect),
        parameters=machine.parameters,
    )
    paper_values = published_values("table7_estimates") if machine.probes is None else {}
    given = {name: entry["nominal"] for name, entry in machine.parameters.items() if "nominal" in entry}
    return model, {n: v for n, v in (paper_values | given).items() if n in model.names}


def _levels(campaign: Campaign, model: Any, values: Mapping[str, float]) -> dict[str, float]:
    """Noise by column: the campaign file's own, else Table 8's."""
    if not campaign.noise:
        return dict(twin.table8_noise(model, values).sigma)
    columns = (*model.channels, *model.state, *model.references)
    check_noise_keys(campaign.noise, columns, "the campaign's [noise]")
    return {c: s.value for c, s in Noise.given(campaign.noise, columns).sigmas.items()}


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


def _about_log(log: Log, options: Namespace) -> tuple[dict[str, Any], str]:
    notes = list(log.notes) if options.drop_bad else check_log(log)
    extent = spans(log)
    columns = [c for c in log.columns if c != "run"]
    noise = noise_of(log, None)
    record: dict[str, Any] = {
        "log": log.name,
        "rows": log.rows,
        "runs": list(log.runs),
        "holdout": list(log.meta.holdout),
        "base_model": log.meta.base_model,
        "columns": {
            c: {
                "min": extent.overall[c].min,
                "max": extent.overall[c].max,
                "std": extent.overall[c].std,
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
        numbers = [f"{entry[k] * factor:.5g}" for k in ("min", "max", "std")]
        sigma = "" if entry["noise"] is None else f"{entry['noise'] * factor:.3g}"
        rows.append([c, *numbers, sigma, unit, entry["noise_source"] or ""])
    head = f"{log.name}: {log.rows} samples in {len(log.runs)} runs"
    if log.meta.holdout:
        head += f"; held out by its meta.json: {', '.join(map(str, log.meta.holdout))}"
    return record, "\n".join([head, "", grid(rows), *_noted(notes)])
