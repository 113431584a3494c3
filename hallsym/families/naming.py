"""The words of column names: which of our columns a laboratory's name could mean."""

from __future__ import annotations

import re
import string

from hallsym.units import UNITS

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
