"""Several logs of one device: shared parameters, each log with its own runs, noise and outliers.

Their cost is the sum of the costs of all (`hallsym.estimation.likelihood.joint_cost`), and their fit one
calibration with a record of each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from msgspec import structs

from hallsym.errors import InputError
from hallsym.estimation.calibration import (
    CombinationEstimate,
    Estimate,
    Fit,
    FittedLogRecord,
    Joint,
    LogRecord,
    LowerBound,
)  # fmt: skip
from hallsym.estimation.covariance import Uncertainty, uncertainty
from hallsym.estimation.decoding import Errors, ErrorTable
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Sharing, own_name
from hallsym.estimation.optimum import Solution
from hallsym.estimation.task import Begun, LogFit, fit_of, lower_bound
from hallsym.log import Log, Noise
from hallsym.log.quality.findings import Fault
from hallsym.model import Model
from hallsym.units import UNITS

LIKE_A_UNIT = 0.1
"""Relative distance of a ratio of gains from that of two units within which it shows another unit."""
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
        both = f"{first.short_name} and {log.short_name}"
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
                    f"Units differ between files: {channel} of {log.short_name} is {factor:.4g} times that "
                    f"of {logs[0].short_name}, the ratio of two units; correct the unit with --column, or "
                    "fit each log by itself."
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
    members: Sequence[LogFit],
    judged: Sequence[LogFit],
    names: Sequence[str],
    numbers: Sequence[Mapping[int, int]],
    began: float,
) -> Fit:
    """Return the fit of the logs `members`; `judged`: the holdout logs. `numbers`: per log run -> number."""
    estimate = uncertainty(solution.point, solution.determined, [one.samples for one in members])
    bound = None if sharing.own else lower_bound(solution.point, estimate.fitted)
    each = _goodness(members, estimate.fitted)
    own = [_own(estimate, sharing, g, goodness) for g, goodness in enumerate(each)]
    own += [replace(own[-1], goodness=goodness_of(m.solution.everywhere, 0)) for m in judged]
    fits = [
        fit_of(m, m.solution.determination, e, None, began)
        for m, e in zip((*members, *judged), own, strict=True)
    ]
    # runs of holdout logs keep their numbers, since they stand in no table with others
    renumbered = [*numbers, *({run: run for run in m.solution.everything.summary.runs} for m in judged)]
    records = tuple(
        _record(name, k >= len(members), fit, sharing, known)
        for k, (name, fit, known) in enumerate(zip(names, fits, renumbered, strict=True))
    )
    whole = _whole(fits[: len(members)], numbers, sharing, solution, estimate, bound, began)
    return whole.changed(by_log=tuple(fits), logs=records)


def _goodness(members: Sequence[LogFit], free: int) -> list[GoodnessOfFit]:
    """Return the goodness of fit of each log; the degrees of freedom are shared by samples."""
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
    """Whether a named combination belongs to the log with this suffix, or to all."""
    others = [own_name("", log) for log in sharing.logs]
    return expression.endswith(suffix) or not any(expression.endswith(other) for other in others)


def _renamed(c: CombinationEstimate, named: Mapping[str, str], suffix: str) -> CombinationEstimate:
    """Return a combination with the names that the parameters have in one log."""
    expression, factors = c.expression.removesuffix(suffix), c.factors
    if factors:
        for joint, name in named.items():
            expression = expression.replace(joint, name)
        factors = {named[n]: value for n, value in factors.items()}
    return structs.replace(c, expression=expression, factors=factors)


def _record(
    name: str, held_out: bool, fit: Fit, sharing: Sharing, numbers: Mapping[int, int]
) -> FittedLogRecord:
    """Return what is saved of one log beside the calibration."""
    own = {n: fit.parameters[n] for n in sharing.own}
    return FittedLogRecord(
        name=name,
        held_out=held_out,
        log=structs.replace(fit.log, sha256=fit.sha256),
        runs=dict(numbers),
        errors=dict(fit.error_rows),
        noise=fit.noise,
        parameters={n: Estimate(p.value, p.std, p.unit) for n, p in own.items()},
        residual_over_noise=fit.goodness.residual_over_noise if fit.goodness else None,
    )


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
    holdout = tuple(known[r] for f, known in zip(fits, numbers, strict=True) for r in f.log.holdout)
    tables = [fit.errors for fit in fits if fit.errors]
    errors = Errors(
        _tables([own.fitted for own in tables], numbers), holdout,
        lambda: _tables([own.designed for own in tables], numbers),
    )  # fmt: skip
    counts = np.array([fit.log.rows for fit in fits], dtype=float)
    floors = np.array([list(fit.noise_floor.values()) for fit in fits])
    floor = np.sqrt(counts / counts.sum() @ floors**2)
    cost = estimate.goodness.cost_per_degree_of_freedom
    solver = structs.replace(last.solver, cost_per_degree_of_freedom=cost, lower_bound=bound)
    worst = max(fits, key=lambda fit: fit.goodness.residual_over_noise if fit.goodness else 0.0)
    limits = max((fit.goodness for fit in fits if fit.goodness), key=lambda each: each.limit)
    goodness = replace(
        estimate.goodness, uncertain=limits.uncertain, threshold=limits.threshold,
        next_command=worst.goodness.next_command if worst.goodness else "",
    )  # fmt: skip
    names = sharing.joint.names
    return last.changed(
        zero_deviations={
            known[r]: z
            for fit, known in zip(fits, numbers, strict=True)
            for r, z in fit.zero_deviations.items()
        },
        noise=noise,
        noise_floor=dict(zip(last.model.pose, floor.tolist(), strict=True)),
        solver=solver,
        log=LogRecord(
            path=", ".join(str(f.log.path or name) for f, name in zip(fits, sharing.logs, strict=True)),
            rows=sum(fit.log.rows for fit in fits),
            runs=sum(fit.log.runs for fit in fits),
            holdout=holdout,
            span=errors.fitted.span,
        ),
        seconds=perf_counter() - began,
        goodness=goodness,
        notes=_notes(fits, numbers, sharing),
        errors=errors,
        error_rows=errors,
        keep=None,
        source=None,
        likelihood=None if sharing.own else solution.fitted,
        determination=None if sharing.own else solution.determined,
        undetermined_by_log=estimate.undetermined_by_log,
        joint=Joint(names, solution.p, estimate.std, estimate.covariance, sharing.own, sharing.logs),
    )


def _noise(fits: Sequence[Fit]) -> Noise:
    """Return the noise of every column over the samples of all logs (rms)."""
    counts = np.array([fit.log.rows for fit in fits], dtype=float)
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
    """Return the notes on the logs, each note once, with the name of its log."""
    out = [
        note.of(f"{log}: {note}") if isinstance(note, Fault) else f"{log}: {note}"
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


def restricted(found: Determination, sharing: Sharing, g: int) -> Determination:
    """Return the identifiability of the parameters of one log."""
    chosen, names = sharing.chosen[g], sharing.model.names
    place = {int(k): own for own, k in enumerate(chosen)}
    structural = [names[place[k]] for k, n in enumerate(sharing.joint.names)
                  if n in found.structural and k in place]  # fmt: skip
    fixed = tuple(place[k] for k in found.fixed if k in place)
    gauges = np.array([j for j, k in enumerate(found.dependent) if k in place], dtype=int)
    return replace(found, scale=found.scale[chosen], null=found.null[chosen], fixed=fixed,
                   structural=tuple(structural), gauge=found.gauge[np.ix_(gauges, chosen)],
                   dependent=tuple(place[found.dependent[j]] for j in gauges))  # fmt: skip
