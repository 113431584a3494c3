"""Tables and lines in a terminal of any width: they fit it, and nothing is left out."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym import bundled_campaign, evaluate, fit
from hallsym.output import NARROWEST, columns, fitted, prose_width
from hallsym.report.content import Table
from hallsym.report.tables import grid

ROWS = [
    ["parameter", "value", "unit", "standard uncertainty", "what it is"],
    ["eta_A", "0.86697(10)", "1", "0.0001", "gain of probe A at height zero, as it was recorded"],
    ["misalignment of probe A", "-0.007(11)", "deg", "0.011", "angle about the vertical axis"],
]


@pytest.fixture
def wide(monkeypatch):
    """Return what makes the terminal so many characters wide."""
    monkeypatch.delenv("COLUMNS", raising=False)
    return lambda width: monkeypatch.setenv("COLUMNS", str(width))


def words_of(text: str) -> list[str]:
    return sorted(re.findall(r"[^\s\\]+", re.sub(r"^-+$", "", text, flags=re.MULTILINE)))


def test_where_there_is_no_terminal_lines_have_any_length(wide):
    assert columns() is None
    assert prose_width() == 110
    assert len(grid(ROWS, words=True).split("\n")) == 4
    assert fitted("word " * 100) == "word " * 100


def test_the_variable_columns_is_honoured_down_to_what_can_be_read(wide):
    wide(72)
    assert (columns(), prose_width()) == (72, 72)
    wide(200)
    assert (columns(), prose_width()) == (200, 110)
    wide(3)
    assert columns() == NARROWEST


def test_rows_that_do_not_fit_are_lists(wide):
    wide(40)
    rows = [["run", *(f"column_{k:04d}" for k in range(9))], ["first", *map(str, range(9))]]
    name, *lines = grid(rows).split("\n")
    assert name == "run  first"
    assert lines == [f"  column_{k:04d}  {k}" for k in range(9)]


@settings(max_examples=60, deadline=None)
@given(
    st.integers(40, 130),
    st.lists(st.tuples(*[st.text("abc 0.1", max_size=18).map(str.strip)] * 5), min_size=2, max_size=5),
    st.booleans(),
)  # fmt: skip
def test_any_table_fits_any_terminal(width, rows, words):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("COLUMNS", raising=False)
        whole = grid(rows, words=words)
        patch.setenv("COLUMNS", str(width))
        text = grid(rows, words=words)
    assert max(map(len, text.split("\n"))) <= width
    assert set(words_of(text)) >= set(words_of(whole))


def test_a_command_to_copy_stays_one_command(wide):
    wide(60)
    typed = "hallsym diagnose a/rather/long/path/to/a/log.parquet --model stage31 --holdout 2,7,12"
    text = fitted(f"The model does not describe this log: it is far off, in all of it; next: {typed}")
    prose, _, command = text.partition("next: ")
    assert prose.endswith("\n")
    assert " ".join(command.replace("\\\n", " ").split()) == typed
    assert max(map(len, text.split("\n"))) <= 60


def test_what_is_printed_of_results_fits(wide):
    found = fit(bundled_campaign(), "stage31", solver="direct")
    seen = evaluate(found, bundled_campaign())
    wide(70)
    for result in (found, seen):
        assert max(map(len, result.summary().split("\n"))) <= 70


def test_a_table_whose_columns_are_all_words_does_not_vanish_where_it_is_too_wide(wide):
    wide(NARROWEST)
    rows = [["effect", *(f"{k} x" for k in range(12))], ["magnet_tilt", *["refused"] * 12]]
    assert grid(rows, left=13).count("refused") == 12


def test_a_column_that_says_nothing_is_left_out():
    table = Table(["a", "b", "c"], [["x", "", "one"], ["y", None, "two"]], left=2, wordy=(2,))
    assert (table.head, table.rows) == (["a", "c"], [["x", "one"], ["y", "two"]])
    assert (table.left, table.wordy) == (1, [1])
