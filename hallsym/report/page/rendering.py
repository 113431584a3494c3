"""Templates of a page: their environment, what escapes in them, and the policy that forbids every request."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any
from unicodedata import category

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hallsym.report.page.marks import Chart


def render(template: str, **values: Any) -> str:
    """Return a template of this package as HTML. What is not markup is escaped."""
    return _environment().get_template(template).render(**values) + "\n"


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader("hallsym.report.page"),
        autoescape=True,
        finalize=_shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script = part("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    found.globals |= {
        "style": Markup(part("page.css")),
        "script": Markup(script),
        "policy": f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'",
    }
    found.tests["chart"] = lambda value: isinstance(value, Chart)
    return found


@cache
def part(name: str) -> str:
    """Return the text of a file that stands beside the templates."""
    return files("hallsym.report.page").joinpath("templates", name).read_text(encoding="utf-8")


def _shown(value: Any) -> Any:
    """Return a value as a template shows it: nothing for None; what a file name may not show as �."""
    if value is None:
        return ""
    if isinstance(value, str) and not isinstance(value, Markup) and not value.isprintable():
        return "".join(c if _shows(c) else "�" for c in value)
    return value


def _shows(character: str) -> bool:
    return character.isprintable() or character in "\n\t" or category(character) == "Zs"
