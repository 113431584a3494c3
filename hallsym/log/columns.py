"""Which column of a file becomes which SI column of a log."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import structs

from hallsym.errors import InputError, few, nearest, quoted, require
from hallsym.files import MOST_NUMBER
from hallsym.records import structured
from hallsym.toml import Table
from hallsym.units import UNITS, Array, quantity, require_unit, si_name, split_unit

RUN = "run"
RUN_WORDS = (
    "run", "pass", "scan", "sweep", "trial", "test", "experiment", "segment", "measurement", "lauf", "fahrt",
    "messung", "versuch", "次数",
)  # fmt: skip
TIME_WORDS = ("t", "time", "timestamp", "zeit", "clock", "elapsed", "temps", "时间", "時間")
"""Usual names of runs, and of the time."""
T = "t"
"""Name of the time in a log, without its unit, and of times that a format gives."""


def is_time_word(name: str) -> bool:
    """Say whether a name without a unit is one of time, such as `Relative Time`.

    >>> is_time_word("Zeit"), is_time_word("Relative Time"), is_time_word("Time constant")
    (True, True, False)
    """
    return next(reversed(re.findall(r"[^\W_]+", name.lower())), "") in TIME_WORDS


WORDS = re.compile(r"[A-Z]{2,}(?![a-z])|[A-Z]?[^\W\d_A-Z]+|[A-Z]|\d+")
"""The words of a name, and its numbers."""


def is_run_word(name: str) -> bool:
    """Say whether a word of a name is one of runs, as of `scan_number` and `TestID`."""
    return not {*RUN_WORDS}.isdisjoint(word.lower() for word in WORDS.findall(name))


def numbers_runs(values: Array) -> bool:
    """Say whether numbers (rows,) are such as those of runs: whole, they stay, and they rise."""
    steps, whole = np.diff(values), np.isfinite(values).all() and (values == np.floor(values)).all()
    return bool(whole and np.count_nonzero(steps) <= len(values) / SHORTEST_RUN and (steps >= 0).all())


SHORTEST_RUN = 8
"""Samples of a run on average from which a column of whole numbers may be that of runs."""


UNNAMED = re.compile(r"unnamed_\d+|\(column \d+\)|column_\d+")
"""Columns without a name, by their place."""
_OPEN = re.compile(r"^# (\w+) = ", re.MULTILINE)


Turn = Annotated[float, msgspec.Meta(ge=2, le=MOST_NUMBER)]
"""Counts that make a turn."""


class Foreign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A column of another program: values are `sign * scale * file + offset`, in the unit that we name.

    `counts_per_turn`: of an angle in counts.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    counts_per_turn: Turn | None = None
    sign: Literal[1, -1] = 1

    @property
    def option(self) -> str:
        """Text behind the equals sign of `--column`."""
        numbers = {k: v for k, v in msgspec.to_builtins(self).items() if k != "name"}
        return self.name + "".join(f",{k}={v!r}" for k, v in numbers.items())


@dataclass(frozen=True)
class Binding:
    """SI column `name` is `factor * file[foreign.name] + offset`.

    `asked`: our name with its unit, as somebody mapped it, "" for the file's own; `foreign`: what was mapped.
    """

    name: str
    foreign: Foreign
    factor: float = 1.0
    offset: float = 0.0
    asked: str = ""

    @property
    def source(self) -> str:
        """Name of the column in the file."""
        return self.foreign.name

    def si(self, raw: Array) -> Array:
        """Return SI values (float64; the run column as integers) of raw values of shape (rows,)."""
        if self.name == RUN:
            return _whole(raw, self.source)
        values = np.asarray(raw, np.float64)
        if self.factor != 1.0:
            values = values * self.factor
        return values + self.offset if self.offset else values


@dataclass(frozen=True)
class ColumnFile:
    """Content of a column file: foreign columns by our name, and noise (1 sigma) in the stated units.

    `open`: names that stand in it as comments, for somebody to choose a unit.
    """

    columns: dict[str, Foreign] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    counts_per_turn: float | None = None
    open: tuple[str, ...] = ()


_NUMBERS = re.compile(r"((?:,\s*(?:scale|offset|counts_per_turn|sign)=[^,]*)+)$")


def parse_column_option(text: str) -> tuple[str, Foreign]:
    """Split `hall_a_um=HallA,scale=0.5,offset=-3` into our name and the foreign column; numbers may lack."""
    ours, equals, theirs = (part.strip() for part in text.partition("="))
    numbers = _NUMBERS.search(theirs)
    name = theirs[: numbers.start()].strip() if numbers else theirs
    if not (equals and ours and name):
        raise InputError(
            f"Option --column must be OUR_NAME=ITS_NAME, such as hall_a_um=HallA; it is '{text}'."
        )
    entry: dict[str, Any] = {"name": name}
    for part in numbers[1].split(",")[1:] if numbers else ():
        key, _, value = part.strip().partition("=")
        try:
            entry[key] = int(value) if key == "sign" else float(value)
        except ValueError:
            said = f"Option --column {ours} must give {key} as a number; instead received {value!r}."
            raise InputError(said) from None
    return ours, _foreign(ours, entry, "option --column")


def read_column_file(path: str | Path) -> ColumnFile:
    """Read a TOML column file: `[columns]` maps `hall_a_um = "HallA"`, `[noise]` gives `hall_m = 5e-7`.

    A sign, scale or offset is stated as `hall_b_m = {name = "ADC1", sign = -1}` (or `scale`, `offset`).
    """
    file = Table.read(path, "Column file", ("columns", "noise", "counts_per_turn"))
    columns, noise = file.table("columns"), file.table("noise")
    where = f"column file {quoted(path)}"
    return ColumnFile(
        {ours: _foreign(ours, entry, where) for ours, entry in columns.raw.items()},
        {key: noise.positive(key) for key in noise.raw},
        file.raw.get("counts_per_turn"),
        tuple(_OPEN.findall(Path(path).read_text(encoding="utf-8"))),
    )


def counts_in_turn(value: Any, where: str) -> float:
    """Return the counts of a turn, 2 or more; raise `InputError` for anything else."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and 2 <= value <= MOST_NUMBER
    require(good, f"counts_per_turn of {where}", "a number of 2 or more, such as 16384 for 14 bits", value)
    return float(value)


def bind(
    found: Sequence[str],
    wanted: Mapping[str, Foreign],
    where: str,
    counts_per_turn: float | None = None,
    units: Mapping[str, str] | None = None,
) -> tuple[dict[str, Binding], list[str]]:
    """Return the SI columns that a file with columns `found` offers, by SI name, and notes on them.

    A file's own column whose name states its unit, or beside whose name the file does (`units`, by name),
    needs no mapping; one without a unit is left out. Angles in counts need `counts_per_turn`.
    """
    bindings: dict[str, Binding] = {}
    stated, said = units or {}, []
    for ours, foreign in wanted.items():
        if ours != RUN and foreign.name not in stated:
            require_unit(ours)
        if foreign.name not in found:
            raise InputError(
                f"{where} has no column '{foreign.name}' for {ours}{nearest(foreign.name, list(found))};"
                f" it has {few(found, 20) or 'no numeric columns'}."
            )
        unit, asked = stated.get(foreign.name), ours
        if ours != RUN and unit and split_unit(ours)[1] is None:
            ours = f"{ours}_{unit}"
        elif ours != RUN and unit and unit != require_unit(ours).name:
            said.append(
                f"Column '{foreign.name}' is read in {require_unit(ours).name} as stated; its header says"
                f" {unit}."
            )
        _add(bindings, _binding(ours, foreign, where, counts_per_turn, asked), where)
    taken = {b.source for b in bindings.values()}
    mapped = set(bindings)
    for column in (c for c in found if c not in taken):
        name = RUN if column.lower() == RUN not in found else _named(column, stated.get(column), where)
        if name == RUN or split_unit(name)[1]:
            own = _binding(name, Foreign(column), where, counts_per_turn)
            if own.name not in mapped:  # what somebody wrote wins over the file's own name
                _add(bindings, own, where)
    return bindings, said


def _named(column: str, unit: str | None, where: str) -> str:
    """Return a column with the unit that the file states beside its name: `x_ref` [um] -> `x_ref_um`."""
    stem, own = split_unit(column)
    if unit is None or column == RUN:
        return column
    if own and quantity(stem) and own != UNITS[unit]:
        raise InputError(
            f"Column '{column}' of {where} must have one unit; its name says {own.name}, the file {unit}:"
            f" state the right one with --column {stem}_{unit}={column} or --column {column}={column}."
        )
    return column if own and quantity(stem) else f"{column}_{unit}"


def still_missing(
    known: Mapping[str, Foreign],
    found: Sequence[str],
    wanted: Mapping[str, Foreign],
    units: Mapping[str, str],
    where: str,
) -> dict[str, Foreign]:
    """Return those columns of an earlier mapping that a file has and nothing else gives.

    `found`, `units`, `where`: as in `bind`; `wanted`: what was mapped for this file. Raises `InputError`
    where the file states another unit than the mapping, which was made for another file.
    """
    given = {_stem(ours) for ours in wanted} | {_stem(column) for column in found}
    used = {foreign.name for foreign in wanted.values()}
    again = {
        ours: foreign
        for ours, foreign in known.items()
        if foreign.name in found
        and foreign.name not in used
        and (_stem(ours) not in given or _stem(ours) == _stem(foreign.name))
        and (ours == RUN or split_unit(ours)[1] or foreign.name in units)
    }
    for ours, foreign in again.items():
        own, unit = split_unit(ours)[1], units.get(foreign.name)
        if own and unit and UNITS[unit] != own:
            raise InputError(
                f"Column '{foreign.name}' of {where} is in {unit} by its header; in the calibration's log"
                f" it was in {own.name}: say which it is with --column {_stem(ours)}_{unit}={foreign.name}."
            )
    return again


def _stem(column: str) -> str:
    return split_unit(column)[0]


def _binding(
    ours: str, foreign: Foreign, where: str, counts_per_turn: float | None, asked: str = ""
) -> Binding:
    if ours == RUN:
        return Binding(RUN, foreign, asked=asked)
    unit, (stem, _), counts = require_unit(ours), split_unit(ours), None
    name, factor, zero = si_name(ours), unit.factor, unit.offset
    if unit.si == "count" and "rad" in quantity(stem):
        counts = foreign.counts_per_turn or counts_per_turn
        if counts is None:
            raise InputError(
                f"Column '{foreign.name}' of {where} is an angle in counts; say how many make a turn with "
                f"--column {ours}={foreign.name},counts_per_turn=16384 (14 bits), or in the column file or "
                "meta.json."
            )
        name, factor, asked = f"{stem}_rad", 2 * math.pi / counts, asked or ours
    scale, offset = factor * (foreign.sign * foreign.scale), factor * foreign.offset + zero
    return Binding(name, structs.replace(foreign, counts_per_turn=counts), scale, offset, asked)


def _add(bindings: dict[str, Binding], new: Binding, where: str) -> None:
    if new.name in bindings:
        raise InputError(
            f"{where} gives {new.name} twice, by '{bindings[new.name].source}' and '{new.source}';"
            " map the one you mean with --column."
        )
    bindings[new.name] = new


_FORM = 'write it as "Name" or {name = "Name", sign = -1, scale = 1.0, offset = 0.0}'


def _foreign(ours: str, entry: Any, where: str) -> Foreign:
    if ours != RUN and not (quantity(ours) and split_unit(ours)[1] is None):  # the file may state the unit
        require_unit(ours)
    entry = {"name": entry} if isinstance(entry, str) else entry
    found = structured(entry, Foreign, f"entry {ours} of {where}", _FORM)
    if not (0 < abs(found.scale) <= MOST_NUMBER and abs(found.offset) <= MOST_NUMBER):
        raise InputError(
            f"Entry {ours} of {where} must have a finite scale other than zero, and a finite offset; {_FORM}."
        )
    return found


def _whole(raw: Array, source: str) -> Array:
    values = np.asarray(raw)
    wrong = (values < -MOST_RUN) | (values > MOST_RUN)
    if values.dtype.kind not in "iu":
        wrong = ~(np.abs(values) < MOST_RUN) | (values != np.floor(values))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"Column '{source}' must hold whole run numbers up to 2^53; row {row} holds {values[row]}."
        )
    return values.astype(np.int64, copy=False)


MOST_RUN = 2**53
"""Beyond it neighbouring whole numbers are one double, so that two runs would become one."""
MOST_RUNS = 1_000_000
"""Runs that a range of run numbers may hold: more than any campaign has."""


def read_runs(text: str, what: str) -> tuple[int, ...]:
    """Return the runs of `2,7,12` or `40-45`; `what` names the text in errors.

    >>> read_runs("3,5,7-9", "--holdout")
    (3, 5, 7, 8, 9)
    """
    runs: list[int] = []
    try:
        for part in filter(None, text.split(",")):
            first, _, last = part.strip().partition("-")
            low, high = int(first), int(last or first)
            if not low <= high <= min(low + MOST_RUNS, MOST_RUN):
                raise ValueError(part)
            runs += range(low, high + 1)
    except ValueError:
        wanted = f"run numbers such as 2,7,12 or 40-45, {MOST_RUNS} in a row at most"
        raise InputError(f"{what} must be {wanted}; instead received {text!r}.") from None
    return tuple(runs)


def in_a_row(runs: Sequence[int]) -> list[list[int]]:
    """Return run numbers in groups of neighbours.

    >>> in_a_row([3, 5, 9, 8])
    [[3], [5], [8, 9]]
    """
    numbered = groupby(enumerate(sorted(runs)), key=lambda entry: entry[1] - entry[0])
    return [[run for _, run in group] for _, group in numbered]


def run_list(runs: Sequence[int]) -> str:
    """Return runs as `--holdout` takes them.

    >>> run_list([3, 5, 7, 8, 9])
    '3,5,7-9'
    """
    return ",".join(str(p[0]) if len(p) == 1 else f"{p[0]}-{p[-1]}" for p in in_a_row(runs))


@dataclass(frozen=True)
class Limit:
    """Columns that fit `pattern` span at most `span` and stay below `level`; else their unit is another.

    `instead` holds the units it could be, large to small. A usual log spans less than `likely`.
    """

    pattern: str
    span: float
    what: str
    instead: tuple[str, ...]
    likely: float
    level: float = math.inf

    @property
    def si(self) -> str:
        """The SI unit of the columns."""
        return UNITS[self.instead[0]].si


LIMITS = (
    Limit(r"(hall_\w+|[xyz](_ref)?)_m", 1.0, "a machine travels", ("mm", "um", "nm"), 0.01, 1e3),
    Limit(r"r[xyz](_ref)?_rad", 0.5, "a machine turns", ("mrad", "urad", "nrad"), 0.01, 1e3),
    Limit(r"([xy]\d+_)?(col|row|v|hall)_\w+_v", 1e3, "a sensor puts out", ("mv", "uv"), 10.0),
    Limit(r"hall_\w+_t", 100.0, "a magnet makes", ("mt", "ut"), 3.0),
    Limit(r"current\w*_a", 1e3, "a coil carries", ("ma",), 100.0),
    Limit("t_s", 1e9, "a recording lasts", ("ms", "us", "ns"), 1e6),
    Limit(r"temperature\w*_degc", 500.0, "a machine warms", ("k",), 200.0, 200.0),
)

_READING = re.compile(r"([xy]\d+_)?(hall|col|row|v)_\w+_(m|v|t|count)|hall\d+_(v|t|count)|angle_rad")
_REFERENCE = re.compile(r"([xyz]|r[xyz]|angle)_ref_(m|rad)")
_POSE = re.compile(r"(z|r[xy])_(m|rad)")


@cache
def is_reading(column: str) -> bool:
    """Say whether a column is a sensor's reading (`hall_a_m`, `col_3_v`, `v_sin_v`, `angle_rad`)."""
    return bool(_READING.fullmatch(column))


@cache
def is_reference(column: str) -> bool:
    """Say whether a column is a reference of motion (`x_ref_m`, `angle_ref_rad`)."""
    return bool(_REFERENCE.fullmatch(column))


@cache
def is_moving(column: str) -> bool:
    """Say whether a column follows the motion sample by sample: readings, references, vertical pose."""
    return is_reading(column) or is_reference(column) or bool(_POSE.fullmatch(column))


def is_ours(column: str) -> bool:
    """Say whether the name of a column is one of ours, so that it is meant for no other."""
    return is_moving(column) or bool(quantity(split_unit(column)[0]))


def limit_of(column: str) -> Limit | None:
    """Return the limit of a column's span, if there is one."""
    return next((limit for limit in LIMITS if re.fullmatch(limit.pattern, column)), None)


# -- names with units, as headers have them ----------------------------------------------------------------

_WORDS = {
    "°": "deg", "º": "deg", "degree": "deg", "degrees": "deg", "grad": "", "°c": "degc", "celsius": "degc",
    "deg c": "degc", "sec": "s", "msec": "ms", "usec": "us", "micron": "um", "microns": "um", "amp": "a",
    "vdc": "v", "v dc": "v", "volt dc": "v", "gs": "gauss", "in": "inch", "inches": "inch",
    "kelvin": "k", "rad/s": "rad_s", "°/s": "deg_s", "deg/s": "deg_s", "1/min": "rpm", "u/min": "rpm",
    "min-1": "rpm", "r/min": "rpm", "m/s": "m_s", "mm/s": "mm_s", "counts": "count", "cts": "count",
    "inc": "count", "lsb": "count", "digit": "count", "digits": "count", '"': "arcsec", "″": "arcsec",
    "''": "arcsec", "arcseconds": "arcsec", "′": "arcmin", "arcminutes": "arcmin", "turn": "rev",
    "turns": "rev", "umdr": "rev", "gon": "grad", "°f": "degf", "f": "degf",
    **{f"{prefix}{word}{end}": unit
       for word, si in {"meter": "m", "metre": "m", "radian": "rad", "second": "s", "volt": "v",
                        "ampere": "a", "tesla": "t"}.items()
       for prefix, letter in {"": "", "centi": "c", "milli": "m", "micro": "u", "nano": "n"}.items()
       for end in ("", "s") if (unit := letter + si) in UNITS},
}  # fmt: skip
_EXACT = {u.symbol: u.name for u in UNITS.values() if u.symbol != u.name == u.symbol.lower() != "degc"}
"""Units in which a capital letter is another size: mV is not MV."""
_ANY_CASE = set(UNITS) - {unit for unit in _EXACT.values() if len(unit) > 1} - {"k", "t"}
UNITS_AS_WRITTEN = frozenset({*_WORDS, *_EXACT, *_ANY_CASE})
NO_UNIT = ("", "-", "--", "1", "[]", "[-]", "()", "(-)", "n/a", "none", "#", "[1]")
"""What a row of units says of a column without one."""
LONGEST_UNIT = 12
"""Characters of a unit that is not known."""
_BRACKETS = re.compile(r"(.*?)[\s_]*[\[({<]\s*([^\])}>]*?)\s*[\])}>]")
_BEHIND = (
    re.compile(r"([^/]*[^/\s])\s*/\s*(\S+?(?:/\S+)?)"),
    re.compile(r"(?:(.*\S)\s+)?in\s+(\S+)"),
    re.compile(r"(.*\S),\s*(\S+)"),
    re.compile(r"(.*\S)_([µμ°]\S*)"),
    re.compile(r"(.*\w)\.+(\w+)\."),  # brackets as R writes them
)


_PROGRAMS = {"X_Value": ("t", "s"), "millis": ("t", "ms"), "micros": ("t", "us")}
"""Names of the time, whatever is recorded: of LabVIEW's measurement files, of functions of Arduino."""
_PLAIN = re.compile(r"(.*\S)\s+(\S+)")
_SURE = {
    "um", "nm", "mm", "urad", "mrad", "nrad", "deg", "mdeg", "arcmin", "arcsec", "ms", "us", "mv", "uv", "mt",
    "ut", "rpm", "degc",
}  # fmt: skip
"""Units that are no words: x um is x in micrometres, Hall A and y min are names."""


def unit_of(text: str) -> str | None:
    """Return hallsym's name of a unit as people write it; None for what is none.

    >>> unit_of("[µm]"), unit_of("°"), unit_of("mV"), unit_of("MV")
    ('um', 'deg', 'mv', None)
    """
    plain = unicodedata.normalize("NFKC", text).strip().replace("μ", "u").replace("º", "°")
    plain = re.sub(r"(?i)(?:(?:unit|einheit)s?[:=]|\b(?:in|utc|unix)\b(?= *\w)) *| since .*", "", plain)
    plain = re.sub(r"^[\[({<](.*)[\])}>]$", r"\1", plain).strip()
    if plain in _EXACT:
        return _EXACT[plain]
    folded = plain.lower()
    if folded in _WORDS:
        return _WORDS[folded] or None
    return folded if folded in _ANY_CASE or (plain in UNITS and plain not in "kt") else None


def split_header(text: str) -> tuple[str, str | None]:
    """Return name and unit of a header's cell; the unit is None where none stands in it.

    >>> split_header("x_ref [µm]"), split_header("Hall A / mV"), split_header("Hall(1)")
    (('x_ref', 'um'), ('Hall A', 'mv'), ('Hall(1)', None))
    """
    if text in _PROGRAMS:
        return _PROGRAMS[text]
    match = _BRACKETS.fullmatch(text)
    if match and match[1]:
        unit = unit_of(match[2])
        index = match[2].isdigit() and text[len(match[1])] in "[("  # of an array: Hall(1)
        if unit or (match[2].lower() in NO_UNIT and not index):
            return match[1], unit
        return text, None
    for pattern in _BEHIND:
        match = pattern.fullmatch(text)
        unit = unit_of(match[2]) if match else None
        if match and unit:
            return match[1] or text, unit
    plain = _PLAIN.fullmatch(text)
    if plain and unit_of(plain[2]) in _SURE:
        return plain[1], unit_of(plain[2])
    return text, None


_AGAIN = re.compile(r"(.+)\.\d+")
"""A name that pandas has numbered, since another column has it too."""


def stems_of(
    texts: Sequence[str], stated: Sequence[str | None] = (), where: str = ""
) -> dict[str, tuple[str, str | None]]:
    """Return headers' own texts and units by their names without unit, or by the text where two are equal.

    `stated`: units that the file states elsewhere. Columns of one name are numbered. `where`: a file whose
    names may be wrong: refuse a column of ours that is there twice, and a column with two units.
    """
    texts = [text or f"(column {k})" for k, text in enumerate(texts, 1)]
    same = Counter(texts)
    bare = [m[1] if (m := _AGAIN.fullmatch(text)) and m[1] in texts else text for text in texts]
    groups, times, seen = Counter(text.rpartition("/")[0] for text in bare), Counter(bare), Counter[str]()
    parts = []
    for k, text in enumerate(bare):
        before, _, last = text.rpartition("/")
        group = f"{before}/" if before and groups[before] > 1 else ""  # then it is a group of channels
        stem, unit = split_header(last if group else text)
        if where and times[text] > 1 and (text == "run" or split_unit(text)[1]):
            raise InputError(f"Column names of {where} must differ; '{text}' stands there twice: rename one.")
        seen[text] += 1
        number = f" {seen[text]}" if same[texts[k]] > 1 else ""  # pandas has numbered others
        texts[k] += number
        other = stated[k] if k < len(stated) else None
        if where and unit and other and unit != other:
            raise InputError(
                f"The unit of column '{group}{stem}' of {where} must be one; the names say {unit}, the line"
                f" below {other}."
            )
        parts.append((f"{group}{stem}{number}", other or unit))
    often = Counter(stem for stem, _ in parts)
    return {
        stem if often[stem] == 1 else text: (text, unit)
        for text, (stem, unit) in zip(texts, parts, strict=True)
    }
