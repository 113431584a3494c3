"""A model: the chain of named links from pose to reading, as CasADi expressions, and its parameters.

    pose -> clock -> mechanics -> reference -> field -> transducer -> electronics -> reading

A family builds the chain; an effect is a function `Model -> Model` that adds a step to one link. Readings,
decoded pose, derivatives and generated code are derived from the expressions of the steps, so there is one
copy of the mathematics.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import takewhile
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.model.arrays import Columns, jacobian, on_arrays, on_vectors
from hallsym.model.derived import Computed
from hallsym.model.family import Family

LINKS = ("clock", "mechanics", "reference", "field", "transducer", "electronics")
"""Links in the order in which a signal meets them. `reference` stands after `mechanics` because the zero of
the reference is seen by each probe as a displacement."""


STEPS = 4
"""Newton's steps where readings are not linear in the pose; one is exact where they are."""


@dataclass(frozen=True)
class Parameter:
    """One scalar of the device: name, nominal value and bounds in SI, unit, and meaning."""

    name: str
    nominal: float
    lower: float
    upper: float
    unit: str
    meaning: str = ""

    @property
    def width(self) -> float:
        """Width of the bounds; 0 for a fixed parameter, inf for a free one."""
        return self.upper - self.lower


class Signals(dict):
    """The signals of the chain: `name -> SX`. A step reads those it needs and replaces those it changes.

    Keys set before the first step: the columns of pose and state. `derive` adds a data-only quantity (such
    as 1 - cos Rz) that is not polynomial in the columns, so that readings stay polynomial in data.
    `functions`: functions of the signals that a step provides for later steps.
    """

    def __init__(self, columns: Iterable[str]) -> None:
        super().__init__({name: ca.SX.sym(name) for name in columns})
        self.derived: dict[str, tuple[ca.SX, ca.SX]] = {}
        self.functions: dict[str, Callable[..., Any]] = {}

    def copied(self) -> "Signals":
        """Return a copy of the signals for another chain that continues from here.

        Raises `TypeError` if one is no expression, number or container: it may refer to these signals.
        """
        out = Signals(())
        out.update({k: +v if isinstance(v, ca.SX) else mapped(v) for k, v in self.items()})
        out.derived, out.functions = dict(self.derived), dict(self.functions)
        return out

    def derive(self, name: str, expression: ca.SX) -> ca.SX:
        """Return the symbol that stands for `expression` of the columns; made at the first call."""
        if name not in self.derived:
            self.derived[name] = (ca.SX.sym(name), expression)
        return self.derived[name][0]


def mapped(value: Any, of: Callable[[ca.SX], Any] = lambda expression: expression) -> Any:
    """Return a signal whose containers are new ones, with `of` each expression in place of it.

    Raises `TypeError` if it holds more than expressions, numbers and containers.
    """
    if isinstance(value, ca.SX):
        return of(value)
    if isinstance(value, ca.DM | float | int | str):
        return value
    if isinstance(value, dict):
        return {key: mapped(v, of) for key, v in value.items()}
    if type(value) in (list, tuple):
        return type(value)([mapped(v, of) for v in value])
    raise TypeError


Step = Callable[[Signals, Mapping[str, ca.SX]], None]


@dataclass(frozen=True, eq=False)
class Combination:
    """A readable function of the parameters, such as a lever arm: may be identifiable when they are not."""

    expression: str
    unit: str
    parameters: tuple[str, ...]
    value: Callable[[Mapping[str, ca.SX]], ca.SX]


@dataclass(frozen=True)
class Gauge:
    """A factor or shift that no reading shows: the mean of `parameters` stays at its nominal value.

    It holds where readings leave it free. `text`: what is free, and what the user may state in its place.
    """

    parameters: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class Inspection:
    """Result of a family's pre-fit check of a log: notes, and channels of reversed sign."""

    notes: tuple[str, ...] = ()
    inverted: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Model:
    """A chain with its parameters; immutable, extended by `with_step`.

    `pose` are the columns that the sensor measures (x, y, Rz), `references` their logged references, `state`
    the measured columns that the gain may depend on, `channels` the readings. `offsets` are the nuisance
    parameters of each run (the zero deviations of Eq. (30)); a reading is linear in them.
    """

    name: str
    family: Family
    pose: tuple[str, ...]
    references: tuple[str, ...]
    state: tuple[str, ...]
    channels: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    steps: tuple[tuple[str, Step], ...]
    offsets: tuple[Parameter, ...] = ()
    combinations: tuple[Combination, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    effects: tuple[str, ...] = ()
    layout: tuple = ()
    closed_form: "Callable[[Model, Mapping[str, np.ndarray]], np.ndarray] | None" = None
    """Start from unconstrained feature coefficients, if the family has one; nominal values otherwise."""
    computed: tuple[Computed, ...] = ()
    """How to make the columns among `state` that are not logged; `hallsym.log.derived` serves them."""
    texts: Mapping[str, str] = field(default_factory=dict)
    """Text under which an effect with numbers is saved: `hysteresis:half_width_m=6e-05`."""
    period: Mapping[str, float] = field(default_factory=dict)
    """Pose coordinates, channels, references and parameters that repeat, each with its period [its unit]."""
    absolute: tuple[str, ...] = ()
    """References among them that do not wrap, such as an interferometer beside a periodic field."""
    homes: Mapping[str, str] = field(default_factory=dict)
    """Offsets that are the origin of a periodic coordinate in each run: name of the offset -> coordinate."""
    amplitudes: tuple[str, ...] = ()
    """Parameters whose common factor, set by the air gap, scales all readings and moves no decoded pose."""
    begin: "Callable[[ca.SX, Mapping[str, ca.SX]], ca.SX] | None" = None
    """`(reading, parameters) -> pose` near which decoding begins; the zero pose otherwise."""
    formulas: "Mapping[str, Callable[[ca.SX, Mapping[str, ca.SX]], ca.SX]]" = field(default_factory=dict)
    """Other closed forms `(reading, parameters) -> pose` by name, as a paper states them."""
    onward: "Callable[[np.ndarray, str, Mapping[str, float]], np.ndarray] | None" = None
    """`(poses (n_pose, samples), coordinate, parameters) -> (n_pose, samples)`: change of the pose, per unit
    of the nominal period of a coordinate, towards the next pose with the same readings; None: only that
    coordinate changes, by its period."""
    guess: "Callable[[Model, Any], Mapping[str, float]] | None" = None
    """`(model, log) -> parameters` to begin from, of a model without run statistics; nominal otherwise."""
    typical: tuple[tuple[float, ...], ...] = ()
    """Poses over which noise is averaged where readings are not linear in the pose; else the zero pose."""
    inspect: "Callable[..., Inspection] | None" = None
    """`(model, log, fitted=True)`: the family's pre-fit check of a log that is fitted, or evaluated. Raises
    `InputError`."""
    nearly: bool = False
    """Whether readings have the form that generated code decodes nearly only, such as a wave that has ends:
    the code then says what that leaves of the pose, where it refuses other forms otherwise."""
    before: "Model | None" = field(default=None, repr=False)
    """The model that this one was made from; it shares the expressions up to the first step that differs."""

    def with_step(
        self,
        link: str,
        step: Step | None,
        *,
        effect: str,
        parameters: tuple[Parameter, ...] = (),
        offsets: tuple[Parameter, ...] = (),
    ) -> "Model":
        """Return a model whose `link` ends with `step`; this is how an effect is added."""
        if link not in LINKS:
            raise InputError(f"Link {link!r} of effect {effect} must be one of {', '.join(LINKS)}.")
        taken = {p.name for p in self.parameters} & {p.name for p in parameters}
        if effect in self.effects or taken:
            raise InputError(f"Effect {effect} is already part of model {self.name}; add it once.")
        where = LINKS.index(link)
        split = sum(LINKS.index(name) <= where for name, _ in self.steps)
        added = () if step is None else ((link, step),)
        return replace(
            self,
            steps=self.steps[:split] + added + self.steps[split:],
            parameters=self.parameters + parameters,
            offsets=self.offsets + offsets,
            effects=(*self.effects, effect),
            before=self,
        )

    def with_columns(self, *columns: "str | Computed") -> "Model":
        """Return a model whose steps may read further columns, logged ones by name or computed ones."""
        state, computed = list(self.state), list(self.computed)
        for column in columns:
            name = column if isinstance(column, str) else column.name
            if name not in state:
                state.append(name)
                computed += [] if isinstance(column, str) else [column]
        return replace(self, state=tuple(state), computed=tuple(computed), before=self)

    def with_gauge(self, parameters: Iterable[str], text: str) -> "Model":
        """Return a model in which the mean of some parameters is a `Gauge`."""
        return replace(self, gauges=(*self.gauges, Gauge(tuple(parameters), text)), before=self)

    def with_parameters(self, changes: Mapping[str, Mapping[str, Any]]) -> "Model":
        """Return a model with other nominal values or bounds: `{"H1x": {"nominal": .2, "lower": .1}}`."""
        if not changes:
            return self
        known = [p.name for p in (*self.parameters, *self.offsets)]
        for name in changes:
            if name not in known:
                raise InputError(f"Model {self.name} has no parameter {name!r}{nearest(name, known)}.")

        def changed(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
            return tuple(replace(p, **dict(changes.get(p.name, {}))) for p in parameters)

        model = replace(self, parameters=changed(self.parameters), offsets=changed(self.offsets), before=self)
        for p in (*model.parameters, *model.offsets):
            if not p.lower <= p.upper:
                raise InputError(
                    f"Bounds of {p.name} must have lower <= upper; instead received {p.lower:g}, {p.upper:g}."
                )
        return model

    def poses(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return random poses (n_pose, count): typical ones times 1 +- 0.3; of size 1 if none are stated."""
        noise = rng.standard_normal((len(self.pose), count))
        if not self.typical:
            return noise
        return np.array(self.typical)[rng.integers(len(self.typical), size=count)].T * (1 + 0.3 * noise)

    @property
    def rest(self) -> dict[str, float]:
        """Default pose and state: the first typical pose if any is stated, else 0."""
        pose = self.typical[0] if self.typical else (0.0,) * len(self.pose)
        return dict(zip(self.pose, pose, strict=True)) | dict.fromkeys(self.state, 0.0)

    @cached_property
    def _remembered(self) -> dict[Hashable, Any]:
        return {}

    def remember(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return `make()`, made once for this model: `key` says all else that it depends on.

        A model extended in the same way is then the same model, and its expressions are built once.
        """
        if key not in self._remembered:
            self._remembered[key] = make()
        return self._remembered[key]

    # -- names and numbers -------------------------------------------------------------------------------

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of every parameter vector."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def nominal(self) -> np.ndarray:
        """Nominal values, shape (n_parameters,)."""
        return np.array([p.nominal for p in self.parameters], dtype=float)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds, each of shape (n_parameters,)."""
        return (
            np.array([p.lower for p in self.parameters], dtype=float),
            np.array([p.upper for p in self.parameters], dtype=float),
        )

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the parameter vector with `values` over the nominal ones; unknown names are an error."""
        for name in values:
            if name not in self.names:
                raise InputError(
                    f"Model {self.name} has no parameter {name!r}{nearest(name, list(self.names))}."
                )
        return np.array([values.get(p.name, p.nominal) for p in self.parameters], dtype=float)

    def named(self, values: np.ndarray) -> dict[str, float]:
        """Return a parameter vector (n,) as values by name."""
        return dict(zip(self.names, np.asarray(values, dtype=float).tolist(), strict=True))

    # -- expressions -------------------------------------------------------------------------------------

    @cached_property
    def _symbols(self) -> dict[tuple[str, str], ca.SX]:
        """Symbols of parameters, offsets and columns by kind and name, shared with the model before."""
        known = self.before._symbols if self.before else {}
        own = [("parameter", name) for name in (*self.names, *(z.name for z in self.offsets))]
        own += [("column", name) for name in (*self.pose, *self.state)]
        return {key: known[key] if key in known else ca.SX.sym(key[1]) for key in own}

    @cached_property
    def _after(self) -> list[Signals]:
        """The signals after each step that was asked for, as far as they can be copied."""
        before = self.before
        while before and "_after" not in before.__dict__:  # one that nobody has asked for
            before = before.before
        known = before._after if before else []
        pairs = zip(self.steps, before.steps if before else (), known, strict=False)
        return [signals for _, _, signals in takewhile(lambda pair: pair[0] is pair[1], pairs)]

    def signals(self, count: int) -> Signals:
        """Return the signals after the first `count` steps; they are the caller's own."""
        known = self._after[:count]
        signals = known[-1].copied() if known else Signals(())
        for column in (*self.pose, *self.state):
            signals.setdefault(column, self._symbols["column", column])
        for k in range(len(known), count):
            self.through(signals, k, k + 1)
            if len(self._after) == k:
                with suppress(TypeError):
                    self._after.append(signals.copied())
        return signals

    def forget(self) -> None:
        """Drop the expressions of the chain, which are built again when asked for; the symbols stay."""
        for name in ("_after", "symbols"):
            self.__dict__.pop(name, None)

    def through(self, signals: Signals, first: int, last: int) -> None:
        """Take signals through the steps `first` to `last` (exclusive)."""
        p = {name: symbol for (kind, name), symbol in self._symbols.items() if kind == "parameter"}
        for _, step in self.steps[first:last]:
            step(signals, p)

    @cached_property
    def symbols(self) -> "Symbols":
        """The symbols and the reading of the chain, with derived quantities still symbols of their own."""
        signals = self.signals(len(self.steps))
        derived = list(signals.derived.values())
        return Symbols(
            parameters=self.symbols_of("parameter", self.names),
            offsets=self.symbols_of("parameter", (z.name for z in self.offsets)),
            pose=self.symbols_of("column", self.pose),
            state=self.symbols_of("column", self.state),
            derived=column_of(s for s, _ in derived),
            derived_as=column_of(e for _, e in derived),
            reading=signals["reading"],
            gain=signals["gain"] if "gain" in signals else ca.SX.ones(len(self.channels)),
            displacement=signals["displacement"] if "displacement" in signals else ca.SX(0, 1),
        )

    def symbols_of(self, kind: str, names: Iterable[str]) -> ca.SX:
        """Return the symbols of one kind, parameters (and offsets) or columns, (names,)."""
        return column_of(self._symbols[kind, name] for name in names)

    @cached_property
    def reading(self) -> ca.Function:
        """Forward form `(parameters, offsets, pose, state) -> reading`, columns of SI values."""
        s = self.symbols
        return ca.Function(
            "reading",
            [s.parameters, s.offsets, s.pose, s.state],
            [s.full(s.reading)],
            ["parameters", "offsets", "pose", "state"],
            ["reading"],
        )

    @cached_property
    def gain(self) -> ca.Function:
        """Gain phi `(parameters, state) -> phi` of each channel."""
        s = self.symbols
        return ca.Function("gain", [s.parameters, s.state], [ca.densify(s.full(s.gain))])

    def zero_scale(self, p: np.ndarray, first_state: np.ndarray) -> np.ndarray:
        """Return the factor from a run's offsets (z,) to readings; for states (runs, n_state), (runs, z).

        phi(0) of Eq. (31) where they are displacements, one per channel; else 1.
        """
        if not self.offsets or self.symbols.displacement.numel() != len(self.offsets):
            return np.ones((*np.shape(first_state)[:-1], len(self.offsets)))
        gain = self.remember("gain, on arrays", lambda: on_arrays(self.gain))
        return np.asarray(gain(p, np.transpose(first_state))[0]).T

    @cached_property
    def decoded(self) -> ca.Function:
        """Decoupled form `(parameters, offsets, reading, state, weight) -> pose`.

        Newton's method on the forward form from `begin` or the zero pose: one step where a reading is linear
        in the pose (small angles: then this *is* Eq. (31)), three more where it is not. As in Eq. (31) each
        reading is divided by its gain, so that the matrix hardly depends on the state. With more channels
        than coordinates each step is the weighted least-squares one; `weight` is 1/variance per channel.
        """
        begin, slopes, solve, count = self._newton(near=False)
        inputs = begin.sx_in()
        pose = begin(*inputs)
        for _ in range(count):
            pose = solve(pose, inputs[-1], slopes(*inputs, pose))
        names = ["parameters", "offsets", "reading", "state", "weight"]
        return ca.Function("decoded", inputs, [pose], names, ["pose"])

    def readings(
        self, p: Columns, pose: Columns, state: Columns = (), offsets: Columns | None = None
    ) -> np.ndarray:
        """Return the readings (n_channels, samples) for arrays of samples, inputs as for `on_arrays`.

        `offsets`: of the runs, 0 by default.
        """
        read = self.remember("readings", lambda: on_arrays(self.reading))
        return read(p, np.zeros(len(self.offsets)) if offsets is None else offsets, pose, state)[0]

    def decode(
        self, p: Columns, offsets: Columns, reading: Columns, state: Columns, weight: Columns,
        near: Columns | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Return the pose (n_pose, samples) that `decoded` gives for arrays of samples; not finite: no pose.

        Inputs as for `on_arrays`. `near`: a pose on whose branch coordinates that repeat lie. Readings repeat
        with the pose; errors of the reference, such as its scale, do not.
        """
        branch = [] if near is None or not {*self.pose} & {*self.period} else [near]
        begin, steps = self.remember(("decode", bool(branch)), lambda: self._on_arrays(bool(branch)))
        inputs = [p, offsets, reading, state, *branch, weight]
        (pose,) = begin(*inputs)
        for slopes, solve in steps:
            (pose,) = solve(pose, weight, *slopes(*inputs, pose))
        return pose

    def _on_arrays(self, near: bool) -> tuple[Callable, list[tuple[Callable, Callable]]]:
        begin, slopes, solve, count = self._newton(near)
        return on_arrays(begin), [(on_arrays(slopes), on_arrays(solve))] * count if count else []

    def _newton(self, near: bool) -> tuple[ca.Function, ca.Function, ca.Function, int]:
        """Return where Newton's method begins, two parts of a step, and how many steps follow.

        A linear model begins with its step. Inputs of the beginning are those of `decoded`, the pose `near`
        before the weight if there is one; of the first part these and the pose. It returns residual and
        slopes of each channel in turn, so that few values are in use at once, for the second part.
        """
        s, size = self.symbols, len(self.channels)
        reading = s.full(s.reading)
        slope, gain = jacobian(reading, s.pose), ca.SX.ones(size)
        if size == len(self.pose):
            gain = gain * s.full(s.gain)
        measured, weight, branch = (
            ca.SX.sym(name, n) for name, n in (("reading", size), ("weight", size), ("near", len(self.pose)))
        )
        residual = self._within_half(measured - reading, self.channels) if near else measured - reading
        rows = ca.horzcat(residual, slope) / ca.repmat(gain, 1, 1 + slope.size2())
        inputs = [s.parameters, s.offsets, measured, s.state, *([branch] if near else []), weight]
        slopes = ca.Function("slopes", [*inputs, s.pose], [ca.cse(ca.densify(ca.vec(rows.T)))])
        flat = ca.SX.sym("rows", rows.numel())
        given = ca.reshape(flat, rows.size2(), size).T
        moved = s.pose + _solve(given[:, 1:], given[:, 0], weight)
        solve = ca.Function("solve", [s.pose, weight, flat], [ca.cse(ca.densify(moved))])
        pose: ca.SX = ca.SX.zeros(len(self.pose))
        if self.begin is not None:
            pose = self.begin(measured, dict(zip(self.names, ca.vertsplit(s.parameters), strict=True)))
        if near:
            pose = branch + self._within_half(pose - branch, self.pose)
        linear = not any(ca.which_depends(ca.vec(slope), s.pose, 1, False))
        first = solve(pose, weight, slopes(*inputs, pose)) if linear else ca.densify(pose)
        return ca.Function("begin", inputs, [first]), slopes, solve, 0 if linear else STEPS

    def _within_half(self, values: ca.SX, columns: tuple[str, ...]) -> ca.SX:
        """Return values of columns, periodic ones wrapped to half a period around zero."""
        periods = [self.period.get(c) for c in columns]
        return ca.vertcat(
            *(
                v - p * ca.floor(v / p + 0.5) if p else v
                for v, p in zip(ca.vertsplit(values), periods, strict=True)
            )
        )

    @cached_property
    def noise_gain(self) -> ca.Function:
        """d pose / d reading at rest, `(parameters, state, weight) -> (n_pose, n_channels)`."""
        s, weight = self.symbols, ca.SX.sym("weight", len(self.channels))
        slope = self.noise_gain_at(s.parameters, ca.SX.zeros(len(self.pose)), s.state, weight)
        return ca.Function("noise_gain", [s.parameters, s.state, weight], [ca.densify(slope)])

    @cached_property
    def noise_gain_at(self) -> ca.Function:
        """d pose / d reading, `(parameters, pose, state, weight) -> (n_pose, n_channels)`, offsets 0."""
        s, weight = self.symbols, ca.SX.sym("weight", len(self.channels))
        reading = ca.substitute(s.full(s.reading), s.offsets, ca.SX.zeros(len(self.offsets)))
        slope = _solve(jacobian(reading, s.pose), ca.SX.eye(len(self.channels)), weight)
        inputs = [s.parameters, s.pose, s.state, weight]
        return ca.Function("noise_gain_at", inputs, [ca.densify(slope)])

    @cached_property
    def combined(self) -> ca.Function:
        """Values of the readable combinations, `(parameters) -> (n_combinations,)`."""
        values = [
            c.value({name: self._symbols["parameter", name] for name in self.names})
            for c in self.combinations
        ]
        return ca.Function(
            "combined",
            [self.symbols_of("parameter", self.names)],
            [ca.densify(ca.vertcat(*values)) if values else ca.DM(0, 1)],
        )


def column_of(entries: Iterable[ca.SX]) -> ca.SX:
    """Return scalars as one column, of length 0 where there is none."""
    listed = list(entries)
    return ca.vertcat(*listed) if listed else ca.SX(0, 1)


@dataclass(frozen=True, eq=False)
class Symbols:
    """The symbolic chain of a model: its inputs as SX columns, and its outputs."""

    parameters: ca.SX
    offsets: ca.SX
    pose: ca.SX
    state: ca.SX
    derived: ca.SX
    derived_as: ca.SX
    reading: ca.SX
    gain: ca.SX
    displacement: ca.SX

    def full(self, expression: ca.SX) -> ca.SX:
        """Return `expression` with derived quantities replaced by their definitions."""
        if self.derived.numel() == 0:
            return expression
        return ca.substitute(expression, self.derived, self.derived_as)


def _solve(slope: ca.SX, residual: ca.SX, weight: ca.SX) -> ca.SX:
    """Solve `slope q = residual`: Cramer's rule for 3 x 3, weighted normal equations when overdetermined."""
    if slope.size1() > slope.size2():
        scaled = slope * ca.repmat(weight, 1, slope.size2())
        slope, residual = scaled.T @ slope, scaled.T @ residual
    if slope.size1() == 1:
        return residual / slope
    if slope.size1() != 3:
        return ca.solve(slope, residual)
    if residual.size2() > 1:
        return ca.horzcat(*(_solve(slope, column, weight) for column in ca.horzsplit(residual)))
    a, b, c = slope[:, 0], slope[:, 1], slope[:, 2]
    bc = ca.cross(b, c)
    determinant = ca.dot(a, bc)
    return (
        ca.vertcat(ca.dot(residual, bc), ca.dot(residual, ca.cross(c, a)), ca.dot(residual, ca.cross(a, b)))
        / determinant
    )


@dataclass(frozen=True, eq=False)
class Quantity:
    """A named scalar g(p) of the n parameters of a model, with exact derivatives.

    `lower`, `upper`: its bounds; infinite where only the bounds of the parameters apply.
    `symbol` (n,) and `expression` (scalar) define it in CasADi.
    """

    name: str
    unit: str
    lower: float
    upper: float
    symbol: ca.SX
    expression: ca.SX

    @cached_property
    def _at(self) -> Callable[..., list[np.ndarray]]:
        gradient = ca.gradient(self.expression, self.symbol)
        outputs = [ca.densify(self.expression), ca.densify(gradient)]
        return on_vectors(ca.Function("first", [self.symbol], outputs))

    @cached_property
    def _hessian(self) -> ca.Function:
        hessian, _ = ca.hessian(self.expression, self.symbol)
        return ca.Function("hessian", [self.symbol], [ca.densify(hessian)])

    @cached_property
    def linear(self) -> bool:
        """Whether the Hessian is zero everywhere."""
        return not any(ca.which_depends(self.expression, self.symbol, 2, False))

    def first(self, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the value and the gradient (n,) at `p` (n,)."""
        value, gradient = self._at(p)
        return float(value[0, 0]), gradient.ravel()

    def at(self, p: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the value, the gradient (n,) and the Hessian (n, n) at `p` (n,)."""
        hessian = np.zeros((len(p), len(p))) if self.linear else np.asarray(self._hessian(p))
        return *self.first(p), hessian


@lru_cache(maxsize=256)
def parameter(model: Model, name: str) -> Quantity:
    """Return one parameter of `model`, with its unit and bounds."""
    if name not in model.names:
        raise InputError(f"Model {model.name} has no parameter {name!r}{nearest(name, list(model.names))}.")
    k = model.names.index(name)
    p, symbol = model.parameters[k], model.symbols.parameters
    return Quantity(name, p.unit, p.lower, p.upper, symbol, symbol[k])


@lru_cache(maxsize=256)
def combination(model: Model, which: Combination) -> Quantity:
    """Return a named combination of `model`, such as a lever arm."""
    symbols = dict(zip(model.names, ca.vertsplit(model.symbols.parameters), strict=True))
    value = which.value(symbols)
    return Quantity(which.expression, which.unit, -np.inf, np.inf, model.symbols.parameters, value)


def linear(model: Model, gradient: Sequence[float] | np.ndarray, unit: str, name: str = "") -> Quantity:
    """Return the combination gradient . p; its name is its formula unless one is given."""
    factors = [float(factor) for factor in gradient]
    involved = [k for k, factor in enumerate(factors) if factor != 0.0]
    text = " + ".join(_term(factors[k], model.names[k]) for k in involved).replace("+ -", "- ")
    symbol = model.symbols.parameters
    value = sum((factors[k] * symbol[k] for k in involved), ca.SX(0))
    return Quantity(name or text, unit, -np.inf, np.inf, symbol, value)


def _term(factor: float, name: str) -> str:
    return name if factor == 1 else f"-{name}" if factor == -1 else f"{factor:.6g}*{name}"
