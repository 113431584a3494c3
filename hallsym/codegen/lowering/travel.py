"""Lowering of models of a wave of finite length over a longer row of sensors: absolute place and height.

The sensors that see the wave are weighted smoothly by their distance from its ends, so nothing steps as it
travels, and nothing is remembered from one sample to the next. Where it is follows from which of them see it:
the middle of what they read, squared, says the period, and where the wave reaches beyond the row, the middle
of the rest and the end of the row say it. Least squares of the weighted sensors then give the phasor as of an
endless wave; how far from its ends a sensor must be to count is chosen by what ends and noise leave.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box, limits
from hallsym.codegen.decoupler import Decoupler, Flag, Margin
from hallsym.codegen.entries import Entry, short, unit
from hallsym.codegen.lowering.travel_bounds import Rounding
from hallsym.codegen.lowering.travel_fit import Row, row_of
from hallsym.codegen.lowering.travel_steps import Pieces
from hallsym.codegen.lowering.wave_steps import Collected, Wave, wave_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

SWING = 0.1
"""Share of its swing by which a reading may leave what the model gives over the box: noise, temperature."""
MARGINS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Wavelengths from the ends of the wave within which a sensor does not count, of which one is chosen."""
TRIALS = 4000
SAFE = 1.5
"""What errors met over trial poses are multiplied by where they are stated."""
COVER = 0.5
"""Share of the least cover of the box below which the flag is set."""
MOST_ROUNDS = 4
FIELD = "field beyond the calibrated heights: too near, too far, or no array"
COVERED = "too few sensors see the array: it is at an end of the board or beyond"


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float) -> Decoupler:
    """Return the decoupler of a travelling wave at parameters `p` over a box; see `lowering.wave.decoupler`.

    The first pose coordinate is along the wave, the second its height.
    """
    row = row_of(model, np.asarray(p, dtype=float), weight, box)
    wave = wave_of(row.plain, box.ends[model.pose[1]], accuracy)
    best = min((_Tried(row, wave, margin, accuracy) for margin in MARGINS), key=lambda t: t.size)
    if not best.resolved:
        raise InputError(
            f"Over the box the sensors do not say which period {model.pose[0]} is in: too few of them see "
            f"the array at its ends; give fewer with --range {model.pose[0]}."
        )
    row = replace(best.row, rounds=best.rounds)
    return _Assembly(row, wave, box).make()


class _Tried:
    """What a margin leaves of poses of the box, with the noise of the calibration."""

    def __init__(self, row: Row, wave: Wave, margin: float, accuracy: float) -> None:
        self.row, self.size, self.resolved, self.rounds = replace(row, margin=margin), np.inf, False, 0
        if 2 * margin * row.wavelength >= row.length - row.wavelength:
            return
        rng = np.random.default_rng(7)
        pose = row.poses(rng, TRIALS)
        readings = row.readings(pose)
        noisy = readings + rng.standard_normal(readings.shape) / np.sqrt(row.weight)[:, None]
        with np.errstate(all="ignore"):  # where no sensor counts there is no pose
            found = self.row.decoded(noisy, 0)
            for rounds in range(1, MOST_ROUNDS + 1):
                again = self.row.decoded(noisy, rounds)
                if not np.abs(again - found).max() >= accuracy / 4:
                    break
                found, self.rounds = again, rounds
            off = found - pose
        self.resolved = bool(np.abs(off[0]).max() < row.wavelength / 4)
        self.size = float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


@dataclass(eq=False)
class _Assembly:
    """Collects the decoupler of one calibration."""

    row: Row
    wave: Wave
    given: Box
    made: Collected = field(default_factory=Collected)

    def make(self) -> Decoupler:
        model, made = self.row.model, self.made
        inputs = model.channels
        made.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        made.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        Pieces(self.row, self.wave, made, COVER).add()
        made.keep((*map(short, model.pose), "inside", "cover"))
        ends = self._ends
        values: dict[str, float | tuple[float, float]] = {e.name: e.value for e in made.table}
        values |= {short(c): ends.ends[c] for c in inputs}
        leaves = self._leaves
        return Decoupler(
            model=model, inputs=inputs, table=tuple(made.table), limits=limits(inputs, ends), zeros=zeros,
            steps=tuple(made.steps), at_pose=(), margins=(Margin(inputs[0], "lc"),), box=ends,
            exact=self.row.exact, symbols=made.symbols,
            flags=(
                Flag("FIELD", "inside", "least_inside", FIELD), Flag("COVER", "cover", "least_cover", COVERED)
            ),
            approximation=max(leaves.values()), leaves=leaves,
            bounded=Rounding(self.row, self.wave, tuple(made.steps), values, self.drawn),
            drawn=self.drawn, said=self._said(leaves), evident=False,
        )  # fmt: skip

    @cached_property
    def _ends(self) -> Box:
        """Ranges of readings over poses of the box."""
        seen = self.row.readings(self.row.poses(np.random.default_rng(4), TRIALS))
        ends = {}
        for c, values in zip(self.row.model.channels, seen, strict=True):
            end = float(f"{(1 + SWING) * np.abs(values).max():.3g}")
            ends[c] = self.given.ends.get(c, (-end, end))
        return Box(ends)

    def drawn(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return self.row.readings(self.row.poses(rng, count))

    @cached_property
    def _leaves(self) -> dict[str, float]:
        """What ends, harmonics and functions leave of each coordinate."""
        pose = self.row.poses(np.random.default_rng(5), TRIALS)
        readings = self.row.readings(pose)
        off = self.row.decoded(readings, self.row.rounds) - self.row.exact(readings)
        functions = self.wave.error * self.row.lc
        return {
            c: SAFE * (float(np.abs(v).max()) + functions)
            for c, v in zip(self.row.model.pose, off, strict=True)
        }

    def _said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        row = self.row
        listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
        return (
            f"{counted(len(row.model.channels), 'sensor')} over {1e3 * row.board[0]:.4g} to "
            f"{1e3 * row.board[1]:.4g} mm, an array of {1e3 * row.length:.3g} mm with a wavelength of "
            f"{1e3 * row.wavelength:.6g} mm: {row.model.pose[0]} is absolute, from the readings of one "
            f"sample. A sensor counts from {1e3 * row.margin * row.wavelength:.3g} mm inside the ends of the "
            "array on, and fully half a wavelength further.",
            "Give all readings at every sample, also of sensors that the array is not over: the code weights "
            "them.",
            f"Against least squares over all readings, converged, in double it leaves at most {listed}: "
            f"{SAFE:g} times what {TRIALS} poses of the box met, and what polynomials leave (measured, not "
            "proved for every pose).",
            "Only readings of a pose in the box have that error: others give a finite pose, mostly a flag.",
        )
