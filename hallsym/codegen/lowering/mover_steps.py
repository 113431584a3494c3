"""Steps from the readings of rows of sensors to six coordinates of a mover with arrays of finite length."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Whole
from hallsym.codegen.entries import short
from hallsym.codegen.lowering.arrays_steps import PERIODS, Pieces
from hallsym.codegen.lowering.choices import (
    BEYOND,
    HELD,
    above_minus,
    at_least,
    at_most,
    held_logarithm,
    inverse,
    logarithm_of_ratio,
    period_count,
    smooth_weight,
)
from hallsym.codegen.lowering.mover_fit import Mover, Row
from hallsym.codegen.lowering.travel_fit import RAMP
from hallsym.codegen.lowering.wave_steps import (
    AXES,
    Pair,
    Powers,
    arctangent_steps,
    least_inside,
    logarithm_steps,
    power,
)

TRIALS = 2000
COVER = 0.5
"""Share of the least cover of the box below which the flag is set."""


@dataclass(eq=False)
class MoverPieces(Pieces):
    """Adds the steps of one calibration, one after the other."""

    found: Mover  # type: ignore[assignment]

    # -- sums ----------------------------------------------------------------------------------------------

    def _channels(self, row: Row) -> list[str]:
        return [short(self.found.model.channels[k]) for k in row.channels]

    # -- from readings to places and heights ---------------------------------------------------------------

    def rows(self) -> list[ca.SX]:
        """Add the steps from the readings to places from the middle [m] and logarithms of all rows."""
        made, found = self.made, self.found
        self.lc = made.entry("lc", found.lc, "m", "wavelength over 2 pi")
        self.whole = made.entry("wavelength", found.wavelength, "m", "wavelength")
        self.per = made.entry("per_wave", 1 / found.wavelength, "1/m", "periods per metre")
        least_inside(made, self.waves[:1])
        self.at = {axis: self._first(axis, members) for axis, members in found.axes.items()}
        for row, name in zip(found.rows, self.names, strict=True):
            self._weights(row, name)
        before = self._solved("_first")
        turns = {k: self._first_turn(k, before) for k in sorted({found.tilt_of(row) for row in found.rows})}
        return list(self._solved("", turns).values())

    def _first(self, axis: int, members: Sequence[int]) -> ca.SX:
        """The place along an axis that all its sensors alike say, in the period that is meant."""
        made, column, cos, sin = self.made, short(self.found.model.pose[axis]), [], []
        for k in members:
            row = self.found.rows[k]
            design = row.design()
            for j, name in enumerate(self._channels(row)):
                offset = made.entry(f"offset_{name}", float(row.offset[j]), "V", f"offset of {name}")
                field = made.step(
                    f"field_{name}", made.symbols[self.found.model.channels[row.channels[j]]] - offset
                )
                cos.append(
                    field * made.entry(f"cos_{name}", design[0, j], "V", f"read by {name} of the cosine")
                )
                sin.append(
                    field * made.entry(f"sin_{name}", design[1, j], "V", f"read by {name} of the sine")
                )
        u = self.made.total(f"cos_all_{column}", cos, "all alike"), self.made.total(f"sin_all_{column}", sin)
        made.entry(f"{column}_middle", float(self.found.middle[axis]), "m", "middle of the box")
        near = made.symbols[f"{column}_near_m" if self.wide(axis) else f"{column}_middle"]
        return self._place(u, near, f"_{column}", self._least_of_all(axis))

    def _least_of_all(self, axis: int) -> float:
        """Length of the sum of all sensors of an axis alike, at least, of poses of the box [V2]."""
        _, readings = self.found.trials(3, TRIALS)
        return float(np.abs(self.found.all_alike(self.found.without_offset(readings), axis)).min()) / BEYOND

    def _place(self, u: Pair, near: ca.SX, tag: str, least: float) -> ca.SX:
        """The place of a phase in the period next to another place; `least`: length of u, of integers."""
        made = self.made
        phase = arctangent_steps(made, self.waves[0], u, tag, least)
        place = made.step(f"in_wave{tag}", self.lc * phase)
        count = made.step(f"periods{tag}", (near - place) * self.per + (PERIODS + 0.5))
        held = period_count(made, count, tag, PERIODS)
        made.steps.append(Whole(f"whole{tag}", held))
        number = made.symbols.setdefault(f"whole{tag}", ca.SX.sym(f"whole{tag}"))
        return made.step(f"place{tag}", place + self.whole * (number - float(PERIODS)), "[m]")

    def _weights(self, row: Row, tag: str) -> None:
        """Weight of each sensor: 1 well under the array, 0 beyond, smooth."""
        made, found = self.made, self.found
        ramp = RAMP * found.wavelength
        half = row.length / 2 - found.margin * found.wavelength
        start = made.entry(
            f"depth_{tag}", half / ramp, "1", "half of what counts of the array, over the ramp"
        )
        if "per_ramp" not in made.symbols:
            made.entry("per_ramp", 1 / ramp, "1/m", "a weight goes from 0 to 1 over its inverse")
        rate = made.symbols["per_ramp"]
        for name, place in zip(self._channels(row), row.place, strict=True):
            at = made.entry(f"at_{name}", float(place), "m", f"place at which the array is over {name}")
            beside = made.step(f"beside_{name}", self.at[row.axis] - at, "[m] of the middle of the array")
            depth = made.step(f"deep_{name}", start - ca.fabs(beside) * rate)
            smooth_weight(made, depth, name)

    def _solved(self, tag: str, turns: dict[int, ca.SX] | None = None) -> dict[str, ca.SX]:
        """Place from the middle and logarithm of each row by label; `turns`: rotations to be taken out."""
        found, made, places, logs = self.found, self.made, {}, {}
        for k, (row, name) in enumerate(zip(found.rows, self.names, strict=True)):
            turn = None if turns is None else turns[found.tilt_of(row)]
            u = self._vector(row, name, tag, turn)
            log = self._logarithm(k, u, tag)
            least = self.waves[k].least * self._covers[name][0]  # u is as many times the phasor as the cover
            place = self._place(u, self.at[row.axis], f"_{name}{tag}", least)
            middle = made.symbols[f"{short(found.model.pose[row.axis])}_middle"]
            places[f"along_{name}"] = made.step(f"along_{name}{tag}", place - middle, "[m] from the middle")
            logs[f"deep_{name}"] = log
        return places | logs

    def _logarithm(self, k: int, u: Pair, tag: str) -> ca.SX:
        """The logarithm of a phasor, of integers from the phasor times the cover."""
        made, name = self.made, self.names[k]
        if not made.native:
            return logarithm_steps(made, self.waves[k], u, f"_{name}{tag}")
        log_cover, least = made.symbols[f"log_cover_{name}{tag}"], self.waves[k].least * self._covers[name][0]
        names = f"log_{name}{tag}", f"inside_{name}{tag}"
        log = logarithm_of_ratio(made, u, log_cover, least, names)
        most = max(-float(np.log(w.least)) for w in self.waves)
        held = made.held(log, "most_log", most, "1", "largest logarithm")
        return made.step(f"held_log_{name}{tag}", held)

    def _first_turn(self, k: int, values: dict[str, ca.SX]) -> ca.SX:
        """First estimate of a rotation, within its range: of readings of no pose it could be anything."""
        made, column = self.made, short(self.found.model.pose[k])
        most = made.entry(f"most_{column}", self.most_turn, "rad", f"largest {column} that is taken out")
        turn = made.step(f"seen_{column}", self.total(k, values), "[rad] first estimate")
        up = made.step(f"above_{column}", at_most(made, turn, most))
        return made.step(f"first_{column}", above_minus(made, up, most))

    @property
    def most_turn(self) -> float:
        """Half more than the largest rotation of the box [rad]."""
        return 1.5 * float(self.found.half[3:].max())

    def _lifted(self, row: Row, name: str, turn: ca.SX) -> list[ca.SX]:
        """How much stronger the field is at each sensor than at the middle of the array."""
        made, out = self.made, []
        lift = made.entry(f"lift_{name}", self.found.lift_of(row), "1/m", "of ln |u| per metre and rotation")
        steep = made.step(f"steep_{name}", lift * turn)
        for sensor in self._channels(row):
            v = made.step(f"tilt_{sensor}", steep * made.symbols[f"beside_{sensor}"])
            out.append(made.step(f"lifted_{sensor}", 1.0 + v * (1.0 + v * (0.5 + v * (1 / 6)))))
        return out

    def _vector(self, row: Row, name: str, tag: str, turn: ca.SX | None) -> Pair:
        """Weighted least squares of what the sensors of a row read."""
        made, sensors = self.made, self._channels(row)
        field = [made.symbols[f"field_{s}"] for s in sensors]
        cos, sin, weight = ([made.symbols[f"{n}_{s}"] for s in sensors] for n in ("cos", "sin", "weight"))
        if turn is not None:
            lifted = self._lifted(row, name, turn)
            field = self._without_harmonics(row, name, field, lifted)
            cos = [made.step(f"lifted_cos_{s}", c * v) for s, c, v in zip(sensors, cos, lifted, strict=True)]
            sin = [made.step(f"lifted_sin_{s}", c * v) for s, c, v in zip(sensors, sin, lifted, strict=True)]
        wc = [made.step(f"wcos_{s}{tag}", w * c) for s, w, c in zip(sensors, weight, cos, strict=True)]
        ws = [made.step(f"wsin_{s}{tag}", w * c) for s, w, c in zip(sensors, weight, sin, strict=True)]

        def product(label: str, a: Sequence[ca.SX], b: Sequence[ca.SX]) -> ca.SX:
            return self.made.total(f"{label}_{name}{tag}", [x * y for x, y in zip(a, b, strict=True)])

        cc, cs, ss = product("cos_cos", wc, cos), product("cos_sin", wc, sin), product("sin_sin", ws, sin)
        re, im = product("cos_seen", wc, field), product("sin_seen", ws, field)
        cover = made.step(f"cover_{name}{tag}", cc * ss - cs * cs, "[V4] cosine told from sine")
        ends = self._covers[name]
        if f"least_cover_{name}" not in made.symbols:
            made.entry(f"least_cover_{name}", ends[0], "V4", "share of the least of the box")
        if made.native:
            held_logarithm(made, cover, f"cover_{name}", ends, "V4", tag)
            re, im = ss * re - cs * im, cc * im - cs * re
            return made.step(f"wide_cos_{name}{tag}", re), made.step(f"wide_sin_{name}{tag}", im)
        held = made.step(
            f"held_cover_{name}{tag}", at_least(made, cover, made.symbols[f"least_cover_{name}"])
        )
        per = made.step(f"per_cover_{name}{tag}", 1.0 / held)
        return self._held_parts((ss * re - cs * im, cc * im - cs * re), per, f"{name}{tag}")

    def _held_parts(self, wide: Pair, per: ca.SX, tag: str) -> Pair:
        """A phasor, no longer than any of the box is, from what is as many times it as 1 over `per`."""
        made = self.made
        if "longest" not in made.symbols:
            longest = (HELD if made.native else 2.0) * self.waves[0].outer
            made.entry("longest", longest, "1", "most of a phasor")
        raw = [made.step(f"raw_{a}_{tag}", v * per) for a, v in zip(AXES, wide, strict=True)]
        u = [self._held_part(v, f"{a}_{tag}") for a, v in zip(AXES, raw, strict=True)]
        return u[0], u[1]

    def _held_part(self, v: ca.SX, name: str) -> ca.SX:
        most = self.made.symbols["longest"]
        low = self.made.step(f"above_{name}", above_minus(self.made, v, most))
        return self.made.step(f"held_{name}", at_most(self.made, low, most))

    def _first_phasor(self, name: str) -> Pair:
        """The phasor of the first solution."""
        made, symbols = self.made, self.made.symbols
        if not made.native:
            return symbols[f"held_cos_{name}_first"], symbols[f"held_sin_{name}_first"]
        log_cover = symbols[f"log_cover_{name}_first"]
        per = inverse(made, log_cover, f"cover_{name}", self._covers[name], "V4")
        wide = symbols[f"wide_cos_{name}_first"], symbols[f"wide_sin_{name}_first"]
        return self._held_parts(wide, per, f"{name}_first")

    def _without_harmonics(
        self, row: Row, name: str, field: Sequence[ca.SX], lifted: Sequence[ca.SX]
    ) -> list[ca.SX]:
        """Readings without the higher harmonics that the first solution says."""
        made, out = self.made, list(field)
        powers = Powers(made, *self._first_phasor(name), f"_{name}_first")
        known = [{1: v} for v in lifted]
        for n in self.found.harmonics:
            re, im = powers(n)
            design = row.design(n)
            for k, sensor in enumerate(self._channels(row)):
                a, b = (
                    made.entry(f"{part}_{n}_{sensor}", design[j, k], "V", f"read by {sensor} of {part} {n}")
                    for j, part in enumerate(("cos", "sin"))
                )
                strong = power(made, known[k], n, f"lifted_{sensor}")
                out[k] = made.step(f"left_{n}_{sensor}", out[k] - (a * re + b * im) * strong)
        return out

    @cached_property
    def _covers(self) -> dict[str, tuple[float, float]]:
        """By row: determinant of the normal matrix [V4], at least without a flag, and at most of a pose."""
        pose, out = self.found.poses(np.random.default_rng(3), TRIALS), {}
        for row, name in zip(self.found.rows, self.names, strict=True):
            w, (c, s) = self.found.weights(row, pose[row.axis]), row.design()
            cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
            cover = cc * ss - cs * cs
            out[name] = COVER * float(cover.min()), BEYOND * float(cover.max())
        return out

    # -- the linear pose -----------------------------------------------------------------------------------

    @property
    def labels(self) -> list[str]:
        """Of what the pose is linear in: places, then logarithms."""
        return [f"along_{n}" for n in self.names] + [f"deep_{n}" for n in self.names]

    @property
    def matrix(self) -> np.ndarray:
        """Pose per label (6, labels)."""
        n = len(self.names)
        scale = np.array(n * [1.0] + n * [self.found.rising * self.found.lc])
        return np.asarray(self.found.inverse * scale)

    def covered(self) -> None:
        """Add the step that the flag of the cover looks at: what the row that has least has to spare."""
        made = self.made
        value = None
        for name in self.names:
            own = made.step(
                f"covered_{name}",
                made.symbols[f"cover_{name}_first"] - made.symbols[f"least_cover_{name}"],
                "[V4]",
            )
            value = own if value is None else made.step(f"cover_to_{name}", at_most(made, value, own))
        made.entry("least_cover", 0.0, "V4", "what each row must have more than its least")
