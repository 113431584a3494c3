"""Hypothesis without a clock and with the same examples in every run; no progress on a busy machine."""

from collections.abc import Iterator

import pytest
from hypothesis import settings

from hallsym.cli import progress

settings.register_profile("hallsym", deadline=None, derandomize=True)
settings.load_profile("hallsym")


@pytest.fixture(scope="session", autouse=True)
def _no_progress() -> Iterator[None]:
    """Let a command that is slow on a busy machine write no line of progress beside its one sentence."""
    every, progress.EVERY_S = progress.EVERY_S, float("inf")
    yield
    progress.EVERY_S = every
