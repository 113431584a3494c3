"""Lack of fit: does what a model leaves depend on anything? The curves of a localisation are held against it.

What a curve over a coordinate (`curves`), or a gain of every run, predicts on runs (or stretches) that it was
not fitted on is lack of fit, whatever the noise floor is said to be; its p-value rests on signs, so it is
honest for noise that is correlated in time. Memory is constant.
"""

from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.coordinates import coordinates
from hallsym.diagnosis.curves import over, run_gains
from hallsym.diagnosis.residual_table import residual_table
from hallsym.diagnosis.residuals import Base, found_once
from hallsym.diagnosis.tones import tones


@dataclass(frozen=True)
class Key:
    """A family of curves: `kind` says what the residual may depend on, `name` which one of that kind."""

    kind: str
    name: str = ""


@dataclass(frozen=True)
class Shape:
    """How far a family of curves lowers the residual (rms) of runs it was not fitted on, and its p-value."""

    key: Key
    drop: float
    p_value: float


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Families of curves, best first; `tones`: decrease of the gap metric without its steady tones."""

    shapes: tuple[Shape, ...]
    tones: float = 0.0

    def best(self, level: float) -> Shape | None:
        """Return the family that explains most and is no chance (level corrected for all tried)."""
        tried = max(len(self.shapes), 1)
        return next((s for s in self.shapes if s.p_value * tried < level and s.drop > 0), None)


@found_once
def lack_of_fit(base: Base, runs: frozenset[int]) -> LackOfFit:
    """Hold the families of curves against what `base` leaves on `runs`."""
    r = residual_table(base, runs)
    if r is None:
        return LackOfFit(())
    total = max(float(r.squares.sum()), 1e-300)
    explained, z = run_gains(r, r.residual)
    found = [(Key("run", "gain of its own"), explained, float((z >= z[0]).mean()))]
    for c in coordinates(r):
        kind = "place" if c.fine and not c.own else c.name  # those along several axes are one shape
        curves = [each.curve(r.residual) for each in over(r, c)]
        found += [(Key(kind, c.name), x.explained, x.p_value) for x in curves]
    shapes = [Shape(key, 1 - float(np.sqrt(1 - np.clip(x / total, 0.0, 1.0))), p) for key, x, p in found]
    return LackOfFit(tuple(sorted(shapes, key=lambda s: -s.drop)), tones(base, runs))
