"""Decoupler of models whose readings are gain * displacement + offset: few steps over few table entries.

With the gain of probe k as eta_k phi_k, phi_k = 1 + small terms, and displacement = M pose + h(pose, state),
the reading m gives

    pose = zero + D (m' - eta h),   m'_k = (m_k - offset_k) / phi_k,   D = (M^T W M)^-1 M^T W diag(1 / eta)

which for small angles (h = 0) is Eq. (31) of Chen et al., doi:10.3390/s16060872, with its zero
deviations in `zero` = -D delta'. Where h depends on the pose the last line is iterated. One entry of D per
probe is folded into its gain, phi_k / D_ik, so that column k of D holds a 1: one product and one rounding
less.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.accepted import any_accepted
from hallsym.codegen.decoupler import (
    Box,
    Collected,
    Decoupler,
    Margin,
    Redundancy,
    Step,
    Watched,
    short,
    unit,
)
from hallsym.codegen.lowering.polynomials import Polynomial, PolynomialModel, Row
from hallsym.errors import InputError
from hallsym.model import Model

CLAMPED = 16.0
"""Times the box from which an iteration starts at most, of a model whose iterations could grow without end:
far more than any readings within their limits make."""


def per(base: str, label: str) -> str:
    """Unit of a coefficient: base per unit of the monomial."""
    powers: dict[str, int] = {}
    for column in filter(None, label.split("*")):
        powers[unit(column)] = powers.get(unit(column), 0) + 1
    if base in powers:
        powers[base] -= 1
        base = "1"
    below = "*".join(f"{u}{n if n > 1 else ''}" for u, n in powers.items() if n)
    return f"{base}/({below})" if "*" in below else f"{base}/{below}" if below else base


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Decoupler:
    """Return the decoupler of a model at parameters `p` over a box (readings are added where it has none).

    `weight`: 1 / variance of each reading, for more channels than pose coordinates.
    """
    if not model.symbols.displacement.numel():
        raise InputError(
            f"C is generated for readings gain * displacement + offset; model {model.name} has none of that "
            "form, and its family brings no decoupler of its own."
        )
    taken = PolynomialModel(model, box)
    made = _Assembly(taken, p, weight).make()
    if made.at_pose and not any_accepted(made, float(np.finfo(np.float32).max)):
        made = _Assembly(taken, p, weight, clamped=True).make()
    return made


@dataclass(eq=False)
class _Assembly(Collected):
    taken: PolynomialModel
    p: np.ndarray
    weight: np.ndarray
    clamped: bool = False
    """Whether each iteration starts within `CLAMPED` times the box, whatever the readings are."""
    redundancy: Redundancy | None = None

    def make(self) -> Decoupler:
        taken, model = self.taken, self.taken.model
        inputs = (*model.channels, *model.state)
        self.begin(model, inputs)
        self.symbols |= {c: ca.SX.sym(short(c)) for c in model.pose}
        eta, inverse = taken.eta(self.p), taken.inverse(self.p, self.weight)
        rows, own = self._design()
        scale = np.array([inverse[i, k] for k, i in enumerate(own)])
        spare = self._spare(inverse * eta, scale * eta, self.weight**-0.5 / np.abs(eta))
        monomials = _Monomials(self)
        margins = self._gains(1 / eta / scale, 1 / scale, own, monomials)
        self._shares(own, monomials)
        for i, column in enumerate(model.pose):
            for k in rows[i]:
                if i != own[k]:
                    label, share = short(model.channels[k]), model.pose[own[k]]
                    about = f"{column} per share of {share} that {label} sees"
                    value = inverse[i, k] / scale[k]
                    self.entry(f"{short(column)}_{label}", value, per(unit(column), share), about)
        bends = []
        for poly, channel, of in zip(taken.bend, model.channels, eta * scale, strict=True):
            about = f"displacement at {short(channel)} beyond the linear one"
            bends.append(self._terms(poly, poly.rows, f"bend_{short(channel)}", of, "m", about, "per 1"))
        at_pose = self._solve(rows, bends, monomials, spare)
        box = taken.box.over({**taken.readings(self.p), **dict(taken.box.ends)})
        exact = taken.exact(self.p, self.weight)
        return self.finished(
            model, inputs, box, at_pose=at_pose, margins=margins, exact=exact, redundancy=self.redundancy,
            drawn=residual.drawn_of(model, self.p, taken.box) if self.redundancy else None,
            flags=(residual.flag(),) if self.redundancy else (),
        )  # fmt: skip

    @staticmethod
    def _spare(inverse: np.ndarray, scale: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Return what is left of the displacements, (rows, n) per what the probes see: no row of three
        probes.

        `inverse` (n_pose, n): pose per displacement, (M^T W M)^-1 M^T W; `scale` (n,): what is seen of a
        displacement; `sigma` (n,): its standard deviation, in units of the largest of which the rows are: one
        row where one degree of freedom is left, one for each probe where there are more.
        """
        count, freedom = len(scale), len(scale) - len(inverse)
        if not freedom:
            return np.zeros((0, count))
        wide = inverse * sigma
        slopes = (sigma[:, None] ** 2 * inverse.T) @ np.linalg.inv(wide @ wide.T)
        left = np.eye(count) - slopes @ inverse
        if freedom == 1:
            left = np.linalg.svd(left / sigma[:, None] * sigma)[2][:1] / sigma
            return np.asarray(left * sigma.max() / scale)
        return np.asarray(left * (sigma.max() / sigma)[:, None] / scale)

    def _contradiction(self, spare: np.ndarray, sensed: Mapping[str, ca.SX]) -> None:
        """Add what is left of the probes, and the sum of its squares."""
        channels, watched = self.taken.model.channels, []
        for k, row in enumerate(spare):
            name, terms = "left_of_all" if len(spare) == 1 else f"left_{short(channels[k])}", []
            for (label, value), share, channel in zip(sensed.items(), row, channels, strict=True):
                about = f"share of {channel} in what {'they contradict' if len(spare) == 1 else 'is left'}"
                terms.append(self.entry(f"{name}_{label}", share, "1", about) * value)
            self.step(name, _total(terms), "[m] that the pose leaves")
            readings = tuple(range(len(channels))) if len(spare) == 1 else (k,)
            watched.append(Watched(name, readings))
        if watched:
            self.redundancy = residual.summed(self, watched)

    def _design(self) -> tuple[list[list[int]], list[int]]:
        """Return the channels of each pose coordinate, least influence first, and each channel's own row.

        By the nominal values, not the fitted ones: so code outlasts a calibration. The own row is the
        coordinate that the channel counts for most, among the channels.
        """
        influence = np.abs(self.taken.inverse(self.taken.model.nominal, self.weight))
        rows = [np.argsort(row, kind="stable").tolist() for row in np.round(influence, 6)]
        share = np.round(influence / influence.max(axis=1, keepdims=True), 3)
        return rows, share.argmax(axis=0).tolist()

    # -- steps -------------------------------------------------------------------------------------------

    def _gains(
        self, scale: np.ndarray, at_rest: np.ndarray, own: list[int], monomials: "_Monomials"
    ) -> tuple[Margin, ...]:
        """Add the gain of each probe over its own entry of D, small terms first."""
        model, margins = self.taken.model, []
        for k, (poly, channel) in enumerate(zip(self.taken.gain, model.channels, strict=True)):
            name, column = short(channel), model.pose[own[k]]
            base, about = per("m", column), f"gain of {channel} for its share of {column}"
            terms = self._terms(poly, poly.rest, f"gain_{name}", scale[k], base, about, "at rest")
            small = self._sum(terms, monomials) if terms else None
            rest = self.entry(f"gain_{name}", at_rest[k], base, f"{about}, at rest")
            total = rest if small is None else small + rest
            self.step(f"now_{name}", total, f"[{base}] {about}")
            of = tuple((t.entry, t.columns) for t in terms)
            margins.append(Margin(channel, f"gain_{name}", of))
        return tuple(margins)

    def _shares(self, own: list[int], monomials: "_Monomials") -> None:
        model = self.taken.model
        for k, (poly, channel) in enumerate(zip(self.taken.offset, model.channels, strict=True)):
            name, about = short(channel), f"offset of {channel}"
            terms = self._terms(poly, poly.rows, f"offset_{name}", 1.0, "m", about, "at rest")
            reading, column = self.symbols[channel], model.pose[own[k]]
            if terms:
                reading = reading - self._sum(terms, monomials)
            value = reading / self.symbols[f"now_{name}"]
            self.step(f"u_{name}", value, f"[{unit(column)}] share of {column} that {name} sees")

    def _terms(
        self, poly: Polynomial, rows: list[Row], name: str, scale: float, base: str, about: str, alone: str
    ) -> list["_Term"]:
        """Add the entries of some terms; `alone`: what is said of one without columns."""
        (values,) = self.taken.numbers([poly], self.p)
        terms = []
        for row in rows:
            label = poly.label(row)
            columns = tuple(filter(None, label.split("*")))
            key = "_".join([name, *map(short, columns)])
            said = f"{about}, per {label}" if label else f"{about}, {alone}"
            self.entry(key, scale * values[row], per(base, label), said)
            terms.append(_Term(key, columns))
        return terms

    def _sum(self, terms: Iterable["_Term"], monomials: "_Monomials") -> ca.SX:
        """Sum of coefficient * monomial in the order of the terms, smallest first."""
        return _total(
            self.symbols[t.entry] * monomials(t.columns) if t.columns else self.symbols[t.entry]
            for t in terms
        )

    # -- from what the probes see to the pose ------------------------------------------------------------

    def _solve(
        self, rows: list[list[int]], bends: list, monomials: "_Monomials", spare: np.ndarray
    ) -> tuple[Step, ...]:
        """Add the steps from u to the pose; returns those of `decoupler_zero` for a non-linear model."""
        model = self.taken.model
        if not self.taken.curved:
            sensed = self._sensed(bends, monomials, "") if any(bends) else self._seen()
            self._contradiction(spare, sensed)
            self._product(rows, sensed, "")
            return ()
        before, named = list(self.steps), set(self.named)
        count = self.taken.iterations(self.p, self.weight)
        source: dict[str, ca.SX] = {}
        for n in range(count + 1):
            sensed = self._seen()
            if n:
                sensed = self._sensed(bends, _Monomials(self, source, f"_{n}"), f"_{n}")
            if n == count:
                self._contradiction(spare, sensed)
            made = self._product(rows, sensed, f"_{n + 1}" if n < count else "")
            source = dict(zip(model.pose, made, strict=True))
            if self.clamped and n < count:
                source = {c: self._within(c, v, f"_{n + 1}") for c, v in source.items()}
        every, self.steps, self.named = self.steps, before, named
        known = _Monomials(self, {c: self.symbols[c] for c in model.pose}, "_known")
        self._product(rows, self._sensed(bends, known, "_known"), "_seen", zero=False)
        at_pose, self.steps = tuple(self.steps), every
        return at_pose

    def _within(self, column: str, value: ca.SX, tag: str) -> ca.SX:
        """A pose coordinate that an iteration starts from, no further out than `CLAMPED` times the box."""
        name, most = short(column), CLAMPED * max(map(abs, self.taken.box.ends[column]))
        end = self.entry(f"most_{name}", most, unit(column), f"largest |{column}| of an iteration", "sign")
        below = self.step(f"{name}_below{tag}", ca.if_else(value < end, value, end))
        return self.step(f"{name}_held{tag}", ca.if_else(below > -end, below, -end))

    def _seen(self) -> dict[str, ca.SX]:
        return {(k := short(c)): self.symbols[f"u_{k}"] for c in self.taken.model.channels}

    def _sensed(self, bends: list, monomials: "_Monomials", tag: str) -> dict[str, ca.SX]:
        sensed = self._seen()
        for bend, label in zip(bends, sensed, strict=True):
            if bend:
                sensed[label] = self.step(f"w_{label}{tag}", sensed[label] - self._sum(bend, monomials))
        return sensed

    def _product(
        self, rows: list[list[int]], sensed: Mapping[str, ca.SX], tag: str, zero: bool = True
    ) -> list[ca.SX]:
        """Add zero + D sensed, one step per pose coordinate."""
        labels, made = list(sensed), []
        for i, column in enumerate(self.taken.model.pose):
            terms = [self.symbols[f"zero_{short(column)}"]] if zero else []
            for k in rows[i]:
                entry = self.symbols.get(f"{short(column)}_{labels[k]}")
                terms.append(sensed[labels[k]] if entry is None else entry * sensed[labels[k]])
            made.append(self.step(f"{short(column)}{tag}", _total(terms)))
        return made


@dataclass(frozen=True)
class _Term:
    """An entry of the table times the product of some columns."""

    entry: str
    columns: tuple[str, ...]


@dataclass(eq=False)
class _Monomials:
    """Products of columns: one step each, made where first used; `pose` stands in for the pose columns."""

    made: Collected
    pose: Mapping[str, ca.SX] = field(default_factory=dict)
    tag: str = ""

    def __call__(self, names: Sequence[str]) -> ca.SX:
        column = {name: self.pose.get(name, self.made.symbols[name]) for name in names}
        product = column[names[0]]
        for k in range(1, len(names)):
            tag = self.tag if any(name in self.pose for name in names[: k + 1]) else ""
            key = "_".join(short(c) for c in names[: k + 1]) + tag
            product = self.made.step(key, product * column[names[k]])
        return product


def _total(terms: Iterable[ca.SX]) -> ca.SX:
    """Sum from left to right, without a 0 before it."""
    first, *others = terms
    return sum(others, start=first)
