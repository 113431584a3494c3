"""Hypothesis without a clock and with the same examples in every run.

Output has the width of a pipe, none, and Ctrl-C ends a program, wherever the tests are started from.
"""

import gc
import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from hallsym.errors import commanded

MANY = 100 if os.environ.get("CI") == "true" else 40
"""Examples of a property whose test states no number: the first of the same sequence."""

settings.register_profile("hallsym", deadline=None, derandomize=True, max_examples=MANY)
settings.load_profile("hallsym")


def pytest_collection_finish() -> None:
    """Leave out what lives as long as the tests, modules and items, of every later search for garbage."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _commanded() -> Iterator[None]:
    """Let errors read as commands print them; `test_shown.py` looks at those of Python."""
    with commanded():
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_terminal() -> None:
    """Let nothing be folded: pytest-xdist states the width of its own terminal to its workers."""
    os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="session", autouse=True)
def _control_c() -> None:
    """Let programs that tests start heed Ctrl-C: a shell ignores it in a job in the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
