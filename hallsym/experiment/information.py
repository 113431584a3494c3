"""What a run would tell: its expected information, and the directions that information is about."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.estimation import Cost, cost_near, least_information, scales, structural_directions
from hallsym.log import Log
from hallsym.model import Model
from hallsym.model.quantities import combination
from hallsym.simulation import Campaign, Run, Signal, simulate

LEAST, PER_PERIOD = 512, 16
"""A run is looked at in so many samples at least, and so many per period of its fastest signal; information
of a longer recording is proportional to its samples."""


def planned_cost(
    runs: Sequence[Run], step_s: float, model: Model, values: Mapping[str, float], noise: Mapping[str, float]
) -> tuple[Cost, np.ndarray]:
    """Return the cost of `runs` recorded without noise, and (runs,) factors to the real number of samples.

    It is exact near `values`. Zero deviations are 0: they move the information by the square of their share
    of the motion.
    """
    zeros = (0.0,) * len(model.zeros)
    real = Campaign(step_s, tuple(runs))
    longest = max(run.duration_s for run in runs)
    least = max(LEAST, PER_PERIOD * max(map(_fastest, runs)) * longest)
    coarse = Campaign(max(step_s, longest / least), tuple(replace(run, zeros=zeros) for run in runs))
    log = Log.from_arrays(simulate(model, values, coarse, seed=0))
    factor = np.array([real.samples(run) / coarse.samples(run) for run in runs])
    return cost_near(log, model, model.vector(values), noise), factor


def _fastest(run: Run) -> float:
    """Highest frequency in a run [Hz]; infinite where a motion is a plain function."""
    motions = run.motion.values()
    return max((s.fastest_hz if isinstance(s, Signal) else float("inf") for s in motions), default=0.0)


@dataclass(frozen=True, eq=False)
class Directions:
    """The m directions of the n parameters that some recording can determine.

    `basis`: (n, m), parameters = basis @ coordinates, coordinates scaled by the bound widths `scale` (n,).
    `null`: (n, k) scaled directions that no recording determines, fixed parameters left out.
    """

    model: Model
    scale: np.ndarray
    basis: np.ndarray
    null: np.ndarray

    def reduced(self, information: np.ndarray) -> np.ndarray:
        """Return information (..., n, n) about the parameters as (..., m, m) about the coordinates."""
        out = self.basis.T @ information @ self.basis
        return 0.5 * (out + np.swapaxes(out, -1, -2))

    def weak(self, information: np.ndarray) -> np.ndarray:
        """Return the scaled parameter directions (n, k) that information (m, m) leaves undetermined."""
        values, vectors = np.linalg.eigh(information)
        return (self.basis / self.scale[:, None]) @ vectors[:, values < least_information(values)]

    def std(self, gradients: np.ndarray, information: np.ndarray) -> np.ndarray:
        """Return standard uncertainties of functions with `gradients` (q, n), shape (q,), in their units."""
        half = np.linalg.solve(np.linalg.cholesky(information), (gradients @ self.basis).T)
        return np.sqrt(np.sum(half**2, axis=0))

    def worst(self, information: np.ndarray) -> "Worst":
        """Return the combination that information (m, m) determines worst."""
        values, vectors = np.linalg.eigh(information)
        direction = (self.basis / self.scale[:, None]) @ vectors[:, 0]
        determined = values[0] > least_information(values)
        direction = direction * np.sign(direction[int(np.argmax(np.abs(direction)))])
        order = np.argsort(-np.abs(direction), kind="stable")
        kept = [int(k) for k in order if abs(direction[k]) >= 0.3 * abs(direction[order[0]])]
        return Worst(
            {self.model.names[k]: float(direction[k]) for k in kept},
            float(values[0] ** -0.5) if determined else None,
        )


@dataclass(frozen=True)
class Worst:
    """The combination of parameters, each over its bound width, that is known worst.

    `parameters`: the larger entries of the unit direction. `std`: its standard uncertainty as a share of the
    bound width; None where it is not determined.
    """

    parameters: Mapping[str, float]
    std: float | None

    @property
    def text(self) -> str:
        """The direction in words, such as `0.71 b_B - 0.55 eta_B`."""
        joined = " ".join(f"{'-' if v < 0 else '+'} {abs(v):.2f} {n}" for n, v in self.parameters.items())
        return joined.removeprefix("+ ")


def directions(cost: Cost, p: np.ndarray) -> Directions:
    """Return what can be determined about the model of `cost` at parameters `p` (n,)."""
    model, (null, rest) = cost.summary.model, structural_directions(cost, p)
    scale = scales(model)
    return Directions(model, scale, scale[:, None] * rest, null)


def quantities(found: Directions, p: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and gradients (q, n) of what can be determined.

    Parameters, and the model's combinations of those that cannot.
    """
    model = found.model
    rows = dict(zip(model.names, np.eye(len(p)), strict=True))
    lost = {name for name, row in rows.items() if not _determined(found, row)}
    for named in model.combinations:
        if lost & set(named.parameters):
            rows[named.expression] = combination(model, named).first(p)[1]
    kept = {name: row for name, row in rows.items() if _determined(found, row)}
    return tuple(kept), np.array(list(kept.values())).reshape(-1, len(p))


def _determined(found: Directions, gradient: np.ndarray) -> bool:
    """Whether null directions leave it alone and a direction that is not fixed moves it."""
    scaled = gradient * found.scale
    size = float(np.linalg.norm(scaled))
    moved = float(np.linalg.norm(scaled @ found.null)) if found.null.shape[1] else 0.0
    return moved <= 1e-6 * size and bool(np.linalg.norm(gradient @ found.basis) > 1e-6 * size)
