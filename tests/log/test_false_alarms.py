"""Logs without a mistake pass in silence: simulated ones of many kinds, bundled ones, independent cases."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import drawn_by, healthy, healthy_cases

from hallsym.errors import InputError
from hallsym.log import Log, check_log, read_log

ROOT = Path(__file__).resolve().parents[2]
REMARKED = ("missing samples", "slow clock")
"""Kinds of healthy logs of which a remark is true."""


def coarse(kind: str, family: str, seed: str) -> Log:
    """A healthy log behind a converter, whose steps are up to 30 times the noise and stated by nobody."""
    r, rng = healthy(kind, family, seed), drawn_by("converter", kind, family, seed)
    step = rng.choice([0.0, 0.3, 1.0, 3.0, 10.0, 30.0])
    if not step:
        return r.log
    steps = {c: step * r.sigma[c] for c in r.readings}
    rounded = {c: h * np.round(r.arrays[c] / h) for c, h in steps.items()}
    return replace(r, arrays={**r.arrays, **rounded}, stated={}).log


def said(log: Log) -> tuple[bool, list[str]]:
    """Whether a log is refused, and what is said of it."""
    try:
        return False, check_log(log)
    except InputError as error:
        return True, [str(error)]


@pytest.mark.parametrize(
    ("seed", "repeat", "every", "logs"), [(1, 1, 3, 70), pytest.param(2, 5, 1, 1000, marks=pytest.mark.slow)]
)
def test_healthy_logs_pass_silently(seed: int, repeat: int, every: int, logs: int) -> None:
    """None is refused, and at most 1 % get a note."""
    cases = [case for case in healthy_cases(seed, repeat) if case[0] not in REMARKED][::every]
    results = [said(coarse(*case)) for case in cases]
    assert len(results) >= logs
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
NO_RUNS = "No column 'run': a run begins where t_s starts again or text has an empty line or names again."


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
