"""The information of each candidate run and the criterion, computed once for all choices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.identifiable import least_information, scales, structural_directions
from hallsym.estimation.likelihood import Cost, cost_near
from hallsym.experiment.criteria import Criterion, choose, criterion, greedy
from hallsym.experiment.ranges import Candidate, Ranges, candidates, corners
from hallsym.log import Log
from hallsym.model import Model
from hallsym.model.influence import influence
from hallsym.model.model import combination
from hallsym.simulation import Campaign, Run, Signal, simulate

RIDGE = 1e-9
"""Ridge as a share of a run's mean information, so that criteria have values for fewer runs than the model
needs; no reported uncertainty contains it."""
MOST_RUNS = 500
LEAST, PER_PERIOD = 512, 16
"""Fewest samples of a simulated run, and per period of its fastest signal; information of a longer recording
is proportional to its samples."""


def planned_cost(
    runs: Sequence[Run], step_s: float, model: Model, values: Mapping[str, float], noise: Mapping[str, float]
) -> tuple[Cost, np.ndarray]:
    """Return the cost of `runs` recorded without noise, and (runs,) factors to the real number of samples.

    It is exact near `values`. Zero deviations are 0: they move the information by the square of their share
    of the motion.
    """
    offsets = (0.0,) * len(model.offsets)
    real = Campaign(step_s, tuple(runs))
    longest = max(run.duration_s for run in runs)
    motions = [motion for run in runs for motion in run.motion.values()]  # a plain function may be any fast
    fastest = max((s.fastest_hz if isinstance(s, Signal) else np.inf for s in motions), default=0.0)
    least = max(LEAST, PER_PERIOD * fastest * longest)
    coarse = Campaign(max(step_s, longest / least), tuple(replace(run, offsets=offsets) for run in runs))
    log = Log.from_arrays(simulate(model, values, coarse, seed=0))
    factor = np.array([real.samples(run) / coarse.samples(run) for run in runs])
    return cost_near(log, model, model.vector(values), noise), factor


@dataclass(frozen=True)
class Worst:
    """The worst-determined combination of parameters, each over its bound width.

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


@dataclass(frozen=True, eq=False)
class Study:
    """Candidates with their information in m identifiable coordinates.

    `basis`: (n, m), parameters = basis @ coordinates. `infos`: (candidates, m, m), `known`: (m, m) of the
    earlier recording. `slopes`: (points, n_pose, m) of the decoded position over the workspace, SI. `names`,
    `gradients`: reported quantities, (q, n).
    """

    model: Model
    values: Mapping[str, float]
    noise: Mapping[str, float]
    ranges: Ranges
    candidates: tuple[Candidate, ...]
    basis: np.ndarray
    infos: np.ndarray
    known: np.ndarray
    slopes: np.ndarray
    names: tuple[str, ...]
    gradients: np.ndarray
    criterion: Criterion
    seed: int

    @cached_property
    def directions(self) -> np.ndarray:
        """Orthonormal basis (n, m) of the coordinates, in parameters over the widths of their bounds."""
        return self.basis / scales(self.model)[:, None]

    @cached_property
    def base(self) -> np.ndarray:
        """Prior information, with the ridge that makes it invertible."""
        m = len(self.known)
        return self.known + RIDGE * np.trace(self.infos.mean(axis=0)) * np.eye(m)

    def information(self, counts: np.ndarray) -> np.ndarray:
        """Return the information (m, m) of candidates run `counts` times, with the prior information."""
        return self.known + np.tensordot(counts, self.infos, axes=1)

    def value(self, information: np.ndarray) -> float:
        """Return the criterion of the total information (m, m)."""
        return float(self.criterion.values(information + self.base - self.known))

    def choose(self, runs: int) -> np.ndarray:
        """Return how often each candidate is run in the best choice of `runs` runs that is found.

        Reproducible by seed. Refuses parameters that no such choice determines, with what is missing.
        """
        weak = self.weak(self.known + runs * self.infos.sum(axis=0))
        if weak.shape[1]:
            share = np.abs(weak).max(axis=1)
            lost = [n for n, v in zip(self.model.names, share, strict=True) if v >= 0.3 * share.max()]
            raise InputError(
                f"No run within these ranges determines {', '.join(lost)} of {self.model.name} at these "
                "values: let the axes that they belong to take several positions, give other --values or a "
                "smaller --model."
            )
        rng = np.random.default_rng((self.seed, runs))
        counts = choose(self.infos, self.base, runs, self.criterion, rng)
        if self.weak(self.information(counts)).shape[1] and (least := self.least_runs()) > runs:
            raise InputError(
                f"{runs} runs are too few to determine {self.model.name} within these ranges; allow at "
                f"least {least}."
            )
        return counts

    def weak(self, information: np.ndarray) -> np.ndarray:
        """Return the scaled parameter directions (n, k) that information (m, m) leaves undetermined."""
        values, vectors = np.linalg.eigh(information)
        return self.directions @ vectors[:, values < least_information(values)]

    def least_runs(self) -> int:
        """Return the least number of runs that determine the model, chosen one by one for the volume (D)."""
        d, counts = criterion("D", len(self.known), self.slopes), np.zeros(len(self.infos), dtype=int)
        for n in range(1, MOST_RUNS + 1):
            counts = greedy(self.infos, self.base, n, d, counts)
            if not self.weak(self.information(counts)).shape[1]:
                return n
        raise InputError(f"Even {MOST_RUNS} runs within these ranges do not determine {self.model.name}.")

    def std(self, information: np.ndarray) -> np.ndarray:
        """Return the standard uncertainties of `names`, (q,), SI."""
        return _std(self.gradients @ self.basis, information)

    def position(self, information: np.ndarray) -> np.ndarray:
        """Return the worst standard uncertainty over the workspace of each pose coordinate, (n_pose,), SI."""
        return _std(self.slopes, information).max(axis=0)

    def worst(self, information: np.ndarray) -> Worst:
        """Return the worst-determined combination for information (m, m)."""
        values, vectors = np.linalg.eigh(information)
        direction = self.directions @ vectors[:, 0]
        determined = values[0] > least_information(values)
        direction = direction * np.sign(direction[int(np.argmax(np.abs(direction)))])
        order = np.argsort(-np.abs(direction), kind="stable")
        kept = [int(k) for k in order if abs(direction[k]) >= 0.3 * abs(direction[order[0]])]
        return Worst(
            {self.model.names[k]: float(direction[k]) for k in kept},
            float(values[0] ** -0.5) if determined else None,
        )


def _reduced(information: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return information (..., n, n) about the parameters as (..., m, m) about the coordinates."""
    out = basis.T @ information @ basis
    return np.asarray(0.5 * (out + np.swapaxes(out, -1, -2)))


def _std(gradients: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Return standard uncertainties (...,) of functions with `gradients` (..., m) of the coordinates."""
    half = np.linalg.solve(np.linalg.cholesky(information), gradients.reshape(-1, len(information)).T)
    return np.asarray(np.sqrt(np.sum(half**2, axis=0)).reshape(gradients.shape[:-1]))


def study(
    ranges: Ranges,
    model: Model,
    values: Mapping[str, float],
    noise: Mapping[str, float],
    name: str,
    recorded: np.ndarray | None,
    seed: int,
) -> Study:
    """Return the study of what `ranges` allow. `recorded`: (n, n) information of an earlier log."""
    found = candidates(ranges, model)
    p, scale = model.vector(values), scales(model)
    cost, factor = planned_cost([c.run for c in found], ranges.step_s, model, values, noise)
    null, rest, _ = structural_directions(cost, p)
    basis = scale[:, None] * rest
    m = basis.shape[1]
    if m == 0:
        raise InputError(f"Every parameter of {model.name} is fixed; there is nothing to plan for.")
    names, gradients = _quantities(model, p, scale, null, basis)
    points = corners(ranges.box, (*model.pose, *model.state))
    pose, state = np.split(points.T, [len(model.pose)])
    still = np.zeros((len(model.offsets), len(points)))
    slopes = influence(model, p, list(still), list(pose), list(state)).parameters @ basis
    return Study(
        model=model,
        values=values,
        noise=noise,
        ranges=ranges,
        candidates=found,
        basis=basis,
        infos=_reduced(cost.at(p).information(0.0) * factor[:, None, None], basis),
        known=np.zeros((m, m)) if recorded is None else _reduced(recorded, basis),
        slopes=slopes,
        names=names,
        gradients=gradients,
        criterion=criterion(name, m, slopes / ranges.references(model.pose)[:, None]),
        seed=seed,
    )


def _quantities(
    model: Model, p: np.ndarray, scale: np.ndarray, null: np.ndarray, basis: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and gradients (q, n) of identifiable quantities.

    Parameters, and the model's combinations of the others, which null directions do not move.
    """

    def determined(gradient: np.ndarray) -> bool:
        size = 1e-6 * np.linalg.norm(gradient * scale)
        moved = np.linalg.norm((gradient * scale) @ null)
        return bool(moved <= size and np.linalg.norm(gradient @ basis) > size)

    rows = dict(zip(model.names, np.eye(len(p)), strict=True))
    lost = {name for name, row in rows.items() if not determined(row)}
    for named in model.combinations:
        if lost & set(named.parameters):
            rows[named.expression] = combination(model, named).first(p)[1]
    kept = {name: row for name, row in rows.items() if determined(row)}
    return tuple(kept), np.array(list(kept.values())).reshape(-1, len(p))
