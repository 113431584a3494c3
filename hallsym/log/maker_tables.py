"""Correction tables of makers' firmware: read as numbers and as readings of a log, and written.

Each row of `LAYOUTS` is one format as its public source prints and uses it:

- `simplefoc`: `CalibratedSensor` of simplefoc/Arduino-FOC-drivers at 011c612 (CalibratedSensor.cpp). Entry i
  is reading - angle [rad] at the reading 2 pi i / N; straight lines between. Its mean is zero, so that the
  electrical zero holds with it. Measured in 5 steps of each electrical period and copied to the entries of
  that step, which makes a staircase where steps are fewer than N. What is copied is the mean of both ends of
  a step (one on the way forward, one back), over an electrical period: it belongs to the middle.
- `mechaduino`: `lookup` of jcchurch13/Mechaduino-Firmware at 01b0121 (Utils.cpp, Controller.cpp). Entry k is
  the angle [deg] at count k of 16384, with straight lines between the full steps. The angle commutates the
  motor: its zero and its sense are those of the drive.
- `mechaduino-knots`: `fullStepReadings` of the same routine: the count at each full step.
- `klipper`: `calibrate` in a section [angle NAME], Klipper3d/klipper at 0a7a14e (klippy/extras/angle.py).
  Entry k is the reading, in 65536ths of a turn, at full step k; Klipper makes 64 straight lines of it. It
  begins at the group of four full steps that the lowest reading lies in (the highest, of a reversed sensor).
- `moteus`: `compensation_table` of mjbots/moteus at 06a3d52 (fw/motor_position.h, `lerp`), one `conf` entry
  a line. Entry i times `compensation_scale` / 127 is added to the reading (raw + offset) sign / cpr at i / N,
  in turns; straight lines between. (A comment there puts it at (i + 1/2) / N; the code does not.)

ODrive has no table: it keeps four coefficients whose sign and unit no public source states. Of Halls over a
ring `LinearHall` of simplefoc/Arduino-FOC-drivers at 0d8f79c takes centres off, then the arctangent; it
counts periods from where it is switched on.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hallsym.errors import InputError, listed, quoted, require
from hallsym.files import MOST_TEXT_BYTES, reading, regular
from hallsym.log.phase import wrapped
from hallsym.log.table import Arrays
from hallsym.output import csv_text
from hallsym.units import Array

TURN = 2 * pi
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LEAST = 3
"""Entries of a table at least; two numbers in braces are something else."""
MOST = 1e6
"""Largest number of a table: a turn has 65536 of the finest units."""
REPEATS = 4
"""Entries that repeat the one before, at least, of a staircase; a smooth table of few digits has some."""
STEPS = (200, 400)
"""Full steps in a turn of usual steppers: 1.8 and 0.9 deg."""
PER_LINE = 8
"""Entries of a line of Klipper's `calibrate`."""
FULL = 127
"""Largest entry of moteus, which means the whole of `compensation_scale`."""
FACTS = rf"\bfloat\s+\w*(zero_electric_angle)\w*\s*=\s*({NUMBER})|\bDirection\s+\w+\s*=\s*(Direction)::(\w+)"
"""Electrical zero and direction of the motor, which stand beside a table of SimpleFOC."""
SOURCE = r"motor_position\.sources\.(?P<source>\d)\."


@dataclass(frozen=True)
class Layout:
    """A format: entry = `reading` * reading + `angle` * angle, at equal steps of the one or of the other.

    `body`: a pattern whose group of that name holds the numbers, `number`: of one of them. `per_turn`: how
    many units of an entry are a turn. `code`: it is C, with comments. `lines`: straight lines that the
    firmware makes of it, where those are fewer than the entries. `by_pole_pair`: it begins with the first
    full step of the pole pair in which readings begin. `multiple`: what the number of entries is one of.
    `halls`: its firmware computes an angle from Halls over a ring (SimpleFOC `LinearHall`).
    """

    name: str
    about: str
    body: str
    entries: int
    per_turn: float
    reading: int
    angle: int
    decimals: int = 0
    at_reading: bool = True
    code: bool = True
    number: str = rf"(?<![\w.])(?P<value>{NUMBER})"
    lines: int = 0
    by_pole_pair: bool = False
    multiple: int = 1
    halls: bool = False

    @property
    def scaled(self) -> bool:
        """Whether the file states the scale of its largest entry."""
        return self.per_turn == FULL

    @property
    def absolute(self) -> bool:
        """Whether an entry is an angle or a reading, not what is between them."""
        return not (self.reading and self.angle)


LAYOUTS = (
    Layout(
        "simplefoc", "SimpleFOC CalibratedSensor",
        r"\bfloat\s+\w*[lL][uU][tT]\w*\s*\[\s*(?P<count>\w*)\s*\]\s*=\s*\{(?P<body>[^}]*)\}",
        200, TURN, 1, -1, decimals=6, halls=True,
    ),
    Layout(
        "mechaduino", "Mechaduino lookup",
        r"\bfloat\b[^;={}]*\blookup\s*\[\s*(?P<count>\w*)\s*\]\s*=\s*\{(?P<body>[^}]*)\}",
        16384, 360.0, 0, 1, decimals=2,
    ),
    Layout(
        "mechaduino-knots", "Mechaduino full steps",
        r"\b(?:int|float|u?int\d+_t)\s+fullStepReadings\s*\[\s*(?P<count>\w*)\s*\]\s*=\s*\{(?P<body>[^}]*)\}",
        200, 16384.0, 1, 0, at_reading=False,
    ),
    Layout(
        "klipper", "Klipper angle calibration",
        rf"(?m)^(?:#\*#[ \t]*)?calibrate[ \t]*[:=](?P<body>[^\n]*(?:\n(?:#\*#)?[ \t]+{NUMBER}[^\n]*)*)",
        200, 65536.0, 1, 0, decimals=1, at_reading=False, code=False, lines=64, by_pole_pair=True,
        multiple=4,
    ),
    Layout(
        "moteus", "moteus compensation",
        rf"(?m)(?P<body>(?:^(?:conf set )?{SOURCE}compensation_table\.\d+ +{NUMBER}[ \t\r]*(?:\n|\Z))+)",
        256, float(FULL), -1, 1, code=False, multiple=32,
        number=rf"(?m)compensation_table\.\d+ +(?P<value>{NUMBER})",
    ),
)  # fmt: skip
CSV = Layout("csv", "readings and angles", "", 200, TURN, 0, 1, decimals=17, halls=True)
"""A log of readings and the angles they stand for [rad], every bit of them; it is read as any log is."""
BY_NAME = {one.name: one for one in (*LAYOUTS, CSV)}


@dataclass(frozen=True, eq=False)
class MakerTable:
    """A table: entries (n,) in the unit of the file, and further numbers of the firmware.

    `scale`: turns that the largest entry of moteus means. The place of an entry is (reading + `shift`)
    `sign`, the reading as the chip gives it [rad]. `decimals`: digits after the point.
    """

    layout: Layout
    values: Array
    decimals: int
    scale: float = 1.0
    sign: int = 1
    shift: float = 0.0

    @property
    def unit(self) -> float:
        """Angle that an entry of one means [rad]."""
        return TURN * self.scale / self.layout.per_turn

    @property
    def places(self) -> Array:
        """Where the entries stand, of the reading as the table sees it or of the angle, (n,) [rad]."""
        return np.arange(len(self.values)) * (TURN / len(self.values))

    def seen(self, reading: Array) -> Array:
        """Return a reading of the chip as the table sees it."""
        return self.sign * (reading + self.shift)

    @property
    def rows(self) -> tuple[Array, Array]:
        """Readings as the table sees them and angles, (n,) [rad] each."""
        one, given, at = self.layout, self.values * self.unit, self.places
        if one.at_reading:
            return at, (given - one.reading * at) / one.angle
        return (given - one.angle * at) / one.reading, at

    @property
    def sense(self) -> int:
        """1 where angles grow with readings, -1 where they fall."""
        reading, angle = self.rows
        same = wrapped(np.diff(reading), TURN) * wrapped(np.diff(angle), TURN) >= 0
        return 1 if same.mean() >= 0.5 else -1

    def decoded(self, seen: Array) -> Array:
        """Return the angles (s,) [rad] that the firmware computes, each within any turn."""
        reading, angle = self.rows
        off = angle - self.sense * reading
        middle = np.angle(np.exp(1j * off).mean())
        off = np.asarray(wrapped(off - middle, TURN))
        if self.layout.lines:
            at = np.mod(reading, TURN) / TURN * self.layout.lines
            first, part = np.floor(at).astype(int) % self.layout.lines, at - np.floor(at)
            shares = np.zeros((len(at), self.layout.lines))
            np.add.at(shares, (np.arange(len(at)), first), 1 - part)
            np.add.at(shares, (np.arange(len(at)), (first + 1) % self.layout.lines), part)
            off = np.linalg.lstsq(shares, off, rcond=None)[0]
            off = np.round((off + middle) / self.unit) * self.unit - middle  # kept as whole numbers
            reading = np.arange(self.layout.lines) * (TURN / self.layout.lines)
        return self.sense * seen + middle + np.interp(seen, reading, off, period=TURN)

    def rounded(self) -> MakerTable:
        """Return the table with the digits that its file has; a turn is 0."""
        values = np.round(self.values, self.decimals)
        return replace(self, values=values % self.layout.per_turn if self.layout.absolute else values)


# -- text ------------------------------------------------------------------------------------------------


def masked(text: str) -> str:
    """Return C with blanks in the place of comments, so that places in it stay."""
    return re.sub(r"/\*.*?\*/|//[^\n]*", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.S)


class Found(NamedTuple):
    """A table in a text: where each of its numbers stands, and where its scale does (moteus)."""

    table: MakerTable
    cells: list[tuple[int, int]]
    scale: tuple[int, int] | None = None


def found_in(text: str) -> Found | None:
    """Return the first table in a text; None where there is none."""
    plain = masked(text)
    for layout in LAYOUTS:
        seen = plain if layout.code else text
        match = re.search(layout.body, seen)
        numbers = [] if match is None else [*re.compile(layout.number).finditer(seen, *match.span("body"))]
        cells = [m["value"] for m in numbers]
        if match is None or len(cells) < LEAST:
            continue
        decimals = max(len(re.split("[eE]", c)[0].partition(".")[2]) for c in cells)
        values = np.array([float(c) for c in cells])
        most = float(np.abs(values).max())
        what, stated = f"a table of {layout.about}", match.groupdict().get("count") or ""
        require(most <= MOST, f"Numbers of {what}", f"{MOST:g} at most", f"{most:g}")
        wanted = stated if stated.isdecimal() else f"in multiples of {layout.multiple}"
        whole = len(cells) == int(stated) if stated.isdecimal() else len(cells) % layout.multiple == 0
        require(whole, f"Entries of {what}", f"{wanted} in a file that is not cut short", len(cells))
        found = Found(MakerTable(layout, values, decimals), [m.span("value") for m in numbers])
        return _configured(found, text, match["source"]) if "source" in match.re.groupindex else found
    return None


def _configured(found: Found, text: str, source: str) -> Found:
    """Return a table of moteus with its scale, and with sign and offset of its source."""
    entry = rf"(?m)^(?:conf set )?motor_position\.sources\.{source}\.%s +(?P<value>{NUMBER})"
    names = ("compensation_scale", "sign", "offset", "cpr")
    matches = {name: match for name in names if (match := re.search(entry % name, text))}
    value = {name: float(match["value"]) for name, match in matches.items()}
    if "compensation_scale" not in matches:
        raise InputError(
            "A table of moteus needs motor_position.sources.N.compensation_scale beside it, as 'conf "
            "enumerate' prints it; firmware that has none keeps 32 numbers and is not read."
        )
    table = replace(
        found.table, scale=value["compensation_scale"], sign=-1 if value.get("sign", 1.0) < 0 else 1,
        shift=value.get("offset", 0.0) / (value.get("cpr") or 16384.0) * TURN,
    )  # fmt: skip
    return Found(table, found.cells, matches["compensation_scale"].span("value"))


def replaced(text: str, table: MakerTable) -> str:
    """Return a file with the numbers of its table replaced; all else, and numbers that stay, as they are.

    Raises `InputError` for a file without a table of that format and as many entries.
    """
    found = found_in(text)
    wanted = f"one with {len(table.values)} entries of {table.layout.about}"
    has = "none" if found is None else f"{len(found.cells)} of {found.table.layout.about}"
    if found is None or found.table.layout is not table.layout or len(found.cells) != len(table.values):
        raise InputError(f"The file to put the table into must be {wanted}; instead received {has}.")
    news = {
        at: f"{value:.{table.decimals}f}"
        for at, old, value in zip(found.cells, found.table.values, table.values, strict=True)
        if old != value
    }
    if found.scale and found.table.scale != table.scale:
        news[found.scale] = repr(table.scale)
    pieces, last = [], 0
    for first, end in sorted(news):
        pieces += [text[last:first], news[first, end]]
        last = end
    return "".join([*pieces, text[last:]])


def text_of(table: MakerTable) -> str:
    """Return a file that holds the table alone, as the firmware prints it."""
    if table.layout is CSV:
        rows = zip(*(map(repr, column.tolist()) for column in table.rows), strict=True)
        return csv_text([("angle_rad", "angle_ref_rad"), *rows])
    cells = [f"{value:.{table.decimals}f}" for value in table.values]
    count = len(cells)
    plain, several = ", ".join(cells), [",".join(cells[k : k + PER_LINE]) for k in range(0, count, PER_LINE)]
    name = "motor_position.sources.0.compensation_"
    entries = "".join(f"{name}table.{k} {cell}\n" for k, cell in enumerate(cells))
    return {
        "simplefoc": f"float calibrationLut[{count}] = {{\n{plain}}};\n",
        "mechaduino": f"const float lookup[] = {{\n{plain}, \n}};\n",
        "mechaduino-knots": f"const int fullStepReadings[{count}] = {{\n{plain}\n}};\n",
        "klipper": "[angle my_angle_sensor]\ncalibrate =\n\t" + ",\n\t".join(several) + "\n",
        "moteus": f"{entries}{name}scale {table.scale!r}\n",
    }[table.layout.name]


def read_table(path: str | Path) -> tuple[MakerTable, str]:
    """Return the table of a file, and the text of the file: `encoded` gives its bytes again."""
    file = regular(path, "Table")
    with reading(path, "Table", "cannot be read"):
        size = file.stat().st_size
        require(size <= MOST_TEXT_BYTES, f"Table {quoted(path)}", f"at most {MOST_TEXT_BYTES} bytes", size)
        text = file.read_bytes().decode("utf-8", "surrogateescape")
    found = found_in(text)
    if found is None:
        known = listed([one.about for one in LAYOUTS])
        raise InputError(f"{quoted(path)} must hold a table of {known}; it holds none: give another file.")
    return found.table, text


def encoded(text: str) -> bytes:
    """Return the bytes of a text that `read_table` gave, whatever their coding was."""
    return text.encode("utf-8", "surrogateescape")


# -- as a log --------------------------------------------------------------------------------------------


def stairs(values: Array) -> Array | None:
    """Return where plateaus of a staircase begin, (m,): m measured places fill n entries. None of another.

    Entries that are filled from the measured place before them make plateaus as even as whole numbers of
    entries can be: the k-th of m begins within one entry of k n / m.
    """
    begins = np.flatnonzero(values != np.roll(values, 1))
    n, m = len(values), len(begins)
    if m < 2 or n - m < REPEATS:
        return None
    off = begins - np.arange(m) * (n / m)
    return begins if np.ptp(off) <= 1 + 1e-9 else None


def full_steps(table: MakerTable) -> tuple[Array, Array] | None:
    """Return readings and angles [rad] at the full steps between which lines are straight, else None."""
    reading, angle = table.rows
    grown = table.sense * np.unwrap(angle)
    for steps in STEPS:
        at = (np.ceil(grown[0] / TURN * steps) + np.arange(steps)) * (TURN / steps)
        knots = np.interp(at, np.append(grown, grown[0] + TURN), np.append(reading, TURN))
        left = reading + np.interp(reading, knots, at - knots, period=TURN) - grown
        if np.sqrt(np.mean(left**2)) <= table.unit * 10.0**-table.decimals:
            return knots, table.sense * at
    return None


def measured(table: MakerTable) -> tuple[Array, Array, str]:
    """Return the readings [rad] that a table was made of, angles [rad] beside them, and what to say of it."""
    reading, angle = table.rows
    entries = f"{len(reading)} entries"
    if table.layout.absolute and table.layout.at_reading and (knots := full_steps(table)):
        return *knots, f"{len(knots[0])} full steps, with straight lines between them in {entries}"
    begins = None if table.layout.absolute else stairs(table.values)
    if begins is None:
        return reading, angle, entries
    ends = np.append(begins[1:], begins[0] + len(reading))
    middle = (begins + ends) / 2 * table.places[1]  # an entry stands for the places from it to the next
    said = f"{len(begins)} measured places in {entries}, a staircase"
    return middle, middle + (angle - reading)[begins], said


def open_table(path: Path) -> Arrays:
    """Open a table as a log: the readings that it was made of beside the position of the drive."""
    table, text = read_table(path)
    reading, angle, said = measured(table)
    raw = table.sign * reading - table.shift
    source = Arrays({"angle_rad": np.mod(raw, TURN), "angle_ref_rad": np.mod(angle, TURN)})
    kept = ", ".join(" ".join(filter(None, fact)) for fact in re.findall(FACTS, masked(text)))
    source.recognised = f"table of {table.layout.about}"
    source.notes = (
        f"{quoted(path)} is a table of {table.layout.about}: {said}; each is a reading beside the position "
        "of the drive, so the reference is that motor, and what repeats with its poles may be in the table"
        + (f" ({kept}, kept by 'hallsym export --like')." if kept else "."),
    )
    return source
