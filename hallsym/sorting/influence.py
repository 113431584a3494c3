"""Sensitivity of the decoded pose to each channel's gain, from the model's expressions.

If the gain of a channel grows by the part d, its reading grows by d times the part that is proportional to
the gain: the sum of p d reading / d p over the parameters of its gain alone (`Model.symbols.gain`), or the
whole reading if there are none. The decoder, with the nominal gain, moves the pose by the weighted inverse of
the model times that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.log import near
from hallsym.model import Model, on_arrays
from hallsym.simulation import Campaign, default_campaign
from hallsym.uncertainty.tolerances import Workspace, workspace_of
from hallsym.units import Array

SAME = 1e-9
"""Relative differences of a quadratic form below which it is symmetric in all channels."""


@dataclass(frozen=True, eq=False)
class Influence:
    """Error of the pose by relative gain errors d (k,) of the channels, over points of a workspace.

    `error` (n_pose, points, k): of each coordinate [SI] per gain error; `reading` and `part` (k, points):
    what each channel reads, and what its gain multiplies; `weights` (n_pose,) turn coordinates into the one
    length or angle of the model's metric; `values` are the parameters.
    """

    model: Model
    values: Array
    where: Workspace
    error: Array
    reading: Array
    part: Array
    weights: Array

    @property
    def square(self) -> Array:
        """Quadratic form Q (k, k): d' Q d is the mean square of the weighted error over the workspace."""
        weighted = self.error * self.weights[:, None, None]
        return np.asarray(np.einsum("cpi,cpj->ij", weighted, weighted) / self.error.shape[1])

    def decoded_errors(self, gains: Array) -> Array:
        """Return decoded minus true pose (n_pose, m, points) of sets whose channels have `gains` (m, k).

        Relative to those that the decoder knows; by the decoder itself, without noise.
        """
        model, none = self.model, np.zeros(len(self.model.offsets))
        read = self.reading[:, None, :] + self.part[:, None, :] * (gains.T[:, :, None] - 1.0)
        pose = model.decode(self.values, none, read, self.where.state, np.ones(len(model.channels)))
        if not np.isfinite(pose).all():
            raise InputError(
                f"The decoder of {model.name} finds no pose for some of the sets: their gains differ"
                " too much; sort them first, or ask for fewer --sets."
            )
        true = self.where.pose[:, None, :]
        return np.asarray(near(model, pose, true) - true)


def influence_of_gains(
    model: Model,
    values: Mapping[str, float] | None = None,
    where: Campaign | Workspace | None = None,
) -> Influence:
    """Return the sensitivity of a model's pose to gain errors of its channels.

    `values` over the nominal ones; `where`: campaign or workspace over which errors count (default: the
    model's typical poses, a period of a periodic coordinate; else its family's example, else the paper's
    campaign).
    Raises `InputError` where the model cannot be decoded, or gains do not count.
    """
    p, space, s = model.vector(dict(values or {})), _workspace(model, where), model.symbols
    reading = ca.substitute(s.full(s.reading), s.offsets, ca.SX.zeros(len(model.offsets)))
    symbols, parts = dict(zip(model.names, ca.vertsplit(s.parameters), strict=True)), []
    for k, own in enumerate(_gains(model)):
        along = ca.vertcat(*(symbol if name in own else ca.SX(0) for name, symbol in symbols.items()))
        parts.append(ca.jtimes(reading[k], s.parameters, along) if own else reading[k])
    part = ca.vertcat(*parts)  # of each reading, that is proportional to its gain
    weight = np.ones(len(model.channels))
    slope = model.noise_gain_at(s.parameters, s.pose, s.state, weight) @ ca.diag(part)
    given, made = [s.parameters, s.pose, s.state], [ca.densify(x) for x in (slope, reading, part)]
    found = on_arrays(ca.Function("influence", given, made))(p, space.pose, space.state)
    flat, read, own_parts = (np.broadcast_to(x, (len(x), space.points)) for x in found)
    error = flat.reshape(len(model.channels), len(model.pose), space.points).transpose(1, 2, 0)
    if not np.isfinite(error).all():
        raise InputError(
            f"Model {model.name} cannot be decoded everywhere in its workspace with these values: check them."
        )
    if not error.any():
        raise InputError(
            f"The gains of model {model.name} do not move its pose in this workspace; there is nothing"
            " to match."
        )
    return Influence(model, p, space, error, read, own_parts, model.family.pose_metric.weights(model.pose))


def _gains(model: Model) -> list[set[str]]:
    """Names of the gain parameters of each channel: those on which no other channel's gain depends."""
    gain, p = model.symbols.gain, model.symbols.parameters
    if gain.numel() != len(model.channels):
        return [set()] * len(model.channels)
    depends = [
        {n for n, d in zip(model.names, ca.which_depends(gain[k], p, 1, False), strict=True) if d}
        for k in range(len(model.channels))
    ]
    shared = Counter(name for names in depends for name in names)
    return [{name for name in names if shared[name] == 1} for names in depends]


def _workspace(model: Model, where: Campaign | Workspace | None) -> Workspace:
    if isinstance(where, Workspace):
        return where
    if where is not None:
        return workspace_of(model, where)
    if model.typical:
        poses = np.array(model.typical, float).T
        return Workspace(poses, np.zeros((len(model.state), poses.shape[1])))
    return workspace_of(model, default_campaign(model))


def without_common(square: Array) -> tuple[Array, Array]:
    """Return the form with the best common gain taken out, and that gain as weights (k,): c = weights . d.

    The gain of a whole array is one number in its decoder: only differences between its channels stay.
    """
    ones = np.ones(len(square))
    total = float(ones @ square @ ones)
    if total <= SAME * np.trace(square):
        return square, ones / len(square)
    weights = square @ ones / total
    return square - np.outer(square @ ones, square @ ones) / total, weights


def is_symmetric(square: Array) -> bool:
    """Return whether a form without common gain is symmetric in all its places: c (I - 1 1' / k).

    Sets of neighbours in gain are then the best ones.
    """
    k = len(square)
    even = (np.eye(k) - 1 / k) * np.trace(square) / max(k - 1, 1)
    return bool(np.abs(square - even).max() <= SAME * max(np.abs(square).max(), np.finfo(float).tiny) * 1e3)
