"""A person who obeys what is printed ends in the right answer, with files that others wrote."""

from __future__ import annotations

from pathlib import Path

import pytest
from lab_files import FILES, obeyed

QUICK = {
    "decimal commas", "no units", "counts with scale and offset", "runs side by side", "folder of runs",
    "two files, moments", "workbook", "HDF5, attributes", "HDF5, records", "TDMS", "MATLAB matrices",
    "JSON lines", "parquet", "averaged counts", "an encoder without units", "a column of words, lost samples",
    "no names", "noise of a channel that is not there", "two files of other hours",
    "a folder with another table", "a clock for each channel", "channels in their own rows",
}  # fmt: skip
"""One of each kind of question; `slow` are those that ask the same of another file."""
NAMES = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in FILES]


@pytest.mark.parametrize("name", NAMES)
def test_obeying_twice_ends_in_the_right_answer(name: str, tmp_path: Path) -> None:
    outcome = obeyed(name, tmp_path)
    assert outcome.right, f"{outcome.why}\n{outcome.printed}"
