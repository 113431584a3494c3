"""A person who obeys what is printed ends in the right answer, with files that others wrote."""

from __future__ import annotations

from pathlib import Path

import pytest
from lab_files import FILES, obeyed, recording

RIGHT = 0.9
"""Share of the files that end right: 50 of 54 do."""


@pytest.mark.parametrize("name", list(FILES))
def test_each_file_can_be_written_and_its_owner_knows_its_columns(name: str, tmp_path: Path) -> None:
    file = FILES[name]
    written = file.write(tmp_path, recording(file.family))
    assert any(tmp_path.iterdir())
    assert set(written.known) <= set(recording(file.family))


@pytest.mark.slow
def test_obeying_ends_in_the_right_answer(tmp_path: Path) -> None:
    wrong = {}
    for name in FILES:
        folder = tmp_path / name.replace("/", " ")
        folder.mkdir()
        outcome = obeyed(name, folder)
        if not outcome.right:
            wrong[name] = outcome.why
    assert len(wrong) <= (1 - RIGHT) * len(FILES), wrong
