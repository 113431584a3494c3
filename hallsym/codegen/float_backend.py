"""The decoupler in float or double."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar
from zlib import crc32

import casadi as ca
import numpy as np

from hallsym.codegen.backend import (
    COUNT,
    REFERENCE,
    VERSION,
    Backend,
    Stored,
    bit,
    ends,
    mix,
    of_params,
)
from hallsym.codegen.bounds import LEAST_GAIN, Bounds, pose_bounds, slope_errors, spreads
from hallsym.codegen.cost import firmware_cost
from hallsym.codegen.entries import Entry, short, unit
from hallsym.codegen.float_c import Real, shared_statements, statements, straight
from hallsym.codegen.gappa import gappa
from hallsym.codegen.templates import lines_of
from hallsym.model.arrays import on_arrays

M4 = "-mcpu=cortex-m4 -mthumb"
FPU = {4: "-mfloat-abi=hard -mfpu=fpv4-sp-d16", 8: "-mfloat-abi=soft"}
"""Compiler options of a Cortex-M4F by bytes of a number; its unit has no double."""
MOST_STEPS = 20
"""Steps of the arithmetic that the report lists."""


@dataclass(frozen=True, eq=False)
class FloatBackend(Backend):
    """IEEE 754 leaves no freedom to +, -, *, / and comparisons that round to nearest one by one: numpy computes
    the same bits as C. `jacobian` adds d pose / d reading.
    """

    real: Real
    jacobian: bool = False

    tree: ClassVar[str] = "float"
    hashed: ClassVar[tuple[int, int]] = (4096, 1_000_000)
    outside: ClassVar[str] = "outside its range, or not finite"

    # -- the arithmetic ------------------------------------------------------------------------------------

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
        return {c: error + self.decoupler.slack for c, error in self.bounds.error.items()}

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """As the table holds them."""
        low, high = np.array([self.decoupler.ends(c) for c in self.decoupler.inputs]).T.astype(
            self.real.dtype
        )
        return low[:, None], high[:, None]

    @property
    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """As they are given, not rounded."""
        low, high = np.array([self.decoupler.ends(c) for c in self.decoupler.inputs]).T
        return low[:, None], high[:, None]

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return self.decoupler.on_arrays(self.real.dtype)

    def run(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Operation by operation."""
        dtype = self.real.dtype
        constants: list[np.ndarray] = [np.array([c], dtype=dtype) for c in self.decoupler.constants]
        with np.errstate(under="ignore"):
            pose, *seen = self._run(held.astype(dtype), constants)
        flags = self.decoupler.raised(seen[0].astype(dtype), dtype) if seen else np.uint32(0)
        return pose.astype(dtype), np.asarray(flags)

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

    def words(self, pose: np.ndarray) -> np.ndarray:
        """The bits themselves, or both halves of a double."""
        if self.real.size == 4:
            return pose.view(np.uint32)
        bits = pose.view(np.uint64)
        return np.asarray((bits >> np.uint64(32)).astype(np.uint32) ^ mix(bits.astype(np.uint32)))

    def rounded(self, inputs: np.ndarray) -> np.ndarray:
        """To nearest."""
        return inputs.astype(self.real.dtype)

    def si(self, values: np.ndarray, columns: Sequence[str]) -> np.ndarray:
        """They are SI."""
        return values.astype(float)

    def chosen(self) -> np.ndarray:
        """Return corners and points of the box, and inputs that are out of range or not finite."""
        low, high = (side[:, 0] for side in self.ends)
        rng, dtype = np.random.default_rng(1), self.real.dtype
        share = np.hstack([np.zeros((len(low), 1)) + 0.5, rng.random((len(low), COUNT - 1))])
        share[:, 1:9] = rng.choice([0.0, 1.0], (len(low), 8))
        inside = (low[:, None] + (high - low)[:, None] * share).astype(dtype)
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

    def _stored(self, entries: Sequence[Entry]) -> list[Stored]:
        return [
            Stored(e.name, np.array(e.value, self._dtype), f"[{e.unit}] {e.meaning}", e.unit) for e in entries
        ]

    @property
    def _dtype(self) -> np.dtype:
        return np.dtype(self.real.dtype).newbyteorder("<")

    @cached_property
    def coefficients(self) -> Sequence[Stored]:
        """Coefficients and limits."""
        return self._stored((*self.decoupler.table, *self.decoupler.limits))

    @cached_property
    def rows(self) -> Sequence[Stored]:
        """Arrays, of numbers or of 16-bit integers."""
        return [
            Stored(
                a.name,
                np.array(a.values, "<i2" if a.integers else self._dtype),
                f"[{a.unit}] {a.meaning}",
                a.unit,
            )
            for a in self.decoupler.arrays
        ]

    @cached_property
    def zeros(self) -> Sequence[Stored]:
        """One of each pose coordinate."""
        return self._stored(self.decoupler.zeros)

    @property
    def head(self) -> tuple[tuple[str, int], ...]:
        """One more word before doubles, which begin at a multiple of 8 bytes."""
        return (*super().head, ("reserved", 0)) if self.real.size == 8 else super().head

    @cached_property
    def layout(self) -> int:
        """Of names, units and statements."""
        d = self.decoupler
        lines = [f"{VERSION} {self.type}"]
        lines += [f"{e.name} {e.unit}" for e in d.entries]
        lines += [f"{a.name}[{len(a.values)}] {a.unit} {a.integers}" for a in d.arrays]
        lines += statements([replace(step, remark="") for step in d.steps], {}, self.real, {})
        return crc32("\n".join(lines).encode())

    def json_of_table(self) -> dict[str, Any]:
        """Numbers as they are stored, in SI."""
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

    # -- C -------------------------------------------------------------------------------------------------

    def literal(self, value: Any) -> str:
        """Digits that are read back as the same number; integers of a row as they are."""
        return str(value) if isinstance(value, int) else self.real.constant(value)

    def c_type(self, column: str) -> str:
        """All have the same."""
        return self.type

    def note(self, column: str) -> str:
        """SI."""
        return f"[{unit(column)}]"

    def input_note(self, column: str) -> str:
        """Unit and kind."""
        kind = "reading" if column in self.decoupler.model.channels else "measured state"
        return f"{self.note(column)} {kind}"

    def any_value(self, column: str) -> str:
        """Any bits, NaN and infinity among them."""
        return f"nondet_{self.type}()"

    def outer(self, column: str) -> tuple[str, str] | None:
        """A little beyond its bounds."""
        low, high = (float(np.float32(v[column] * 1.0001)) for v in (self.bounds.low, self.bounds.high))
        return tuple(self.literal(v + (1e-12 if v > 0 else -1e-12)) for v in (low, high))  # type: ignore[return-value]

    def by_size(self, column: str) -> bool:
        """State columns are tested by size, readings end by end: fewest instructions, typical and worst."""
        return column in self.decoupler.model.state and self.decoupler.box.symmetric(column)

    @cached_property
    def names(self) -> dict[str, str]:
        """C text of each table entry."""
        return {e.name: f"p->{e.name}" for e in self.decoupler.entries}

    def _held(self, used: ca.SX | None = None) -> list[str]:
        """Bring the inputs into their range; of those that are not `used` only the status counts."""
        d, lines = self.decoupler, []
        for c in d.inputs:
            low, high = ends(d, c)
            call = f"limited(in->{c}, {low}, {high}, {bit(c)}, &status);"
            if self.by_size(c):
                call = f"within(in->{c}, {high}, {bit(c)}, &status);"
            needed = used is None or ca.depends_on(used, d.symbols[c])
            lines.append(f"const {self.type} {short(c)} = {call}" if needed else f"(void){call}")
        return lines

    def summary(self) -> dict[str, Any]:
        """CRC of the table, and how near to zero gains come."""
        return {"crc32": f"0x{self.crc:08x}", "least_gain": dict(self.bounds.least_gain)}

    def files(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, str | bytes]:
        """Not in double: the trial of all bit patterns, of which there are too many, and Gappa's script."""
        made = super().files(errors, notes)
        if self.real.size == 8:
            del made["proof/exhaustive.c"]
        elif straight(self.decoupler.steps):
            made["proof/rounding.g"] = gappa(self.decoupler, self.real, self.bounds)
        return made

    def fields(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        """Fields of header, step, check, self-test, proofs and report."""
        real = self.real
        common = {
            "real": self.type, "fabs": real.fabs, "zero": real.constant(0.0), "all_nan": ", all NaN", "shifts": [],
            "cpu": f"{M4} {FPU[real.size]}", "machine": "mps2-an386",
            "that_the_model_gives": "that the model gives", "nan_included": ", NaN and infinity included",
            "nondet": f"{self.type} nondet_{self.type}",
        }  # fmt: skip
        parts = (self._header(), self._step(common), self._check(), self._selftest(), self._main())
        for part in (*parts, self._count(), self._proofs(common), self._report(errors, notes)):
            common |= part
        return common

    def _header(self) -> dict[str, Any]:
        d = self.decoupler

        def units(columns: Sequence[str], between: str = ", ") -> str:
            return between.join(dict.fromkeys(map(unit, columns)))

        slopes = [
            f"{self.type} {short(c)}_{short(m)}; /**< [{unit(c)}/{unit(m)}] d {c} / d {m} */"
            for c in d.pose
            for m in d.model.channels
        ]
        flags = ", ".join(f"DECOUPLER_{f.name}" for f in d.flags)
        return {
            "probes": len(d.model.channels),
            "all_units": units((*d.inputs, *d.pose), " and "),
            "reading_units": units(d.model.channels),
            "state_units": f" and state [{units(d.model.state)}]" if d.model.state else "",
            "pose_units": units(d.pose),
            "said": [f" * {line}" for text in d.said for line in textwrap.wrap(text, 110)],
            "known": ", ".join(dict.fromkeys(f"{d.known(c):.6g} {unit(c)}" for c in d.pose)),
            "least_gain": f"{LEAST_GAIN:g}",
            "and_flags": [f" *         (and {flags})"] if flags else [],
            "jacobian_type": self._with_jacobian("jacobian_type.h", {"slope_members": slopes}),
            "jacobian_function": self._with_jacobian("jacobian.h", {}),
        }

    def _with_jacobian(self, fragment: str, fields: Mapping[str, Any]) -> list[str]:
        return lines_of(f"float/fragments/{fragment}", fields) if self.jacobian else []

    def _step(self, common: Mapping[str, Any]) -> dict[str, Any]:
        d, real = self.decoupler, self.real
        results = {s.name: f"out->{c}" for s, c in zip(d.steps[-len(d.pose) :], d.pose, strict=True)}
        body = statements(d.steps, self.names, real, results)
        used = [c for c in d.inputs if ca.depends_on(d.folded, d.symbols[c])]
        flags = [
            line
            for f in d.flags
            for line in (f"if (!({f.step} >= p->{f.least}))", "{", f"    status |= DECOUPLER_{f.name};", "}")
        ]
        most = {c: real.constant(d.known(c)) for c in d.pose}
        known = [f"((pose->{c} >= -{most[c]}) && (pose->{c} <= {most[c]}))" for c in d.pose]
        slopes: list[str] = []
        if self.jacobian:
            flat = ca.vertcat(*d.slopes.values())
            slopes = [
                *self._held(flat),
                *shared_statements(flat, self.names, real, [f"slopes->{n}" for n in d.slopes]),
            ]
        within = any(self.by_size(c) for c in d.inputs)
        return {
            "within": lines_of("float/fragments/within.c", common) if within else [],
            "held": self._held(d.folded),
            "body": body,
            "flags": flags,
            "jacobian": self._with_jacobian("jacobian.c", {"slopes": slopes}),
            "known_within": "\n        && ".join(known),
            "take_zero": self._take_zero(),
            "bare_includes": ["#include <math.h>", ""]
            if any(f"{real.fabs}(" in line for line in body)
            else [],
            "bare_helpers": [],
            "bare_body": [
                *(f"const {self.type} {short(c)} = in->{c};" for c in used),
                *body,
                *(f"(void){flag.step};" for flag in d.flags),
            ],
        }

    def _take_zero(self) -> list[str]:
        """The zero from the decoupled pose, or, of a non-linear model, from the steps at the known pose."""
        d, t = self.decoupler, self.type
        zeros = [(short(c), c, f"p->{z.name}") for c, z in zip(d.pose, d.zeros, strict=True)]
        if not d.at_pose:
            return lines_of("float/fragments/take_zero.c", {
                "before": [f"const {t} before_{name} = {z};" for name, _, z in zeros],
                "clear": [f"{z} = {self.literal(0.0)};" for _, _, z in zeros],
                "add_zeros": [f"{z} = pose->{c} - seen.{c};" for _, c, z in zeros],
                "restore": [f"{z} = before_{name};" for name, _, z in zeros],
            })  # fmt: skip
        seen = [s.name for s in d.at_pose[-len(d.pose) :]]
        return [
            "status = 0U;",
            *self._held(),
            *(f"const {t} {name} = pose->{c};" for name, c, _ in zeros),
            *statements(d.at_pose, self.names, self.real, {}),
            "if (status == 0U)",
            "{",
            *(f"    {z} = pose->{c} - {s};" for (_, c, z), s in zip(zeros, seen, strict=True)),
            "}",
        ]

    def _check(self) -> dict[str, Any]:
        d, real, names = self.decoupler, self.real, self.names
        zero, share = real.constant(0.0), real.constant(round(1 - LEAST_GAIN, 6))
        gains = spreads(d)
        filled = [
            f"({high} >= {zero})" if d.box.symmetric(c) else f"({low} <= {high})"
            for c in d.inputs
            for low, high in [ends(d, c)]
        ]
        remain = [
            f"({s.name} < ({share} * greater({names[m.rest]}, -{names[m.rest]})))"
            for s, m in zip(gains, d.margins, strict=True)
        ]
        finite = [f"bad += not_finite(p->{e.name});" for e in d.entries]
        for a in d.arrays:
            if not a.integers:
                finite += [f"for (uint32_t k = 0U; k < {len(a.values)}U; k++)", "{"]
                finite += [f"    bad += not_finite(p->{a.name}[k]);", "}"]
        return {
            "most": "FLT_MAX" if real.size == 4 else "DBL_MAX",
            "spreads": statements(gains, names, real, {}),
            "not_empty": "\n        && ".join(filled),
            "gains_remain": "\n        && ".join(remain),
            "not_finite": finite,
        }

    # -- self-test -----------------------------------------------------------------------------------------

    def _selftest(self) -> dict[str, Any]:
        d, real, found = self.decoupler, self.real, self.vectors
        width = len(d.pose) + 1
        sample = [
            f"in->{c} = input(n, {k}U, {low}, {high});"
            for k, c in enumerate(d.inputs, 1)
            for low, high in [of_params(*ends(d, c))]
        ]
        words = [
            f"total += mix(word(out.{c}) ^ mix((n * {width}U) + {k}U));" for k, c in enumerate(d.pose, 1)
        ]
        compare = [
            f"failed |= differs(out.{c}, wanted->pose[{k}], decoupler_bounds[{k}], &result.worst);"
            for k, c in enumerate(d.pose)
        ]
        slopes, slope_bounds = self._slopes() if self.jacobian else (found.pose, [])
        rows = []
        for k in range(found.inputs.shape[1]):
            inputs = ", ".join(self._input(float(v)) for v in found.inputs[:, k])
            slope = f"{{{_listed(slopes[:, k])}}}, " if self.jacobian else ""
            rows.append(
                f"{{{{{inputs}}}, {{{_listed(found.pose[:, k])}}}, {slope}0x{int(found.status[k]):X}UL}},"
            )
        if self.jacobian:
            compare.append("failed |= (status == wanted->status) ? 0U : 1U;")
            compare += [
                f"failed |= differs(slopes.{name}, wanted->slopes[{k}], decoupler_slope_bounds[{k}], &slope_worst);"
                for k, name in enumerate(d.slopes)
            ]
        size = "float" if real.size == 4 else "double"
        return {
            "word": lines_of(f"float/fragments/word_{size}.c", {}),
            "wild": lines_of(f"float/fragments/wild_{size}.c", {}),
            "scale": real.constant(2.0**-24),
            "four": real.constant(4.0),
            "sample": sample,
            "words": words,
            "compare": compare,
            "slope_field": [f"double slopes[{len(d.slopes)}];"] if self.jacobian else [],
            "slope_step": self._with_jacobian("slope_step.c", {}),
            "slope_bounds": slope_bounds,
            "vector_includes": ["#include <math.h>", ""],
            "bounds": ", ".join(f"{error + REFERENCE:.3e}" for error in self.error_bound.values()),
            "rows": rows,
        }

    def _slopes(self) -> tuple[np.ndarray, list[str]]:
        """Return the slopes (n_slopes, s) of the vectors in double, and the line of their bounds."""
        d = self.decoupler
        given = [ca.vertcat(*(d.symbols[n] for n in d.inputs))]
        given.append(ca.vertcat(*(d.symbols[e.name] for e in (*d.table, *d.zeros))))
        run = on_arrays(ca.Function("slopes", given, [ca.vertcat(*d.slopes.values())]))
        slopes = run(list(self.vectors.held), d.constants)[0]
        errors = slope_errors(d, self.real.digits).values()
        # the reference is computed in double and written with 13 digits
        limits = [error + 1e-12 * np.abs(row).max() for error, row in zip(errors, slopes, strict=True)]
        listed = ", ".join(f"{limit:.3e}" for limit in limits)
        return slopes, [f"static const double decoupler_slope_bounds[{len(limits)}] = {{{listed}}};"]

    def _input(self, value: float) -> str:
        cast = "" if self.real.size == 4 else "(double)"  # math.h has them as float
        if np.isnan(value):
            return f"{cast}NAN"
        if np.isinf(value):
            return f"{'' if value > 0 else '-'}{cast}INFINITY"
        return self.literal(value)

    def _main(self) -> dict[str, Any]:
        d, c = self.decoupler, self.real.constant
        rest = [c(value) for value in d.rest] or ["at_rest"] * len(d.inputs)
        return {
            "near": c(1e-9),
            "at_rest": [] if d.rest else [f"const {self.type} at_rest = {c(2.0**-14)};"],
            "at_known": c(2.0**-12),
            "rest": [f"in.{column} = {value};" for column, value in zip(d.inputs, rest, strict=True)],
            "pose_at_known": [f"pose.{column} = at_known;" for column in d.pose],
            "not_back": " || ".join(f"(near(out.{column}, at_known) == 0)" for column in d.pose),
            "first_input": d.inputs[0],
            "first_rest": rest[0],
            "first_pose": d.pose[0],
            "too_large": c(1e30),
            "too_far": c(2.0 * d.known(d.pose[0])),
        }

    def _count(self) -> dict[str, Any]:
        """Inputs in the box, all above, all below, above and below in turn, all NaN."""
        d = self.decoupler
        low, high = np.array([d.ends(c) for c in d.inputs]).T
        above, below = high + 2 * np.abs(high - low), low - 2 * np.abs(high - low)
        turn = np.where(np.arange(len(low)) % 2, below, above)
        rows = [0.5 * (low + high) + 0.2 * (high - low), above, below, turn, np.full(len(low), np.nan)]
        slopes = "(void)decoupler_jacobian(&decoupler_params, &in[k], &slopes);"
        return {
            "count_includes": ["#include <math.h>", ""],
            "calls": len(rows),
            "called_with": [f"{{{', '.join(self._input(float(v)) for v in row)}}}," for row in rows],
            "count_slopes": ["decoupler_jacobian_t slopes;"] if self.jacobian else [],
            "call_slopes": [slopes] if self.jacobian else [],
        }

    # -- proofs and report ---------------------------------------------------------------------------------

    def _proofs(self, common: Mapping[str, Any]) -> dict[str, Any]:
        """Drivers of Frama-C EVA and of the trial of every bit pattern through the range test.

        The range test is all that stands between an input and the arithmetic: with the interval bounds it shows
        that outputs are finite and bounded and that status is 0 iff inputs are in the box.
        """
        d, t = self.decoupler, self.type
        box = {c: of_params(*ends(d, c)) for c in d.inputs}
        tests = [
            f"bad += all_within({high});" if self.by_size(c) else f"bad += all_limited({low}, {high});"
            for c, (low, high) in box.items()
        ]
        forms = {
            "within": (f"{t} high", [f"const {t} low = -high;"], "high, 1U, &status"),
            "limited": (f"{t} low, {t} high", [], "low, high, 1U, &status"),
        }
        every = [
            line
            for by, (parameters, declared, arguments) in forms.items()
            if any(f"all_{by}(" in test for test in tests)
            for line in lines_of("float/fragments/every.c", {
                **common, "by": by, "parameters": parameters, "declared": declared, "arguments": arguments,
            })
        ]  # fmt: skip
        bounded = [
            f"//@ assert {short(c)}_bounded: {low} <= out.{c} <= {high};"
            for c in d.pose
            for low, high in filter(None, [self.outer(c)])
        ]
        interval = f"Frama_C_{t}_interval"
        return {
            "in_the_box": [f"in.{c} = {interval}({low}, {high});" for c, (low, high) in box.items()],
            "pose_asserted": bounded,
            "eva_slopes": self._with_jacobian("eva_slopes.c", {}),
            "every": every,
            "range_tests": tests,
        }

    def _report(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        d, found, work = self.decoupler, self.bounds, firmware_cost(self.decoupler)
        box = [f"| {c} | {low:.6g} | {high:.6g} | {unit(c)} |" for c in d.inputs for low, high in [d.ends(c)]]
        outputs = [
            f"| {c} | {found.low[c]:.6g} | {found.high[c]:.6g} | {_small(self.error_bound[c], c)} | "
            f"{_small(errors[c], c)} |"
            for c in d.pose
        ]
        arithmetic = [f"    {s.name} = {s.expression}" for s in d.steps]
        if len(d.steps) > MOST_STEPS:
            arithmetic = [f"    {len(d.steps)} steps, see src/decoupler.c"]
        return {
            "notes": "\n".join(f"- {note}" for note in (*d.said, *notes)),
            "box": box,
            "outputs": outputs,
            "least_gains": [f"| {c} | {share:.4f} |" for c, share in found.least_gain.items()],
            "arithmetic": arithmetic,
            "operations": work.operations,
            "moves": work.moves,
            "instructions": work.instructions,
        }


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{v:.12e}" for v in values)


def _small(value: float, column: str) -> str:
    return f"{value * 1e9:.3g} n{unit(column)}" if value > 1e-13 else f"{value:.2g} {unit(column)}"
