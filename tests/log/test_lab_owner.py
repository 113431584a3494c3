"""A person who obeys what is printed ends in the right answer, with files that others wrote."""

from __future__ import annotations

from pathlib import Path

import pytest
from lab_files import FILES, obeyed

QUICK = {
    "no units", "counts with scale and offset", "runs side by side", "two files, moments", "HDF5, attributes",
    "a channel in each row", "averaged counts", "a column of words, lost samples",
    "a clock for each channel",
}  # fmt: skip
"""One of each kind of question; `slow` are those that ask the same of another file."""
NAMES = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in FILES]


@pytest.mark.parametrize("name", NAMES)
def test_obeying_twice_ends_in_the_right_answer(name: str, tmp_path: Path) -> None:
    outcome = obeyed(name, tmp_path)
    assert outcome.right, f"{outcome.why}\n{outcome.printed}"
