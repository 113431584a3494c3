"""Why an encoder does not follow its reference: another unit or scale, in the whole log or in some runs."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from math import pi

import numpy as np

from hallsym.families.rotary.seen import Seen
from hallsym.model import Model

UNITS = {"": 1.0, "deg": pi / 180, "grad": pi / 200, "mdeg": pi / 180e3, "mrad": 1e-3, "urad": 1e-6,
         "arcmin": pi / 10800, "arcsec": pi / 648e3, "rev": 2 * pi, "rad": 180 / pi}  # fmt: skip
"""Unit that an angle may be in where rad is said -> rad; "rad": where degrees are said. Likelier ones first:
whole numbers of other units are whole numbers of turns, so that these come before."""
RATIOS = tuple(range(2, 13))
"""Other counts of turns: pole pairs, gears, counts of another resolution."""
TOGETHER = 0.75
"""An encoder follows its reference within a run if the mean of exp(i (angle - reference)) is longer: 43 deg
of scatter, far beyond any offset, gain or clipping."""
SPAN = 2 * pi / 3
"""Span of angles [rad] below which they are near each other, whatever they are of."""
TRIED, ALIKE = 4096, 0.01
"""Samples that units are tried on, and lengths by which two causes are the same; the plainer one is named."""


@dataclass(frozen=True)
class Cause:
    """What puts an encoder right: units of angle and reference, or its turns per turn of the reference.

    "" stands for a column that is as it says. `length`: of the mean of exp(i (angle - reference)) then.
    """

    length: float
    angle: str = ""
    reference: str = ""
    turns: float = 0.0


def cause(seen: Seen, model: Model, runs: Collection[int] | None = None) -> Cause | None:
    """Return the plainest cause that makes the encoder follow its reference in some runs (default: all)."""
    run, angle, reference = seen.some.values
    kept = np.ones(len(run), dtype=bool) if runs is None else np.isin(run, list(runs))
    every = max(1, int(kept.sum()) // TRIED)
    run, angle, reference = (v[kept][::every] for v in (run, angle, reference))
    if not len(run):
        return None
    found = [c for c in _causes(run, angle, reference, len(model.channels) == 1) if c.length > TOGETHER]
    best = max((c.length for c in found), default=0.0)
    return next((c for c in found if c.length > best - ALIKE), None)


def _causes(run: np.ndarray, angle: np.ndarray, reference: np.ndarray, read: bool) -> Iterator[Cause]:
    """Yield causes, the plainest first: a unit of one column, both columns in one unit, other turns."""
    others = [unit for unit in UNITS if unit]
    pairs = [("", unit) for unit in others]
    if read:
        pairs += [(unit, "") for unit in others] + [(unit, unit) for unit in others]
        pairs += [(a, b) for a in others for b in others if a != b]
    starts = np.flatnonzero(np.r_[True, np.diff(run) != 0])

    def length(a: np.ndarray, b: np.ndarray) -> float:
        if min(np.ptp(a), np.ptp(b)) < SPAN:
            return 0.0
        turns = (np.add.reduceat(np.exp(1j * (a - sign * b)), starts) for sign in (1, -1))
        return max(float(np.abs(sums).sum()) for sums in turns) / len(run)

    for mine, theirs in pairs:
        yield Cause(length(UNITS[mine] * angle, UNITS[theirs] * reference), mine, theirs)
    for many in RATIOS:
        yield Cause(length(angle, many * reference), turns=float(many))
        yield Cause(length(many * angle, reference), turns=1.0 / many)
