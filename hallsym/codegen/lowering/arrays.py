"""Lowering of models of several arrays: from sums of sensors to six coordinates of a mover.

Each array gives a phasor as one wave does (`lowering.wave_steps`), so a place and a height; weighted least
squares make rotations of them, which say what tilt adds to each, and then the pose; products of rotations and
displacements are added at the end. Which channels see which array, and every number, come from the model's
own readings (`lowering.arrays_fit`). No iteration, no branch that changes the pose by
a step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations_with_replacement as combined
from math import pi, tan

import casadi as ca
import numpy as np
from scipy.linalg import qr

from hallsym.codegen import residual
from hallsym.codegen.decoupler import (
    Box,
    Collected,
    Decoupler,
    Flag,
    Redundancy,
    Trial,
    Watched,
    short,
    unit,
)
from hallsym.codegen.lowering import wave_steps
from hallsym.codegen.lowering.arrays_fit import (
    BATCH,
    KINDS,
    NEGLIGIBLE,
    SAMPLES,
    Arrays,
    Group,
    Term,
    fewest,
    groups_of,
    turning_of,
)
from hallsym.codegen.lowering.odd_series import Odd, odd, shortest
from hallsym.codegen.lowering.remainders import LEAVE, Seen, contradictions, rms
from hallsym.codegen.lowering.wave_steps import Pair, Wave
from hallsym.errors import InputError, counted
from hallsym.model import Model
from hallsym.records import named

ENOUGH = 1e-6
"""Place [m] that terms and polynomials may leave, and rotation times the arm of the family's pose metric."""
NEAR = 0.3
"""Share of a period by which what says the period may be off, and trials let it be."""
TRIALS = 20_000
STEP = 1e-6
"""Step [m, rad] of the slopes of phasors."""
FIELD = "an array's field beyond the calibrated heights: too near, too far, or no array"
TILTED = "rotations beyond the calibrated box"


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, accuracy: float) -> Decoupler:
    """Return the decoupler of several arrays at parameters `p` over a box; see `lowering.wave.decoupler`."""
    middle, half, leaves = ends_and_leaves(model, box, accuracy)
    aim = float(leaves[0])
    own = replace(model, period={c: v for c, v in model.period.items() if c not in model.pose})
    groups, level = groups_of(own, p, weight, middle, box.ends[model.pose[2]])
    half, middle = half + np.abs(level - middle), level
    found = Arrays(own, np.asarray(p, dtype=float), weight, middle, half, leaves, groups)
    return Assembly(found, _waves(found, aim), box).make()


def ends_and_leaves(model: Model, box: Box, accuracy: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middle and half of the box (6,), and what terms may leave of each coordinate (6,)."""
    ends = np.array([box.ends[c] for c in model.pose])
    arm = model.family.pose_metric.arm_m
    leaves = np.array([accuracy if c.endswith("_m") else accuracy / arm for c in model.pose])
    return ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / 2, leaves


def _waves(found: Arrays, aim: float) -> tuple[Wave, ...]:
    """Return the wave of each array over the heights that poses of the box bring it to."""
    out = []
    for group, u in zip(found.groups, found.swept, strict=True):
        heights = group.phasor.pose(u)[1]
        if not np.isfinite(heights).all():
            raise InputError(
                "Tilt brings an array of the box so near that its harmonics cannot be distinguished; give a "
                "smaller range of rotations or heights with --range."
            )
        out.append(wave_steps.wave_of(group.phasor, (float(heights.min()), float(heights.max())), aim))
    return tuple(out)


@dataclass(eq=False)
class Assembly:
    """Collects the decoupler of one calibration over a box."""

    found: Arrays
    waves: tuple[Wave, ...]
    given: Box
    made: Collected = field(default_factory=Collected)

    def __post_init__(self) -> None:
        """Name the arrays: x_1, x_2, y_1, y_2; begin the steps, and their trial over poses of the box."""
        pose = self.found.model.pose
        self.names = [f"{short(pose[a])}_{k + 1}" for a, m in self.found.axes.items() for k in range(len(m))]
        self.nears = tuple(f"{short(pose[axis])}_near_m" for axis in (0, 1) if self.wide(axis))
        self.inputs = (*self.found.model.channels, *self.nears)
        self.made.begin(self.found.model, self.inputs)
        self.poses, readings = self.found.trials(1, SAMPLES)
        self.tried = self.trial(readings, self.poses)

    def readings_of(self, group: Group) -> dict[str, ca.SX]:
        """Symbols of the readings of an array, by name."""
        columns = [self.found.model.channels[k] for k in group.channels]
        return {short(c): self.made.symbols[c] for c in columns}

    def trial(self, readings: np.ndarray, near: np.ndarray) -> Trial:
        """Return the trial of readings (n, s); `near` (2, s): places that say the period."""
        nears = dict(zip(self.nears, (near[axis] for axis in (0, 1) if self.wide(axis)), strict=True))
        return Trial(self.made, {**dict(zip(self.found.model.channels, readings, strict=True)), **nears})

    def decoded(self, readings: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return the poses (n_pose, s) of readings (n, s) by all steps."""
        names = [short(c) for c in self.found.model.pose]
        parts = (slice(k, k + BATCH) for k in range(0, readings.shape[1], BATCH))
        return np.hstack([self.trial(readings[:, part], near[:, part])(names) for part in parts])

    def turn(self, first: int, k: int, vectors: Sequence[Pair]) -> ca.SX:
        """Angle of one phasor from the first of its axis: small, so one polynomial without quadrants."""
        made, (a, b), (c, d), name = self.made, vectors[first], vectors[k], self.names[k]
        real = made.step(f"cross_real_{name}", c * a + d * b)
        imaginary = made.step(f"cross_imaginary_{name}", d * a - c * b)
        # no reading turns two phasors beyond the end of the polynomial: limit real - cotangent |imaginary|
        least, angle = self.waves[first].least * self.waves[k].least, self._angle(first, k)
        steep = 1.0 / self.series(first, k).end
        floor = 0.5 * least * (float(np.cos(angle)) - steep * float(np.sin(angle)))
        cone = made.entry(f"cone_{name}", steep, "1", "cotangent of the largest turn of two phasors", "sign")
        about = "least product of two phasors of the box"
        bound = cone * ca.fabs(imaginary) + made.entry(f"least_cross_{name}", floor, "1", about, "sign")
        bound = made.step(f"bound_{name}", bound)
        clamped = made.step(f"held_cross_{name}", ca.if_else(real > bound, real, bound))
        tangent = made.step(f"cross_{name}", imaginary / clamped, most=1.0 / cone)
        square = made.step(f"cross_square_{name}", tangent * tangent)
        return made.step(f"turn_{name}", odd(self.series(first, k).coefficients, tangent, square), "[rad]")

    def _angle(self, first: int, k: int) -> float:
        """Largest turn of two phasors of an axis over the box [rad], and of noise that no fault hides in."""
        u, noise = self.found.swept, np.hypot(*(self.noise[n] / self.waves[n].least for n in (first, k)))
        return float(np.abs(np.angle(u[k] * u[first].conj())).max()) * 1.05 + BEYOND_NOISE * noise

    def series(self, first: int, k: int) -> Odd:
        """Return the polynomial of that angle."""
        end = np.ceil(20 * ROOMY * tan(min(self._angle(first, k), 1.4))) / 20
        share = wave_steps.POLYNOMIALS * float(self.found.accuracy[0]) / self.found.groups[k].phasor.lc
        series = shortest("atan", float(end), share, fewest=1)
        if series is None:
            raise InputError(
                "Rotations of the box turn two arrays of an axis by most of a period against each other; "
                "give a smaller range of rotations with --range."
            )
        return series

    def wide(self, axis: int) -> bool:
        """Whether the box spans more than the period that readings resolve."""
        return bool(2 * self.found.half[axis] > WITHIN * self.found.wave_of(axis))

    def unwrapped(self, axis: int) -> bool:
        """Whether no pose of the box brings the phase of the first array of an axis near half a turn.

        Then the place is that phase times lc: nothing to wrap, and no mean of the arrays is needed for it.
        """
        phase = np.abs(np.angle(self.found.swept[self.found.axes[axis][0]])).max()
        return not self.wide(axis) and bool(phase < WITHIN * pi)

    def least(self) -> None:
        """Add what the flag of the field looks at: the least of 1 - t^2 over the arrays."""
        made, names = self.made, self.names
        value = made.symbols[f"tangent_square_{names[0]}"]
        for name in names[1:]:
            other = made.symbols[f"tangent_square_{name}"]
            value = made.step(f"most_to_{name}", ca.if_else(value > other, value, other))
        made.step(f"least_to_{names[-1]}", 1.0 - value)  # to the last bit

    # -- places and heights --------------------------------------------------------------------------------

    def places(self, vectors: Sequence[Pair]) -> list[ca.SX]:
        """For each axis: mean place [m] from the middle, then turns of the other arrays from the first."""
        made, out = self.made, []
        for axis, members in self.found.axes.items():
            first, name = members[0], self.names[members[0]]
            phase = wave_steps.arctangent_steps(made, self.waves[first], vectors[first], f"_{name}")
            turns = [self.turn(first, k, vectors) for k in members[1:]]
            total = phase
            if turns and not self.unwrapped(axis):
                total = phase + sum(turns[1:], start=turns[0]) * (1.0 / len(members))
            lc = self.found.groups[first].phasor.lc
            entry = made.entry(f"lc_{name}", lc, "m", "wavelength over 2 pi", "sign")
            if self.unwrapped(axis):
                out += [made.step(f"along_{name}", entry * total, "[m] from the middle"), *turns]
                continue
            place = made.step(f"place_{name}", entry * total, "[m] mean of the axis")
            out += [self._in_period(axis, name, place, lc), *turns]
        return out

    def _in_period(self, axis: int, name: str, place: ca.SX, lc: float) -> ca.SX:
        """The place from the middle of the box, in the period that is meant."""
        made, column = self.made, short(self.found.model.pose[axis])
        whole = made.entry(f"wavelength_{name}", 2 * pi * lc, "m", "wavelength", "sign")
        if not self.wide(axis):
            half = made.entry(f"half_wave_{name}", pi * lc, "m", "half the wavelength", "sign")
            beyond = made.step(f"next_{name}", place - ca.if_else(place < 0, -whole, whole))
            return made.step(f"along_{name}", ca.if_else(ca.fabs(place) <= half, place, beyond), "[m]")
        per = made.entry(f"per_wave_{name}", 1 / (2 * pi * lc), "1/m", "periods per metre", "sign")
        center = made.entry(f"{column}_middle", float(self.found.middle[axis]), "m", "middle of the box")
        away = (made.symbols[f"{column}_near_m"] - center) - place
        number = wave_steps.periods_steps(made, away * per, f"_{name}", "periods to the known place")
        return made.step(f"along_{name}", place + whole * number, "[m]")

    # -- the pose ------------------------------------------------------------------------------------------

    @property
    def labels(self) -> list[str]:
        """Of what the pose is linear in: mean place and turns by axis, then logarithms."""
        out = []
        for members in self.found.axes.values():
            out += [f"along_{self.names[members[0]]}", *(f"turn_{self.names[k]}" for k in members[1:])]
        return [*out, *(f"log_{n}" for n in self.names)]

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation of each phasor (arrays,)."""
        groups, weight = self.found.groups, self.found.weight
        return np.array([np.sqrt((g.phasor.weights**2 / weight[list(g.channels)]).sum()) for g in groups])

    @cached_property
    def scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (2 arrays, n_pose) of phases and logarithms by the pose about the middle, and phases and
        logarithms per label (2 arrays, labels); both over the standard deviations of noise."""
        found, moves = self.found, STEP * np.eye(len(self.found.middle))
        ends = found.middle[:, None] + np.hstack([moves, -moves])
        up, down = np.hsplit(np.array(found.phasors(found.readings(ends))), 2)
        rotation = np.log(up / down) / (2 * STEP)
        slopes = np.vstack([rotation.imag, rotation.real])
        root = np.tile(self.noise, 2)[:, None]
        return slopes / root, np.linalg.inv(self.by_array) / root

    @property
    def matrix(self) -> np.ndarray:
        """Pose per label (n_pose, labels): weighted least squares."""
        return np.asarray(np.linalg.lstsq(*self.scaled, rcond=None)[0])

    @cached_property
    def by_array(self) -> np.ndarray:
        """Labels per phase and logarithm of each array, (labels, 2 arrays)."""
        out = np.eye(2 * len(self.found.groups))
        for axis, (first, *others) in self.found.axes.items():
            mean = 0.0 if self.unwrapped(axis) else 1.0 / (1 + len(others))
            out[first, [first, *others]] = [1.0 - len(others) * mean, *[mean] * len(others)]
            out[first] *= self.found.groups[first].phasor.lc
            out[others, first] = -1.0
        return out

    def spread_of(self, labels: Sequence[str]) -> np.ndarray:
        """Return how far labels are from their mean over poses of the box."""
        seen = self.tried(labels)
        return np.asarray(np.abs(seen - seen.mean(axis=1, keepdims=True)).max(axis=1))

    @cached_property
    def _rows(self) -> dict[int, dict[str, float]]:
        """By coordinate: what counts of labels, and for displacements of rotations, in the linear pose.

        A displacement is the mean place of its axis less what rotations move it by: fewer entries than all
        labels.
        """
        found, matrix, labels, spread = self.found, self.matrix, self.labels, self.spread
        out: dict[int, dict[str, float]] = {}
        for i, column in enumerate(found.model.pose):
            row, turns = matrix[i], np.zeros(len(found.turns))
            if len(turns) and i in self.found.axes:
                own = [self.names[k] for k in self.found.axes[i]]
                other = [k for k, label in enumerate(labels)
                         if label.startswith("log_") or label.partition("_")[2] not in own]  # fmt: skip
                seen_by = matrix[:, other] * spread[other]  # of labels that other axes, or heights, say
                turns, *_ = np.linalg.lstsq(seen_by[3:].T, seen_by[i], rcond=LEAST_SHARE)
                row = row - turns @ matrix[3:]
            most = NEGLIGIBLE * found.accuracy[i]
            out[i] = {n: float(v) for n, v, s in zip(labels, row, spread, strict=True) if abs(v) * s > most}
            for k, value in enumerate(turns):
                if abs(value) * found.half[3 + k] > most:
                    out[i][f"linear_{short(found.model.pose[3 + k])}"] = float(value)
            if not out[i]:
                raise InputError(f"No array of {found.model.name} tells {column}; it cannot be decoded.")
        return out

    def total(self, i: int, values: Mapping[str, ca.SX]) -> ca.SX:
        """Sum of the entries of a row times labels; the entry 1 is left out."""
        column, terms = self.found.model.pose[i], []
        for label, value in self._rows[i].items():
            if abs(value - 1) < ONE:
                terms.append(values[label])
                continue
            name = f"{short(column)}_{label}"
            entry = self.made.entry(name, value, unit(column), f"{column} per {label}")
            terms.append(entry * values[label])
        return sum(terms[1:], start=terms[0])

    def _tilts(self, vectors: Sequence[Pair]) -> list[dict[Term, float]]:
        """Return what a tilt adds to phase and logarithm of each array, (2 arrays): factors by term."""
        found, seen = self.found, self.tried(self.labels)
        inside = np.abs(self.matrix @ seen + found.middle[:, None] - self.poses)[:2].max(axis=0)
        inside = inside < found.groups[0].phasor.lc  # no place wraps
        self.tried.only(inside)
        self.poses, seen = self.poses[:, inside], seen[:, inside]
        smooth = np.array([
            np.prod(((self.poses - found.middle[:, None]) / found.half[:, None])[list(c)], axis=0)
            for degree in range(4)
            for c in combined(range(6), degree)
        ])  # fmt: skip
        basis, _ = np.linalg.qr(smooth.T)
        terms = [
            (kind, c, part)
            for kind in KINDS
            for degree in (0, 1, 2)
            for c in combined(range(3), degree)
            for part in (0, 1)
        ]
        rotations, own, out = self.matrix[3:] @ seen, np.linalg.solve(self.by_array, seen), []
        # what a phase or logarithm adds to the coordinates, over what they may be off by
        share = (np.abs(self.matrix @ self.by_array) / found.accuracy[:, None]).max(axis=0)
        for row, target in enumerate(own):
            re, im = self.tried([v.name() for v in vectors[row % len(found.groups)]])
            columns = np.array([turning_of(re + 1j * im, rotations, term) for term in terms])
            free, rest = (v - (v @ basis) @ basis.T for v in (columns, target))
            out.append(fewest(terms, free, rest, 1 / (2 * share[row])))
        return out

    def turning(self, vectors: Sequence[Pair]) -> dict[str, ca.SX]:
        """Add what tilt adds to each label."""
        found, made = self.found, self.made
        self.tilts = self._tilts(vectors)
        if not any(self.tilts):
            return {}
        used = {c for part in self.tilts for _, turns, _ in part for c in turns}
        rotations = {}
        for k in sorted(used):
            name = f"first_{short(found.model.pose[3 + k])}"
            rotations[k] = made.step(name, self.total(3 + k, made.symbols), "[rad] first estimate")
        sums: list[ca.SX] = []
        n = len(found.groups)
        for row, part in enumerate(self.tilts):
            k, what = row % n, "place" if row < n else "log"
            total = ca.SX(0)
            for j, ((kind, turns, side), factor) in enumerate(part.items(), 1):
                value = self._kind(k, kind, vectors)[side]
                product = self._product(value, kind, side, turns, k, rotations)
                about = f"tilt in {what} of {self.names[k]}"
                total = total + made.entry(f"tilt_{what}_{self.names[k]}_{j}", factor, "1", about) * product
            sums.append(total)
        return self._by_label(sums)

    def _by_label(self, sums: Sequence[ca.SX]) -> dict[str, ca.SX]:
        """What is added to places and logarithms of the arrays (over lc), as added to labels."""
        found, made, n, out = self.found, self.made, len(self.found.groups), {}
        for members in found.axes.values():
            places = [made.step(f"tilted_{self.names[k]}", sums[k], "[rad] of a tilt") for k in members]
            lc = made.symbols[f"lc_{self.names[members[0]]}"]
            mean = places[0]
            if not self.unwrapped(found.groups[members[0]].axis):
                mean = sum(places[1:], start=mean) * (1.0 / len(members))
            out[f"along_{self.names[members[0]]}"] = lc * mean
            for k, place in zip(members[1:], places[1:], strict=True):
                out[f"turn_{self.names[k]}"] = place - places[0]
        for k in range(n):
            out[f"log_{self.names[k]}"] = sums[n + k]
        return out

    def _kind(self, k: int, kind: str, vectors: Sequence[Pair]) -> Pair:
        """Real and imaginary part of a kind of term of an array, made where first used."""
        made, name = self.made, self.names[k]
        key = f"kind{KINDS.index(kind)}_{name}"
        powers = wave_steps.Powers(made, *vectors[k], f"_of_{name}")
        if kind == "4":
            re, im = powers(4)
        elif kind == "-4":
            a, b = self._kind(k, "2", vectors)
            re, im = a * a - b * b, (a * b) + (a * b)
        else:
            c, d = powers(int(kind))
            clamped = self._clamped_size(name)
            re, im = c / clamped, -(d / clamped)
        return made.step(f"{key}_re", re), made.step(f"{key}_im", im)

    def _clamped_size(self, name: str) -> ca.SX:
        """The square of a phasor, no less than where the flag is set."""
        made, value = self.made, min(w.least for w in self.waves) ** 2
        size = made.symbols[f"size_{name}"]
        least = made.entry("least_size", value, "1", "least of a square", "sign")
        return made.step(f"held_size_{name}", ca.if_else(size > least, size, least))

    def _product(
        self, value: ca.SX, kind: str, side: int, turns: tuple[int, ...], k: int, rotations: dict[int, ca.SX]
    ) -> ca.SX:
        """A kind times rotations: products of rotations once for all, of a kind once for its array."""
        if not turns:
            return value
        turning = self._monomial("turns", tuple(turns), rotations)
        name = f"kind{KINDS.index(kind)}_{self.names[k]}_{'im' if side else 're'}_{''.join(map(str, turns))}"
        return self.made.step(name, value * turning)

    def _monomial(self, name: str, numbers: tuple[int, ...], of: dict[int, ca.SX]) -> ca.SX:
        if len(numbers) == 1:
            return of[numbers[0]]
        before = self._monomial(name, numbers[:-1], of)
        return self.made.step(f"{name}_{''.join(map(str, numbers))}", before * of[numbers[-1]])

    def pose(self, seen: Sequence[ca.SX], off: dict[str, ca.SX]) -> list[ca.SX]:
        """Add the pose from the middle of the box, linear in places and heights without what tilt adds."""
        made, labels = self.made, self.labels
        straight = {}
        for label, value in zip(labels, seen, strict=True):
            straight[label] = made.step(f"straight_{label}", value - off[label]) if label in off else value
        self.straight = list(straight.values())
        linear: dict[int, ca.SX] = {}
        for i in (*self.found.turns, *range(self.found.height + 1)):
            name = f"linear_{short(self.found.model.pose[i])}"
            straight[name] = linear[i] = made.step(
                name, self.total(i, straight), "from the middle of the box"
            )
        out = [linear[i] for i in sorted(linear)]
        if not self.found.turns:
            return out
        most = float(((TILT * self.found.half[3:]) ** 2).sum())
        made.entry(
            "least_turns", -most, "rad2", "less the largest sum of the squares of the rotations", "sign"
        )
        made.step("turns", -(out[3] * out[3] + out[4] * out[4] + out[5] * out[5]))
        return out

    def _bends(self, linear: Sequence[ca.SX]) -> list[dict[tuple[int, ...], float]]:
        """Return products of displacements (their numbers) that are added to each coordinate, with factors.

        Rotations make them: none without.
        """
        found, v = self.found, self.tried([value.name() for value in linear])
        if not found.turns or not np.isfinite(v).all():
            return [{}] * len(linear)
        off = self.poses - found.middle[:, None] - v
        terms = [c for degree in range(4) for c in combined(range(6), degree)]
        columns = np.array([np.prod(v[list(c)], axis=0) for c in terms])
        return [fewest(terms, columns, row, most / 2) for row, most in zip(off, found.accuracy, strict=True)]

    def bent(self, linear: Sequence[ca.SX]) -> list[ca.SX]:
        """Add the middle of the box and products of displacements."""
        made, found, out = self.made, self.found, []
        of = dict(enumerate(linear))
        self.bends = self._bends(linear)
        for i, bend in enumerate(self.bends):
            column, constant, total = found.model.pose[i], float(found.middle[i]), linear[i]
            for numbers, factor in bend.items():
                if not numbers:
                    constant += factor
                    continue
                name = f"bend_{short(column)}_{''.join(map(str, numbers))}"
                about = "*".join(found.model.pose[k] for k in numbers)
                entry = made.entry(name, factor, "SI", f"{column} per {about}, from the middle of the box")
                total = total + entry * self._monomial("times", numbers, of)
            if constant:
                at = made.entry(
                    f"{short(column)}_at_middle", constant, unit(column), f"{column} in the middle"
                )
                total = total + at
            out.append(total)
        return out

    # -- the whole -----------------------------------------------------------------------------------------

    def steps(self) -> list[ca.SX]:
        """Add the steps from the inputs to the pose; returns displacements from the middle, linear."""
        made, pose = self.made, self.found.model.pose
        linear = self.linear()
        for column, value in zip(pose, self.bent(linear), strict=True):
            made.step(short(column), made.symbols[f"zero_{short(column)}"] + value, f"[{unit(column)}]")
        return linear

    def make(self) -> Decoupler:
        """Return the decoupler."""
        made, model, inputs = self.made, self.found.model, self.inputs
        ends = self._ends()
        linear = self.steps()
        pose = made.steps[-len(model.pose) :]
        redundancy = self.redundancy(linear)
        made.steps = [*(s for s in made.steps if s not in pose), *pose]
        flags = (*self.flags, *((residual.flag(),) if redundancy else ()))
        left = redundancy.steps if redundancy else ()
        made.keep((*(short(c) for c in model.pose), *(flag.step for flag in flags), *left))
        leaves = self.leaves()
        return made.finished(
            model, inputs, ends, exact=self.exact,
            flags=flags, redundancy=redundancy, leaves=leaves, drawn=self.drawn_of_box,
            sampled=True, said=self.said(leaves), evident=False,
        )  # fmt: skip

    def linear(self) -> list[ca.SX]:
        """Add the steps from the readings to the linear pose; returns its displacements from the middle."""
        vectors: list[Pair] = []
        for wave, group, name in zip(self.waves, self.found.groups, self.names, strict=True):
            readings = self.readings_of(group)
            vectors.append(wave_steps.phasor_steps(self.made, wave, readings, f"_{name}"))
        logs = [
            wave_steps.logarithm_steps(self.made, w, u, f"_{n}")
            for w, u, n in zip(self.waves, vectors, self.names, strict=True)
        ]
        wave_steps.least_inside(self.made, self.waves)
        self.least()
        seen = [*self.places(vectors), *logs]
        self.spread = self.spread_of(self.labels)
        return self.pose(seen, self.turning(vectors))

    def redundancy(self, linear: Sequence[ca.SX]) -> Redundancy | None:
        """Add what is left of the readings of each array, and of the arrays where that cannot tell some."""
        found, made = self.found, self.made
        read, tilted, waves = found.readings(self.poses), self.poses[3:] - found.middle[3:, None], []
        for group, wave, name in zip(found.groups, self.waves, self.names, strict=True):
            cos, sin = (made.symbols[f"{axis}_{wave.rounds or 'seen'}_{name}"] for axis in wave_steps.AXES)
            waves.append(Seen(group.channels, group.phasor, self.readings_of(group), (cos, sin), f"_{name}"))
        sigma, tilts = found.weight**-0.5, dict(enumerate(linear[3:]))
        more = partial(self._across, linear, float(sigma.max()))
        return contradictions(made, waves, sigma, read, tilts, tilted, more)

    def _across(self, linear: Sequence[ca.SX], unit: float) -> list[Watched]:
        """Add what the arrays leave of the pose beyond its unknowns; `unit` [V]: its standard deviation.

        An array of three readings sees that one of them is off, and the others see which one.
        """
        made, (slopes, by_label), labels = self.made, self.scaled, self.labels
        left = np.eye(len(slopes)) - slopes @ np.linalg.pinv(slopes)
        basis = qr(left, pivoting=True)[0][:, : len(slopes) - slopes.shape[1]]
        rows = unit * min(w.least for w in self.waves) * (basis.T @ by_label)
        terms = [c for degree in range(3) for c in combined(range(slopes.shape[1]), degree)]
        seen, off = (self.tried([v.name() for v in some]) for some in (linear, self.straight))
        columns, out, of = (
            np.array([np.prod(seen[list(c)], axis=0) for c in terms]),
            [],
            dict(enumerate(linear)),
        )
        for k, row in enumerate(rows, 1):
            name, few = f"across_{k}", fewest(terms, columns, row @ off, LEAVE * unit, rms)
            parts = [
                made.entry(f"{name}_{label}", v, "V", f"{label} in what the arrays contradict") * value
                for label, value, v, s in zip(labels, self.straight, row, self.spread, strict=True)
                if abs(v) * s > NEGLIGIBLE * unit
            ]
            for c, v in few.items():
                about = "*".join(self.found.model.pose[i] for i in c) or "1"
                entry = made.entry(
                    f"{name}_{''.join(map(str, c)) or 'of_all'}", -v, "SI", f"the same per {about}"
                )
                parts.append(entry * self._monomial("times", c, of) if c else entry)
            made.total(name, parts, "[V] that the arrays contradict one another by")
            out.append(Watched(name, ()))
        return out

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Status bits beyond the ranges."""
        field = Flag("FIELD", f"least_to_{self.names[-1]}", "least_inside", FIELD)
        return (field, Flag("TILT", "turns", "least_turns", TILTED)) if self.found.turns else (field,)

    # -- ranges, trials, what is said ----------------------------------------------------------------------

    def _ends(self) -> Box:
        """Ranges of readings over poses of the box, and of what says the period."""
        found = self.found
        ends = wave_steps.ranges(found.model.channels, found.trials(4, 4000)[1], self.given)
        for c in self.nears:
            axis = 0 if short(found.model.pose[0]) == c.removesuffix("_near_m") else 1
            most = float(np.abs(found.middle[axis]) + found.half[axis] + NEAR * found.wave_of(axis))
            ends[c] = (-most, most)
        return self.given.over(ends)

    def drawn_of_box(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random inputs (n, s) of poses of the box, what says the period off by `NEAR` at most."""
        found, pose = self.found, self.found.poses(rng, count)
        off = rng.uniform(-NEAR, NEAR, (2, count))
        nears = [pose[axis] + off[axis] * found.wave_of(axis) for axis in (0, 1) if self.wide(axis)]
        return np.vstack([found.readings(pose), *nears])

    def exact(self, inputs: np.ndarray) -> np.ndarray:
        """Return the poses (6, s) of inputs (n, s) by the reference decoder."""
        n, given = len(self.found.model.channels), np.asarray(inputs, dtype=float)
        rows, middle = list(given[n:]), np.broadcast_to(self.found.middle[:2, None], (2, given.shape[1]))
        near = np.array([rows.pop(0) if self.wide(axis) else middle[axis] for axis in (0, 1)])
        return self.found.solved(given[:n], self.decoded(given[:n], near))

    def leaves(self) -> dict[str, float]:
        """What is left of each coordinate: met over trial poses."""
        pose = self.found.poses(np.random.default_rng(5), TRIALS)
        met = np.abs(self.decoded(self.found.readings(pose), pose[:2]) - pose).max(axis=1)
        return named(self.found.model.pose, wave_steps.SAFE * met)

    def said(self, leaves: dict[str, float]) -> tuple[str, ...]:
        """Return sentences for header and report."""
        found = self.found
        sizes = ", ".join(
            f"{n} from {counted(len(g.channels), 'reading')}"
            for n, g in zip(self.names, found.groups, strict=True)
        )
        turning, bends = (sum(map(len, terms)) for terms in (self.tilts, self.bends))
        return (
            f"Arrays: {sizes}. Six coordinates by weighted least squares of their places and heights, "
            f"{counted(turning, 'term')} of tilt and {counted(bends, 'product')} of coordinates.",
            f"{wave_steps.REVERSED}: no bit is raised.",
            *wave_steps.measured(wave_steps.AGAINST, leaves, TRIALS),
        )


BEYOND_NOISE = 30.0
"""Standard deviations by which the turn of two phasors may exceed that of the box before it is clamped: more
than twice any limit, so that a clamped one contradicts the other arrays."""
ROOMY = 1.1
"""Times the largest tangent of the box: end of the polynomial of a turn."""


TILT = 1.1
"""Times the largest rotation of the box beyond which the flag of the pose is set."""
WITHIN = 0.98
"""Share of a period that a box may span where no input says which period it is."""
LEAST_SHARE = 1e-6
"""Share of the largest below which what a rotation does to labels is rounding of the analysis."""
ONE = 1e-9
"""Distance from 1 of an entry that is 1 but for rounding of the analysis."""
