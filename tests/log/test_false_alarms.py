"""Logs without a mistake pass in silence: simulated ones of many kinds, bundled ones, independent cases."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from healthy_logs import KINDS, healthy

from hallsym.errors import InputError
from hallsym.log import Log, check_log, read_log

ROOT = Path(__file__).resolve().parents[2]
FAST, SLOW = 8, 143
"""Logs of each kind; seven kinds make 56 and 1001."""


def said(log: Log) -> tuple[bool, list[str]]:
    """Whether a log is refused, and what is said of it."""
    try:
        return False, check_log(log)
    except InputError as error:
        return True, [str(error)]


@pytest.mark.parametrize("kind", KINDS)
def test_healthy_logs_pass_silently(kind: str) -> None:
    for seed in range(FAST):
        assert said(Log.from_arrays(healthy(kind, 1000 + seed))) == (False, []), seed


@pytest.mark.slow
def test_a_thousand_healthy_logs() -> None:
    """None is refused, and at most 1 % get a note."""
    results = [said(Log.from_arrays(healthy(kind, seed))) for kind in KINDS for seed in range(SLOW)]
    assert len(results) >= 1000
    assert [text for refused, text in results if refused] == []
    noted = [text for _, text in results if text]
    assert len(noted) <= len(results) // 100, noted


@pytest.mark.parametrize("name", ["campaign", "encoder"])
def test_bundled_logs_pass_silently(name: str) -> None:
    assert check_log(read_log(ROOT / "data" / name)) == []


CASES = Path(os.environ.get("HALLSYM_CASES", ROOT.parent / "shared" / "cases"))
REAL = CASES.parent / "real"
OTHER_NOISE = "meta.json states the noise of "
"""Of channels that the log does not have: the cases state it of all that their machines could have."""
NO_RUNS = "No column 'run': a run begins where t_s starts again, the first is number 0."


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="no folder of cases beside the repository")
def test_cases_pass_silently() -> None:
    folders = sorted(path for path in CASES.glob("*/*") if path.is_dir())
    assert len(folders) >= 84
    noted = {folder.name: check_log(read_log(folder)) for folder in folders}
    noted |= {path.name: check_log(read_log(path)) for path in sorted(CASES.glob("encoders/*.csv"))}
    said = {
        name: [n for n in notes if n != NO_RUNS and OTHER_NOISE not in n] for name, notes in noted.items()
    }
    assert {name: notes for name, notes in said.items() if notes} == {}


@pytest.mark.skipif(not REAL.is_dir(), reason="no folder of recordings beside the repository")
@pytest.mark.parametrize(
    ("pattern", "columns", "counts"),
    [
        (
            "rotary-mechaduino-luts/*.csv",
            {"angle_count": "raw_count", "angle_ref_deg": "ref_angle_deg"},
            16384,
        ),
        ("rotary-resolver-amci/*.csv", {"angle_deg": "resolver_deg", "angle_ref_deg": "ref_deg"}, None),
        ("linear-hall-undulators/*.csv", {"angle_ref_deg": "ref_deg"}, None),
        ("halbach-fieldmaps/*.csv", {}, None),
    ],
)
def test_recordings_pass_silently(pattern: str, columns: dict[str, str], counts: float | None) -> None:
    paths = sorted(REAL.glob(pattern))
    assert paths
    for path in paths:
        assert set(check_log(read_log(path, columns=columns, counts_per_turn=counts))) <= {NO_RUNS}, path
