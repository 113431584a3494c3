"""Runs with too few samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.quality.findings import Finding, name_of, others
from hallsym.log.quality.scan import Scan

FEWEST_SAMPLES = 8
_CUT_SHORT = 0.1
"""Samples of a run over those of the usual run below which somebody, or something, ended it early."""
_FEW = 16
"""Samples of a run below which a frozen column, noise or a delay cannot be seen in it."""


def short_runs(log: Log, seen: Scan) -> Iterator[Finding]:
    """Runs with too few samples to say anything, or far fewer than the others."""
    samples = seen.samples
    short = [run for run, n in samples.items() if n < FEWEST_SAMPLES]
    if short:
        yield Finding(
            f"Every run of {name_of(log)} must have at least {FEWEST_SAMPLES} samples; run {short[0]} has"
            f" {samples[short[0]]}{others(short)}",
            True, Drop(runs=frozenset(short)) if len(short) < len(samples) else None,
            remedy="record longer runs",
        )  # fmt: skip
        return
    usual = float(np.median(list(samples.values())))
    cut = [run for run, n in samples.items() if n < _CUT_SHORT * usual]
    if cut:
        yield Finding(
            f"Run {cut[0]} of {name_of(log)} has {samples[cut[0]]} samples{others(cut)} where the usual run"
            f" has {usual:.0f}: it tells little more than its own zero",
            remedy="see whether its recording was cut short",
        )
    elif usual < _FEW and "t_s" in log.columns:
        yield Finding(
            f"The usual run of {name_of(log)} has {usual:.0f} samples: a frozen column, noise or a delay"
            " cannot be seen in so few",
            remedy="record longer runs if you can",
        )
    elif usual < _FEW:
        yield Finding(
            f"The usual part of {name_of(log)} has {usual:.0f} samples: a frozen column cannot be seen"
            " in so few",
            remedy="record more samples if you can",
        )
