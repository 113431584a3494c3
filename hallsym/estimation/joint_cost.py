"""The likelihood of several logs of one device: the sum of their costs, of parameters that most logs share.

Every log keeps its own run statistics and its own noise. A parameter is shared by all logs, or each log has
one of its own; `Sharing` says which, and the sum knows derivatives, information and zeros of all of them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import casadi as ca
import numpy as np

from hallsym.estimation.coefficients import Coefficients
from hallsym.estimation.likelihood import Cost, Point
from hallsym.estimation.run_statistics import RunStatistics, joined
from hallsym.model import Model
from hallsym.model.model import Combination, Signals, Step


@dataclass(frozen=True, eq=False)
class Sharing:
    """Which parameters several logs share.

    `model`: of one log, n parameters. `joint`: the same model with the parameters of all logs; one that a log
    has of its own is named `gain[log]`, and its readings are those of the last log. `chosen`: per log the
    index (n,) of its parameters among those.
    """

    model: Model
    own: tuple[str, ...]
    logs: tuple[str, ...]
    joint: Model
    chosen: tuple[np.ndarray, ...]

    @staticmethod
    def of(model: Model, own: Collection[str], logs: Sequence[str]) -> "Sharing":
        """Return how `logs` share the parameters of `model`; each has those named `own` for itself."""
        parameters, chosen = [], [np.zeros(len(model.names), dtype=int) for _ in logs]
        for k, parameter in enumerate(model.parameters):
            for g, log in enumerate(logs):
                if parameter.name in own or g == 0:
                    name = own_name(parameter.name, log) if parameter.name in own else parameter.name
                    parameters.append(replace(parameter, name=name))
                chosen[g][k] = len(parameters) - 1
        several = replace(
            model,
            parameters=tuple(parameters),
            steps=tuple((link, _with_own(step, own, logs[-1])) for link, step in model.steps),
            combinations=tuple(c for one in model.combinations for c in _by_log(one, own, logs)),
            period=dict(model.period)
            | {own_name(n, log): model.period[n] for n in own if n in model.period for log in logs},
        )
        return Sharing(model, tuple(own), tuple(logs), several if own else model, tuple(chosen))

    def of_log(self, log: int, p: np.ndarray) -> np.ndarray:
        """Return the parameters (n,) of one log out of all."""
        return p[self.chosen[log]]


def own_name(parameter: str, log: str) -> str:
    """Return what the parameter of one log is called among those of all.

    >>> own_name("eta_A", "night2")
    'eta_A[night2]'
    """
    return f"{parameter}[{log}]"


def _with_own(step: Step, own: Collection[str], log: str) -> Step:
    """Return a step that reads the parameters which one log has of its own."""

    def read(signals: Signals, p: Mapping[str, ca.SX]) -> None:
        step(signals, {**p, **{name: p[own_name(name, log)] for name in own}})

    return read


def _by_log(one: Combination, own: Collection[str], logs: Sequence[str]) -> list[Combination]:
    """Return a combination once for each log where a log's own parameter is part of it."""
    if not set(one.parameters) & set(own):
        return [one]
    return [_of_log(one, own, log) for log in logs]


def _of_log(one: Combination, own: Collection[str], log: str) -> Combination:
    named = {n: own_name(n, log) if n in own else n for n in one.parameters}

    def value(p: Mapping[str, ca.SX]) -> ca.SX:
        return one.value({**p, **{name: p[here] for name, here in named.items()}})

    return replace(
        one, expression=own_name(one.expression, log), parameters=tuple(named.values()), value=value
    )


@dataclass(frozen=True, eq=False)
class JointCost(Cost):
    """The sum of the costs of several logs; `parts` and `chosen` as `Cost.shares` pairs them.

    Its runs are those of the logs one after the other, under other numbers where two logs have the same.
    `reading_variance` and `column_variance` are means over the samples; each part has its own.
    """

    parts: tuple[Cost, ...] = ()
    chosen: tuple[np.ndarray, ...] = ()

    @property
    def shares(self) -> tuple[tuple[Cost, np.ndarray], ...]:
        """The cost of each log, with the index of its parameters."""
        return tuple(zip(self.parts, self.chosen, strict=True))

    @property
    def by_population(self) -> bool:
        """Whether every part can."""
        return all(part.by_population for part in self.parts)

    @cached_property
    def noise_in_features(self) -> np.ndarray:
        """Of every run by the noise of its own log, (runs, f, f)."""
        return np.concatenate([part.noise_in_features for part in self.parts])

    def runs_of(self, log: int) -> slice:
        """Return where the runs of a log stand among all."""
        ends = [0, *accumulate(len(part.weights) for part in self.parts)]
        return slice(ends[log], ends[log + 1])

    def weighted(self, weights: np.ndarray) -> "JointCost":
        """Return the same cost with other run weights."""
        weights = np.asarray(weights, dtype=float)
        parts = tuple(part.weighted(weights[self.runs_of(g)]) for g, part in enumerate(self.parts))
        return replace(self, weights=weights, parts=parts)

    def anchored(self, p: np.ndarray) -> "JointCost":
        """Return a cost whose re-weightings share what has been computed at `p`."""
        parts = tuple(part.anchored(p[chosen]) for part, chosen in self.shares)
        return replace(self, parts=parts)

    def population(self, points: np.ndarray) -> np.ndarray:
        """Return F of whole populations, (m, n) -> (m,), of parts that are merged."""
        return np.sum([part.population(points[:, chosen]) for part, chosen in self.shares], axis=0)

    def at(self, p: np.ndarray) -> "JointPoint":
        """Return everything the cost knows at one parameter vector."""
        return JointPoint(self, np.asarray(p, dtype=float))


class JointPoint(Point):
    """The joint cost at one parameter vector: what `Point` knows, for the runs of all logs."""

    def __init__(self, cost: JointCost, p: np.ndarray) -> None:
        self.cost, self.p, self.joint = cost, p, cost
        self.points = [part.at(p[chosen]) for part, chosen in cost.shares]
        self.zeros = self._joined([point.zeros for point in self.points])
        self.run_values = self._joined([point.run_values for point in self.points])
        self.value = float(sum(point.value for point in self.points))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of a residual in each run, (r, K, K)."""
        return self._joined([point.covariance for point in self.points])

    @property
    def squares(self) -> np.ndarray:
        """Sum of the products of a run's residuals, (r, K, K)."""
        return self._joined([point.squares for point in self.points])

    @property
    def feature_products(self) -> np.ndarray:
        """Sum of the products of each feature with each channel's residual, (r, f, K)."""
        return self._joined([point.feature_products for point in self.points])

    @property
    def W(self) -> np.ndarray:
        """Inverse of `covariance`."""
        return self._joined([point.W for point in self.points])

    def keep_derivatives(self) -> None:
        """Keep gradient and Hessian of every run."""
        for point in self.points:
            point.keep_derivatives()

    def derivatives(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return F, its gradient (n,) and its exact Hessian (n, n)."""
        n = len(self.p)
        gradient, hessian = np.zeros(n), np.zeros((n, n))
        for point, chosen in zip(self.points, self.joint.chosen, strict=True):
            _, part, square = point.derivatives()
            gradient[chosen] += part
            hessian[np.ix_(chosen, chosen)] += square
        return self.value, gradient, hessian

    @cached_property
    def run_gradients(self) -> np.ndarray:
        """Gradient of each run's own F, (r, n)."""
        out = np.zeros((len(self.run_values), len(self.p)))
        for g, (point, chosen) in enumerate(zip(self.points, self.joint.chosen, strict=True)):
            out[self.joint.runs_of(g), chosen] = point.run_gradients
        return out

    @property
    def run_hessians(self) -> np.ndarray:
        """Exact Hessian of each run's own F, (r, n, n)."""
        return self._spread([point.run_hessians for point in self.points])

    def information(self, noise_factor: float = 1.0, free: np.ndarray | None = None) -> np.ndarray:
        """Expected information of each run, (r, n, n), of the parameters `free`."""
        whole = self._spread([point.information(noise_factor) for point in self.points])
        return whole if free is None else np.ascontiguousarray(whole[:, free[:, None], free])

    def total_information(self, noise_factor: float = 1.0) -> np.ndarray:
        """Expected information of all runs by their weights, (n, n)."""
        total = np.zeros((len(self.p),) * 2)
        for point, chosen in zip(self.points, self.joint.chosen, strict=True):
            total[np.ix_(chosen, chosen)] += point.total_information(noise_factor)
        return total

    def zero_covariance(self, covariance: np.ndarray) -> np.ndarray:
        """Covariance of each run's zero displacements [m^2], (r, z, z)."""
        return self._joined([
            point.zero_covariance(covariance[np.ix_(chosen, chosen)])
            for point, chosen in zip(self.points, self.joint.chosen, strict=True)
        ])  # fmt: skip

    def _spread(self, matrices: Sequence[np.ndarray]) -> np.ndarray:
        """Return matrices of the parameters of each log as those of all, (r, n, n)."""
        out = np.zeros((len(self.run_values), len(self.p), len(self.p)))
        for g, (own, chosen) in enumerate(zip(matrices, self.joint.chosen, strict=True)):
            out[self.joint.runs_of(g), chosen[:, None], chosen] = own
        return out


def joint_cost(sharing: Sharing, costs: Sequence[Cost], numbers: Sequence[dict[int, int]]) -> JointCost:
    """Return the sum of the costs of the logs; `numbers`: of each log, run -> number among all."""
    counts = np.array([cost.weights @ cost.summary.counts for cost in costs])
    share = counts / max(counts.sum(), 1e-300)
    summary = joined([numbered(cost.summary, known) for cost, known in zip(costs, numbers, strict=True)])
    features = replace(summary.features, model=sharing.joint)
    return JointCost(
        replace(summary, features=features),
        Coefficients(features, summary.centre),
        share @ [cost.reading_variance for cost in costs],
        share @ [cost.column_variance for cost in costs],
        np.concatenate([cost.weights for cost in costs]),
        parts=tuple(costs),
        chosen=sharing.chosen,
    )


def numbered(summary: RunStatistics, numbers: dict[int, int]) -> RunStatistics:
    """Return run statistics whose runs have other numbers."""
    return replace(summary, runs=tuple(numbers[run] for run in summary.runs))


def run_numbers(runs: Sequence[Sequence[int]]) -> tuple[dict[int, int], ...]:
    """Return for each log run -> number among all logs: its own where no other log has it.

    Else the number of the log, from 1, stands before that of the run.

    >>> run_numbers([[0, 7], [7, 12]])
    ({0: 100, 7: 107}, {7: 207, 12: 212})
    """
    every = [run for own in runs for run in own]
    if len(set(every)) == len(every):
        return tuple({run: run for run in own} for own in runs)
    step = 10 ** len(str(max(map(abs, every))))
    return tuple({run: step * (g + 1) + run for run in own} for g, own in enumerate(runs))
