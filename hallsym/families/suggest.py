"""Which column of a file could be which of ours: by its name, its unit, and by what the data do.

A suggestion is written for a person to confirm; nothing of it is applied.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from unicodedata import normalize

import numpy as np

from hallsym.errors import InputError
from hallsym.families import FAMILIES, build, default_model, family_called
from hallsym.log import Meta
from hallsym.log.columns import RUN_WORDS, TIME_WORDS, UNNAMED, WORDS, limit_of, numbers_runs, unit_of
from hallsym.log.table import SHOWN_ROWS, Source
from hallsym.model import Model
from hallsym.output import printable, toml_text
from hallsym.units import UNITS, Array, quantity, si_name, split_unit

REF, READING, RUN, TIME, ANGLE = "ref", "reading", "run", "t", "angle"
_SAME: dict[str, tuple[str, ...]] = {
    REF: (
        "ref", "reference", "if", "ifm", "interferometer", "interf", "laser", "true", "cnc", "truth",
        "actual", "referenz", "ist", "autocollimator", "激光", "参考", "干涉仪", "レーザー", "干渉計",
    ),
    READING: ("hall", "sensor", "probe", "hs", "ch", "channel", "adc", "sonde", "霍尔", "ホール"),
    RUN: RUN_WORDS,
    TIME: TIME_WORDS,
    ANGLE: ("angle", "theta", "phi", "winkel", "rotation", "rot", "角度"),
    "sin": ("sin", "sine", "sinus"),
    "cos": ("cos", "cosine", "cosinus", "kosinus"),
    "rx": ("rx", "roll", "tiltx", "wank", "roulis"),
    "ry": ("ry", "pitch", "tilty", "nick", "tangage"),
    "rz": ("rz", "yaw", "gier"),
    "z": ("z", "height", "gap", "hoehe", "hohe", "hauteur", "luftspalt", "高度", "气隙", "高さ"),
    "col": ("col", "column"),
    "temperature": ("temperature", "temp", "temperatur"),
    "current": ("current", "strom"),
    "speed": ("speed", "velocity", "rpm"),
}  # fmt: skip
_WORDS = {word: token for token, words in _SAME.items() for word in words}
_IDLE = {"v", "pos", "position", "value", "signal", "raw", "data", "meas", "stage", "out", "val", "the", "of"}
"""Words that tell nothing."""
FULL, MORE, NUMBERED, BARE = 1.0, 0.9, 0.8, 0.5
"""Likeness of names: the same words; further words; a number for a letter; all but the word that the unit,
or the other columns, tell: of a reference, of an angle."""
_FURTHER = 0.05
"""What each further word takes."""


@cache
def words_of(name: str, *, unit: bool = False) -> frozenset[str]:
    """Return the words of a name in ours: "IFM_X" -> {"ref", "x"}. `unit`: its last word may be one.

    >>> sorted(words_of("IFM_X")), sorted(words_of("HallA_um", unit=True)), sorted(words_of("ThetaZ"))
    (['ref', 'x'], ['a', 'reading'], ['rz'])
    """
    plain = normalize("NFC", re.sub("[\u0300-\u036f]", "", normalize("NFKD", name)))  # without accents
    odd = WORDS.findall((behind := _odd(plain)).lower())
    if len(odd) == 1 < len(odd[0]) and odd[0] not in _WORDS:  # a unit that nobody knows tells nothing
        plain = plain[: -len(behind) - 2]
    found = [word for part in WORDS.findall(plain) for word in _apart(part.lower())]
    if unit and len(found) > 1 and found[-1] in UNITS and len(found[-1]) > 1:
        found = found[:-1]
    words = {_WORDS.get(word, word) for word in found if not word.isdecimal()} - _IDLE
    words |= {numbers} if (numbers := "_".join(filter(str.isdecimal, found))) else {*()}
    for axis in "xyz":
        if axis in words and words & {ANGLE, "tilt"}:
            words = words - {ANGLE, "tilt", axis} | {f"r{axis}"}
    return frozenset(words)


def _odd(name: str) -> str:
    """Return what stands in brackets behind a name, where a unit would stand."""
    behind = re.search(r".[(\[{<](.*\D.*)[)\]}>]$", name)
    return behind[1] if behind else ""


_NUMBER = r"(?P<size>\d+[.,]?\d*(?:[eE][-+]?\d+)?) ?(?P<unit>[^\W\d]+)"
_SIZES = (
    re.compile(rf"\b1 ?(?P<per>[^\W\d]+) ?= ?{_NUMBER}"),
    re.compile(rf"{_NUMBER} ?(?:/|per) ?(?P<per>[^\W\d]+)"),
)


def _sizes_in(facts: Mapping[str, str]) -> list[tuple[float, str, str]]:
    """Return what lines of a header state of counts and fringes: a number, its unit, of which one.

    >>> _sizes_in({"ADC": "16 bit, 1 LSB = 76.3 uV", "Laser": "158.2 nm/fringe"})
    [(76.3, 'uv', 'count'), (158.2, 'nm', 'fringe')]
    """
    found = [m for fact in facts.items() for form in _SIZES if (m := form.search(" = ".join(fact)))]
    return [
        (float(m["size"].replace(",", ".")), unit, unit_of(m["per"]) or m["per"].lower().rstrip("s"))
        for m in found
        if (unit := unit_of(m["unit"]))
    ]


def _apart(word: str) -> tuple[str, ...]:
    """Return the words of one that is written with its axis or channel: xlaser, halla, rzref."""
    axis = r"(r[xyz]|[abcxyz])"
    found = re.fullmatch(f"{axis}(..+)", word) or re.fullmatch(f"(..+?){axis}", word)
    parts = found.groups() if found and word not in _WORDS else ()
    return parts if {_WORDS.get(part) for part in parts if len(part) > 2} & {REF, READING} else (word,)


_KINDS = frozenset({REF, READING, "col"})
"""Words of names that say what numbered columns are."""


def series_of(names: Iterable[str]) -> list[dict[str, int]]:
    """Return the sets of names that differ in a number alone, with the place of each name in its set.

    A name without the number is the first of them, as pandas numbers columns of one name. Numbers are missing
    only where a word says that they are readings or references.

    >>> series_of(["S1", "S2", "S3", "t", "x_ref", "Hall", "Hall.1"])
    [{'S1': 0, 'S2': 1, 'S3': 2}, {'Hall': 0, 'Hall.1': 1}]
    """
    found: dict[str, dict[int, str]] = {}
    for name in names:
        numbers = re.findall(r"\d+", name)
        words = words_of(name, unit=True) - set(numbers)
        if len(numbers) <= 1 and not UNNAMED.fullmatch(name) and not words & (set(_WORDS.values()) - _KINDS):
            stem = re.sub(r"\W*\d+", "", name)
            found.setdefault(stem, {}).setdefault(int(numbers[0]) if numbers else 0, name)
    several = [
        each for stem, each in found.items()
        if 1 < len(each) == max(each) - min(each) + 1 or (len(each) > 1 and words_of(stem) & _KINDS)
    ]  # fmt: skip
    return [{each[number]: place for place, number in enumerate(sorted(each))} for each in several]


def _places(sets: Sequence[Mapping[str, int]], model: Model) -> dict[str, str]:
    """Return the stems of numbered names of a file: a set is as large as one of channels, references, state.

    Or as all of these that have one unit. A set whose words say that it is references, or readings, is no
    other; one without such words is taken where it fits one place alone, and no other set does. Of sine and
    cosine the first is not known.
    """
    kinds = [model.channels, model.references, _measured(model)]
    one_set = len({re.sub(r"(?<![a-z])[a-z]$|\d+", "", split_unit(c)[0]) for c in model.channels}) == 1
    free = {
        (k, tuple(split_unit(c)[0] for c in own if c.endswith(si)))
        for k, of in enumerate(kinds) for own in [of] if k or one_set
        for si in ("", *(f"_{c.rpartition('_')[2]}" for c in own))
    }  # fmt: skip
    found = dict[str, str]()
    words = [frozenset().union(*map(words_of, each)) & _KINDS for each in sets]
    for each, own in sorted(zip(sets, words, strict=True), key=lambda pair: not pair[1]):
        alike = [len(each) == len(other) for other, said in zip(sets, words, strict=True) if said == own]
        wanted = {1} if REF in own else {0} if own else {0, 1, 2} if sum(alike) == 1 else ()
        places = [of for k, of in free if k in wanted and len(of) == len(each)]
        if len(places) == 1:
            found |= {name: places[0][k] for name, k in each.items()}
            free = {(k, of) for k, of in free if {*of}.isdisjoint(places[0])}
    return found


def likeness(ours: str, theirs: str) -> float:
    """Return how well a name fits one of our stems, in [0, 1]; 0 where it does not."""
    wanted, found = words_of(ours), words_of(theirs, unit=True)
    if wanted == found:
        return FULL
    if wanted < found:
        return MORE - _FURTHER * len(found - wanted)
    recognised = ({REF}, {ANGLE})  # by the other columns, by the unit
    return BARE if found and any(word <= wanted and wanted - word == found for word in recognised) else 0.0


STATED, BY_SIZE = "its unit is stated", "CHECK THE UNIT: assumed from its size"
MOVES = 0.9
"""Correlation from which a column moves as another one does: the other axes and the noise make the rest."""
BITS = range(6, 25)
"""Bits of an encoder's turn that are tried."""
MOST_COLUMNS = 100
"""Columns of a file of which each is tried as the reference, and readings of a model by their number."""
TRIED = 2000
"""Samples with which references are tried: a share of variance is known to 3 %."""
PLACES = 24
"""Places of the zero of an angle that are tried: between two of them a correlation loses 1 %."""
NEAR = 3.0
"""Ratio of sizes up to which a unit fits: gains and nominal values are not exact."""
OTHERS = ("temperature", "current", "speed")
MOMENTS = 1e9
"""Whole numbers from which times count from 1970: in s this century, in shorter units any in use."""
CLOCKS_HZ = (1.0, 2e4)
"""Rates that loggers of positions record at: a time whose ticks could be ms or s is asked about."""
MOTIONS = {"m": ("m", "mm", "um", "nm"), "rad": ("rad", "deg", "mrad", "urad", "nrad")}
"""Units in which motion is recorded, by SI unit."""
LEAST_MOTION = 1e-8
"""Motion that sensors and references resolve: 10 nm, 10 nrad. A unit in which a column moves less is none."""
WRAPPED = 0.95
"""Share of a turn from which on a column up to a turn is one that begins again."""
COUNTS = "counts"
COUNTED = 256
"""Whole numbers over at least this range, those of eight bits, may be counts of a converter."""


@dataclass(frozen=True)
class Guess:
    """Our stem for a column of the file, the units it may have, and what speaks for it.

    `units`: one where it is known or can be assumed, several where somebody must choose, none where nothing
    tells. `raw`: what the values are where they need a scale, such as counts. `scale`: one that serves, where
    only ratios count; of a turn in `raw` values nearly that, to see what follows it.
    """

    stem: str
    theirs: str
    units: tuple[str, ...]
    why: str
    sign: int = 1
    counts_per_turn: int | None = None
    raw: str = ""
    scale: float | None = None

    @property
    def unit(self) -> str:
        """The unit; "" where it is open."""
        return self.units[0] if len(self.units) == 1 and (self.scale or not self.raw) else ""

    @property
    def open(self) -> bool:
        """Whether somebody must choose."""
        return (bool(self.raw) or not self.unit) and self.stem != RUN

    def in_units(self, *units: str, said: str, turn: int | None = None, raw: str = "") -> Guess:
        """Return the guess with units, what is said for them, and counts per turn."""
        return replace(self, units=units, why=f"{self.why}; {said}", counts_per_turn=turn, raw=raw)

    @property
    def lines(self) -> list[str]:
        """The lines of a column file; comments where somebody must choose."""
        name = toml_text(self.theirs)
        more = ", sign = -1" if self.sign < 0 else ""
        more += f", counts_per_turn = {self.counts_per_turn}" if self.counts_per_turn else ""
        more += f", scale = {self.scale!r}" if self.scale and not self.raw else ""
        names = [RUN] if self.stem == RUN else [f"{self.stem}_{u}" for u in self.units or ("UNIT",)]
        entries = [f"{ours} = {{ name = {name}{more} }}" if more else f"{ours} = {name}" for ours in names]
        if self.raw:
            scaled = f"{names[0]} = {{ name = {name}{more}, scale = 1.0, offset = 0.0 }}"
            entries = [*(entries if self.raw == COUNTS else ()), scaled]
        return [f"{'# ' if self.open else ''}{entry}" for entry in entries]

    @property
    def ours(self) -> str:
        """Our name, with the first of the units."""
        return f"{self.stem}_{self.units[0]}" if self.units else self.stem

    @property
    def as_it_is(self) -> bool:
        """Whether the file's own name says it all."""
        return self.theirs == (RUN if self.stem == RUN else f"{self.stem}_{self.unit}") and self.sign > 0


@dataclass(frozen=True)
class Suggestion:
    """Guesses for a file and the model they are for; `rest`: columns that nothing is known of."""

    model: Model
    guesses: tuple[Guess, ...]
    rest: tuple[str, ...]

    @property
    def open(self) -> tuple[str, ...]:
        """Our names of columns of the model whose unit or scale somebody must choose."""
        return tuple(g.stem for g in self.guesses if g.open and g.stem not in OTHERS)

    @property
    def recognised(self) -> bool:
        """Whether anything in the file is like a column of the model."""
        return any(g.stem in _stems(self.model) for g in self.guesses)

    @property
    def lacking(self) -> tuple[str, ...]:
        """Columns of the model that no column of the file is like."""
        known = {g.stem for g in self.guesses}
        return tuple(
            c for c in (*self.model.channels, *self.model.references) if split_unit(c)[0] not in known
        )

    @property
    def by_columns(self) -> bool:
        """Whether the columns alone lead to a model of this family."""
        columns = tuple(si_name(g.ours) for g in self.guesses)
        try:
            return family_called(default_model(Meta(columns=columns))) is self.model.family
        except InputError:
            return False

    def to_toml(self, log: str) -> str:
        """Return the column file, each line with what speaks for it."""
        rows = [(line, g.why) for g in self.guesses if not g.as_it_is for line in g.lines]
        width = max((len(line) for line, _ in rows), default=0)
        lines = [f"{line.ljust(width)}  # {printable(why)}" for line, why in rows]
        own = [g.theirs for g in self.guesses if g.as_it_is]
        lines += [f"# read as they are: {printable(', '.join(own))}"] if own else []
        lines += [f"# not used: {', '.join(map(repr, self.rest))}"] if self.rest else []
        head = [
            f"# For {printable(log)}, as {self.model.name} needs it. Check every line.",
        ]
        if any(line.startswith("#") for line, _ in rows):
            choose = "remove the # of the right one: nothing in the file tells which"
            head.append(f"# Of lines that begin with #, {choose}.")
        return "\n".join([*head, "", "[columns]", *lines, ""])


def suggest(source: Source, model: str | None = None, meta: Meta | None = None) -> Suggestion:
    """Return the best guess for each column of a file.

    `model`: what it is for, else that of `meta`, what a folder says of its log, else what its columns fit.
    Raises `InputError` for a file without a column of numbers.
    """
    data = _numbers(source)
    if not data:
        source.read(source.names[-1:])  # where a line is at fault, it is named
        raise InputError("No column of the file holds numbers; nothing can be suggested.")
    runs, named = source.run_column()
    data.pop(runs if named else "", None)
    forms = _models(source, data, model, meta or Meta())
    tried = [(form, _guesses(source, data, form)) for form in forms]
    moving = {name for name, values in data.items() if np.ptp(values[np.isfinite(values)]) > 0}
    chosen, guesses = max(tried, key=lambda one: _covered(one[0], one[1], moving))
    guesses += _by_rest(source, {n: data[n] for n in moving}, chosen, guesses)
    order = {stem: k for k, stem in enumerate((RUN, TIME, *_stems(chosen), *OTHERS))}
    used = {g.theirs for g in guesses}
    if runs := runs if named else source.run_column(used)[0]:
        guesses.append(Guess(RUN, runs, (), "its name" if named else "its data"))
        used.add(runs)
    return Suggestion(
        chosen,
        tuple(sorted(guesses, key=lambda g: order[g.stem])),
        tuple(name for name in source.names if name not in used),
    )


def _guesses(source: Source, data: Mapping[str, Array], model: Model) -> list[Guess]:
    """Return the guesses for a model: by name, by what the references let its readings do."""
    named = _by_readings(source, data, model, _by_name(source, data, model))
    expected = _expected(data, model, named)
    named = [
        _with_unit(source, data[g.theirs], replace(g, why="its name"), model, expected[g.stem])
        if g.stem in expected and g.open and not g.raw and np.ptp(expected[g.stem]) > 0
        else g
        for g in named
    ]
    return [*named, *_by_motion(source, data, model, named, expected)]


def _by_rest(source: Source, data: Mapping[str, Array], model: Model, known: Sequence[Guess]) -> list[Guess]:
    """Return guesses for references of which one of a unit is lacking, as one column of that unit is left."""
    stems, used = {g.stem for g in known}, {g.theirs for g in known}
    lacking = [c for c in model.references if split_unit(c)[0] not in stems and not _goes_round(c)]
    free = {n: UNITS[u].si for n in data if not (n in used or _own(n)) and (u := _stated(source, n))}
    pairs = (
        ([c for c in lacking if c.endswith(f"_{si}")], [n for n in free if free[n] == si]) for si in MOTIONS
    )
    return [
        _with_unit(
            source, data[n], Guess(split_unit(c)[0], n, (), "no other column left has its unit"), model
        )
        for ours, theirs in pairs
        if len(lacking) < len(model.references) and len(ours) == len(theirs) == 1
        for c, n in zip(ours, theirs, strict=True)
    ]


def _expected(data: Mapping[str, Array], model: Model, named: Sequence[Guess]) -> dict[str, Array]:
    """Return what the nominal machine would read where the references say it is; {} where none is known.

    The zero of an angle that goes round is its own: of `PLACES` over the turn the one where most of the
    columns that are not named move as a reading.
    """
    known = _known(data, named)
    if not any(split_unit(c)[0] in known for c in model.references):
        return {}
    angles = [s for c in model.references if (s := split_unit(c)[0]) in known and _goes_round(c)]
    free = [x for name, x in data.items() if name not in {g.theirs for g in named} and np.ptp(x) > 0]
    if not angles or not free:
        return _readings(model, known)
    starts = np.arange(PLACES) * 2 * np.pi / PLACES
    tried = [_readings(model, {**known, **{s: known[s] + zero for s in angles}}) for zero in starts]
    with np.errstate(invalid="ignore", divide="ignore"):
        r = [np.corrcoef(np.vstack([*e.values(), *free]))[: len(e), len(e) :] for e in tried]
    return tried[int(np.argmax([np.nan_to_num(own).max(axis=1).sum() for own in r]))]


def _known(data: Mapping[str, Array], named: Sequence[Guess]) -> dict[str, Array]:
    """Return the columns of the file that have a unit, in SI units by our stems."""
    return {g.stem: _si(data[g.theirs], g) for g in named if g.unit and g.stem != RUN}


def _goes_round(column: str) -> bool:
    return column.endswith("_rad") and limit_of(column) is None


def _covered(model: Model, guesses: Sequence[Guess], moving: Collection[str]) -> tuple[float, int]:
    """Return the share of the columns of a model, and of those of a file that move, that go together.

    And how many of them have a unit in which the model takes them.
    """
    stems = _stems(model)
    rest = set(moving) - {g.theirs for g in guesses}
    share = len({g.stem for g in guesses} & set(stems)) / (len(stems) + len(rest))
    return share, sum(not g.raw for g in guesses)


def _numbers(source: Source) -> dict[str, Array]:
    """Return the first samples of the columns that hold numbers."""
    found = {name: np.asarray(values, float) for name, values in source.numbers(most=SHOWN_ROWS).items()}
    return {name: values for name, values in found.items() if np.isfinite(values).any()}


def _stems(model: Model) -> list[str]:
    return [split_unit(c)[0] for c in (*model.channels, *_measured(model), *model.references)]


def _measured(model: Model) -> tuple[str, ...]:
    computed = {c.name for c in model.computed}
    return tuple(c for c in model.state if c not in computed)


def _models(source: Source, data: Mapping[str, Array], name: str | None, meta: Meta) -> list[Model]:
    """Return the forms of models whose columns a file may have.

    A model is read by its channels, as its pose is read, as columns of ours say, or by as many readings as
    there are numbered columns.
    """
    own = tuple(si_name(n) for n in source.names if _own(n))
    sets = [each for each in _series(data) if len(each) <= MOST_COLUMNS]
    sets = [each for each in sets if words_of(next(iter(each))) & _KINDS or _overlap([data[n] for n in each])]
    kinds = [{UNITS[u].si for n in each if (u := _stated(source, n))} for each in sets]
    stated, found = name or meta.base_model, list[Model]()
    for default in [stated] if stated else [family.default for family in FAMILIES]:
        with nullcontext() if stated else suppress(InputError):  # a family that fails and nobody asked for
            found.append(usual := build(default, meta=meta))
            forms = [(*usual.pose, *usual.references), own]
            first, _, unit = usual.channels[0].rpartition("_")
            for each, si in zip(sets, kinds, strict=True):
                ending = unit if len(si) != 1 else next(iter(si))
                forms += [tuple(f"{re.sub('[0-9]+', str(k), first)}_{ending}" for k in range(len(each)))]
            for columns in forms:
                with suppress(InputError):  # not a form of it
                    found.append(build(default, meta=replace(meta, columns=columns)))
    return found


def _series(data: Mapping[str, Array]) -> list[dict[str, int]]:
    """Return the sets of numbered columns (`series_of`) that are neither runs nor times."""
    return series_of(n for n, x in data.items() if not (numbers_runs(x) or _is_clock(x)))


def _overlap(columns: Sequence[Array]) -> bool:
    """Say whether columns move together as readings of one field: in two directions, or in few of many."""
    moving = np.array([x for x in columns if np.isfinite(x).all() and np.ptp(x) > 0])
    largest = np.linalg.eigvalsh(np.corrcoef(moving))[-max(2, len(moving) // 4) :] if len(moving) > 1 else 0.0
    return bool(np.sum(largest) > MOVES**2 * len(moving))


# -- by name ---------------------------------------------------------------------------------------------


def _likeliest(pairs: Iterable[tuple[float, str, str]]) -> list[tuple[float, str, str]]:
    """Return the pairs (how likely, stem, name) with each stem and each name once, the likeliest first."""
    found: list[tuple[float, str, str]] = []
    for pair in sorted(pairs, key=lambda p: -p[0]):
        if all(pair[1] != stem and pair[2] != name for _, stem, name in found):
            found.append(pair)
    return found


def _from_zero(names: Iterable[str], stems: Sequence[str]) -> dict[str, str]:
    """Return names whose numbers count from 0 on in the place of those from 1 on, where ours do.

    >>> _from_zero(["X1 col 1", "X1 col 2"], ["x1_col_0", "x1_col_1"])
    {'X1 col 1': 'X1 col 0', 'X1 col 2': 'X1 col 1'}
    """
    found = {name: name for name in names}
    sets = defaultdict[tuple[str, str], dict[int, str]](dict)
    for name in found:
        for digits in re.finditer(r"\d+", name):
            sets[name[: digits.start()], name[digits.end() :]][int(digits[0])] = name
    for (before, behind), own in sets.items():
        if 1 < len(own) == max(own) and any(likeness(s, f"{before}0{behind}") == FULL for s in stems):
            found |= {name: f"{before}{number - 1}{behind}" for number, name in own.items()}
    return found


def _matched(source: Source, data: Mapping[str, Array], model: Model) -> list[tuple[float, str, str]]:
    """Return how well our stems and the file's names go together (score, stem, name), each once."""
    stems = _stems(model)
    paths = {name: path for path, name in source.aliases.items()}  # Hall/A
    own = {name: o if (o := _own(name)) in (RUN, TIME, *stems, *OTHERS) else "" for name in data}
    series, pairs, called = _places(_series(data), model), [], _from_zero(data, stems)
    for stem in (TIME, *stems, *OTHERS):
        for name, values in data.items():
            if own[name] not in ("", stem, stem.removesuffix("_ref")):
                continue  # a name of ours is not another one of ours
            if stem == TIME and not _is_clock(values):
                continue
            like = max(likeness(stem, called[name]), likeness(stem, paths.get(name, name)))
            fits = _unit_fits(source, name, stem, model)
            if name in series and stem in stems and not own[name]:
                like = NUMBERED if series[name] == stem else 0.0
            if fits or (like > BARE and stem in stems):  # in V or counts it lacks a scale
                pairs.append((like if fits else like / 2, stem, name))
            unit, unnamed = _stated(source, name), not words_of(name, unit=True)
            by_unit = unit == name.lower() if stem == TIME else bool(unit and unnamed)
            # an index or a counter is no time; moments since 1970 are one, and ticks that stand first
            ticks = name == source.names[0] and (np.diff(values) != 1).any()
            index = _whole(values) and values[0] < MOMENTS and not (ticks or unit)
            if fits and (by_unit or (stem == TIME and not index)):
                pairs.append((BARE / 2, stem, name))
    return _likeliest(pair for pair in pairs if pair[0] > 0)


def _by_name(source: Source, data: Mapping[str, Array], model: Model) -> list[Guess]:
    found = []
    for score, stem, name in _matched(source, data, model):
        named = score >= BARE or (words_of(name, unit=True) and stem != TIME)
        why = "its name" if named else "its data" if stem == TIME else "its unit"
        guess = Guess(stem, name, (), why)
        found.append(_with_unit(source, data[name], guess, model))
    return found


def _is_clock(values: Array) -> bool:
    """Say whether values are such as times: they rise by even steps; each may be there twice."""
    if not np.isfinite(values).all() or len(values) < 3:
        return False
    steps = np.diff(values)
    steps = steps[steps != 0] if 2 * (steps == 0).sum() <= len(values) else steps
    usual = np.median(steps)
    return bool(usual > 0 and (np.abs(steps - usual) < 0.5 * usual).mean() > 0.8)


def _whole(values: Array) -> bool:
    return bool((values == np.floor(values)).all())


def _stated(source: Source, name: str) -> str:
    """Return the unit that the file states for a column, in its header or in its name; "" without one."""
    if name in source.units:
        return source.units[name]
    if _own(name):
        unit = split_unit(name)[1]
        return unit.name if unit else ""
    if name.lower() in ("s", "ms", "us", "ns"):
        return name.lower()
    last = name.rpartition("_")[2].lower()
    return last if "_" in name and last in UNITS and (len(last) > 1 or last in "sm") else ""


def _own(name: str) -> str:
    """Return the stem of a name that is one of ours, with its unit; "" for any other."""
    stem, unit = split_unit(name)
    return RUN if name == RUN else stem if unit and quantity(stem) else ""


def _unit_fits(source: Source, name: str, stem: str, model: Model) -> bool:
    """Say whether the unit of a column, where it is stated, is one that the model takes, or counts of it."""
    stated, kinds = _stated(source, name), _kinds(stem, model)
    return not stated or UNITS[stated].si in (*kinds, *("count",) * ("rad" in kinds))


def _kinds(stem: str, model: Model) -> tuple[str, ...]:
    """Return the SI units that the model takes a column in."""
    columns = (*model.channels, *model.state, *model.references)
    return tuple(c.rpartition("_")[2] for c in columns if split_unit(c)[0] == stem) or quantity(stem)


def _with_unit(
    source: Source, values: Array, guess: Guess, model: Model, expected: Array | None = None
) -> Guess:
    """Add the unit that the file states, else those in which the values are as large as they can be.

    `expected`: what the values should be in SI, which decides.
    """
    stated, kinds = _stated(source, guess.theirs), _kinds(guess.stem, model)
    odd = "" if stated else _odd(guess.theirs)
    whole = guess.stem in _stems(model) and _whole(values) and np.ptp(values) >= COUNTED
    if odd or (whole and stated in ("", "count")):
        each = unit_of(odd or "counts") or odd.lower().rstrip("s")
        sizes = {s[:2] for s in _sizes_in(source.facts) if UNITS[s[1]].si in kinds and s[2] == each}
        for size, unit in sizes if len(sizes) == 1 else ():
            said = f"{guess.why}; the file states {size:g} {unit} per {each}"
            return replace(guess, units=(unit,), scale=size, why=said)
    going_round = "rad" in kinds and _goes_round(f"{guess.stem}_rad")
    if going_round and (stated == "count" or (whole and not stated)):
        said = STATED if stated else "whole numbers"
        return guess.in_units(
            "count", said=f"{said}; CHECK THE TURN: assumed from its size", turn=_turn(values)
        )
    if stated and UNITS[stated].si in kinds:
        return guess.in_units(stated, said=STATED)
    units = [UNITS[u] for u in _possible(guess.stem, kinds, values)]
    if whole and not stated and kinds[:1] == ("v",):
        full = _turn(values)
        return replace(
            guess, units=("v",), scale=1 / full, why=f"{guess.why}; counts, 1 V is taken for {full}"
        )
    if going_round and stated:  # an output in proportion to the angle
        span = float(np.nanmax(values) - np.nanmin(values))
        why = f"{guess.why}; state rad per {stated}: its range is {span:.4g} {stated}"
        return replace(guess, units=("rad",), scale=2 * np.pi / span, why=why, raw=stated)
    if stated or whole or (odd and guess.stem in _stems(model)):
        unit = {"m": "um", "rad": "urad"}.get(kinds[0], kinds[0])
        others = [] if stated else [u.name for u in units if u.name != unit]
        said = f"state {unit} per {stated or odd}"
        said = said if stated or odd else f"whole numbers: counts, of so many {unit} each?"
        return guess.in_units(unit, *others, said=said, raw=stated or COUNTS)
    if expected is not None:
        distance = {u.name: abs(np.log(u.factor * np.std(values) / np.std(expected)))
                 for u in UNITS.values() if u.si in kinds[:1]}  # fmt: skip
        best = min(distance, key=lambda u: distance[u], default="")
        if best and distance[best] < np.log(NEAR):
            return guess.in_units(best, said=BY_SIZE)
    said = BY_SIZE if len(units) == 1 else "its unit is not stated"
    return guess.in_units(*(u.name for u in units), said=said)


def _possible(stem: str, kinds: Sequence[str], values: Array) -> list[str]:
    """Return the units in which values are as large as they can be, large to small.

    Of what is no motion, only down to the first that makes them usual.
    """
    known = values[np.isfinite(values)]
    span = float(np.ptp(known))
    if stem == TIME:
        tick = float(np.median(np.diff(known)))
        fits = {u: tick * UNITS[u].factor for u in ("s", "ms", "us", "ns") if tick > 0}
        return [u for u, s in fits.items() if 1 / CLOCKS_HZ[1] <= s <= 1 / CLOCKS_HZ[0]]
    limit = next((limit for si in kinds if (limit := limit_of(f"{stem}_{si}"))), None)
    if limit is None:
        turns = {u.name: 1 / u.factor for u in UNITS.values() if "rad" in kinds and u.name in ("deg", "rad")}
        wrapped = [u for u, rad in turns.items() if WRAPPED <= span / (2 * np.pi * rad) <= 1.001]
        return wrapped or list(turns)
    found = []
    for unit in MOTIONS.get(limit.si, (limit.si, *limit.instead)):
        size, level = span * UNITS[unit].factor, np.abs(known * UNITS[unit].factor + UNITS[unit].offset).max()
        if size <= limit.span and level <= limit.level and (size >= LEAST_MOTION or span == 0):
            found.append(unit)
            if 0 < size <= limit.likely and limit.si not in MOTIONS:
                break
    return found


def _turn(values: Array) -> int:
    return 1 << int(np.nanmax(values) - np.nanmin(values)).bit_length()


# -- by motion -------------------------------------------------------------------------------------------


def _by_motion(
    source: Source,
    data: Mapping[str, Array],
    model: Model,
    named: Sequence[Guess],
    expected: Mapping[str, Array],
) -> list[Guess]:
    """Return guesses for readings that move as they are `expected` to, where the references are known."""
    taken, stems = {g.theirs for g in named}, {g.stem for g in named}
    free = [n for n in data if n not in taken and not _own(n) and np.ptp(data[n]) > 0]
    lacking = [c for c in model.channels if split_unit(c)[0] not in stems and c not in model.period]
    likely = {
        (stem, name): float(np.corrcoef(expected[stem], data[name])[0, 1])
        for stem in (split_unit(c)[0] for c in lacking)
        if stem in expected
        for name in free
        if _unit_fits(source, name, stem, model)
        and np.isfinite(data[name]).all()
        and np.ptp(expected[stem]) > 0
    }
    found = []
    for _, stem, name in _likeliest((abs(r), *pair) for pair, r in likely.items() if abs(r) >= MOVES):
        r = likely[stem, name]
        guess = Guess(stem, name, (), f"moves as {stem} should (r = {r:.3f})", 1 if r > 0 else -1)
        found.append(_with_unit(source, data[name], guess, model, expected[stem]))
    return found


def _by_readings(
    source: Source, data: Mapping[str, Array], model: Model, named: Sequence[Guess]
) -> list[Guess]:
    """Return the guesses with the one reference, unit or counts per turn that the readings follow.

    Only of an angle that goes round: others would be followed in any unit.
    """
    angle = model.references[0] if len(model.references) == 1 else ""
    stem, known = split_unit(angle)[0], [g for g in named if f"{g.stem}_rad" != angle]
    mine = [g for g in named if g not in known]
    sure = mine and not (mine[0].open or mine[0].counts_per_turn)
    if not angle or not _goes_round(angle) or sure or (len(data) > MOST_COLUMNS and not mine):
        return list(named)
    free = [n for n in data if n not in {g.theirs for g in named} and not _own(n) and np.ptp(data[n]) > 0]
    volts = {UNITS[u].si if (u := _stated(source, n)) else "" for n in free} == {"v"}  # of an oscilloscope
    free = [n for n in free if (volts or _unit_fits(source, n, stem, model)) and not numbers_runs(data[n])]
    followed = []
    few = {name: values[:: -(-len(values) // TRIED)] for name, values in data.items()}
    for guess in mine or [_with_unit(source, data[n], Guess(stem, n, (), "its data"), model) for n in free]:
        if guess.counts_per_turn:
            tried = [replace(guess, counts_per_turn=1 << bits) for bits in BITS]
        else:
            tried = [
                replace(guess, units=(u.name,), raw="", scale=None) for u in UNITS.values() if u.si == "rad"
            ]
            tried += [guess] if guess.scale else []
        others = [
            x for name, x in few.items() if name != guess.theirs and np.isfinite(x).all() and np.ptp(x) > 0
        ]
        for one in tried if len(others) >= len(model.channels) else ():
            if np.ptp(_si(data[one.theirs], one)) >= np.pi:
                why = guess.why.partition(";")[0] if mine else "its data"
                said = one if one.scale else replace(one, why=f"{why}; the readings follow it in this unit")
                followed.append((_left_over(_readings(model, _known(few, [*known, one])), others), said))
    (best, found), *worse = sorted([*followed, (1.0, None)], key=lambda one: one[0])
    sure = best <= 1 - MOVES**2 and (not worse or best * NEAR**2 <= worse[0][0])
    return [*known, *([found] if found and sure else mine)]


def _left_over(expected: Mapping[str, Array], columns: Sequence[Array]) -> float:
    """Return the share of variance of finite columns that is no combination of what readings should be.

    It is the largest of as many columns as there are readings, those of which least is left, in [0, 1].
    """
    rows = np.isfinite(list(expected.values())).all(axis=0)
    basis = np.column_stack([np.ones(rows.sum()), *(e[rows] for e in expected.values())])
    own = np.column_stack([values[rows] for values in columns])
    own = own[:, np.ptp(own, axis=0) > 0]
    left = own - basis @ np.linalg.lstsq(basis, own, rcond=None)[0]
    shares = np.sort(np.var(left, axis=0) / np.var(own, axis=0))
    return float(shares[len(expected) - 1]) if len(shares) >= len(expected) else 1.0


def _si(values: Array, guess: Guess) -> Array:
    unit = UNITS[guess.unit]
    factor = 2 * np.pi / guess.counts_per_turn if guess.counts_per_turn else unit.factor
    return np.asarray(factor * (guess.scale or 1.0) * values + unit.offset)


def _readings(model: Model, known: Mapping[str, Array]) -> dict[str, Array]:
    """Return what the nominal machine would read where the references say it is."""
    rows = len(next(iter(known.values())))
    pose = np.array([known.get(split_unit(c)[0], np.zeros(rows)) for c in model.references])
    rest = model.rest
    state = np.array([known.get(split_unit(c)[0], np.full(rows, rest.get(c, 0.0))) for c in model.state])
    offsets = np.zeros((len(model.offsets), 1))
    found = np.asarray(model.reading(model.nominal, offsets, pose, state.reshape(len(model.state), rows)))
    return dict(zip((split_unit(c)[0] for c in model.channels), found, strict=True))
