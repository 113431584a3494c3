"""Which column of a file could be which of ours: by its name, its unit, and by what the data do.

A suggestion is written for a person to confirm; nothing of it is applied.
"""

from __future__ import annotations

import re
import string
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hallsym.errors import InputError
from hallsym.families import FAMILIES, build
from hallsym.log import Meta
from hallsym.log.columns import likely_units, limit_of
from hallsym.log.table import Source
from hallsym.model import Model
from hallsym.output import printable, toml_text
from hallsym.units import UNITS, Array, quantity, si_name, split_unit

REF, READING, RUN, TIME, ANGLE = "ref", "reading", "run", "t", "angle"
_SAME: dict[str, tuple[str, ...]] = {
    REF: ("ref", "reference", "ifm", "interferometer", "interf", "laser", "true", "cnc", "truth", "referenz"),
    READING: ("hall", "sensor", "probe", "hs", "ch", "channel", "adc", "sonde"),
    RUN: ("run", "pass", "scan", "sweep", "trial", "segment", "lauf", "fahrt", "messung", "measurement"),
    TIME: ("t", "time", "timestamp", "zeit", "clock", "elapsed", "temps"),
    ANGLE: ("angle", "theta", "phi", "winkel", "rotation", "rot"),
    "sin": ("sin", "sine", "sinus"),
    "cos": ("cos", "cosine", "cosinus", "kosinus"),
    "rx": ("rx", "roll", "tiltx"),
    "ry": ("ry", "pitch", "tilty"),
    "rz": ("rz", "yaw"),
    "z": ("z", "height", "gap", "hoehe"),
    "col": ("col", "column"),
    "temperature": ("temperature", "temp", "temperatur"),
    "current": ("current", "strom"),
    "speed": ("speed", "velocity", "rpm"),
}
_WORDS = {word: token for token, words in _SAME.items() for word in words}
_SPLIT = re.compile(r"[A-Z]{2,}(?![a-z])|[A-Z]?[a-zäöü]+|[A-Z]|\d+")
_IDLE = {"v", "pos", "position", "value", "signal", "raw", "data", "meas", "stage", "out", "val", "the", "of"}
"""Words that tell nothing."""
FULL, MORE, NUMBERED, BARE = 1.0, 0.9, 0.8, 0.5
"""Likeness of names: the same words; further words; a number for a letter; all but the word that the unit,
or the other columns, tell: of a reference, of an angle."""
_FURTHER = 0.05
"""What each further word takes."""


def words_of(name: str, *, unit: bool = False) -> frozenset[str]:
    """Return the words of a name in ours: "IFM_X" -> {"ref", "x"}. `unit`: its last word may be one.

    >>> sorted(words_of("IFM_X")), sorted(words_of("HallA_um", unit=True)), sorted(words_of("ThetaZ"))
    (['ref', 'x'], ['a', 'reading'], ['rz'])
    """
    found = [part.lower() for part in _SPLIT.findall(name)]
    if unit and len(found) > 1 and found[-1] in UNITS and len(found[-1]) > 1:
        found = found[:-1]
    words = {_WORDS.get(word, word) for word in found} - _IDLE
    for axis in "xyz":
        if {ANGLE, axis} <= words:
            words = words - {ANGLE, axis} | {f"r{axis}"}
    return frozenset(words)


def likeness(ours: str, theirs: str, numbers: tuple[int, ...] = ()) -> float:
    """Return how well a name fits one of our stems, in [0, 1]; 0 where it does not.

    `numbers`: those that the file's names of this kind have, from which a letter is told.
    """
    wanted, found = words_of(ours), words_of(theirs, unit=True)
    if wanted == found:
        return FULL
    if wanted < found:
        return MORE - _FURTHER * len(found - wanted)
    letters = [w for w in wanted if len(w) == 1 and w.isalpha()]
    digits = [w for w in found if w.isdigit()]
    if READING in wanted and letters and digits and numbers:
        place = sorted(numbers).index(int(digits[0])) if int(digits[0]) in numbers else -1
        if string.ascii_lowercase[place] == letters[0] and wanted - set(letters) <= found - set(digits):
            return NUMBERED
    told = ({REF}, {ANGLE})  # by the other columns, by the unit
    return BARE if found and any(word <= wanted and wanted - word == found for word in told) else 0.0


def numbers_of(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the numbers in names of readings: of Hall1, Hall2, Hall3 they are 1, 2, 3."""
    found = [words_of(name, unit=True) for name in names]
    return tuple(sorted({int(w) for words in found if READING in words for w in words if w.isdigit()}))


ROWS = 50_000
"""Samples that are looked at."""
STATED, BY_SIZE = "its unit is stated", "UNIT ONLY BY ITS SIZE"
MOVES = 0.9
"""Correlation from which a column moves as another one does: the other axes and the noise make the rest."""
NEAR = 3.0
"""Ratio of sizes up to which a unit fits: gains and nominal values are not exact."""
OTHERS = ("temperature", "current", "speed")


@dataclass(frozen=True)
class Guess:
    """Our stem for a column of the file, its unit ("" where nothing tells it), and what speaks for it."""

    stem: str
    theirs: str
    unit: str
    why: str
    sign: int = 1
    counts_per_turn: int | None = None

    @property
    def ours(self) -> str:
        """Our name, with the unit."""
        return self.stem if self.stem == RUN else f"{self.stem}_{self.unit or 'UNIT'}"

    def in_unit(self, unit: str, said: str, turn: int | None = None) -> Guess:
        """Return the guess with a unit, what is said for it, and counts per turn."""
        return replace(self, unit=unit, why=f"{self.why}; {said}", counts_per_turn=turn)

    @property
    def line(self) -> str:
        """The line of a column file; a comment where the unit is not known."""
        name = toml_text(self.theirs)
        more = ", sign = -1" if self.sign < 0 else ""
        more += f", counts_per_turn = {self.counts_per_turn}" if self.counts_per_turn else ""
        entry = f"{self.ours} = {{ name = {name}{more} }}" if more else f"{self.ours} = {name}"
        lacking = not self.unit and self.stem != RUN
        return f"# {entry}" if lacking else entry


@dataclass(frozen=True)
class Suggestion:
    """Guesses for a file and the model they are for; `rest`: columns that nothing is known of."""

    model: str
    guesses: tuple[Guess, ...]
    rest: tuple[str, ...]

    def to_toml(self, log: str) -> str:
        """Return the column file, each line with what speaks for it."""
        mapped = [g for g in self.guesses if g.ours != g.theirs]
        width = max((len(g.line) for g in mapped), default=0)
        lines = [f"{g.line.ljust(width)}  # {printable(g.why)}" for g in mapped]
        own = [g.theirs for g in self.guesses if g.ours == g.theirs]
        lines += [f"# read as they are: {printable(', '.join(own))}"] if own else []
        others = [f"# not used: {', '.join(map(repr, self.rest))}"] if self.rest else []
        head = [
            f"# Suggested for {printable(log)}, as {self.model} needs it. Check every line: nothing is used",
            "# until you give the file with --column-file. A line that begins with # lacks its UNIT (um).",
        ]
        return "\n".join([*head, "", "[columns]", *lines, *others, ""])


def suggest(source: Source, model: str | None = None, meta: Meta | None = None) -> Suggestion:
    """Return the best guess for each column of a file.

    `model`: what it is for, else that of `meta`, what a folder says of its log, else what the names fit.
    Raises `InputError` for a file without a column of numbers.
    """
    data = _numbers(source)
    if not data:
        raise InputError("No column of the file holds numbers; nothing can be suggested.")
    chosen = _model(source, model, meta or Meta())
    named = _by_name(source, data, chosen)
    guesses = [*named, *_by_motion(source, data, chosen, named)]
    order = {stem: k for k, stem in enumerate((RUN, TIME, *_stems(chosen), *OTHERS))}
    known = {g.theirs for g in guesses}
    return Suggestion(
        chosen.name,
        tuple(sorted(guesses, key=lambda g: order[g.stem])),
        tuple(name for name in source.names if name not in known),
    )


def _numbers(source: Source) -> dict[str, Array]:
    """Return the first samples of the columns that hold numbers."""
    found: dict[str, Array] = {}
    for names in (source.names, *((name,) for name in source.names)):
        try:
            found |= _head(source, names) if names else {}
        except InputError:
            continue  # words, dates
        if names == source.names:
            break
    return found


def _head(source: Source, names: Sequence[str]) -> dict[str, Array]:
    parts: list[Mapping[str, Array]] = []
    for part in source.chunks(names, ROWS):
        parts.append(part)
        if sum(len(p[names[0]]) for p in parts) >= ROWS:
            break
    joined = {n: np.concatenate([np.asarray(p[n], float) for p in parts])[:ROWS] for n in names if parts}
    return {n: v for n, v in joined.items() if np.isfinite(v).any()}


def _stems(model: Model) -> list[str]:
    return [split_unit(c)[0] for c in (*model.channels, *_measured(model), *model.references)]


def _measured(model: Model) -> tuple[str, ...]:
    computed = {c.name for c in model.computed}
    return tuple(c for c in model.state if c not in computed)


def _model(source: Source, name: str | None, meta: Meta) -> Model:
    """Return the model whose columns the names of a file fit best, in the form in which it is read there."""
    numbers = numbers_of(source.names)

    def fits(model: Model) -> float:
        stems, names = _stems(model), list(source.names)
        pairs = [(likeness(s, n, numbers), s, n) for s in sorted(stems) for n in sorted(names)]
        total, like = 0.0, _likeliest(p for p in pairs if p[0] > 0)
        for score, stem, theirs in like:  # each column is one of ours
            stems.remove(stem)
            names.remove(theirs)
            total += score
        for stem in stems:  # no name is like it, a unit may be
            told = [n for n in names if _stated(source, n) and _unit_fits(source, n, stem, model)]
            names = [n for n in names if n not in told[:1]]
            total += BARE * len(told[:1])
        return total / len(_stems(model))

    own = tuple(si_name(n) for n in source.names if _own(n))
    if stated := name or meta.base_model:
        return max(_forms(stated, own, meta), key=fits)
    found: list[Model] = []
    for family in FAMILIES:
        with suppress(InputError):  # of a family whose code fails, which nobody has asked for
            found += _forms(family.default, own, meta)
    return max(found, key=fits)


def _forms(name: str, own: tuple[str, ...], meta: Meta) -> list[Model]:
    """Return a model as it is read by its channels, as its pose is read, and as columns of ours say."""
    usual = build(name)
    found = [usual]
    for columns in ((*usual.pose, *usual.references), own):
        try:
            found.append(build(name, meta=replace(meta, columns=columns)))
        except InputError:
            continue  # not a form of it
    return found


# -- by name ---------------------------------------------------------------------------------------------


def _likeliest(pairs: Iterable[tuple[float, str, str]]) -> list[tuple[float, str, str]]:
    """Return the pairs (how likely, stem, name) with each stem and each name once, the likeliest first."""
    found: list[tuple[float, str, str]] = []
    for pair in sorted(pairs, key=lambda p: -p[0]):
        if all(pair[1] != stem and pair[2] != name for _, stem, name in found):
            found.append(pair)
    return found


def _by_name(source: Source, data: Mapping[str, Array], model: Model) -> list[Guess]:
    numbers = numbers_of(source.names)
    stems = [RUN, TIME, *_stems(model), *OTHERS]
    own = {name: _own(name) for name in data}
    fitting = [
        (stem, name)
        for stem in stems
        for name in data
        if own[name] in ("", stem)  # a name of ours is not another one of ours
        and (stem not in (RUN, TIME) or _behaves(stem, data[name]))
        and _unit_fits(source, name, stem, model)
    ]
    pairs = [(likeness(stem, name, numbers), stem, name) for stem, name in fitting]
    # an index is no time
    pairs += [(BARE / 2, s, n) for s, n in fitting if s == RUN or (s == TIME and not _whole(data[n]))]
    found = []
    for score, stem, name in _likeliest(p for p in pairs if p[0] > 0):
        by_data = "its data: whole numbers that stay" if stem == RUN else "its data"
        guess = Guess(stem, name, "", "its name" if score >= BARE else by_data)
        found.append(_with_unit(source, data[name], guess))
    return found


def _behaves(stem: str, values: Array) -> bool:
    """Say whether values are such as run numbers (whole, and stay) or times (rise by even steps)."""
    if not np.isfinite(values).all() or len(values) < 3:
        return False
    steps = np.diff(values)
    if stem == RUN:
        changes = np.count_nonzero(steps)
        return bool(_whole(values) and changes <= len(values) / 8 and (steps >= 0).all())
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
    last = name.rpartition("_")[2].lower()
    return last if "_" in name and last in UNITS and (len(last) > 1 or last in "sm") else ""


def _own(name: str) -> str:
    """Return the stem of a name that is one of ours, with its unit; "" for any other."""
    stem, unit = split_unit(name)
    return RUN if name == RUN else stem if unit and quantity(stem) else ""


def _unit_fits(source: Source, name: str, stem: str, model: Model) -> bool:
    """Say whether the unit of a column, where it is stated, is one that the model takes, or counts of it."""
    stated = _stated(source, name)
    taken = {
        split_unit(c)[0]: c.rpartition("_")[2] for c in (*model.channels, *model.state, *model.references)
    }
    kinds = (taken[stem],) if stem in taken else quantity(stem)
    return not stated or stem == RUN or UNITS[stated].si in (*kinds, *("count",) * ("rad" in kinds))


def _with_unit(source: Source, values: Array, guess: Guess, expected: Array | None = None) -> Guess:
    """Add the unit that the file states, else the one in which the values are as large as they should be.

    That is what is `expected` of them, or what is likely. An angle that goes round: whole numbers are counts,
    up to 7 radians, up to 400 degrees.
    """
    if guess.stem == RUN:
        return guess
    stated, kinds = _stated(source, guess.theirs), quantity(guess.stem)
    if stated and UNITS[stated].si == "count" and "rad" in kinds:
        return guess.in_unit("count", f"{STATED}, THE TURN ONLY BY ITS SIZE", _turn(values))
    if stated:
        return guess.in_unit(stated, STATED)
    if expected is not None:
        apart = {u.name: abs(np.log(u.factor * np.std(values) / np.std(expected)))
                 for u in UNITS.values() if u.si in kinds[:1]}  # fmt: skip
        best = min(apart, key=lambda u: apart[u], default="")
        return guess.in_unit(best, BY_SIZE) if best and apart[best] < np.log(NEAR) else guess
    span = float(np.nanmax(values) - np.nanmin(values))
    for si in kinds:
        limit = limit_of(f"{guess.stem}_{si}")
        if limit and span > 0:
            units = [si] if span <= limit.likely else likely_units(limit, span)
            if units:
                return guess.in_unit(units[0], BY_SIZE)
    if "rad" not in kinds:
        return guess
    if _whole(values) and span > 400:
        return guess.in_unit("count", "COUNTS ONLY BY SIZE", _turn(values))
    return guess.in_unit("rad" if span < 7 else "deg", BY_SIZE) if span < 400 else guess


def _turn(values: Array) -> int:
    return 1 << int(np.nanmax(values)).bit_length()


# -- by motion -------------------------------------------------------------------------------------------


def _by_motion(
    source: Source, data: Mapping[str, Array], model: Model, named: Sequence[Guess]
) -> list[Guess]:
    """Return guesses for readings that move as the references say they should."""
    known = {g.stem: _si(data[g.theirs], g) for g in named if g.unit and g.stem != RUN}
    taken, stems = {g.theirs for g in named}, {g.stem for g in named}
    free = [n for n in data if n not in taken and not _own(n) and np.ptp(data[n]) > 0]
    lacking = [c for c in model.channels if split_unit(c)[0] not in stems and c not in model.period]
    if not lacking or not any(split_unit(c)[0] in known for c in model.references):
        return []
    expected = _readings(model, known)
    likely = {
        (stem, name): float(np.corrcoef(expected[stem], data[name])[0, 1])
        for stem in (split_unit(c)[0] for c in lacking)
        for name in free
        if _unit_fits(source, name, stem, model)
        and np.isfinite(data[name]).all()
        and np.ptp(expected[stem]) > 0
    }
    found = []
    for _, stem, name in _likeliest((abs(r), *pair) for pair, r in likely.items() if abs(r) >= MOVES):
        r = likely[stem, name]
        guess = Guess(stem, name, "", f"moves as {stem} should (r = {r:.3f})", 1 if r > 0 else -1)
        found.append(_with_unit(source, data[name], guess, expected[stem]))
    return found


def _si(values: Array, guess: Guess) -> Array:
    unit = UNITS[guess.unit]
    factor = 2 * np.pi / guess.counts_per_turn if guess.counts_per_turn else unit.factor
    return np.asarray(factor * values + unit.offset)


def _readings(model: Model, known: Mapping[str, Array]) -> dict[str, Array]:
    """Return what the nominal machine would read where the references say it is."""
    rows = len(next(iter(known.values())))
    pose = np.array([known.get(split_unit(c)[0], np.zeros(rows)) for c in model.references])
    rest = model.rest
    state = np.array([known.get(split_unit(c)[0], np.full(rows, rest.get(c, 0.0))) for c in model.state])
    zeros = np.zeros((len(model.zeros), 1))
    found = np.asarray(model.reading(model.nominal, zeros, pose, state.reshape(len(model.state), rows)))
    return dict(zip((split_unit(c)[0] for c in model.channels), found, strict=True))
