"""What a calibration takes away: machines drawn, calibrated without noise, and the error that remains."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.estimation import Coefficients, exact, scales, structural_null
from hallsym.log.phase import near
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.features import find_features
from hallsym.model.influence import influence
from hallsym.uncertainty.tolerances.workspace import Workspace, not_decoded

Outcome = tuple[np.ndarray, np.ndarray, np.ndarray]
MACHINES, POINTS, ROUNDS = 16, 128, 12


@dataclass(frozen=True, eq=False)
class Remainder:
    """What is left of the errors once a calibration has found all that readings can tell.

    `undetermined`: parameters that no recording tells apart, of which `combinations` (expressions) are
    determined instead; `freedom` directions among them change no reading. `before`, `after`: rms error
    (n_pose,) of `machines` machines drawn, with the nominal decoder and with the calibrated one.
    `apart`: largest distance of an undetermined parameter's calibrated value from the true one, over its
    tolerance: a calibration leaves these wrong, and the error is `after` all the same.
    """

    undetermined: tuple[str, ...]
    combinations: tuple[str, ...]
    freedom: int
    machines: int
    before: np.ndarray
    after: np.ndarray
    apart: float


def after_calibration(model: Model, where: Workspace, machines: np.ndarray, width: np.ndarray) -> Remainder:
    """Calibrate the first of `machines` (m, n) without noise over the workspace, from the nominal values.

    `width`: (n,) tolerances, 0 for exact parameters.
    """
    space = _some(where)
    null = _null(model, space, machines[0])
    moving = np.flatnonzero(np.linalg.norm(null, axis=1) > 1e-6)
    names = tuple(model.names[k] for k in moving)
    scale, before, after, apart = scales(model), [], [], [0.0]
    calibrate = _calibration(model, space, scale)
    for machine in machines[:MACHINES]:
        try:
            with np.errstate(all="ignore"):
                found, first, last = calibrate(machine)
        except np.linalg.LinAlgError:
            raise not_decoded(model) from None
        before.append(first)
        after.append(last)
        apart += [float(abs(found[k] - machine[k]) / width[k]) for k in moving if width[k] > 0]
    return Remainder(
        names,
        tuple(c.expression for c in model.combinations if set(c.parameters) & set(names)) if names else (),
        null.shape[1],
        len(before),
        np.sqrt(np.mean(before, axis=0)),
        np.sqrt(np.mean(after, axis=0)),
        max(apart),
    )


def _some(where: Workspace) -> Workspace:
    """Return `POINTS` points at most, drawn: every k-th could be the same phase of every sine."""
    if where.points <= POINTS:
        return where
    pick = np.sort(np.random.default_rng(0).choice(where.points, POINTS, replace=False))
    return Workspace(where.pose[:, pick], where.state[:, pick])


UNSEEN = 1e-9
"""Singular value over the largest below which a direction changes no reading: rounding is 1e-3 of it."""


def _null_at(model: Model, space: Workspace, machine: np.ndarray) -> np.ndarray:
    """Return the directions (n, k) in scaled parameters that change no reading in the workspace."""
    s, n = model.symbols, len(model.names)
    slopes = ca.densify(ca.jacobian(s.full(s.reading), s.parameters))
    function = ca.Function("slopes", [s.parameters, s.zeros, s.pose, s.state], [slopes])
    (rows,) = on_arrays(function)(machine, np.zeros(len(model.zeros)), space.pose, space.state)
    jacobian = rows.reshape(n, -1).T * scales(model)
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    return directions[values < UNSEEN * values[0]].T


def _null(model: Model, space: Workspace, machine: np.ndarray) -> np.ndarray:
    if not exact(model):
        return _null_at(model, space, machine)
    features = find_features(model)
    centre = np.zeros(len(model.pose) + len(model.state) + model.symbols.derived.numel())
    (values,) = features.values(space.pose, space.state, centre)
    size = np.linalg.norm(values, axis=1)
    size[size == 0] = 1.0
    return structural_null(Coefficients(features, centre), size, machine)


def _calibration(model: Model, space: Workspace, scale: np.ndarray) -> Callable[[np.ndarray], Outcome]:
    """Return `calibrate(machine)`: Gauss-Newton on the decoded pose, no step where nothing changes.

    It gives the decoder's parameters and its mean squares (n_pose,) before and after.
    """
    read, decode = on_arrays(model.reading), on_arrays(model.decoded)
    none, weight = np.zeros(len(model.zeros)), np.ones(len(model.channels))
    size = np.abs(space.pose).max(axis=1)[:, None]
    size[size == 0] = 1.0

    def calibrate(machine: np.ndarray) -> Outcome:
        (reading,) = read(machine, none, space.pose, space.state)
        p, squares = model.nominal, []
        for _ in range(ROUNDS):
            (pose,) = decode(p, none, reading, space.state, weight)
            e = near(model, pose, space.pose) - space.pose
            squares.append((e**2).mean(axis=1))
            slopes = influence(model, p, [*none], [*pose], [*space.state]).parameters * scale
            rows = (slopes / size).reshape(-1, len(p))
            step, *_ = np.linalg.lstsq(rows, -(e / size).T.ravel(), rcond=1e-9)
            if np.abs(step).max() < 1e-12:
                break
            p = p + step * scale
        (pose,) = decode(p, none, reading, space.state, weight)
        return p, squares[0], ((near(model, pose, space.pose) - space.pose) ** 2).mean(axis=1)

    return calibrate
