"""The fit of several logs as it is handed out: one `Fit` a log, and one of all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, cast

import numpy as np

from hallsym.estimation.calibration import CombinationEstimate, Errors, Fit, Joint, SolverRecord
from hallsym.estimation.channel_assignment import Wiring
from hallsym.estimation.covariance import Uncertainty, uncertainty_at
from hallsym.estimation.decoding import ErrorTable
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, goodness_of
from hallsym.estimation.joint_cost import Sharing, own_name
from hallsym.estimation.lower_bound import LowerBound, lower_bound
from hallsym.estimation.optimum import Solution
from hallsym.estimation.result import fit_of
from hallsym.estimation.task import Solved, Task
from hallsym.log import Noise
from hallsym.log.batches import Weigh


@dataclass(frozen=True, eq=False)
class Member:
    """One of several logs at their common optimum; `solution` is that of its own runs and parameters."""

    name: str
    task: Task
    solution: Solution
    errors: Errors
    keep: Weigh | None
    wiring: Wiring | None
    mounted: Wiring | None
    notes: tuple[str, ...]
    held_out: bool = False


def several_fit(
    sharing: Sharing,
    solution: Solution,
    members: Sequence[Member],
    judged: Sequence[Member],
    numbers: Sequence[Mapping[int, int]],
    began: float,
) -> Fit:
    """Return the fit of the logs `members`; `judged`: those held out. `numbers`: per log run -> number."""
    point = solution.point
    found = solution.determined
    estimate = uncertainty_at(point, found)
    free = int(np.count_nonzero(np.diag(estimate.covariance)))
    bound = None if sharing.own else lower_bound(point, free)
    fits = [
        _of_log(member, _own(estimate, sharing, g, goodness), began)
        for g, (member, goodness) in enumerate(zip(members, _goodness(members, free), strict=True))
    ]
    last = _own(estimate, sharing, len(members) - 1, estimate.goodness)
    fits += [_of_log(m, replace(last, goodness=_judged_goodness(m)), began) for m in judged]
    parts = [*members, *judged]
    renumbered = [*numbers, *_further(judged, numbers)]
    records = tuple(
        _record(member, fit, sharing, known)
        for member, fit, known in zip(parts, fits, renumbered, strict=True)
    )
    whole = _whole(fits[: len(members)], members, numbers, sharing, solution, estimate, bound, began)
    return replace(whole, by_log=tuple(fits), logs=records)


def _of_log(member: Member, estimate: Uncertainty, began: float) -> Fit:
    solved = Solved(member.task, member.solution, member.errors, member.keep, member.wiring)
    return fit_of(solved, member.solution.determination, estimate, None, member.notes, member.mounted, began)


def _goodness(members: Sequence[Member], free: int) -> list[GoodnessOfFit]:
    """Return what the fit leaves in each log; the parameters are shared out by samples."""
    points = [m.solution.point for m in members]
    counts = np.array([point.cost.summary.counts.sum() for point in points])
    share = free * counts / max(counts.sum(), 1e-300)
    return [goodness_of(point, round(own)) for point, own in zip(points, share.tolist(), strict=True)]


def _judged_goodness(member: Member) -> GoodnessOfFit:
    return goodness_of(member.solution.everywhere, 0)


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


def _further(judged: Sequence[Member], numbers: Sequence[Mapping[int, int]]) -> list[dict[int, int]]:
    """Return numbers for the runs of held-out logs: their own, since they stand in no table with others."""
    return [{run: run for run in member.solution.everything.summary.runs} for member in judged]


def _record(member: Member, fit: Fit, sharing: Sharing, numbers: Mapping[int, int]) -> dict[str, Any]:
    """Return what is saved of one log beside the calibration."""
    at = [fit.model.names.index(n) for n in sharing.own]
    return {
        "name": member.name,
        "held_out": member.held_out,
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
    members: Sequence[Member],
    numbers: Sequence[Mapping[int, int]],
    sharing: Sharing,
    solution: Solution,
    estimate: Uncertainty,
    bound: LowerBound | None,
    began: float,
) -> Fit:
    """Return the fit of all logs; parameters of which each log has its own are those of the last log."""
    last = fits[-1]
    noise = _noise(fits)
    holdout = tuple(known[r] for m, known in zip(members, numbers, strict=True) for r in m.task.holdout)
    errors = Errors(
        _tables([m.errors.designed for m in members], numbers),
        _tables([m.errors.fitted for m in members], numbers),
        holdout,
    )
    counts = np.array([fit.log["rows"] for fit in fits], dtype=float)
    floors = np.array([list(fit.noise_floor.values()) for fit in fits])
    floor = np.sqrt(counts / counts.sum() @ floors**2)
    solver = cast(SolverRecord, {
        **last.solver,
        "cost": solution.search.cost,
        "cost_per_degree_of_freedom": estimate.cost_per_dof,
        "evaluations": solution.search.evaluations,
        "starts": solution.search.starts,
        "share_at_optimum": solution.search.share,
        "lower_bound": None if bound is None else bound.to_dict(),
    })  # fmt: skip
    worst = max(fits, key=lambda fit: fit.goodness.residual_over_noise if fit.goodness else 0.0)
    goodness = estimate.goodness.judged(
        noise, (*last.model.channels, *last.model.references), members[0].task.log.meta.gap_threshold_rel
    )
    goodness = replace(goodness, next_command=worst.goodness.next_command if worst.goodness else "")
    names = sharing.joint.names
    return replace(
        last,
        structural=last.structural,
        zeros={known[r]: z for fit, known in zip(fits, numbers, strict=True) for r, z in fit.zeros.items()},
        noise=noise,
        noise_floor=dict(zip(last.model.pose, floor.tolist(), strict=True)),
        solver=solver,
        log={
            "path": ", ".join(str(f.log["path"] or m.name) for f, m in zip(fits, members, strict=True)),
            "sha256": None,
            "rows": sum(fit.log["rows"] for fit in fits),
            "runs": sum(fit.log["runs"] for fit in fits),
            "holdout": list(holdout),
            "span": {column: list(ends) for column, ends in errors.fitted.span.items()},
        },
        seconds=perf_counter() - began,
        goodness=goodness,
        notes=_notes(fits, members, numbers, sharing),
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


def _notes(
    fits: Sequence[Fit], members: Sequence[Member], numbers: Sequence[Mapping[int, int]], sharing: Sharing
) -> tuple[str, ...]:
    """Return what is to be said of the logs, each note once, with the log that it is of."""
    out = [
        type(note)(f"{m.name}: {note}") for fit, m in zip(fits, members, strict=True) for note in fit.notes
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
