"""A diagnosis reads a log in memory a few times at most, however many models it tries on it."""

import sys
from pathlib import Path

import pytest

from hallsym.diagnosis import diagnose
from hallsym.log import Log, read_log

DATA = Path(__file__).parents[2] / "data"
MOST = 8
"""Passes over the log: runs, check, fit, and each set of derived columns once."""


@pytest.mark.parametrize(
    ("folder", "model", "causes"),
    [
        ("encoder", None, ()),
        pytest.param("campaign", "stage30", ("vertical_gain_coupling",), marks=pytest.mark.slow),
    ],
)
def test_diagnosis_reads_the_log_a_few_times_at_most(
    monkeypatch: pytest.MonkeyPatch, folder: str, model: str | None, causes: tuple[str, ...]
) -> None:
    passes = []
    blocks = Log.blocks
    monkeypatch.setattr(Log, "blocks", lambda *of, **by: passes.append(of) or blocks(*of, **by))
    found = diagnose(read_log(DATA / folder), model)
    assert found.ranked == causes
    assert 0 < len(passes) <= MOST + (folder == "encoder"), passes  # once more to follow its turns


def test_a_log_that_is_too_long_to_be_kept_is_diagnosed_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = diagnose(read_log(DATA / "encoder")).to_dict()
    monkeypatch.setattr(sys.modules["hallsym.log.batches"], "CACHED_ROWS", 0)
    streamed = diagnose(read_log(DATA / "encoder")).to_dict()
    assert streamed | {"seconds": 0} == kept | {"seconds": 0}
