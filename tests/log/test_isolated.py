"""Files that are decoded in a process of its own: the same columns, and a death that is one sentence."""

import os
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.log import isolated
from hallsym.log.formats import Guarded
from hallsym.log.isolated import Isolated
from hallsym.log.table import Arrays

posix = pytest.mark.skipif(sys.platform != "linux", reason="limits of a process")


def vectors(path: Path) -> Arrays:
    return Arrays({"a_m": np.arange(6.0)[::2], "b": np.arange(3, dtype=">i4"), "c": np.ones(3, bool)})


def crashing(path: Path) -> Arrays:
    os.abort()


def endless(path: Path) -> Arrays:
    isolated.SECONDS = 1
    isolated._limit(0)
    while True:
        pass


def hungry(path: Path) -> Arrays:
    return Arrays({"a_m": np.ones(4 << 30)})


def roomy(path: Path) -> Arrays:
    np.zeros(2 << 30, np.uint8)
    return vectors(path)


def talking(path: Path) -> Arrays:
    os.write(1, b"a library says something\n")
    raise ValueError("no magic number\n at 0")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "log.bin").write_bytes(b"1234")
    return tmp_path / "log.bin"


def test_columns_are_those_of_the_reader(path: Path) -> None:
    found, own = Isolated(vectors, path), vectors(path)
    assert (tuple(found.names), found.rows, found.count(), found.small) == (own.names, 3, 3, True)
    for name, values in own.columns.items():
        read = found.read([name])[name]
        assert read.dtype == values.dtype
        assert np.array_equal(read, values)
        read[0] = 7


@pytest.mark.slow
@posix
@pytest.mark.parametrize(
    ("reader", "why"),
    [
        (crashing, r"it is damaged \(decoding it crashed with SIGABRT\)"),
        (endless, r"it is damaged \(decoding it takes more than 60 s\)"),
        (hungry, "needs more memory than there is"),
        (talking, r"it is damaged \(no magic number at 0\)"),
    ],
)
def test_a_file_that_kills_its_decoder_is_one_sentence(path: Path, reader, why: str) -> None:
    with pytest.raises(InputError, match=rf"Log .*log\.bin {why}"):
        Guarded(path, partial(Isolated, reader), "it is damaged")
    assert Guarded(path, partial(Isolated, vectors), "").names == ("a_m", "b", "c")


@posix
def test_a_large_file_may_take_more_memory(path: Path) -> None:
    with pytest.raises(MemoryError):
        Isolated(roomy, path)
    os.truncate(path, 256 << 20)
    assert Isolated(roomy, path).rows == 3


def test_one_decoder_serves_file_after_file_and_keeps_none_open(path: Path) -> None:
    isolated.end_decoders()
    for k in range(3):
        path.write_bytes(bytes(k + 1))
        source = Isolated(vectors, path)
        assert next(source.chunks(["b"], 2))["b"].tolist() == [0, 1, 2]
    (decoder,) = isolated._IDLE
    assert decoder.ready
    assert decoder.ask("next", source._file) is None  # what nobody reads on is ended
