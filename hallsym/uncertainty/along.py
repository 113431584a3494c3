"""Error model: errors of the decoded pose by known causes along one coordinate, alone and together."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.families import effect_named
from hallsym.families import plain as without_effects
from hallsym.log.phase import near
from hallsym.model import Model, on_arrays
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.uncertainty.position import place

LEAST_SQUARES, CLOSED_FORM = "least-squares", "closed-form"
"""Decoders that every model may have, beside the formulas that it states by name."""
NOTHING = 1e-9
"""Error [m or rad] that counts as none: a decoder that has converged rounds below it."""
EQUAL, ROUNDING = 1e-6, 1e-12
"""Part of an error's range, and size [m or rad], by which extremes of a wave differ by rounding."""
PLACES = 360
"""Places along a period; a range that is none has its end too."""


@dataclass(frozen=True, eq=False)
class ErrorsAlong:
    """Errors of the decoded pose of one machine along a coordinate.

    `at`: (n,) places of `coordinate` [SI]. `error`: (n_pose, n) decoded less true [SI]. `waves`: of each
    coordinate of the pose, the number of waves over the range that is largest; 0 where the error is constant.
    `ends`: of the range.
    """

    coordinate: str
    at: np.ndarray
    error: np.ndarray
    waves: tuple[int, ...]
    ends: tuple[float, float]

    @property
    def peak(self) -> np.ndarray:
        """Largest deviation of each error from its mean, (n_pose,)."""
        return np.abs(self.error - self.error.mean(axis=1, keepdims=True)).max(axis=1)

    @property
    def rms(self) -> np.ndarray:
        """Root of the mean square of each error, its mean included, (n_pose,)."""
        return np.sqrt((self.error**2).mean(axis=1))

    def extremes(self, k: int) -> Iterator[tuple[float, float]]:
        """Largest and least error of coordinate `k` of the pose, each with its place."""
        same = EQUAL * float(np.ptp(self.error[k])) + ROUNDING
        for sign in (1.0, -1.0):
            e = sign * self.error[k]
            at = int(np.argmax(e >= e.max() - same))  # the first of those that are equal but for rounding
            yield float(self.error[k, at]), float(self.at[at])


def errors_along(
    model: Model,
    values: Mapping[str, float],
    *,
    over: tuple[str, float, float] | None = None,
    at: Mapping[str, float] | None = None,
    plain: Model | None = None,
    decoder: str = LEAST_SQUARES,
    samples: int = PLACES,
) -> ErrorsAlong:
    """Return the error that a machine with `values` of the parameters of `model` makes along a coordinate.

    No noise, no zero deviations. `over`: coordinate of pose or state, from and to [SI], a period without its
    end; one of the first that repeats by default. `at`: where the others rest [SI]; a typical pose of the
    model by default, state 0. `plain`: the model whose nominal values decode, `model` without effects by
    default. `decoder`: "least-squares" over all channels, "closed-form", or a formula of the model. Raises
    `InputError`.
    """
    plain = without_effects(model) if plain is None else plain
    over = over or next(((c, 0.0, model.period[c]) for c in model.pose if c in model.period), None)
    if over is None:
        raise InputError(f"No coordinate of {model.name} repeats: state the range to look at.")
    coordinate, low, high = over
    whole = bool(np.isclose(high - low, model.period.get(coordinate, 0.0)))
    places = np.linspace(low, high, samples + (not whole), endpoint=not whole)
    rest = place(model, {coordinate: 0.0} | dict(at or {}))
    pose, state = (np.tile(values[:, None], len(places)) for values in rest)
    for names, true in ((model.pose, pose), (model.state, state)):
        if coordinate in names:
            true[names.index(coordinate)] = places
    errors = decoding_errors(model, plain, pose, state, "state smaller deviations", decoder)
    error = errors(model.vector(values)[None])[:, 0]
    return ErrorsAlong(coordinate, places, error, tuple(_waves(e) for e in error), (low, high))


Errors = Callable[[np.ndarray], np.ndarray]


def decoding_errors(
    model: Model, plain: Model, pose: np.ndarray, state: np.ndarray, remedy: str, decoder: str = LEAST_SQUARES
) -> Errors:
    """Return `errors(machines)`: decoded minus true pose, (n_pose, m, points), for machines (m, n).

    A machine reads with its own parameters of `model` at `pose` (n_pose, points) and `state`, and is decoded
    with the nominal values of `plain`. No noise and no zero deviations. `remedy`: what to do where a reading
    gives no pose.
    """
    decode = _decode(plain, decoder)
    kept = [state[model.state.index(c)] for c in plain.state]

    def errors(machines: np.ndarray) -> np.ndarray:
        own = [column[:, None] for column in machines.T]
        found = decode(model.readings(own, pose, state), kept)
        if not np.isfinite(found).all():
            raise InputError(f"The decoder of {plain.name} finds no pose for some of the readings: {remedy}.")
        return near(plain, found, pose[:, None]) - pose[:, None]

    return errors


def _decode(plain: Model, decoder: str) -> Callable[[np.ndarray, list[np.ndarray]], np.ndarray]:
    """Return `decode(readings, states) -> pose` of a decoder by its name, with the nominal values."""
    known = [LEAST_SQUARES, *([CLOSED_FORM] if plain.begin else []), *plain.formulas]
    if decoder not in known:
        raise InputError(
            f"Model {plain.name} has no decoder {decoder!r}{nearest(decoder, known)}; it has "
            f"{', '.join(known)}."
        )
    if decoder == LEAST_SQUARES:
        offsets, weight = np.zeros(len(plain.offsets)), np.ones(len(plain.channels))
        return lambda reading, state: plain.decode(plain.nominal, offsets, reading, state, weight)
    formula: Any = plain.begin if decoder == CLOSED_FORM else plain.formulas[decoder]
    v = ca.SX.sym("v", len(plain.channels))
    named = {n: ca.SX(a) for n, a in plain.named(plain.nominal).items()}
    closed = on_arrays(ca.Function("closed", [v], [ca.densify(formula(v, named))]))
    return lambda reading, state: closed(reading)[0]


def _waves(error: np.ndarray) -> int:
    """Return the number of waves over the range that is largest; 0 where the error is constant."""
    spectrum = np.abs(np.fft.rfft(error - error.mean())) / len(error)
    return int(spectrum.argmax()) if 2 * spectrum.max() > NOTHING else 0


@dataclass(frozen=True, eq=False, repr=False)
class ErrorModel(Shown):
    """Errors along a coordinate by cause: `causes` (name, values, errors), each alone, then all together."""

    model: Model
    decoder: str
    at: Mapping[str, float]
    causes: tuple[tuple[str, Mapping[str, float], ErrorsAlong], ...]

    @property
    def coordinate(self) -> str:
        """The coordinate that moves."""
        return self.causes[0][2].coordinate

    @property
    def expected_waves(self) -> dict[int, tuple[str, ...]]:
        """Waves per period -> effects of the family that cause them; empty where the range is no period."""
        low, high = self.causes[0][2].ends
        whole = np.isclose(high - low, self.model.period.get(self.coordinate, 0.0))
        return self.model.family.waves if whole else {}

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready record in SI units."""
        pose = self.model.pose
        return {
            "model": self.model.name,
            "decoder": self.decoder,
            "over": self.coordinate,
            "at": dict(self.at),
            "places": self.causes[0][2].at.tolist(),
            "causes": [
                {
                    "name": name,
                    "values": dict(values),
                    "rms": named(pose, e.rms),
                    "peak": named(pose, e.peak),
                    "waves": dict(zip(pose, e.waves, strict=True)),
                    "error": named(pose, e.error),
                }
                for name, values, e in self.causes
            ],
            "expected_waves": {str(n): list(names) for n, names in self.expected_waves.items()},
        }


TOGETHER = "all together"
DEVIATION = "other values"
"""Names of further causes: all effects together, and parameters that differ from the decoder's."""


def error_model(model: Model, values: Mapping[str, float], **about: Any) -> ErrorModel:
    """Return the errors that each effect of `model` makes alone at `values`, and all together.

    `values` of parameters without an effect make the machine differ from what decodes it. `about`: as for
    `errors_along`. Raises `InputError` for an effect without a value.
    """
    plain = about.pop("plain", None) or without_effects(model)
    model.vector(values)
    groups, built = {DEVIATION: {n: v for n, v in values.items() if n in plain.names}}, plain
    for effect in model.effects:
        if effect in built.effects:
            continue
        text = model.texts.get(effect, effect)
        before, built = built, effect_named(text, built).added(built, text)
        own = [n for n in built.names if n not in before.names]
        groups[effect] = {n: v for n, v in values.items() if n in own}
        if own and not groups[effect]:
            raise InputError(
                f"Effect {effect} has no value to make an error with; state one or more of "
                f"{', '.join(own[:6])}{', ...' if len(own) > 6 else ''}."
            )
    groups = {name: own for name, own in groups.items() if own}
    if not groups:
        raise InputError("An error needs a cause: state effects and their values.")
    if len(groups) > 1:
        groups[TOGETHER] = dict(values)
    found = tuple((n, v, errors_along(model, v, plain=plain, **about)) for n, v in groups.items())
    return ErrorModel(model, about.get("decoder", LEAST_SQUARES), dict(about.get("at") or {}), found)
