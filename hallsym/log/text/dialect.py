"""What a text file is: the record that the sniffer fills and the reader follows."""

from __future__ import annotations

from dataclasses import dataclass, field

from hallsym.log.text.numbers import POINT, Convention
from hallsym.log.text.times import TimeForm

SAID = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "blanks"}
TYPED = {"\t": "tab", " ": "blank"}
"""What `--delimiter` takes for what cannot be typed."""


@dataclass(frozen=True)
class Dialect:
    """Everything that was recognised of a file. Lines are counted from 1.

    `delimiter`: " " stands for any number of blanks and tabs. `names`: one by cell, `units` those that the
    header states, by name. `header`: line of the names; `units_line`: of the units, 0 without one.
    `first`: line the table begins at. `footer`: lines after the table. `quoted`: whether quotes stand around
    cells, "inside" where delimiters may stand in them. `padded`: whether blanks stand beside delimiters.
    """

    encoding: str
    compressed: bool
    delimiter: str
    names: tuple[str, ...]
    header: int
    first: int
    numbers: Convention = POINT
    units: dict[str, str] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    units_line: int = 0
    comments: tuple[str, ...] = ("#",)
    quoted: str = ""
    padded: bool = False
    footer: int = 0
    footer_text: str = ""
    times: dict[str, TimeForm] = field(default_factory=dict)
    """Columns of times as text, by name, and how they are written."""
    above: int = 0
    """Lines before the names that are neither empty nor comments."""

    @property
    def usual(self) -> bool:
        """Whether the file is what needs no word: UTF-8, commas or tabs, decimal point, names first."""
        plain = self.encoding in ("utf-8", "utf-8-sig") and self.numbers == POINT
        bare = not (self.units_line or self.footer or self.above)
        return plain and bare and self.delimiter in ",\t"

    def said(self, sheet: str = "") -> str:
        """Return one line that says what was recognised; `sheet`: of a workbook."""
        coding = {"utf-8": "UTF-8", "utf-8-sig": "UTF-8 with a byte order mark"}.get(
            self.encoding, self.encoding.upper().replace("LATIN", "Latin")
        )
        by = SAID.get(self.delimiter, repr(self.delimiter))
        columns = f"columns separated by {by}" if len(self.names) > 1 else "one column"
        text = f"{coding}{', gzip' if self.compressed else ''}, {columns}"
        words = [f"sheet '{sheet}'" if sheet else text]
        group = f" and {self.numbers.grouping!r} between thousands" if self.numbers.grouping else ""
        words.append(f"decimal {'comma' if self.numbers.decimal == ',' else 'point'}{group}")
        units = f" with units in line {self.units_line}" if self.units_line else ""
        words.append(f"names in line {self.header}{units}")
        if self.above:
            words.append(f"{self.above} {'line' if self.above == 1 else 'lines'} above them not used")
        if self.footer:
            what = "the last line" if self.footer == 1 else f"the last {self.footer} lines"
            words.append(f"{what} left out ({repr(self.footer_text[:40]) if self.footer_text else 'empty'})")
        return ", ".join(words)
