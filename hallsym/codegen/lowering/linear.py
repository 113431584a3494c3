"""Decoupler of models whose readings are gain * displacement + offset: few steps over few table entries.

With the gain of probe k as eta_k phi_k, phi_k = 1 + small terms, and displacement = M pose + h(pose, state),
the reading m gives

    pose = zero + D (m' - eta h),   m'_k = (m_k - offset_k) / phi_k,   D = (M^T W M)^-1 M^T W diag(1 / eta)

which for the small-angle stage (h = 0) is Eq. (31) of Chen et al., doi:10.3390/s16060872, with its zero
deviations in `zero` = -D delta'. Where h depends on the pose the last line is iterated. One entry of D per
probe is folded into its gain, phi_k / D_ik, so that column k of D holds a 1: one product and one rounding
less.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box, limits
from hallsym.codegen.decoupler import Decoupler, Margin, Step
from hallsym.codegen.entries import Entry, per, short, unit
from hallsym.codegen.lowering.anatomy import Anatomy
from hallsym.codegen.lowering.polynomials import Polynomial, Row
from hallsym.errors import InputError
from hallsym.model import Model


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Decoupler:
    """Return the decoupler of a model at parameters `p` over a box (readings are added where it has none).

    `weight`: 1 / variance of each reading, for more channels than pose coordinates.
    """
    if not model.symbols.displacement.numel():
        raise InputError(
            f"C is generated for readings gain * displacement + offset; model {model.name} has none of that "
            "form, and its family brings no decoupler of its own."
        )
    return _Assembly(Anatomy(model, box), p, weight).make()


@dataclass(eq=False)
class _Assembly:
    """Collects entries, symbols and steps of one calibration."""

    anatomy: Anatomy
    p: np.ndarray
    weight: np.ndarray
    table: list[Entry] = field(default_factory=list)
    symbols: dict[str, ca.SX] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)

    def make(self) -> Decoupler:
        anatomy, model = self.anatomy, self.anatomy.model
        inputs = (*model.channels, *model.state)
        self.symbols |= {c: ca.SX.sym(short(c)) for c in (*inputs, *model.pose)}
        eta, inverse = anatomy.eta(self.p), anatomy.inverse(self.p, self.weight)
        rows, own = self._design()
        scale = np.array([inverse[i, k] for k, i in enumerate(own)])
        monomials = _Monomials(self.symbols, self.steps)
        margins = self._gains(1 / eta / scale, 1 / scale, own, monomials)
        self._shares(own, monomials)
        for i, column in enumerate(model.pose):
            for k in rows[i]:
                if i != own[k]:
                    label, share = short(model.channels[k]), model.pose[own[k]]
                    about = f"{column} per share of {share} that {label} sees"
                    value = inverse[i, k] / scale[k]
                    self._add(f"{short(column)}_{label}", value, per(unit(column), share), about)
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        self.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        at_pose = self._solve(rows, self._bends(eta * scale), monomials)
        box = Box({**anatomy.readings(self.p), **dict(anatomy.box.ends)})
        return Decoupler(
            model=model,
            inputs=inputs,
            table=tuple(self.table),
            limits=limits(inputs, box),
            zeros=zeros,
            steps=tuple(self.steps),
            at_pose=at_pose,
            margins=margins,
            box=box,
            exact=anatomy.exact(self.p, self.weight),
            symbols=self.symbols,
        )

    def _design(self) -> tuple[list[list[int]], list[int]]:
        """Return the channels of each pose coordinate, least influence first, and each channel's own row.

        By the nominal values, not the fitted ones: so code outlasts a calibration. The own row is the
        coordinate that the channel counts for most, among the channels.
        """
        influence = np.abs(self.anatomy.inverse(self.anatomy.model.nominal, self.weight))
        rows = [np.argsort(row, kind="stable").tolist() for row in np.round(influence, 6)]
        share = np.round(influence / influence.max(axis=1, keepdims=True), 3)
        return rows, share.argmax(axis=0).tolist()

    # -- steps -------------------------------------------------------------------------------------------

    def _add(self, name: str, value: float, unit: str, meaning: str) -> ca.SX:
        self.table.append(Entry(name, float(value), unit, meaning))
        self.symbols[name] = ca.SX.sym(name)
        return self.symbols[name]

    def _gains(
        self, scale: np.ndarray, at_rest: np.ndarray, own: list[int], monomials: "_Monomials"
    ) -> tuple[Margin, ...]:
        """Add the gain of each probe over its own entry of D, small terms first."""
        model, margins = self.anatomy.model, []
        for k, (poly, channel) in enumerate(zip(self.anatomy.gain, model.channels, strict=True)):
            name, column = short(channel), model.pose[own[k]]
            base, about = per("m", column), f"gain of {channel} for its share of {column}"
            small, terms = self._sum(poly, f"gain_{name}", scale[k], base, about, monomials)
            rest = self._add(f"gain_{name}", at_rest[k], base, f"{about}, at rest")
            total = rest if small is None else small + rest
            self._step(f"now_{name}", total, f"[{base}] {about}")
            margins.append(Margin(channel, f"gain_{name}", terms))
        return tuple(margins)

    def _shares(self, own: list[int], monomials: "_Monomials") -> None:
        """Add what each probe sees: (reading - offset) / gain."""
        model = self.anatomy.model
        for k, (poly, channel) in enumerate(zip(self.anatomy.offset, model.channels, strict=True)):
            name, about = short(channel), f"offset of {channel}"
            level, _ = self._sum(poly, f"offset_{name}", 1.0, "m", about, monomials, constant=True)
            reading, column = self.symbols[channel], model.pose[own[k]]
            value = (reading if level is None else reading - level) / self.symbols[f"now_{name}"]
            self._step(f"u_{name}", value, f"[{unit(column)}] share of {column} that {name} sees")

    def _step(self, name: str, expression: ca.SX, remark: str = "") -> ca.SX:
        self.steps.append(Step(name, expression, remark))
        return self.symbols.setdefault(name, ca.SX.sym(name))

    def _sum(
        self,
        poly: Polynomial,
        name: str,
        scale: float,
        base: str,
        about: str,
        monomials: "_Monomials",
        constant: bool = False,
    ) -> tuple[ca.SX | None, tuple[tuple[str, tuple[str, ...]], ...]]:
        """Sum of coefficient * monomial, smallest first; None without terms. Also the entries' columns."""
        rest = [(0,) * len(poly.variables)] if constant and not poly.constant.is_zero() else []
        (values,) = self.anatomy.numbers([poly], self.p)
        total: ca.SX | None = None
        terms = []
        for row in [*poly.rest, *rest]:
            label = poly.label(row)
            columns = tuple(filter(None, label.split("*")))
            key = "_".join([name, *map(short, columns)])
            said = f"{about}, per {label}" if label else f"{about}, at rest"
            entry = self._add(key, scale * values[row], per(base, label), said)
            term = entry * monomials(poly, row) if label else entry
            total = term if total is None else total + term
            terms.append((key, columns))
        return total, tuple(terms)

    def _bends(self, scale: np.ndarray) -> list[Callable[["_Monomials"], ca.SX] | None]:
        """Return eta h of each probe as a function of where its monomials are taken from."""
        return [
            self._bend(poly, short(channel), scale[k])
            for k, (poly, channel) in enumerate(
                zip(self.anatomy.bend, self.anatomy.model.channels, strict=True)
            )
        ]

    def _bend(self, poly: Polynomial, label: str, scale: float) -> Callable[["_Monomials"], ca.SX] | None:
        rows = [*poly.rest, *([(0,) * len(poly.variables)] if not poly.constant.is_zero() else [])]
        if not rows:
            return None
        (values,) = self.anatomy.numbers([poly], self.p)
        entries = []
        for row in rows:
            name = poly.label(row)
            key = "_".join(["bend", label, *(short(c) for c in name.split("*") if c)])
            about = f"displacement at {label} beyond the linear one, per {name or '1'}"
            entries.append(self._add(key, scale * values[row], per("m", name), about))

        def at(monomials: "_Monomials") -> ca.SX:
            return _total(
                entry * monomials(poly, row) if sum(row) else entry
                for entry, row in zip(entries, rows, strict=True)
            )

        return at

    # -- from what the probes see to the pose ------------------------------------------------------------

    def _solve(self, rows: list[list[int]], bends: list, monomials: "_Monomials") -> tuple[Step, ...]:
        """Add the steps from u to the pose; returns those of `decoupler_zero` for a non-linear model."""
        model = self.anatomy.model
        if not self.anatomy.curved:
            felt = self._felt(bends, monomials, "") if any(bends) else self._seen()
            self._product(rows, felt, "")
            return ()
        before = list(self.steps)
        count = self.anatomy.iterations(self.p, self.weight)
        source: dict[str, ca.SX] = {}
        for n in range(count + 1):
            felt = self._seen()
            if n:
                felt = self._felt(bends, _Monomials(self.symbols, self.steps, source, f"_{n}"), f"_{n}")
            made = self._product(rows, felt, f"_{n + 1}" if n < count else "")
            source = dict(zip(model.pose, made, strict=True))
        every, self.steps = self.steps, before
        known = _Monomials(self.symbols, self.steps, {c: self.symbols[c] for c in model.pose}, "_known")
        self._product(rows, self._felt(bends, known, "_known"), "_seen", zero=False)
        at_pose, self.steps = tuple(self.steps), every
        return at_pose

    def _seen(self) -> dict[str, ca.SX]:
        return {(k := short(c)): self.symbols[f"u_{k}"] for c in self.anatomy.model.channels}

    def _felt(self, bends: list, monomials: "_Monomials", tag: str) -> dict[str, ca.SX]:
        """Take h off what each probe sees."""
        felt = self._seen()
        for bend, label in zip(bends, felt, strict=True):
            if bend:
                felt[label] = self._step(f"w_{label}{tag}", felt[label] - bend(monomials))
        return felt

    def _product(
        self, rows: list[list[int]], felt: Mapping[str, ca.SX], tag: str, zero: bool = True
    ) -> list[ca.SX]:
        """Add zero + D felt, one step per pose coordinate."""
        labels, made = list(felt), []
        for i, column in enumerate(self.anatomy.model.pose):
            terms = [self.symbols[f"zero_{short(column)}"]] if zero else []
            for k in rows[i]:
                entry = self.symbols.get(f"{short(column)}_{labels[k]}")
                terms.append(felt[labels[k]] if entry is None else entry * felt[labels[k]])
            made.append(self._step(f"{short(column)}{tag}", _total(terms)))
        return made


class _Monomials:
    """Products of columns: one step each, made where first used; `pose` stands in for the pose columns."""

    def __init__(
        self,
        symbols: dict[str, ca.SX],
        steps: list[Step],
        pose: Mapping[str, ca.SX] | None = None,
        tag: str = "",
    ) -> None:
        self.symbols, self.steps, self.pose, self.tag = symbols, steps, pose or {}, tag

    def __call__(self, poly: Polynomial, row: Row) -> ca.SX:
        names = poly.label(row).split("*")
        column = {name: self.pose.get(name, self.symbols[name]) for name in names}
        product = column[names[0]]
        for k in range(1, len(names)):
            tag = self.tag if any(name in self.pose for name in names[: k + 1]) else ""
            key = "_".join(short(c) for c in names[: k + 1]) + tag
            if key not in {step.name for step in self.steps}:
                self.steps.append(Step(key, product * column[names[k]]))
                self.symbols.setdefault(key, ca.SX.sym(key))
            product = self.symbols[key]
        return product


def _total(terms: Iterable[ca.SX]) -> ca.SX:
    """Sum from left to right, without a 0 before it."""
    first, *others = terms
    return sum(others, start=first)
