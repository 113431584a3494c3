"""The table and the files of a decoupler in one arithmetic.

A `Backend` says what numbers are in C, how steps are printed and run, and what is proved of them. What is the
same for every arithmetic is here; `float_backend` and `integer_backend` are the two.
"""

import struct
import textwrap
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from itertools import product
from typing import Any, ClassVar

import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.accepted import Ends, kept_ends
from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import Decoupler, flag_bit, short, unit
from hallsym.codegen.naming import PREFIX
from hallsym.codegen.residual import Ran
from hallsym.codegen.templates import LICENSE, filled, hexadecimal, status_bit, tree
from hallsym.files import json_text
from hallsym.output import commented
from hallsym.records import named

STEP = "misra-c2012-8.7:decoupler.c"
"""Deviation: the function is external for its user, not for its library."""
UNION = "misra-c2012-19.2:decoupler_check.c"
"""Deviation: the bytes of a number are read through a union, which C99 defines."""
VERSION = 3
"""Of the generated interface and of the head of the table."""
BINARY = "table/decoupler_params.bin"
DIGITS = 16
"""Digits of the SHA-256 of a calibration that each file shows."""
REFERENCE = 1e-15
"""Rounding [m, rad] of the model's own pose, computed in double and written with 13 digits."""
C_TYPES = {"f4": "float", "i4": "int32_t", "u4": "uint32_t", "i2": "int16_t"}


COUNT = 48
"""Vectors within the box that the self-test lists."""


BATCH = 1 << 16
"""Samples that are computed at a time."""


def mix(x: np.ndarray) -> np.ndarray:
    """Return 32 well-mixed bits of each 32-bit number (the `mix` of test/selftest.c)."""
    x = np.asarray(x, dtype=np.uint32).copy()
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    return x ^ (x >> np.uint32(16))


@dataclass(frozen=True)
class Port:
    """An input or output of the generated functions: its C type and name, unit, and the SI value of 1."""

    column: str
    type: str
    member: str
    unit: str
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Vectors:
    """Listed vectors: `inputs` (n_inputs, s), `clamped` those brought back into the box [SI], `status` (s,).

    `pose` (n_pose, s): of the model in double.
    """

    inputs: np.ndarray
    clamped: np.ndarray
    pose: np.ndarray
    status: np.ndarray


@dataclass(frozen=True, eq=False)
class Stored:
    """An entry of the table in C: a number () or a row (n,), little-endian."""

    name: str
    values: np.ndarray
    meaning: str
    unit: str = ""

    @property
    def note(self) -> str:
        """What the header says of it."""
        return f"[{self.unit}] {self.meaning}" if self.unit else self.meaning

    @property
    def member(self) -> str:
        """Its declaration in the struct of the table."""
        size = f"[{len(self.values)}]" if self.values.ndim else ""
        return f"{C_TYPES[self.values.dtype.str[1:]]} {self.name}{size}; /**< {commented(self.note)} */"


@dataclass(frozen=True, eq=False)
class Backend(ABC):
    """What is computed, printed, run and proved of a decoupler in one arithmetic: float32 or integers.

    `record`: what the table came from (model, sha256 of the calibration, options), for its JSON form. `kept`:
    least and greatest values of the table of code that shall stay as it is.
    """

    decoupler: Decoupler
    record: Mapping[str, Any]
    kept: Ends | None = field(default=None, kw_only=True)

    type: ClassVar[str]
    """The name of its numbers, float or q31, and of its folder of templates."""
    batch: ClassVar[int] = BATCH
    """Random samples that are drawn at a time."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Range and rounding error bound of the pose over the box."""

    @property
    def error_bound(self) -> Mapping[str, float]:
        """Bound of |computed - model| [SI] by pose column: rounding, approximations, everything."""
        return self.bounds.error

    @abstractmethod
    def _port(self, column: str) -> Port:
        """Return an input or output."""

    @cached_property
    def inputs(self) -> Sequence[Port]:
        """Readings, then state."""
        return [self._port(c) for c in self.decoupler.inputs]

    @cached_property
    def outputs(self) -> Sequence[Port]:
        """Pose coordinates."""
        return [self._port(c) for c in self.decoupler.pose]

    @property
    def limited(self) -> Sequence[str]:
        """Inputs that have a range: all but binary angles."""
        return [c for c in self.decoupler.inputs if self.range_test(c)]

    @property
    @abstractmethod
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest value of the inputs in their own numbers, (n_inputs, 1) each."""

    @property
    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """The same, between which random inputs are drawn."""
        return self.ends

    @abstractmethod
    def run(self, clamped: np.ndarray) -> Ran:
        """Return pose, bits of the flags and suspects of inputs within the box: the same bits as C."""

    @abstractmethod
    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Return inputs (n_inputs, s) of numbered samples, as `sample` of test/selftest.c makes them."""

    @abstractmethod
    def _words(self, pose: np.ndarray) -> np.ndarray:
        """Return the 32 bits (n_pose, s) of a pose that the hash takes."""

    @abstractmethod
    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        """Return inputs as numbers of this arithmetic."""

    @abstractmethod
    def _beyond(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return values (v, n_inputs) that are in no range, of the ends (n_inputs,) of ranges."""

    def _chosen(self) -> np.ndarray:
        """Return the inputs (n_inputs, s) that the self-test lists: within, one beyond, all beyond."""
        d, (low, high), rng = self.decoupler, self.ends, np.random.default_rng(1)
        share = np.hstack([np.full_like(low, 0.5, dtype=float), rng.random((len(low), COUNT - 1))])
        share[:, 1:9] = rng.choice([0.0, 1.0], (len(low), 8))
        inside = low + (high - low) * share if d.drawn is None else self._trials(rng, COUNT)
        found = [self._rounded(np.clip(inside, low, high))]
        sides = [self._beyond(low[:, 0], high[:, 0])]
        sides += [] if d.drawn is None else [np.hstack([low, high]).T]  # poses alone do not reach the ends
        for values in sides:
            for k in range(len(low)):
                columns = np.repeat(found[0][:, [(9 + k) % COUNT]], len(values), axis=1)
                columns[k] = values[:, k]
                found.append(columns)
        found.append(sides[0][:1].T)
        if d.listed:
            found.append(self._rounded((np.array(d.listed) / [port.scale for port in self.inputs]).T))
        return np.hstack(found)

    def _trials(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random inputs (n_inputs, count) in the box, in the unit of their own numbers."""
        low, high = self.span
        if self.decoupler.drawn is not None:
            scale = np.array([[port.scale] for port in self.inputs])
            return np.clip(self.decoupler.drawn(rng, count) / scale, low, high)
        return np.asarray(low + (high - low) * rng.random((len(low), count)))

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs brought back into the box, and the status bits (s,) of those that were not in it."""
        low, high = self.ends
        with np.errstate(all="ignore"):
            above, below = ~(inputs <= high), inputs < low
        bits = np.array(self.decoupler.input_bits, dtype=np.uint32)[:, None]
        status = np.bitwise_or.reduce(np.where(above | below, bits, np.uint32(0)), axis=0)
        return np.where(above, high, np.where(below, low, inputs)), status

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and status (s,) of inputs (n_inputs, s), whatever their bits, as C does."""
        return self.whole_step(inputs)[:2]

    def whole_step(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose (n_pose, s), status (s,) and suspects (s,) by number from 1; 0 is none."""
        clamped, status = self.hold(inputs)
        return self._done(status, self.run(clamped))

    def _done(self, status: np.ndarray, found: Ran) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return found.pose, status.astype(np.uint32) | found.flags.astype(np.uint32), found.suspects

    def hashed_step(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose, status and suspects of numbered samples, as the self-test hashes them."""
        return self.whole_step(self.sample(numbers))

    def hash(self, count: int) -> int:
        """Return the hash of status and pose over samples 0 to count - 1."""
        total, width = 0, np.uint32(self.width)
        for first in range(0, count, BATCH):
            n = np.arange(first, min(first + BATCH, count), dtype=np.uint32)
            pose, status, suspects = self.hashed_step(n)
            others = (suspects,) if self.decoupler.suspects else ()
            for k, row in enumerate((status, *self._words(pose), *others)):
                total += int(mix(row ^ mix(n * width + np.uint32(k))).astype(np.uint64).sum())
        return total & 0xFFFFFFFF

    @property
    def width(self) -> int:
        """Words of a sample that the hash takes: status, pose and, where one is named, the suspect."""
        return len(self.decoupler.pose) + 1 + self.decoupler.suspects

    def errors(self, samples: int | None = None, seed: int = 0) -> dict[str, float]:
        """Return the largest error of each pose coordinate against the model, over random inputs."""
        d, rng, most = self.decoupler, np.random.default_rng(seed), np.zeros(len(self.decoupler.pose))
        samples = d.tried if samples is None else samples
        for first in range(0, samples, self.batch):
            count = min(self.batch, samples - first)
            inputs = self._rounded(self._trials(rng, count))
            pose, status = self.step(inputs)
            error = d.difference(_si(pose, self.outputs), d.exact(_si(inputs, self.inputs)))
            most = np.maximum(most, np.abs(error[:, status == 0]).max(axis=1, initial=0.0))
        return named(d.pose, most)

    @cached_property
    def vectors(self) -> Vectors:
        """The vectors of the self-test: where a flag says that there is no pose, what is computed."""
        d, inputs = self.decoupler, self._chosen()
        clamped = _si(self.hold(inputs)[0], self.inputs)
        pose, status = self.step(inputs)
        found, exact = _si(pose, self.outputs), d.exact(clamped)
        if d.model.period:  # on the branch of what is computed
            exact = found - d.difference(found, exact)
        weak = status >= flag_bit(len(d.flags) - 1) if d.flags else np.zeros(len(status), bool)
        if d.drawn is not None:
            # Inputs brought back into the box belong to no pose, nor does one that was put to its end alone.
            # Code that weights such a sensor out keeps its pose, with status 0; the model, which fits all
            # readings alike, goes elsewhere. What is computed still holds the compiled C to it.
            low, high = self.ends
            given = self.hold(inputs)[0]
            weak = (status > 0) | ((given <= low) | (given >= high)).any(axis=0)
        return Vectors(inputs, clamped, np.where(weak, found, exact), status)

    machine: ClassVar[str]
    """Of QEMU, on which the folder is tried."""
    cpu: ClassVar[str]
    """Compiler options of the core of that machine."""
    why_ends: ClassVar[str]
    """What C says of the least and greatest values of a table."""

    @property
    @abstractmethod
    def hashed(self) -> tuple[int, int]:
        """Samples in the short and the long hash of the self-test."""

    @abstractmethod
    def summary(self) -> dict[str, Any]:
        """Return what the record of a generation says of this arithmetic alone."""

    # -- the table -----------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def entries(self) -> Sequence[Stored]:
        """Coefficients and limits, rows of numbers that steps look up, and offsets, in their order."""

    @property
    @abstractmethod
    def layout(self) -> int:
        """CRC-32 over names, units and arithmetic: code and table belong together if it is the same."""

    @cached_property
    def accepted(self) -> Ends:
        """Least and greatest value of each number and row of the table: those of code that stays, if any."""
        values = {e.name: e.values.ravel().tolist() for e in self.entries}
        return kept_ends(self.kept, values) or self._accepted()

    @abstractmethod
    def _accepted(self) -> Ends:
        """Return the least and the greatest value of each number and row, in its own numbers."""

    @abstractmethod
    def _just_outside(self, name: str) -> list[str]:
        """Return, in C, the numbers next to the ends of an entry, and what is no number."""

    @abstractmethod
    def _literal(self, value: Any) -> str:
        """Return a number of the table in C."""

    @property
    def identity(self) -> tuple[int, int]:
        """The first 8 bytes of the SHA-256 of the calibration."""
        digest = str(self.record.get("calibration_sha256", "0" * 64))
        return int(digest[:8], 16), int(digest[8:16], 16)

    @property
    def constant(self) -> Sequence[Stored]:
        """The entries that a reset leaves as they are."""
        return self.entries[: -len(self.decoupler.pose)]

    @property
    def offsets(self) -> Sequence[Stored]:
        """The entries that a reset sets."""
        return self.entries[-len(self.decoupler.pose) :]

    @property
    def length(self) -> int:
        """Bytes of the table: two CRC, five words, entries."""
        return 4 * (2 + 5) + sum(entry.values.nbytes for entry in self.entries)

    @cached_property
    def covered(self) -> bytes:
        """The bytes that the CRC of the table covers: all between it and the CRC of the offsets."""
        words = struct.pack("<5I", VERSION, self.layout, self.length, *self.identity)
        return words + _joined(self.constant)

    @property
    def crc(self) -> int:
        """CRC-32 (IEEE 802.3, as zlib has it) of all but the offsets."""
        return zlib.crc32(self.covered)

    @property
    def zeros_crc(self) -> int:
        """CRC-32 of the offsets."""
        return zlib.crc32(_joined(self.offsets))

    @property
    def binary(self) -> bytes:
        """The table as it lies in the flash of a little-endian controller."""
        crc, zeros_crc = (struct.pack("<I", value) for value in (self.crc, self.zeros_crc))
        return crc + self.covered + zeros_crc + _joined(self.offsets)

    def json(self, **more: Any) -> str:
        """Return the table as a readable record; `more`: of an arithmetic alone."""
        listed: dict[str, list[dict[str, Any]]] = {"parameters": [], "arrays": []}
        for e in self.entries:
            kind, value = ("arrays", "values") if e.values.ndim else ("parameters", "value")
            about = {"unit": e.unit, "meaning": e.meaning} if e.unit else {"meaning": e.meaning}
            ends = dict(zip(("least", "greatest"), self.accepted[e.name], strict=True))
            listed[kind].append({"name": e.name, value: e.values.tolist(), **about, **ends})
        record = {
            "format": "hallsym decoupler parameters 1", "generator": f"hallsym {version('hallsym')}",
            **self.record, "version": VERSION, "layout": f"0x{self.layout:08x}", "crc32": f"0x{self.crc:08x}",
            "type": self.type, **more, **{k: v for k, v in listed.items() if v},
        }  # fmt: skip
        return json_text(record) + "\n"

    def listed(self, entries: Sequence[Stored]) -> list[str]:
        """Return entries as lines of an initializer in C."""
        rows = []
        for entry in entries:
            remark = f" /* [{entry.unit}] */" if entry.unit else ""
            if entry.values.ndim:
                text = textwrap.wrap(", ".join(map(self._literal, entry.values.tolist())), 104)
                rows += [f"    .{entry.name} = {{{remark}", *(f"        {line}" for line in text), "    },"]
            else:
                sign = "U" if entry.values.dtype.kind == "u" else ""
                rows.append(f"    .{entry.name} = {self._literal(entry.values.item())}{sign},{remark}")
        return rows

    # -- files ---------------------------------------------------------------------------------------------

    @abstractmethod
    def _own(self, port: Port, given: bool) -> dict[str, Any]:
        """Return what templates of this arithmetic alone say of an input (`given`) or an output."""

    def _inputs(self) -> list[dict[str, Any]]:
        d, out = self.decoupler, []
        for k, port in enumerate(self.inputs):
            low, high = ends(d, port.column)
            out.append({
                **_record(k, port), "bit": bit(port.column), "mask": hexadecimal(d.input_bits[k]),
                "by": self.range_test(port.column), "symmetric": d.box.symmetric(port.column),
                "filled": f"({low} <= {high})", "least": of_params(low), "greatest": of_params(high),
                "lowest": f"{d.ends(port.column)[0]:.6g}", "highest": f"{d.ends(port.column)[1]:.6g}",
                **self._own(port, True),
            })  # fmt: skip
        return out

    def _outputs(self, errors: Mapping[str, float]) -> list[dict[str, Any]]:
        out, found = [], self.bounds
        for k, port in enumerate(self.outputs):
            c = port.column
            out.append({
                **_record(k, port), "zero": f"zero_{short(c)}",
                "lowest": f"{found.low[c]:.6g}", "highest": f"{found.high[c]:.6g}",
                "error": _small(self.error_bound[c], c), "met": _small(errors[c], c),
                **self._own(port, False),
            })  # fmt: skip
        return out

    @abstractmethod
    def range_test(self, column: str) -> str:
        """Return the C function that brings an input into its range: `within`, `limited`, or none."""

    def clamped(self, used: Collection[str]) -> list[str]:
        """Return C that brings the inputs into their ranges; of those not `used` only the status counts."""
        d, lines = self.decoupler, []
        for port in self.inputs:
            (low, high), by = ends(d, port.column), self.range_test(port.column)
            limits = high if by == "within" else f"{low}, {high}"
            call = f"{by}(in->{port.member}, {limits}, {bit(port.column)}, &status);"
            own = f"const {port.type} {short(port.column)} = " if port.column in used else "(void)"
            lines.append(own + (call if by else f"in->{port.member};"))
        return lines

    @property
    def said(self) -> Sequence[str]:
        """Sentences for header and report."""
        return (*self.decoupler.said, *self.decoupler.of_faults)

    @abstractmethod
    def _fields(self) -> dict[str, Any]:
        """Return what templates of this arithmetic alone say.

        Of all arithmetics: `real`, the C type of its numbers, its `zero`, its `one`, and `some_zero` that a
        reset may set; `left`, what is left of each reading that is watched; `known` poses at which the
        self-test takes a zero, and `far`, by member, values that are refused, the last one is not; `most`,
        the largest number.
        """

    @abstractmethod
    def _input(self, port: Port, value: Any) -> str:
        """Return a value of an input or output in C, whatever it is."""

    def vector_rows(self) -> list[str]:
        """Return the vectors of the self-test in C."""
        found, every, out = self.vectors, self._references(), []
        for k in range(found.inputs.shape[1]):
            inputs = ", ".join(map(self._input, self.inputs, found.inputs[:, k].tolist()))
            references = "".join(f"{{{listed(row[:, k])}}}, " for row in every)
            out.append(f"{{{{{inputs}}}, {references}0x{int(found.status[k]):X}UL}},")
        return out

    def _references(self) -> list[np.ndarray]:
        """Return what a vector has beside its inputs (n, s): the pose of the model."""
        return [self.vectors.pose]

    def files(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, str | bytes]:
        """Return the files of the folder by path; `errors`: largest met, `notes`: on the calibration."""
        d = self.decoupler
        sha256 = str(self.record["calibration_sha256"])
        raised = {sum(some) for some in product(*((0, flag_bit(k)) for k in range(len(d.flags))))}
        fields = {
            "b": self, "d": d, "inputs": self._inputs(), "outputs": self._outputs(errors),
            "version": VERSION, "prefix": self.record.get("name", PREFIX),
            "generated": f"Generated by hallsym {version('hallsym')} from calibration {sha256[:DIGITS]}",
            "sha256": sha256, "license": self.record.get("license", LICENSE),
            "ends": self._ends_checked(),
            "suspects": residual.fields_of(d) if d.suspects else {},
            "status_or_flags": " || ".join(f"status == {f'0x{v:08X}' if v else 0}" for v in sorted(raised)),
            "bounds": ", ".join(f"{error + REFERENCE:.3e}" for error in self.error_bound.values()),
            "notes": "\n".join(f"- {commented(note)}" for note in (*self.said, *notes)),
            "slopes": [], "reciprocals": [], "tried": "range test, all bit patterns",
            **self._fields(),
        }  # fmt: skip
        made: dict[str, str | bytes] = {
            name: filled(path, fields) for name, path in self._templates().items()
        }
        return made | {"table/decoupler_params.json": self.json(), BINARY: self.binary}

    @property
    def rows(self) -> list[Stored]:
        """The rows of numbers that are not whole."""
        return [e for e in self.entries if e.values.ndim and e.values.dtype.kind == "f"]

    @property
    def numbers(self) -> list[Stored]:
        """The entries without rows."""
        return [e for e in self.entries if not e.values.ndim]

    def _ends_checked(self) -> dict[str, Any]:
        """The fields of the loop over ends, from the first number that has any to the last."""
        numbers = list(self.numbers)
        while numbers and self._any(numbers[0]):
            numbers.pop(0)
        while numbers and self._any(numbers[-1]):
            numbers.pop()
        if not numbers:
            return {}
        kinds = [self._found_bad_by(e) for e in numbers]
        names = list(dict.fromkeys(kinds))
        kind = f"DECOUPLER_BAD_{names[-1]}"
        for name in names[-2::-1]:
            last = len(kinds) - kinds[::-1].index(name)
            kind = f"((k < {last}U) ? DECOUPLER_BAD_{name} : {kind})"
        count = len(kinds) - kinds.count("ZEROS")
        places = ["NUMBERS"] * (count > 0) + ["ZEROS_LESS"] * (count < len(kinds))
        return {
            "number": C_TYPES[numbers[0].values.dtype.str[1:]], "first": numbers[0].name,
            "limits_to": 4 * count, "kind": kind,
            "place": places[0] if len(places) == 1 else f"((k < {count}U) ? NUMBERS : ZEROS_LESS)",
            "listed": [f"{{{', '.join(self.ends_in_c(e))}}}, /* {e.name} */" for e in numbers],
        }  # fmt: skip

    def _any(self, entry: Stored) -> bool:
        """Whether an entry may be any number."""
        return not self._just_outside(entry.name)

    def _found_bad_by(self, entry: Stored) -> str:
        """Return the finding of a number beyond its ends."""
        limit = entry.name in {e.name for e in self.decoupler.limits}
        return "ZEROS" if entry in self.offsets else "LIMITS" if limit else "NUMBER"

    def ends_in_c(self, entry: Stored) -> list[str]:
        """Return the least and the greatest value of an entry in C."""
        own = float if entry.values.dtype.kind == "f" else int
        return [self._literal(own(end)) for end in self.accepted[entry.name]]

    def faults(self) -> Iterator[tuple[list[str], str]]:
        """Yield changes of a table in C, and what `decoupler_check()` finds then, separated by blanks.

        Each table is sealed with new CRC, so that the test behind the CRC has to find the fault.
        """
        d, version, layout = self.decoupler, "table.version += 1U;", "table.layout ^= 1U;"
        yield [version], "VERSION"
        yield [layout], "LAYOUT"
        yield ["table.length += 4U;"], "LAYOUT"
        yield ["table.calibration[0] ^= 1U;"], ""
        yield [version, layout], "VERSION LAYOUT"
        for e in self.entries:
            place = f"table.{e.name}[{len(e.values) - 1}]" if e.values.ndim else f"table.{e.name}"
            fault, outside = self._found_bad_by(e), self._just_outside(e.name)
            yield from (([f"{place} = {value};"], fault) for value in outside)
            if outside and fault != "LIMITS":
                yield from (([f"{place} = {value};"], "") for value in self.ends_in_c(e))
        values = {e.name: e.values.item() for e in self.numbers}
        zero = self._literal(0 * self.offsets[0].values.item())
        swapped: list[list[str]] = []
        for column in self.limited:  # an empty range, one of a single value, one of 0 and -0
            limit, low, high = (f"{side}_{short(column)}" for side in ("limit", "low", "high"))
            if d.box.symmetric(column):
                swapped.append([f"table.{limit} = -decoupler_params.{limit};"])
                for value in (f"-decoupler_params.{limit}", zero, f"-{zero}"):
                    yield [f"table.{limit} = {value};"], "LIMITS"
            else:
                changes = [
                    f"table.{low} = decoupler_params.{high};",
                    f"table.{high} = decoupler_params.{low};",
                ]
                yield changes, "LIMITS"
                swapped.append(changes[::-1])
                least, greatest = self.accepted[low]
                yield changes[:1], "" if least <= values[high] <= greatest else "LIMITS"
        beyond = [f"table.{e.name} = {v};" for e in self.offsets for v in self._just_outside(e.name)][:1]
        kinds = ["VERSION"] + ["ZEROS"] * len(beyond) + ["LIMITS"] * bool(swapped)  # each has its own bit
        yield [version, *beyond, *(swapped[0] if swapped else ())], " ".join(kinds)

    def _templates(self) -> dict[str, str]:
        """Return the template of each file; EVA is for code whose results it can see."""
        found = dict(tree(self.type))
        if not self.decoupler.evident:
            del found["proof/eva.c"]
        return found


def _record(k: int, port: Port) -> dict[str, Any]:
    cast = "(uint32_t)" if port.type == "uint32_t" else ""
    shown = {"column": commented(port.column), "name": short(port.column)}
    return {**vars(port), **shown, "number": k + 1, "index": k, "cast": cast}


def listed(values: np.ndarray) -> str:
    """Return numbers of the model in C, with 13 digits."""
    return ", ".join(f"{v:.12e}" for v in values)


def _small(value: float, column: str) -> str:
    return f"{value * 1e9:.3g} n{unit(column)}" if value > 1e-13 else f"{value:.2g} {unit(column)}"


def ends(d: Decoupler, column: str) -> tuple[str, str]:
    """Return the C text of the ends of an input's range."""
    name = short(column)
    if d.box.symmetric(column):
        return f"-p->limit_{name}", f"p->limit_{name}"
    return f"p->low_{name}", f"p->high_{name}"


def of_params(text: str) -> str:
    """Return C with the entries taken from the constant table."""
    return text.replace("p->", "decoupler_params.")


def bit(column: str) -> str:
    """Return the name of an input's status bit."""
    return status_bit(short(column).upper())


def _joined(entries: Sequence[Stored]) -> bytes:
    return b"".join(entry.values.tobytes() for entry in entries)


def _si(values: np.ndarray, ports: Sequence[Port]) -> np.ndarray:
    """Return numbers of an arithmetic (n, s) in SI."""
    return values.astype(float) * np.array([[port.scale] for port in ports])
