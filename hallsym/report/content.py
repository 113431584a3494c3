"""The content of a report: the answer in a sentence, tables, remarks and pictures.

A terminal prints it (`printed`), a page lays it out (`document`), a notebook shows it (`fragment`).
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar
from urllib.parse import quote

from hallsym.files import json_text
from hallsym.output import csv_text, printable
from hallsym.report.picture import Panel, Picture
from hallsym.report.tables import grid
from hallsym.report.words import micro, minus

PHONE = 44
"""Characters of a table side by side on a phone of 390 px."""


@dataclass(frozen=True)
class Words:
    """A paragraph."""

    kind: ClassVar[str] = "words"
    words: str


class Note(Words):
    """Explanation of a figure or a table of a page; a terminal leaves it out."""

    kind = "note"


class Heading(Words):
    """A heading inside a section."""

    kind = "heading"


@dataclass(frozen=True)
class Table:
    """Rows of text, and numbers as text. The first `left` columns and `wordy` hold text.

    `sortable`: by every column of a page, with JavaScript. `titled`: a terminal has the caption too, as a
    page always. A column whose cells are all empty is left out.
    """

    kind: ClassVar[str] = "table"
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    left: int = 1
    wordy: Sequence[int] = ()
    sortable: bool = False
    titled: bool = False

    def __post_init__(self) -> None:
        """Leave out columns that say nothing."""
        full = [k for k in range(len(self.head)) if any(row[k] not in (None, "") for row in self.rows)]
        if self.rows and len(full) < len(self.head):
            kept = {
                "head": [self.head[k] for k in full],
                "rows": [[row[k] for k in full] for row in self.rows],
                "left": sum(k < self.left for k in full),
                "wordy": [full.index(k) for k in self.wordy if k in full],
            }
            for name, value in kept.items():
                object.__setattr__(self, name, value)

    def look(self, column: int) -> str | None:
        """Return the class of a column's cells in a page."""
        return None if column < self.left else "t" if column in self.wordy else "n"

    @property
    def many(self) -> bool:
        """Whether a phone is too narrow for the columns; it shows each row as a list."""
        columns = zip(self.head, *self.rows, strict=True)
        words = ([w for cell in column for w in str(cell or "").split()] for column in columns)
        return sum(1 + max(map(len, column), default=0) for column in words) > PHONE

    @property
    def text(self) -> str:
        """The table in a terminal; a last column of words is prose."""
        rows = [["" if cell is None else str(cell) for cell in row] for row in (self.head, *self.rows)]
        prose = len(self.head) - 1 in self.wordy
        left = max([self.left, *(k + 1 for k in self.wordy if k == self.left)]) if not prose else self.left
        return grid(rows, left=left, words=prose)


@dataclass(frozen=True)
class Items:
    """A list of lines, each a name, which may be empty, and a value; None and "" are left out."""

    kind: ClassVar[str] = "items"
    pairs: Sequence[tuple[str, Any]]

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Names and values as text."""
        return [(name, str(value)) for name, value in self.pairs if value not in (None, "")]


@dataclass(frozen=True)
class Runs:
    """The errors of one run over time, in whose place a script shows others: `data` is what it reads."""

    kind: ClassVar[str] = "runs"
    title: str
    note: str
    charts: Sequence[Panel]
    key: str
    data: Any


@dataclass(frozen=True)
class Folded(Words):
    """Blocks that a page shows when they are asked for, under `words`, which is all that a terminal has."""

    kind = "folded"
    content: Sequence[Table | Picture]


Block = Words | Table | Items | Picture | Runs


@dataclass(frozen=True)
class Section:
    """A part with a heading, which a terminal leaves out; without content it is left out itself."""

    ident: str
    title: str
    content: Sequence[Block | str]


@dataclass(frozen=True)
class Content:
    """The whole report of a result.

    `answer`: a sentence, the first line of a command and the card of a page, after the `word` of a page.
    `state`: good, open or bad. `first`: blocks beside the answer. `command`: the next one, `why`: its
    purpose. `columns`: the numbers of the result in SI, for a file of a page.
    """

    title: str
    answer: str
    sections: Sequence[Section] = ()
    first: Sequence[Block | str] = ()
    state: str = "open"
    word: str = ""
    why: str = ""
    command: str = ""
    columns: Mapping[str, Sequence[Any]] | None = None
    pictures: Mapping[str, Callable[[Any], Picture]] = field(default_factory=dict)
    """By the name of their file, the first one first: of the result; of a log where it is given one."""
    seconds: float | None = None
    """Computing time, for a terminal only, so that a page depends on the data alone."""


# -- in a terminal ---------------------------------------------------------------------------------------


def printed(content: Content) -> str:
    """Return the content as text: the answer, then tables between empty lines, and remarks.

    It ends with an empty line where it ends with a table.
    """
    blocks = [*content.first, *(block for section in content.sections for block in section.content)]
    ends = [] if content.seconds is None else [f"computed in {content.seconds:.1f} s"]
    ends += [f"next: {content.command}"] if content.command else []
    return text_of([content.answer, *blocks, *ends])


def text_of(blocks: Sequence[Block | str]) -> str:
    """Return blocks as text; a table, and a heading with what follows it, stand between empty lines."""
    lines: list[str] = []
    headed = False
    for block in blocks:
        if isinstance(block, Table) and block.rows:
            lines += [""] if lines and lines[-1] and not headed else []
            lines += [*([block.caption] if block.titled else []), block.text, ""]
        elif isinstance(block, Heading):
            lines += [*([""] if lines and lines[-1] else []), block.words]
        elif isinstance(block, Items):
            lines += [f"{name}: {words}" if name else words for name, words in block.lines]
        elif isinstance(block, Words | str) and not isinstance(block, Note):
            lines.append(block if isinstance(block, str) else block.words)
        else:
            continue
        headed = isinstance(block, Heading)
    return "\n".join(lines)


# -- as HTML: what escapes in templates, and the policy that forbids every request -----------------------


def document(content: Content) -> str:
    """Return the page as HTML. Its policy forbids every request and every script but its own."""
    return _render("page.html.j2", **_parts(content))


def fragment(content: Content, picture: Picture | None = None) -> str:
    """Return the answer, the tables and a picture as HTML for a notebook, without script or style sheet."""
    return _render("fragment.html.j2", **_parts(content), picture=picture)


def _parts(content: Content) -> dict[str, Any]:
    sections = [
        Section(s.ident, s.title, blocks) for s in content.sections if (blocks := [*_full(s.content)])
    ]
    return {"content": content, "first": [*_full(content.first)], "sections": sections}


def _full(blocks: Sequence[Block | str]) -> Iterator[Block]:
    """Yield the blocks that hold something, plain text as paragraphs."""
    full = {"table": "rows", "items": "lines", "figure": "panels", "runs": "charts"}
    for block in blocks:
        block = Words(block) if isinstance(block, str) else block
        if getattr(block, full.get(block.kind, "words")):
            yield block


def _render(template: str, **values: Any) -> str:
    """Return a template as HTML. What is not markup is escaped."""
    return str(_environment().get_template(template).render(**values)) + "\n"


@cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    from hallsym.report.drawing import key, svg

    found = Environment(
        loader=PackageLoader("hallsym.report"),
        autoescape=True,
        finalize=_shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.policies["json.dumps_function"] = json_text
    found.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "indent": None}
    script = part("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    found.globals |= {
        "svg": svg,
        "key": key,
        "csv": _csv,
        "minus": lambda value: minus(str(value)),
        "micro": lambda value: micro(str(value)),
        "style": Markup(part("page.css")),
        "script": Markup(script),
        "policy": f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'",
    }
    return found


@cache
def part(name: str) -> str:
    """Return the text of a file that stands beside the templates."""
    return files("hallsym.report").joinpath("templates", name).read_text(encoding="utf-8")


def _csv(columns: Mapping[str, Sequence[Any]]) -> str:
    """Return columns as the address of a CSV file that is inside the page."""
    rows = zip(*columns.values(), strict=True)
    text = csv_text([[*columns], *(["" if cell is None else cell for cell in row] for row in rows)])
    return f"data:text/csv;charset=utf-8,{quote(text)}"


def _shown(value: Any) -> Any:
    """Return a value as a template shows it: nothing for None, text as `printable`."""
    from markupsafe import Markup

    if value is None:
        return ""
    plain = isinstance(value, str) and not isinstance(value, Markup)
    return printable(value, keep="\n\t") if plain else value
