"""`hallsym capture` over pseudo-terminals, which carry what is written as a board's port does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.log import LogWriter, read_log
from hallsym.log.capture import LONGEST, WRAPS, Lines, capture

ROOT = Path(__file__).resolve().parents[2]


def rows_of(reader: Lines, *pieces: bytes) -> list[list[float]]:
    """The rows of some pieces of bytes; the end of a line comes before them."""
    return [row for piece in (b"\n", *pieces) for row in reader.rows(piece)]


# -- lines -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line", [b"1,-2.5,3e-2", b"1; -2.5; 3e-2", b" 1\t-2.5  3e-2 ", b"sin:1,cos:-2.5,t=3e-2", b"1,-2.5,3e-2\r"]
)
def test_numbers_of_a_line_however_they_are_separated(line: bytes) -> None:
    assert rows_of(Lines(3), line + b"\n") == [[1.0, -2.5, 0.03]]


def test_lines_come_in_pieces_and_the_first_may_be_the_end_of_one() -> None:
    reader = Lines(2)
    assert reader.rows(b"5,6\n1,") == []
    assert reader.rows(b"2\n3,4\n5") == [[1.0, 2.0], [3.0, 4.0]]
    assert reader.rows(b"0,6\n", most=2) == []
    assert reader.rows(b"7,8\n") == [[7.0, 8.0]]
    assert (reader.good, reader.bad) == (3, 0)


def test_bad_lines_are_counted_after_the_first_good_one() -> None:
    reader = Lines(2)
    rows = rows_of(reader, b"Hello\n\n1,2\n1,2,3\nnonsense\n,\n3,4\n" + b"x" * (LONGEST + 1))
    assert rows == [[1.0, 2.0], [3.0, 4.0]]
    assert reader.bad == 4
    assert reader.other[3] == 1


@pytest.mark.parametrize("wrap", WRAPS)
def test_a_counter_tells_lost_lines_across_its_wrap(wrap: int) -> None:
    reader = Lines(2, counter=0)
    counts = [wrap - 3, wrap - 2, 1, 2, 5]
    assert len(rows_of(reader, b"".join(b"%d,1\n" % k for k in counts))) == 5
    assert reader.lost == 2 + 2
    rows_of(reader, b"0,1\n")  # the board began anew
    assert reader.lost == 4 or wrap == WRAPS[0]
    rows_of(reader, b"0.5,1\n")
    assert reader.bad == 1


class Played:
    """A port that gives pieces of bytes, one a read, on a clock of its own."""

    def __init__(self, *pieces: bytes | Exception, step: float = 0.1) -> None:
        self.pieces, self.step, self.t, self.in_waiting = list(pieces), step, 0.0, 0

    def read(self, size: int) -> bytes:
        self.t += self.step
        piece = self.pieces.pop(0) if self.pieces else b""
        if isinstance(piece, Exception):
            raise piece
        return piece

    def now(self) -> float:
        return self.t


def captured(path: Path, port: Played, columns: list[str], **how: Any) -> Lines:
    with LogWriter(path) as writer:
        return capture(port, writer, columns, where="board", now=port.now, **how)


def test_times_of_arrival_are_spread_over_lines_that_come_together(tmp_path: Path) -> None:
    port = Played(b"\n", b"1\n2\n", b"", b"3\n4\n5\n6\n")
    captured(tmp_path / "a.csv", port, ["v_sin_mv"], duration_s=0.45)
    log = read_log(tmp_path / "a.csv").run(0)
    np.testing.assert_allclose(log["t_s"], [0.1, 0.2, 0.25, 0.3, 0.35, 0.4], atol=1e-12)
    np.testing.assert_allclose(log["v_sin_v"], np.arange(1, 7) * 1e-3)


def test_the_boards_own_time_and_skipped_columns(tmp_path: Path) -> None:
    port = Played(b"\n", b"0,1000,7,1\n1,2000,7,2\n")
    found = captured(tmp_path / "a.parquet", port, ["counter", "t_us", "skip", "v_sin_v"], lines=2)
    log = read_log(tmp_path / "a.parquet")
    assert log.table.columns == ("run", "t_s", "v_sin_v")
    np.testing.assert_allclose(log.run(0)["t_s"], [1e-3, 2e-3])
    assert (found.good, found.lost) == (2, 0)


def test_a_port_that_is_lost_leaves_what_came(tmp_path: Path) -> None:
    found = captured(tmp_path / "a.csv", Played(b"\n1\n2\n", OSError("gone")), ["v_sin_v"])
    assert "unplugged" in found.fault
    assert len(read_log(tmp_path / "a.csv").run(0)["t_s"]) == 2
    with pytest.raises(InputError, match="there until a line comes"):
        captured(tmp_path / "b.csv", Played(b"\n", OSError("gone")), ["v_sin_v"])
    assert not (tmp_path / "b.csv").exists()


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        ([], "Nothing came from board"),
        ([b"\n" + b"1,2\n" * 12], r"have 2 numbers, such as '1,2', but --columns names 1"),
        ([b"\nready\nset\n"], "no lines of numbers, such as 'ready'"),
        ([b"\xf8\x00\xff" * 9], "--baud may be another"),
    ],
)
def test_what_is_no_log_is_said_and_nothing_is_written(
    pieces: list[bytes], says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=says):
        captured(tmp_path / "a.csv", Played(*pieces), ["v_sin_v"], patience_s=1.0)
    assert list(tmp_path.iterdir()) == []


# -- ports -----------------------------------------------------------------------------------------------


@contextmanager
def board(feed: Callable[[Callable[[bytes], None]], None]) -> Iterator[str]:
    """A pseudo-terminal that `feed(write)` plays, once somebody has opened it."""
    pytest.importorskip("serial")
    tty = pytest.importorskip("tty")
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    done = threading.Event()

    def write(data: bytes) -> None:
        while data:
            if done.is_set():
                raise OSError("the test is over")
            try:
                data = data[os.write(master, data) :]
            except BlockingIOError:  # a write that waits could not be ended
                time.sleep(5e-4)

    def play() -> None:
        try:
            feed(write)
        except OSError:
            return

    thread = threading.Thread(target=play, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        done.set()
        thread.join(5)
        os.close(slave)
        os.close(master)


def counting(rate: float | None, read: list[int] | None = None) -> Callable[[Callable[[bytes], None]], None]:
    """Lines `counter,sin,cos`, without end, at so many bytes a second; `read`: bytes that went out so far."""

    def feed(write: Callable[[bytes], None]) -> None:
        begin, sent, k = time.monotonic(), 0, 0
        while True:
            piece = b"".join(b"%d,%.5f,%.5f\n" % (j % 65536, np.sin(j * 1e-3), np.cos(j * 1e-3))
                             for j in range(k, k + 40))  # fmt: skip
            write(piece)
            k, sent = k + 40, sent + len(piece)
            if read is not None:
                read[:] = [sent]
            if rate:
                time.sleep(max(begin + sent / rate - time.monotonic(), 0.0))

    return feed


@pytest.mark.parametrize(
    ("rate", "lines"), [(1e5, 3000), (None, 30000)], ids=["1 Mbaud", "as fast as it goes"]
)
def test_nothing_is_lost_at_a_megabaud(rate: float | None, lines: int, tmp_path: Path, capsys) -> None:
    out = tmp_path / "log.parquet"
    words = [
        "--baud",
        "1000000",
        "--columns",
        "counter,v_sin_v,v_cos_v",
        "--lines",
        str(lines),
        "-o",
        str(out),
    ]
    begin = time.monotonic()
    with board(counting(rate)) as port:
        assert main(["capture", port, *words]) == 0
    seconds = time.monotonic() - begin
    log = read_log(out).run(0)
    assert len(log["t_s"]) == lines
    phase = np.unwrap(np.arctan2(log["v_sin_v"], log["v_cos_v"]))
    np.testing.assert_allclose(np.diff(phase), 1e-3, atol=3e-5)
    assert (np.diff(log["t_s"]) > 0).all()
    assert f"{lines} lines in" in capsys.readouterr().out
    if rate is None:  # 20 bytes a line; the read end must be faster than the port
        assert lines * 20 / seconds > 1e5


def test_ctrl_c_ends_the_capture_with_the_file_written(tmp_path: Path) -> None:
    out, read = tmp_path / "log.csv", [0]
    with board(counting(1e5, read)) as port:
        command = [sys.executable, "-m", "hallsym", "capture", port, "--columns", "counter,v_sin_v,v_cos_v"]
        running = subprocess.Popen(
            [*command, "-o", str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
        waiting = time.monotonic() + 120
        while read[0] < 50_000 and time.monotonic() < waiting:
            time.sleep(0.02)  # a terminal that nobody reads holds 4 kB
        assert not out.exists()
        running.send_signal(signal.SIGINT)
        said, complaint = running.communicate(timeout=120)
    assert running.returncode == 0, complaint
    assert "a second" in said
    assert list(tmp_path.iterdir()) == [out]
    assert len(read_log(out).run(0)["t_s"]) > 100


def test_ctrl_c_before_a_line_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        captured(tmp_path / "a.csv", Played(b"\n"), ["v_sin_v"], stopped=lambda: True)
    assert list(tmp_path.iterdir()) == []


def test_lost_and_bad_lines_are_told(tmp_path: Path, capsys) -> None:
    def feed(write: Callable[[bytes], None]) -> None:
        for k in range(10**6):
            write(b"junk\n" if k % 100 == 50 else b"%d,%d\n" % (2 * (k // 10) + k, k))
            time.sleep(2e-4)

    with board(feed) as port:
        words = ["--columns", "counter,v_sin_v", "--lines", "400", "-o", str(tmp_path / "a.csv")]
        assert main(["capture", port, *words]) == 3
    said = capsys.readouterr().out
    assert "lines are missing" in said
    assert "such as 'junk', are left out" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["/dev/ttyNONE"], "Port /dev/ttyNONE does not exist; there"),
        ([str(ROOT / "README.md")], "cannot be opened at 115200 baud"),
        (["/dev/ttyNONE", "--baud", "0"], "--baud must be bits a second"),
        (["/dev/ttyNONE", "--columns", "v_sin"], "must end with the unit"),
        (["/dev/ttyNONE", "--columns", "v_sin_v,v_sin_mv"], "different names of readings"),
        (["/dev/ttyNONE", "--columns", "counter"], "different names of readings"),
        (["/dev/ttyNONE", "--lines", "0"], "--lines must be a positive number"),
        (["/dev/ttyNONE", "--wait", "nan"], "--wait must be a positive number of seconds"),
        (["/dev/ttyNONE", "-o", "a.mat"], "end a.mat with .parquet or .csv"),
    ],
)
def test_a_port_that_cannot_be_read_is_said(
    words: list[str], says: str, capsys, monkeypatch, tmp_path
) -> None:
    pytest.importorskip("serial")
    monkeypatch.chdir(tmp_path)
    usual = {"--columns": "v_sin_v", "-o": "a.csv"}
    rest = [word for option, value in usual.items() if option not in words for word in (option, value)]
    assert main(["capture", *words, *rest]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("number", "says"), [(13, "dialout"), (16, "another program has it")])
def test_a_port_of_somebody_else(number: int, says: str, capsys, monkeypatch, tmp_path: Path) -> None:
    serial = pytest.importorskip("serial")

    def refused(*words: object, **options: object) -> None:
        raise serial.SerialException(number, "refused")

    monkeypatch.setattr(serial, "serial_for_url", refused)
    assert main(["capture", "/dev/ttyACM0", "--columns", "v_sin_v", "-o", str(tmp_path / "a.csv")]) == 2
    assert says in capsys.readouterr().err
