"""Several logs of one device: shared parameters, each log with its own runs, noise and outliers.

Every log is checked, summarised and judged by itself (`Task`), with one centre for all, and only the optimum
is that of the sum of their costs (`joint_cost`). No sample is read more often than by a fit of one log.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import accumulate
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.estimation import outliers, start
from hallsym.estimation.calibration import CombinationEstimate, Errors, Fit, Joint
from hallsym.estimation.covariance import Uncertainty, uncertainty
from hallsym.estimation.decoding import ErrorTable, columns_of
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Coefficients, Cost, Point, cost_of
from hallsym.estimation.linearised import exact
from hallsym.estimation.optimum import Solution, search
from hallsym.estimation.plausible import lateness, rewired
from hallsym.estimation.residual_noise import noise_followed
from hallsym.estimation.result import LowerBound, fit_of, lower_bound, result_of
from hallsym.estimation.run_statistics import RunStatistics, joined
from hallsym.estimation.task import Asked, Begun, Opened, Solved, Task, held_out, prepared
from hallsym.log import Log, Noise
from hallsym.log.batches import Weigh, batches, remembered
from hallsym.log.phase import continuous, nearest_turn
from hallsym.log.quality.findings import name_of
from hallsym.log.quality.gains import explained
from hallsym.model import Model
from hallsym.model.model import Combination, Signals, Step
from hallsym.units import UNITS


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
    return [_combination_of_log(one, own, log) for log in logs]


def _combination_of_log(one: Combination, own: Collection[str], log: str) -> Combination:
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
        self._parts = self.points
        self.zeros = self._joined([point.zeros for point in self.points])
        self.run_values = self._joined([point.run_values for point in self.points])
        self.value = float(sum(point.value for point in self.points))

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
        k = np.arange(len(self.p)) if free is None else free
        return self._spread([point.information(noise_factor) for point in self.points])[:, k[:, None], k]

    def total_information(self, noise_factor: float = 1.0) -> np.ndarray:
        """Expected information of all runs by their weights, (n, n)."""
        return np.tensordot(self.cost.weights, self.information(noise_factor), axes=1)

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


LIKE_A_UNIT = 0.1
"""Relative distance of a ratio of gains from that of two units within which another unit is what it shows."""
LEAST_RATIO = 5.0
"""Ratio of gains below which two logs of one device may differ: a repair, an air gap, a temperature."""


def labels(logs: Sequence[Log]) -> tuple[str, ...]:
    """Return a short name of each log: that of its file or folder, else its place, 1 first; all different."""
    out: list[str] = []
    for k, log in enumerate(logs):
        path = log.path
        name = (
            str(k + 1)
            if path is None
            else path.parent.name
            if path.stem == "log"
            else path.name.partition(".")[0]
        )
        name = name.replace("[", "(").replace("]", ")") or str(k + 1)
        out.append(name if name not in out else f"{name} {k + 1}")
    return tuple(out)


def check_same(logs: Sequence[Log], models: Sequence[Model]) -> None:
    """Raise `InputError` where the models of two logs, or their devices by name, are not the same."""
    first, known = logs[0], models[0]
    for log, model in zip(logs[1:], models[1:], strict=True):
        both = f"{name_of(first)} and {name_of(log)}"
        if (model.name, model.effects, model.channels) != (known.name, known.effects, known.channels):
            raise InputError(
                f"{both} have different models, {known.name} ({', '.join(known.channels)}) and "
                f"{model.name} ({', '.join(model.channels)}); fit those of one device, or give --model."
            )
        if None not in (a := (first.meta.device, log.meta.device)) and a[0] != a[1]:
            raise InputError(
                f"{both} are of different devices, {a[0]!r} and {a[1]!r} by their meta.json; fit each by "
                "itself, or all with 'hallsym fleet'."
            )
        differ = [
            p.name for p, q in zip(known.parameters, model.parameters, strict=True)
            if (p.nominal, p.lower, p.upper) != (q.nominal, q.lower, q.upper)
        ]  # fmt: skip
        if differ or known.layout != model.layout:
            what = f"the nominal value or bounds of {differ[0]}" if differ else "the places of the probes"
            raise InputError(
                f"{both} state another machine: {what} differ in their meta.json; correct one, or give "
                "--machine, which holds for all."
            )


def check_gains(logs: Sequence[Log], model: Model, begun: Sequence[Begun]) -> None:
    """Raise `InputError` where a channel of one log is that of the first one in another unit."""
    for log, own in zip(logs[1:], begun[1:], strict=True):
        for channel, ratio in zip(model.channels, _ratios(own, begun[0]), strict=True):
            if (factor := unit_factor(float(ratio), channel)) is not None:
                raise InputError(
                    f"Units differ between files: {channel} of {name_of(log)} is {factor:.4g} times that of "
                    f"{name_of(logs[0])}, the ratio of two units; correct the unit with --column, or fit "
                    "each log by itself."
                )


def unit_factor(ratio: float, column: str) -> float | None:
    """Return the ratio of two units of the column's kind that a ratio of gains is; None for no such ratio.

    >>> unit_factor(998.0, "v_sin_v")
    1000.0
    """
    if not ratio > 0 or 1 / LEAST_RATIO < ratio < LEAST_RATIO:
        return None
    own = column.rpartition("_")[2]
    scales = {unit.factor for unit in UNITS.values() if unit.si == own} | {1.0}
    factors = sorted({a / b for a in scales for b in scales if a != b}, key=lambda f: abs(np.log(ratio / f)))
    if not factors or abs(ratio / factors[0] - 1) > LIKE_A_UNIT:
        return None
    return float(factors[0])


def _ratios(begun: Begun, first: Begun) -> np.ndarray:
    """Return each channel's linear coefficients over those of the first log, (K,), in size."""
    merged, known = first.merged, first.linear
    features = merged.summary.features
    both = begun.linear.moved & known.moved
    both &= np.array([features.label(j) != "1" for j in range(features.size)])
    size = np.sqrt(np.einsum("jj->j", merged.grams[0]))[:, None]
    own, other = (np.linalg.norm((one.coefficients * size)[both], axis=0) for one in (begun.linear, known))
    return own / np.maximum(other, 1e-300)


def several_fit(
    sharing: Sharing,
    solution: Solution,
    members: Sequence[Solved],
    judged: Sequence[Solved],
    names: Sequence[str],
    numbers: Sequence[Mapping[int, int]],
    began: float,
) -> Fit:
    """Return the fit of the logs `members`; `judged`: those held out. `numbers`: per log run -> number."""
    estimate = uncertainty(solution.point, solution.determined)
    free = int(np.count_nonzero(np.diag(estimate.covariance)))
    bound = None if sharing.own else lower_bound(solution.point, free)
    own = [_own(estimate, sharing, g, goodness) for g, goodness in enumerate(_goodness(members, free))]
    own += [replace(own[-1], goodness=goodness_of(m.solution.everywhere, 0)) for m in judged]
    fits = [
        fit_of(m, m.solution.determination, e, None, began)
        for m, e in zip((*members, *judged), own, strict=True)
    ]
    # runs of held-out logs keep their numbers, since they stand in no table with others
    renumbered = [*numbers, *({run: run for run in m.solution.everything.summary.runs} for m in judged)]
    records = tuple(
        _record(name, k >= len(members), fit, sharing, known)
        for k, (name, fit, known) in enumerate(zip(names, fits, renumbered, strict=True))
    )
    whole = _whole(fits[: len(members)], numbers, sharing, solution, estimate, bound, began)
    return replace(whole, by_log=tuple(fits), logs=records)


def _goodness(members: Sequence[Solved], free: int) -> list[GoodnessOfFit]:
    """Return what the fit leaves in each log; the parameters are shared out by samples."""
    points = [m.solution.point for m in members]
    counts = np.array([point.cost.summary.counts.sum() for point in points])
    share = free * counts / max(counts.sum(), 1e-300)
    return [goodness_of(point, round(own)) for point, own in zip(points, share.tolist(), strict=True)]


def _own(estimate: Uncertainty, sharing: Sharing, g: int, goodness: GoodnessOfFit) -> Uncertainty:
    """Return the uncertainties of the parameters of one log."""
    chosen = sharing.chosen[g]
    named = {sharing.joint.names[k]: n for k, n in zip(chosen, sharing.model.names, strict=True)}
    suffix = own_name("", sharing.logs[g])
    combinations = [
        _renamed(c, named, suffix) for c in estimate.combinations
        if (set(c.factors) <= set(named) if c.factors else _of(c.expression, sharing, suffix))
    ]  # fmt: skip
    lost = [n for n in estimate.undetermined_by_log if n in named or _of(n, sharing, suffix)]
    return replace(
        estimate,
        std=estimate.std[chosen],
        determined=estimate.determined[chosen],
        covariance=estimate.covariance[np.ix_(chosen, chosen)],
        at_bound=tuple(named[n] for n in estimate.at_bound if n in named),
        combinations=tuple(combinations),
        undetermined_by_log=tuple(named.get(n, n.removesuffix(suffix)) for n in lost),
        degrees_of_freedom=estimate.degrees_of_freedom[chosen],
        goodness=goodness,
    )


def _of(expression: str, sharing: Sharing, suffix: str) -> bool:
    """Whether a named combination is of the log with this suffix, or of all."""
    others = [own_name("", log) for log in sharing.logs]
    return expression.endswith(suffix) or not any(expression.endswith(other) for other in others)


def _renamed(c: CombinationEstimate, named: Mapping[str, str], suffix: str) -> CombinationEstimate:
    """Return a combination with the names that the parameters have in one log."""
    expression, factors = c.expression.removesuffix(suffix), c.factors
    if factors:
        for joint, name in named.items():
            expression = expression.replace(joint, name)
        factors = {named[n]: value for n, value in factors.items()}
    return replace(c, expression=expression, factors=factors)


def _record(
    name: str, held_out: bool, fit: Fit, sharing: Sharing, numbers: Mapping[int, int]
) -> dict[str, Any]:
    """Return what is saved of one log beside the calibration."""
    at = [fit.model.names.index(n) for n in sharing.own]
    return {
        "name": name,
        "held_out": held_out,
        "log": {**fit.log, "sha256": fit.source.sha256 if fit.source else None},
        "runs": {str(run): number for run, number in numbers.items()},
        "errors": dict(fit.error_rows),
        "noise": {c: {"value": s.value, "source": s.source} for c, s in fit.noise.sigmas.items()},
        "parameters": {
            fit.model.names[k]: {
                "value": float(fit.values[k]),
                "std": float(fit.std[k]) if np.isfinite(fit.std[k]) else None,
                "unit": fit.model.parameters[k].unit,
            }
            for k in at
        },
        "residual_over_noise": fit.goodness.residual_over_noise if fit.goodness else None,
    }


def _whole(
    fits: Sequence[Fit],
    numbers: Sequence[Mapping[int, int]],
    sharing: Sharing,
    solution: Solution,
    estimate: Uncertainty,
    bound: LowerBound | None,
    began: float,
) -> Fit:
    """Return the fit of all logs; parameters of which each log has its own are those of the last log."""
    last, noise = fits[-1], _noise(fits)
    holdout = tuple(known[r] for f, known in zip(fits, numbers, strict=True) for r in f.log["holdout"])
    tables = [fit.errors for fit in fits if fit.errors]
    errors = Errors(
        _tables([own.designed for own in tables], numbers), _tables([own.fitted for own in tables], numbers),
        holdout,
    )  # fmt: skip
    counts = np.array([fit.log["rows"] for fit in fits], dtype=float)
    floors = np.array([list(fit.noise_floor.values()) for fit in fits])
    floor = np.sqrt(counts / counts.sum() @ floors**2)
    solver = {
        **last.solver,
        "cost_per_degree_of_freedom": estimate.cost_per_dof,
        "lower_bound": None if bound is None else bound.to_dict(),
    }
    worst = max(fits, key=lambda fit: fit.goodness.residual_over_noise if fit.goodness else 0.0)
    limits = max((fit.goodness for fit in fits if fit.goodness), key=lambda each: each.limit)
    goodness = replace(
        estimate.goodness, uncertain=limits.uncertain, threshold=limits.threshold,
        next_command=worst.goodness.next_command if worst.goodness else "",
    )  # fmt: skip
    names = sharing.joint.names
    return replace(
        last,
        zeros={known[r]: z for fit, known in zip(fits, numbers, strict=True) for r, z in fit.zeros.items()},
        noise=noise,
        noise_floor=dict(zip(last.model.pose, floor.tolist(), strict=True)),
        solver=solver,
        log={
            "path": ", ".join(str(f.log["path"] or name) for f, name in zip(fits, sharing.logs, strict=True)),
            "sha256": None,
            "rows": sum(fit.log["rows"] for fit in fits),
            "runs": sum(fit.log["runs"] for fit in fits),
            "holdout": list(holdout),
            "span": {column: list(ends) for column, ends in errors.fitted.span.items()},
        },
        seconds=perf_counter() - began,
        goodness=goodness,
        notes=_notes(fits, numbers, sharing),
        errors=errors,
        error_rows=errors.rows(),
        keep=None,
        source=None,
        likelihood=None if sharing.own else solution.fitted,
        determination=None if sharing.own else solution.determined,
        undetermined_by_log=estimate.undetermined_by_log,
        joint=Joint(names, solution.p, estimate.std, estimate.covariance, sharing.own, sharing.logs),
    )


def _noise(fits: Sequence[Fit]) -> Noise:
    """Return the noise of every column over the samples of all logs (rms)."""
    counts = np.array([fit.log["rows"] for fit in fits], dtype=float)
    out = {}
    for column, sigma in fits[-1].noise.sigmas.items():
        own = np.array([fit.noise[column].value for fit in fits])
        out[column] = replace(sigma, value=float(np.sqrt(counts @ own**2 / counts.sum())))
    return Noise(out)


def _tables(tables: Sequence[ErrorTable], numbers: Sequence[Mapping[int, int]]) -> ErrorTable:
    """Return the error tables of several logs as one."""
    span: dict[str, tuple[float, float]] = {}
    for column in dict.fromkeys(c for table in tables for c in table.span):
        ends = [table.span[column] for table in tables if column in table.span]
        span[column] = (min(low for low, _ in ends), max(high for _, high in ends))
    return ErrorTable(
        tables[0].pose,
        tuple(known[run] for table, known in zip(tables, numbers, strict=True) for run in table.runs),
        np.concatenate([table.count for table in tables]),
        np.concatenate([table.squares for table in tables]),
        np.concatenate([table.peak for table in tables]),
        span,
    )


def _notes(fits: Sequence[Fit], numbers: Sequence[Mapping[int, int]], sharing: Sharing) -> tuple[str, ...]:
    """Return what is to be said of the logs, each note once, with the log that it is of."""
    out = [
        type(note)(f"{log}: {note}")
        for fit, log in zip(fits, sharing.logs, strict=True)
        for note in fit.notes
    ]
    first = next(((g, r, n) for g, own in enumerate(numbers) for r, n in own.items() if r != n), None)
    if first is not None:
        g, run, number = first
        out.append(f"Runs have the number of their log before their own: {number} is run {run} of "
                   f"{sharing.logs[g]}.")  # fmt: skip
    if sharing.own:
        out.append(f"{', '.join(sharing.own)}: each log has its own; the calibration holds those of "
                   f"{sharing.logs[-1]}, the last.")  # fmt: skip
    return tuple(dict.fromkeys(out))


CLEARLY = 2.0
"""Cost of a fit over that of another reading of the log from which on the other is right: noise alone makes
them equal, to a few percent."""
ROUNDS = 12
"""Of taking outliers out and fitting again, at most."""


def fit_several(
    logs: Sequence[Log],
    holdout_logs: Sequence[Log],
    models: Sequence[Model],
    per_log: Sequence[str],
    asked: Asked,
    *,
    alone: bool,
    began: float,
) -> Fit:
    """Return the fit of several logs, or of one `alone`; `models`: of logs and held-out logs, in order."""
    every, model = [*logs, *holdout_logs], models[0]
    check_same(every, models)
    if not exact(model):
        raise InputError(
            f"Model {model.name} with {', '.join(model.effects)} has no run statistics, so several "
            "logs cannot be fitted together with it; fit them without the effects, or one at a time."
        )
    names = labels(every)
    own = _own_parameters(model, per_log, len(logs), bool(holdout_logs))
    opened = _opened(every, model, len(logs), asked)
    check_gains(every, opened[0].task.model, [one.begun for one in opened])
    together = _Together(opened[: len(logs)], Sharing.of(model, own, names[: len(logs)]), asked)
    solution, errors = together.optimum()
    members = [
        one.solved(together.of_log(solution, g), errors[g] if errors else None)
        for g, one in enumerate(together.logs)
    ]
    if alone:
        return result_of(members[0], began)
    judged = [_judged(one, members[-1].solution) for one in opened[len(logs) :]]
    return several_fit(together.sharing, solution, members, judged, names, together.numbers, began)


def _own_parameters(model: Model, per_log: Sequence[str], logs: int, holdout: bool) -> tuple[str, ...]:
    """Return the parameters that each log has of its own, by names and patterns."""
    found: list[str] = []
    for pattern in per_log:
        named = [name for name in model.names if fnmatchcase(name, pattern)]
        if not named:
            raise InputError(
                f"Model {model.name} has no parameter {pattern!r}{nearest(pattern, list(model.names))}; "
                f"each log can have its own of {', '.join(model.names)}."
            )
        found += [name for name in named if name not in found]
    if found and logs < 2:
        raise InputError("Parameters per log need two logs at least; give another log, or leave them out.")
    if found and holdout:
        raise InputError(
            f"A held-out log cannot have a {found[0]} of its own, since nothing of it is fitted; leave "
            "per-log parameters or held-out logs out, or hold out some runs of that log."
        )
    return tuple(found)


def _opened(logs: Sequence[Log], model: Model, fitted: int, asked: Asked) -> list[Opened]:
    """Return every log checked, summarised about the centre of the first, and judged."""
    out: list[Opened] = []
    centre: np.ndarray | None = None
    known = {run for log in logs[:fitted] for run in log.runs}
    if fitted > 1 and (lost := [run for run in asked.holdout or () if run not in known]):
        raise InputError(f"Held-out run {lost[0]} is in none of the {fitted} logs.")
    for k, log in enumerate(logs):
        asked.say(f"checking {log.name}")
        ready, said, mounted = prepared(log, model, drop_bad=asked.drop_bad)
        held = log.meta.holdout if asked.holdout is None else tuple(asked.holdout)
        held = held if fitted == 1 else tuple(r for r in held if r in ready.runs)
        task = Task(ready, model, held_out(ready, held) if k < fitted else (), asked, centre=centre)
        found = task.opened()
        centre = found.begun.everything.summary.centre
        found.mounted, found.notes = mounted.wiring, (*said, *found.judged.notes)
        out.append(found)
    return out


class _Together:
    """The logs that are fitted, and their common optimum."""

    def __init__(self, logs: list[Opened], sharing: Sharing, asked: Asked) -> None:
        self.logs, self.sharing, self.asked = logs, sharing, asked
        self.numbers = run_numbers([one.begun.everything.summary.runs for one in logs])

    def optimum(self) -> tuple[Solution, list[Errors] | None]:
        """Return the optimum without outliers, for the noise that each log shows, and errors by log.

        No errors where a quick fit of one log shows nothing amiss.
        """
        state = self.solve(self.asked.solver)
        self._refuse_references(state)
        if self.asked.quick and not self.logs[0].judged.spiky and self.logs[0].task.in_order(state):
            self._check()
            return state, None
        errors = self.errors(state)
        whole, state = state, self._without_outliers(state, errors)
        for g, one in enumerate(self.logs):
            if one.judged.spiky:
                again = one.task.judge(one.begun)
                again.refuse()
                one.notes += again.notes
            one.notes += _late(one, self.of_log(state, g))
        self._check()
        state = self._with_noise_left(state)
        return state, errors if state is whole else self.errors(state)

    def solve(self, solver: str, begin_at: np.ndarray | None = None) -> Solution:
        """Minimise the sum of the costs as they are."""
        everything = self._sum([one.begun.everything for one in self.logs], self.numbers)
        fitted = self._sum([one.begun.fitted for one in self.logs], self.numbers)
        merged = self._sum([one.begun.merged for one in self.logs], [{0: g} for g in range(len(self.logs))])
        model = self.sharing.joint
        first = np.clip(self._first() if begin_at is None else begin_at, *model.bounds)
        found: Determination = determine(fitted, first)
        held = list(found.held)
        first[held] = np.clip(model.nominal, *model.bounds)[held]
        self.asked.say(f"solving with {solver}")
        best = search(
            fitted, merged, first, found, solver=solver, seed=self.asked.seed, newton_first=self.asked.quick
        )
        best = replace(best, p=nearest_turn(model, best.p))
        return Solution(everything, fitted, found, best)

    def _sum(self, costs: list[Cost], numbers: Sequence[dict[int, int]]) -> Cost:
        return costs[0] if len(costs) == 1 else joint_cost(self.sharing, costs, numbers)

    def _refuse_references(self, state: Solution) -> None:
        """Refuse a reference where its sign or order explains the log, and not that of the channels.

        By linear slopes both may; what the fit leaves tells. `state`: the fit with the channels resolved.
        """
        for g, one in enumerate(self.logs):
            for other in one.found.whole if one.wiring is not None else ():
                if not other.only_references or any(c.factor != 1 for c in other.changes):
                    continue
                as_meant = tuple((c.source, c.sign) for c in other.references)
                task = replace(one.task, log=rewired(one.given, one.task.model.references, as_meant))
                turned = replace(one, task=task, begun=task.begin(task.summary()))
                both = _Together([*self.logs[:g], turned, *self.logs[g + 1 :]], self.sharing, self.asked)
                if CLEARLY * both.solve("direct").search.cost < state.search.cost:
                    raise InputError(explained(one.given, task.model, [other]).sentence)

    def _check(self) -> None:
        """Refuse a reference that does not belong."""
        for one in self.logs:
            start.check_reference(one.task.model, one.begun.linear.unexplained, one.task.log.name)

    def _first(self) -> np.ndarray:
        """Return where the search begins: the closed form of all runs, of own parameters that of each log."""
        if self.asked.start is not None:
            every = [np.asarray(self.asked.start, dtype=float)] * len(self.logs)
        elif len(self.logs) == 1:
            every = [start.closed_form(self.logs[0].begun.merged, self.logs[0].begun.linear)]
        else:
            parts = [numbered(one.begun.fitted.summary, known)
                     for one, known in zip(self.logs, self.numbers, strict=True)]  # fmt: skip
            pooled = cost_of(joined(parts).merged(), self.logs[0].task.noise.std)
            shared = start.closed_form(pooled, start.linear_fit(pooled))
            of_own = np.isin(self.sharing.model.names, self.sharing.own)
            every = [
                np.where(of_own, start.closed_form(one.begun.merged, one.begun.linear), shared)
                if of_own.any() else shared
                for one in self.logs
            ]  # fmt: skip
        first = np.zeros(len(self.sharing.joint.names))
        for chosen, values in zip(self.sharing.chosen, every, strict=True):
            first[chosen] = values
        return first

    def of_log(self, state: Solution, g: int) -> Solution:
        """Return the optimum as one log sees it: its runs, its parameters."""
        if len(self.logs) == 1:
            return state
        everything, fitted = state.everything.shares[g][0], state.fitted.shares[g][0]
        return Solution(
            everything, fitted, restricted(state.determination, self.sharing, g),
            replace(state.search, p=self.sharing.of_log(g, state.p)),
        )  # fmt: skip

    def errors(self, state: Solution) -> list[Errors]:
        """Return the error tables of every log."""
        return [one.task.errors(self.of_log(state, g), one.keep) for g, one in enumerate(self.logs)]

    def _suspicious(self, state: Solution, errors: Sequence[Errors]) -> list[int]:
        """Return the logs in which outliers are looked for."""
        if self.asked.loss != "auto":
            return [] if self.asked.loss == "none" else list(range(len(self.logs)))
        return [g for g, own in enumerate(errors)
                if self.logs[g].task.suspicious(self.of_log(state, g), own)]  # fmt: skip

    def _without_outliers(self, state: Solution, errors: Sequence[Errors]) -> Solution:
        """Take outliers out of the logs that show any and fit again, until the same samples are left."""
        if not (loud := self._suspicious(state, errors)):
            return state
        whole, tasks = state, {g: self.logs[g].task for g in loud}
        clean = {g: self.logs[g].begun for g in loud}
        total, before = sum(begun.samples for begun in clean.values()), -1.0
        columns = (*self.sharing.model.references, *self.sharing.model.channels)
        rules = {g: outliers.column_spikes(columns) for g in loud}
        weigh = suspects = {g: remembered(rules[g], tasks[g].log.rows, columns) for g in loud}
        for left_over in reversed(range(ROUNDS)):
            for g in loud:
                self.logs[g].begun = _weighed(tasks[g], weigh[g], clean[g])
            left = sum(self.logs[g].begun.samples for g in loud)
            if left < total:
                self.asked.say(f"refitting without outliers ({100 * (1 - left / total):.2g} % of the weight)")
                state = self.solve("direct")
            self._check()
            if abs(left - before) <= 1e-6 * total or not left_over:
                break
            before = left
            rules = {g: tasks[g].weigh(self.of_log(state, g), suspects[g]) for g in loud}
            weigh = {g: remembered(rules[g], tasks[g].log.rows, columns_of(tasks[g].model)) for g in loud}
        for g, begun in clean.items():
            one, wrong_for = self.logs[g], rules[g].wrong_for
            if one.begun.samples < begun.samples:
                one.keep = weigh[g]
                one.notes += (_left_out(begun.samples, one.begun.samples, self.asked.loss),)
            else:
                one.begun = begun
            if wrong_for:
                one.notes += outliers.too_many_note(sorted(wrong_for, key=columns.index))
        return self.solve(self.asked.solver) if left < total else whole

    def _with_noise_left(self, state: Solution) -> Solution:
        """Return the optimum with the noise that it leaves where that was estimated."""
        changed = False
        for g, one in enumerate(self.logs):
            noise = noise_followed(one.task.log, self.of_log(state, g).point, one.task.noise, one.keep)
            if noise is not None:
                one.task = replace(one.task, log=replace(one.task.log, noise=noise))
                one.begun = one.task.begin(one.begun.everything.summary)
                changed = True
        return self.solve("direct", state.p) if changed else state


def restricted(found: Determination, sharing: Sharing, g: int) -> Determination:
    """Return what is determined of the parameters of one log."""
    chosen, names = sharing.chosen[g], sharing.model.names
    place = {int(k): own for own, k in enumerate(chosen)}
    structural = [names[place[k]] for k, n in enumerate(sharing.joint.names)
                  if n in found.structural and k in place]  # fmt: skip
    held = tuple(place[k] for k in found.held if k in place)
    return replace(found, scale=found.scale[chosen], null=found.null[chosen], held=held,
                   structural=tuple(structural))  # fmt: skip


def _weighed(task: Task, weigh: Weigh, clean: Begun) -> Begun:
    """Return the costs of a log with weights; those without, if no sample lost any."""
    whole = batches(continuous(task.log, task.model), columns_of(task.model))
    lost = any((np.asarray(b.weights(weigh)) < 1).any() for b in whole)  # most logs have no spike
    return task.begin(task.summary(weigh)) if lost else clean


def _left_out(total: float, left: float, loss: str) -> str:
    """Return what to say of the weight that outliers lost."""
    share = f"{100 * (total - left) / total:.2g} %"
    if loss == "tukey":
        return f"Tukey's biweight took {share} of the weight."
    return (
        f"{total - left:.0f} of {total:.0f} samples ({share}) are isolated spikes and were left out of fit "
        "and error tables (--loss none keeps them)."
    )


def _late(one: Opened, state: Solution) -> tuple[str, ...]:
    late = lateness(one.task.log, state.point)
    return () if late is None else (late,)


def _judged(one: Opened, known: Solution) -> Solved:
    """Return a held-out log, decoded with the parameters of the others; all of its runs are held out."""
    everything = one.begun.everything
    state = Solution(everything, everything, known.determination, known.search)
    errors = replace(one.task.errors(state, None), holdout=everything.summary.runs)
    one.notes += _late(one, state)
    start.check_reference(one.task.model, one.begun.linear.unexplained, one.task.log.name)
    return one.solved(state, errors)
