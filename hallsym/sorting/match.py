"""Choose sets of sensors for arrays by the least error of the decoded position, against bins alone."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.records import named
from hallsym.simulation import Campaign
from hallsym.sorting.bins import bins_of
from hallsym.sorting.exchange import cost, exchanged, neighbours
from hallsym.sorting.influence import Influence, alike, influence_of_gains, places, summed, without_common
from hallsym.sorting.result import Sorting
from hallsym.sorting.sort import WIDTH
from hallsym.uncertainty.tolerances.workspace import Workspace
from hallsym.units import Array

NOT_FELT = 0.1
"""Part of the error from the uncertainty of the gains below which a mismatch is not felt: .5 % of the sum."""
BLOCK = 2**16
"""Sets times poses that are decoded at once; bounds the memory."""


@dataclass(frozen=True, eq=False)
class Way:
    """Sets that one way of choosing gives: `sets` (m, k) indices of sensors, and their errors by decoding.

    `rms` (m,) of the metric over the workspace, `pose_rms` and `pose_peak` (m, n_pose) of each coordinate
    [SI], `gain` (m,) the common gain that the decoder of a set is given, over the nominal one.
    """

    name: str
    sets: Array
    gain: Array
    rms: Array
    pose_rms: Array
    pose_peak: Array

    @property
    def overall(self) -> float:
        """Root of the mean square error of all sets."""
        return float(np.sqrt(np.mean(self.rms**2))) if len(self.rms) else float("nan")

    @property
    def worst(self) -> float:
        """Largest rms error of a set."""
        return float(self.rms.max(initial=0.0)) if len(self.rms) else float("nan")


@dataclass(frozen=True, eq=False)
class Matching:
    """Sets of sensors chosen by a model, beside bins alone and sets drawn blindly.

    `sensors` (n,) names, `places` (k,) of a set; `floor`: rms error that the uncertainty of the gains alone
    makes, whatever is chosen; `optimal`: whether no other sets can have less (neighbours, where the model
    treats all channels alike and every sensor is equally well known).
    """

    model: Model
    influence: Influence
    sensors: tuple[str, ...]
    places: tuple[str, ...]
    members: int
    width: float
    ways: tuple[Way, ...]
    floor: float
    optimal: bool
    notes: tuple[str, ...]
    seconds: float

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
        pose = self.model.pose
        return {
            "model": self.model.name,
            "channels": list(self.model.channels),
            "sensors_per_channel": self.members,
            "unit": self.unit,
            "bin_width": self.width,
            "rms_from_uncertainty": self.floor,
            "optimal": self.optimal,
            "gain_over_bins": self.gain_over_bins if np.isfinite(self.gain_over_bins) else None,
            "ways": [
                {
                    "way": w.name,
                    "sets": len(w.sets),
                    "rms": w.overall if len(w.sets) else None,
                    "expected_rms": self.expected(w) if len(w.sets) else None,
                    "worst_rms": w.worst if len(w.sets) else None,
                    "pose_rms": named(pose, np.sqrt((w.pose_rms**2).mean(axis=0))) if len(w.sets) else None,
                    "pose_peak": named(pose, w.pose_peak.max(axis=0)) if len(w.sets) else None,
                }
                for w in self.ways
            ],
            "sets": self.chosen(),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def match_sensors(
    inventory: Sorting | Mapping[str, float],
    model: Model,
    *,
    sets: int | None = None,
    members: int = 1,
    width: float | None = None,
    values: Mapping[str, float] | None = None,
    where: Campaign | Workspace | None = None,
    seed: int = 0,
) -> Matching:
    """Return sets of sensors for `model` whose gain mismatch makes the least error of the pose.

    `inventory`: sorted sensors, or their gains by name in any unit. `sets`: how many (default: as many as
    there are sensors for). `members`: sensors that are summed into each channel and read alike. `width`: of
    the bins to compare with (default: those of the inventory). `values`, `where`: as in
    `influence_of_gains`. A set's common gain is set in its decoder, so that only differences within a set
    count. `seed`: of the exchanges and of the sets drawn for comparison.

    Raises `InputError` for too few sensors.
    """
    started = time.perf_counter()
    if seed < 0:
        raise InputError(f"A seed must be a whole number, 0 or more; instead received {seed!r}.")
    names, gain, std, width = _inventory(inventory, width)
    influence = influence_of_gains(model, values, where)
    square = summed(influence.square, members)
    size = len(square)
    count = _count(sets, len(names), size, model, members)
    plain, weights = without_common(square)
    rng = np.random.default_rng(seed)
    symmetric = alike(plain)
    chosen = neighbours(gain, size, count)
    if not symmetric:
        level = float(np.mean(std**2) * np.trace(plain))
        chosen = exchanged(chosen, gain, plain, rng, NOT_FELT**2 * level)
    chosen = chosen[np.argsort(cost(gain[chosen], plain), kind="stable")]
    decode = _Decoder(influence, weights, members)
    others = {
        f"bins of {100 * width:.3g} %": _from_bins(gain, width, size, count, rng),
        "unsorted": rng.permutation(len(names))[: count * size].reshape(count, size),
    }
    ways = tuple(decode.way(name, index, gain) for name, index in {"matched": chosen, **others}.items())
    floor = float(np.sqrt(np.mean(std[chosen] ** 2 @ np.diag(plain))))
    return Matching(
        influence.model,
        influence,
        names,
        places(model.channels, members),
        members,
        width,
        ways,
        floor,
        symmetric,
        tuple(_notes(ways, floor, count, symmetric)),
        time.perf_counter() - started,
    )


def _inventory(
    inventory: Sorting | Mapping[str, float], width: float | None
) -> tuple[tuple[str, ...], Array, Array, float]:
    """Names, relative gains and their standard uncertainties, and the width of the bins."""
    if isinstance(inventory, Sorting):
        relative, std = inventory.relative, inventory.std / inventory.nominal
        names, usual = inventory.sensors, inventory.width
    else:
        names, usual = tuple(inventory), WIDTH
        gains = np.array([float(inventory[n]) for n in names])
        for name, value in zip(names, gains.tolist(), strict=True):
            if not 0 < value < np.inf:
                raise InputError(
                    f"The gain of sensor {name} must be a positive number; instead received {value!r}."
                )
        relative, std = gains / np.median(gains) if len(gains) else gains, np.zeros(len(gains))
    if width is not None and not 0 < width < 1:
        raise InputError(
            "The width of a bin must be above 0 and below 100 % of the gain; instead received"
            f" {100 * width:g} %."
        )
    return names, relative, std, usual if width is None else width


def _count(sets: int | None, sensors: int, size: int, model: Model, members: int) -> int:
    most = sensors // size
    each = f"{len(model.channels)} channels" + (f" of {members} sensors" if members > 1 else "")
    if sets is not None and sets < 1:
        raise InputError(f"The number of sets must be 1 or more; instead received {sets}.")
    if most < 1 or (sets or 0) > most:
        raise InputError(
            f"{sets or 1} set{'s' if (sets or 1) > 1 else ''} for {model.name} ({each}) need"
            f" {(sets or 1) * size} sensors; {sensors} were sorted, which is enough for {most}."
        )
    return most if sets is None else sets


def _from_bins(gain: Array, width: float, size: int, count: int, rng: np.random.Generator) -> Array:
    """At most `count` sets drawn within a bin each, from the fullest bins first."""
    bins = bins_of(gain, width)
    found: list[Array] = []
    labels, filled = np.unique(bins, return_counts=True)
    for k in labels[np.argsort(-filled, kind="stable")]:
        inside = rng.permutation(np.flatnonzero(bins == k))
        found.append(inside[: len(inside) // size * size].reshape(-1, size))
    return np.concatenate(found)[:count]


@dataclass(frozen=True, eq=False)
class _Decoder:
    """Errors of sets by the model's own decoder, which knows the common gain of a set and no other."""

    influence: Influence
    weights: Array
    members: int

    def way(self, name: str, index: Array, gain: Array) -> Way:
        """Decode the sets (m, k) of one way of choosing."""
        model, d = self.influence.model, gain[index] - 1.0
        common = d @ self.weights
        channels = (1 + d).reshape(len(d), len(model.channels), self.members).mean(axis=2) / (
            1 + common[:, None]
        )
        rows = max(1, BLOCK // self.influence.where.points)
        rms, pose_rms, peak = (
            np.zeros(len(d)),
            np.zeros((len(d), len(model.pose))),
            np.zeros((len(d), len(model.pose))),
        )
        for at in (slice(k, k + rows) for k in range(0, len(d), rows)):
            e = self.influence.decoded_errors(channels[at])
            square = (e * e).mean(axis=2).T
            rms[at], pose_rms[at] = np.sqrt(square @ self.influence.weights**2), np.sqrt(square)
            peak[at] = np.abs(e).max(axis=2).T
        return Way(name, index, 1 + common, rms, pose_rms, peak)


def _notes(ways: Sequence[Way], floor: float, count: int, symmetric: bool) -> list[str]:
    notes = []
    if len(ways[1].sets) < count:
        notes.append(
            f"bins alone give {len(ways[1].sets)} of {count} sets: what is left over in a bin makes none."
        )
    if floor > ways[0].overall:
        notes.append(
            "the uncertainty of the gains makes more of the error than what matching leaves: measure each"
            " sensor more often before sorting finer."
        )
    if not symmetric:
        notes.append(
            "the model treats its channels differently: sets are improved by exchanges, and a sensor's"
            " place in its set counts."
        )
    return notes
