"""Lowering of models of arrays of finite length on a mover, over rows of sensors longer than they are.

Which sensors count follows from where the mover is: weights go to zero smoothly at the ends of each array.
See `lowering.mover_fit`; nothing is remembered from one sample to the next, and no choice makes a step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box
from hallsym.codegen.decoupler import Decoupler, Flag, Step
from hallsym.codegen.entries import short, unit
from hallsym.codegen.intervals import Enclosure
from hallsym.codegen.lowering.adjoints import rounding
from hallsym.codegen.lowering.arrays import (
    FIELD,
    NEAR,
    SAFE,
    TILTED,
    TRIALS,
    Assembly,
    ends_and_leaves,
)
from hallsym.codegen.lowering.mover_fit import Mover, ends, mover_of
from hallsym.codegen.lowering.mover_steps import MoverPieces
from hallsym.codegen.lowering.passing import NeverEnds
from hallsym.codegen.lowering.travel import COVERED, MARGINS
from hallsym.codegen.lowering.wave_bounds import Values
from hallsym.codegen.lowering.wave_steps import wave_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

TRIED = 1000
"""Poses over which margins are compared."""
HARDLY = 1.1
"""Times what is left with them: harmonics that bring less are left alone."""
BOUNDED = 1000
"""Poses for which the rounding is bounded, one by one."""
ROOM = 1.5
"""Times the largest bound of these poses."""


def decoupler(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float | None = None
) -> Decoupler | None:
    """Return the decoupler of a mover over longer rows over a box; see `lowering.wave.decoupler`.

    None where arrays do not end near the box, or no sensor is ever beyond the end of its array.
    """
    middle, half, leaves = ends_and_leaves(model, box, accuracy)
    p = np.asarray(p, dtype=float)
    if not ends(model, p, middle, (middle[2] - half[2], middle[2] + half[2])):
        return None
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    try:
        found = replace(mover_of(model, p, weight, middle, half, leaves), model=own)
    except NeverEnds:
        return None
    if not found.travels():
        return None
    found = _best(found)
    low, high = middle[2] - half[2], middle[2] + half[2]
    tilted = float(np.abs(np.array([row.lever for row in found.rows])).max(axis=0) @ half[3:])
    wave = wave_of(found.plain, (low - tilted, high + tilted), float(leaves[0]))
    return _Assembly(found, (wave,) * len(found.rows), given=box).make()


def _best(found: Mover) -> Mover:
    """Return the mover with the margin that leaves least of ends and noise; harmonics where they count."""
    tried: list[tuple[float, int, Mover]] = []
    for margin in MARGINS:
        for plainly in (True, False):
            one = replace(found, margin=margin, plainly=plainly)
            if 2 * margin * one.wavelength < min(r.length for r in one.rows) - one.wavelength:
                tried.append((_left(one) * (1.0 if plainly else HARDLY), len(tried), one))
    size, _, best = min(tried, default=(np.inf, 0, found))
    if not np.isfinite(size):
        x, y = found.model.pose[:2]
        raise InputError(
            f"Over the box too few sensors see an array at its ends; give fewer {x} and {y} with --range, or "
            "more sensors in the layout."
        )
    return best


def _left(found: Mover) -> float:
    """What is left, rms, of coordinates over their accuracy, with the noise of the calibration."""
    pose, readings = found.trials(7, TRIED)
    noisy = (
        readings + np.random.default_rng(8).standard_normal(readings.shape) / np.sqrt(found.weight)[:, None]
    )
    with np.errstate(all="ignore"):  # where no sensor counts there is no pose
        off = (found.decoded(noisy, pose[:2]) - pose) / found.accuracy[:, None]
        return float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


@dataclass(eq=False)
class _Assembly(MoverPieces, Assembly):
    """Collects the decoupler of one calibration over a box."""

    def linear(self, nears: Sequence[str]) -> list[ca.SX]:
        """Add the steps from the readings to the linear pose; returns its displacements from the middle."""
        seen = self.rows()
        self.covered()
        self.least()
        return self.pose(seen, {})

    @property
    def never_zero(self) -> str:
        """An entry that decoupler_check() looks at: a wavelength over 2 pi."""
        return "lc"

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Status bits beyond the ranges."""
        last = self.names[-1]
        return (
            Flag("FIELD", f"least_to_{last}", "least_inside", FIELD),
            Flag("TILT", "turns", "least_turns", TILTED),
            Flag("COVER", f"cover_to_{last}", "least_cover", COVERED),
        )

    def bounded(self, values: Values, nears: tuple[str, ...]) -> Callable[[int], Mapping[str, Enclosure]]:
        """Return what bounds the rounding."""
        return PoseByPose(self.found, tuple(self.made.steps), dict(values), nears, self.drawn_of_box)

    def leaves(self) -> dict[str, float]:
        """What is left of each coordinate: met over trial poses by exact functions, and what these leave."""
        found = self.found
        pose, readings = found.trials(5, TRIALS)
        met = np.abs(found.decoded(readings, pose[:2]) - pose).max(axis=1)
        each = np.full(2 * len(found.rows), self.waves[0].error * found.lc)
        return dict(
            zip(found.model.pose, (SAFE * (met + np.abs(found.inverse) @ each)).tolist(), strict=True)
        )

    def said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        """Return sentences for header and report."""
        found = self.found
        rows = ", ".join(
            f"{n} {counted(len(r.channels), 'reading')} over {1e3 * np.ptp(r.place):.4g} mm, array of "
            f"{1e3 * r.length:.3g} mm"
            for n, r in zip(self.names, found.rows, strict=True)
        )
        listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
        return (
            f"Rows: {rows}. A sensor counts from {1e3 * found.margin * found.wavelength:.3g} mm inside the "
            "ends of its array on, and fully half a wavelength further: weights are smooth, so nothing steps "
            "where sensors come and go.",
            "Give all readings at every sample, also of sensors that no array is over: the code weights "
            "them.",
            f"What says the period, x_near_m and y_near_m where they are inputs, is the position so far or "
            f"the commanded one, within {1e3 * NEAR * found.wavelength:.2g} mm: it chooses the period and "
            "nothing else.",
            f"It leaves at most {listed} of the poses of the model: {SAFE:g} times what {TRIALS} poses of "
            "the box met, and what polynomials leave (measured, not proved for every pose).",
            "Only readings of a pose in the box have that error: others give a finite pose, mostly a flag.",
        )


@dataclass(frozen=True, eq=False)
class PoseByPose:
    """Digits of the significand -> range and rounding of each coordinate, flags clear, zeros at zero.

    Rounding is bounded for each of many poses, and the largest bound is taken with some room.
    """

    found: Mover
    steps: tuple[Step, ...]
    values: Values
    nears: tuple[str, ...]
    drawn: Callable[[np.random.Generator, int], np.ndarray]

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each coordinate."""
        model = self.found.model
        entries = {n: v for n, v in self.values.items() if not isinstance(v, tuple)}
        entries |= {f"zero_{short(c)}": 0.0 for c in model.pose}
        columns = [short(c) for c in (*model.channels, *self.nears)]
        inputs = dict(zip(columns, self.drawn(np.random.default_rng(6), BOUNDED), strict=True))
        values, errors = rounding(self.steps, inputs, entries, digits, len(model.pose))
        ends = (values.min(axis=1), values.max(axis=1), ROOM * errors.max(axis=1))
        return {c: Enclosure(*map(float, e)) for c, *e in zip(model.pose, *ends, strict=True)}
