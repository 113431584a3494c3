"""`hallsym info`: the content of a file, or the models, effects and solvers of hallsym.

Describe a log (columns, runs, motion, noise, what is wrong with it), a saved calibration, a
saved curve or a campaign file. A model by name: its links, parameters, offsets and possible
effects. An effect by name: what it means, its numbers, the parameters it adds, what recording
separates it from others. corrections: what --correct of fit takes. Without an argument: the
models, effects and solvers there are.

examples:
  hallsym info campaign.parquet
  hallsym info stage31
  hallsym info hysteresis
  hallsym info lab.csv --write columns.toml
  hallsym info 'runs/*.csv' --write columns.toml
"""

import shlex
from argparse import Namespace
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import accumulate, zip_longest
from pathlib import Path
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import (
    FILE_OPTIONS,
    layout_notes,
    open_log,
    reading_of,
    reading_words,
    runs_in_files,
    say,
)
from hallsym.cli.trajectory import about_curve
from hallsym.errors import InputError, counted, few
from hallsym.estimation import LOSSES, SOLVERS
from hallsym.estimation.calibration import load_fit
from hallsym.families import build, effects, family_called, models, recording
from hallsym.families.machine_file import read_machine
from hallsym.files import atomic_write, read_json
from hallsym.log import Log, Meta, check_log, estimate_noise, open_source, spans
from hallsym.log.columns import is_moving, split_header
from hallsym.log.formats import FORMATS, Opened
from hallsym.log.groups import GroupedSource
from hallsym.log.table import Source
from hallsym.model import Model
from hallsym.output import PROSE, fitted
from hallsym.output import columns as columns_of_line
from hallsym.report.content import Block, Content, Section, Table, text_of
from hallsym.report.results.info import (
    effect_content,
    effect_record,
    is_explained,
    model_content,
    model_record,
)
from hallsym.report.words import number
from hallsym.simulation import read_campaign
from hallsym.trajectory import is_curve, read_curve
from hallsym.units import readable, si_name, split_unit

COLUMN_FILE = "columns.toml"


EPILOG = "endings of logs, by --format:\n" + "\n".join(
    f"  {entry.name:9}{' '.join(entry.suffixes)}" for entry in FORMATS
)
OPTIONS = f"""
files FILE_OR_NAME <any>        log, calibration or curve (.json), campaign (.toml), or the name of
    a model or an effect; several files are one log: runs where they have the same columns, else
    joined by their times
--write TOML <optional, alone={COLUMN_FILE}>  of a log whose columns have other names: write a
    column file with the best guess for each, to be checked (default {COLUMN_FILE})
--model MODEL                   what --write is for, such as stage31 (default: by the names)
--machine TOML                  your machine, whose probes --write looks for; as of 'hallsym fit'
@log explained
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    options.file, *others = runs_in_files(options, options.files) or options.files or [None]
    options.join = [*others, *options.join]
    if options.file is None:
        record: dict[str, Any] = {
            "models": {name: _meaning(make) for name, make in models().items()},
            "effects": {name: effect.meaning for name, effect in effects().items()},
            "solvers": list(SOLVERS),
            "losses": list(LOSSES),
        }
        say(options, record, lambda: _listing(record))
    elif options.file == "corrections":
        record = {"corrections": [recording.usage(known) for known in recording.MISTAKES.values()]}
        say(options, record, lambda: recording.__doc__.strip())
    elif others or options.write:
        return _write(options) if options.write else _log(options)
    elif family_called(options.file) and not Path(options.file).exists():
        record = model_record(build(options.file))
        say(options, record, lambda: model_content(record))
    elif is_explained(options.file):
        record = effect_record(options.file)
        say(options, record, lambda: effect_content(record))
    elif options.file.endswith(".json") and is_curve(options.file):
        record, text = about_curve(read_curve(options.file))
        say(options, record, lambda: text)
    elif options.file.endswith(".json") and not _is_log(options.file):
        known = load_fit(options.file)
        say(options, known)
    elif options.file.endswith(".toml"):
        campaign = read_campaign(options.file)
        record = {
            "runs": len(campaign.runs), "samples": campaign.rows, "clock_s": campaign.step_s,
            "seconds": sum(run.duration_s for run in campaign.runs),
            "noise": dict(campaign.noise or {}),
        }  # fmt: skip
        said = f"{options.file}: {counted(campaign.rows, 'sample')} in {counted(len(campaign.runs), 'run')}."
        lines = [f"{k}: {v}" for k, v in record.items()]
        say(options, record, lambda: Content(said, said, first=lines))
    else:
        return _log(options)
    return OK


def _is_log(path: str) -> bool:
    """Return whether a JSON file is one of another program; each of hallsym states its format."""
    try:
        raw = read_json(path, "File", "copy it again")
    except InputError:
        return False
    return not (isinstance(raw, dict) and "format" in raw)


def _log(options: Namespace) -> int:
    source = _opened(options).source
    try:
        log = open_log(options, path=options.file)
    except InputError:
        if not options.json:
            print(fitted(text_of(_head(source))))
        raise
    record, said = _about_log(log, options)
    if source.recognised:
        record["recognised"] = source.recognised
    if not any(map(is_moving, log.columns)):
        typed = shlex.join([*options.typed, "--write"])
        note = f"note: no column has one of hallsym's names; '{typed}' writes a column file to check."
        said = replace(said, sections=[*said.sections, Section("more", "More", [note])])
    say(options, record, lambda: replace(said, first=_head(source)))
    return OK


SHOWN_ROWS, SHOWN_COLUMNS, SHOWN_DIGITS = 3, 40, 12


def _opened(options: Namespace) -> Opened:
    paths = [options.file, *options.join] if options.join else options.file
    named = {their.name: ours for ours, their in reading_of(options)["columns"].items()}
    return open_source(paths, mapped=named, **{name: getattr(options, name) for name in FILE_OPTIONS})


def _head(source: Source) -> list[Block | str]:
    """The recognised form of a file, and its first rows under its own names, as many as fit."""
    rows = source.head(SHOWN_ROWS, SHOWN_COLUMNS)
    names = source.names[:SHOWN_COLUMNS]
    stated = [source.units.get(name) for name in names]
    units = [f" [{u}]" if u and u != split_header(n)[1] else "" for n, u in zip(names, stated, strict=True)]
    columns = [
        [name + unit, *(_short(row[k]) or "-" for row in rows if k < len(row))]
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    ends = list(accumulate(max(map(len, column)) + 2 for column in columns))
    fit = max(1, sum(end <= (columns_of_line() or PROSE) for end in ends))
    table = list(zip_longest(*columns[:fit], fillvalue=""))
    more = len(source.names) - fit
    lines: list[Block | str] = [f"read as {source.recognised}"] if source.recognised else []
    lines += [Table(table[0], table[1:], "first rows", left=0)] if table else []
    lines += [f"and {counted(more, 'column')} more"] if more > 0 else []
    return [*lines, *(f"left out: {name} ({why})" for name, why in source.left_out.items())]


def _short(cell: str) -> str:
    """Return a cell of a file; of a number with more digits than a person compares the first ones."""
    try:
        return cell if len(cell) <= SHOWN_DIGITS else f"{float(cell):.6g}"
    except ValueError:
        return cell


def _write(options: Namespace) -> int:
    from hallsym.families.suggest import likeness, suggest

    _, folder, source, where = _opened(options)
    described = folder is not None and (folder / "meta.json").exists()
    meta = Meta.read(folder / "meta.json") if folder and described else Meta()
    found = suggest(source, options.model, read_machine(options.machine).applied(meta))
    text = found.to_toml(where)
    if (old := Path(options.write)).is_file() and old.read_bytes() != text.encode():
        raise InputError(
            f"{options.write} exists, perhaps corrected by hand; remove it, or give --write another name."
        )
    atomic_write(options.write, text)
    record = {
        "model": found.model.name,
        "columns": {g.stem: {**vars(g), "lines": g.lines} for g in found.guesses},
        "open": list(found.open),
        "rest": list(found.rest),
    }
    options.column = [options.write]
    if options.join and isinstance(source, GroupedSource) and source.others:  # whose names are in the draft
        options.clock = source.master.name
    stated = options.model or (found.recognised and not found.by_columns)
    chosen = ["--model", found.model.name] if stated else []
    following = ["hallsym", "fit", options.file, *chosen, *reading_words(options)]
    check = f"Check {options.write}"
    if found.open:
        open = ", ".join(found.open)
        check += f": in it the unit of {open} is open; remove the # of the right line of each"
    columns = tuple(si_name(g.ours) for g in found.guesses) + found.rest
    notes = list[str]()
    with suppress(InputError):  # a draft with open units may be no log of the model
        notes = [] if described or options.machine else layout_notes(found.model.name, Meta(columns=columns))
    if not found.recognised:
        unknown = "nothing in the file tells what sensor it is of"
        remedy = f"say it with --model ('hallsym info' lists them), or name the columns in {options.write}"
        notes = [f"{unknown}: {remedy}."]
    elif found.lacking:
        notes.append(f"no column is like {', '.join(found.lacking)}; name theirs in {options.write}.")
        stems = [split_unit(column)[0] for column in found.lacking]
        for name in (n for n in found.rest if any(likeness(stem, n) for stem in stems)):
            try:
                source.read([name])
            except InputError as error:
                notes.append(str(error))
    answer = f"{check}."
    blocks = [*_head(source), "", *text.split("\n")]
    say(
        options,
        record,
        lambda: Content(answer, answer, first=blocks),
        notes=notes,
        wrote=[options.write],
        then=following,
    )
    return OK


def _meaning(make: Callable[..., Model]) -> str:
    """Return the noun of the first line of a docstring: it says what is returned."""
    said = (make.__doc__ or "").strip().split("\n")[0].removeprefix("Return ")
    return said[:1].upper() + said[1:]


def _listing(record: Mapping[str, Any]) -> Content:
    tables: list[Block | str] = [
        Table([kind, "meaning"], [*record[kind].items()], kind, wordy=(1,)) for kind in ("models", "effects")
    ]
    tables += [f"{kind}: {', '.join(record[kind])}" for kind in ("solvers", "losses")]
    known = f"{len(record['models'])} models, {len(record['effects'])} effects"
    answer = f"hallsym knows {known} and {len(record['solvers'])} solvers; 'hallsym info NAME' explains one."
    return Content("hallsym", answer, first=tables)


ROUNDING = 1e-12
"""Part of a column's largest value below which its noise is the rounding of the numbers: 4e3 units of it."""


def _sigma(entry: Mapping[str, Any], factor: float) -> str:
    """Return the noise of a column for reading; 0 where nothing but rounding scatters."""
    largest = max(abs(entry[end] or 0.0) for end in ("min", "max"))
    return "0" if entry["noise"] <= ROUNDING * largest else number(entry["noise"] * factor)


def _about_log(log: Log, options: Namespace) -> tuple[dict[str, Any], Content]:
    notes = list(log.notes) if options.drop_bad else check_log(log)
    extent = spans(log)
    columns = [c for c in log.columns if c != "run"]
    sensed = [c for c in columns if c != "t_s" and c in extent.overall]
    unknown = [c for c in sensed if c not in log.noise]
    noise = log.noise.merged(estimate_noise(log, unknown)) if unknown else log.noise
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
    head, rows = ["column", "min", "max", "std", "noise (1 sigma)", "unit", "noise is"], []
    for c in columns:
        factor, unit, _ = readable(c) if c != "t_s" else (1.0, "s", "t")
        entry = record["columns"][c]
        numbers = ["" if entry[k] is None else number(entry[k] * factor, 5) for k in ("min", "max", "std")]
        sigma = "" if entry["noise"] is None else _sigma(entry, factor)
        rows.append([c, *numbers, sigma, unit, entry["noise_source"] or ""])
    runs = f" in {counted(len(log.runs), 'run')}" if len(log.runs) > 1 else ""
    answer = f"{log.name}: {counted(log.rows, 'sample')}{runs}"
    if log.meta.holdout:
        answer += f"; holdout by its meta.json: {few([*map(str, log.meta.holdout)])}"
    known = log.table.source.recognised  # stands above the first rows already
    others = [f"note: {note}" for note in notes if not known or known not in note]
    answer += f"; {counted(len(others), 'remark')}" if others else "; nothing wrong was found"
    table = Table(head, rows, "columns")
    return record, Content(log.name, f"{answer}.", [Section("columns", "Columns", [table, *others])])
