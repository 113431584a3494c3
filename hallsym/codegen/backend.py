"""One decoupler in one arithmetic: its table, its C, the same arithmetic in numpy, self-test and proofs.

A `Backend` says what numbers are in C, how steps are printed and run, and what is proved of them. What is the
same for every arithmetic is here; `float_backend` and `integer_backend` are the two there are.
"""

import json
import struct
import textwrap
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import Decoupler, flag_bit
from hallsym.codegen.entries import short
from hallsym.codegen.templates import MARK, filled, tree

VERSION = 1
"""Of the generated interface and of the head of the table."""
BINARY = "params/decoupler_params.bin"
COUNT = 48
"""Vectors within the box that the self-test lists."""
BATCH = 1 << 16
"""Samples that are computed at a time."""
REFERENCE = 1e-15
"""Rounding [m, rad] of the model's own pose, computed in double and written with 13 digits."""
C_TYPES = {"f4": "float", "f8": "double", "i4": "int32_t", "u4": "uint32_t", "i2": "int16_t"}


def mix(x: np.ndarray) -> np.ndarray:
    """Return 32 well-mixed bits of each 32-bit number (the `mix` of test/selftest.c)."""
    x = np.asarray(x, dtype=np.uint32).copy()
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    return x ^ (x >> np.uint32(16))


@dataclass(frozen=True, eq=False)
class Stored:
    """An entry of the table as C holds it: a number () or a row (n,), little-endian, and what the header says."""

    name: str
    values: np.ndarray
    note: str
    unit: str = ""

    @property
    def member(self) -> str:
        """Its declaration in the struct of the table."""
        size = f"[{len(self.values)}]" if self.values.ndim else ""
        return f"{C_TYPES[self.values.dtype.str[1:]]} {self.name}{size}; /**< {self.note} */"


@dataclass(frozen=True, eq=False)
class Vectors:
    """Listed vectors: `inputs` (n_inputs, s), `held` those brought back into the box, `status` (s,), `pose`
    (n_pose, s) of the model in double.
    """

    inputs: np.ndarray
    held: np.ndarray
    pose: np.ndarray
    status: np.ndarray


@dataclass(frozen=True, eq=False)
class Backend(ABC):
    """What is printed, run and proved of a decoupler in one arithmetic.

    `record`: what the table came from (model, sha256 of the calibration, options), for its JSON form.
    """

    decoupler: Decoupler
    record: Mapping[str, Any]

    tree: ClassVar[str]
    """Folder of templates."""
    hashed: ClassVar[tuple[int, int]]
    """Samples in the short and the long hash of the self-test."""
    batch: ClassVar[int] = BATCH
    outside: ClassVar[str]
    """What the header says of an input whose bit is set."""

    # -- the arithmetic ------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def type(self) -> str:
        """The name of its numbers: float, double or q31."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Range and rounding error bound of the pose over the box."""

    @property
    @abstractmethod
    def error_bound(self) -> Mapping[str, float]:
        """Bound of |computed - model| [SI] by pose column: rounding, approximations, everything."""

    @property
    @abstractmethod
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest value of the inputs in their own numbers, (n_inputs, 1) each."""

    @property
    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """The same, between which random inputs are drawn."""
        return self.ends

    @abstractmethod
    def run(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and bits of the flags (s,) of inputs within the box: the same bits as C."""

    @abstractmethod
    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Return inputs (n_inputs, s) of numbered samples, as `sample` of test/selftest.c makes them."""

    @abstractmethod
    def words(self, pose: np.ndarray) -> np.ndarray:
        """Return the 32 bits (n_pose, s) of a pose that the hash takes."""

    @abstractmethod
    def rounded(self, inputs: np.ndarray) -> np.ndarray:
        """Return inputs as numbers of this arithmetic."""

    @abstractmethod
    def si(self, values: np.ndarray, columns: Sequence[str]) -> np.ndarray:
        """Return numbers of this arithmetic (n, s) in SI."""

    @abstractmethod
    def chosen(self) -> np.ndarray:
        """Return the inputs (n_inputs, s) that the self-test lists."""

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs brought back into the box, and the status bits (s,) of those that were not in it."""
        low, high = self.ends
        with np.errstate(all="ignore"):
            above, below = ~(inputs <= high), inputs < low
        bits = (1 << np.arange(len(inputs), dtype=np.uint32))[:, None]
        return np.where(above, high, np.where(below, low, inputs)), ((above | below) * bits).sum(axis=0)

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and status (s,) of inputs (n_inputs, s), whatever their bits, as C does."""
        held, status = self.hold(inputs)
        pose, flags = self.run(held)
        return pose, status.astype(np.uint32) | flags.astype(np.uint32)

    def hash(self, count: int) -> int:
        """Return the hash of status and pose over samples 0 to count - 1."""
        total, width = 0, np.uint32(len(self.decoupler.pose) + 1)
        for first in range(0, count, BATCH):
            n = np.arange(first, min(first + BATCH, count), dtype=np.uint32)
            pose, status = self.step(self.sample(n))
            for k, row in enumerate((status, *self.words(pose))):
                total += int(mix(row ^ mix(n * width + np.uint32(k))).astype(np.uint64).sum())
        return total & 0xFFFFFFFF

    def errors(self, samples: int = 100_000, seed: int = 0) -> dict[str, float]:
        """Return the largest error of each pose coordinate against the model in double, over random inputs."""
        d, rng, most = self.decoupler, np.random.default_rng(seed), np.zeros(len(self.decoupler.pose))
        low, high = self.span
        for first in range(0, samples, self.batch):
            share = rng.random((len(low), min(self.batch, samples - first)))
            inputs = self.rounded(low + (high - low) * share)
            pose, status = self.step(inputs)
            error = d.difference(self.si(pose, d.pose), d.exact(self.si(inputs, d.inputs)))
            most = np.maximum(most, np.abs(error[:, status == 0]).max(axis=1, initial=0.0))
        return dict(zip(d.pose, most.tolist(), strict=True))

    @cached_property
    def vectors(self) -> Vectors:
        """The vectors of the self-test: where a flag says that there is no pose, what is computed."""
        d, inputs = self.decoupler, self.chosen()
        held = self.si(self.hold(inputs)[0], d.inputs)
        pose, status = self.step(inputs)
        found, exact = self.si(pose, d.pose), d.exact(held)
        if d.model.period:  # on the branch of what is computed
            exact = found - d.difference(found, exact)
        weak = status >= flag_bit(len(d.flags) - 1) if d.flags else np.zeros(len(status), bool)
        return Vectors(inputs, held, np.where(weak, found, exact), status)

    # -- the table -----------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def coefficients(self) -> Sequence[Stored]:
        """Coefficients and limits, in the order of the table."""

    @property
    @abstractmethod
    def rows(self) -> Sequence[Stored]:
        """Rows of numbers that steps look up, after the limits."""

    @property
    @abstractmethod
    def zeros(self) -> Sequence[Stored]:
        """What a reset adds to the pose, at the end of the table."""

    @property
    @abstractmethod
    def layout(self) -> int:
        """CRC-32 over names, units and arithmetic: code and table belong together if it is the same."""

    @abstractmethod
    def json_of_table(self) -> dict[str, Any]:
        """Return what its JSON form says of the numbers."""

    @property
    def head(self) -> tuple[tuple[str, int], ...]:
        """Words before the entries."""
        return ("version", VERSION), ("layout", self.layout), ("crc", self.crc)

    @cached_property
    def covered(self) -> bytes:
        """The bytes that the CRC covers: not the zeros, which a reset changes."""
        return b"".join(entry.values.tobytes() for entry in (*self.coefficients, *self.rows))

    @property
    def crc(self) -> int:
        """CRC-32 (IEEE 802.3, as zlib has it)."""
        return zlib.crc32(self.covered)

    @property
    def binary(self) -> bytes:
        """The table as it lies in the flash of a little-endian controller."""
        head = struct.pack(f"<{len(self.head)}I", *(word for _, word in self.head))
        return head + self.covered + b"".join(zero.values.tobytes() for zero in self.zeros)

    def json(self) -> str:
        """Return the table as a readable record."""
        record = {
            "format": "hallsym decoupler parameters 1",
            "generator": MARK,
            **self.record,
            "version": VERSION,
            "layout": f"0x{self.layout:08x}",
            "crc32": f"0x{self.crc:08x}",
            "type": self.type,
            **self.json_of_table(),
        }
        return json.dumps(record, indent=1) + "\n"

    # -- C -------------------------------------------------------------------------------------------------

    @abstractmethod
    def literal(self, value: Any) -> str:
        """Return a number in C."""

    def member(self, column: str) -> str:
        """Return the C name of an input or output."""
        return column

    @abstractmethod
    def c_type(self, column: str) -> str:
        """Return the C type of an input or output."""

    @abstractmethod
    def note(self, column: str) -> str:
        """Return what the header says of an output: its unit."""

    def input_note(self, column: str) -> str:
        """Return what the header says of an input: its unit first."""
        return self.note(column)

    @property
    def limited(self) -> Sequence[str]:
        """Inputs that have a range."""
        return self.decoupler.inputs

    @abstractmethod
    def any_value(self, column: str) -> str:
        """Return the C of an input of any bits, for CBMC."""

    @abstractmethod
    def outer(self, column: str) -> tuple[str, str] | None:
        """Return C of the ends between which a prover is to see an output, or None."""

    @abstractmethod
    def summary(self) -> dict[str, Any]:
        """Return what the record of a generation says of this arithmetic alone."""

    @abstractmethod
    def fields(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        """Return the fields of the templates of this arithmetic alone."""

    def files(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, str | bytes]:
        """Return the files of the folder by path; `errors`: largest met, `notes`: on the calibration."""
        fields = {**self._fields(), **self.fields(errors, notes)}
        made: dict[str, str | bytes] = {name: filled(path, fields) for name, path in tree(self.tree).items()}
        return made | {"params/decoupler_params.json": self.json(), BINARY: self.binary}

    def _fields(self) -> dict[str, Any]:
        d = self.decoupler
        bits = [
            f"#define {bit(c)} 0x{1 << k:08X}UL /**< {c} {self.outside} */"
            for k, c in enumerate(d.inputs)
            if c in self.limited
        ]
        bits += [
            f"#define DECOUPLER_{f.name} 0x{flag_bit(k):08X}UL /**< {f.meaning} */"
            for k, f in enumerate(d.flags)
        ]
        flags = " | ".join(f"DECOUPLER_{f.name}" for f in d.flags)
        wanted = [
            f"wanted |= ((in.{c} >= {low}) && (in.{c} <= {high})) ? 0U : {bit(c)};"
            for c in self.limited
            for low, high in [of_params(*ends(d, c))]
        ]
        bounded = [
            f'__CPROVER_assert((out.{c} >= {low}) && (out.{c} <= {high}), "{c} bounded");'
            for c in d.pose
            for low, high in filter(None, [self.outer(c)])
        ]
        short_hash, long_hash = (f"0x{self.hash(n):08X}UL" for n in self.hashed)
        return {
            "model": d.model.name,
            "family": d.model.family,
            "sha256": self.record["calibration_sha256"],
            "version": VERSION,
            "layout": f"0x{self.layout:08X}UL",
            "table_layout": f"0x{self.layout:08x}",
            "table_bytes": len(self.binary),
            "inputs": len(d.inputs),
            "pose": len(d.pose),
            "width": len(d.pose) + 1,
            "first": self.coefficients[0].name,
            "last": self.zeros[0].name,
            "bits": bits or [""],
            "table": [f"uint32_t {name}; /**< 0 */" for name, _ in self.head[3:]]
            + [e.member for e in (*self.coefficients, *self.rows, *self.zeros)],
            "in": [f"{self.c_type(c)} {self.member(c)}; /**< {self.input_note(c)} */" for c in d.inputs],
            "out": [f"{self.c_type(c)} {self.member(c)}; /**< {self.note(c)} */" for c in d.pose],
            "values": self._values(),
            "without_flags": f" & ~({flags})" if d.flags else "",
            "status_or_flags": self.flag_status,
            "any_inputs": [f"in.{self.member(c)} = {self.any_value(c)};" for c in d.inputs],
            "wanted": wanted,
            "pose_bounded": bounded,
            "vectors": self.vectors.inputs.shape[1],
            "hash_short": short_hash,
            "hash_long": long_hash,
        }

    @property
    def flag_status(self) -> str:
        """The status of inputs in the box, for a prover: 0, or all flags."""
        raised = sum(flag_bit(k) for k in range(len(self.decoupler.flags)))
        return f"status == 0 || status == 0x{raised:08X}" if raised else "status == 0"

    def _values(self) -> list[str]:
        """The table as an initializer in C."""
        rows = [f"    .{name} = {_word(name, value)}," for name, value in self.head]
        for entry in (*self.coefficients, *self.rows, *self.zeros):
            remark = f" /* [{entry.unit}] */" if entry.unit else ""
            if entry.values.ndim:
                text = ", ".join(map(self.literal, entry.values.tolist()))
                rows += [f"    .{entry.name} = {{{remark}", *wrapped(text), "    },"]
            else:
                sign = "U" if entry.values.dtype.kind == "u" else ""
                rows.append(f"    .{entry.name} = {self.literal(entry.values.item())}{sign},{remark}")
        return rows


def _word(name: str, value: int) -> str:
    return f"0x{value:08X}UL" if name in ("layout", "crc") else f"{value}UL"


def wrapped(text: str) -> list[str]:
    """Return the lines of a row of numbers in an initializer."""
    return [f"        {line}" for line in textwrap.wrap(text, 104)]


def ends(d: Decoupler, column: str) -> tuple[str, str]:
    """Return the C text of the ends of an input's range."""
    name = short(column)
    if d.box.symmetric(column):
        return f"-p->limit_{name}", f"p->limit_{name}"
    return f"p->low_{name}", f"p->high_{name}"


def of_params(*texts: str) -> tuple[str, ...]:
    """Return C texts with the entries taken from the constant table."""
    return tuple(text.replace("p->", "decoupler_params.") for text in texts)


def bit(column: str) -> str:
    """Return the name of an input's status bit."""
    return f"DECOUPLER_{short(column).upper()}"
