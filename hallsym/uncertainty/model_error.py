"""Model error of a decoded position, from a diagnosis: what a model leaves, and which model it is.

A diagnosis says what no effect explains, as a function of a coordinate where it goes with one, and which
models the log does not exclude. An error that is known and not corrected counts in full (JCGM 100, F.2.4.5).
Models that are not excluded differ in the position that they decode; their scatter, weighed by their
probabilities, is the uncertainty of having selected one of them (Hoeting et al. 1999,
doi:10.1214/ss/1009212519).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import Fit
from hallsym.families import adapted, plain
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.uncertainty.settings import Zeroed

BAND = 1.96
"""Half-width of the bands of a shape over their standard uncertainty."""
SHAPE, REST, SELECTED = "model error: shape", "model error: rest", "model selection"
"""Names of the sources."""


@dataclass(frozen=True, eq=False)
class Shape:
    """What is left of each reading over a coordinate, which is a column of the pose or the state.

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
    """What a diagnosis adds to the budget of a position.

    `rest`: pose column -> standard uncertainty of what is left and goes with nothing known [SI].
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
            if model.zeros:
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
    (out,) = on_arrays(c.model.reading)(c.values, np.zeros(len(c.model.zeros)), list(pose), own)
    return np.broadcast_to(out, (len(model.channels), pose.shape[1]))


def _shaped(shape: Shape, fit: Fit, pose: np.ndarray, state: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Square of the error that a shape makes, and the variance of the shape itself, (s, n_pose)."""
    model = fit.model
    x = np.vstack([pose, state])[(*model.pose, *model.state).index(shape.column)]

    def over(rows: np.ndarray) -> np.ndarray:
        return np.array([np.interp(x, shape.grid, row, period=shape.period) for row in rows])

    value, std = over(shape.value), over(shape.std)
    if shape.gain:
        zeros = np.zeros(len(model.zeros))
        (reading,) = on_arrays(model.reading)(fit.values, zeros, list(pose), list(state))
        value, std = value * reading, std * reading
    error = np.einsum("spk,ks->sp", slope, value)
    return np.asarray(error**2 + np.einsum("spk,ks->sp", slope**2, std**2))


# -- the record of a diagnosis -------------------------------------------------------------------------------


def read_model_error(path: str | Path, model: Model) -> ModelError:
    """Read what `hallsym diagnose -o FILE.json` saved; `model`: of the calibration that is budgeted.

    Raises `InputError` for a missing file, another record or a diagnosis of another model.
    """
    name = Path(path).name
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"Diagnosis {name} cannot be read: {error}.") from error
    if not isinstance(data, dict) or "model_error" not in data:
        raise InputError(
            f"{name} holds no diagnosis with a model error; give what 'hallsym diagnose LOG -o FILE.json' "
            "saved."
        )
    if data["model"] != model.name:
        raise InputError(
            f"{name} is a diagnosis of {data['model']}, the calibration is of {model.name}; "
            "diagnose the log with that model."
        )
    try:
        return _read(data, model)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"The model error in {name} cannot be read ({error!r}); diagnose again.") from error


def _read(data: Mapping[str, Any], model: Model) -> ModelError:
    said = data["model_error"]
    curve = (data.get("unexplained") or {}).get("curve")
    return ModelError(
        rest={c: float(v) for c, v in said["rest"].items()},
        shape=_shape(curve, model) if curve and said["shape_counts"] else None,
        candidates=tuple(_candidate(c, model) for c in said["candidates"]),
    )


def _candidate(said: Mapping[str, Any], model: Model) -> Candidate:
    own = adapted(plain(model), tuple(said["effects"]), {})
    return Candidate(own, own.vector(said["values"]), float(said["weight"]))


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
