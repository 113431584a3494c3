"""What a study of tolerances found, as typed numbers and as plain ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hallsym.model import Model
from hallsym.records import named
from hallsym.uncertainty.tolerances.calibrated import Remainder
from hallsym.uncertainty.tolerances.ranges import Tolerance
from hallsym.uncertainty.tolerances.sobol import Indices

ENOUGH = 0.05
"""Half width of a 95 % interval below which an index is called sharp."""
QUANTITIES = ("error", "rms", "peak")


@dataclass(frozen=True, eq=False)
class Errors95:
    """Errors of the machines drawn, per pose coordinate: rms over machines and workspace, and quantiles."""

    rms: np.ndarray
    mean: np.ndarray
    rms_spread: np.ndarray
    rms_95: np.ndarray
    peak_95: np.ndarray


@dataclass(frozen=True, eq=False)
class Worth:
    """How much the rms falls, relative, if one tolerance is tightened; (n, n_pose) each.

    `exact`, `halved`: fall of the rms over machines and workspace. `exact_half`: half width of the 95 %
    interval of `exact`. `spread`: fall of the standard deviation of one machine's rms among machines, when
    exact. Negative where it grows. From machines drawn again with that tolerance alone changed.
    """

    exact: np.ndarray
    halved: np.ndarray
    exact_half: np.ndarray
    spread: np.ndarray


@dataclass(frozen=True, eq=False)
class Tolerances:
    """What `tolerances` found. Arrays have one row per entry of `active`, the tolerances that are not exact.

    `indices`: quantity ("error", "rms", "peak") -> pose column -> Sobol indices. "error" is the error itself,
    averaged over the workspace; "rms" and "peak" are those of one machine over the workspace.
    """

    model: Model
    tolerances: tuple[Tolerance, ...]
    active: tuple[str, ...]
    points: int
    samples: int
    seed: int
    errors: Errors95
    indices: Mapping[str, Mapping[str, Indices]]
    worth: Worth
    remainder: Remainder
    notes: tuple[str, ...]
    seconds: float

    @property
    def ranking(self) -> tuple[str, ...]:
        """Active tolerances, the one most worth money first: by the mean square it takes from all outputs."""
        value = 1 - (1 - self.worth.exact) ** 2  # fall of the mean square
        return tuple(self.active[j] for j in np.argsort(-value.mean(axis=1), kind="stable"))

    @property
    def widest(self) -> float:
        """Largest half width of a 95 % interval of an index of the error."""
        return max(indices.widest for indices in self.indices["error"].values())

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, SI."""
        r, by_pose = self.remainder, partial(named, self.model.pose)
        return {
            "model": self.model.name,
            "seed": self.seed,
            "samples": self.samples,
            "points": self.points,
            "tolerances": {
                t.name: {
                    "unit": t.unit, "designed": float(t.nominal), "centre": float(t.centre),
                    "width": float(t.width), "distribution": t.distribution, "std": float(t.std),
                    "source": t.source,
                }
                for t in self.tolerances
            },
            "errors": {name: by_pose(values) for name, values in vars(self.errors).items()},
            "ranking": list(self.ranking),
            "worth": {
                name: {what: by_pose(values[j]) for what, values in vars(self.worth).items()}
                for j, name in enumerate(self.active)
            },
            "indices": {q: _indices(self.active, self.indices[q]) for q in QUANTITIES},
            "sharp": self.widest <= ENOUGH,
            "calibration": {
                "machines": r.machines, "before": by_pose(r.before), "after": by_pose(r.after),
                "undetermined": list(r.undetermined), "determined_instead": list(r.combinations),
                "freedom": r.freedom, "apart": r.apart,
            },
            "notes": list(self.notes),
            "seconds": self.seconds,
        }  # fmt: skip


def _indices(active: Sequence[str], by_pose: Mapping[str, Indices]) -> dict[str, dict[str, dict[str, float]]]:
    return {
        c: {
            name: {what: float(values[j]) for what, values in vars(i).items()}
            for j, name in enumerate(active)
        }
        for c, i in by_pose.items()
    }
