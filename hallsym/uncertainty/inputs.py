"""The inputs of a decoded position, each once: its uncertainty and where it enters.

A position is decoded from readings m and state s with parameters p and the offsets d of this reset, that come
from readings m0 averaged at a known pose q0 and state s0 (docs/budget.md):

    m0 = f(p, d, q0, s0)   gives d,      m = f(p, d, q, s)   gives q.

The linear budget and Monte Carlo use the same list of inputs; only the fitted parameters, which are
correlated, are separate.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest, require
from hallsym.estimation import Fit
from hallsym.estimation.prediction import reading_variance
from hallsym.families import adapted, plain
from hallsym.files import read_json
from hallsym.model import Model
from hallsym.model.arrays import estimator, on_arrays
from hallsym.model.influence import influence, reading_slopes
from hallsym.toml import Table, number, unit_of, whole
from hallsym.uncertainty.gum import Source, coverage_of
from hallsym.units import si_unit, split_unit

SECTIONS = ("coverage_factor", "level", "reading", "zeroing", "state", "reference")


Zeroed = tuple[np.ndarray, np.ndarray]
"""Pose (n_pose,) and state (n_state,) of the zeroing."""


@dataclass(frozen=True, eq=False)
class Settings:
    """Settings of a position measurement, in SI; everything has a default.

    `averaged`: readings averaged in one position. `adc_step`: step of the converter in the unit of a
    reading, 0 for none. `zero_averaged`: readings averaged at the zeroing. `zero_pose_std`: pose column ->
    standard uncertainty of the pose at the zeroing; the noise of the reference, averaged as the readings
    are, where not given. `zero_at`: pose or state column -> where the zeroing is done, 0 where not given.
    `state_std`: state column -> standard uncertainty besides noise, of the vertical sensors since the
    calibration. `scale_std`: pose column -> relative standard uncertainty of the scale of the reference.
    `model_error`: of a diagnosis. `coverage` and `level` as in `Budget`.
    """

    averaged: int = 1
    adc_step: float = 0.0
    zero_averaged: int = 1
    zero_pose_std: Mapping[str, float] = field(default_factory=dict)
    zero_at: Mapping[str, float] = field(default_factory=dict)
    state_std: Mapping[str, float] = field(default_factory=dict)
    scale_std: Mapping[str, float] = field(default_factory=dict)
    model_error: "ModelError | None" = None
    coverage: float = 2.0
    level: float | None = None

    def checked(self, model: Model) -> "Settings":
        """Return these settings; columns that `model` has not and impossible numbers are an `InputError`."""
        for name in ("averaged", "zero_averaged"):
            whole(getattr(self, name), name, "the budget's settings")
        number(self.adc_step, "adc_step", "the budget's settings", 0.0)
        columns = {
            "zero_pose_std": model.pose,
            "zero_at": (*model.pose, *model.state),
            "state_std": model.state,
            "scale_std": model.pose,
        }
        for name, allowed in columns.items():
            for column, value in getattr(self, name).items():
                wanted = f"of columns of {model.name} ({', '.join(allowed)})"
                require(column in allowed, f"Setting '{name}'", wanted, column, allowed)
                number(value, column, f"setting '{name}'", -np.inf if name == "zero_at" else 0.0)
        return self


def read_settings(path: str | Path, model: Model) -> Settings:
    """Read `[reading]`, `[zeroing]`, `[zeroing.at]`, `[state]` and `[reference]` from TOML (docs/budget.md).

    Units are in the keys: `adc_step_nm`, `z_nm`, `x_scale_ppm`. Raises `InputError` for a missing file,
    unknown keys and impossible numbers.
    """
    file = Table.read(path, "Settings file", SECTIONS)
    coverage, level = coverage_of(file)
    reading, zeroing, state, reference = (
        file.table(key) for key in ("reading", "zeroing", "state", "reference")
    )
    at = zeroing.table("at")
    return Settings(
        averaged=reading.whole("averaged", 1),
        adc_step=_adc_step(reading, model),
        zero_averaged=zeroing.whole("averaged", 1),
        zero_pose_std=_sizes(zeroing, model.pose, ("averaged", "at")),
        zero_at={c: at.number(key) * factor for key, c, factor in at.columns((*model.pose, *model.state))},
        state_std=_sizes(state, model.state),
        scale_std=_scales(reference, model),
        coverage=coverage,
        level=level,
    )


def _sizes(raw: Table, columns: tuple[str, ...], but: tuple[str, ...] = ()) -> dict[str, float]:
    return {c: raw.number(key, least=0.0) * factor for key, c, factor in raw.columns(columns, but)}


def _scales(raw: Table, model: Model) -> dict[str, float]:
    """`x_scale_ppm = 2` for each pose coordinate."""
    stems = {f"{split_unit(column)[0]}_scale": column for column in model.pose}
    found = {}
    for key in raw.raw:
        stem, _, suffix = key.rpartition("_")
        if stem not in stems or suffix not in ("ppm", "percent"):
            wanted = [f"{s}_ppm" for s in stems]
            raise InputError(
                f"Unknown key {key!r} in {raw.where}{nearest(key, wanted)}; known are {', '.join(wanted)}."
            )
        found[stems[stem]] = raw.number(key, least=0.0) * unit_of(suffix, raw.where)[1]
    return found


def _adc_step(raw: Table, model: Model) -> float:
    """Return the step of the converter [SI], 0 for none: `adc_step_nm` in any unit of a reading."""
    keys = [key for key in raw.raw if key.startswith("adc_step_")]
    Table({k: v for k, v in raw.raw.items() if k not in keys[:1]}, raw.where, ("averaged", "adc_step_nm"))
    units = {si_unit(column) for column in model.channels} - {""}
    for key in keys:
        si, factor = unit_of(key.removeprefix("adc_step_"), raw.where)
        if si not in units:
            raise InputError(f"'{key}' of {raw.where} must be in the unit of a reading ({', '.join(units)}).")
        return raw.number(key, least=0.0) * factor
    return 0.0


GAIN_FACTOR = 2.0
"""A gain whose distance from 0 is below this many of its standard uncertainties is not decoded."""

Place = tuple[str, int]
"""Where an input enters: "reading", "state", "zero reading", "zero state", "zero pose" or "scale"; index."""


@dataclass(frozen=True)
class Input:
    """One independent input: its source (sensitivity 1 so far) and the places it enters with equal weight."""

    source: Source
    places: tuple[Place, ...]


@dataclass(frozen=True, eq=False)
class Slopes:
    """Total slopes of the decoded pose at s samples, the zeroing included, in SI per SI.

    `parameters`: (s, n_pose, n). `places`: place -> (s, n_pose, size of the place). `left`: variances of the
    error of the model, (s, n_pose), by source; none without a diagnosis.
    """

    parameters: np.ndarray
    places: Mapping[str, np.ndarray]
    left: Mapping[str, np.ndarray]

    def of(self, source: Input) -> np.ndarray:
        """Slopes with respect to one input, shape (s, n_pose)."""
        total = np.zeros(self.parameters.shape[:2])
        for place, index in source.places:
            total = total + self.places[place][:, :, index]
        return total


def check_fit(fit: Fit) -> None:
    """Refuse a calibration that has no covariance to propagate."""
    if not np.all(np.isfinite(fit.values)):
        raise InputError("The calibration holds values that are no numbers; fit the log again.")
    spread = np.diag(fit.covariance)
    if not np.all(np.isfinite(fit.covariance)) or np.any(spread < 0):
        raise InputError(
            "The covariance of the calibration holds values that cannot be; fit a log with more motion."
        )
    if not np.any(spread > 0):
        raise InputError(
            "The calibration has no determined parameter, so its covariance cannot be formed; "
            "fit a log that moves the machine."
        )


def independent_inputs(fit: Fit, settings: Settings) -> tuple[Input, ...]:
    """Return every independent input that has an uncertainty, in the order of a budget table."""
    return tuple(i for i in _all_inputs(fit, settings.checked(fit.model)) if i.source.std > 0)


def _all_inputs(fit: Fit, settings: Settings) -> Iterator[Input]:
    model, noise, zeroed = fit.model, fit.noise.std, 1 / np.sqrt(settings.zero_averaged)
    once = {c: s / np.sqrt(settings.averaged) for c, s in noise.items()}
    first = {c: s * zeroed for c, s in noise.items()}
    half = dict.fromkeys(model.channels, 0.5 * settings.adc_step)
    known = {c: first.get(r, 0.0) for c, r in zip(model.pose, model.references, strict=True)}
    normal, uniform = Source.normal, Source.rectangular
    both = ("state", "zero state") if model.offsets else ("state",)
    listed: list[tuple[Callable[..., Source], str, tuple[str, ...], Mapping[str, float], tuple[str, ...]]] = [
        (normal, "{} noise", model.channels, once, ("reading",)),
        (uniform, "{} ADC step", model.channels, half, ("reading",)),
        (normal, "{} noise", model.state, once, ("state",)),
        (normal, "{} sensor", model.state, settings.state_std, both),
        (normal, "reference scale {}", model.pose, settings.scale_std, ("scale",)),
    ]
    if model.offsets:
        listed += [
            (normal, "zeroing: {} noise", model.channels, first, ("zero reading",)),
            (uniform, "zeroing: {} ADC step", model.channels, half, ("zero reading",)),
            (normal, "zeroing: {} noise", model.state, first, ("zero state",)),
            (normal, "zeroing: pose {}", model.pose, known | dict(settings.zero_pose_std), ("zero pose",)),
        ]
    for make, text, columns, std, places in listed:
        for k, column in enumerate(columns):
            unit = "" if places == ("scale",) else si_unit(column)
            source = make(text.format(split_unit(column)[0]), std.get(column, 0.0), unit or "1")
            yield Input(source, tuple((place, k) for place in places))


def slopes(fit: Fit, pose: np.ndarray, state: np.ndarray, settings: Settings) -> Slopes:
    """Return the slopes of the decoded pose at `pose` (n_pose, s) and `state` (n_state, s).

    Refuses a calibration without covariance, and a state at which a gain crosses zero: nothing can be decoded
    there.
    """
    check_fit(fit)
    check_gain(fit, state, settings)
    model, zero, weight = fit.model, zero_point(fit.model, settings), 1 / reading_variance(fit)
    found = influence(model, fit.values, np.zeros(len(model.offsets)), pose, state, weight)
    moved, by_parameters = np.asarray(pose).T - zero[0], found.parameters  # (s, n_pose, ...)
    places = {
        "reading": found.readings,
        "state": found.state,
        "scale": moved[:, :, None] * np.eye(len(model.pose)),
    }
    if model.offsets:
        none = np.zeros(len(model.offsets))
        by_p, by_zero, by_pose, by_state = reading_slopes(
            model, fit.values, none, *(v[:, None] for v in zero)
        )
        # through the offsets, which a reset determines
        by_reading = found.offsets @ estimator(by_zero, weight)
        places |= {"zero reading": by_reading, "zero state": -by_reading @ by_state}
        places |= {"zero pose": -by_reading @ by_pose}
        by_parameters = by_parameters - by_reading @ by_p
    error = settings.model_error
    left = {} if error is None else error.variances(fit, pose, state, zero, places)
    return Slopes(by_parameters, places, left)


def zero_point(model: Model, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Pose (n_pose,) and state (n_state,) of the zeroing."""
    at = settings.zero_at
    return np.array([at.get(c, 0.0) for c in model.pose]), np.array([at.get(c, 0.0) for c in model.state])


@lru_cache(maxsize=64)
def offsets_at_reset(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, reading, pose, state, weight) -> offsets` of a reset by weighted least squares."""
    s = model.symbols
    reading, weight = (ca.SX.sym(name, len(model.channels)) for name in ("reading", "weight"))
    full = s.full(s.reading)
    at_zero = ca.substitute(full, s.offsets, ca.SX.zeros(s.offsets.numel()))
    B = ca.jacobian(full, s.offsets)
    BW = (B * ca.repmat(weight, 1, B.size2())).T
    offsets = ca.densify(ca.solve(BW @ B, BW @ (reading - at_zero)))
    return on_arrays(ca.Function("offsets", [s.parameters, reading, s.pose, s.state, weight], [offsets]))


def check_gain(fit: Fit, state: np.ndarray, settings: Settings) -> None:
    """Refuse states (n_state, s) where a gain is not clearly on the side of zero it has at the reset."""
    model = fit.model
    if not model.state:  # a constant gain cannot cross zero
        return
    _, s0 = zero_point(model, settings)
    states = np.column_stack([s0, np.asarray(state, dtype=float).reshape(len(s0), -1)])
    gain, flat = _gain_slopes(model)(fit.values, states)
    slope = np.moveaxis(flat.reshape(len(fit.values), len(model.channels), -1), 0, 2)  # (channels, s, n)
    std = np.sqrt(np.maximum(np.einsum("csj,jk,csk->cs", slope, fit.covariance, slope), 0.0))
    clear = gain * np.sign(gain[:, :1]) - GAIN_FACTOR * std
    if np.all(clear > 0):
        return
    k, worst = np.unravel_index(np.argmin(clear), clear.shape)
    where = ", ".join(f"{c} = {v:.4g}" for c, v in zip(model.state, states[:, worst], strict=True))
    raise InputError(
        f"The gain of {model.channels[k]} at {where} is {gain[k, worst]:.3g} +- {std[k, worst]:.2g} "
        f"({gain[k, 0]:.3g} at the zeroing): it crosses zero, so no position can be decoded; "
        "stay nearer to the heights of the calibration."
    )


@lru_cache(maxsize=64)
def _gain_slopes(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, state) -> gain, d gain / d parameters` on arrays of states."""
    s = model.symbols
    gain = s.full(s.gain)
    outputs = [ca.densify(gain), ca.densify(ca.jacobian(gain, s.parameters))]
    return on_arrays(ca.Function("gain_slopes", [s.parameters, s.state], outputs))


# -- model error, from a diagnosis -------------------------------------------------------------------------

# An error that is known and not corrected counts in full (JCGM 100, F.2.4.5). Models that are not excluded
# differ in the position that they decode; their scatter, weighed by their probabilities, is the uncertainty
# of having selected one of them (Hoeting et al. 1999, doi:10.1214/ss/1009212519).

BAND = 1.96
"""Half-width of the bands of a shape over their standard uncertainty."""
SHAPE, REST, SELECTED = "model error: shape", "model error: rest", "model selection"
"""Names of the sources."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Shape of the residual of each reading over a coordinate, a column of the pose or the state.

    `grid`: (g,) ascending places [SI]. `value`, `std`: (K, g) in the unit of the reading, or relative to it
    for a `gain`. `period`: of the coordinate, None for a line.
    """

    column: str
    grid: np.ndarray
    value: np.ndarray
    std: np.ndarray
    gain: bool
    period: float | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that the log does not exclude, its `values` (n,) and its probability."""

    model: Model
    values: np.ndarray
    weight: float


@dataclass(frozen=True, eq=False)
class ModelError:
    """Contributions of a diagnosis to the budget of a position.

    `rest`: pose column -> standard uncertainty of the unexplained residual without a shape [SI].
    """

    rest: Mapping[str, float]
    shape: Shape | None
    candidates: tuple[Candidate, ...]

    def variances(
        self, fit: Fit, pose: np.ndarray, state: np.ndarray, zero: Zeroed, places: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return the variance of each source, (s, n_pose), at poses (n_pose, s) and states (n_state, s).

        `zero`: pose and state of the zeroing. `places`: place -> slopes (s, n_pose, size), as of `Slopes`.
        """
        model = fit.model
        rest = np.array([self.rest.get(c, 0.0) for c in model.pose])
        found = {REST: np.tile(rest**2, (pose.shape[1], 1))}
        if self.shape is not None:
            found[SHAPE] = _shaped(self.shape, fit, pose, state, places["reading"])
        if len(self.candidates) > 1:
            found[SELECTED] = self._between(fit, pose, state, zero, places)
        return {name: v for name, v in found.items() if np.any(v > 0)}

    def _between(
        self, fit: Fit, pose: np.ndarray, state: np.ndarray, zero: Zeroed, places: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Variance between the positions that the candidates decode from the same reading and zeroing."""
        model, weight = fit.model, np.array([c.weight for c in self.candidates])
        moved = []
        for c in self.candidates:
            there = np.einsum("spk,ks->sp", places["reading"], _reading(c, model, pose, state))
            if model.offsets:
                first = _reading(c, model, zero[0][:, None], zero[1][:, None])[:, 0]
                there = there + places["zero reading"] @ first
            moved.append(there)
        share = weight / weight.sum()
        mean = np.einsum("m,msp->sp", share, moved)
        return np.asarray(np.einsum("m,msp->sp", share, (np.array(moved) - mean) ** 2))


def _reading(c: Candidate, model: Model, pose: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Readings (K, s) of a candidate; columns that only it reads are at rest."""
    known = dict(zip(model.state, state, strict=True))
    own = [known.get(n, np.full(pose.shape[1], c.model.rest[n])) for n in c.model.state]
    return np.broadcast_to(c.model.readings(c.values, pose, own), (len(model.channels), pose.shape[1]))


def _shaped(shape: Shape, fit: Fit, pose: np.ndarray, state: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Square of the error by a shape, and the variance of the shape itself, (s, n_pose)."""
    model = fit.model
    x = np.vstack([pose, state])[(*model.pose, *model.state).index(shape.column)]

    def over(rows: np.ndarray) -> np.ndarray:
        return np.array([np.interp(x, shape.grid, row, period=shape.period) for row in rows])

    value, std = over(shape.value), over(shape.std)
    if shape.gain:
        reading = model.readings(fit.values, pose, state)
        value, std = value * reading, std * reading
    error = np.einsum("spk,ks->sp", slope, value)
    return np.asarray(error**2 + np.einsum("spk,ks->sp", slope**2, std**2))


# -- the record of a diagnosis -------------------------------------------------------------------------------


def read_model_error(path: str | Path, model: Model) -> ModelError:
    """Read a file of `hallsym diagnose -o FILE.json`; `model`: of the calibration of the budget.

    Raises `InputError` for a missing file, another record or a diagnosis of another model.
    """
    name = Path(path).name
    data = read_json(path, "Diagnosis", "diagnose the log again")
    if not isinstance(data, dict) or "model_error" not in data:
        raise InputError(
            f"{name} holds no diagnosis with a model error; give what 'hallsym diagnose LOG -o FILE.json' "
            "saved."
        )
    if data.get("model") != model.name:
        raise InputError(
            f"{name} is a diagnosis of {data.get('model')}, the calibration is of {model.name}; "
            "diagnose the log with that model."
        )
    try:
        said, curve = data["model_error"], (data.get("unexplained") or {}).get("curve")
        tried = [(adapted(plain(model), tuple(c["effects"]), {}), c) for c in said["candidates"]]
        return ModelError(
            rest={c: float(v) for c, v in said["rest"].items()},
            shape=_shape(curve, model) if curve and said["shape_counts"] else None,
            candidates=tuple(Candidate(m, m.vector(c["values"]), float(c["weight"])) for m, c in tried),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"The model error in {name} cannot be read ({error!r}); diagnose again.") from error


def _shape(curve: Mapping[str, Any], model: Model) -> Shape:
    column = str(curve["column"]).removeprefix("d0_")
    column = dict(zip(model.references, model.pose, strict=True)).get(column, column)
    bands = [curve["readings"][c] for c in model.channels]
    value, low, high = (np.array([b[key] for b in bands], dtype=float) for key in ("value", "low", "high"))
    return Shape(
        column=column,
        grid=np.array(curve["grid"], dtype=float),
        value=value,
        std=(high - low) / (2 * BAND),
        gain=curve["kind"] == "gain",
        period=model.period.get(column),
    )
