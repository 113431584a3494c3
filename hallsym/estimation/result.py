"""A solved fit as the `Fit` that is handed out: uncertainties, zero deviations, notes, what was done.

`lower_bound`: a model's readings are linear in its features, and its parameters only choose the
coefficients, by formulas and inside bounds. Free coefficients leave less, whatever the formulas are. A cost
near that bound cannot be improved by another start, which is evidence where agreement among starts is none.
"""

import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.estimation.calibration import Fit
from hallsym.estimation.covariance import Uncertainty, uncertainty
from hallsym.estimation.gauss_newton import deviations_of
from hallsym.estimation.goodness_of_fit import WORTH_REPORTING, diagnose_command, limit_of, noise_floor
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Point
from hallsym.estimation.linearised import exact
from hallsym.estimation.normal_equations import pseudo_inverse, unit_scale
from hallsym.estimation.plausible import composed
from hallsym.estimation.residual_noise import with_noise
from hallsym.estimation.task import Solved
from hallsym.families import added_effects
from hallsym.log.phase import home_notes
from hallsym.model import Model

COLLINEAR = 1e-8
"""Eigenvalue, over the largest, below which features repeat each other: to four digits, beyond which the sum
of squares that they explain is rounding."""


@dataclass(frozen=True)
class LowerBound:
    """Cost of the unconstrained linear fit, at the weights that residuals have at the optimum.

    `ratio`: cost at the optimum over `cost`, 1 or more. `expected`: the ratio that follows from the number of
    `coefficients` alone, where the formulas of the model hold and no bound is in the way.
    """

    cost: float
    ratio: float
    expected: float
    coefficients: int

    @property
    def near(self) -> bool:
        """Whether the optimum costs no more, beyond the expected, than what is worth reporting."""
        return self.ratio <= self.expected * limit_of(1.0, WORTH_REPORTING) ** 2

    def to_dict(self) -> dict[str, Any]:
        """Return the record of calib.json and `--json`."""
        return {**vars(self), "near": self.near}


def lower_bound(point: Point, estimated: int) -> LowerBound | None:
    """Return the bound for the optimum at `point`, where `estimated` parameters were free.

    Offsets of a run that multiply a changing state are free by themselves here too. None where nothing is
    left over to compare with: as many free coefficients as readings.
    """
    cost, summary, z = point.cost, point.cost.summary, point.cost.summary.features.n_zero
    K, left, products = len(cost.reading_variance), point.squares, point.feature_products
    grams, squares, rank = cost.grams, left, 0
    if z:
        inner = pseudo_inverse(grams[:, :z, :z], COLLINEAR)
        rank = int(np.round(np.einsum("rij,rji->r", inner, grams[:, :z, :z])) @ (cost.weights > 0))
        across = inner @ np.concatenate([grams[:, :z, z:], products[:, :z]], axis=2)
        squares = squares - np.swapaxes(products[:, :z], 1, 2) @ across[:, :, -K:]
        products = products[:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, -K:]
        grams = grams[:, z:, z:] - np.swapaxes(grams[:, :z, z:], 1, 2) @ across[:, :, :-K]
    W = point.W * cost.weights[:, None, None]
    f = grams.shape[-1]
    H = np.tensordot(W, grams, axes=(0, 0)).transpose(0, 2, 1, 3).reshape(K * f, K * f)
    g = np.swapaxes(products @ W, 1, 2).sum(axis=0).ravel()
    unit = unit_scale(H)
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    some = values > COLLINEAR * values.max(initial=0.0)
    gains = np.square((unit * g) @ vectors[:, some]) / values[some]
    bound, free = float(np.einsum("rij,rji->", W, squares) - gains.sum()), int(some.sum())
    readings = float(cost.weights @ summary.counts) * K
    zeros = len(summary.model.zeros) * int(np.sum(cost.weights > 0))
    over = readings - rank * K - free
    if over < 1 or not bound > 0:
        return None
    expected = max((readings - estimated - zeros) / over, 1.0)
    return LowerBound(bound, max(point.value / bound, 1.0), expected, free)


def result_of(solved: Solved, began: float) -> Fit:
    """Return the fit that is handed out; `began`: when, by `perf_counter`."""
    state, found = solved.solution, solved.solution.determined
    point = state.point
    estimate = uncertainty(point, found)
    free = int(np.count_nonzero(np.diag(estimate.covariance)))
    asked = solved.errors is not None  # a quick fit that found nothing amiss needs no further evidence
    bound = lower_bound(point, free) if asked and exact(solved.task.model) else None
    return fit_of(solved, found, estimate, bound, began)


def fit_of(
    solved: Solved,
    found: Determination,
    estimate: Uncertainty,
    bound: LowerBound | None,
    began: float,
) -> Fit:
    """Return the fit of a solved log, with what is determined of its parameters, and how certainly."""
    task, state, errors = solved.task, solved.solution, solved.errors
    model = task.model
    path = task.log.path
    whole = (
        path.parent if path is not None and path.is_file() and task.log.meta.raw else path
    )  # a folder with its meta.json
    command = diagnose_command(whole, model, added_effects(model))
    zeros = deviations_of(state.everywhere)
    delta = np.array(list(zeros.values()))
    return Fit(
        model=model,
        values=state.p,
        std=estimate.std,
        determined=estimate.determined,
        covariance=estimate.covariance,
        covariance_method=estimate.method,
        covariance_reason=estimate.reason,
        degrees_of_freedom=estimate.degrees_of_freedom,
        held=tuple(model.names[k] for k in found.held),
        structural=found.structural,
        at_bound=estimate.at_bound,
        combinations=estimate.combinations,
        zeros=zeros,
        noise=task.noise,
        noise_floor=noise_floor(state.point),
        status=state.search.status,
        message=state.search.message,
        solver={
            "name": task.asked.solver,
            "loss": task.asked.loss,
            "cost": state.search.cost,
            "cost_per_degree_of_freedom": estimate.cost_per_dof,
            "evaluations": state.search.evaluations,
            "starts": state.search.starts,
            "share_at_optimum": state.search.share,
            "seed": task.asked.seed,
            "lower_bound": None if bound is None else bound.to_dict(),
        },
        log={
            "path": None if task.log.path is None else str(task.log.path),
            "sha256": None,
            "rows": task.log.rows,
            "runs": len(state.everything.summary.runs),
            "holdout": list(task.holdout),
            "span": {c: list(ends) for c, ends in errors.fitted.span.items()} if errors else {},
        },
        seconds=perf_counter() - began,
        goodness=replace(
            with_noise(estimate.goodness, task.log, state.point, task.noise, solved.keep),
            next_command=command,
        ),
        notes=(
            *solved.notes,
            *zero_notes(model, tuple(zeros), delta),
            *(home_notes(task.log, model, zeros) if errors else ()),
        ),
        errors=errors,
        keep=solved.keep,
        source=task.log,
        likelihood=state.fitted,
        determination=found,
        undetermined_by_log=estimate.undetermined_by_log,
        wiring=composed(solved.mounted, solved.wiring, model.channels),
        turned=solved.mounted is not None and solved.wiring is None,
        columns=dict(task.log.table.mapping),
        read_with=dict(task.log.table.read_with),
        versions=dict(_versions()),
        error_rows=errors.rows() if errors else {},
    )


def zero_notes(model: Model, runs: Sequence[int], delta: np.ndarray) -> tuple[str, ...]:
    """Zero deviations beyond their bounds are reported, not clipped: clipping would bend the parameters."""
    out = []
    for k, zero in enumerate(model.zeros):
        beyond = [r for r, d in zip(runs, delta[:, k], strict=True) if not zero.lower <= d <= zero.upper]
        if beyond:
            factor, unit = (1e6, "um") if zero.unit == "m" else (float(np.degrees(1.0)), "deg")
            low, high, worst = (factor * v for v in (zero.lower, zero.upper, np.abs(delta[:, k]).max()))
            out.append(
                f"Zero deviation {zero.name} is beyond {low:.3g} to {high:.3g} {unit} in {len(beyond)} runs "
                f"(run {beyond[0]} first, {worst:.3g} {unit} at most): look at the reset."
            )
    return tuple(out)


@cache
def _versions() -> dict[str, str]:
    packages = ("hallsym", "casadi", "numpy", "scipy")
    found = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return {"python": platform.python_version(), **found}
