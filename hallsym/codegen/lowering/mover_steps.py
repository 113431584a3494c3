"""Steps from the readings of rows of sensors to six coordinates of a mover with arrays of finite length."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.codegen.entries import short
from hallsym.codegen.lowering.arrays_steps import Pieces
from hallsym.codegen.lowering.mover_fit import Mover, Row
from hallsym.codegen.lowering.travel_fit import RAMP
from hallsym.codegen.lowering.travel_steps import place_steps, smooth_weight
from hallsym.codegen.lowering.wave_steps import (
    AXES,
    Pair,
    Powers,
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
        made.entry("lc", found.lc, "m", "wavelength over 2 pi")
        made.entry("wavelength", found.wavelength, "m", "wavelength")
        made.entry("per_wave", 1 / found.wavelength, "1/m", "periods per metre")
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
        return place_steps(made, self.waves[0], u, near, f"_{column}")

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
            log = logarithm_steps(made, self.waves[k], u, f"_{name}{tag}")
            place = place_steps(made, self.waves[0], u, self.at[row.axis], f"_{name}{tag}")
            middle = made.symbols[f"{short(found.model.pose[row.axis])}_middle"]
            places[f"along_{name}"] = made.step(f"along_{name}{tag}", place - middle, "[m] from the middle")
            logs[f"deep_{name}"] = log
        return places | logs

    def _first_turn(self, k: int, values: dict[str, ca.SX]) -> ca.SX:
        """First estimate of a rotation, within its range: of readings of no pose it could be anything."""
        made, column = self.made, short(self.found.model.pose[k])
        most = made.entry(f"most_{column}", self.most_turn, "rad", f"largest {column} that is taken out")
        turn = made.step(f"seen_{column}", self.total(k, values), "[rad] first estimate")
        up = made.step(f"above_{column}", ca.if_else(turn < most, turn, most))
        return made.step(f"first_{column}", ca.if_else(up > -most, up, -most))

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
        if f"least_cover_{name}" not in made.symbols:
            end = self._least_covers[name]
            made.entry(f"least_cover_{name}", end, "V4", "share of the least of the box")
        least = made.symbols[f"least_cover_{name}"]
        held = made.step(f"held_cover_{name}{tag}", ca.if_else(cover > least, cover, least))
        per = made.step(f"per_cover_{name}{tag}", 1.0 / held)
        return self._held_parts((ss * re - cs * im, cc * im - cs * re), per, f"{name}{tag}")

    def _held_parts(self, wide: Pair, per: ca.SX, tag: str) -> Pair:
        """A phasor, no longer than any of the box is, from what is as many times it as 1 over `per`."""
        made = self.made
        if "longest" not in made.symbols:
            made.entry("longest", 2.0 * self.waves[0].outer, "1", "most of a phasor")
        raw = [made.step(f"raw_{a}_{tag}", v * per) for a, v in zip(AXES, wide, strict=True)]
        u = [self._held_part(v, f"{a}_{tag}") for a, v in zip(AXES, raw, strict=True)]
        return u[0], u[1]

    def _held_part(self, v: ca.SX, name: str) -> ca.SX:
        most = self.made.symbols["longest"]
        low = self.made.step(f"above_{name}", ca.if_else(v > -most, v, -most))
        return self.made.step(f"held_{name}", ca.if_else(low < most, low, most))

    def _without_harmonics(
        self, row: Row, name: str, field: Sequence[ca.SX], lifted: Sequence[ca.SX]
    ) -> list[ca.SX]:
        """Readings without the higher harmonics that the first solution says."""
        made, out = self.made, list(field)
        cos, sin = (made.symbols[f"held_{axis}_{name}_first"] for axis in AXES)
        powers = Powers(made, cos, sin, f"_{name}_first")
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
    def _least_covers(self) -> dict[str, float]:
        """By row: determinant of the normal matrix [V4], at least without a flag."""
        pose, out = self.found.poses(np.random.default_rng(3), TRIALS), {}
        for row, name in zip(self.found.rows, self.names, strict=True):
            w, (c, s) = self.found.weights(row, pose[row.axis]), row.design()
            cc, cs, ss = ((p[:, None] * w).sum(axis=0) for p in (c * c, c * s, s * s))
            out[name] = COVER * float((cc * ss - cs * cs).min())
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
            value = (
                own if value is None else made.step(f"cover_to_{name}", ca.if_else(value < own, value, own))
            )
        made.entry("least_cover", 0.0, "V4", "what each row must have more than its least")
