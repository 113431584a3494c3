"""The decoupler in float or double: its numbers and its table; `float_backend` prints it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar
from zlib import crc32

import numpy as np

from hallsym.codegen.arithmetic import COUNT, Port, mix
from hallsym.codegen.backend import VERSION, Backend, Stored
from hallsym.codegen.bounds import Bounds, pose_bounds
from hallsym.codegen.entries import Entry, unit
from hallsym.codegen.execution import on_arrays
from hallsym.codegen.float_c import Real, statements
from hallsym.codegen.naming import identifier


@dataclass(frozen=True, eq=False)
class FloatArithmetic(Backend):
    """IEEE 754 leaves no freedom to +, -, *, / and comparisons that round to nearest one by one.

    So numpy computes the same bits as C. `jacobian`: kinds of input by which the pose is differentiated, of
    `slopes.KINDS`.
    """

    real: Real
    jacobian: tuple[str, ...] = ()

    tree: ClassVar[str] = "float"
    hashed: ClassVar[tuple[int, int]] = (4096, 1_000_000)

    @property
    def type(self) -> str:
        """Float or double."""
        return self.real.name

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
        return {"crc32": f"0x{self.crc:08x}", "least_gain": dict(self.bounds.least_gain)}

    # -- the arithmetic ------------------------------------------------------------------------------------

    @cached_property
    def inputs(self) -> Sequence[Port]:
        """In SI."""
        return [Port(c, self.type, identifier(c), unit(c)) for c in self.decoupler.inputs]

    @cached_property
    def outputs(self) -> Sequence[Port]:
        """In SI."""
        return [Port(c, self.type, identifier(c), unit(c)) for c in self.decoupler.pose]

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
        return on_arrays(self.decoupler, self.real.dtype)

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By the bits of its size where a range is symmetric: NaN goes to the end of its sign."""
        held, status = super().hold(inputs)
        below = np.isnan(inputs) & np.signbit(inputs) & self._symmetric
        return np.where(below, self.ends[0], held), status

    @cached_property
    def _symmetric(self) -> np.ndarray:
        return np.array([[self.decoupler.box.symmetric(c)] for c in self.decoupler.inputs])

    def run(self, held: np.ndarray, zeros: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Operation by operation; `zeros` (n_pose, s) in place of those of the table."""
        dtype = self.real.dtype
        constants: list[np.ndarray] = [np.array([c], dtype=dtype) for c in self.decoupler.constants]
        if zeros is not None:
            constants[-len(zeros) :] = list(zeros)
        with np.errstate(under="ignore"):
            pose, *seen = self._run(held.astype(dtype), constants)
        flags = self.decoupler.raised(seen[0], dtype) if seen else np.uint32(0)
        return pose, np.asarray(flags)

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Most lie in the box, every 16th has any bits at all, every 16th is four times too large."""
        (low, high), dtype = self.ends, self.real.dtype
        n = np.asarray(numbers, dtype=np.uint32)
        count = np.uint32(len(self.decoupler.inputs))
        kind = mix(n ^ np.uint32(0x9E3779B9)) & np.uint32(15)
        raw = mix(n * count + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        share = (raw >> np.uint32(8)).astype(dtype) * dtype(2.0**-24)
        with np.errstate(all="ignore"):
            value = low + (high - low) * share
            value = np.where(kind == 1, value * dtype(4), value)
        wild = raw if self.real.size == 4 else (raw.astype(np.uint64) << np.uint64(32)) | mix(raw)
        return np.where(kind == 0, wild.view(dtype), value).astype(dtype)

    @cached_property
    def reset(self) -> dict[str, float]:
        """Zeros that hashed samples have: such that an angle wraps, or a fraction of a millimetre."""
        d = self.decoupler
        return {c: (1 - 2.0**-7) * d.known(c) if c in d.model.period else 2.0**-12 for c in d.pose}

    def hashed_step(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Half of the samples have no zeros, a quarter each those of a reset at one end and at the other."""
        kind = mix(np.asarray(numbers, dtype=np.uint32) ^ np.uint32(0x85EBCA6B)) & np.uint32(3)
        sign: np.ndarray = np.select([kind == 2, kind == 3], [1, -1], 0).astype(self.real.dtype)
        zeros = np.array([self.real.dtype(self.reset[c]) * sign for c in self.decoupler.pose])
        held, status = self.hold(self.sample(numbers))
        pose, flags = self.run(held, zeros)
        return pose, status.astype(np.uint32) | flags.astype(np.uint32)

    def _words(self, pose: np.ndarray) -> np.ndarray:
        if self.real.size == 4:
            return pose.view(np.uint32)
        bits = pose.view(np.uint64)
        return np.asarray((bits >> np.uint64(32)).astype(np.uint32) ^ mix(bits.astype(np.uint32)))

    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        return inputs.astype(self.real.dtype)

    def _chosen(self) -> np.ndarray:
        """Return corners and points of the box, and inputs that are out of range or not finite."""
        low, high = (side[:, 0] for side in self.ends)
        rng, dtype = np.random.default_rng(1), self.real.dtype
        share = np.hstack([np.zeros((len(low), 1)) + 0.5, rng.random((len(low), COUNT - 1))])
        share[:, 1:9] = rng.choice([0.0, 1.0], (len(low), 8))
        inside = (low[:, None] + (high - low)[:, None] * share).astype(dtype)
        if self.decoupler.drawn is not None:
            inside = self.decoupler.drawn(rng, COUNT).astype(dtype)
        inside = np.clip(inside, low[:, None], high[:, None])
        bad = []
        for k in range(len(low)):
            for value in (np.nan, np.inf, -np.inf, 2 * low[k], 2 * high[k], np.finfo(dtype).max):
                column = inside[:, 9 + k].copy()
                column[k] = value
                bad.append(column)
        bad.append(np.full(len(low), np.nan, dtype=dtype))
        bad += [np.array(row, dtype=dtype) for row in self.decoupler.listed]
        return np.hstack([inside, np.array(bad, dtype=dtype).T])

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> Sequence[Stored]:
        """Numbers in SI, or 16-bit integers in a row."""
        d, dtype = self.decoupler, np.dtype(self.real.dtype).newbyteorder("<")

        def stored(entries: Sequence[Entry]) -> list[Stored]:
            return [
                Stored(e.name, np.array(e.value, dtype), f"[{e.unit}] {e.meaning}", e.unit) for e in entries
            ]

        rows = [
            Stored(
                a.name, np.array(a.values, "<i2" if a.integers else dtype), f"[{a.unit}] {a.meaning}", a.unit
            )
            for a in d.arrays
        ]
        return [*stored((*d.table, *d.limits)), *rows, *stored(d.zeros)]

    @property
    def pad(self) -> int:
        """A word before the zeros in double."""
        return self.real.size - 4

    @cached_property
    def layout(self) -> int:
        """Of names, units and statements."""
        d = self.decoupler
        lines = [f"{VERSION} {self.type}"]
        lines += [f"{e.name} {e.unit}" for e in d.entries]
        lines += [f"{a.name}[{len(a.values)}] {a.unit} {a.integers}" for a in d.arrays]
        lines += statements([replace(step, remark="") for step in d.steps], {}, self.real, {})
        return crc32("\n".join(lines).encode())

    def _json(self) -> dict[str, Any]:
        d = self.decoupler
        record: dict[str, Any] = {
            "parameters": [
                {
                    "name": e.name,
                    "value": float(self.real.dtype(e.value)),
                    "unit": e.unit,
                    "meaning": e.meaning,
                }
                for e in d.entries
            ]
        }
        if d.arrays:
            record["arrays"] = [
                {"name": a.name, "values": list(a.values), "unit": a.unit, "meaning": a.meaning}
                for a in d.arrays
            ]
        return record

    def _literal(self, value: Any) -> str:
        return str(value) if isinstance(value, int) else self.real.constant(value)
