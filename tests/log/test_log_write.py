"""A file is there whole or not at all, and a failure leaves the old one as it was."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from log_samples import refusal, stage_arrays

from hallsym.files import atomic_write
from hallsym.log import LogWriter, read_log, write_log
from hallsym.log.write import WRITERS


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.parametrize("method", ["write_table", "close"])
def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, method: str) -> None:
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"old")
    real = WRITERS[suffix[1:]]

    def made(*given: Any) -> Any:
        writer = real(*given)

        def full(*tables: Any) -> None:
            getattr(writer, method)(*tables)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        own = {"write_table": writer.write_table, "close": writer.close, method: full}
        return SimpleNamespace(**own)

    monkeypatch.setitem(WRITERS, suffix[1:], made)
    with refusal(r"Cannot write .*: the disk is full"):
        write_log(stage_arrays(), path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == [path.name]


def test_nothing_appears_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    with LogWriter(path) as writer:
        writer.append({"x_ref_m": np.arange(3.0)})
        assert not path.exists()
    assert read_log(path).array("x_ref_m").tolist() == [0.0, 1.0, 2.0]
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~_umask()


def test_an_error_in_the_block_goes_through_and_leaves_nothing(tmp_path: Path) -> None:
    def record() -> None:
        with LogWriter(tmp_path / "log.csv") as writer:
            writer.append({"x_ref_m": np.arange(3.0)})
            raise FileNotFoundError("elsewhere")

    with pytest.raises(FileNotFoundError, match="elsewhere"):
        record()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        ([], "Nothing was written"),
        ([{"x_ref_m": np.zeros(2), "y_ref_m": np.zeros(3)}], r"equally long; instead received \[2, 3\]"),
        ([{"x_ref_m": np.zeros(2)}, {"y_ref_m": np.zeros(2)}], "must have the columns x_ref_m"),
        ([{"HallA": np.zeros(2)}], "must end with the unit"),
        ([{"x_ref_m": np.zeros((2, 2))}], "must be a vector"),
        ([{"run": np.array([0.5]), "x_ref_m": np.zeros(1)}], "run must hold whole numbers"),
    ],
)
def test_misuse(tmp_path: Path, pieces: list[dict[str, np.ndarray]], says: str) -> None:
    def record() -> None:
        with LogWriter(tmp_path / "log.csv") as writer:
            for piece in pieces:
                writer.append(piece)

    with refusal(says):
        record()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "says"),
    [("missing/a.txt", "its folder does not exist"), ("", "it is a folder"), ("f/a", "is a file")],
)
def test_impossible_targets(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "f").write_text("")
    with refusal(f"Cannot write .*{says}"):
        atomic_write(tmp_path / name, "text")


def test_atomic_write(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for content in ("µm", "µm".encode(), lambda temporary: temporary.write_text("µm", encoding="utf-8")):
        atomic_write(path, content)
        assert path.read_text(encoding="utf-8") == "µm"
    link = tmp_path / "link.txt"
    link.symlink_to(path)
    atomic_write(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"

    def fails(temporary: Path) -> None:
        temporary.write_text("half")
        raise KeyError("bug")

    with pytest.raises(KeyError):
        atomic_write(path, fails)
    assert path.read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "link.txt"]


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
