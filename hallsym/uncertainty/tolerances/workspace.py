"""Where errors count: poses and vertical states, and the errors of the nominal decoder there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError
from hallsym.log.phase import near
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.simulation import Campaign, Run


@dataclass(frozen=True, eq=False)
class Workspace:
    """Points of equal weight: `pose` (n_pose, points) and `state` (n_state, points), in SI."""

    pose: np.ndarray
    state: np.ndarray

    @property
    def points(self) -> int:
        """Number of points."""
        return self.pose.shape[1]


def workspace_of(model: Model, campaign: Campaign, points_per_run: int = 8) -> Workspace:
    """Return a campaign's poses and states, at most `points_per_run` samples of each run, evenly spaced.

    Eight samples of a sine's period hold its peaks and the exact mean of any product of up to seven sines.
    """
    times = [_times(campaign, run, points_per_run) for run in campaign.runs]
    if not times:
        raise InputError("The campaign must have at least one run to span a workspace; it has none.")

    def along(columns: Sequence[str]) -> np.ndarray:
        rows = [
            np.concatenate([run.position(c, t) for run, t in zip(campaign.runs, times, strict=True)])
            for c in columns
        ]
        return np.array(rows).reshape(len(columns), sum(map(len, times)))

    return Workspace(along(model.pose), along(model.state))


def _times(campaign: Campaign, run: Run, points: int) -> np.ndarray:
    total = campaign.samples(run)
    return np.arange(min(points, total)) * total // min(points, total) * campaign.step_s


Errors = Callable[[np.ndarray], np.ndarray]


def nominal_errors(model: Model, where: Workspace) -> Errors:
    """Return `errors(machines)`: decoded minus true pose, (n_pose, m, points), for machines (m, n).

    The machine reads with its own parameters, the decoder computes with the nominal ones. No noise and no
    zero deviations.
    """
    read, decode, none = on_arrays(model.reading), on_arrays(model.decoded), np.zeros(len(model.zeros))
    weight = np.ones(len(model.channels))

    def errors(machines: np.ndarray) -> np.ndarray:
        own = [column[:, None] for column in machines.T]
        (reading,) = read(own, none, where.pose, where.state)
        with np.errstate(all="ignore"):
            (pose,) = decode(model.nominal, none, reading, where.state, weight)
        if not np.isfinite(pose).all():
            raise not_decoded(model)
        return near(model, pose, where.pose[:, None, :]) - where.pose[:, None, :]

    return errors


def not_decoded(model: Model) -> InputError:
    """Return the refusal of tolerances in which a machine is too far from the nominal one to be decoded."""
    return InputError(
        f"The decoder of {model.name} finds no pose for some of the machines drawn: state narrower "
        "tolerances in --ranges."
    )


def gain_ratio(model: Model, where: Workspace, machines: np.ndarray) -> np.ndarray:
    """Return the gain of machines (m, n) over the nominal one, its least over channels and points, (m,)."""
    gain = on_arrays(model.gain)
    own = [column[:, None] for column in machines.T]
    (nominal,) = gain(model.nominal, where.state)
    (real,) = gain(own, where.state)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.broadcast_to(real, (len(real), len(machines), where.points)) / nominal.reshape(
            len(nominal), 1, -1
        )
    return np.nan_to_num(ratio, nan=-np.inf).min(axis=(0, 2))
