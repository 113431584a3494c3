"""What a decoded position is computed from, each input once: its uncertainty and where it enters.

A position is decoded from readings m and state s with parameters p and the zeros d of this reset, which come
from readings m0 averaged at a known pose q0 and state s0 (docs/budget.md):

    m0 = f(p, d, q0, s0)   gives d,      m = f(p, d, q, s)   gives q.

The linear budget and Monte Carlo walk the same list of inputs; only the fitted parameters, which are
correlated, stand beside it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import Fit
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.influence import influence
from hallsym.uncertainty.gum import Source
from hallsym.uncertainty.settings import Settings
from hallsym.units import split_unit

GAIN_FACTOR = 2.0
"""A gain whose distance from 0 is below this many of its standard uncertainties is not decoded."""

Place = tuple[str, int]
"""Where an input enters: "reading", "state", "zero reading", "zero state", "zero pose" or "scale"; index."""


@dataclass(frozen=True)
class Input:
    """One independent input: its source (sensitivity 1 as yet) and the places it enters, all alike."""

    source: Source
    places: tuple[Place, ...]


@dataclass(frozen=True, eq=False)
class Slopes:
    """Total slopes of the decoded pose at s samples, the zeroing included, in SI per SI.

    `parameters`: (s, n_pose, n). `places`: place -> (s, n_pose, size of the place).
    """

    parameters: np.ndarray
    places: Mapping[str, np.ndarray]

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
    model = fit.model
    noise = {column: sigma.value for column, sigma in fit.noise.sigmas.items()}

    def make(name: str, std: float, column: str, *places: Place, adc: bool = False) -> Input:
        unit = _unit(column)
        source = Source.rectangular(name, std, unit) if adc else Source.normal(name, std, unit)
        return Input(source, places)

    half = 0.5 * settings.adc_step
    once, zeroed = 1 / np.sqrt(settings.averaged), 1 / np.sqrt(settings.zero_averaged)
    for k, column in enumerate(model.channels):
        yield make(f"{word(column)} noise", noise.get(column, 0.0) * once, column, ("reading", k))
    for k, column in enumerate(model.channels):
        yield make(f"{word(column)} ADC step", half, column, ("reading", k), adc=True)
    for k, column in enumerate(model.state):
        yield make(f"{word(column)} noise", noise.get(column, 0.0) * once, column, ("state", k))
    for k, column in enumerate(model.state):
        both: tuple[Place, ...] = (("state", k), ("zero state", k)) if model.zeros else (("state", k),)
        yield make(f"{word(column)} sensor", settings.state_std.get(column, 0.0), column, *both)
    for k, column in enumerate(model.pose):
        scale = settings.scale_std.get(column, 0.0)
        yield Input(Source.normal(f"reference scale {word(column)}", scale, "1"), (("scale", k),))
    if not model.zeros:
        return
    for k, column in enumerate(model.channels):
        std = noise.get(column, 0.0) * zeroed
        yield make(f"zeroing: {word(column)} noise", std, column, ("zero reading", k))
    for k, column in enumerate(model.channels):
        yield make(f"zeroing: {word(column)} ADC step", half, column, ("zero reading", k), adc=True)
    for k, column in enumerate(model.state):
        std = noise.get(column, 0.0) * zeroed
        yield make(f"zeroing: {word(column)} noise", std, column, ("zero state", k))
    for k, (column, reference) in enumerate(zip(model.pose, model.references, strict=True)):
        std = settings.zero_pose_std.get(column, noise.get(reference, 0.0) * zeroed)
        yield make(f"zeroing: pose {word(column)}", std, column, ("zero pose", k))


def slopes(fit: Fit, pose: np.ndarray, state: np.ndarray, settings: Settings) -> Slopes:
    """Return the slopes of the decoded pose at `pose` (n_pose, s) and `state` (n_state, s).

    Refuses a state at which a gain crosses zero: nothing can be decoded there.
    """
    model = fit.model
    check_gain(fit, state, settings)
    found = influence(model, fit.values, np.zeros(len(model.zeros)), pose, state, weights(fit))
    q0, _ = zero_point(model, settings)
    moved = np.asarray(pose).T - q0  # (s, n_pose)
    places = {
        "reading": found.readings,
        "state": found.state,
        "scale": moved[:, :, None] * np.eye(len(model.pose)),
    }
    if not model.zeros:
        return Slopes(found.parameters, places)
    zero = zero_slopes(fit, settings)
    places |= {f"zero {name}": found.zeros @ zero[name] for name in ("reading", "state", "pose")}
    return Slopes(found.parameters + found.zeros @ zero["parameters"], places)


def model_error(
    fit: Fit, pose: np.ndarray, state: np.ndarray, settings: Settings, found: Slopes
) -> dict[str, np.ndarray]:
    """Return the variances (s, n_pose) of the error of the model by source; none without a diagnosis."""
    if settings.model_error is None:
        return {}
    zero = zero_point(fit.model, settings)
    return settings.model_error.variances(fit, pose, state, zero, found.places)


def zero_point(model: Model, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Pose (n_pose,) and state (n_state,) of the zeroing."""
    at = settings.zero_at
    return np.array([at.get(c, 0.0) for c in model.pose]), np.array([at.get(c, 0.0) for c in model.state])


def zero_slopes(fit: Fit, settings: Settings) -> dict[str, np.ndarray]:
    """Slopes of the zeros found at the reset: d zeros / d (reading, parameters, pose, state) there."""
    q0, s0 = zero_point(fit.model, settings)
    values = _zero_functions(fit.model)[1](fit.values, q0, s0, weights(fit))
    names = ("reading", "parameters", "pose", "state")
    return dict(zip(names, map(np.asarray, values), strict=True))


def zeros_found(model: Model) -> ca.Function:
    """`(parameters, reading, pose, state, weight) -> zeros` of a reset: readings are linear in the zeros."""
    return _zero_functions(model)[0]


@lru_cache(maxsize=64)
def _zero_functions(model: Model) -> tuple[ca.Function, ca.Function]:
    """The zeros of a reset by weighted least squares, and their slopes at a reset without deviation."""
    s = model.symbols
    reading, weight = (ca.SX.sym(name, len(model.channels)) for name in ("reading", "weight"))
    full = s.full(s.reading)
    at_zero = ca.substitute(full, s.zeros, ca.SX.zeros(s.zeros.numel()))
    B = ca.jacobian(full, s.zeros)
    BW = (B * ca.repmat(weight, 1, B.size2())).T
    zeros = ca.densify(ca.solve(BW @ B, BW @ (reading - at_zero)))
    inputs_ = [s.parameters, reading, s.pose, s.state, weight]
    found = ca.Function("zeros", inputs_, [zeros])
    slopes_ = [
        ca.densify(ca.substitute(ca.jacobian(zeros, by), reading, at_zero))
        for by in (reading, s.parameters, s.pose, s.state)
    ]
    return found, ca.Function("zero_slopes", [s.parameters, s.pose, s.state, weight], slopes_)


def weights(fit: Fit) -> np.ndarray:
    """1/variance of each channel, as `fit` decodes."""
    return np.array([fit.noise[c].value ** -2 for c in fit.model.channels])


def check_gain(fit: Fit, state: np.ndarray, settings: Settings) -> None:
    """Refuse states (n_state, s) where a gain is not clearly on the side of zero it has at the reset."""
    model = fit.model
    if not model.state:  # a gain that follows nothing cannot cross zero
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


def _unit(column: str) -> str:
    unit = split_unit(column)[1]
    return unit.si if unit else "1"


def word(column: str) -> str:
    """`hall_a_m` is hall_a, `z_m` is z."""
    return split_unit(column)[0]
