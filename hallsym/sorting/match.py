"""Choose sets of sensors for arrays by the least error of the decoded position, against bins alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np

from hallsym.errors import InputError, counted, require
from hallsym.model import Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.simulation import Campaign
from hallsym.sorting.bins import bins_of
from hallsym.sorting.influence import Influence, influence_of_gains, is_symmetric, without_common
from hallsym.sorting.sort import WIDTH, Sorting
from hallsym.uncertainty.tolerances import Workspace
from hallsym.units import Array

MOST_ORDERED = 6
"""Channels of a set whose every order is tried: 720 of six."""
BLOCK = 2**16
"""Sets times poses that are decoded at once; bounds the memory."""


@dataclass(frozen=True, eq=False)
class Way:
    """Sets that one way of choosing gives: `sets` (m, k) indices of sensors, and their errors by decoding.

    `rms` (m,) of the metric over the workspace, `pose_peak` (m, n_pose) of each coordinate [SI], `gain` (m,)
    the common gain that the decoder of a set is given, over the nominal one.
    """

    name: str
    sets: Array
    gain: Array
    rms: Array
    pose_peak: Array

    @property
    def overall(self) -> float:
        """Root of the mean square error of all sets."""
        return float(np.sqrt(np.mean(self.rms**2))) if len(self.rms) else float("nan")


@dataclass(frozen=True, eq=False, repr=False)
class Matching(Shown):
    """Sets of sensors chosen by a model, beside bins alone and sets drawn blindly.

    `sensors` (n,) names, `places` (k,) of a set; `floor`: rms error that the uncertainty of the gains alone
    makes, whatever is chosen; `optimal`: whether no other sets can have less (neighbours, where the model is
    symmetric in all channels).
    """

    model: Model
    influence: Influence
    sensors: tuple[str, ...]
    places: tuple[str, ...]
    width: float
    ways: tuple[Way, ...]
    floor: float
    optimal: bool
    notes: tuple[str, ...]

    @property
    def matched(self) -> Way:
        """The sets that the model chose."""
        return self.ways[0]

    @property
    def bins(self) -> Way:
        """Sets from one bin each."""
        return self.ways[1]

    @property
    def unit(self) -> str:
        """SI unit of the metric of the error."""
        return self.model.family.pose_metric.unit

    def expected(self, way: Way) -> float:
        """Return the rms error to expect of the sets of one way, with the uncertainty of their gains."""
        return float(np.hypot(way.overall, self.floor))

    @property
    def gain_over_bins(self) -> float:
        """Error to expect of sets from bins over that of matched sets; nan where no bin fills a set."""
        least = self.expected(self.matched)
        return self.expected(self.bins) / least if least > 0 else float("inf")

    def chosen(self) -> list[dict[str, Any]]:
        """Return the matched sets: sensor by place, common gain, and predicted errors [SI]."""
        way = self.matched
        return [
            {
                "sensors": dict(zip(self.places, (self.sensors[i] for i in row), strict=True)),
                "common_gain": float(gain),
                "rms": float(rms),
                "peak": named(self.model.pose, peak),
            }
            for row, gain, rms, peak in zip(way.sets.tolist(), way.gain, way.rms, way.pose_peak, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain data."""
        ways = []
        for w in self.ways:
            known = len(w.sets) > 0
            peak = named(self.model.pose, w.pose_peak.max(axis=0)) if known else None
            rms, expected = (w.overall, self.expected(w)) if known else (None, None)
            ways.append(
                {"way": w.name, "sets": len(w.sets), "rms": rms, "expected_rms": expected, "pose_peak": peak}
            )
        return {
            "model": self.model.name,
            "unit": self.unit,
            "bin_width": self.width,
            "rms_from_uncertainty": self.floor,
            "optimal": self.optimal,
            "gain_over_bins": self.gain_over_bins if np.isfinite(self.gain_over_bins) else None,
            "ways": ways,
            "sets": self.chosen(),
            "notes": list(self.notes),
        }


def match_sensors(
    inventory: Sorting | Mapping[str, float],
    model: Model,
    *,
    sets: int | None = None,
    members: int = 1,
    values: Mapping[str, float] | None = None,
    where: Campaign | Workspace | None = None,
) -> Matching:
    """Return sets of sensors for `model` whose gain mismatch makes the least error of the pose.

    `inventory`: sorted sensors, or their gains by name in any unit. `sets`: how many (default: as many as
    there are sensors for). `members`: sensors that are summed with equal weight into each channel. `values`,
    `where`: as in `influence_of_gains`. A set's common gain is set in its decoder, so that only differences
    within a set count. Sets are stretches of neighbours in gain, compared with sets drawn from one bin each.

    Raises `InputError` for too few sensors.
    """
    names, gain, std, width = _inventory(inventory)
    influence = influence_of_gains(model, values, where)
    channels = len(model.channels)
    size = channels * members
    count = _count(sets, len(names), size, model, members)
    plain, weights = without_common(influence.square)
    symmetric = is_symmetric(plain) and members == 1
    chosen = neighbours(gain, size, count)
    if not symmetric:
        chosen = arranged(chosen, gain, plain, members)
    errors = _channels(gain[chosen], members)
    chosen = chosen[np.argsort(np.einsum("mi,ij,mj->m", errors, plain, errors), kind="stable")]
    rng = np.random.default_rng(0)
    ways = {
        "matched": chosen,
        f"bins of {100 * width:.3g} %": _from_bins(gain, width, size, count, rng),
        "unsorted": rng.permutation(len(names))[: count * size].reshape(count, size),
    }
    decoded = tuple(_decoded(influence, weights, members, *way, gain) for way in ways.items())
    floor = float(np.sqrt(np.mean(_channels(std[chosen] ** 2, members) @ np.diag(plain)) / members))
    notes, alone = [], len(decoded[1].sets)
    if alone < count:
        notes.append(f"bins alone give {alone} of {count} sets: what is left over in a bin makes none.")
    if floor > decoded[0].overall:
        notes.append(
            "the uncertainty of the gains makes more of the error than what matching leaves: measure each"
            " sensor more often before sorting finer."
        )
    return Matching(
        influence.model,
        influence,
        names,
        tuple(c if members == 1 else f"{c}#{j + 1}" for c in model.channels for j in range(members)),
        width,
        decoded,
        floor,
        symmetric,
        tuple(notes),
    )


def _channels(values: Array, members: int) -> Array:
    """Mean of the summed sensors of each channel: (m, channels * members) to (m, channels)."""
    return values.reshape(len(values), values.shape[1] // members, members).mean(axis=2)


def neighbours(gain: Array, size: int, sets: int) -> Array:
    """Return indices (sets, size) of disjoint stretches of the sorted gains with least variance in all.

    Where a model is symmetric in all channels these sets are optimal: exchanging sensors of two neighbouring
    sets raises the error.
    """
    order = np.argsort(gain, kind="stable")
    g = gain[order] - gain.mean()
    sums, squares = (np.r_[0.0, np.cumsum(x)] for x in (g, g * g))
    inside = squares[size:] - squares[:-size] - (sums[size:] - sums[:-size]) ** 2 / size
    starts = _stretches(np.maximum(inside, 0.0), size, sets)
    return order[starts[:, None] + np.arange(size)]


def _stretches(inside: Array, size: int, sets: int) -> Array:
    """Starts of `sets` disjoint stretches of least total cost, where `inside` is the cost by start.

    `total[k, j]`: least cost of sets 0 to k, where set k starts at k size + j, after j sensors left out.
    """
    spare = len(inside) - 1 - (sets - 1) * size
    total, before = np.empty((sets, spare + 1)), np.zeros(spare + 1)
    for k in range(sets):
        total[k] = before + inside[k * size : k * size + spare + 1]
        before = np.minimum.accumulate(total[k])
    starts = np.empty(sets, int)
    for k in reversed(range(sets)):
        spare = int(np.argmin(total[k, : spare + 1]))
        starts[k] = k * size + spare
    return starts


def arranged(index: Array, gain: Array, square: Array, members: int) -> Array:
    """Return the sets (m, channels * members) with their sensors in the best order of channels.

    Summed sensors are dealt to the channels to and fro, so that high and low ones meet; up to six channels
    are tried in every order.
    """
    deal = np.arange(index.shape[1]).reshape(members, -1)
    deal[1::2] = deal[1::2, ::-1]
    index = index[:, deal.T.ravel()]
    channels = len(square)
    if channels > MOST_ORDERED:
        return index
    orders = np.array(list(permutations(range(channels))))
    d = _channels(gain[index], members)[:, orders]
    best = orders[np.einsum("moi,ij,moj->mo", d, square, d).argmin(axis=1)]
    sets = index.reshape(len(index), channels, members)
    return np.take_along_axis(sets, best[:, :, None], axis=1).reshape(index.shape)


def _inventory(inventory: Sorting | Mapping[str, float]) -> tuple[tuple[str, ...], Array, Array, float]:
    """Names, relative gains and their standard uncertainties, and the width of the bins."""
    if isinstance(inventory, Sorting):
        return inventory.sensors, inventory.relative, inventory.std / inventory.nominal, inventory.width
    gains = np.array([float(gain) for gain in inventory.values()])
    for name, value in zip(inventory, gains.tolist(), strict=True):
        require(0 < value < np.inf, f"The gain of sensor {name}", "a positive number", value)
    relative = gains / np.median(gains) if len(gains) else gains
    return tuple(inventory), relative, np.zeros(len(gains)), WIDTH


def _count(sets: int | None, sensors: int, size: int, model: Model, members: int) -> int:
    require(members >= 1, "A channel", "the sum of 1 or more sensors", members)
    require(sets is None or sets >= 1, "The number of sets", "1 or more", sets)
    each = f"{len(model.channels)} channels" + (f" of {members} sensors" if members > 1 else "")
    most, wanted = sensors // size, sets or 1
    if wanted > most:
        raise InputError(
            f"{counted(wanted, 'set')} for {model.name} ({each}) need {wanted * size} sensors; {sensors} were"
            f" sorted, which is enough for {most}."
        )
    return sets or most


def _from_bins(gain: Array, width: float, size: int, count: int, rng: np.random.Generator) -> Array:
    """At most `count` sets drawn within a bin each, from the fullest bins first."""
    bins = bins_of(gain, width)
    found: list[Array] = []
    labels, filled = np.unique(bins, return_counts=True)
    for k in labels[np.argsort(-filled, kind="stable")]:
        inside = rng.permutation(np.flatnonzero(bins == k))
        found.append(inside[: len(inside) // size * size].reshape(-1, size))
    return np.concatenate(found)[:count]


def _decoded(influence: Influence, weights: Array, members: int, name: str, index: Array, gain: Array) -> Way:
    """Decode the sets (m, k) of one way; the decoder knows the common gain of a set and no other."""
    model = influence.model
    channels = _channels(gain[index], members)
    common = 1 + (channels - 1) @ weights
    rows = max(1, BLOCK // influence.where.points)
    rms, peak = np.zeros(len(index)), np.zeros((len(index), len(model.pose)))
    for at in (slice(k, k + rows) for k in range(0, len(index), rows)):
        e = influence.decoded_errors(channels[at] / common[at, None])
        rms[at] = np.sqrt((e * e).mean(axis=2).T @ influence.weights**2)
        peak[at] = np.abs(e).max(axis=2).T
    return Way(name, index, common, rms, peak)
