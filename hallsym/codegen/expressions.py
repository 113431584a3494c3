"""The decoupled pose as few steps over few table entries, taken from the model's own expressions.

A family leaves `displacement`, `gain` and `reading` = gain * displacement + offset. With the gain of probe k
as eta_k phi_k, phi_k = 1 + small terms, and displacement = M pose + h(pose, state), the reading m gives

    pose = zero + D (m' - eta h),   m'_k = (m_k - offset_k) / phi_k,   D = (M^T W M)^-1 M^T W diag(1 / eta)

which for the small-angle stage (h = 0) is Eq. (31) of Chen et al., doi:10.3390/s16060872, with its zero
deviations in `zero` = -D delta'. Where h depends on the pose the last line is iterated. One entry of D per
probe is folded into its gain, phi_k / D_ik, so that column k of D holds a 1: one product and one rounding
less. The coefficients of phi, h and offset are found by differentiation and are functions of the parameters;
their values are the table.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.arrays import on_arrays
from hallsym.calibration import Fit
from hallsym.codegen.box import Box
from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.codegen.parts import ENOUGH, Decoupler, Entry, Step, short, unit
from hallsym.codegen.polynomials import NEGLIGIBLE, Polynomial, Row, polynomial, without_derived
from hallsym.errors import InputError
from hallsym.model import Model

MOST_ITERATIONS = 8


def decoupler(fit: Fit, box: Box) -> Decoupler:
    """Return the decoupler of a calibration over a box (readings are added to it where it has none)."""
    return _Maker(fit.model, fit.values, _weights(fit), box).make()


def _weights(fit: Fit) -> np.ndarray:
    sigma = [fit.noise.sigmas[c].value for c in fit.model.channels]
    return 1.0 / np.array(sigma) ** 2


@dataclass(frozen=True, eq=False)
class _Maker:
    """Takes one model apart at one set of parameters."""

    model: Model
    p: np.ndarray
    weight: np.ndarray
    box: Box

    def make(self) -> Decoupler:
        model = self.model
        phi, eta = self._gains()
        h, matrix = self._displacement()
        offset = self._offset()
        inverse = self._inverse(matrix, eta)
        inputs = (*model.channels, *model.state)
        symbols = {c: ca.SX.sym(short(c)) for c in (*inputs, *model.pose)}
        table: list[Entry] = []
        add = _adder(table, symbols)
        labels = [short(c) for c in model.channels]
        steps: list[Step] = []
        monomials = _Monomials(symbols, steps)
        rows, own = self._design()
        scale = np.array([inverse[i, k] for k, i in enumerate(own)])
        for k, label in enumerate(labels):  # small terms first
            column = model.pose[own[k]]
            base = _per("m", column)
            about = f"gain of {model.channels[k]} for its share of {column}"
            small = self._sum(phi[k], f"gain_{label}", 1 / eta[k] / scale[k], base, about, add, monomials)
            rest = add(f"gain_{label}", 1 / scale[k], base, f"{about}, at rest")
            symbols[f"now_{label}"] = ca.SX.sym(f"now_{label}")
            steps.append(Step(f"now_{label}", rest if small is None else small + rest, f"[{base}] {about}"))
        for k, label in enumerate(labels):
            reading = symbols[model.channels[k]]
            about = f"offset of {model.channels[k]}"
            level = self._sum(offset[k], f"offset_{label}", 1.0, "m", about, add, monomials, constant=True)
            value = (reading if level is None else reading - level) / symbols[f"now_{label}"]
            column = model.pose[own[k]]
            steps.append(Step(f"u_{label}", value, f"[{unit(column)}] share of {column} that {label} sees"))
            symbols[f"u_{label}"] = ca.SX.sym(f"u_{label}")
        for i, column in enumerate(model.pose):
            for k in rows[i]:
                if i != own[k]:
                    per = f"{column} per share of {model.pose[own[k]]} that {labels[k]} sees"
                    units = _per(unit(column), model.pose[own[k]])
                    add(f"{short(column)}_{labels[k]}", inverse[i, k] / scale[k], units, per)
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        bends = [self._bend(h[k], labels[k], eta[k] * scale[k], add) for k in range(len(labels))]
        at_pose = self._solve(steps, symbols, labels, rows, bends, monomials)
        box = Box({**self._readings(), **dict(self.box.ends)})
        found = Decoupler(
            model=model,
            inputs=inputs,
            table=tuple(table),
            limits=_limits(inputs, box),
            zeros=zeros,
            steps=tuple(steps),
            at_pose=at_pose,
            phi=tuple(phi),
            box=box,
            exact=self._exact(eta),
            symbols=symbols,
        )
        return found

    # -- parts of the model ------------------------------------------------------------------------------

    def _polynomials(self, expression: ca.SX, what: str) -> list[Polynomial]:
        s, model = self.model.symbols, self.model
        zeros = ca.SX.zeros(s.zeros.numel())
        plain = ca.substitute(expression, s.zeros, zeros)
        plain = without_derived(model, plain, self.box.reach())
        symbols = ca.vertcat(s.pose, s.state)
        names = (*model.pose, *model.state)
        return [
            polynomial(plain[k], symbols, names, f"the {what} of {model.name}") for k in range(plain.numel())
        ]

    def _number(self, expression: ca.SX) -> float:
        f = ca.Function("number", [self.model.symbols.parameters], [expression])
        return float(f(self.p))

    def _gains(self) -> tuple[list[Polynomial], np.ndarray]:
        n = len(self.model.pose)
        phi = self._polynomials(self.model.symbols.gain, "gain")
        if any(sum(row[:n]) for poly in phi for row in poly.terms):
            raise InputError(
                f"C is generated for gains that do not depend on the pose; that of {self.model.name} does."
            )
        eta = np.array([self._number(poly.constant) for poly in phi])
        for channel, value in zip(self.model.channels, eta, strict=True):
            if not abs(value) > 1e-6:
                raise InputError(
                    f"The gain of {channel} at rest is {value:g}: nothing can be decoded from it."
                )
        return phi, eta

    def _displacement(self) -> tuple[list[Polynomial], np.ndarray]:
        """Return the polynomials of the displacement and its linear part M, (n_channels, n_pose)."""
        n = len(self.model.pose)
        polys = [
            self._pruned(poly) for poly in self._polynomials(self.model.symbols.displacement, "displacement")
        ]
        matrix = np.zeros((len(polys), n))
        rest = []
        for k, poly in enumerate(polys):
            terms = dict(poly.terms)
            for i in range(n):
                row = tuple(int(v == i) for v in range(len(poly.variables)))
                matrix[k, i] = self._number(terms.pop(row, ca.SX(0)))
            rest.append(Polynomial(poly.variables, terms))
        return rest, matrix

    def _pruned(self, poly: Polynomial) -> Polynomial:
        """Leave out terms of higher degree that count nowhere in the bounds of the parameters."""
        reach = [self.box.reach()[c] for c in poly.variables]
        lower, upper = np.nan_to_num(self.model.bounds, posinf=1.0, neginf=-1.0)
        trials = [self.model.nominal, *np.random.default_rng(0).uniform(lower, upper, (8, len(lower)))]
        kept = {}
        for row, coefficient in poly.terms.items():
            f = ca.Function("number", [self.model.symbols.parameters], [coefficient])
            most = max(abs(float(f(p))) for p in trials) * np.prod(np.power(reach, row))
            if sum(row) < 2 or most > NEGLIGIBLE:
                kept[row] = coefficient
        return Polynomial(poly.variables, kept)

    def _offset(self) -> list[Polynomial]:
        s = self.model.symbols
        polys = self._polynomials(s.reading - s.gain * s.displacement, "offset")
        n = len(self.model.pose)
        rng = np.random.default_rng(0)
        kept = []
        for poly in polys:
            real = {row: c for row, c in poly.terms.items() if self._counts(c, rng)}
            if any(sum(row[:n]) for row in real):
                raise InputError(
                    f"C is generated for readings gain * displacement + offset with an offset that does not "
                    f"depend on the pose; those of {self.model.name} are not."
                )
            kept.append(Polynomial(poly.variables, real))
        return kept

    def _counts(self, coefficient: ca.SX, rng: np.random.Generator) -> bool:
        """Whether a coefficient is not zero for all parameters (a difference of equal terms is)."""
        f = ca.Function("number", [self.model.symbols.parameters], [coefficient])
        trials = [self.p, *(self.model.nominal + rng.standard_normal(len(self.p)) for _ in range(3))]
        return any(abs(float(f(p))) > 1e-9 for p in trials)

    def _inverse(self, matrix: np.ndarray, eta: np.ndarray) -> np.ndarray:
        """D = (M^T W M)^-1 M^T W / eta with W = weight eta^2: the least-squares inverse at rest."""
        scaled = matrix.T * (self.weight * eta**2 / np.max(self.weight * eta**2))
        return np.linalg.solve(scaled @ matrix, scaled) / eta

    def _design(self) -> tuple[list[list[int]], list[int]]:
        """Return the channels of each pose coordinate, least influence first, and each channel's own row.

        By the nominal values, not the fitted ones: so code outlasts a calibration. The own row is the
        coordinate that the channel counts for most, among the channels.
        """
        nominal = _Maker(self.model, self.model.nominal, self.weight, self.box)
        _, matrix = nominal._displacement()
        _, eta = nominal._gains()
        influence = np.abs(nominal._inverse(matrix, eta))
        rows = [np.argsort(row, kind="stable").tolist() for row in np.round(influence, 6)]
        share = np.round(influence / influence.max(axis=1, keepdims=True), 3)
        return rows, share.argmax(axis=0).tolist()

    # -- steps -------------------------------------------------------------------------------------------

    def _sum(
        self,
        poly: Polynomial,
        name: str,
        scale: float,
        base: str,
        about: str,
        add: Callable[..., ca.SX],
        monomials: "_Monomials",
        constant: bool = False,
    ) -> ca.SX | None:
        """Sum of coefficient * monomial, smallest first; None without terms."""
        rows = [
            *poly.rest,
            *([(0,) * len(poly.variables)] if constant and not poly.constant.is_zero() else []),
        ]
        total: ca.SX | None = None
        for row in rows:
            label = poly.label(row)
            entry = add(
                "_".join([name, *(short(c) for c in label.split("*") if c)]),
                scale * self._number(poly.terms[row]),
                _per(base, label),
                f"{about}, per {label}" if label else f"{about}, at rest",
            )
            term = entry * monomials(poly, row) if label else entry
            total = term if total is None else total + term
        return total

    def _bend(
        self, poly: Polynomial, label: str, eta: float, add: Callable[..., ca.SX]
    ) -> Callable[["_Monomials"], ca.SX] | None:
        """eta h of one probe as a function of where its monomials are taken from."""
        rows = [*poly.rest, *([(0,) * len(poly.variables)] if not poly.constant.is_zero() else [])]
        if not rows:
            return None
        entries = []
        for row in rows:
            name = poly.label(row)
            entries.append(
                add(
                    "_".join(["bend", label, *(short(c) for c in name.split("*") if c)]),
                    eta * self._number(poly.terms[row]),
                    _per("m", name),
                    f"displacement at {label} beyond the linear one, per {name or '1'}",
                )
            )

        def at(monomials: "_Monomials") -> ca.SX:
            return _total(
                entry * monomials(poly, row) if sum(row) else entry
                for entry, row in zip(entries, rows, strict=True)
            )

        return at

    def _solve(
        self,
        steps: list[Step],
        symbols: dict[str, ca.SX],
        labels: list[str],
        rows: list[list[int]],
        bends: list,
        monomials: "_Monomials",
    ) -> tuple[Step, ...]:
        """Add the steps from u to the pose; returns those of `decoupler_zero` for a non-linear model."""
        pose = self.model.pose
        curved = any(
            sum(row[: len(pose)])
            for k, poly in enumerate(self._displacement()[0])
            if bends[k]
            for row in poly.terms
        )

        def product(felt: Mapping[str, ca.SX], tag: str, zero: bool = True) -> list[Step]:
            out = []
            for i, column in enumerate(pose):
                terms = [symbols[f"zero_{short(column)}"]] if zero else []
                for k in rows[i]:
                    entry = symbols.get(f"{short(column)}_{labels[k]}")
                    terms.append(felt[labels[k]] if entry is None else entry * felt[labels[k]])
                out.append(Step(f"{short(column)}{tag}", _total(terms)))
            return out

        felt = {label: symbols[f"u_{label}"] for label in labels}
        if not any(bends):
            steps += product(felt, "")
            return ()
        if not curved:
            for k, label in enumerate(labels):
                if bends[k]:
                    symbols[f"w_{label}"] = ca.SX.sym(f"w_{label}")
                    steps.append(Step(f"w_{label}", felt[label] - bends[k](monomials)))
                    felt[label] = symbols[f"w_{label}"]
            steps += product(felt, "")
            return ()
        before = tuple(steps)
        count = self._iterations()
        source: dict[str, ca.SX] = {}
        for n in range(count + 1):
            if n:
                felt = self._felt(steps, symbols, labels, bends, source, f"_{n}")
            made = product(felt, f"_{n + 1}" if n < count else "")
            steps += made
            source = {
                c: symbols.setdefault(m.name, ca.SX.sym(m.name)) for c, m in zip(pose, made, strict=True)
            }
        known = {c: symbols[c] for c in pose}
        at_pose = list(before)
        felt = self._felt(at_pose, symbols, labels, bends, known, "_known")
        at_pose += product(felt, "_seen", zero=False)
        return tuple(at_pose)

    def _felt(
        self,
        steps: list[Step],
        symbols: dict[str, ca.SX],
        labels: list[str],
        bends: list,
        pose: Mapping[str, ca.SX],
        tag: str,
    ) -> dict[str, ca.SX]:
        """Take h at `pose` off what each probe sees."""
        local, felt = _Monomials(symbols, steps, pose, tag), {}
        for k, label in enumerate(labels):
            felt[label] = symbols[f"u_{label}"]
            if bends[k]:
                key = f"w_{label}{tag}"
                steps.append(Step(key, felt[label] - bends[k](local)))
                felt[label] = symbols.setdefault(key, ca.SX.sym(key))
        return felt

    def _iterations(self) -> int:
        """How often h must be taken off until the pose stands still, wherever the inputs are in their box."""
        model, s = self.model, self.model.symbols
        rest, matrix = self._displacement()
        h = ca.vertcat(*(_evaluated(poly, ca.vertcat(s.pose, s.state)) for poly in rest))
        run = on_arrays(ca.Function("h", [s.parameters, s.pose, s.state], [ca.densify(h)]))
        _, eta = self._gains()
        inverse = self._inverse(matrix, np.ones_like(eta))
        ends = {**self._readings(), **self.box.ends}
        low, high = np.array([ends[c] for c in (*model.channels, *model.state)]).T[:, :, None]
        rng = np.random.default_rng(0)
        share = np.hstack([rng.choice([0.0, 1.0], (len(low), 256)), rng.random((len(low), 256))])
        inputs = low + (high - low) * share
        readings, state = inputs[: len(eta)], list(inputs[len(eta) :])
        u = readings / on_arrays(model.gain)(self.p, state)[0]
        pose = inverse @ u
        for n in range(1, MOST_ITERATIONS + 1):
            new = inverse @ (u - run(self.p, list(pose), state)[0])
            change, pose = np.abs(new - pose).max(), new
            if change < ENOUGH:
                return n - 1 or 1
        raise InputError(
            f"Iterations of {model.name} do not settle over the box within {MOST_ITERATIONS} rounds; "
            "give a smaller one with --range."
        )

    # -- numbers -----------------------------------------------------------------------------------------

    def _readings(self) -> dict[str, tuple[float, float]]:
        """Ends of the readings over the box of pose and state, symmetric where they nearly are."""
        model, s = self.model, self.model.symbols
        symbols = ca.vertcat(s.pose, s.state)
        gain, shift = self._polynomials(s.gain, "gain"), self._polynomials(s.displacement, "displacement")
        offset = self._offset()
        ends = {}
        variables = [Enclosure(*self.box.ends[c]) for c in (*model.pose, *model.state)]
        for k, channel in enumerate(model.channels):
            parts = [_evaluated(poly[k], symbols) for poly in (gain, shift, offset)]
            numeric = ca.Function("n", [s.parameters, symbols], [parts[0] * parts[1] + parts[2]])
            symbol = [ca.SX.sym(f"v{i}") for i in range(symbols.numel())]
            value = numeric(self.p, ca.vertcat(*symbol))
            (found,) = enclose(ca.Function("n", symbol, [value]), variables, digits=53)
            zero = max((abs(z.upper) for z in model.zeros if np.isfinite(z.upper)), default=0.0)
            low, high = float(f"{found.low - zero:.3g}"), float(f"{found.high + zero:.3g}")
            most = max(abs(low), abs(high))
            ends[channel] = (-most, most) if min(-low, high) > 0.5 * most else (low, high)
        return ends

    def _exact(self, eta: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """`inputs (n_inputs, s) -> pose (n_pose, s)` by the model's own decoded form, zeros 0.

        The weight of a reading is held in units of its displacement, as the table holds it.
        """
        model = self.model
        gain, run = on_arrays(model.gain), on_arrays(model.decoded)
        n = len(model.channels)

        def exact(inputs: np.ndarray) -> np.ndarray:
            readings, state = list(inputs[:n]), list(inputs[n:])
            phi = gain(self.p, state)[0] / eta[:, None]
            weight = self.weight[:, None] / phi**2
            return run(self.p, np.zeros(len(model.zeros)), readings, state, list(weight))[0]

        return exact


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
        self.made: set[str] = set()

    def __call__(self, poly: Polynomial, row: Row) -> ca.SX:
        names = poly.label(row).split("*")
        column = {name: self.pose.get(name, self.symbols[name]) for name in names}
        product = column[names[0]]
        for k in range(1, len(names)):
            tag = self.tag if any(name in self.pose for name in names[: k + 1]) else ""
            key = "_".join(short(c) for c in names[: k + 1]) + tag
            if key not in self.made:
                self.steps.append(Step(key, product * column[names[k]]))
                self.symbols.setdefault(key, ca.SX.sym(key))
                self.made.add(key)
            product = self.symbols[key]
        return product


def _adder(table: list[Entry], symbols: dict[str, ca.SX]) -> Callable[..., ca.SX]:
    def add(name: str, value: float, unit: str, meaning: str) -> ca.SX:
        table.append(Entry(name, float(value), unit, meaning))
        symbols[name] = ca.SX.sym(name)
        return symbols[name]

    return add


def _limits(inputs: Sequence[str], box: Box) -> tuple[Entry, ...]:
    out = []
    for column in inputs:
        low, high = box.ends[column]
        if box.symmetric(column):
            out.append(Entry(f"limit_{short(column)}", high, unit(column), f"largest |{column}| of the box"))
        else:
            out.append(Entry(f"low_{short(column)}", low, unit(column), f"least {column} of the box"))
            out.append(Entry(f"high_{short(column)}", high, unit(column), f"greatest {column} of the box"))
    return tuple(out)


def _per(base: str, label: str) -> str:
    """Unit of a coefficient: base per unit of the monomial."""
    powers: dict[str, int] = {}
    for column in filter(None, label.split("*")):
        powers[unit(column)] = powers.get(unit(column), 0) + 1
    if base in powers:
        powers[base] -= 1
        base = "1"
    below = "*".join(f"{u}{n if n > 1 else ''}" for u, n in powers.items() if n)
    return f"{base}/({below})" if "*" in below else f"{base}/{below}" if below else base


def _total(terms: Iterable[ca.SX]) -> ca.SX:
    """Sum from left to right, without a 0 before it."""
    first, *others = terms
    return sum(others, start=first)


def _evaluated(poly: Polynomial, symbols: ca.SX) -> ca.SX:
    total = ca.SX(0)
    for row, coefficient in poly.terms.items():
        term = coefficient
        for v, power in enumerate(row):
            for _ in range(power):
                term = term * symbols[v]
        total = total + term
    return total


def check_columns(model: Model) -> None:
    """Refuse a model whose columns a controller does not have, or that nothing can be decoded from."""
    for column in model.computed:
        raise InputError(
            f"Model {model.name} needs {column.name}, which is computed from a whole log; a controller does "
            "not have it. Generate from a calibration without that effect."
        )
    if len(model.channels) < len(model.pose):
        raise InputError(
            f"Model {model.name} has fewer readings than pose coordinates; nothing can be decoded."
        )
