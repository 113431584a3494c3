"""Lowering of models of several arrays: from sums of sensors to six coordinates of a mover.

Each array gives a phasor as one wave does (`lowering.wave_steps`), so a place and a height; weighted least squares make
rotations of them, which say what tilt adds to each, and then the pose; products of rotations and displacements are
added at the end. Which channels see which array, and every number, come from the model's own readings
(`lowering.wave_groups`, `lowering.arrays_fit`). No iteration, no branch that changes the pose by a step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import pi, tan

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box, limits
from hallsym.codegen.decoupler import Decoupler, Flag, Margin, Whole
from hallsym.codegen.entries import Entry, short, unit
from hallsym.codegen.lowering.arrays_bounds import Rounding
from hallsym.codegen.lowering.arrays_fit import KINDS, NEGLIGIBLE, Arrays
from hallsym.codegen.lowering.odd_series import Odd, shortest
from hallsym.codegen.lowering.trigonometry import odd
from hallsym.codegen.lowering.wave_groups import groups_of
from hallsym.codegen.lowering.wave_steps import (
    POLYNOMIALS,
    Collected,
    Pair,
    Powers,
    Wave,
    arctangent_steps,
    logarithm_steps,
    phasor_steps,
    wave_of,
)
from hallsym.errors import InputError, counted
from hallsym.model import Model

ENOUGH = 1e-6
"""Place [m] that terms and polynomials may leave, and rotation times the arm of the family's pose metric."""
SWING = 0.1
"""Share of its swing by which a reading may leave what the model gives over the box: noise, temperature."""
TILT = 1.1
"""Times the largest rotation of the box beyond which the flag of the pose is set."""
WITHIN = 0.98
"""Share of a period that a box may span where no input says which period it is."""
NEAR = 0.3
"""Share of a period by which what says the period may be off, and trials let it be."""
PERIODS = 1 << 12
"""Added to whole periods, so that they are no negative number."""
SAFE = 1.5
"""What errors met over trial poses are multiplied by where they are stated."""
TRIALS = 20_000
FIELD = "an array's field beyond the calibrated heights: too near, too far, or no array"
TILTED = "rotations beyond the calibrated box"


def decoupler(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float | None = None
) -> Decoupler:
    """Return the decoupler of several arrays at parameters `p` over a box; see `lowering.wave.decoupler`."""
    aim = ENOUGH if accuracy is None else accuracy
    ends = np.array([box.ends[c] for c in model.pose])
    middle, half = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / 2
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    groups = groups_of(own, p, weight, middle, (ends[2, 0], ends[2, 1]))
    arm = model.family.pose_metric.arm_m
    leaves = np.array([aim if c.endswith("_m") else aim / arm for c in model.pose])
    found = Arrays(own, np.asarray(p, dtype=float), weight, groups, middle, half, leaves)
    return _Assembly(found, box, _waves(found, aim)).make()


def _waves(found: Arrays, aim: float) -> tuple[Wave, ...]:
    """Return the wave of each array over the heights that poses of the box bring it to."""
    pose = found.poses(np.random.default_rng(2), 2000)
    out = []
    for group, u in zip(found.groups, found.phasors(found.readings(pose)), strict=True):
        heights = group.phasor.pose(u)[1]
        if not np.isfinite(heights).all():
            raise InputError(
                "Tilt brings an array of the box so near that its harmonics cannot be told apart; give a smaller "
                "range of rotations or heights with --range."
            )
        out.append(wave_of(group.phasor, (float(heights.min()), float(heights.max())), aim))
    return tuple(out)


@dataclass(eq=False)
class _Assembly:
    """Collects the decoupler of one calibration."""

    found: Arrays
    given: Box
    waves: tuple[Wave, ...]
    made: Collected = field(default_factory=Collected)

    def __post_init__(self) -> None:
        self.names = [f"{axis}{k + 1}" for axis in (0, 1) for k in range(len(self.found.axes[axis]))]
        self.names = [f"{short(self.found.model.pose[int(n[0])])}_{n[1:]}" for n in self.names]
        """Of the arrays: x_1, x_2, y_1, y_2."""

    # -- the whole -----------------------------------------------------------------------------------------

    def make(self) -> Decoupler:
        found, made, model = self.found, self.made, self.found.model
        near = [c for c, a in (("x", 0), ("y", 1)) if self._wide(a)]
        nears = tuple(f"{short(model.pose['xy'.index(c)])}_near_m" for c in near)
        inputs = (*model.channels, *nears)
        made.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        made.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        ends = self._ends(nears)
        stages = [self._vector(k) for k in range(len(self.waves))]
        logs = [logarithm_steps(made, w, u, f"_{n}") for w, u, n in zip(self.waves, stages, self.names, strict=True)]
        inside = self._least_inside()
        seen = [*self._places(stages), *self._heights(logs)]
        pose = self._bent(self._pose(seen, self._turning(stages)))
        for column, value in zip(model.pose, pose, strict=True):
            made.step(short(column), made.symbols[f"zero_{short(column)}"] + value, f"[{unit(column)}]")
        made.keep((*(short(c) for c in model.pose), inside, "turn_left"))
        values: dict[str, float | tuple[float, float]] = {e.name: e.value for e in made.table}
        values |= {short(c): ends.ends[c] for c in inputs}
        leaves = self._leaves()
        return Decoupler(
            model=model, inputs=inputs, table=tuple(made.table), limits=limits(inputs, ends), zeros=zeros,
            steps=tuple(made.steps), at_pose=(), margins=(Margin(inputs[0], f"lc_{self.names[0]}"),), box=ends,
            exact=self._exact, symbols=made.symbols,
            flags=(
                Flag("FIELD", inside, "least_inside", FIELD),
                Flag("TILT", "turn_left", "least_turn_left", TILTED),
            ),
            approximation=max(leaves.values()), leaves=leaves,
            bounded=Rounding(found, self.waves, self.names, tuple(made.steps), values, nears, self._drawn),
            rest=tuple(self.drawn(found.middle[:, None], np.zeros((2, 1)))[:, 0].tolist()),
            drawn=self._drawn, said=self._said(leaves), by_size=True, evident=False,
        )  # fmt: skip

    def _wide(self, axis: int) -> bool:
        """Whether the box spans more than the period that readings resolve."""
        lc = self.found.groups[self.found.axes[axis][0]].phasor.lc
        return bool(2 * self.found.half[axis] > WITHIN * 2 * pi * lc)

    def _vector(self, k: int) -> Pair:
        group, name = self.found.groups[k], self.names[k]
        readings = {short(c): self.made.symbols[c] for c in (self.found.model.channels[j] for j in group.channels)}
        return phasor_steps(self.made, self.waves[k], readings, f"_{name}")

    def _least_inside(self) -> str:
        """The least of what the flag of the field looks at, over the arrays, each over its own least."""
        made, least = self.made, min(w.least_inside for w in self.waves)
        made.entry("least_inside", least, "1", "1 - t^2 at the ends of the heights, t as computed")
        value = made.symbols[f"inside_{self.names[0]}"]
        for name in self.names[1:]:
            other = made.symbols[f"inside_{name}"]
            value = made.step(f"least_to_{name}", ca.if_else(value < other, value, other))
        return f"least_to_{self.names[-1]}"

    # -- places and heights --------------------------------------------------------------------------------

    def _heights(self, logs: Sequence[ca.SX]) -> list[ca.SX]:
        """Heights from those in the middle of the box, over lc and without sign: logarithms."""
        out = []
        for k, (group, log) in enumerate(zip(self.found.groups, logs, strict=True)):
            at = float(self.found.at_middle[len(logs) + k, 0])
            value = group.phasor.rising * (at - group.phasor.middle) / group.phasor.lc
            entry = self.made.entry(f"log_{self.names[k]}_middle", value, "1", "logarithm in the middle of the box")
            out.append(self.made.step(f"deep_{self.names[k]}", log - entry))
        return out

    def _places(self, vectors: Sequence[Pair]) -> list[ca.SX]:
        """For each axis: the mean place [m] from the middle, then the turns of the other arrays from the first."""
        made, out = self.made, []
        for axis, members in self.found.axes.items():
            first = members[0]
            phase = arctangent_steps(made, self.waves[first], vectors[first], f"_{self.names[first]}")
            turns = [self._turn(first, k, vectors) for k in members[1:]]
            total = phase
            if turns:
                total = phase + sum(turns[1:], start=turns[0]) * (1.0 / len(members))
            lc = self.found.groups[first].phasor.lc
            name = self.names[first]
            entry = made.entry(f"lc_{name}", lc, "m", "wavelength over 2 pi")
            place = made.step(f"place_{name}", entry * total, "[m] mean of the axis")
            out += [self._in_period(axis, name, place, lc), *turns]
        return out

    def _in_period(self, axis: int, name: str, place: ca.SX, lc: float) -> ca.SX:
        """The place from the middle of the box, in the period that is meant."""
        made, column = self.made, short(self.found.model.pose[axis])
        at = float(self.found.at_middle[self.found.axes[axis], 0].mean())
        whole = made.entry(f"wavelength_{name}", 2 * pi * lc, "m", "wavelength")
        middle = made.entry(f"place_{name}_middle", at, "m", "place in the middle of the box")
        from_middle = made.step(f"from_middle_{name}", place - middle)
        if not self._wide(axis):
            half = made.entry(f"half_wave_{name}", pi * lc, "m", "half the wavelength")
            beyond = made.step(f"next_{name}", from_middle - ca.if_else(from_middle < 0, -whole, whole))
            return made.step(
                f"along_{name}", ca.if_else(ca.fabs(from_middle) <= half, from_middle, beyond), "[m]"
            )
        per = made.entry(f"per_wave_{name}", 1 / (2 * pi * lc), "1/m", "periods per metre")
        center = made.entry(f"{column}_middle", float(self.found.middle[axis]), "m", "middle of the box")
        near = made.symbols[f"{column}_near_m"]
        count = made.step(
            f"periods_{name}", ((near - center) - from_middle) * per + (PERIODS + 0.5), "periods to the known place"
        )
        made.steps.append(Whole(f"whole_{name}", count))
        number = made.symbols.setdefault(f"whole_{name}", ca.SX.sym(f"whole_{name}"))
        return made.step(f"along_{name}", from_middle + whole * (number - float(PERIODS)), "[m]")

    def _turn(self, first: int, k: int, vectors: Sequence[Pair]) -> ca.SX:
        """Angle of one phasor from the first of its axis: small, so one polynomial without quadrants."""
        made, (a, b), (c, d), name = self.made, vectors[first], vectors[k], self.names[k]
        real = made.step(f"cross_real_{name}", c * a + d * b)
        imaginary = made.step(f"cross_imaginary_{name}", d * a - c * b)
        floor = made.entry(
            f"least_cross_{name}", self._floor(first, k), "1", "least product of two phasors of the box"
        )
        held = made.step(f"held_cross_{name}", ca.if_else(real > floor, real, floor))
        tangent = made.step(f"cross_{name}", imaginary / held)
        square = made.step(f"cross_square_{name}", tangent * tangent)
        return made.step(f"turn_{name}", odd(self.series(first, k).coefficients, tangent, square), "[rad]")

    def _floor(self, first: int, k: int) -> float:
        return 0.5 * self.waves[first].least * self.waves[k].least * float(np.cos(self._angle(first, k)))

    def _angle(self, first: int, k: int) -> float:
        """Largest turn of two phasors of an axis over the box [rad]."""
        pose = self.found.poses(np.random.default_rng(3), 2000)
        u = self.found.phasors(self.found.readings(pose))
        return float(np.abs(np.angle(u[k] * u[first].conj())).max()) * 1.05

    def series(self, first: int, k: int) -> Odd:
        """Return the polynomial of that angle."""
        end = np.ceil(20 * tan(min(self._angle(first, k), 1.4))) / 20
        share = POLYNOMIALS * float(self.found.accuracy[0]) / self.found.groups[k].phasor.lc
        series = shortest("atan", float(end), share)
        if series is None:
            raise InputError(
                "Rotations of the box turn two arrays of an axis by most of a period against each other; give a "
                "smaller range of rotations with --range."
            )
        return series

    # -- the pose ------------------------------------------------------------------------------------------

    @property
    def _labels(self) -> list[str]:
        """Of what the pose is linear in: mean place and turns by axis, then logarithms."""
        out = []
        for members in self.found.axes.values():
            out += [f"along_{self.names[members[0]]}", *(f"turn_{self.names[k]}" for k in members[1:])]
        return [*out, *(f"deep_{n}" for n in self.names)]

    @property
    def _matrix(self) -> np.ndarray:
        """Pose per label (6, labels), from the inverse per place and height."""
        groups, n = self.found.groups, len(self.found.groups)
        back = np.zeros((2 * n, 2 * n))  # places and heights per label
        row = 0
        for members in self.found.axes.values():
            back[members, row] = 1.0
            for j, k in enumerate(members[1:], 1):
                lc = groups[k].phasor.lc
                back[members, row + j] = -lc / len(members)
                back[k, row + j] += lc
            row += len(members)
        for k, group in enumerate(groups):
            back[n + k, n + k] = group.phasor.rising * group.phasor.lc
        return np.asarray(self.found.inverse @ back)

    def _entries(self, rows: Sequence[int]) -> dict[int, list[tuple[str, ca.SX]]]:
        """Add the entries of some rows of the matrix that count."""
        found, matrix, labels = self.found, self._matrix, self._labels
        pose, phasors, seen = found.sample
        spread = np.abs(np.linalg.pinv(matrix) @ (found.inverse @ (seen - found.at_middle))).max(axis=1)
        out: dict[int, list[tuple[str, ca.SX]]] = {}
        for i in rows:
            column = found.model.pose[i]
            out[i] = []
            for label, value, most in zip(labels, matrix[i], spread, strict=True):
                if abs(value) * most > NEGLIGIBLE * found.accuracy[i]:
                    name = f"{short(column)}_{label}"
                    if name not in self.made.symbols:
                        self.made.entry(name, value, unit(column), f"{column} per {label}")
                    out[i].append((label, self.made.symbols[name]))
        return out

    def _turning(self, vectors: Sequence[Pair]) -> dict[str, ca.SX]:
        """Add what tilt adds to each label."""
        found, made = self.found, self.made
        terms = found.turning
        if not any(t.terms for t in terms):
            return {}
        used = {c for t in terms for _, turns, _ in t.terms for c in turns}
        rows, rotations = self._entries([3 + k for k in sorted(used)]), {}
        for i, row in rows.items():
            value = [entry * made.symbols[label] for label, entry in row]
            name = f"first_{short(found.model.pose[i])}"
            rotations[i - 3] = made.step(name, sum(value[1:], start=value[0]), "[rad] first estimate")
        sums: list[ca.SX] = []
        n = len(found.groups)
        for row_, part in enumerate(terms):
            k = row_ % n
            total = ca.SX(0)
            for j, ((kind, turns, side), factor) in enumerate(zip(part.terms, part.factors, strict=True)):
                value = self._kind(k, kind, vectors)[side]
                product = self._product(value, kind, side, turns, k, rotations)
                scale = found.groups[k].phasor.lc * (1.0 if row_ < n else found.groups[k].phasor.rising)
                name = f"tilt_{'place' if row_ < n else 'log'}_{self.names[k]}_{j + 1}"
                entry = made.entry(name, factor / scale, "1", f"tilt in {name.split('_')[1]} of {self.names[k]}")
                total = total + entry * product
            sums.append(total)
        return self._by_label(sums)

    def _by_label(self, sums: Sequence[ca.SX]) -> dict[str, ca.SX]:
        """What is added to places and logarithms of the arrays (over lc), as added to labels."""
        found, made, n, out = self.found, self.made, len(self.found.groups), {}
        for axis, members in found.axes.items():
            places = [made.step(f"tilted_{self.names[k]}", sums[k], "[rad] of a tilt") for k in members]
            lc = made.symbols[f"lc_{self.names[members[0]]}"]
            mean = sum(places[1:], start=places[0]) * (1.0 / len(members))
            out[f"along_{self.names[members[0]]}"] = lc * mean
            for k, place in zip(members[1:], places[1:], strict=True):
                out[f"turn_{self.names[k]}"] = place - places[0]
        for k in range(n):
            out[f"deep_{self.names[k]}"] = sums[n + k]
        return out

    def _kind(self, k: int, kind: str, vectors: Sequence[Pair]) -> Pair:
        """Real and imaginary part of a kind of term of an array, made where first used."""
        made, name = self.made, self.names[k]
        key = f"kind{KINDS.index(kind)}_{name}"
        if f"{key}_re" in made.symbols:
            return made.symbols[f"{key}_re"], made.symbols[f"{key}_im"]
        powers = Powers(made, *vectors[k], f"_of_{name}")
        if kind == "4":
            re, im = powers(4)
        elif kind == "-4":
            a, b = self._kind(k, "2", vectors)
            re, im = a * a - b * b, (a * b) + (a * b)
        else:
            size = made.symbols[f"size_{name}"]
            if f"held_size_{name}" not in made.symbols:
                if "least_size" not in made.symbols:
                    value = min(w.least for w in self.waves) ** 2
                    made.entry("least_size", value, "1", "least square of a phasor")
                least = made.symbols["least_size"]
                made.step(f"held_size_{name}", ca.if_else(size > least, size, least))
            c, d = powers(int(kind))
            held = made.symbols[f"held_size_{name}"]
            re, im = c / held, -(d / held)
        return made.step(f"{key}_re", re), made.step(f"{key}_im", im)

    def _product(
        self, value: ca.SX, kind: str, side: int, turns: tuple[int, ...], k: int, rotations: dict[int, ca.SX]
    ) -> ca.SX:
        """A kind times rotations: products of rotations once for all, of a kind once for its array."""
        made = self.made
        turning = self._monomial("turns", tuple(turns), rotations)
        name = f"kind{KINDS.index(kind)}_{self.names[k]}_{'im' if side else 're'}_{''.join(map(str, turns))}"
        return made.symbols[name] if name in made.symbols else made.step(name, value * turning)

    def _monomial(self, name: str, numbers: tuple[int, ...], of: dict[int, ca.SX]) -> ca.SX:
        if len(numbers) == 1:
            return of[numbers[0]]
        key = f"{name}_{''.join(map(str, numbers))}"
        if key not in self.made.symbols:
            before = self._monomial(name, numbers[:-1], of)
            self.made.step(key, before * of[numbers[-1]])
        return self.made.symbols[key]

    def _pose(self, seen: Sequence[ca.SX], off: dict[str, ca.SX]) -> list[ca.SX]:
        """Add the pose from the middle of the box, linear in places and heights without what tilt adds."""
        made, labels = self.made, self._labels
        straight = {}
        for label, value in zip(labels, seen, strict=True):
            straight[label] = made.step(f"straight_{label}", value - off[label]) if label in off else value
        out = []
        for i, row in self._entries(range(6)).items():
            value = [entry * straight[label] for label, entry in row]
            name = f"linear_{short(self.found.model.pose[i])}"
            out.append(made.step(name, sum(value[1:], start=value[0]), "from the middle of the box"))
        left = sum(x * x for x in out[3:])
        most = float(((TILT * self.found.half[3:]) ** 2).sum())
        made.entry("most_turn", most, "rad2", "largest sum of the squares of the rotations")
        made.entry("least_turn_left", 0.0, "rad2", "what must be left of it")
        made.step("turn_left", made.symbols["most_turn"] - left)
        return out

    def _bent(self, linear: Sequence[ca.SX]) -> list[ca.SX]:
        """Add the middle of the box and products of displacements."""
        made, found, out = self.made, self.found, []
        of = dict(enumerate(linear))
        for i, bend in enumerate(found.bends):
            column, constant, total = found.model.pose[i], float(found.middle[i]), linear[i]
            for numbers, factor in zip(bend.terms, bend.factors, strict=True):
                if not numbers:
                    constant += factor
                    continue
                name = f"bend_{short(column)}_{''.join(map(str, numbers))}"
                about = "*".join(found.model.pose[k] for k in numbers)
                entry = made.entry(name, factor, "SI", f"{column} per {about}, from the middle of the box")
                total = total + entry * self._monomial("times", numbers, of)
            if constant:
                at = made.entry(f"{short(column)}_at_middle", constant, unit(column), f"{column} in the middle")
                total = total + at
            out.append(total)
        return out

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
            wave = 2 * pi * found.groups[found.axes[axis][0]].phasor.lc
            most = float(np.abs(found.middle[axis]) + found.half[axis] + NEAR * wave)
            ends[c] = (-most, most)
        return Box(ends)

    def drawn(self, pose: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Return inputs (n, s) of poses (6, s); `off` (2, s): of what says the period, in periods."""
        found = self.found
        nears = [
            pose[axis] + off[axis] * 2 * pi * found.groups[found.axes[axis][0]].phasor.lc
            for axis in (0, 1)
            if self._wide(axis)
        ]
        return np.vstack([found.readings(pose), *nears])

    def _drawn(self, rng: np.random.Generator, count: int) -> np.ndarray:
        pose = self.found.poses(rng, count)
        return self.drawn(pose, rng.uniform(-NEAR, NEAR, (2, count)))

    def _near(self, inputs: np.ndarray) -> np.ndarray | None:
        """What says the period (2, s), the middle of the box where nothing does; None where nothing is wide."""
        found, rows = self.found, list(inputs[len(self.found.model.channels) :])
        return np.array(
            [
                rows.pop(0) if self._wide(axis) else np.full(inputs.shape[1], found.middle[axis])
                for axis in (0, 1)
            ]
        )

    def _exact(self, inputs: np.ndarray) -> np.ndarray:
        given = np.asarray(inputs, dtype=float)
        n = len(self.found.model.channels)
        return self.found.solved(given[:n], self._near(given))

    def _leaves(self) -> dict[str, float]:
        """What is left of each coordinate: met over trial poses by exact functions, and what these leave."""
        found = self.found
        pose = found.poses(np.random.default_rng(5), TRIALS)
        met = np.abs(found.decoded(found.readings(pose), pose[:2]) - pose).max(axis=1)
        n = len(found.groups)
        each = np.array([w.error * w.phasor.lc for w in self.waves])
        functions = np.abs(found.inverse) @ np.concatenate([each, each]) * SAFE
        return dict(zip(found.model.pose, (SAFE * met + functions).tolist(), strict=True)) if n else {}

    def _said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        found = self.found
        sizes = ", ".join(f"{n} from {counted(len(g.channels), 'reading')}" for n, g in zip(self.names, found.groups, strict=True))
        turning, bends = (sum(len(t.terms) for t in terms) for terms in (found.turning, found.bends))
        listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
        return (
            f"Arrays: {sizes}. Six coordinates by weighted least squares of their places and heights, "
            f"{counted(turning, 'term')} of tilt and {counted(bends, 'product')} of coordinates.",
            f"Against least squares over all readings, converged, in double it leaves at most {listed}: {SAFE:g} times "
            f"what {TRIALS} poses of the box met, and what the polynomials leave (not a proof for every pose).",
            "Only readings of a pose in the box have that error: any others give a finite pose, and mostly a flag.",
        )



