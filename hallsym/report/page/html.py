"""HTML elements from Python: whatever is not marked as HTML is escaped."""

from collections.abc import Iterable, Sequence
from html import escape as _escape
from unicodedata import category

VOID = frozenset({"meta", "br", "hr", "col"})


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def escape(value: object) -> Markup:
    """Return text as HTML; control characters and broken UTF-8 of a file name show as �."""
    if isinstance(value, Markup):
        return value
    text = str(value)
    if not text.isprintable():
        text = "".join(c if _shows(c) else "�" for c in text)
    return Markup(_escape(text, quote=True))


def tag(name: str, /, *children: object, **attributes: object) -> Markup:
    """Return an element: `tag("a", "here", href="#x")`.

    `class_` and `data_x` stand for `class` and `data-x`; an attribute that is None or False is left out, True
    gives it without a value.
    """
    opening = f"<{name}{''.join(_attribute(k, v) for k, v in attributes.items())}>"
    if name in VOID:
        return Markup(opening)
    return Markup(f"{opening}{join(children)}</{name}>")


def join(children: Iterable[object]) -> Markup:
    """Return children one after the other."""
    return Markup("".join(escape(child) for child in children if child is not None))


def table(
    head: Sequence[object],
    rows: Sequence[Sequence[object]],
    *,
    left: int = 1,
    wordy: Sequence[int] = (),
    caption: str = "",
) -> Markup:
    """Return a table that scrolls by itself where it is too wide; nothing for no rows.

    Numbers stand to the right, except in the first `left` columns and in `wordy`, which hold text.
    """
    if not rows:
        return Markup("")

    def look(k: int) -> str | None:
        return None if k < left else "t" if k in wordy else "n"

    def row_of(row: Sequence[object]) -> Markup:
        first = tag("th", row[0], scope="row")
        return tag("tr", first, *(tag("td", v, class_=look(k)) for k, v in enumerate(row) if k))

    body = join(map(row_of, rows))
    inner = tag(
        "table",
        tag("caption", caption) if caption else None,
        tag("thead", tag("tr", *(tag("th", v, scope="col", class_=look(k)) for k, v in enumerate(head)))),
        tag("tbody", body),
    )
    return tag("div", inner, class_="wide", tabindex="0", role="region", aria_label=caption or "table")


def items(lines: Sequence[object]) -> Markup:
    """Return a list; nothing for no lines."""
    return tag("ul", *(tag("li", line) for line in lines)) if lines else Markup("")


def facts(pairs: Sequence[tuple[str, object]]) -> Markup:
    """Return a list of names and what belongs to them; pairs without a value are left out."""
    return tag("dl", *(tag("div", tag("dt", k), tag("dd", v)) for k, v in pairs if v not in (None, "")))


def _shows(character: str) -> bool:
    return character.isprintable() or character in "\n\t" or category(character) == "Zs"


def _attribute(name: str, value: object) -> str:
    if value is None or value is False:
        return ""
    name = name.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{escape(value)}"'
