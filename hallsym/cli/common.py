"""Shared parts of the commands: options, opening logs, progress, and output of results."""

import math
import re
import shlex
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hallsym.cli import progress
from hallsym.cli.progress import Meter
from hallsym.errors import InputError, require
from hallsym.estimation import Fit, load_fit
from hallsym.families import build, default_model, family_called, load_effects, model_for
from hallsym.families.machine_file import Machine
from hallsym.families.published import values as published_values
from hallsym.families.recording import corrected
from hallsym.files import MOST_NUMBER, json_text
from hallsym.log import Log, Meta, Noise, check_noise_keys, parse_column_option, read_log
from hallsym.log.formats import files_of, open_source
from hallsym.log.groups import GroupedSource
from hallsym.model import Effect, Model
from hallsym.output import fitted, printable
from hallsym.records import named
from hallsym.report.content import Content, printed
from hallsym.report.views import content, pictures
from hallsym.simulation import Campaign, default_campaign, read_campaign, table8_noise
from hallsym.simulation.paper import DESIGNED
from hallsym.toml import column_of


def plots(
    options: Namespace, found: Any, *named: object, folder: str | Path | None = None, log: Log | None = None
) -> list[Path]:
    """Save the pictures of a result in a folder, that of `--plots` if none is named; nothing without one.

    `named` on each of them: file and model, those that are known. `log`: as for `pictures`.
    """
    folder = folder or getattr(options, "plots", None)
    if folder is None:
        return []
    from hallsym.report.drawing import save

    words = [str(name) for name in named if name]
    brief = ["/".join(Path(word).parts[-2:]) if Path(word).exists() else word for word in words]
    return save(pictures(found, log), folder, ", ".join(brief))


FILE_OPTIONS = ("format", "delimiter", "decimal", "sheet", "clock")
"""Options that say what a file is."""


def own_effects(options: Namespace) -> dict[str, Effect]:
    """Return the user's own effects by name; none without a file."""
    return {e.name: e for e in load_effects(options.effects)} if options.effects else {}


def open_log(
    options: Namespace,
    machine: Machine | None = None,
    known: Fit | None = None,
    path: str | None = None,
    *,
    correct: Sequence[str] = (),
) -> Log:
    """Read a log, `options.log` by default; a machine's probes stand in place of the log's own.

    `known`: a calibration, whose names of columns count where nothing else is stated. `correct`: mistakes of
    the recording to undo; a fit is given them beside its log, since its result keeps them.
    """
    reading = reading_of(options) | {"drop_bad": options.drop_bad}
    reading |= {} if known is None else {"remembered": known.columns, "read_with": known.read_with}
    path = options.log if path is None else path
    log = read_log([path, *options.join] if options.join else path, **reading)
    log = corrected(log, correct)
    if machine is None:
        return log
    meta = machine.applied(log.meta)
    stated = meta.probes is not None or meta.nominal or machine.parameters
    words = shlex.join([str(path), *reading_words(options)])
    notes = [] if stated or known else layout_notes(options.model, meta, words)
    return replace(log, meta=meta, notes=(*log.notes, *notes))


def layout_notes(name: str | None, meta: Meta, log: str = "LOG") -> list[str]:
    """Return the note on the layout that is assumed where nobody states one; `log` as in `default_model`."""
    name = name or default_model(meta, log)
    family = family_called(name)
    if family is None or not family.assumed or any(table in meta.raw for table in family.tables):
        return []
    places = build(name, meta=meta).channels
    extra = [c for c in meta.columns if re.fullmatch(family.readings, c) and c not in places]
    beside = f"; {', '.join(extra)} of the log have no place in it and are not used" if extra else ""
    return [
        f"The layout is assumed: {family.assumed}{beside}. State that of your machine with --machine FILE."
    ]


def runs_in_files(options: Namespace, paths: Sequence[str]) -> list[str]:
    """Return files as the words that name them as one log, where each is a run; else none.

    A folder that holds nothing else is named in place of its files.
    """
    if len(paths) < 2 or any(Path(path).is_dir() for path in paths):
        return []
    source = open_source(list(paths), **{name: getattr(options, name) for name in FILE_OPTIONS}).source
    if not (isinstance(source, GroupedSource) and source.numbered):
        return []
    folder = Path(paths[0]).parent
    whole = set(files_of(folder)) == {Path(path) for path in paths}
    return [str(folder)] if whole else list(paths)


def refuse_twice(paths: Sequence[str]) -> None:
    """Refuse a log that is given twice."""
    for k, path in enumerate(paths):
        if path in paths[:k]:
            raise InputError(f"Log {path} is given twice; give it once.")


def reading_of(options: Namespace) -> dict[str, Any]:
    """Return how a log is read, as `read_log` takes it: `log_options` but for `--drop-bad`."""
    files = [t for t in options.column if "=" not in t and (Path(t).suffix or Path(t).exists())]
    require(len(files) < 2, "--column", "one column file at most", ", ".join(files))
    return {
        "columns": dict(parse_column_option(text) for text in options.column if text not in files),
        "column_file": files[0] if files else None,
        "noise": dict(assignment(text) for text in options.noise),
        **{name: getattr(options, name) for name in FILE_OPTIONS},
    }


def assignment(text: str) -> tuple[str, float]:
    """Read one `--noise COLUMN=SIGMA`."""
    name, _, value = text.partition("=")
    sigma = _floats(value)
    good = name and len(sigma) == 1 and 0 < sigma[0] < math.inf
    require(good, "--noise", "COLUMN=SIGMA with a positive number in SI, such as hall_m=5e-7", text)
    return name, sigma[0]


def _floats(text: str) -> list[float]:
    """Return the numbers of `-300:300`; none where one of them is none."""
    try:
        return [float(number) for number in text.split(":")]
    except ValueError:
        return []


def column_numbers(text: str, columns: Sequence[str], option: str, example: str) -> tuple[str, list[float]]:
    """Read `x_um=100` or `x_um=-300:300` of an option: the column and its finite values in SI."""
    key, _, value = text.partition("=")
    column, factor = column_of(key, columns, option)
    found = [number * factor for number in _floats(value)]
    good = len(found) == 1 + example.count(":") and all(abs(value) <= MOST_NUMBER for value in found)
    wanted = f"numbers with the unit in the name, such as {key}={example.partition('=')[2]}"
    require(good, option, wanted, text)
    return column, found


def column_values(given: Sequence[str], columns: Sequence[str]) -> dict[str, float]:
    """Read every `--at x_um=100`: column -> SI value."""
    return {c: value for c, (value,) in (column_numbers(text, columns, "--at", "=100") for text in given)}


def column_ranges(
    given: Sequence[str], columns: Sequence[str], option: str = "--range"
) -> dict[str, tuple[float, float]]:
    """Read every `--range x_um=-300:300`: column -> least and greatest SI value."""
    ranges = {}
    for text in given:
        example = f"{text.partition('=')[0]}=-300:300"
        column, (low, high) = column_numbers(text, columns, option, example)
        require(low < high, option, "from the lesser to the greater value", text)
        ranges[column] = low, high
    return ranges


def chosen(options: Namespace, work: Callable[..., Any]) -> dict[str, Any]:
    """Return the options that are named as keyword arguments of the function that does the work."""
    named = (p.name for p in signature(work).parameters.values() if p.kind is p.KEYWORD_ONLY)
    return {name: getattr(options, name) for name in named if hasattr(options, name)}


def refuse(options: Namespace, names: Sequence[str], why: str) -> None:
    """Refuse the first of some options that is given, in a sentence that goes on with `why`."""
    for name in names:
        if getattr(options, name) not in (None, False, []):
            raise InputError(f"{'A LOG' if name == 'log' else '--' + name.replace('_', '-')} {why}.")


def warn(sentence: str) -> None:
    """Print a sentence on stderr that goes with an exit code."""
    print(f"hallsym: {printable(sentence)}", file=sys.stderr)


def progress_of(options: Namespace) -> Callable[[str], None]:
    """Return what shows the progress of long work on stderr; nothing beside `--json`."""
    return (lambda _: None) if options.json else Meter()


def say(
    options: Namespace,
    found: Any,
    said: Callable[[], Content | str] | None = None,
    *,
    notes: Sequence[str] = (),
    wrote: Sequence[str | Path | None] = (),
    then: Sequence[str] = (),
    more: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Print the JSON record with its format; or the answer, then notes, files written, the next command.

    `found`: a result, or a record of which `said` makes the answer. `then`: the words of that command.
    `more`: of the record of a result.
    """
    if options.json:
        record = {**found.to_dict(), **more} if said is None else found
        print(json_text({"format": f"hallsym {options.command} 1", **record}))
        return
    progress.ended()
    answer = content(found) if said is None else said()
    text = answer if isinstance(answer, str) else printed(answer)
    lines = [printable(f"note: {note}") for note in notes]
    lines += [printable(f"wrote {path}") for path in wrote if path]
    lines += [printable(f"next: {shlex.join(then)}")] if then else []
    print(fitted("\n".join([text, *lines]).rstrip("\n")))


def reading_words(options: Namespace, known: Fit | None = None) -> list[str]:
    """Words of a command that its next step needs too: how the log is read, and the machine.

    `known`: a calibration that the next step does not read, but whose mapping of columns it needs.
    """
    mapped = known.columns if known else {}
    columns = [f"{ours}={c.option}" for ours, c in mapped.items() if not options.column]
    words = [word for column in (*options.column, *columns) for word in ("--column", column)]
    for name, text in (known.read_with if known else {}).items():
        words += [f"--{name}", text] if getattr(options, name, None) is None else []
    words += [word for noise in options.noise for word in ("--noise", noise)]
    for option in (*FILE_OPTIONS, "machine", "effects"):
        value = getattr(options, option, None)
        if value is not None:
            words += [f"--{option.replace('_', '-')}", value]
    return [*words, *samples_words(options)]


def samples_words(options: Namespace) -> list[str]:
    """Words of a command on the same log that no calibration holds: further files, samples left out."""
    words = [word for path in options.join for word in ("--join", path)]
    words += [word for text in getattr(options, "correct", []) for word in ("--correct", text)]
    return [*words, *(["--drop-bad"] if options.drop_bad else [])]


def campaign_of(options: Namespace) -> Campaign:
    """Return the campaign of a file, else the paper's, else the example of the model's family."""
    step = getattr(options, "step", None)
    require(step is None or 0 < step < math.inf, "--step", "a positive number of seconds", step)
    if options.campaign is None:
        model = build(options.model or DESIGNED)
        if step is None or model.family.example is None:
            return default_campaign(model, step or 2e-3)
    if step:
        raise InputError(
            "--step belongs to the paper's campaign of the stage; a campaign file states its own."
        )
    return read_campaign(options.campaign)


def built(name: str, machine: Machine, effects: Sequence[str] = ()) -> Model:
    """Return a model with some effects, of the probes and parameters of a machine."""
    meta = machine.applied(Meta())
    return build(name, meta=meta, added=tuple(effects), parameters=machine.parameters)


def truth_of(
    options: Namespace, machine: Machine, campaign: Campaign | None = None
) -> tuple[Model, dict[str, float]]:
    """Return model and values of the simulated machine: a calibration's, else the published ones it has.

    Where no model is named, that of the axes which `campaign` moves.
    """
    if path := getattr(options, "values", None):
        known = load_fit(path)
        if options.model and options.model != known.model.name:
            raise InputError(f"--values holds a {known.model.name}; leave --model out or give that name.")
        return known.model, named(known.model.names, known.values)
    runs = campaign.runs if campaign else ()
    moved = {axis for run in runs for axis in (*run.setting, *run.motion)}
    model = built(options.model or model_for(moved), machine, options.effect)
    own = model.family.example
    paper_values = published_values("table7_estimates") if machine.probes is None and own is None else {}
    paper_values = paper_values | dict(own.values if own else {})
    given = {name: entry["nominal"] for name, entry in machine.parameters.items() if "nominal" in entry}
    return model, {n: v for n, v in (paper_values | given).items() if n in model.names}


def levels(campaign: Campaign, model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Return the noise by column: the campaign file's own, else the example's of the family, else Table 8's.

    A file may state the noise of every form in which a family is read (two voltages, or an angle).
    """
    own = model.family.example.noise if model.family.example else None
    if not campaign.noise and own:
        return Noise.given(own, (*model.channels, *model.references)).std
    if not campaign.noise:
        return dict(table8_noise(model, values).sigma)
    columns = (*model.channels, *model.state, *model.references)
    other = [c for c in campaign.noise if c in (own or {}) and not Noise.given({c: 1.0}, columns)]
    stated = {c: s for c, s in campaign.noise.items() if c not in other}
    check_noise_keys(stated, columns, "the campaign's [noise]")
    found = Noise.given(stated, columns).std
    lacking = [c for c in model.channels if c not in found]
    if other and lacking:
        raise InputError(
            f"The campaign's [noise] states {' and '.join(other)}, but this machine is read as "
            f"{' and '.join(model.channels)}; state the noise of {' and '.join(lacking)} too: "
            "one file may hold both."
        )
    return found
