"""Files of a generated folder from Jinja templates: its trees are `templates/common` and of an arithmetic.

A list alone on a line of a template stands for its lines, each indented as it is; an empty one takes the line
away.
"""

import re
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from textwrap import wrap
from typing import Any

from hallsym.codegen.decoupler import flag_bit, unit
from hallsym.output import commented

LICENSE = "LicenseRef-generated"
"""SPDX identifier of files whose user has not said another: generated, and theirs to license."""
FRAGMENTS = "fragments"
"""Folder of templates that are parts of files."""
ROOT = Path(__file__).parent / "templates"
BEGIN, END = "\x02", "\x03"
"""Around the lines of a list in a rendered text."""
LISTED = re.compile(f"( *){BEGIN}([^{END}]*){END}\n")


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    found = Environment(
        loader=FileSystemLoader(ROOT),
        undefined=StrictUndefined,
        finalize=_lines,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters |= {
        "braced": lambda text: f"{{{text}}}", "commented": commented, "mask": hexadecimal,
        "status_bit": status_bit, "wrapped": partial(wrap, width=110),
        "units": lambda columns, between=", ": between.join(dict.fromkeys(map(unit, columns))),
    }  # fmt: skip
    found.globals["flag_bit"] = flag_bit
    return found


@cache
def tree(arithmetic: str) -> Mapping[str, str]:
    """Return the template of each file of a folder, by its path there."""
    return {
        path.relative_to(ROOT / top).as_posix(): path.relative_to(ROOT).as_posix()
        for top in ("common", arithmetic)
        for path in sorted((ROOT / top).rglob("*"))
        if path.is_file() and path.parent.name != FRAGMENTS
    }


def filled(name: str, fields: Mapping[str, Any]) -> str:
    """Return a template with its fields filled in."""
    return LISTED.sub(_indented, _environment().get_template(name).render(fields))


def hexadecimal(bits: int) -> str:
    """Return 32 bits in C."""
    return f"0x{bits:08X}UL"


def status_bit(name: str) -> str:
    """Return the name of a status bit."""
    return f"DECOUPLER_STATUS_{name}"


def _lines(value: Any) -> Any:
    return BEGIN + "".join(f"{row}\n" for row in value) + END if isinstance(value, list) else value


def _indented(found: re.Match[str]) -> str:
    return re.sub(r"(?m)^(?=.)", found[1], found[2])
