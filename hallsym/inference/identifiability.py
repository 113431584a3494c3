"""`identify`: what the data determine, parameter by parameter, and what they do not."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import scipy

from hallsym.errors import InputError
from hallsym.estimation import (
    CombinationEstimate,
    Cost,
    Determination,
    Fit,
    cost_near,
    coverage_factor,
    feature_scale,
    least_information,
    noise_floor,
    scales,
    structural_directions,
    structural_null,
)
from hallsym.estimation.decoding import logged_columns
from hallsym.estimation.identifiable import MOVING, echelon
from hallsym.inference.evidence import Change, Evidence, Slopes, from_fit, from_plan, slopes_over, visited
from hallsym.inference.intervals import Interval, Intervals, intervals_of, profile_record
from hallsym.log import Log, as_log
from hallsym.model import Model, on_arrays
from hallsym.shown import Shown
from hallsym.simulation import Campaign, table8_noise

NAMED = 0.05
"""Parameters that move less than this part of the leading one along a direction that a recording leaves are
not named with it. A structural direction names all that move: none of them is determined."""


WIDE = 4
"""Parameters of one direction above which what is determined of them is not said in a sentence."""


@dataclass(frozen=True)
class NullDirection:
    """One direction that is not determined: its parameters, and the combinations of them that are."""

    parameters: tuple[str, ...]
    determined: tuple[str, ...]

    @property
    def is_wide(self) -> bool:
        """Whether so many parameters change together that what is determined of them takes a table."""
        return len(self.parameters) > WIDE and len(self.determined) > 1


@dataclass(frozen=True)
class NullSpace:
    """`rank` of `of` directions are determined; `null` names the others that belong here."""

    rank: int
    of: int
    null: tuple[NullDirection, ...]


def structural(cost: Cost, found: Determination, combinations: Sequence[CombinationEstimate]) -> NullSpace:
    """Return the directions no recording determines.

    Their parameters are read off at a point anywhere in the bounds: at the optimum itself an angle near zero
    would hide that a parameter belongs.
    """
    model = cost.summary.model
    open_ = np.array([p.width > 0 for p in model.parameters])
    null = structural_null(cost.coefficients, feature_scale(cost), None, open_)
    of = int(open_.sum())
    return NullSpace(of - found.n_structural, of, _named(null, model.names, combinations, MOVING))


def practical(cost: Cost, found: Determination, combinations: Sequence[CombinationEstimate]) -> NullSpace:
    """Return the directions that this recording leaves undetermined, beyond the structural ones."""
    model = cost.summary.model
    of = sum(p.width > 0 for p in model.parameters)
    null = found.null[:, found.n_structural :]
    return NullSpace(of - found.null.shape[1], of, _named(null, model.names, combinations, NAMED))


def _named(
    null: np.ndarray, names: Sequence[str], combinations: Sequence[CombinationEstimate], least: float
) -> tuple[NullDirection, ...]:
    """Sparse directions that span the columns of `null`, in the order of their first parameter.

    `least`: part of the leading parameter's motion from which on another one is named.
    """
    if null.shape[1] == 0:
        return ()
    out = []
    for row in echelon(null.T):
        involved = tuple(names[k] for k in np.flatnonzero(np.abs(row) > least * np.abs(row).max()).tolist())
        telling = tuple(c.expression for c in combinations if mentions(c.expression, involved))
        out.append(NullDirection(involved, telling))
    return tuple(sorted(out, key=lambda d: list(names).index(d.parameters[0])))


def mentions(expression: str, parameters: Sequence[str]) -> bool:
    """Return whether an expression holds one of some parameters."""
    return bool(set(re.findall(r"[A-Za-z_]\w*", expression)) & set(parameters))


VERDICTS = ("determined", "weak", "at bound", "not determined", "no effect", "fixed")
WEAK = 1 / 3
"""A 95 % interval wider than this part of the bounds makes a parameter weak."""
WEAK_ALONE = 0.25
"""The same for a parameter without finite bounds: standard uncertainty over value."""
TRADED = 0.7
"""Correlation from which a parameter counts as traded off against another."""


@dataclass(frozen=True)
class Verdict:
    """`word` is one of `VERDICTS`; `because` says why, in a few words, where that needs saying."""

    word: str
    because: str = ""


def verdicts(
    evidence: Evidence, structural: NullSpace, practical: NullSpace, correlation: np.ndarray
) -> list[Verdict]:
    """Return one verdict per parameter; `correlation` is (n, n), nan where there is none."""
    return [_verdict(evidence, k, structural, practical, row) for k, row in enumerate(correlation)]


def _verdict(
    evidence: Evidence,
    k: int,
    structural: NullSpace,
    practical: NullSpace,
    correlation: np.ndarray,
) -> Verdict:
    parameter, names, told = evidence.model.parameters[k], evidence.model.names, evidence.uncertainty
    if parameter.width == 0:
        return Verdict("fixed")
    if parameter.name in told.at_bound:
        return Verdict("at bound", _bound(evidence, k))
    shared = [d for d in structural.null if parameter.name in d.parameters]
    if shared and not told.determined[k]:
        word = "not determined" if len(shared[0].parameters) > 1 else "no effect"
        return Verdict(word, _instead(parameter.name, *shared))
    if evidence.information[k, k] * evidence.found.scale[k] ** 2 < 1.0:
        return Verdict("no effect", "its whole range leaves no trace in these readings")
    if not told.determined[k]:
        lost = [d for d in practical.null if parameter.name in d.parameters]
        cause = "by this recording" if practical.null else "by any recording"
        return Verdict("not determined", _instead(parameter.name, *lost, cause=cause))
    half = float(coverage_factor(told.degrees_of_freedom[k])) * told.std[k]
    share = 2 * half / parameter.width if np.isfinite(parameter.width) else 0.0
    alone = told.std[k] / abs(evidence.p[k]) if not share and evidence.p[k] else 0.0
    if share > WEAK or alone > WEAK_ALONE:
        traded = [f"{n} (r = {r:+.2f})" for n, r in strongest(correlation, names, k) if abs(r) > TRADED]
        spans = f"its interval spans {100 * share:.0f} % of its bounds"
        return Verdict("weak", f"traded off against {', '.join(traded)}" if traded else spans)
    return Verdict("determined")


def strongest(
    correlation: np.ndarray, names: Sequence[str], k: int, most: int = 3
) -> list[tuple[str, float]]:
    """Return the parameters whose estimates are most correlated with parameter k, largest first."""
    size = np.abs(np.where(np.isfinite(correlation), correlation, 0.0))
    size[k] = 0.0
    order = [int(j) for j in np.argsort(-size, kind="stable") if size[j] > 0][:most]
    return [(names[j], float(correlation[j])) for j in order]


def _bound(evidence: Evidence, k: int) -> str:
    p = evidence.model.parameters[k]
    side = "lower" if abs(evidence.p[k] - p.lower) < abs(p.upper - evidence.p[k]) else "upper"
    return f"the data pull it to its {side} bound {getattr(p, side):g} {p.unit}"


def _instead(name: str, *directions: NullDirection, cause: str = "by any recording") -> str:
    """What is determined in the place of a parameter that is not, or what it may change together with."""
    wide = next((d for d in directions if d.is_wide), None)
    if wide is not None:
        first, second, *more = (n for n in wide.parameters if n != name)
        return f"{cause}; it may change together with {first}, {second} and {len(more)} more"
    every = [text for d in directions for text in d.determined]
    told = [text for text in every if mentions(text, (name,))] or every
    if told:
        return f"{cause}; only {_listed(dict.fromkeys(told))} determined"
    alone = all(len(d.parameters) == 1 for d in directions)
    return cause if alone else f"{cause}, nor a combination of it"


def _listed(expressions: Iterable[str]) -> str:
    *first, last = expressions
    return f"{', '.join(first)} and {last} are" if first else f"{last} is"


SAMPLES = 20_000
"""Samples of a log that stand for a further recording; the information of more is proportional to them."""
SHARED = 1e-6
"""Sine of the angle within which two structural null directions are one."""


@dataclass(frozen=True)
class FurtherReport:
    """What a log and one further recording determine together: `rank` of `of` directions.

    `determined`: standard uncertainties, in SI, of the parameters that the same motion once more leaves open.
    """

    recording: str
    rank: int
    of: int
    determined: Mapping[str, float]


def further_reports(evidence: Evidence, log: Log) -> tuple[FurtherReport, ...]:
    """Return one report for each further recording that the family of the model offers."""
    model = evidence.model
    offered = [(f, read) for f in model.family.further if (read := f.read(model)) is not None]
    if not offered:
        return ()
    columns, factor = _columns(evidence, log)
    _, again = _together(evidence, model, columns, factor)
    return tuple(
        _report(evidence, f.text, again, *_together(evidence, read, columns | dict(f.moved(columns)), factor))
        for f, read in offered
    )


LEFT = 1e-3
"""Part of a determined parameter that may lie along undetermined directions: they move it by less than a
thousandth of its bounds."""


def _report(evidence: Evidence, text: str, again: np.ndarray, rank: int, known: np.ndarray) -> FurtherReport:
    parameters = evidence.model.parameters
    new = {p.name: float(known[k]) for k, p in enumerate(parameters) if np.isnan(again[k]) and known[k] > 0}
    return FurtherReport(text, rank, sum(p.width > 0 for p in parameters), new)


def _together(
    evidence: Evidence, model: Model, columns: Mapping[str, np.ndarray], factor: float
) -> tuple[int, np.ndarray]:
    """Return what the log and a recording of these columns, as `model` reads them, determine together.

    That is the rank and standard uncertainties (n,), nan where there is none. `factor`: times as much as
    these samples are recorded.
    """
    n, first = len(evidence.p), evidence.cost
    p = np.concatenate([evidence.p, model.nominal[n:]])
    second = _cost(evidence, model, p, columns)
    scale = scales(evidence.model)
    added = _eliminated(second.information(p, 2.0), n)
    information = (first.information(evidence.p, 2.0) + factor * added) * np.outer(scale, scale)
    always, rest = structural_directions(first, evidence.p)
    theirs = structural_directions(second, p)[0][:n]
    basis = np.hstack([rest, always @ _apart(always, theirs)])
    values, vectors = np.linalg.eigh(basis.T @ information @ basis)
    good = values >= least_information(values)
    vectors = basis @ vectors
    found = vectors[:, good] @ (vectors[:, good] / values[good]).T
    left = 1 - np.sum(vectors[:, good] ** 2, axis=1)  # of a parameter, along what is not determined
    std = np.where(left < LEFT**2, scale * np.sqrt(np.diag(found)), np.nan)
    return int(good.sum()), std


def _apart(always: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return the directions (k, m) among the columns of `always` (n, k) that are not in those of `theirs`."""
    if always.shape[1] == 0 or theirs.shape[1] == 0:
        return np.eye(always.shape[1])
    u, cosines, _ = np.linalg.svd(always.T @ scipy.linalg.orth(theirs))
    shared = int(np.sum(cosines > np.sqrt(1 - SHARED**2)))
    return np.asarray(u[:, shared:])


def _eliminated(information: np.ndarray, n: int) -> np.ndarray:
    """Return the information about the first n parameters, the others unknown."""
    own = information[n:, n:]
    if own.size == 0:
        return information
    cross = information[n:, :n]
    return np.asarray(information[:n, :n] - cross.T @ np.linalg.pinv(own, hermitian=True) @ cross)


def _columns(evidence: Evidence, log: Log) -> tuple[dict[str, np.ndarray], float]:
    """Return the first samples of each run that was fitted, and how many times as many there are."""
    names = ("run", "t_s", *logged_columns(evidence.model))
    kept: dict[str, list[np.ndarray]] = {c: [] for c in names}
    counts = dict(zip(evidence.cost.summary.runs, evidence.cost.summary.counts.tolist(), strict=True))
    most = max(1, SAMPLES // len(counts))
    taken = dict.fromkeys(counts, 0)
    for block in log.blocks(names[1:]):
        room = most - taken.get(block.run, most)
        if room <= 0:
            continue
        rows = {c: np.asarray(v)[:room] for c, v in block.data.items()}
        taken[block.run] += len(rows["t_s"])
        kept["run"].append(np.full(len(rows["t_s"]), block.run))
        for c in names[1:]:
            kept[c].append(rows[c])
    columns = {c: np.concatenate(parts) for c, parts in kept.items()}
    return columns, sum(counts.values()) / len(columns["run"])


def _cost(evidence: Evidence, model: Model, p: np.ndarray, columns: Mapping[str, np.ndarray]) -> Cost:
    """Return the likelihood of a recording of these poses, its readings those of `model` at p."""
    cost = evidence.cost
    names = (*evidence.model.channels, *evidence.model.references, *evidence.model.state)
    sigma = np.sqrt([*cost.reading_variance, *cost.column_variance])
    noise = dict(zip(names, sigma.tolist(), strict=True))
    poses = Log.from_arrays(columns)
    at = visited(poses, model, poses.rows, noise, model.named(p))
    own = dict(zip(cost.summary.runs, cost.at(evidence.p).zeros, strict=True))
    zeros = np.array([own[int(run)] for run in at.runs]).T
    (read,) = on_arrays(model.reading)(p, zeros, at.pose, at.state)
    log = Log.from_arrays({**columns, **dict(zip(model.channels, read, strict=True))})
    return replace(cost_near(log, model, p, noise), planned=cost.planned)


FORMAT = "hallsym sensitivity 1"


@dataclass(frozen=True, eq=False)
class ParameterReport:
    """What the data say of one parameter.

    `share`: width of the 95 % interval over that of the bounds, None without finite bounds.
    `sigma`: what one standard uncertainty of it does to the decoded pose; `percent`: what 1 % of its value
    does. Both over the recorded workspace, everything else held.
    """

    name: str
    value: float
    unit: str
    std: float | None
    degrees_of_freedom: float
    interval: Interval | None
    share: float | None
    correlated_with: tuple[tuple[str, float], ...]
    sigma: Change | None
    percent: Change
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class CombinationReport:
    """A combination that is determined although its parameters are not; the same fields."""

    expression: str
    value: float
    unit: str
    std: float
    interval: Interval


@dataclass(frozen=True)
class Output:
    """1 sigma of one decoded pose coordinate, by the noise of a reading and by that of all parameters."""

    noise_floor: float
    parameters_rms: float
    parameters_worst: float


@dataclass(frozen=True, eq=False)
class Offsets:
    """The offsets that each run has of its own, its zero deviations; `values`, `std`: (runs, offsets)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    runs: tuple[int, ...]
    values: np.ndarray
    std: np.ndarray

    def sizes(self) -> dict[str, dict[str, Any]]:
        """Return unit, rms, worst and standard uncertainty of each, over the runs."""
        columns = zip(self.names, self.units, self.values.T, self.std.T, strict=True)
        return {
            name: {
                "unit": unit,
                "rms": float(np.sqrt(np.mean(v**2))),
                "worst": float(np.abs(v).max()),
                "std": float(np.sqrt(np.mean(s**2))),
            }
            for name, unit, v, s in columns
        }

    def to_dict(self) -> dict[str, Any]:
        """Return how many there are, their sizes and each of them."""
        if not self.names:
            return {"count": 0, "zeros": {}}
        runs = zip(self.runs, self.values.tolist(), self.std.tolist(), strict=True)
        return {
            "count": self.values.size,
            "zeros": self.sizes(),
            "runs": {
                str(run): {n: {"value": v, "std": s} for n, v, s in zip(self.names, row, own, strict=True)}
                for run, row, own in runs
            },
        }


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Shown):
    """What `identify` returns.

    `correlation`: (n, n) of the estimates, nan where a parameter is not estimated. `outputs`: by pose
    coordinate. `further`: what other recordings would determine beside this one. `partial`: what could not be
    computed, and why.
    """

    evidence: Evidence
    parameters: tuple[ParameterReport, ...]
    combinations: tuple[CombinationReport, ...]
    structural: NullSpace
    practical: NullSpace
    correlation: np.ndarray
    outputs: Mapping[str, Output]
    offsets: Offsets
    intervals: Intervals
    further: tuple[FurtherReport, ...]
    partial: tuple[str, ...]
    seconds: float

    @property
    def model(self) -> Model:
        """The model whose parameters these are."""
        return self.evidence.model

    def __getitem__(self, name: str) -> ParameterReport:
        """Return the report of one parameter."""
        for entry in self.parameters:
            if entry.name == name:
                return entry
        raise InputError(f"Model {self.model.name} has no parameter {name!r}.")

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym sensitivity --json` prints."""
        return {
            "format": FORMAT,
            "model": self.model.name,
            "recorded": self.evidence.recorded,
            "planned": self.evidence.cost.planned,
            "parameters": {entry.name: _entry(entry) for entry in self.parameters},
            "combinations": [
                {
                    "expression": c.expression,
                    "value": c.value,
                    "unit": c.unit,
                    "std": c.std,
                    "interval": c.interval.to_dict(),
                }
                for c in self.combinations
            ],
            "structural": _space(self.structural),
            "practical": _space(self.practical),
            "further": [vars(report) for report in self.further],
            "outputs": {c: vars(entry) for c, entry in self.outputs.items()},
            "nuisance": self.offsets.to_dict(),
            "uncertainty": {"method": self.intervals.method, "reason": self.intervals.reason},
            "profiles": [profile_record(p) for p in self.intervals.profiles],
            "notes": list(self.evidence.notes),
            "partial": list(self.partial),
            "seconds": self.seconds,
        }


def identify(
    known: Fit | Model,
    on: Any = None,
    *,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    profiles: str = "auto",
    name: str = "the plan",
    on_progress: Callable[[str], None] | None = None,
) -> Identifiability:
    """Return what the data determine of each parameter.

    `known`: a fit, with `on` its log (not needed for a fit just made), another log (as `fit` takes it) or a
    campaign that is not recorded yet; or a model with a campaign. For a campaign: `values` are the machine's
    (default: the fit's, or nominal), `noise` the standard deviation by column (default: the fit's, the
    campaign's, or Table 8's), `name` what to call it.
    `profiles`: "auto" where the normal interval is not good enough, "all", or "none".

    Raises `InputError` when model and log do not belong together or no covariance can be formed.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    if on is not None and not isinstance(on, Campaign):
        on = as_log(on, known.columns, known.read_with) if isinstance(known, Fit) else as_log(on)
    evidence = _evidence(known, on, values, noise, name)
    intervals = intervals_of(evidence, profiles=profiles, say=say)
    say("looking for null directions")
    stated = [replace(c, std=intervals.std[c.expression]) for c in evidence.uncertainty.combinations]
    always = structural(evidence.cost, evidence.found, stated)
    here = practical(evidence.cost, evidence.found, stated)
    correlation = _correlation(evidence.uncertainty.covariance, evidence.uncertainty.determined)
    words = verdicts(evidence, always, here, correlation)
    slopes = slopes_over(evidence.workspace, evidence.cost, evidence.p)
    parameters = tuple(
        _parameter(evidence, k, words[k], correlation[k], intervals, slopes) for k in range(len(evidence.p))
    )
    combinations = tuple(
        CombinationReport(c.expression, c.value, c.unit, c.std, intervals.of[c.expression]) for c in stated
    )
    return Identifiability(
        evidence=evidence,
        parameters=parameters,
        combinations=combinations,
        structural=always,
        practical=here,
        correlation=correlation,
        outputs=_outputs(evidence, slopes),
        offsets=_offsets(evidence),
        intervals=intervals,
        further=further_reports(evidence, evidence.log),
        partial=intervals.failures,
        seconds=perf_counter() - began,
    )


def _evidence(
    known: Fit | Model,
    on: Log | Campaign | None,
    values: Mapping[str, float] | None,
    noise: Mapping[str, float] | None,
    name: str,
) -> Evidence:
    if isinstance(known, Fit) and not isinstance(on, Campaign):
        return from_fit(known, on)
    if not isinstance(on, Campaign):
        raise InputError("A model by itself determines nothing: give a campaign, or fit a log first.")
    if isinstance(known, Fit):
        model = known.model
        values = values or model.named(known.values)
        noise = noise or known.noise.std
    else:
        model, values = known, values or {}
        noise = noise or dict(on.noise or table8_noise(model, values).sigma)
    return from_plan(model, values, on, noise, name)


def _correlation(covariance: np.ndarray, determined: np.ndarray) -> np.ndarray:
    std = np.sqrt(np.where(determined, np.diag(covariance), np.nan))
    return covariance / np.outer(std, std)


def _parameter(
    evidence: Evidence,
    k: int,
    verdict: Verdict,
    correlation: np.ndarray,
    intervals: Intervals,
    slopes: Slopes,
) -> ParameterReport:
    parameter, step = evidence.model.parameters[k], np.zeros(len(evidence.p))
    std, interval = intervals.std.get(parameter.name), intervals.of.get(parameter.name)
    share = None
    if interval is not None and np.isfinite(parameter.width):
        share = float((interval.high - interval.low) / parameter.width)
    step[k] = 1.0
    return ParameterReport(
        name=parameter.name,
        value=float(evidence.p[k]),
        unit=parameter.unit,
        std=std,
        degrees_of_freedom=intervals.dof.get(parameter.name, np.inf),
        interval=interval,
        share=share,
        correlated_with=tuple(strongest(correlation, evidence.model.names, k)),
        sigma=None if std is None else slopes.change(step * std),
        percent=slopes.change(step * 0.01 * abs(evidence.p[k])),
        verdict=verdict,
    )


def _outputs(evidence: Evidence, slopes: Slopes) -> dict[str, Output]:
    spread = slopes.spread(evidence.uncertainty.covariance)
    floor = noise_floor(evidence.cost.at(evidence.p))
    return {c: Output(float(floor[c]), spread.rms[c], spread.worst[c]) for c in evidence.model.pose}


def _offsets(evidence: Evidence) -> Offsets:
    cost, model, p = evidence.cost, evidence.model, evidence.p
    names, units = tuple(z.name for z in model.zeros), tuple(z.unit for z in model.zeros)
    if not names:
        return Offsets((), (), cost.summary.runs, np.zeros((0, 0)), np.zeros((0, 0)))
    gain = model.zero_scale(p, cost.summary.first_state)
    point = cost.at(p)
    variance = np.diagonal(point.zero_covariance(evidence.uncertainty.covariance), axis1=1, axis2=2)
    std = np.sqrt(np.maximum(variance, 0.0)) * np.abs(gain)
    return Offsets(names, units, cost.summary.runs, point.zeros * gain, std)  # (31): delta = d phi(0)


def _entry(entry: ParameterReport) -> dict[str, Any]:
    sigma = entry.sigma.to_dict() if entry.sigma else None
    percent = entry.percent.to_dict()
    return {
        "value": entry.value,
        "unit": entry.unit,
        "std": entry.std,
        "degrees_of_freedom": entry.degrees_of_freedom if np.isfinite(entry.degrees_of_freedom) else None,
        "interval": None if entry.interval is None else entry.interval.to_dict(),
        "share_of_bounds": entry.share,
        "verdict": entry.verdict.word,
        "because": entry.verdict.because,
        "correlated_with": [{"parameter": n, "correlation": r} for n, r in entry.correlated_with],
        "effect": {c: {"one_sigma": sigma[c] if sigma else None, "one_percent": percent[c]} for c in percent},
    }


def _space(space: NullSpace) -> dict[str, Any]:
    return {
        "rank": space.rank,
        "of": space.of,
        "null": [{"parameters": list(d.parameters), "determined": list(d.determined)} for d in space.null],
    }
