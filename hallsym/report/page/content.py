"""What a page holds, without a word of HTML, and the templates that show it."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hallsym.files import json_text
from hallsym.output import printable
from hallsym.report.picture import Panel
from hallsym.report.words import micro, minus

# -- templates: what escapes in them, and the policy that forbids every request --------------------------


def render(template: str, **values: Any) -> str:
    """Return a template of this package as HTML. What is not markup is escaped."""
    return _environment().get_template(template).render(**values) + "\n"


@cache
def _environment() -> Environment:
    from hallsym.report.drawing import svg

    found = Environment(
        loader=PackageLoader("hallsym.report.page"),
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
    return files("hallsym.report.page").joinpath("templates", name).read_text(encoding="utf-8")


def _shown(value: Any) -> Any:
    """Return a value as a template shows it: nothing for None, text as `printable`."""
    if value is None:
        return ""
    plain = isinstance(value, str) and not isinstance(value, Markup)
    return printable(value, keep="\n\t") if plain else value


# -- what a page holds -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Words:
    """A paragraph; a `note` is smaller."""

    kind: ClassVar[str] = "words"
    words: str
    note: bool = False


@dataclass(frozen=True)
class Heading:
    """A heading inside a section."""

    kind: ClassVar[str] = "heading"
    words: str


@dataclass(frozen=True)
class Table:
    """Rows of text, and numbers as text. The first `left` columns and `wordy` hold text.

    `sortable`: by every column, with JavaScript.
    """

    kind: ClassVar[str] = "table"
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str
    left: int = 1
    wordy: Sequence[int] = ()
    sortable: bool = False

    def look(self, column: int) -> str | None:
        """Return the class of a column's cells."""
        return None if column < self.left else "t" if column in self.wordy else "n"

    @property
    def many(self) -> bool:
        """Whether a phone is too narrow for the columns; it shows each row as a list."""
        return len(self.head) > 4


@dataclass(frozen=True)
class Facts:
    """Names and values; those without a value are left out, a value in `code` is typed."""

    kind: ClassVar[str] = "facts"
    pairs: Sequence[tuple[str, Any]]
    code: frozenset[str] = frozenset()

    @property
    def known(self) -> list[tuple[str, str, bool]]:
        """Name, value, and whether it is code."""
        return [(name, str(v), name in self.code) for name, v in self.pairs if v not in (None, "")]


@dataclass(frozen=True)
class Items:
    """A list of lines, each a name, which may be empty, and words."""

    kind: ClassVar[str] = "items"
    lines: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Figure:
    """Panels with a caption, side by side: three in a row, or with the `look` "two" two wider ones."""

    kind: ClassVar[str] = "figure"
    charts: Sequence[Panel]
    caption: str = ""
    look: str = ""

    @property
    def width(self) -> float:
        """The px of a panel."""
        return 360.0 if self.look == "two" else 240.0


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
class Section:
    """A part of a page with a heading; one without content is left out."""

    ident: str
    title: str
    content: Sequence[Any]


@dataclass(frozen=True)
class Headline:
    """The card at the top: verdict, next command, sizes against the noise floor.

    `state`: good, open or bad. `word`: the verdict in a few words, `sentence` the rest. `why`: what the next
    command does.
    """

    state: str
    word: str
    sentence: str
    why: str = ""
    command: str = ""
    sizes: Figure | None = None


def document(title: str, headline: Headline, sections: Sequence[Section], footer: str) -> str:
    """Return the page as HTML. Its policy forbids every request and every script but its own."""
    full = {"table": "rows", "items": "lines", "figure": "charts"}
    shown = []
    for s in sections:
        content = [c for c in s.content if c is not None and getattr(c, full.get(c.kind, "kind"))]
        shown += [Section(s.ident, s.title, content)] if content else []
    return render("page.html.j2", title=title, headline=headline, sections=shown, footer=footer)
