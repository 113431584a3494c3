"""Each threshold from both sides, by less than a factor two: what is said, and whether the log is refused."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from mistakes import Arrays, base, now_and_then, of_run, rails, scale, without_rows

from hallsym.errors import InputError
from hallsym.log import Log, check_log

A, B = "hall_a_m", "hall_b_m"


def lost(share: float) -> Callable[[Arrays], Arrays]:
    """One sample in so many is lost."""
    return lambda a: {c: v[np.arange(len(v)) % round(1 / share) != 7] for c, v in a.items()}


def frozen(column: str, length: int, share: float = 0.0) -> Callable[[Arrays], None]:
    """A column holds one value for `length` samples: in one run, or in so many runs that it is a share."""

    def make(arrays: Arrays) -> None:
        rows = len(arrays["run"])
        runs = max(round(share * rows / length), 1)
        for run in range(runs):
            here = of_run(run, 100, 100 + length)(arrays)
            arrays[column][here] = arrays[column][here.start]

    return make


def every(step: int) -> Callable[[Arrays], Arrays]:
    """Runs of a few samples: every so many of each."""
    return lambda a: {c: v[::step] for c, v in a.items()}


def levels(count: int) -> Callable[[Arrays], None]:
    """A reading takes so many values."""

    def make(arrays: Arrays) -> None:
        x = arrays[A]
        step = np.ptp(x) / (count - 1)
        arrays[A] = x.min() + step * np.round((x - x.min()) / step)

    return make


def again(rows: int) -> Callable[[Arrays], None]:
    """Readings and references of a stretch of one run are those of another run."""

    def make(arrays: Arrays) -> None:
        source, to = (of_run(run, 50, 50 + rows)(arrays) for run in (0, 3))
        for column in arrays:
            if column not in ("run", "t_s"):
                arrays[column][to] = arrays[column][source]

    return make


SIDES = (
    ("1.4 % of the samples lost", lost(0.014), "misses .* ticks", False),
    ("3 % of the samples lost", lost(0.03), "misses .* ticks", True),
    ("4 % on the rails", rails((A,), 0.04), "is saturated", False),
    ("7 % on the rails", rails((A,), 0.07), "is saturated", True),
    ("4 % frozen", frozen(A, 200, 0.04), "holds one value", False),
    ("7 % frozen", frozen(A, 200, 0.07), "holds one value", True),
    ("9 equal values", frozen(A, 9), "holds one value", False),
    ("6 equal values", frozen(A, 6), None, False),
    ("a run of 40 samples of 500", without_rows(3, 40), "Run 3 .* has 40 samples", False),
    ("a run of 70 samples of 500", without_rows(3, 70), None, False),
    ("runs of 13 samples", every(40), "usual run .* has 13 samples", False),
    ("runs of 20 samples", every(25), None, False),
    ("six values", levels(6), "takes 6 values only", False),
    ("twelve values", levels(12), None, False),
    ("3 % old values", now_and_then(B, 0.03), "repeats the value before it", False),
    ("1.6 % old values", now_and_then(B, 0.016), None, False),
    ("120 rows again", again(120), "120 samples .* are there twice", True),
    ("40 rows again", again(40), None, False),
    ("a tick of .7 s", scale("t_s", 350.0), None, False),
    ("a tick of 1.5 s", scale("t_s", 750.0), "has a usual step of 1.5 s", False),
    ("a tick of 70 s", scale("t_s", 35e3), "has a usual step of 70 s", False),
    ("a tick of 150 s", scale("t_s", 75e3), "its usual step is 150 s", True),
)  # fmt: skip


@pytest.mark.parametrize(("make", "says", "refused"), [pytest.param(*s[1:], id=s[0]) for s in SIDES])
def test_a_threshold_from_both_sides(make, says: str | None, refused: bool) -> None:
    arrays, noise = base("57 runs")
    changed = make(arrays)
    log = Log.from_arrays(arrays if changed is None else changed, noise)
    try:
        said, ends = check_log(log), False
    except InputError as error:
        said, ends = [str(error)], True
    assert (len(said), ends) == (int(says is not None), refused), said
    assert says is None or re.search(says, said[0])
