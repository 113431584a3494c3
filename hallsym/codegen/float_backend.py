"""The files of a decoupler in float or double."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar
from zlib import crc32

import casadi as ca
import numpy as np

from hallsym.codegen import accepted, backend, residual
from hallsym.codegen.backend import VERSION, Backend, Port, Stored
from hallsym.codegen.bounds import Bounds, enclosed, least_gains, pose_bounds
from hallsym.codegen.cost import firmware_cost
from hallsym.codegen.decoupler import ROOT, Array, Decoupler, Entry, Step, short, steps_on_arrays, unit
from hallsym.codegen.float_c import Real, shared_steps, statements
from hallsym.codegen.naming import identifier
from hallsym.codegen.residual import Ran
from hallsym.model.arrays import on_arrays
from hallsym.output import commented

UNION = "misra-c2012-19.2:decoupler.c"
"""Deviation: the bits of a number are read through a union, which C99 defines."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of the pose of a decoupler by the readings."""

    d: Decoupler

    @cached_property
    def expressions(self) -> dict[str, ca.SX]:
        """By name: `x_hall_a`, by CasADi's differentiation of the printed expressions."""
        d, columns = self.d, self.d.model.channels
        jacobian = ca.jacobian(d.folded, ca.vertcat(*(d.symbols[c] for c in columns)))
        flat = [jacobian[i, k] for i in range(len(d.pose)) for k in range(len(columns))]
        names = [f"{short(c)}_{short(m)}" for c in d.pose for m in columns]
        return dict(zip(names, ca.vertsplit(ca.densify(ca.cse(ca.vertcat(*flat)))), strict=True))

    @property
    def whole(self) -> ca.SX:
        """All of them (n,)."""
        return ca.vertcat(*self.expressions.values())

    @cached_property
    def steps(self) -> list[Step]:
        """What they share, then one step each."""
        return shared_steps(self.whole)

    def records(self) -> list[dict[str, Any]]:
        """Return what templates say of each slope."""
        pairs = [(c, m) for c in self.d.pose for m in self.d.model.channels]
        return [
            {"name": name, "index": k, "unit": f"{unit(c)}/{unit(m)}", "of": commented(c), "by": commented(m)}
            for k, (name, (c, m)) in enumerate(zip(self.expressions, pairs, strict=True))
        ]

    def of(self, clamped: np.ndarray) -> np.ndarray:
        """Return the slopes (n, s) in double of inputs (n_inputs, s) in their ranges."""
        d = self.d
        given = [ca.vertcat(*(d.symbols[n] for n in d.inputs))]
        given.append(ca.vertcat(*(d.symbols[e.name] for e in (*d.table, *d.offsets))))
        return on_arrays(ca.Function("slopes", given, [self.whole]))(list(clamped), d.constants)[0]

    def errors(self, real: Real) -> list[float]:
        """Return how far each computed slope can be from its expression over the box, table included."""
        found = enclosed(self.d, self.steps, real.digits)[-len(self.expressions) :]
        return [float(e.error) for e in found]


@dataclass(frozen=True, eq=False)
class FloatBackend(Backend):
    """A decoupler in float or double.

    IEEE 754 leaves no freedom to +, -, *, / and comparisons that round to nearest one by one, so numpy
    computes the same bits as C. `jacobian`: with the slopes of the pose by the readings.
    """

    real: Real
    jacobian: bool = False

    tree: ClassVar[str] = "float"
    machine: ClassVar[str] = "mps2-an386"
    why_ends: ClassVar[str] = "every table within these ends gives finite numbers, by interval arithmetic"

    @property
    def hashed(self) -> tuple[int, int]:
        """Fewer where most samples, of no pose, are decoded again without a suspect."""
        return 4096, 100_000 if self.decoupler.suspects else 1_000_000

    @property
    def type(self) -> str:
        """Float or double."""
        return self.real.name

    @property
    def cpu(self) -> str:
        """Compiler options of a Cortex-M4F."""
        return f"-mcpu=cortex-m4 -mthumb {self.real.fpu}"

    @cached_property
    def bounds(self) -> Bounds:
        """By interval arithmetic on the printed expressions; approximations are not in it."""
        return pose_bounds(self.decoupler, self.real.digits)

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
        return low.astype(self.real.dtype), high.astype(self.real.dtype)

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return steps_on_arrays(self.decoupler, self.real.dtype)

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By the bits of its size where a range is symmetric: NaN goes to the end of its sign."""
        clamped, status = super().hold(inputs)
        symmetric = np.array([[self.decoupler.box.symmetric(c)] for c in self.decoupler.inputs])
        return np.where(np.isnan(inputs) & np.signbit(inputs) & symmetric, self.ends[0], clamped), status

    def run(self, clamped: np.ndarray, offsets: np.ndarray | None = None) -> Ran:
        """Operation by operation; `offsets` (n_pose, s) in place of those of the table."""
        d, dtype = self.decoupler, self.real.dtype
        constants: list[np.ndarray] = [np.array([c], dtype=dtype) for c in d.constants]

        def once(given: np.ndarray, samples: Any) -> Ran:
            if offsets is not None:
                constants[-len(offsets) :] = list(offsets[:, samples])
            with np.errstate(under="ignore"):
                pose, *seen = self._run(self.hold(given)[0].astype(dtype), constants)
            none = np.zeros(given.shape[1], np.uint32)
            flags = np.asarray(d.raised(seen[0], dtype)) if seen else none
            return Ran(pose, flags, seen[-1] if d.watched else pose[:0], none)

        given: np.ndarray = clamped.astype(dtype)
        return residual.checked(d, once, given, self._root) if d.suspects else once(given, slice(None))

    @cached_property
    def _root(self) -> np.ndarray:
        values = next(a.values for a in self.decoupler.arrays if a.name == ROOT)
        return np.array(values, dtype=self.real.dtype)

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Most lie in the box, every 16th has any bits at all, every 16th is four times too large."""
        (low, high), dtype = self.ends, self.real.dtype
        n = np.asarray(numbers, dtype=np.uint32)
        count = np.uint32(len(self.decoupler.inputs))
        kind = backend.mix(n ^ np.uint32(0x9E3779B9)) & np.uint32(15)
        raw = backend.mix(n * count + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        share = (raw >> np.uint32(8)).astype(dtype) * dtype(2.0**-24)
        with np.errstate(all="ignore"):
            value = low + (high - low) * share
            value = np.where(kind == 1, value * dtype(4), value)
        wild = raw if self.real.size == 4 else (raw.astype(np.uint64) << np.uint64(32)) | backend.mix(raw)
        return np.where(kind == 0, wild.view(dtype), value).astype(dtype)

    @cached_property
    def reset(self) -> dict[str, float]:
        """Offsets that hashed samples have: such that an angle wraps, or a fraction of a millimetre."""
        d = self.decoupler
        return {c: (1 - 2.0**-7) * d.known(c) if c in d.model.period else 2.0**-12 for c in d.pose}

    def hashed_step(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Half of the samples have no offsets, a quarter those of a reset at either end."""
        kind = backend.mix(np.asarray(numbers, dtype=np.uint32) ^ np.uint32(0x85EBCA6B)) & np.uint32(3)
        sign: np.ndarray = np.select([kind == 2, kind == 3], [1, -1], 0).astype(self.real.dtype)
        offsets = np.array([self.real.dtype(self.reset[c]) * sign for c in self.decoupler.pose])
        clamped, status = self.hold(self.sample(numbers))
        return self._done(status, self.run(clamped, offsets))

    def _words(self, pose: np.ndarray) -> np.ndarray:
        if self.real.size == 4:
            return pose.view(np.uint32)
        bits = pose.view(np.uint64)
        return np.asarray((bits >> np.uint64(32)).astype(np.uint32) ^ backend.mix(bits.astype(np.uint32)))

    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        return inputs.astype(self.real.dtype)

    def _beyond(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        bad, most = ([np.full_like(low, v) for v in (np.nan, np.inf, -np.inf)], np.finfo(low.dtype).max)
        return np.array([*bad, 2 * low, 2 * high, np.full_like(low, most)])

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> Sequence[Stored]:
        """Numbers in SI, or 16-bit integers in a row."""
        d, dtype = self.decoupler, np.dtype(self.real.dtype).newbyteorder("<")

        def stored(e: Entry | Array) -> Stored:
            values = (e.values, "<i2" if e.integers else dtype) if isinstance(e, Array) else (e.value, dtype)
            return Stored(e.name, np.array(*values), e.meaning, e.unit)

        every: tuple[Entry | Array, ...] = (*d.table, *d.limits, *d.arrays, *d.offsets)
        return [stored(e) for e in every]

    @property
    def pad(self) -> int:
        """A word before the offsets in double."""
        return self.real.size - 4

    @cached_property
    def layout(self) -> int:
        """Of names, units and statements."""
        d = self.decoupler
        lines = [f"{VERSION} {self.type}"]
        lines += [f"{e.name} {e.unit}" for e in d.entries]
        lines += [f"{a.name}[{len(a.values)}] {a.unit} {a.integers}" for a in d.arrays]
        lines += [f"{w.left} {w.readings}" for w in d.watched if d.suspects and len(w.readings) > 1]
        lines += statements([replace(step, remark="") for step in d.steps], {}, self.real, {})
        return crc32("\n".join(lines).encode())

    def _literal(self, value: Any) -> str:
        return str(value) if isinstance(value, int) else self.real.constant(value)

    def _templates(self) -> dict[str, str]:
        """Not all bit patterns of a double can be tried."""
        found = super()._templates()
        if self.real.size == 8:
            del found["proof/exhaustive.c"]
        return found

    def _own(self, port: Port, given: bool) -> dict[str, Any]:
        d, c, literal = self.decoupler, port.column, self.real.constant
        if given:
            names = [f"{side}_{short(c)}" for side in ("limit", "low", "high")]
            far = max(abs(v) for name in names for v in self.accepted.get(name, ()))
            other = "measured state" if c in d.model.state else "position so far or commanded"
            return {"kind": "reading" if c in d.model.channels else other, "far": literal(far)}
        own = {"hashed": literal(self.reset[c]), "period": literal(d.model.period.get(c, 0.0))}
        if d.evident:  # else nothing is proved of it by EVA
            for name, value in (("outer_low", self.bounds.low[c]), ("outer_high", self.bounds.high[c])):
                own[name] = literal(float(np.float32(value * 1.0001)) + (1e-12 if value > 0 else -1e-12))
        return own

    def _fields(self) -> dict[str, Any]:
        d, real, c = self.decoupler, self.real, self.real.constant
        names = {e.name: f"p->{e.name}" for e in d.entries}
        last = d.steps[-len(d.pose) :]
        results = {s.name: f"out->{identifier(column)}" for s, column in zip(last, d.pose, strict=True)}
        most = {identifier(column): c(d.known(column)) for column in d.pose}
        within = [
            f"((pose->{column} >= -{far}) && (pose->{column} <= {far}))" for column, far in most.items()
        ]
        by_size = [self.range_test(column) == "within" for column in d.inputs]
        ends = (2.0**-12, -(2.0**-12)) if d.at_pose else (2.0**-12, 1.0, -1.0)  # non-linear models: near rest
        return {
            "real": self.type,
            "constant": c,
            "zero": c(0.0),
            "by_size": "all" if all(by_size) else "some" if any(by_size) else "",
            "clamped": self.clamped(self._used(d.folded)),
            "body": statements(d.steps, names, real, results),
            "left": [w.left for w in d.watched],
            "all_clamped": self.clamped(d.inputs),
            "at_pose": statements(d.at_pose, names, real, {}),
            "known_within": "\n        && ".join(within),
            "reach": ", ".join(dict.fromkeys(f"{d.known(column):.6g} {unit(column)}" for column in d.pose)),
            "known": [[c(share * d.known(column)) for column in d.pose] for share in ends],
            "far": {
                p.member: [*(self._input(p, k * d.known(p.column) * 1.0001) for k in (1, -1, np.nan)), c(0.0)]
                for p in self.outputs
            },
            "most": real.most,
            # what roundings of a pose at its largest zero, and iterations, may leave [m, rad], and some
            "near": c(8 * 2.0**-real.digits * max(2.0 * d.known(p) for p in d.pose) + 10 * d.slack),
            "deviations": [
                *([UNION] if any(by_size) else []),
                backend.UNION,
                *([] if d.at_pose and not d.redundancy else [backend.STEP]),
            ],
            "work": firmware_cost(d),
            "least_gain": least_gains(d),
            **(self._of_slopes(names) if self.jacobian else {}),
        }

    def _of_slopes(self, names: Mapping[str, str]) -> dict[str, Any]:
        slopes, values = self.slopes, self._references()[1]
        clamped = self.clamped(self._used(slopes.whole))
        stored = {f"result_{k}": f"slopes->{name}" for k, name in enumerate(slopes.expressions)}
        # the reference is computed in double and written with 13 digits
        limits = [
            error + 1e-12 * np.abs(row).max()
            for error, row in zip(slopes.errors(self.real), values, strict=True)
        ]
        return {
            "slopes": slopes.records(),
            "slope_body": clamped + statements(slopes.steps, names, self.real, stored),
            "slope_bounds": ", ".join(f"{limit:.3e}" for limit in limits),
        }

    def _references(self) -> list[np.ndarray]:
        """With the slopes in double."""
        slopes = [self.slopes.of(self.vectors.clamped)] if self.jacobian else []
        return [self.vectors.pose, *slopes]

    @cached_property
    def slopes(self) -> Slopes:
        """The slopes that `decoupler_jacobian()` gives."""
        return Slopes(self.decoupler)

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
        return accepted.accepted(self.decoupler, float(np.finfo(self.real.dtype).max))

    def _just_outside(self, name: str) -> list[str]:
        if any(a.integers for a in self.decoupler.arrays if a.name == name):
            return []
        real = self.real.dtype
        just = [
            np.nextafter(real(end), real(k * np.inf))
            for end, k in zip(self.accepted[name], (-1, 1), strict=True)
        ]
        return [self._input(self.inputs[0], float(value)) for value in (np.nan, np.inf, -np.inf, *just)]

    def _input(self, port: Port, value: Any) -> str:
        if np.isfinite(value):
            return self.real.constant(value)
        return f"{'-' * (value < 0)}{self.real.cast}{'NAN' if np.isnan(value) else 'INFINITY'}"
