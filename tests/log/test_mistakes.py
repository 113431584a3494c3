"""Each mistake of the table is named in every log it is made in; the same logs without it pass silently."""

from __future__ import annotations

import re

import pytest
from mistaken_columns import COLUMNS
from mistakes import ENCODER, MISTAKES, STAGE, Mistake, base, made

from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.log import Log, check_log

CASES = [pytest.param(m, name, id=f"{m.name}, {name}") for m in (*MISTAKES, *COLUMNS) for name in m.on]
LONGEST = 300


def columns_of(log: Log) -> list[str]:
    """Return the columns that a fit of the log uses."""
    return [name for name in log.columns if name not in ("run", "t_s")]


def sentences(mistake: Mistake, log: Log) -> tuple[str, list[str]]:
    """How it ends, and everything that is said."""
    try:
        notes = (
            check_log(log, columns_of(log))
            if mistake.found == "log"
            else list(fit(log, solver="direct").notes)
        )
    except InputError as error:
        return "refusal", [str(error)]
    return "note", notes


@pytest.mark.parametrize(("mistake", "name"), CASES)
def test_each_mistake_is_named(mistake: Mistake, name: str) -> None:
    ends, said = sentences(mistake, made(mistake, name))
    assert any(re.search(mistake.says, text) for text in said), said
    assert ends == mistake.ends
    assert all(len(text) <= LONGEST and "\n" not in text for text in said), said


@pytest.mark.parametrize("name", [*STAGE, *ENCODER])
def test_the_logs_without_a_mistake_pass_silently(name: str) -> None:
    arrays, noise = base(name)
    assert check_log(Log.from_arrays(arrays, noise)) == []


@pytest.mark.parametrize("name", STAGE)
def test_a_fit_of_a_log_without_a_mistake_says_nothing(name: str) -> None:
    assert fit(Log.from_arrays(*base(name)), solver="direct").notes == ()
