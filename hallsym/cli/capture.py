"""`hallsym capture`: lines of numbers from a serial port, as a log.

Write the lines of numbers that a board prints on a serial port as a log (.parquet or .csv), until
Ctrl-C, --lines or --duration. Numbers are separated by commas, semicolons, tabs or blanks; labels
before them (sin:0.31) are left out. Lost lines and lines without numbers are counted and reported.
"""

import math
import signal
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from hallsym.cli import NOT_DETERMINED, OK
from hallsym.cli.common import progress_of, say
from hallsym.errors import quoted, require
from hallsym.log import LogWriter
from hallsym.log.capture import Lines, capture, checked, open_port
from hallsym.report.words import number

EPILOG = """\
examples:
  hallsym capture /dev/ttyACM0 --columns v_sin_v,v_cos_v,angle_ref_deg -o log.parquet     until Ctrl-C
  hallsym capture /dev/ttyUSB0 --baud 1000000 --columns counter,t_us,angle_count,skip --lines 50000 -o log.csv
needs: pip install 'hallsym[capture]'
"""


OPTIONS = """
port PORT                       such as /dev/ttyACM0, COM3, or socket://host:port
--baud N <int=115200>           bits a second (default 115200)
--columns NAMES <required>      names of the numbers of a line, with their units: v_sin_mv,v_cos_mv.
    The board's own time is t_s, t_ms or t_us; without it t_s is the time of arrival. 'counter'
    counts lines, so that lost ones are reported; 'skip' is not kept
-o, --output LOG <required>     log to write: .parquet or .csv
--lines N <int>                 end after so many lines
--duration S <float>            end after so many seconds
--wait S <float=5.0>            seconds to wait for the first line (default 5)
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    names = checked([name.strip() for name in options.columns.split(",")])
    require(options.lines is None or options.lines > 0, "--lines", "a positive number", options.lines)
    for option in ("duration", "wait"):
        value = getattr(options, option)
        require(value is None or 0 < value < math.inf, f"--{option}", "a positive number of seconds", value)
    writer = LogWriter(options.output)  # which refuses other formats before anything is recorded
    with open_port(options.port, options.baud) as port, stopping() as stopped, writer:
        found = capture(
            port, writer, names, where=quoted(options.port), lines=options.lines, duration_s=options.duration,
            patience_s=options.wait, stopped=stopped, show=progress_of(options),
        )  # fmt: skip
    counts = {n: getattr(found, n) for n in ("good", "bad", "lost", "seconds", "fault")}
    record = {"log": str(options.output), "columns": list(names), **counts}
    text = f"{found.good} lines in {found.seconds:.1f} s, {found.good / found.seconds:.0f} a second"
    say(options, record, lambda: text, notes=[*_notes(found)], wrote=[options.output])
    return NOT_DETERMINED if found.lost or found.bad or found.fault else OK


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Let the first Ctrl-C end the capture, and write the received lines; a second one acts as before."""
    pressed: list[int] = []
    before: Any = None

    def stop(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        signal.signal(signal.SIGINT, before)

    with suppress(ValueError):  # not the main thread
        before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: bool(pressed)
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def _notes(found: Lines) -> Iterator[str]:
    if found.fault:
        yield f"The port was lost ({found.fault}); what came until then is written."
    if found.bad:
        yield f"Lines without these numbers, such as {found.example!r}, are left out: {found.bad}."
    if found.lost:
        share = 100 * found.lost / (found.good + found.lost)
        yield (
            f"{found.lost} lines are missing ({number(share, 2)} %): the board prints more than the port "
            "carries; raise --baud on both sides, or print less."
        )
    if found.counter is None:
        yield (
            "Whether lines were lost is not known: let the board print a line counter, named 'counter' in "
            "--columns, or its own time, in which 'hallsym info' finds gaps."
        )
