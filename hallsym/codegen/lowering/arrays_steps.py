"""Steps from the phasors of several arrays to six coordinates of a mover."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Whole
from hallsym.codegen.entries import short, unit
from hallsym.codegen.lowering.arrays_fit import KINDS, NEGLIGIBLE
from hallsym.codegen.lowering.arrays_turns import Turns
from hallsym.codegen.lowering.wave_steps import (
    Pair,
    Powers,
    arctangent_steps,
    least_inside,
    phasor_steps,
)
from hallsym.errors import InputError

TILT = 1.1
"""Times the largest rotation of the box beyond which the flag of the pose is set."""
WITHIN = 0.98
"""Share of a period that a box may span where no input says which period it is."""
PERIODS = 1 << 12
"""Added to whole periods, so that they are no negative number."""
LOST = 1e-12
"""Displacement [m] that is rounding of the analysis."""
LEAST_SHARE = 1e-6
"""Share of the largest below which what a rotation does to labels is rounding of the analysis."""
ONE = 1e-9
"""Distance from 1 of an entry that is 1 but for rounding of the analysis."""


@dataclass(eq=False)
class Pieces(Turns):
    """Adds the steps of one calibration, one after the other."""

    _unwrapped: dict[int, bool] = field(default_factory=dict, init=False)

    def wide(self, axis: int) -> bool:
        """Whether the box spans more than the period that readings resolve."""
        return bool(2 * self.found.half[axis] > WITHIN * self.found.wave_of(axis))

    def unwrapped(self, axis: int) -> bool:
        """Whether no pose of the box brings the phase of the first array of an axis near half a turn.

        Then the place is that phase times lc: nothing to wrap, and no mean of the arrays is needed for it.
        """
        if axis not in self._unwrapped:
            self._unwrapped[axis] = not self.wide(axis) and self._far_from_half(axis)
        return self._unwrapped[axis]

    def _far_from_half(self, axis: int) -> bool:
        found = self.found
        pose = found.poses(np.random.default_rng(2), 2000)
        first = found.axes[axis][0]
        phase = np.angle(found.phasors(found.readings(pose))[first])
        return bool(np.abs(phase).max() < WITHIN * pi and abs(found.at_middle[first, 0]) < LOST)

    def vector(self, k: int) -> Pair:
        """Add the steps from the readings of an array to its phasor."""
        group, name = self.found.groups[k], self.names[k]
        readings = {
            short(c): self.made.symbols[c] for c in (self.found.model.channels[j] for j in group.channels)
        }
        return phasor_steps(self.made, self.waves[k], readings, f"_{name}")

    def least_inside(self) -> str:
        """The least of what the flag of the field looks at, over the arrays, each over its own least."""
        least_inside(self.made, self.waves)
        return self.least()

    def least(self) -> str:
        """The least of these steps of all arrays."""
        made, names = self.made, self.names
        value = made.symbols[f"tangent_square_{names[0]}"]
        for name in names[1:]:
            other = made.symbols[f"tangent_square_{name}"]
            value = made.step(f"most_to_{name}", ca.if_else(value > other, value, other))
        made.step(f"least_to_{names[-1]}", 1.0 - value)  # the least of 1 - t^2, to the last bit
        return f"least_to_{names[-1]}"

    # -- places and heights --------------------------------------------------------------------------------

    def heights(self, logs: Sequence[ca.SX]) -> list[ca.SX]:
        """Heights from those in the middle of the box, over lc and without sign: logarithms."""
        out = []
        for k, (group, seen) in enumerate(zip(self.found.groups, logs, strict=True)):
            at = float(self.found.at_middle[len(logs) + k, 0])
            value = group.phasor.rising * (at - group.phasor.middle) / group.phasor.lc
            if abs(value) * group.phasor.lc < LOST:
                out.append(self.made.step(f"deep_{self.names[k]}", seen))
                continue
            entry = self.made.entry(
                f"log_{self.names[k]}_middle", value, "1", "logarithm in the middle of the box"
            )
            out.append(self.made.step(f"deep_{self.names[k]}", seen - entry))
        return out

    def places(self, vectors: Sequence[Pair]) -> list[ca.SX]:
        """For each axis: the mean place [m] from the middle, then the turns of the other arrays from the
        first."""
        made, out = self.made, []
        for axis, members in self.found.axes.items():
            first = members[0]
            phase = arctangent_steps(made, self.waves[first], vectors[first], f"_{self.names[first]}")
            turns = [self.turn(first, k, vectors) for k in members[1:]]
            total = phase
            if turns and not self.unwrapped(axis):
                total = phase + sum(turns[1:], start=turns[0]) * (1.0 / len(members))
            lc = self.found.groups[first].phasor.lc
            name = self.names[first]
            entry = made.entry(f"lc_{name}", lc, "m", "wavelength over 2 pi")
            if self.unwrapped(axis):
                out += [made.step(f"along_{name}", entry * total, "[m] from the middle"), *turns]
                continue
            place = made.step(f"place_{name}", entry * total, "[m] mean of the axis")
            out += [self._in_period(axis, name, place, lc), *turns]
        return out

    def _in_period(self, axis: int, name: str, place: ca.SX, lc: float) -> ca.SX:
        """The place from the middle of the box, in the period that is meant."""
        made, column = self.made, short(self.found.model.pose[axis])
        at = float(self.found.at_middle[self.found.axes[axis], 0].mean())
        whole = made.entry(f"wavelength_{name}", 2 * pi * lc, "m", "wavelength")
        from_middle = place
        if abs(at) > LOST:
            middle = made.entry(f"place_{name}_middle", at, "m", "place in the middle of the box")
            from_middle = place - middle
        from_middle = made.step(f"from_middle_{name}", from_middle)
        if not self.wide(axis):
            half = made.entry(f"half_wave_{name}", pi * lc, "m", "half the wavelength")
            beyond = made.step(f"next_{name}", from_middle - ca.if_else(from_middle < 0, -whole, whole))
            return made.step(
                f"along_{name}", ca.if_else(ca.fabs(from_middle) <= half, from_middle, beyond), "[m]"
            )
        per = made.entry(f"per_wave_{name}", 1 / (2 * pi * lc), "1/m", "periods per metre")
        center = made.entry(f"{column}_middle", float(self.found.middle[axis]), "m", "middle of the box")
        away = (made.symbols[f"{column}_near_m"] - center) - from_middle
        count = made.step(f"periods_{name}", away * per + (PERIODS + 0.5))
        most = 2.0 * PERIODS  # of readings of no pose it could be anything
        held = ca.if_else(count < 0.0, 0.0, ca.if_else(count > most, most, count))
        count = made.step(f"counted_{name}", held, "periods to the known place")
        made.steps.append(Whole(f"whole_{name}", count))
        number = made.symbols.setdefault(f"whole_{name}", ca.SX.sym(f"whole_{name}"))
        return made.step(f"along_{name}", from_middle + whole * (number - float(PERIODS)), "[m]")

    # -- the pose ------------------------------------------------------------------------------------------

    @property
    def labels(self) -> list[str]:
        """Of what the pose is linear in: mean place and turns by axis, then logarithms."""
        out = []
        for members in self.found.axes.values():
            out += [f"along_{self.names[members[0]]}", *(f"turn_{self.names[k]}" for k in members[1:])]
        return [*out, *(f"deep_{n}" for n in self.names)]

    @property
    def matrix(self) -> np.ndarray:
        """Pose per label (6, labels), from the inverse per place and height."""
        groups, n = self.found.groups, len(self.found.groups)
        back = np.zeros((2 * n, 2 * n))  # places and heights per label
        row = 0
        for members in self.found.axes.values():
            back[members, row] = 1.0
            for j, k in enumerate(members[1:], 1):
                lc = groups[k].phasor.lc
                if not self.unwrapped(groups[members[0]].axis):
                    back[members, row + j] = -lc / len(members)
                back[k, row + j] += lc
            row += len(members)
        for k, group in enumerate(groups):
            back[n + k, n + k] = group.phasor.rising * group.phasor.lc
        return np.asarray(self.found.inverse @ back)

    @cached_property
    def _rows(self) -> dict[int, dict[str, float]]:
        """By coordinate: what counts of labels, and for displacements of rotations, in the linear pose.

        A displacement is the mean place of its axis less what rotations move it by: fewer entries than all
        labels.
        """
        found, matrix, labels = self.found, self.matrix, self.labels
        _, _, seen = found.sample
        spread = np.abs(np.linalg.pinv(matrix) @ (found.inverse @ (seen - found.at_middle))).max(axis=1)
        out: dict[int, dict[str, float]] = {}
        for i, column in enumerate(found.model.pose):
            row, turns = matrix[i], np.zeros(3)
            if i < len(self.found.axes):
                own = [self.names[k] for k in self.found.axes[i]]
                other = [k for k, label in enumerate(labels)
                         if label.startswith("deep_") or label.partition("_")[2] not in own]  # fmt: skip
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
            if name not in self.made.symbols:
                self.made.entry(name, value, unit(column), f"{column} per {label}")
            terms.append(self.made.symbols[name] * values[label])
        return sum(terms[1:], start=terms[0])

    def turning(self, vectors: Sequence[Pair]) -> dict[str, ca.SX]:
        """Add what tilt adds to each label."""
        found, made = self.found, self.made
        terms = found.turning
        if not any(t.terms for t in terms):
            return {}
        used = {c for t in terms for _, turns, _ in t.terms for c in turns}
        rotations = {}
        for k in sorted(used):
            name = f"first_{short(found.model.pose[3 + k])}"
            rotations[k] = made.step(name, self.total(3 + k, made.symbols), "[rad] first estimate")
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
                entry = made.entry(
                    name, factor / scale, "1", f"tilt in {name.split('_')[1]} of {self.names[k]}"
                )
                total = total + entry * product
            sums.append(total)
        return self._by_label(sums)

    def _by_label(self, sums: Sequence[ca.SX]) -> dict[str, ca.SX]:
        """What is added to places and logarithms of the arrays (over lc), as added to labels."""
        found, made, n, out = self.found, self.made, len(self.found.groups), {}
        for members in found.axes.values():
            places = [made.step(f"tilted_{self.names[k]}", sums[k], "[rad] of a tilt") for k in members]
            lc = made.symbols[f"lc_{self.names[members[0]]}"]
            mean = sum(places[1:], start=places[0]) * (1.0 / len(members))
            if self.unwrapped(found.groups[members[0]].axis):
                mean = places[0]
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
            c, d = powers(int(kind))
            held = self._held_size(name)
            re, im = c / held, -(d / held)
        return made.step(f"{key}_re", re), made.step(f"{key}_im", im)

    def _held_size(self, name: str) -> ca.SX:
        """The square of a phasor, no less than where the flag is set."""
        made = self.made
        if f"held_size_{name}" in made.symbols:
            return made.symbols[f"held_size_{name}"]
        if "least_size" not in made.symbols:
            value = min(w.least for w in self.waves) ** 2
            made.entry("least_size", value, "1", "least square of a phasor")
        size, least = made.symbols[f"size_{name}"], made.symbols["least_size"]
        return made.step(f"held_size_{name}", ca.if_else(size > least, size, least))

    def _product(
        self, value: ca.SX, kind: str, side: int, turns: tuple[int, ...], k: int, rotations: dict[int, ca.SX]
    ) -> ca.SX:
        """A kind times rotations: products of rotations once for all, of a kind once for its array."""
        made = self.made
        if not turns:
            return value
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

    def pose(self, seen: Sequence[ca.SX], off: dict[str, ca.SX]) -> list[ca.SX]:
        """Add the pose from the middle of the box, linear in places and heights without what tilt adds."""
        made, labels = self.made, self.labels
        straight = {}
        for label, value in zip(labels, seen, strict=True):
            straight[label] = made.step(f"straight_{label}", value - off[label]) if label in off else value
        linear: dict[int, ca.SX] = {}
        for i in (3, 4, 5, 0, 1, 2):
            name = f"linear_{short(self.found.model.pose[i])}"
            straight[name] = linear[i] = made.step(
                name, self.total(i, straight), "from the middle of the box"
            )
        out = [linear[i] for i in range(6)]
        most = float(((TILT * self.found.half[3:]) ** 2).sum())
        made.entry("least_turns", -most, "rad2", "less the largest sum of the squares of the rotations")
        made.step("turns", -(out[3] * out[3] + out[4] * out[4] + out[5] * out[5]))
        return out

    def bent(self, linear: Sequence[ca.SX]) -> list[ca.SX]:
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
                at = made.entry(
                    f"{short(column)}_at_middle", constant, unit(column), f"{column} in the middle"
                )
                total = total + at
            out.append(total)
        return out
