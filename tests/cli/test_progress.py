"""Progress: one redrawn line on a terminal, elsewhere nothing unless asked; and how work is cancelled."""

import io
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hallsym.cli import INTERRUPTED
from hallsym.cli.progress import ASKED, EVERY_S, Meter
from hallsym.output import Step, said_time

ROOT = Path(__file__).parents[2]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(stream: io.StringIO, steps) -> str:
    clock = [0.0]
    meter = Meter(stream, lambda: clock[0])
    for at, text in steps:
        clock[0] = at
        meter(text)
    meter.end()
    return stream.getvalue()


def work(seconds: float):
    return [(t, Step(f"summarising runs, {100 * t // seconds} %", t / seconds)) for t in range(int(seconds))]


def test_off_a_terminal_nothing_is_said_unless_asked_and_then_every_few_seconds(monkeypatch):
    assert shown(io.StringIO(), work(20)) == ""
    monkeypatch.setenv(ASKED, "1")
    assert shown(io.StringIO(), work(4)) == ""  # short work
    lines = shown(io.StringIO(), work(20)).splitlines()
    assert len(lines) == 20 // EVERY_S - 1
    assert lines[0] == "hallsym: summarising runs, 25 %, 15 s left"
    assert not any("\r" in line or "\033" in line for line in lines)


def test_on_a_terminal_one_line_is_drawn_again_and_taken_away(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    text = shown(Terminal(), [(t, Step(f"{s}, {'and so on ' * 4}", s.share)) for t, s in work(20)])
    assert "\n" not in text
    drawn = text.split("\r\033[K")
    assert drawn[-1] == ""
    assert len(drawn) > 15
    assert max(map(len, drawn)) < 40


def test_work_whose_end_is_not_known_says_how_long_it_took(monkeypatch):
    monkeypatch.setenv(ASKED, "1")
    steps = [(0.0, "testing 30 effects"), (EVERY_S, "testing 30 effects, beside 1")]
    assert shown(io.StringIO(), steps) == "hallsym: testing 30 effects, beside 1, 5 s so far\n"


def test_work_that_says_nothing_for_long_is_shown_again_until_it_ends(monkeypatch):
    monkeypatch.setattr("hallsym.cli.progress.LEAST_S", 0.01)
    stream = Terminal()
    meter = Meter(stream)
    meter("testing 30 effects")
    end = time.monotonic() + 10
    while stream.getvalue().count("s so far") < 3 and time.monotonic() < end:
        time.sleep(0.01)
    meter.end()
    text = stream.getvalue()
    assert text.count("testing 30 effects") > 3
    time.sleep(0.05)
    assert stream.getvalue() == text


def test_times_are_said_in_units_that_suit_them():
    assert [said_time(t) for t in (0.4, 89, 600, 86400)] == ["0 s", "89 s", "10 min", "24 h 0 min"]


@pytest.mark.parametrize("terminal", [pytest.param(False, marks=pytest.mark.slow), True])
def test_control_c_ends_with_130_one_sentence_and_no_file(tmp_path, terminal):
    """A simulation that would take minutes is interrupted while it writes."""
    ours, theirs = pty.openpty() if terminal else os.pipe()
    words = ["simulate", "-o", str(tmp_path / "log.csv"), "--step=2.5e-6", "--seed=1"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    child = subprocess.Popen([sys.executable, "-m", "hallsym", *words], stderr=theirs, env=env)
    os.close(theirs)
    end = time.monotonic() + 120
    while not list(tmp_path.glob(".hallsym-*")) and child.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    assert list(tmp_path.glob(".hallsym-*")), "nothing was begun"
    time.sleep(0.3)
    child.send_signal(signal.SIGINT)
    assert child.wait(60) == INTERRUPTED == 130
    said = b""
    while True:
        try:
            piece = os.read(ours, 4096)
        except OSError:  # what a terminal says at its end
            break
        if not piece:
            break
        said += piece
    os.close(ours)
    last = said.decode().replace("\r\n", "\n").split("\r\033[K")[-1]
    assert last == "hallsym: interrupted; nothing was written.\n"
    assert list(tmp_path.iterdir()) == []
