"""Decoupler of models whose readings are gain * displacement + offset: few steps over few table entries.

With the gain of probe k as eta_k phi_k, phi_k = 1 + small terms, and displacement = M pose + h(pose, state),
the reading m gives

    pose = zero + D (m' - eta h),   m'_k = (m_k - offset_k) / phi_k,   D = (M^T W M)^-1 M^T W diag(1 / eta)

which for small angles (h = 0) is Eq. (31) of Chen et al., doi:10.3390/s16060872, with its zero
deviations in `zero` = -D delta'. Where h depends on the pose the last line is iterated. One entry of D per
probe is folded into its gain, phi_k / D_ik, so that column k of D holds a 1: one product and one rounding
less. Gain, displacement and offset are polynomials of the columns, by differentiation, whose coefficients are
expressions of the parameters.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import factorial, prod

import casadi as ca
import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.accepted import any_accepted
from hallsym.codegen.decoupler import (
    ENOUGH,
    Box,
    Collected,
    Decoupler,
    Margin,
    Redundancy,
    Step,
    short,
    unit,
)
from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.features import derivatives

CLAMPED = 16.0
"""Times the box from which an iteration starts at most, of a model whose iterations could grow without end:
far more than any readings within their limits make."""


MOST_TERMS = 400
MOST_DEGREE = 8
"""Derivatives of a polynomial that are not always 0, and its degree, at most."""
NEGLIGIBLE = 1e-13
"""Size [m, rad, 1] below which a term of a Taylor series is left out."""

Row = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Terms of one scalar: exponents over `variables` -> coefficient, an SX of the parameters."""

    variables: tuple[str, ...]
    terms: Mapping[Row, ca.SX]

    @property
    def constant(self) -> ca.SX:
        """The term that no variable enters."""
        return self.terms.get((0,) * len(self.variables), ca.SX(0))

    @property
    def rest(self) -> list[Row]:
        """Exponents of the other terms, the highest degree, so the smallest, first."""
        return sorted((row for row in self.terms if sum(row)), key=lambda row: (-sum(row), row))

    @property
    def rows(self) -> list[Row]:
        """Exponents of all terms, the constant one last."""
        return [*self.rest, *([] if self.constant.is_zero() else [(0,) * len(self.variables)])]

    def label(self, row: Row) -> str:
        """Name of a monomial, such as `z_m*z_m`."""
        return "*".join(name for name, power in zip(self.variables, row, strict=True) for _ in range(power))

    def of(self, symbols: ca.SX) -> ca.SX:
        """Return the polynomial of `symbols` (n_variables,)."""
        total = ca.SX(0)
        for row, term in self.terms.items():
            for v, power in enumerate(row):
                for _ in range(power):
                    term = term * symbols[v]
            total = total + term
        return total


def polynomial(expression: ca.SX, symbols: ca.SX, variables: Sequence[str], what: str) -> Polynomial:
    """Return the terms of a scalar `expression` of `symbols` (v,), named `variables`.

    Raises `InputError` where there is no end to them; whether they reproduce it is for the caller to check.
    """
    found = derivatives(expression, symbols, MOST_DEGREE, MOST_TERMS)
    if found is None:
        raise InputError(
            f"C is generated for polynomials of the pose and the state only; {what} is none. Give a "
            "quantity of one column that is not polynomial, such as sin Rz, through Signals.derive."
        )
    origin = ca.SX.zeros(symbols.numel())
    terms = {row: ca.substitute(e, symbols, origin) / prod(map(factorial, row)) for row, e in found.items()}
    terms = {row: value for row, value in terms.items() if not value.is_zero()}
    return Polynomial(tuple(variables), terms)


def without_derived(model: Model, expression: ca.SX, reach: Mapping[str, float]) -> ca.SX:
    """Return `expression` with each derived quantity, such as sin Rz, as its Taylor series.

    `reach`: largest magnitude of each column. No libm at run time: the series ends where its terms do not
    count any more.
    """
    s = model.symbols
    columns = dict(zip((*model.pose, *model.state), ca.vertsplit(ca.vertcat(s.pose, s.state)), strict=True))
    for k in range(s.derived.numel()):
        series = _taylor(s.derived_as[k], columns, reach, str(s.derived[k]))
        expression = ca.substitute(expression, s.derived[k], series)
    return expression


def _taylor(expression: ca.SX, columns: Mapping[str, ca.SX], reach: Mapping[str, float], name: str) -> ca.SX:
    of = [column for column, symbol in columns.items() if ca.depends_on(expression, symbol)]
    if len(of) != 1:
        raise InputError(
            f"C is generated for derived quantities of one column; {name!r} depends on {len(of)} columns."
        )
    symbol, most = columns[of[0]], reach[of[0]]
    series, derivative, small = ca.SX(0), expression, 0
    for n in range(2 * MOST_DEGREE):
        factor = float(ca.evalf(ca.substitute(derivative, symbol, 0))) / factorial(n)
        if not np.isfinite(factor):
            break
        small = small + 1 if abs(factor) * most**n < NEGLIGIBLE else 0
        if small == 3:
            return series
        if factor and not small:
            series = series + factor * symbol**n
        derivative = ca.jacobian(derivative, symbol)
    raise InputError(f"Derived quantity {name!r} has no short Taylor series over {of[0]} within +-{most:g}.")


MOST_ITERATIONS = 16
"""Rounds of the decoder, each of which takes the bend off by its share of the reading: of three probes a
square of 2 % of the range takes 6, 5 % 9, 9 % 15; from 10 % on intervals do not bound the rounds."""


@dataclass(frozen=True, eq=False)
class PolynomialModel:
    """The polynomials of one model over one box; `p` of its methods is a parameter vector."""

    model: Model
    box: Box

    # -- polynomials -------------------------------------------------------------------------------------

    @cached_property
    def gain(self) -> list[Polynomial]:
        """eta_k phi_k of each channel; does not depend on the pose."""
        n = len(self.model.pose)
        polys = self._polynomials(self.model.symbols.gain, "gain")
        if any(sum(row[:n]) for poly in polys for row in poly.terms):
            raise InputError(
                f"C is generated for gains that do not depend on the pose; that of {self.model.name} does."
            )
        return polys

    @cached_property
    def displacement(self) -> list[Polynomial]:
        """What each channel senses, without zero deviations."""
        return self._polynomials(self.model.symbols.displacement, "displacement")

    @cached_property
    def bend(self) -> list[Polynomial]:
        """h: the displacement without its terms linear in the pose, and without terms that count nowhere."""
        n = len(self.model.pose)
        kept = []
        for poly in self._pruned(self.displacement):
            terms = {row: c for row, c in poly.terms.items() if sum(row) != 1 or not sum(row[:n])}
            kept.append(Polynomial(poly.variables, terms))
        return kept

    @cached_property
    def offset(self) -> list[Polynomial]:
        """What the reading has beyond gain * displacement; does not depend on the pose."""
        s, n = self.model.symbols, len(self.model.pose)
        kept = []
        polys = self._polynomials(s.reading - s.gain * s.displacement, "offset")
        rng = np.random.default_rng(0)
        nominal = self.model.nominal
        trials = [nominal + share * rng.standard_normal(len(nominal)) for share in (0.0, 1.0, 1.0, 1.0)]
        for poly, most in zip(polys, self._largest(polys, trials), strict=True):
            # a difference of equal terms is zero for all parameters
            real = {row: c for row, c in poly.terms.items() if most[row] > 1e-9}
            if any(sum(row[:n]) for row in real):
                raise InputError(
                    "C is generated for readings gain * displacement + offset with an offset that does not "
                    f"depend on the pose; those of {self.model.name} are not."
                )
            kept.append(Polynomial(poly.variables, real))
        return kept

    @property
    def curved(self) -> bool:
        """Whether the displacement is not linear in the pose."""
        n = len(self.model.pose)
        return any(sum(row[:n]) for poly in self.bend for row in poly.terms)

    def _polynomials(self, expression: ca.SX, what: str) -> list[Polynomial]:
        s, model = self.model.symbols, self.model
        plain = ca.substitute(expression, s.offsets, ca.SX.zeros(s.offsets.numel()))
        plain = without_derived(model, plain, self.box.reach())
        symbols, names = ca.vertcat(s.pose, s.state), (*model.pose, *model.state)
        return [
            polynomial(plain[k], symbols, names, f"the {what} of {model.name}") for k in range(plain.numel())
        ]

    def _pruned(self, polys: Sequence[Polynomial]) -> list[Polynomial]:
        """Leave out terms of higher degree that count nowhere in the bounds of the parameters."""
        reach = self.box.reach()
        lower, upper = np.nan_to_num(self.model.bounds, posinf=1.0, neginf=-1.0)
        trials = [self.model.nominal, *np.random.default_rng(0).uniform(lower, upper, (8, len(lower)))]
        kept = []
        for poly, most in zip(polys, self._largest(polys, trials), strict=True):
            sizes = [reach[c] for c in poly.variables]
            size = {
                row: 1.0 if sum(row) < 2 else most[row] * np.prod(np.power(sizes, row)) for row in poly.terms
            }
            terms = {row: c for row, c in poly.terms.items() if size[row] > NEGLIGIBLE}
            kept.append(Polynomial(poly.variables, terms))
        return kept

    def _largest(self, polys: Sequence[Polynomial], trials: Sequence[np.ndarray]) -> list[dict[Row, float]]:
        found = [self.numbers(polys, p) for p in trials]
        return [
            {row: max(abs(trial[k][row]) for trial in found) for row in poly.terms}
            for k, poly in enumerate(polys)
        ]

    # -- numbers -----------------------------------------------------------------------------------------

    def numbers(self, polys: Sequence[Polynomial], p: np.ndarray) -> list[dict[Row, float]]:
        """Return the coefficients at one set of parameters."""
        flat = [c for poly in polys for c in poly.terms.values()]
        f = ca.Function("numbers", [self.model.symbols.parameters], [ca.densify(ca.vertcat(*flat, 0))])
        values = iter(np.asarray(f(p)).ravel().tolist())
        return [{row: next(values) for row in poly.terms} for poly in polys]

    def eta(self, p: np.ndarray) -> np.ndarray:
        """Return the gains at rest, (n_channels,)."""
        rest = (0,) * len(self.gain[0].variables)
        eta = np.array([terms.get(rest, 0.0) for terms in self.numbers(self.gain, p)])
        for channel, value in zip(self.model.channels, eta, strict=True):
            if not abs(value) > 1e-6:
                raise InputError(
                    f"The gain of {channel} at rest is {value:g}: nothing can be decoded from it."
                )
        return eta

    def matrix(self, p: np.ndarray) -> np.ndarray:
        """Return M, the part of the displacement that is linear in the pose, (n_channels, n_pose)."""
        rows = [tuple(int(v == i) for v in range(len(self._variables))) for i in range(len(self.model.pose))]
        return np.array(
            [[terms.get(row, 0.0) for row in rows] for terms in self.numbers(self.displacement, p)]
        )

    def inverse(self, p: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return D = (M^T W M)^-1 M^T W / eta, W = weight eta^2: the least-squares inverse at rest."""
        matrix, eta = self.matrix(p), self.eta(p)
        if not matrix.size or not matrix.any(axis=0).all():
            raise InputError(
                f"C for model {self.model.name} of family {self.model.family} cannot be generated: its "
                "readings are not a gain times a displacement that is linear in the pose."
            )
        scaled = matrix.T * (weight * eta**2 / np.max(weight * eta**2))
        return np.linalg.solve(scaled @ matrix, scaled) / eta

    def readings(self, p: np.ndarray) -> dict[str, tuple[float, float]]:
        """Return the ends of the readings over the box of pose and state, symmetric where they nearly are."""
        model, s = self.model, self.model.symbols
        ends = {}
        symbol = [ca.SX.sym(c) for c in self._variables]
        variables = {c: Enclosure(*self.box.ends[c]) for c in self._variables}
        for k, channel in enumerate(model.channels):
            gain, shift, offset = (
                poly[k].of(ca.vertcat(*symbol)) for poly in (self.gain, self.displacement, self.offset)
            )
            value = ca.substitute(gain * shift + offset, s.parameters, ca.DM(p))
            (found,) = enclose([value], variables)
            zero = max((abs(z.upper) for z in model.offsets if np.isfinite(z.upper)), default=0.0)
            low, high = float(f"{found.low - zero:.3g}"), float(f"{found.high + zero:.3g}")
            most = max(abs(low), abs(high))
            ends[channel] = (-most, most) if min(-low, high) > 0.5 * most else (low, high)
        return ends

    def iterations(self, p: np.ndarray, weight: np.ndarray) -> int:
        """Return how often h must be taken off until the pose stands still, wherever the inputs are."""
        model, s = self.model, self.model.symbols
        h = ca.vertcat(*(poly.of(ca.vertcat(s.pose, s.state)) for poly in self.bend))
        run = on_arrays(ca.Function("h", [s.parameters, s.pose, s.state], [ca.densify(h)]))
        eta = self.eta(p)
        inverse = self.inverse(p, weight) * eta
        ends = {**self.readings(p), **self.box.ends}
        low, high = np.array([ends[c] for c in (*model.channels, *model.state)]).T[:, :, None]
        rng = np.random.default_rng(0)
        share = np.hstack([rng.choice([0.0, 1.0], (len(low), 256)), rng.random((len(low), 256))])
        inputs = low + (high - low) * share
        readings, state = inputs[: len(eta)], list(inputs[len(eta) :])
        u = readings / on_arrays(model.gain)(p, state)[0]
        pose = inverse @ u
        for n in range(1, MOST_ITERATIONS + 1):
            with np.errstate(over="ignore", invalid="ignore"):  # what does not settle grows without end
                new = inverse @ (u - run(p, list(pose), state)[0])
                change, pose = np.abs(new - pose).max(), new
            if not np.isfinite(change):
                break
            if change < ENOUGH:
                return n - 1 or 1
        raise InputError(
            f"Iterations of {model.name} do not settle over the box within {MOST_ITERATIONS} rounds; "
            "give a smaller one with --range."
        )

    def exact(self, p: np.ndarray, weight: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return `inputs (n_inputs, s) -> pose (n_pose, s)` by the model's own decoded form, offsets 0.

        The weight of a reading has the units of its displacement, as in the table.
        """
        model, eta = self.model, self.eta(p)
        gain, n, none = on_arrays(model.gain), len(model.channels), np.zeros(len(model.offsets))

        def exact(inputs: np.ndarray) -> np.ndarray:
            readings, state = list(inputs[:n]), list(inputs[n:])
            phi = gain(p, state)[0] / eta[:, None]
            return model.decode(p, none, readings, state, list(weight[:, None] / phi**2))

        return exact

    @property
    def _variables(self) -> tuple[str, ...]:
        return (*self.model.pose, *self.model.state)


# -- the steps -----------------------------------------------------------------------------------------------


LEFT = "[m] that the pose leaves"


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
    if made.at_pose and not any_accepted(made):
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
            self.redundancy = residual.left_over(self, spare, sensed, LEFT)
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
                self.redundancy = residual.left_over(self, spare, sensed, LEFT)
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
