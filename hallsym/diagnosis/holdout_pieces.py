"""A recording of one or two runs, taken to pieces that can be held out: a turn of a shaft, a table of knots.

Only for models whose runs have nothing of their own (no zeros): any piece then judges a fit of the others.
"""

from dataclasses import replace

import numpy as np

from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.regression import FOLDS
from hallsym.errors import counted
from hallsym.log import Log
from hallsym.log.quality.runs import FEWEST_SAMPLES

FEWEST = POLICY.fewest * FEWEST_SAMPLES
"""Samples that a recording must have to be taken to pieces."""
BLOCK = 4
"""Knots of a block. Every second is held out, the other ones in the next block, so that a pattern of two or
four knots (a stepper's) is seen on both sides."""
SLICES = 100
"""Slices of time that a recording is taken as at most: a score of 50 scatters as Gauss has it."""
LASTING = 40
"""Samples of a slice at least: four memories of noise that remembers ten, so that slices are independent."""
TIME = "t_s"


def split(log: Log, spikes: np.ndarray | None = None) -> tuple[Log, tuple[int, ...]]:
    """Return the log in pieces as runs, with a note that says how it was done, and the pieces to hold out.

    With time, pieces are stretches of it, every second held out. Without, samples are knots: every second is
    held out, and a counter stands for the time that the log does not have. `spikes` (samples,) are left out.
    """
    n, timed = log.rows, TIME in log.columns
    at, count = np.arange(n), pieces(n, timed)
    piece = at * count // n if timed else knot_group(at, count)
    held = tuple(range(1, count, 2))
    order = np.argsort(piece, kind="stable")
    notes = []
    if spikes is not None and spikes.any():
        order = order[~spikes[order]]
        gone = int(spikes.sum())
        are = "is an isolated spike and was" if gone == 1 else "are isolated spikes and were"
        notes.append(f"{gone} of {n} knots {are} left out.")
    columns = {c: log.array(c)[order] for c in log.columns if c != "run"}
    columns = {TIME: at[: len(order)].astype(float)} | columns | {"run": piece[order]}
    how = f"{count} {'slices of time' if timed else 'groups of single knots, each round the turn'}"
    short = Log.from_arrays(columns, log.noise, replace(log.meta, holdout=held), log.name)
    short = of_recording(short) if timed else short
    what = counted(len(log.runs), "run") if timed or len(log.runs) > 1 else "A table of knots"
    notes.append(f"{what} cannot be held out whole: taken as {how}, every other one held out.")
    return replace(short, notes=(*log.notes, *notes), path=log.path, counted=not timed), held


def of_recording(log: Log) -> Log:
    """Return a log whose runs are slices of one recording, one after the other, with that recording."""
    whole = {c: log.array(c) for c in log.columns if c != "run"} | {"run": np.zeros(log.rows, dtype=int)}
    return replace(log, recording=Log.from_arrays(whole, log.noise, log.meta, log.name))


def counted_off(log: Log) -> Log:
    """Return a log without time with a counter in its place; its runs stay."""
    columns = {TIME: np.arange(log.rows, dtype=float)} | {c: log.array(c) for c in log.columns}
    counter = Log.from_arrays(columns, log.noise, log.meta, log.name)
    return replace(counter, notes=log.notes, path=log.path, counted=True)


def pieces(n: int, timed: bool) -> int:
    """How many pieces of `n` samples: those fitted are the folds, or as many as have the samples of a run.

    With time there are up to `SLICES` of them: of a machine that rests half of the time many still say
    something. Of knots an odd number is fitted, so that each group takes every phase of a pattern of two or
    four; groups go round the turn, so that waves of it do not lean on another.
    """
    if timed and n >= 2 * FOLDS * LASTING:
        return min(SLICES, n // LASTING // 2 * 2)
    at = np.arange(n)
    for count in range(2 * FOLDS, POLICY.fewest, -4):  # half of it stays odd
        smallest = n // count if timed else int(np.bincount(knot_group(at, count), minlength=count).min())
        if smallest >= FEWEST_SAMPLES:
            return count
    return POLICY.fewest


def knot_group(at: np.ndarray, count: int) -> np.ndarray:
    """Return the group of `count` that each knot belongs to; odd groups are held out."""
    return 2 * (at // 2 % (count // 2)) + (at + at // BLOCK) % 2
