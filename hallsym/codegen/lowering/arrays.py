"""Lowering of models of several arrays: from sums of sensors to six coordinates of a mover.

Each array gives a phasor as one wave does (`lowering.wave_steps`), so a place and a height; weighted least
squares make rotations of them, which say what tilt adds to each, and then the pose; products of rotations and
displacements are added at the end. Which channels see which array, and every number, come from the model's
own readings (`lowering.wave_groups`, `lowering.arrays_fit`). No iteration, no branch that changes the pose by
a step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box, limits
from hallsym.codegen.decoupler import Decoupler, Flag, Margin
from hallsym.codegen.entries import Entry, short, unit
from hallsym.codegen.intervals import Enclosure
from hallsym.codegen.lowering.arrays_bounds import Rounding
from hallsym.codegen.lowering.arrays_fit import Arrays
from hallsym.codegen.lowering.arrays_steps import Pieces
from hallsym.codegen.lowering.wave_groups import groups_of
from hallsym.codegen.lowering.wave_steps import Wave, logarithm_steps, wave_of
from hallsym.errors import InputError, counted
from hallsym.model import Model

ENOUGH = 1e-6
"""Place [m] that terms and polynomials may leave, and rotation times the arm of the family's pose metric."""
SWING = 0.1
"""Share of its swing by which a reading may leave what the model gives over the box: noise, temperature."""
NEAR = 0.3
"""Share of a period by which what says the period may be off, and trials let it be."""
SAFE = 1.5
"""What errors met over trial poses are multiplied by where they are stated."""
TRIALS = 20_000
FIELD = "an array's field beyond the calibrated heights: too near, too far, or no array"
TILTED = "rotations beyond the calibrated box"


def decoupler(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float | None = None
) -> Decoupler:
    """Return the decoupler of several arrays at parameters `p` over a box; see `lowering.wave.decoupler`."""
    middle, half, leaves = ends_and_leaves(model, box, accuracy)
    aim = float(leaves[0])
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    groups, level = groups_of(own, p, weight, middle, box.ends[model.pose[2]])
    half, middle = half + np.abs(level - middle), level
    found = Arrays(own, np.asarray(p, dtype=float), weight, middle, half, leaves, groups)
    return Assembly(found, _waves(found, aim), given=box).make()


def ends_and_leaves(
    model: Model, box: Box, accuracy: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middle and half of the box (6,), and what terms may leave of each coordinate (6,)."""
    ends = np.array([box.ends[c] for c in model.pose])
    aim, arm = ENOUGH if accuracy is None else accuracy, model.family.pose_metric.arm_m
    leaves = np.array([aim if c.endswith("_m") else aim / arm for c in model.pose])
    return ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / 2, leaves


def _waves(found: Arrays, aim: float) -> tuple[Wave, ...]:
    """Return the wave of each array over the heights that poses of the box bring it to."""
    pose = found.poses(np.random.default_rng(2), 2000)
    out = []
    for group, u in zip(found.groups, found.phasors(found.readings(pose)), strict=True):
        heights = group.phasor.pose(u)[1]
        if not np.isfinite(heights).all():
            raise InputError(
                "Tilt brings an array of the box so near that its harmonics cannot be told apart; give a "
                "smaller "
                "range of rotations or heights with --range."
            )
        out.append(wave_of(group.phasor, (float(heights.min()), float(heights.max())), aim))
    return tuple(out)


@dataclass(eq=False)
class Assembly(Pieces):
    """Collects the decoupler of one calibration over a box."""

    given: Box = field(default_factory=lambda: Box({}))

    # -- the whole -----------------------------------------------------------------------------------------

    def make(self) -> Decoupler:
        """Return the decoupler."""
        made, model = self.made, self.found.model
        near = [c for c, a in (("x", 0), ("y", 1)) if self.wide(a)]
        nears = tuple(f"{short(model.pose['xy'.index(c)])}_near_m" for c in near)
        inputs = (*model.channels, *nears)
        made.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        made.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        ends = self._ends(nears)
        pose = self.bent(self.linear(nears))
        for column, value in zip(model.pose, pose, strict=True):
            made.step(short(column), made.symbols[f"zero_{short(column)}"] + value, f"[{unit(column)}]")
        made.keep((*(short(c) for c in model.pose), *(flag.step for flag in self.flags)))
        values: dict[str, float | tuple[float, float]] = {e.name: e.value for e in made.table}
        values |= {short(c): ends.ends[c] for c in inputs}
        leaves = self.leaves()
        return Decoupler(
            model=model, inputs=inputs, table=tuple(made.table), limits=limits(inputs, ends), zeros=zeros,
            steps=tuple(made.steps), at_pose=(), margins=(Margin(inputs[0], self.never_zero),),
            box=ends, exact=self.exact, symbols=made.symbols,
            flags=self.flags, approximation=max(leaves.values()), leaves=leaves,
            bounded=self.bounded(values, nears),
            drawn=self.drawn_of_box, said=self.said(leaves), evident=False,
        )  # fmt: skip

    def linear(self, nears: Sequence[str]) -> list[ca.SX]:
        """Add the steps from the readings to the linear pose; returns its displacements from the middle."""
        vectors = [self.vector(k) for k in range(len(self.waves))]
        logs = [
            logarithm_steps(self.made, w, u, f"_{n}")
            for w, u, n in zip(self.waves, vectors, self.names, strict=True)
        ]
        self.least_inside()
        seen = [*self.places(vectors), *self.heights(logs)]
        return self.pose(seen, self.turning(vectors))

    @property
    def never_zero(self) -> str:
        """An entry that decoupler_check() looks at: a wavelength over 2 pi."""
        return f"lc_{self.names[0]}"

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Status bits beyond the ranges."""
        return (
            Flag("FIELD", f"least_to_{self.names[-1]}", "least_inside", FIELD),
            Flag("TILT", "turns", "least_turns", TILTED),
        )

    def bounded(
        self, values: Mapping[str, float | tuple[float, float]], nears: tuple[str, ...]
    ) -> Callable[[int], Mapping[str, Enclosure]]:
        """Return what bounds the rounding."""
        return Rounding(
            self.found, self.waves, self.names, tuple(self.made.steps), values, nears, self.drawn_of_box
        )

    # -- ranges, trials, what is said ----------------------------------------------------------------------

    def _ends(self, nears: Sequence[str]) -> Box:
        """Ranges of readings over poses of the box, and of what says the period."""
        found = self.found
        seen = found.readings(found.poses(np.random.default_rng(4), 4000))
        ends = {}
        for c, row in zip(found.model.channels, seen, strict=True):
            middle, swing = (row.max() + row.min()) / 2, (row.max() - row.min()) / 2
            end = float(f"{abs(middle) + swing * (1 + SWING):.3g}")
            ends[c] = self.given.ends.get(c, (-end, end))
        for c in nears:
            axis = 0 if short(found.model.pose[0]) == c.removesuffix("_near_m") else 1
            most = float(np.abs(found.middle[axis]) + found.half[axis] + NEAR * found.wave_of(axis))
            ends[c] = (-most, most)
        return self.given.over(ends)

    def drawn(self, pose: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Return inputs (n, s) of poses (6, s); `off` (2, s): of what says the period, in periods."""
        found = self.found
        nears = [pose[axis] + off[axis] * found.wave_of(axis) for axis in (0, 1) if self.wide(axis)]
        return np.vstack([found.readings(pose), *nears])

    def drawn_of_box(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random inputs (n, s) of poses of the box."""
        pose = self.found.poses(rng, count)
        return self.drawn(pose, rng.uniform(-NEAR, NEAR, (2, count)))

    def _near(self, inputs: np.ndarray) -> np.ndarray | None:
        """What says the period (2, s), the middle of the box where nothing does; None where nothing is
        wide."""
        found, rows = self.found, list(inputs[len(self.found.model.channels) :])
        return np.array(
            [
                rows.pop(0) if self.wide(axis) else np.full(inputs.shape[1], found.middle[axis])
                for axis in (0, 1)
            ]
        )

    def exact(self, inputs: np.ndarray) -> np.ndarray:
        """Return the poses (6, s) of inputs (n, s) by the reference decoder."""
        given = np.asarray(inputs, dtype=float)
        n = len(self.found.model.channels)
        return self.found.solved(given[:n], self._near(given))

    def leaves(self) -> dict[str, float]:
        """What is left of each coordinate: met over trial poses by exact functions, and what these leave."""
        found = self.found
        pose = found.poses(np.random.default_rng(5), TRIALS)
        met = np.abs(found.decoded(found.readings(pose), pose[:2]) - pose).max(axis=1)
        n = len(found.groups)
        each = np.array([w.error * w.phasor.lc for w in self.waves])
        turned = np.zeros(n)
        for first, *others in found.axes.values():
            for k in others:
                turned[k] = self.series(first, k).error * found.groups[k].phasor.lc
        functions = np.abs(found.inverse) @ np.concatenate([each + turned, each]) * SAFE
        return dict(zip(found.model.pose, (SAFE * met + functions).tolist(), strict=True)) if n else {}

    def said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        """Return sentences for header and report."""
        found = self.found
        sizes = ", ".join(
            f"{n} from {counted(len(g.channels), 'reading')}"
            for n, g in zip(self.names, found.groups, strict=True)
        )
        turning, bends = (sum(len(t.terms) for t in terms) for terms in (found.turning, found.bends))
        listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
        return (
            f"Arrays: {sizes}. Six coordinates by weighted least squares of their places and heights, "
            f"{counted(turning, 'term')} of tilt and {counted(bends, 'product')} of coordinates.",
            f"Against least squares over all readings, converged, in double it leaves at most {listed}: "
            f"{SAFE:g} times what {TRIALS} poses of the box met, and what polynomials leave (measured, not "
            "proved for every pose).",
            "Only readings of a pose in the box have that error: others give a finite pose, mostly a flag.",
        )
