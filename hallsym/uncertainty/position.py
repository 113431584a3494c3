"""Uncertainty of a decoded position: a budget for any pose, maps, and rms and worst over a recording.

First-order propagation, JCGM 100 (10) and (13), with the exact slopes of `hallsym.model.influence`.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from hallsym.errors import InputError, require
from hallsym.estimation import Fit
from hallsym.log import Log, batches
from hallsym.model import Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.uncertainty.gum import Budget, Source, students
from hallsym.uncertainty.inputs import Settings, independent_inputs, slopes

POINTS, SLICES = 41, 5
"""Points along each planar axis of a map, and how many heights it shows, where only a span is given."""


# -- a budget --------------------------------------------------------------------------------------------


def position_budget(
    fit: Fit,
    at: Mapping[str, float] | None = None,
    settings: Settings | None = None,
) -> dict[str, Budget]:
    """Return one budget per pose coordinate for the position decoded at a pose and vertical state.

    `at`: pose or state column -> value in SI, `Model.rest` where not given. The fit covariance is one source,
    "fit". Raises `InputError` where a gain crosses zero and for a calibration without covariance.
    """
    settings = settings or Settings()
    pose, state = place(fit.model, at or {})
    found = slopes(fit, pose[:, None], state[:, None], settings)
    by_input = [(entry.source, found.of(entry)[0]) for entry in independent_inputs(fit, settings)]
    budgets = {}
    for i, column in enumerate(fit.model.pose):
        rest = [replace(source, sensitivity=float(slope[i])) for source, slope in by_input]
        unit = column.rpartition("_")[2]
        rest += [
            Source.normal(n, float(np.sqrt(v[0, i])), unit) for n, v in found.left.items() if v[0, i] > 0
        ]
        slope = found.parameters[0, i]
        from_fit = float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
        dof = float(fit_degrees_of_freedom(fit, slope))
        budgets[column] = Budget(
            quantity=column,
            unit=unit,
            sources=(Source.normal("fit", from_fit, unit, degrees_of_freedom=dof), *rest),
            coverage=settings.coverage,
            level=settings.level,
            value=float(pose[i]),
            turns=column in fit.model.period,
        )
    return budgets


def fit_degrees_of_freedom(fit: Fit, slope: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom (...,) of the fit's contribution to results with slopes (..., n).

    The mean of those of the parameters, weighed by their contributions. Welch-Satterthwaite would give more
    than any parameter has, as if the errors of the variances were independent; they come from the same runs.
    """
    share = np.square(slope * np.sqrt(np.diag(fit.covariance)))
    few = (share / fit.degrees_of_freedom).sum(axis=-1)
    total = share.sum(axis=-1)
    return np.asarray(np.divide(total, few, out=np.full(np.shape(total), inf), where=few > 1e-15 * total))


def place(model: Model, at: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return pose (n_pose,) and state (n_state,) of `at`, at rest where not given; refuse unknown columns."""
    columns = [*model.pose, *model.state]
    for column, value in at.items():
        wanted = f"given in columns of {model.name} ({', '.join(columns)})"
        require(column in columns, "Position", wanted, column, columns)
        require(np.isfinite(value), f"Position {column}", "a finite number", value)
    whole = model.rest | dict(at)
    pose, state = (np.array([float(whole[c]) for c in names]) for names in (model.pose, model.state))
    return pose, state


def notes(fit: Fit, settings: Settings) -> list[str]:
    """Return the notes of a budget: contributions that it lacks, and assumptions."""
    said = []
    if fit.undetermined_by_log:
        said.append(
            f"the log of this calibration does not determine {', '.join(fit.undetermined_by_log)}; "
            "their contribution is not in the budget."
        )
    if fit.at_bound:
        said.append(
            f"{', '.join(fit.at_bound)} ended at a bound and count as known; the budget is too small by "
            "their contribution."
        )
    amiss = fit.goodness and fit.goodness.said("the model of this calibration does not describe its log")
    if fit.goodness and amiss and settings.model_error is None:
        said.append(
            f"{amiss}; that is in no source, so the true uncertainty is larger; "
            f"next: {fit.goodness.next_command}"
        )
    if fit.model.offsets and settings.zero_averaged == 1:
        said.append(
            "the zeroing is taken from 1 reading; [zeroing] averaged = N in the settings states how many."
        )
    return said


# -- many positions --------------------------------------------------------------------------------------


def _expanded(fit: Fit, pose: np.ndarray, state: np.ndarray, settings: Settings) -> np.ndarray:
    """U of the positions decoded at poses (n_pose, s) and states (n_state, s), shape (s, n_pose)."""
    found = slopes(fit, pose, state, settings)
    from_fit = np.einsum("spj,spj->sp", found.parameters @ fit.covariance, found.parameters)
    total = from_fit.copy()
    for entry in independent_inputs(fit, settings):
        total += (entry.source.std * found.of(entry)) ** 2
    for variance in found.left.values():
        total += variance
    if settings.level is None:
        return settings.coverage * np.sqrt(total)
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = fit_degrees_of_freedom(fit, found.parameters) * np.square(total / from_fit)
    return students(settings.level, dof) * np.sqrt(total)


@dataclass(frozen=True, eq=False)
class Recorded:
    """U over a workspace, one entry per pose coordinate.

    `span`: column -> least and greatest value of pose and state. `rms`: root mean square of U, `worst`: its
    largest value, `where`: the pose and state of that. `periodic`: columns that go round.
    """

    span: Mapping[str, tuple[float, float]]
    rms: Mapping[str, float]
    worst: Mapping[str, float]
    where: Mapping[str, Mapping[str, float]]
    samples: int
    periodic: Collection[str] = ()

    def outside(self, at: Mapping[str, float]) -> list[str]:
        """Columns of `at` that lie outside the recorded span by more than a hundredth of it."""
        out = []
        for column, value in at.items():
            low, high = self.span[column]
            slack = 0.01 * (high - low)
            if not low - slack <= value <= high + slack:
                out.append(column)
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers in SI for JSON."""
        return {
            "samples": self.samples,
            "span": {c: list(v) for c, v in self.span.items()},
            "rms": dict(self.rms),
            "worst": {
                c: {"at": dict(self.where[c]), "expanded_uncertainty": u} for c, u in self.worst.items()
            },
        }


def _over(model: Model, parts: Iterable[tuple[np.ndarray, np.ndarray]]) -> Recorded | None:
    """Return U over a workspace in parts: pose and state (columns, s), U (s, n_pose); None without any."""
    names, n = (*model.pose, *model.state), len(model.pose)
    low, high = np.full(len(names), np.inf), np.full(len(names), -np.inf)
    squares, worst, where, count = np.zeros(n), np.zeros(n), np.zeros((n, len(names))), 0
    for data, U in parts:
        low, high = np.minimum(low, data.min(axis=1)), np.maximum(high, data.max(axis=1))
        squares, count = squares + np.einsum("sp,sp->p", U, U), count + len(U)
        for i, k in enumerate(np.argmax(U, axis=0)):
            if U[k, i] > worst[i]:
                worst[i], where[i] = U[k, i], data[:, k]
    if not count:
        return None
    return Recorded(
        span=dict(zip(names, zip(low.tolist(), high.tolist(), strict=True), strict=True)),
        rms=named(model.pose, np.sqrt(squares / count)),
        worst=named(model.pose, worst),
        where={c: named(names, where[i]) for i, c in enumerate(model.pose)},
        samples=count,
        periodic=model.period,
    )


def over_log(fit: Fit, log: Log, settings: Settings | None = None) -> Recorded:
    """Return U over every recorded pose and state of `log`, read in batches."""
    settings, model = settings or Settings(), fit.model

    def parts() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for batch in batches(log, (*model.references, *model.state)):
            data = np.array(batch.columns((*model.references, *model.state)))
            data = data[:, np.all(np.isfinite(data), axis=0)]
            if data.shape[1]:
                pose, state = np.split(data, [len(model.pose)])
                yield data, _expanded(fit, pose, state, settings)

    found = _over(model, parts())
    if found is None:
        raise InputError(f"{log.name} holds no sample with a reference and a state; give another log.")
    return found


@dataclass(frozen=True, eq=False, repr=False)
class UncertaintyMap(Shown):
    """U of every pose coordinate on a grid.

    `axes`: column -> values along it [SI], in the order of the grid's axes. `fixed`: where the other columns
    stay. `expanded`: (n_pose, *grid), in the units of `pose`. `recorded`: rms and worst over the grid.
    """

    pose: tuple[str, ...]
    axes: Mapping[str, np.ndarray]
    fixed: Mapping[str, float]
    expanded: np.ndarray
    settings: Settings
    recorded: Recorded

    @property
    def periodic(self) -> Collection[str]:
        """Columns that go round."""
        return self.recorded.periodic

    def to_dict(self) -> dict[str, Any]:
        """Return the map as plain numbers in SI: one nested list per pose coordinate."""
        return {
            "axes": {c: v.tolist() for c, v in self.axes.items()},
            "fixed": dict(self.fixed),
            "expanded_uncertainty": named(self.pose, self.expanded),
            "worst": self.recorded.to_dict()["worst"],
        }


def map_axes(model: Model) -> tuple[str, ...]:
    """Columns of a map: two pose coordinates and, where the model has one, the first state column."""
    return (*model.pose[:2], *model.state[:1])


def uncertainty_map(
    fit: Fit,
    axes: Mapping[str, Sequence[float]],
    settings: Settings | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
) -> UncertaintyMap:
    """Return U on the grid of `axes`: column -> values. Other columns are `fixed`, or `Model.rest`.

    Two values are least and greatest: 41 points along a pose coordinate, 5 along a state column.
    """
    settings, model = settings or Settings(), fit.model
    lines = {c: _line(model, c, np.asarray(v, dtype=float)) for c, v in axes.items()}
    place(model, dict.fromkeys(lines, 0.0) | dict(fixed or {}))
    rest = model.rest | dict(fixed or {})
    mesh = np.meshgrid(*lines.values(), indexing="ij")
    size = mesh[0].size
    at = {c: np.full(size, v) for c, v in rest.items()}
    at |= {c: grid.ravel() for c, grid in zip(lines, mesh, strict=True)}
    pose, state = (
        np.array([at[c] for c in names]).reshape(len(names), size) for names in (model.pose, model.state)
    )
    flat = _expanded(fit, pose, state, settings)
    over = _over(model, [(np.vstack([pose, state]), flat)])
    assert over is not None
    over = replace(over, span={c: over.span[c] for c in lines})
    others = {c: float(v) for c, v in rest.items() if c not in lines}
    return UncertaintyMap(model.pose, lines, others, flat.T.reshape(-1, *mesh[0].shape), settings, over)


def _line(model: Model, column: str, values: np.ndarray) -> np.ndarray:
    good = values.ndim == 1 and len(values) and np.all(np.isfinite(values)) and np.all(np.diff(values) > 0)
    require(good, f"Axis {column} of a map", "one or more finite numbers that grow", values.tolist())
    if len(values) != 2:
        return values
    return np.linspace(values[0], values[1], POINTS if column in model.pose else SLICES)
