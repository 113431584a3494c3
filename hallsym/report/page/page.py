"""The skeleton of a page: one file with its style and script inside, nothing loaded from anywhere."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from hallsym.report.page.html import Markup, join, tag

MAIN = "page.js"


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading; one without content is left out."""

    ident: str
    title: str
    content: Markup


def document(title: str, verdict: Sequence[object], sections: Sequence[Section], footer: object) -> str:
    """Return the page as HTML. The verdict is the sentence under the title.

    A content security policy forbids every request and every script but the one inside, whose hash it names.
    """
    shown = [section for section in sections if section.content]
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", http_equiv="Content-Security-Policy", content=_policy()),
        tag("title", title),
        tag("style", Markup(_part("page.css"))),
    )
    body = tag(
        "body",
        tag("header", tag("h1", title), tag("p", *verdict, class_="verdict", id="verdict")),
        tag("nav", *_links(shown), aria_label="sections"),
        tag("main", *(_section(s) for s in shown)),
        tag("footer", footer),
        tag("script", Markup(_part(MAIN))),
    )
    return f'<!doctype html>\n<html lang="en">\n{head}\n{body}\n</html>\n'


def _links(sections: Sequence[Section]) -> list[Markup]:
    return [join([tag("a", s.title, href=f"#{s.ident}"), " "]) for s in sections]


def _section(section: Section) -> Markup:
    return Markup(f"\n{tag('section', tag('h2', section.title), section.content, id=section.ident)}")


def _policy() -> str:
    digest = base64.b64encode(hashlib.sha256(_part(MAIN).encode()).digest()).decode()
    return f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"


@cache
def _part(name: str) -> str:
    return files("hallsym.report.page").joinpath(name).read_text(encoding="utf-8")
