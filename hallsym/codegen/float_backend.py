"""The files of a decoupler in float or double."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.arithmetic import Port
from hallsym.codegen.backend import bit, ends
from hallsym.codegen.bounds import LEAST_GAIN, slope_errors, spreads
from hallsym.codegen.cost import firmware_cost
from hallsym.codegen.entries import short, unit
from hallsym.codegen.float_arithmetic import FloatArithmetic
from hallsym.codegen.float_c import shared_statements, statements, straight
from hallsym.codegen.gappa import gappa
from hallsym.codegen.templates import lines_of
from hallsym.model.arrays import on_arrays

M4 = "-mcpu=cortex-m4 -mthumb"
FPU = {4: "-mfloat-abi=hard -mfpu=fpv4-sp-d16", 8: "-mfloat-abi=soft"}
"""Compiler options of a Cortex-M4F by bytes of a number; its unit has no double."""
MOST_STEPS = 20
"""Steps of the arithmetic that the report lists."""
FRAGMENTS = "float/fragments/"


@dataclass(frozen=True, eq=False)
class FloatBackend(FloatArithmetic):
    """Prints the files of one decoupler in float or double."""

    def _templates(self) -> dict[str, str]:
        """Not all bit patterns of a double can be tried, and EVA is for code whose results it can see."""
        found = super()._templates()
        if not self.decoupler.evident:
            del found["proof/eva.c"]
        if self.real.size == 8:
            del found["proof/exhaustive.c"]
        return found

    def files(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, str | bytes]:
        """Return the files; Gappa's script is for float without branches."""
        made = super().files(errors, notes)
        if self.real.size == 4 and straight(self.decoupler.steps):
            made["proof/rounding.g"] = gappa(self.decoupler, self.real, self.bounds)
        return made

    def _of_input(self, port: Port) -> dict[str, Any]:
        d, c = self.decoupler, port.column
        kind = "reading" if c in d.model.channels else "measured state"
        return {"kind": kind, "rest": self._literal(d.rest[d.inputs.index(c)]) if d.rest else "at_rest"}

    def _of_output(self, port: Port) -> dict[str, Any]:
        if self.decoupler.drawn is not None:  # of readings of no pose nothing is claimed
            return {}
        low, high = (side[port.column] for side in (self.bounds.low, self.bounds.high))
        return {"outer_low": self._beyond(low), "outer_high": self._beyond(high)}

    def _beyond(self, value: float) -> str:
        """A literal a little beyond a bound."""
        return self._literal(float(np.float32(value * 1.0001)) + (1e-12 if value > 0 else -1e-12))

    def _fields(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        d, c = self.decoupler, self.real.constant
        work = firmware_cost(d)
        common = {
            "real": self.type,
            "fabs": self.real.fabs,
            "zero": c(0.0),
            "out": self._outputs(errors),
            "in": self._inputs(),
            "slope": self._slope_records(),
            # build files
            "all_nan": ", all NaN",
            "shifts": [],
            "cpu": f"{M4} {FPU[self.real.size]}",
            "machine": "mps2-an386",
            # proofs
            "nan_included": ", NaN and infinity included",
            "any": self.type,
            "any_type": self.type,
            "eva_slopes": self._if_jacobian("eva_slopes.c"),
            # report
            "notes": "\n".join(f"- {note}" for note in (*d.said, *notes)),
            "gain": [{"column": c, "share": f"{v:.4f}"} for c, v in self.bounds.least_gain.items()],
            "arithmetic": self._arithmetic(),
            "operations": work.operations,
            "moves": work.moves,
            "instructions": work.instructions,
        }
        parts = (self._header(common), self._step(common), self._check(), self._selftest(), self._count())
        for part in (*parts, self._range_tests(common)):
            common |= part
        return common

    def _if_jacobian(self, fragment: str, fields: Mapping[str, Any] | None = None) -> list[str]:
        return lines_of(FRAGMENTS + fragment, fields or {}) if self.jacobian else []

    def _slope_records(self) -> list[dict[str, Any]]:
        d = self.decoupler
        if not self.jacobian:
            return []
        pairs = [(c, m) for c in d.pose for m in d.model.channels]
        return [
            {"name": name, "index": k, "unit": f"{unit(c)}/{unit(m)}", "of": c, "by": m}
            for k, (name, (c, m)) in enumerate(zip(d.slopes, pairs, strict=True))
        ]

    def _arithmetic(self) -> list[str]:
        steps = self.decoupler.steps
        if len(steps) > MOST_STEPS:
            return [f"    {len(steps)} steps, see src/decoupler.c"]
        return [f"    {s.name} = {s.expression}" for s in steps]

    # -- header, step, check -------------------------------------------------------------------------------

    def _header(self, common: Mapping[str, Any]) -> dict[str, Any]:
        d = self.decoupler

        def units(columns: Sequence[str], between: str = ", ") -> str:
            return between.join(dict.fromkeys(map(unit, columns)))

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
            "jacobian_type": self._if_jacobian("jacobian_type.h", common),
            "jacobian_function": self._if_jacobian("jacobian.h"),
        }

    def by_size(self, column: str) -> bool:
        """State columns are tested by size, readings end by end: fewest instructions, typical and worst.

        Readings by size where the decoupler says so.
        """
        d = self.decoupler
        return (d.by_size or column in d.model.state) and d.box.symmetric(column)

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

    def _step(self, common: Mapping[str, Any]) -> dict[str, Any]:
        d, real = self.decoupler, self.real
        names = {e.name: f"p->{e.name}" for e in d.entries}
        results = {s.name: f"out->{c}" for s, c in zip(d.steps[-len(d.pose) :], d.pose, strict=True)}
        body = statements(d.steps, names, real, results)
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
            slopes = self._held(flat)
            slopes += shared_statements(flat, names, real, [f"slopes->{n}" for n in d.slopes])
        within = any(map(self.by_size, d.inputs))
        iterated = {"all_held": self._held(), "at_pose": statements(d.at_pose, names, real, {})}
        zero = "take_zero_iterated.c" if d.at_pose else "take_zero.c"
        return {
            "within": lines_of(f"{FRAGMENTS}within.c", common) if within else [],
            "held": self._held(d.folded),
            "body": body,
            "flags": flags,
            "jacobian": self._if_jacobian("jacobian.c", {"slopes": slopes}),
            "known_within": "\n        && ".join(known),
            "take_zero": lines_of(FRAGMENTS + zero, {**common, **iterated}),
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

    def _check(self) -> dict[str, Any]:
        d, real = self.decoupler, self.real
        zero, share = real.constant(0.0), real.constant(round(1 - LEAST_GAIN, 6))
        gains, sides = spreads(d), {c: ends(d, c) for c in d.inputs}
        filled = [
            f"({high} >= {zero})" if d.box.symmetric(c) else f"({low} <= {high})"
            for c, (low, high) in sides.items()
        ]
        remain = [
            f"({s.name} < ({share} * greater(p->{m.rest}, -p->{m.rest})))"
            for s, m in zip(gains, d.margins, strict=True)
        ]
        finite: list[str] = []
        for a in d.arrays:
            if not a.integers:
                finite += [f"for (uint32_t k = 0U; k < {len(a.values)}U; k++)", "{"]
                finite += [f"    bad += not_finite(p->{a.name}[k]);", "}"]
        return {
            "most": "FLT_MAX" if real.size == 4 else "DBL_MAX",
            "spreads": statements(gains, {e.name: f"p->{e.name}" for e in d.entries}, real, {}),
            "not_empty": "\n        && ".join(filled),
            "gains_remain": "\n        && ".join(remain),
            "rows_finite": finite,
        }

    # -- self-test and proofs ------------------------------------------------------------------------------

    def _selftest(self) -> dict[str, Any]:
        d, found, c = self.decoupler, self.vectors, self.real.constant
        slopes, slope_bounds = self._slopes() if self.jacobian else (found.pose, [])
        rows = []
        for k in range(found.inputs.shape[1]):
            inputs = ", ".join(self._input(float(v)) for v in found.inputs[:, k])
            slope = f"{{{_listed(slopes[:, k])}}}, " if self.jacobian else ""
            rows.append(
                f"{{{{{inputs}}}, {{{_listed(found.pose[:, k])}}}, {slope}0x{int(found.status[k]):X}UL}},"
            )
        status = "failed |= (status == wanted->status) ? 0U : 1U;"
        size = "float" if self.real.size == 4 else "double"
        return {
            "that_the_model_gives": "that the model gives",
            "vector_includes": ["#include <math.h>", ""],
            "slope_bounds": slope_bounds,
            "rows": rows,
            "word": lines_of(f"{FRAGMENTS}word_{size}.c", {}),
            "wild": lines_of(f"{FRAGMENTS}wild_{size}.c", {}),
            "scale": c(2.0**-24),
            "four": c(4.0),
            "slope_field": [f"double slopes[{len(d.slopes)}];"] if self.jacobian else [],
            "slope_step": self._if_jacobian("slope_step.c"),
            "slope_status": [status] if self.jacobian else [],
            "near": c(1e-9),
            "at_rest": [] if d.rest else [f"const {self.type} at_rest = {c(2.0**-14)};"],
            "at_known": c(2.0**-12),
            "not_back": " || ".join(f"(near(out.{column}, at_known) == 0)" for column in d.pose),
            "first_input": d.inputs[0],
            "first_rest": c(d.rest[0]) if d.rest else "at_rest",
            "first_pose": d.pose[0],
            "too_large": c(1e30),
            "too_far": c(2.0 * d.known(d.pose[0])),
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
        return self._literal(value)

    def _count(self) -> dict[str, Any]:
        """Inputs in the box, all above, all below, above and below in turn, all NaN."""
        low, high = (side[:, 0] for side in self.span)
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

    def _range_tests(self, common: Mapping[str, Any]) -> dict[str, Any]:
        """The trial of every bit pattern of an input through its range test.

        That is all that stands between an input and the arithmetic: with the interval bounds it shows that
        outputs are finite and bounded and that status is 0 iff inputs are in the box.
        """
        t, forms = self.type, {}
        if any(map(self.by_size, self.decoupler.inputs)):
            forms["within"] = (f"{t} high", [f"const {t} low = -high;"], "high, 1U, &status")
        if not all(map(self.by_size, self.decoupler.inputs)):
            forms["limited"] = (f"{t} low, {t} high", [], "low, high, 1U, &status")
        every: list[str] = []
        for by, (parameters, declared, arguments) in forms.items():
            fields = {"by": by, "parameters": parameters, "declared": declared, "arguments": arguments}
            every += lines_of(f"{FRAGMENTS}every.c", {**common, **fields})
        tests = [
            f"bad += all_within({i['greatest']});"
            if self.by_size(i["column"])
            else f"bad += all_limited({i['least']}, {i['greatest']});"
            for i in common["in"]
        ]
        return {"every": every, "range_tests": tests}


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{v:.12e}" for v in values)
