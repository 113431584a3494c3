"""The files of a decoupler in float32."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar
from zlib import crc32

import casadi as ca
import numpy as np

from hallsym.codegen import accepted, backend, residual
from hallsym.codegen.backend import VERSION, Backend, Port, Stored
from hallsym.codegen.bounds import Bounds, given_of, least_gains, pose_bounds, rounded
from hallsym.codegen.cost import firmware_cost
from hallsym.codegen.decoupler import ROOT, Array, Entry, short, steps_on_arrays, unit
from hallsym.codegen.float_c import constant, shared_steps, statements
from hallsym.codegen.intervals import ROUNDOFF
from hallsym.codegen.naming import identifier
from hallsym.codegen.residual import Ran
from hallsym.model.arrays import on_arrays
from hallsym.output import commented

FLOAT = np.float32
UNION = "misra-c2012-19.2:decoupler.c"
"""Deviation: the bits of a number are read through a union, which C99 defines."""


@dataclass(frozen=True, eq=False)
class FloatBackend(Backend):
    """A decoupler in float32.

    IEEE 754 leaves no freedom to +, -, *, / and comparisons that round to nearest one by one, so numpy
    computes the same bits as C. `jacobian`: with the slopes of the pose by the readings.
    """

    jacobian: bool = False

    type: ClassVar[str] = "float"
    cpu: ClassVar[str] = "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16"
    machine: ClassVar[str] = "mps2-an386"
    why_ends: ClassVar[str] = "every table within these ends gives finite numbers, by interval arithmetic"

    @property
    def hashed(self) -> tuple[int, int]:
        """Fewer where most samples, of no pose, are decoded again without a suspect."""
        return 4096, 100_000 if self.decoupler.suspects else 1_000_000

    @cached_property
    def bounds(self) -> Bounds:
        """By interval arithmetic on the printed expressions; approximations are not in it."""
        return pose_bounds(self.decoupler)

    @property
    def error_bound(self) -> Mapping[str, float]:
        """Rounding, and what series, polynomials and iterations leave."""
        return {c: error + self.decoupler.left(c) for c, error in self.bounds.error.items()}

    def summary(self) -> dict[str, Any]:
        """CRC of the table, and how near to zero gains come."""
        return {"crc32": f"0x{self.crc:08x}", "least_gain": least_gains(self.decoupler)}

    # -- the arithmetic ------------------------------------------------------------------------------------

    def _port(self, column: str) -> Port:
        return Port(column, self.type, identifier(column), unit(column))

    @property
    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """As they are given, not rounded."""
        low, high = np.array([self.decoupler.ends(c) for c in self.decoupler.inputs]).T
        return low[:, None], high[:, None]

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """As the table holds them."""
        low, high = self.span
        return low.astype(FLOAT), high.astype(FLOAT)

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return steps_on_arrays(self.decoupler, FLOAT)

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By the bits of its size where a range is symmetric: NaN goes to the end of its sign."""
        clamped, status = super().hold(inputs)
        symmetric = np.array([[self.decoupler.box.symmetric(c)] for c in self.decoupler.inputs])
        return np.where(np.isnan(inputs) & np.signbit(inputs) & symmetric, self.ends[0], clamped), status

    def run(self, clamped: np.ndarray, offsets: np.ndarray | None = None) -> Ran:
        """Operation by operation; `offsets` (n_pose, s) in place of those of the table."""
        d = self.decoupler
        constants: list[np.ndarray] = [np.array([c], FLOAT) for c in d.constants]

        def once(given: np.ndarray, samples: Any) -> Ran:
            if offsets is not None:
                constants[-len(offsets) :] = list(offsets[:, samples])
            with np.errstate(under="ignore"):
                pose, *seen = self._run(self.hold(given)[0].astype(FLOAT), constants)
            none = np.zeros(given.shape[1], np.uint32)
            flags = np.asarray(d.raised(seen[0])) if seen else none
            return Ran(pose, flags, seen[-1] if d.watched else pose[:0], none)

        given: np.ndarray = clamped.astype(FLOAT)
        return residual.checked(d, once, given, self._root) if d.suspects else once(given, slice(None))

    @cached_property
    def _root(self) -> np.ndarray:
        return np.array(next(a.values for a in self.decoupler.arrays if a.name == ROOT), FLOAT)

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Most lie in the box, every 16th has any bits at all, every 16th is four times too large."""
        low, high = self.ends
        n = np.asarray(numbers, dtype=np.uint32)
        count = np.uint32(len(self.decoupler.inputs))
        kind = backend.mix(n ^ np.uint32(0x9E3779B9)) & np.uint32(15)
        raw = backend.mix(n * count + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        share = (raw >> np.uint32(8)).astype(FLOAT) * FLOAT(2.0**-24)
        with np.errstate(all="ignore"):
            value = low + (high - low) * share
            value = np.where(kind == 1, value * FLOAT(4), value)
        return np.where(kind == 0, raw.view(FLOAT), value).astype(FLOAT)

    @cached_property
    def reset(self) -> dict[str, float]:
        """Offsets that hashed samples have: such that an angle wraps, or a fraction of a millimetre."""
        d = self.decoupler
        return {c: (1 - 2.0**-7) * d.known(c) if c in d.model.period else 2.0**-12 for c in d.pose}

    def hashed_step(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Half of the samples have no offsets, a quarter those of a reset at either end."""
        kind = backend.mix(np.asarray(numbers, dtype=np.uint32) ^ np.uint32(0x85EBCA6B)) & np.uint32(3)
        sign: np.ndarray = np.select([kind == 2, kind == 3], [1, -1], 0).astype(FLOAT)
        offsets = np.array([FLOAT(self.reset[c]) * sign for c in self.decoupler.pose])
        clamped, status = self.hold(self.sample(numbers))
        return self._done(status, self.run(clamped, offsets))

    def _words(self, pose: np.ndarray) -> np.ndarray:
        return pose.view(np.uint32)

    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        return inputs.astype(FLOAT)

    def _beyond(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        bad, most = ([np.full_like(low, v) for v in (np.nan, np.inf, -np.inf)], np.finfo(low.dtype).max)
        return np.array([*bad, 2 * low, 2 * high, np.full_like(low, most)])

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> Sequence[Stored]:
        """Numbers in SI, or 16-bit integers in a row."""
        d = self.decoupler

        def stored(e: Entry | Array) -> Stored:
            values = (e.values, "<i2" if e.integers else "<f4") if isinstance(e, Array) else (e.value, "<f4")
            return Stored(e.name, np.array(*values), e.meaning, e.unit)

        every: tuple[Entry | Array, ...] = (*d.table, *d.limits, *d.arrays, *d.offsets)
        return [stored(e) for e in every]

    @cached_property
    def layout(self) -> int:
        """Of names, units and statements."""
        d = self.decoupler
        lines = [f"{VERSION} {self.type}"]
        lines += [f"{e.name} {e.unit}" for e in d.entries]
        lines += [f"{a.name}[{len(a.values)}] {a.unit} {a.integers}" for a in d.arrays]
        lines += [f"{w.left} {w.readings}" for w in d.watched if d.suspects and len(w.readings) > 1]
        lines += statements([replace(step, remark="") for step in d.steps], {}, {})
        return crc32("\n".join(lines).encode())

    def _literal(self, value: Any) -> str:
        return str(value) if isinstance(value, int) else constant(value)

    def _own(self, port: Port, given: bool) -> dict[str, Any]:
        d, c = self.decoupler, port.column
        if given:
            names = [f"{side}_{short(c)}" for side in ("limit", "low", "high")]
            far = max(abs(v) for name in names for v in self.accepted.get(name, ()))
            other = "measured state" if c in d.model.state else "position so far or commanded"
            return {"kind": "reading" if c in d.model.channels else other, "far": constant(far)}
        own = {"hashed": constant(self.reset[c]), "period": constant(d.model.period.get(c, 0.0))}
        if d.evident:  # else nothing is proved of it by EVA
            for name, value in (("outer_low", self.bounds.low[c]), ("outer_high", self.bounds.high[c])):
                own[name] = constant(float(np.float32(value * 1.0001)) + (1e-12 if value > 0 else -1e-12))
        return own

    def _fields(self) -> dict[str, Any]:
        d = self.decoupler
        names = {e.name: f"p->{e.name}" for e in d.entries}
        last = d.steps[-len(d.pose) :]
        results = {s.name: f"out->{identifier(column)}" for s, column in zip(last, d.pose, strict=True)}
        most = {identifier(column): constant(d.known(column)) for column in d.pose}
        within = [
            f"((pose->{column} >= -{far}) && (pose->{column} <= {far}))" for column, far in most.items()
        ]
        by_size = [self.range_test(column) == "within" for column in d.inputs]
        ends = (2.0**-12, -(2.0**-12)) if d.at_pose else (2.0**-12, 1.0, -1.0)  # non-linear models: near rest
        return {
            "real": "float",
            "zero": "0.0f",
            "one": "1.0f",
            "some_zero": constant(2.0**-12),
            "by_size": "all" if all(by_size) else "some" if any(by_size) else "",
            "clamped": self.clamped(self._used(d.folded)),
            "body": statements(d.steps, names, results),
            "left": [w.left for w in d.watched],
            "all_clamped": self.clamped(d.inputs),
            "at_pose": statements(d.at_pose, names, {}),
            "known_within": "\n        && ".join(within),
            "reach": ", ".join(dict.fromkeys(f"{d.known(column):.6g} {unit(column)}" for column in d.pose)),
            "known": [[constant(share * d.known(column)) for column in d.pose] for share in ends],
            "far": {
                p.member: [*(self._input(p, k * d.known(p.column) * 1.0001) for k in (1, -1, np.nan)), "0.0f"]
                for p in self.outputs
            },
            "most": "FLT_MAX",
            # what roundings of a pose at its largest zero, and iterations, may leave [m, rad], and some
            "near": constant(8 * ROUNDOFF * max(2.0 * d.known(p) for p in d.pose) + 10 * d.slack),
            "deviations": [
                *([UNION] if any(by_size) else []),
                backend.UNION,
                *([] if d.at_pose and not d.redundancy else [backend.STEP]),
            ],
            "work": firmware_cost(d),
            "least_gain": least_gains(d),
            **(self._of_slopes(names) if self.jacobian else {}),
        }

    @cached_property
    def slopes(self) -> dict[str, ca.SX]:
        """Slopes of the pose by the readings, such as `x_hall_a`: derivatives of the printed expressions."""
        d, columns = self.decoupler, self.decoupler.model.channels
        jacobian = ca.jacobian(d.folded, ca.vertcat(*(d.symbols[c] for c in columns)))
        flat = [jacobian[i, k] for i in range(len(d.pose)) for k in range(len(columns))]
        names = [f"{short(c)}_{short(m)}" for c, m in product(d.pose, columns)]
        return dict(zip(names, ca.vertsplit(ca.densify(ca.cse(ca.vertcat(*flat)))), strict=True))

    def _of_slopes(self, names: Mapping[str, str]) -> dict[str, Any]:
        d, whole, values = self.decoupler, ca.vertcat(*self.slopes.values()), self._references()[1]
        steps = shared_steps(whole)
        stored = {f"result_{k}": f"slopes->{name}" for k, name in enumerate(self.slopes)}
        pairs = zip(self.slopes, product(d.pose, d.model.channels), strict=True)
        # the reference is computed in double and written with 13 digits
        errors = np.split(rounded(steps, list(stored), *given_of(d))[:, 0], 3)[2]
        limits = [e + 1e-12 * np.abs(row).max() for e, row in zip(errors, values, strict=True)]
        return {
            "slopes": [
                {"name": name, "index": k, "unit": f"{unit(c)}/{unit(m)}", "of": commented(c),
                 "by": commented(m)}
                for k, (name, (c, m)) in enumerate(pairs)
            ],
            "slope_body": self.clamped(self._used(whole)) + statements(steps, names, stored),
            "slope_bounds": ", ".join(f"{limit:.3e}" for limit in limits),
        }  # fmt: skip

    def _references(self) -> list[np.ndarray]:
        """With the slopes in double."""
        d, found = self.decoupler, [self.vectors.pose]
        if self.jacobian:
            given = [ca.vertcat(*(d.symbols[n] for n in d.inputs))]
            given.append(ca.vertcat(*(d.symbols[e.name] for e in (*d.table, *d.offsets))))
            slopes = ca.Function("slopes", given, [ca.vertcat(*self.slopes.values())])
            found += on_arrays(slopes)(list(self.vectors.clamped), d.constants)
        return found

    # -- step, check ---------------------------------------------------------------------------------------

    def range_test(self, column: str) -> str:
        """By the bits of its size where one limit says both ends: fewest instructions, typical and worst."""
        return "within" if self.decoupler.box.symmetric(column) else "limited"

    def _used(self, expression: ca.SX) -> list[str]:
        """Return the inputs that an expression depends on."""
        d = self.decoupler
        return [c for c in d.inputs if ca.depends_on(expression, d.symbols[c])]

    def _accepted(self) -> accepted.Ends:
        """As wide as finite results allow."""
        return accepted.accepted(self.decoupler)

    def _just_outside(self, name: str) -> list[str]:
        if any(a.integers for a in self.decoupler.arrays if a.name == name):
            return []
        least, most = map(FLOAT, self.accepted[name])
        just = np.nextafter([least, most], np.array([-np.inf, np.inf], FLOAT)).tolist()
        return [self._input(self.inputs[0], value) for value in (np.nan, np.inf, -np.inf, *just)]

    def _input(self, port: Port, value: Any) -> str:
        if np.isfinite(value):
            return constant(value)
        return f"{'-' * (value < 0)}{'NAN' if np.isnan(value) else 'INFINITY'}"
