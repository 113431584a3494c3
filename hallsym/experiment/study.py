"""What every choice of runs needs, computed once: the information of each candidate and what counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hallsym.errors import InputError
from hallsym.experiment.candidates import Candidate, candidates
from hallsym.experiment.criteria import Criterion, criterion
from hallsym.experiment.exchange import choose, greedy
from hallsym.experiment.information import Directions, Worst, directions, planned_cost, quantities
from hallsym.experiment.ranges import Ranges, corners
from hallsym.experiment.relaxed import Relaxed, relax
from hallsym.model import Model
from hallsym.model.influence import influence
from hallsym.simulation import Campaign

RIDGE = 1e-9
"""Share of a run's mean information that stands for what is known before anything is recorded, so that
criteria have values for fewer runs than the model needs; no reported uncertainty contains it."""
SHORTLIST = 120
"""Candidates that are tried for every run: those that gain most at the relaxed optimum."""
MOST_RUNS = 500


@dataclass(frozen=True, eq=False)
class Choice:
    """`counts`: (candidates,) how often each is run. `information`: (m, m) with what was known before.

    `value` and `bound`: phi of this choice and what no choice of as many runs exceeds.
    """

    counts: np.ndarray
    information: np.ndarray
    value: float
    bound: float

    @property
    def efficiency(self) -> float:
        """Share of the bound that is reached; the best plan's own share may be below 1."""
        return self.value / self.bound


@dataclass(frozen=True, eq=False)
class Outcome:
    """What recorded information determines.

    `value`: the criterion. `std`: (q,) standard uncertainties of the study's `names`, `position`: (n_pose,)
    worst one over the workspace that the parameters leave in the decoded position, SI. `worst`: the
    worst-determined combination.
    """

    value: float
    std: np.ndarray
    position: np.ndarray
    worst: Worst


@dataclass(frozen=True, eq=False)
class Study:
    """Candidates with their information (candidates, m, m) about the determinable `directions`.

    `known`: (m, m) information recorded before. `slopes`: (points, n_pose, m) of the decoded position over
    the workspace, SI. `names`, `gradients`: what standard uncertainties are given for, (q, n).
    """

    model: Model
    values: Mapping[str, float]
    noise: Mapping[str, float]
    ranges: Ranges
    candidates: tuple[Candidate, ...]
    directions: Directions
    infos: np.ndarray
    known: np.ndarray
    slopes: np.ndarray
    names: tuple[str, ...]
    gradients: np.ndarray
    criterion: Criterion
    seed: int
    _choices: dict[int, Choice] = field(default_factory=dict)

    def without_curves(self) -> "Study | None":
        """Return the same study without the candidates that follow a curve; None where none or all do."""
        kept = [k for k, candidate in enumerate(self.candidates) if candidate.run.follows is None]
        if len(kept) in (0, len(self.candidates)):
            return None
        some = tuple(self.candidates[k] for k in kept)
        return replace(self, candidates=some, infos=self.infos[kept], _choices={})

    @cached_property
    def base(self) -> np.ndarray:
        """What is known before, with the ridge that makes it invertible."""
        m = len(self.known)
        return self.known + RIDGE * np.trace(self.infos.mean(axis=0)) * np.eye(m)

    def value(self, information: np.ndarray) -> float:
        """Return the criterion of information (m, m) that is recorded in all."""
        return float(self.criterion.values(information + self.base - self.known))

    def choose(self, runs: int) -> Choice:
        """Return the best choice of `runs` runs that is found; the same for the same seed."""
        if runs not in self._choices:
            relaxed = self._relaxed(runs)
            short = self._shortlist(relaxed, runs)
            some = replace(relaxed, shares=relaxed.shares[short])
            rng = np.random.default_rng((self.seed, runs))
            counts = np.zeros(len(self.infos), dtype=int)
            counts[short] = choose(self.infos[short], self.base, runs, self.criterion, some, rng)
            total = self.known + np.tensordot(counts, self.infos, axes=1)
            self._choices[runs] = Choice(
                counts, total, self.value(total), relaxed.bound(self.infos, self.base, runs)
            )
        return self._choices[runs]

    def _relaxed(self, runs: int) -> Relaxed:
        """The relaxation; where nothing is known before, its shares are the same for any number of runs."""
        if np.any(self.known):
            return relax(self.infos, self.base, runs, self.criterion)
        return self._from_nothing

    @cached_property
    def _from_nothing(self) -> Relaxed:
        return relax(self.infos, self.base, len(self.known) + 1, self.criterion)

    def _shortlist(self, relaxed: Relaxed, runs: int) -> np.ndarray:
        M = self.base + runs * np.tensordot(relaxed.shares, self.infos, axes=1)
        gains = self.infos.reshape(len(self.infos), -1) @ self.criterion.slope(M).ravel()
        return np.sort(np.argsort(-gains, kind="stable")[:SHORTLIST])

    def determined(self, information: np.ndarray) -> bool:
        """Whether information (m, m) determines every direction that can be."""
        return self.directions.weak(information).shape[1] == 0

    def least_runs(self) -> int:
        """Return how few runs determine the model, chosen one by one for the volume (D)."""
        d, counts = criterion("D", len(self.known), self.slopes), np.zeros(len(self.infos), dtype=int)
        for n in range(1, MOST_RUNS + 1):
            counts = greedy(self.infos, self.base, n, d, counts)
            if self.determined(self.known + np.tensordot(counts, self.infos, axes=1)):
                return n
        raise InputError(f"Even {MOST_RUNS} runs within these ranges do not determine {self.model.name}.")

    def outcome(self, information: np.ndarray) -> Outcome:
        """Return what information (m, m) that determines every direction gives."""
        return Outcome(
            self.value(information),
            self.std(information),
            self.position(information),
            self.directions.worst(information),
        )

    def std(self, information: np.ndarray) -> np.ndarray:
        """Return the standard uncertainties of `names`, (q,), SI."""
        return self.directions.std(self.gradients, information)

    def position(self, information: np.ndarray) -> np.ndarray:
        """Return the worst standard uncertainty over the workspace of each pose coordinate, (n_pose,), SI."""
        half = np.linalg.solve(np.linalg.cholesky(information), self.slopes.reshape(-1, len(information)).T)
        return np.sqrt(np.sum(half**2, axis=0)).reshape(self.slopes.shape[:2]).max(axis=0)

    def of(self, campaign: Campaign) -> np.ndarray:
        """Return the information (m, m) that a campaign would add."""
        cost, factor = planned_cost(campaign.runs, campaign.step_s, self.model, self.values, self.noise)
        p = self.model.vector(self.values)
        return self.directions.reduced(np.tensordot(factor, cost.at(p).information(0.0), axes=1))

    def check(self, runs: int) -> None:
        """Refuse what no choice of `runs` runs can determine, and say what is missing."""
        weak = self.directions.weak(self.known + runs * self.infos.sum(axis=0))
        if weak.shape[1]:
            share = np.abs(weak).max(axis=1)
            lost = [n for n, v in zip(self.model.names, share, strict=True) if v >= 0.3 * share.max()]
            raise InputError(
                f"No run within these ranges determines {', '.join(lost)} of {self.model.name} at these "
                "values: let the axes that they belong to take several positions, give other --values or a "
                "smaller --model."
            )
        if not self.determined(self.choose(runs).information):
            least = self.least_runs()
            if least > runs:
                raise InputError(
                    f"{runs} runs are too few to determine {self.model.name} within these ranges; allow at "
                    f"least {least}."
                )


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
    p = model.vector(values)
    cost, factor = planned_cost([c.run for c in found], ranges.step_s, model, values, noise)
    known = directions(cost, p)
    infos = known.reduced(cost.at(p).information(0.0) * factor[:, None, None])
    slopes = _workspace(ranges, model, p) @ known.basis
    names, gradients = quantities(known, p)
    m = infos.shape[1]
    if m == 0:
        raise InputError(f"Every parameter of {model.name} is fixed; there is nothing to plan for.")
    return Study(
        model=model,
        values=values,
        noise=noise,
        ranges=ranges,
        candidates=found,
        directions=known,
        infos=infos,
        known=np.zeros((m, m)) if recorded is None else known.reduced(recorded),
        slopes=slopes,
        names=names,
        gradients=gradients,
        criterion=criterion(name, m, slopes / ranges.references(model.pose)[:, None]),
        seed=seed,
    )


def _workspace(ranges: Ranges, model: Model, p: np.ndarray) -> np.ndarray:
    """Slopes of the decoded position at corners, face centres and centre of the ranges, by parameter."""
    points = corners(ranges.box, (*model.pose, *model.state))
    rest = np.zeros((len(model.zeros), len(points)))
    pose, state = np.split(points.T, [len(model.pose)])
    return influence(model, p, list(rest), list(pose), list(state)).parameters
