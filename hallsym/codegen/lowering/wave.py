"""Lowering of models of one decaying wave: from sums of sensors to the place along it and the height.

A linear map makes cosine and sine of the readings, few rounds take the higher harmonics off (powers of the
same phasor: no function but + and *), an arctangent gives the place and a logarithm the height, both by
polynomials with proved bounds (`lowering.wave_steps`). What they are made of is found from the model's own
readings (`lowering.phasors`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.decoupler import (
    Box,
    Collected,
    Decoupler,
    Flag,
    Redundancy,
    short,
    unit,
)
from hallsym.codegen.lowering import arrays, rows, wave_steps
from hallsym.codegen.lowering.phase_curve import check_static
from hallsym.codegen.lowering.phasors import phasor
from hallsym.codegen.lowering.remainders import Seen, contradictions
from hallsym.codegen.lowering.wave_steps import Pair, Wave
from hallsym.errors import InputError, counted
from hallsym.model import Model
from hallsym.records import named

ENOUGH = 6e-7
"""Place and height [m] that rounds and polynomials may leave: an eighth of what a gain off by a thousandth
changes at a wavelength of 30 mm."""
TWO = 2
"""Coordinates of one array: place and height."""
SIX = 6
"""Coordinates of a mover over several arrays."""
TRIALS = 2000
"""Poses by which it is found what is left of readings."""
ROUNDED = 1e-13


def decoupler(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, *, accuracy: float | None = None
) -> Decoupler:
    """Return the decoupler of a wave at parameters `p` over a box.

    `weight`: 1 / variance of each reading. `accuracy`: what rounds, polynomials and terms may leave of place
    and height [m], default `ENOUGH`, of six coordinates `arrays.ENOUGH`. A place that repeats is the one
    within half a wavelength of zero. Raises `InputError` for readings that are no decaying wave.
    """
    check_static(model, "the pose")
    several = len(model.pose) == SIX
    aim = (arrays.ENOUGH if several else ENOUGH) if accuracy is None else accuracy
    if several or (len(model.pose) == TWO and not model.period):
        longer = rows.decoupler(model, p, weight, box, aim)
        return longer or arrays.decoupler(model, p, weight, box, aim)
    along, height = _coordinates(model)
    found = phasor(model, p, weight, along, height, box.ends[height])
    own = replace(model, period={**model.period, along: 2 * pi * found.lc})
    ends = box.ends[height]
    drawn = residual.drawn_of(model, np.asarray(p, dtype=float), box)
    return _Assembly(own, wave_steps.wave_of(found, ends, aim), box, along, height, weight, drawn, p).make()


def _coordinates(model: Model) -> tuple[str, str]:
    """Return the pose coordinate along the wave, which repeats, and the height."""
    along = [c for c in model.pose if c in model.period]
    height = [c for c in model.pose if c not in model.period]
    if len(along) != 1 or len(height) != 1:
        raise InputError(
            f"C of a decaying wave is generated for one coordinate that repeats and one height; {model.name} "
            f"has {', '.join(model.pose)}."
        )
    return along[0], height[0]


@dataclass(eq=False)
class _Assembly:
    model: Model
    wave: Wave
    given: Box
    along: str
    height: str
    weight: np.ndarray
    drawn: Callable[[np.random.Generator, int], np.ndarray]
    p: np.ndarray
    made: Collected = field(default_factory=Collected)

    def make(self) -> Decoupler:
        model, wave, made = self.model, self.wave, self.made
        found, inputs = wave.phasor, model.channels
        made.begin(model, inputs)
        seen = self.drawn(np.random.default_rng(4), TRIALS)
        ends = self.given.over(wave_steps.ranges(inputs, seen, self.given))
        vector = wave_steps.phasor_steps(made, wave, {short(c): made.symbols[c] for c in inputs})
        redundancy = self._redundancy(vector)
        self._pose(
            made,
            wave_steps.logarithm_steps(made, wave, vector),
            wave_steps.arctangent_steps(made, wave, vector),
        )
        made.keep((*map(short, model.pose), "inside", *(redundancy.steps if redundancy else ())))
        return made.finished(
            model, inputs, ends, exact=self._exact,
            flags=(
                Flag("FIELD", "inside", "least_inside", wave_steps.FIELD),
                *((residual.flag(),) if redundancy else ()),
            ),
            redundancy=redundancy, drawn=self.drawn if redundancy else None,
            approximation=found.lc * wave.error + ROUNDED, leaves=self.leaves,
            listed=self._listed(), said=self._said(), evident=False,
        )  # fmt: skip

    def _redundancy(self, vector: Pair) -> Redundancy | None:
        readings = {short(c): self.made.symbols[c] for c in self.model.channels}
        every, read = tuple(range(len(readings))), self.drawn(np.random.default_rng(12), TRIALS)
        seen = Seen(every, self.wave.phasor, readings, vector, rounds=self.wave.rounds)
        return contradictions(self.made, [seen], self.weight**-0.5, read)

    def _pose(self, made: Collected, logarithm: ca.SX, phase: ca.SX) -> None:
        """Add the last steps: place within half a wavelength, and height."""
        found, wave = self.wave.phasor, self.wave
        lc = made.entry("lc", found.lc, "m", "wavelength over 2 pi", "sign")
        middle = made.entry("middle", found.middle, "m", f"{self.height} at which the phasor is 1")
        wave_steps.least_inside(made, (wave,))
        half = made.entry("half_wave", pi * found.lc, "m", "half the wavelength", "sign")
        place = made.step("place", lc * phase + made.symbols[f"zero_{short(self.along)}"])
        beyond = place - ca.if_else(place < 0, -half, half)
        level = middle + made.symbols[f"zero_{short(self.height)}"]
        moved = lc * logarithm
        last = {
            self.along: ca.if_else(
                ca.fabs(place) <= half, place, beyond - ca.if_else(place < 0, -half, half)
            ),
            self.height: level + moved if found.rising > 0 else level - moved,
        }
        for column in self.model.pose:
            made.step(short(column), last[column], f"[{unit(column)}]")

    def _exact(self, readings: np.ndarray) -> np.ndarray:
        place, height = self.wave.phasor.pose(self.wave.phasor.solved(np.asarray(readings, dtype=float)))
        return np.array([place if c == self.along else height for c in self.model.pose])

    @cached_property
    def leaves(self) -> dict[str, float]:
        """What is left of each coordinate of readings that are a wave nearly, met over trial poses."""
        found, model = self.wave.phasor, self.model
        if not model.nearly:
            return {}
        low, high = np.array([self.given.ends[c] for c in model.pose]).T[..., None]
        at = low + (high - low) * np.random.default_rng(13).random((len(low), TRIALS))
        off = self._exact(self.model.readings(self.p, at)) - at
        k, whole = model.pose.index(self.along), 2 * pi * found.lc
        off[k] -= whole * np.round(off[k] / whole)
        own = found.lc * self.wave.error + ROUNDED
        return named(model.pose, wave_steps.SAFE * np.abs(off).max(axis=1) + own)

    def _listed(self) -> tuple[tuple[float, ...], ...]:
        """No field, the seams of the quadrants and of the period, and both ends of the heights."""
        found = self.wave.phasor
        place = np.append(np.arange(-4, 5) * pi / 4, [0.1, 0.1]) * found.lc
        height = np.append(np.full(9, found.middle), self.given.ends[self.height])
        seen = self.model.readings(self.p, [place if c == self.along else height for c in self.model.pose])
        return tuple(map(tuple, [found.offset.tolist(), *seen.T.tolist()]))

    def _said(self) -> tuple[str, ...]:
        wave, lc = self.wave, self.wave.phasor.lc
        out = [f"{self.along} repeats each {2e3 * pi * lc:.6g} mm; which period it is, readings do not say."]
        for name, series in (("arctangent", wave.arctangent), ("logarithm", wave.logarithm)):
            out.append(
                f"The {name} is a polynomial of degree {series.degree}: off by at most "
                f"{series.error * lc:.2g} m (proved)."
            )
        if wave.harmonics:
            names = ", ".join(map(str, wave.harmonics))
            along = " and the radial part of a second" if wave.radial else ""
            out.append(
                f"{counted(wave.rounds, 'round')}{along} for {names} waves per period leave at most "
                f"{wave.left * lc:.2g} m (proved)."
            )
        out.append(f"{wave_steps.REVERSED}: no bit is raised.")
        if self.leaves:
            out += wave_steps.measured("What ends and sides of the array do", self.leaves, TRIALS)
        return tuple(out)
