"""Features that a lack of fit is looked for with: functions of the pose, its motion, the state and time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from hallsym.diagnosis.coordinates import KNOTS, hats
from hallsym.diagnosis.residual_table import at_rest
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.model.arrays import on_arrays
from hallsym.units import readable

WAVES = 12
"""Waves per period up to which the error of what is periodic is a series: smooth, in few samples."""
HARMONICS = (1, 2)
"""Waves per period that a gain may follow."""
REVERSAL = 0.05
"""Part of the greatest speed within which the direction of motion turns over."""
TOGETHER, DEGREE = 128, 4
"""Products of coordinates that an error may follow together: up to `DEGREE`, and fewer than these in all."""
TIMES = (3, 12)
"""Knots over the time of the log: one for three runs, within these."""


@dataclass(frozen=True)
class Key:
    """A family of features: `kind` says what the residual may depend on, `name` which one of that kind."""

    kind: str
    name: str = ""


class Features:
    """Features of each stretch of some runs of a log."""

    def __init__(self, base: Base, runs: frozenset[int]) -> None:
        """Read the ranges that features are scaled by."""
        self.base, self.model = base, base.model
        self.read = on_arrays(base.model.reading)
        self.ranges = _ranges(base, runs)
        self.periodic = [c for c in self.model.references if c in self.model.period]
        self.turning = len(self.periodic) == len(self.model.references)
        self.times = np.linspace(-1, 1, int(np.clip(len(runs) // 3, *TIMES)))

    def quiet(self, piece: Piece) -> Piece:
        """Take from the coordinates what noise they share with the residual.

        The reference is smoothed, an axis whose motion is its noise is at rest, and readings are the ones
        expected there: else the noise of a coordinate would explain itself.
        """
        base, model, data = self.base, self.model, dict(piece.data)
        for c in model.references:
            smooth = at_rest(data[f"d0_{c}"], base.sigma.get(c, 0.0))
            if smooth is not data[f"d0_{c}"]:
                data |= {f"d{k}_{c}": np.zeros(len(smooth)) for k in (1, 2, 3)}
            data[c] = smooth
        pose, state = ([data[c] for c in columns] for columns in (model.references, model.state))
        (expected,) = self.read(base.p, base.zeros_in(piece.run), pose, state)
        return replace(piece, data=data, readings=expected)

    def unit(self, piece: Piece, column: str) -> np.ndarray:
        """Return a column scaled to -1 .. 1 over its range."""
        middle, half = self.ranges[column]
        return (piece.data[column] - middle) / half

    def moved(self, piece: Piece) -> np.ndarray:
        """Return where the pose was: coordinates over their ranges, harmonics of what is periodic."""
        rows = []
        for c in self.model.references:
            if c in self.periodic:
                angles = [2 * np.pi * n / self.model.period[c] * piece.data[c] for n in HARMONICS]
                rows += [f(angle) for angle in angles for f in (np.cos, np.sin)]
            else:
                rows.append(self.unit(piece, c))
        return np.array(rows)

    def lines(self, piece: Piece) -> dict[Key, np.ndarray]:
        """Return coordinates that the residual may follow in any way, each scaled to 0 .. 1."""
        model = self.model
        out = {
            Key("place", _name(c)): piece.data[c] / model.period[c] % 1.0
            if c in self.periodic
            else (self.unit(piece, c) + 1) / 2
            for c in model.references
        }
        if self.turning:
            return out
        for k, c in enumerate(model.channels):
            middle, half = self.ranges[c]
            out[Key("reading", c)] = ((piece.readings[k] - middle) / half + 1) / 2
        return {key: np.clip(x, 0.0, 1.0) for key, x in out.items()}

    def families(self, piece: Piece) -> Iterator[tuple[Key, np.ndarray]]:
        """Yield families of few functions, each (n_functions, samples)."""
        timed, q = self.base.timed, self.moved(piece)
        v, a, j = (np.array([piece.data[f"d{k}_{c}"] / self.ranges[f"d{k}_{c}"][1]
                             for c in self.model.references]) for k in (1, 2, 3))  # fmt: skip

        def both(x: np.ndarray) -> np.ndarray:
            """Offsets and gains."""
            return np.vstack([x, *(x * row for row in q)])

        if self.periodic:
            turns = [2 * np.pi / self.model.period[c] * piece.data[c] for c in self.periodic]
            orders = np.arange(1, WAVES + 1)[:, None]
            yield Key("waves"), np.vstack([f(orders * u) for u in turns for f in (np.cos, np.sin)])
        if not self.turning:
            yield Key("the pose together"), powers(q, _degree(len(q)))
        states = self.states(piece)
        if not self.turning and states:
            s = powers(np.array([self.unit(piece, c) for c in states]), 3)
            yield Key("the state"), np.vstack([s, *(s * x for x in q), q])
        if "temperature_degc" in piece.data:
            w = both(powers(self.unit(piece, "temperature_degc")[None], 3))
            yield Key("temperature"), w if self.turning else np.vstack([w, q])
        if not timed:  # a counter stands for the time
            return
        yield Key("time"), both(hats(self.unit(piece, "t_s"), self.times))
        if self.turning:
            yield Key("velocity"), both(np.vstack([v, np.abs(v), v * np.abs(v), v**3]))
            yield Key("direction of motion"), both(np.tanh(v / REVERSAL))
            yield Key("acceleration"), both(np.vstack([a, np.abs(a)]))
            return
        fast = [*(v * x for x in q), *(np.abs(v) * x for x in q)]
        yield Key("velocity"), np.vstack([v, np.abs(v), v * np.abs(v), v**3, *fast])
        places = [hats(self.unit(piece, c), np.linspace(-1, 1, KNOTS)) for c in self.model.references]
        sides = [d * x for d, x in zip(np.tanh(v / REVERSAL), places, strict=True)]
        yield Key("direction of motion"), np.vstack(sides)
        yield Key("acceleration"), np.vstack([a, np.abs(a), j, *(a * x for x in q), *(j * x for x in q)])

    def states(self, piece: Piece) -> list[str]:
        """Return the logged columns of the state that have no family of their own."""
        others = {*(c.name for c in self.model.computed), "temperature_degc", "t_s"}
        return [c for c in self.model.state if c not in others and c in piece.data]


def _name(column: str) -> str:
    return readable(column)[2].removesuffix("_ref")


def _ranges(base: Base, runs: frozenset[int]) -> dict[str, tuple[float, float]]:
    """Middle and half range of every column and reading."""
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    for piece in pieces(base, runs):
        columns = piece.data | dict(zip(base.model.channels, piece.readings, strict=True))
        for c, values in columns.items():
            low[c] = min(low.get(c, np.inf), float(values.min(initial=np.inf)))
            high[c] = max(high.get(c, -np.inf), float(values.max(initial=-np.inf)))
    return {c: (0.5 * (low[c] + high[c]), max(0.5 * (high[c] - low[c]), 1e-300)) for c in low}


def _degree(coordinates: int) -> int:
    """Return the highest degree up to `DEGREE` with fewer than `TOGETHER` products of so many coordinates."""
    return next((d for d in range(DEGREE, 1, -1) if comb(coordinates + d, d) <= TOGETHER), 1)


def powers(x: np.ndarray, degree: int) -> np.ndarray:
    """Return products of the rows of x up to `degree`, without the constant."""
    rows = [
        np.prod(x[list(pick)], axis=0)
        for n in range(1, degree + 1)
        for pick in combinations_with_replacement(range(len(x)), n)
    ]
    return np.array(rows)
