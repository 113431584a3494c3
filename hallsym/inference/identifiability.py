"""`identify`: identifiability of each parameter, and null directions."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import scipy

from hallsym.errors import InputError, listed
from hallsym.estimation import Fit
from hallsym.estimation.calibration import CombinationEstimate, coverage_factor
from hallsym.estimation.decoding import logged_columns
from hallsym.estimation.factors import eliminate
from hallsym.estimation.goodness_of_fit import noise_floor
from hallsym.estimation.identifiable import (
    MOVING,
    echelon,
    gauged,
    least_information,
    scales,
    structural_directions,
    structural_null,
)
from hallsym.estimation.likelihood import Cost, cost_near
from hallsym.inference.evidence import Evidence, from_fit, from_plan, visited
from hallsym.inference.intervals import Interval, Intervals, intervals_of
from hallsym.log import Log, as_log
from hallsym.model import Model
from hallsym.records import named, plain
from hallsym.shown import Shown
from hallsym.simulation import Campaign, table8_noise

FORMAT = "hallsym sensitivity 1"


# -- directions that are not determined --------------------------------------------------------------------

NAMED = 0.05
"""Parameters that move less than this part of the leading one along a null direction of a recording are not
named with it. A structural null direction names all that move: none of them is determined."""
WIDE = 4
"""Most parameters of one direction whose determined combinations are stated in a sentence."""


@dataclass(frozen=True)
class NullDirection:
    """One direction that is not determined: its parameters, and the combinations of them that are."""

    parameters: tuple[str, ...]
    determined: tuple[str, ...]

    @property
    def is_wide(self) -> bool:
        """Whether the parameters are too many for a sentence on their determined combinations."""
        return len(self.parameters) > WIDE and len(self.determined) > 1


@dataclass(frozen=True)
class NullSpace:
    """`rank` of `of` directions are determined; `null` names the others that belong here."""

    rank: int
    of: int
    null: tuple[NullDirection, ...]


def null_spaces(evidence: Evidence, stated: Sequence[CombinationEstimate]) -> tuple[NullSpace, NullSpace]:
    """Return the structural null directions, and the further ones of this recording.

    The parameters of the former are found at a random point within the bounds: at the optimum an angle near
    zero could hide one. `stated`: combinations that are determined.
    """
    cost, found = evidence.cost, evidence.found
    open_ = np.array([p.width > 0 for p in evidence.model.parameters])
    anywhere = structural_null(cost, None, open_)
    anywhere, gauge = gauged(evidence.model, anywhere)
    spaces = []
    for null, lost, least in (
        (anywhere, found.n_structural, MOVING),
        (found.null[:, found.n_structural :], found.null.shape[1], NAMED),
    ):
        directions = _directions(null, evidence.model.names, stated, least)
        spaces.append(NullSpace(int(open_.sum()) - lost - len(gauge), int(open_.sum()), directions))
    return spaces[0], spaces[1]


def _directions(
    null: np.ndarray, names: tuple[str, ...], stated: Sequence[CombinationEstimate], least: float
) -> tuple[NullDirection, ...]:
    """Return sparse directions that span the columns of `null`, in the order of their first parameter.

    `least`: part of the leading parameter's motion above which another one is named.
    """
    out = []
    for row in echelon(null.T):
        involved = tuple(names[k] for k in np.flatnonzero(np.abs(row) > least * np.abs(row).max()).tolist())
        telling = tuple(c.expression for c in stated if mentions(c.expression, involved))
        out.append(NullDirection(involved, telling))
    return tuple(sorted(out, key=lambda d: names.index(d.parameters[0])))


def mentions(expression: str, parameters: Sequence[str]) -> bool:
    """Return whether an expression holds one of some parameters."""
    return bool(set(re.findall(r"[A-Za-z_]\w*", expression)) & set(parameters))


# -- verdicts ----------------------------------------------------------------------------------------------

VERDICTS = ("determined", "weak", "at bound", "not determined", "no effect", "fixed")
WEAK = 1 / 3
"""A 95 % interval wider than this part of the bounds makes a parameter weak."""
WEAK_ALONE = 0.25
"""The same for a parameter without finite bounds: standard uncertainty over value."""
TRADED = 0.7
"""Correlation from which a parameter counts as traded off against another."""


@dataclass(frozen=True)
class Verdict:
    """`word` is one of `VERDICTS`; `because`: the reason in a few words, if any."""

    word: str
    because: str = ""


def verdict_on(
    evidence: Evidence,
    k: int,
    structural: NullSpace,
    practical: NullSpace,
    correlated: Sequence[tuple[str, float]],
) -> Verdict:
    """Return the verdict on parameter k; `correlated`: names and correlations of the strongest others."""
    parameter, estimated, value = evidence.model.parameters[k], evidence.uncertainty, evidence.p[k]
    if parameter.width == 0:
        return Verdict("fixed")
    if parameter.name in estimated.at_bound:
        side = "lower" if abs(value - parameter.lower) < abs(parameter.upper - value) else "upper"
        bound = f"its {side} bound {getattr(parameter, side):g} {parameter.unit}"
        return Verdict("at bound", f"the data pull it to {bound}")
    shared = [d for d in structural.null if parameter.name in d.parameters]
    if shared and not estimated.determined[k]:
        word = "not determined" if len(shared[0].parameters) > 1 else "no effect"
        return Verdict(word, _instead(parameter.name, *shared))
    if evidence.information[k, k] * evidence.found.scale[k] ** 2 < 1.0:
        return Verdict("no effect", "its whole range leaves no trace in these readings")
    if not estimated.determined[k]:
        lost = [d for d in practical.null if parameter.name in d.parameters]
        cause = "from this recording" if practical.null else "from any recording"
        return Verdict("not determined", _instead(parameter.name, *lost, cause=cause))
    half = float(coverage_factor(estimated.degrees_of_freedom[k])) * estimated.std[k]
    share = 2 * half / parameter.width if np.isfinite(parameter.width) else 0.0
    alone = estimated.std[k] / abs(value) if not share and value else 0.0
    if share > WEAK or alone > WEAK_ALONE:
        traded = [f"{n} (r = {r:+.2f})" for n, r in correlated if abs(r) > TRADED]
        spans = f"its interval spans {100 * share:.0f} % of its bounds"
        return Verdict("weak", f"traded off against {', '.join(traded)}" if traded else spans)
    return Verdict("determined")


def strongest(correlation: np.ndarray, names: Sequence[str], k: int) -> tuple[tuple[str, float], ...]:
    """Return the three parameters whose estimates are most correlated with parameter k, largest first.

    `correlation`: (n,) with parameter k, nan where there is none.
    """
    size = np.abs(np.where(np.isfinite(correlation), correlation, 0.0))
    size[k] = 0.0
    order = [int(j) for j in np.argsort(-size, kind="stable") if size[j] > 0][:3]
    return tuple((names[j], float(correlation[j])) for j in order)


def _instead(name: str, *directions: NullDirection, cause: str = "from any recording") -> str:
    """Return the determined combinations of a parameter that is not determined, or its null direction."""
    wide = next((d for d in directions if d.is_wide), None)
    if wide is not None:
        first, second, *more = (n for n in wide.parameters if n != name)
        return f"{cause}; it may change together with {first}, {second} and {len(more)} more"
    every = [text for d in directions for text in d.determined]
    estimated = [text for text in every if mentions(text, (name,))] or every
    if estimated:
        only = list(dict.fromkeys(estimated))
        return f"{cause}; only {listed(only)} {'are' if len(only) > 1 else 'is'} determined"
    alone = all(len(d.parameters) == 1 for d in directions)
    return cause if alone else f"{cause}, nor a combination of it"


# -- what a further recording would determine --------------------------------------------------------------

SAMPLES = 20_000
"""Samples of a log that stand for a further recording; the information of more is proportional to them."""
SHARED = 1e-6
"""Sine of the angle within which two structural null directions are one."""
LEFT = 1e-3
"""Largest part of a determined parameter along undetermined directions, which move it by less than a
thousandth of its bounds."""


@dataclass(frozen=True)
class FurtherReport:
    """Identifiability with one further recording: `rank` of `of` directions.

    `determined`: standard uncertainties, in SI, of parameters that a repetition of the log does not
    determine.
    """

    recording: str
    rank: int
    of: int
    determined: Mapping[str, float]


def further_reports(evidence: Evidence) -> tuple[FurtherReport, ...]:
    """Return one report for each further recording that the family of the model offers."""
    model = evidence.model
    offered = [(f, read) for f in model.family.further if (read := f.read(model)) is not None]
    if not offered:
        return ()
    columns, factor = _columns(evidence)
    _, again = _together(evidence, model, columns, factor)
    of, out = sum(p.width > 0 for p in model.parameters), []
    for further, read in offered:
        rank, std = _together(evidence, read, columns | dict(further.moved(columns)), factor)
        new = np.isnan(again) & (std > 0)
        determined = {p.name: float(std[k]) for k, p in enumerate(model.parameters) if new[k]}
        out.append(FurtherReport(further.text, rank, of, determined))
    return tuple(out)


def _together(
    evidence: Evidence, model: Model, columns: Mapping[str, np.ndarray], factor: float
) -> tuple[int, np.ndarray]:
    """Return rank and standard uncertainties (n,) of the log with a recording of these columns by `model`.

    nan where there is none. `factor`: length of the recording over that of these samples.
    """
    n, scale = len(evidence.p), scales(evidence.model)
    p = np.concatenate([evidence.p, model.nominal[n:]])
    second = _cost(evidence, model, p, columns)
    own = len(p) - n  # parameters of the further recording alone: unknown too
    added, _ = eliminate(np.roll(second.information(p, 2.0), own, axis=(0, 1)), own)
    information = (evidence.point.total_information(2.0) + factor * added) * np.outer(scale, scale)
    always, rest, _ = structural_directions(evidence.cost, evidence.p)
    theirs = structural_directions(second, p)[0][:n]
    basis = np.hstack([rest, always @ _beyond(always, theirs)])
    values, vectors = np.linalg.eigh(basis.T @ information @ basis)
    good = values >= least_information(values)
    vectors = (basis @ vectors)[:, good]
    left = 1 - np.sum(vectors**2, axis=1)  # of a parameter, along what is not determined
    variance = np.sum(vectors**2 / values[good], axis=1)
    return int(good.sum()), np.where(left < LEFT**2, scale * np.sqrt(variance), np.nan)


def _beyond(always: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return the directions (k, m) among the columns of `always` (n, k) that are not in those of `theirs`."""
    if always.shape[1] == 0 or theirs.shape[1] == 0:
        return np.eye(always.shape[1])
    u, cosines, _ = np.linalg.svd(always.T @ scipy.linalg.orth(theirs))
    return np.asarray(u[:, int(np.sum(cosines > np.sqrt(1 - SHARED**2))) :])


def _columns(evidence: Evidence) -> tuple[dict[str, np.ndarray], float]:
    """Return the first samples of each run that was fitted, and how many times as many there are."""
    summary = evidence.cost.summary
    taken = dict.fromkeys(summary.runs, 0)
    most, parts = max(1, SAMPLES // len(taken)), []
    for block in evidence.log.blocks(("t_s", *logged_columns(evidence.model))):
        room = most - taken.get(block.run, most)
        if room > 0:
            rows = {c: np.asarray(v)[:room] for c, v in block.data.items()}
            taken[block.run] += len(rows["t_s"])
            parts.append({"run": np.full(len(rows["t_s"]), block.run), **rows})
    columns = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    return columns, float(summary.counts.sum()) / len(columns["run"])


def _cost(evidence: Evidence, model: Model, p: np.ndarray, columns: Mapping[str, np.ndarray]) -> Cost:
    """Return the likelihood of a recording of these poses, its readings those of `model` at p."""
    cost, known = evidence.cost, evidence.model
    sigma = np.sqrt([*cost.reading_variance, *cost.column_variance])
    noise = named((*known.channels, *known.references, *known.state), sigma)
    poses, offsets = (
        Log.from_arrays(columns),
        dict(zip(cost.summary.runs, evidence.point.offsets, strict=True)),
    )
    own, pose, state = visited(poses, model, offsets, poses.rows, noise, model.named(p))
    read = model.readings(p, pose, state, own)
    log = Log.from_arrays({**columns, **dict(zip(model.channels, read, strict=True))})
    return replace(cost_near(log, model, p, noise), planned=cost.planned)


# -- the report --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """Change of the decoded pose over a workspace, by pose column, SI."""

    rms: Mapping[str, float]
    worst: Mapping[str, float]

    @staticmethod
    def of(pose: Sequence[str], moved: np.ndarray) -> "Change":
        """Return the size of what `moved` (s, n_pose) holds."""
        return Change(named(pose, np.sqrt(np.mean(moved**2, axis=0))), named(pose, np.abs(moved).max(axis=0)))


@dataclass(frozen=True, eq=False)
class ParameterReport:
    """Identifiability of one parameter.

    `share`: width of the 95 % interval over that of the bounds, None without finite bounds. `sigma`: change
    of the decoded pose by one standard uncertainty of it; `percent`: by 1 % of its value. Both over the
    recorded workspace, everything else fixed.
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

    def to_dict(self) -> dict[str, Any]:
        """Return the record of this parameter, SI."""
        sigma, percent = plain(self.sigma), plain(self.percent)
        effect = {
            c: {
                "one_sigma": sigma and {size: sigma[size][c] for size in sigma},
                "one_percent": {size: percent[size][c] for size in percent},
            }
            for c in self.percent.rms
        }
        return {
            "value": self.value,
            "unit": self.unit,
            "std": self.std,
            "degrees_of_freedom": plain(self.degrees_of_freedom),
            "interval": plain(self.interval),
            "share_of_bounds": self.share,
            "verdict": self.verdict.word,
            "because": self.verdict.because,
            "correlated_with": [{"parameter": n, "correlation": r} for n, r in self.correlated_with],
            "effect": effect,
        }


@dataclass(frozen=True)
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
    """Per-run offsets, the zero deviations; `values`, `std`: (runs, offsets)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    runs: tuple[int, ...]
    values: np.ndarray
    std: np.ndarray

    def sizes(self) -> dict[str, dict[str, Any]]:
        """Return unit, rms, worst and standard uncertainty of each, over the runs."""
        rms, std = (np.sqrt(np.mean(v**2, axis=0)).tolist() for v in (self.values, self.std))
        worst = np.abs(self.values).max(axis=0).tolist()
        keys = ("unit", "rms", "worst", "std")
        sizes = zip(self.units, rms, worst, std, strict=True)
        return {n: dict(zip(keys, own, strict=True)) for n, own in zip(self.names, sizes, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """Return how many there are, their sizes and each of them."""
        if not self.names:
            return {"count": 0, "offsets": {}}
        runs = {
            str(run): {n: {"value": v, "std": s} for n, v, s in zip(self.names, values, std, strict=True)}
            for run, values, std in zip(self.runs, self.values.tolist(), self.std.tolist(), strict=True)
        }
        return {"count": self.values.size, "offsets": self.sizes(), "runs": runs}


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
        estimated = self.evidence.uncertainty
        return {
            "format": FORMAT,
            "model": self.model.name,
            "recorded": self.evidence.recorded,
            "planned": self.evidence.cost.planned,
            "parameters": {entry.name: entry.to_dict() for entry in self.parameters},
            "combinations": plain(self.combinations),
            "structural": plain(self.structural),
            "gauges": [gauge.text for gauge, _ in self.evidence.found.gauges_of(self.model)],
            "practical": plain(self.practical),
            "further": plain(self.further),
            "outputs": plain(self.outputs),
            "nuisance": self.offsets.to_dict(),
            "uncertainty": {"method": estimated.method, "reason": estimated.reason},
            "profiles": [p.to_dict() for p in self.intervals.profiles],
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
    """Return the identifiability of each parameter.

    `known`: a fit, with `on` its log (not needed for a fit just made), another log (as `fit` takes it) or a
    campaign that is not recorded yet; or a model with a campaign. For a campaign: `values` are the machine's
    (default: the fit's, or nominal), `noise` the standard deviation by column (default: the fit's, the
    campaign's, or Table 8's), `name` what to call it.
    `profiles`: "auto" where the normal interval is not good enough, "all", or "none".

    Raises `InputError` when model and log do not belong together or no covariance can be formed.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    evidence = _evidence(known, on, values, noise, name)
    intervals = intervals_of(evidence, profiles=profiles, say=say)
    say("looking for null directions")
    estimated, names = evidence.uncertainty, evidence.model.names
    spaces = null_spaces(evidence, estimated.combinations)
    std = np.sqrt(np.where(estimated.determined, np.diag(estimated.covariance), np.nan))
    correlation = estimated.covariance / np.outer(std, std)
    parameters = []
    for k, row in enumerate(correlation):
        correlated = strongest(row, names, k)
        verdict = verdict_on(evidence, k, *spaces, correlated)
        parameters.append(_parameter(evidence, k, intervals, correlated, verdict))
    return Identifiability(
        evidence=evidence,
        parameters=tuple(parameters),
        combinations=tuple(
            CombinationReport(c.expression, c.value, c.unit, c.std, intervals.of[c.expression])
            for c in estimated.combinations
        ),
        structural=spaces[0],
        practical=spaces[1],
        correlation=correlation,
        outputs=_outputs(evidence),
        offsets=_offsets(evidence),
        intervals=intervals,
        further=further_reports(evidence),
        partial=intervals.failures,
        seconds=perf_counter() - began,
    )


def _evidence(
    known: Fit | Model,
    on: Any,
    values: Mapping[str, float] | None,
    noise: Mapping[str, float] | None,
    name: str,
) -> Evidence:
    if isinstance(on, Campaign):
        if isinstance(known, Fit):
            values, noise = values or known.model.named(known.values), noise or known.noise.std
        model, values = known.model if isinstance(known, Fit) else known, values or {}
        return from_plan(model, values, on, noise or on.noise or table8_noise(model, values).sigma, name)
    if isinstance(known, Fit):
        return from_fit(known, None if on is None else as_log(on, known.columns, known.read_with))
    raise InputError("A model by itself determines nothing: give a campaign, or fit a log first.")


def _parameter(
    evidence: Evidence,
    k: int,
    intervals: Intervals,
    correlated: tuple[tuple[str, float], ...],
    verdict: Verdict,
) -> ParameterReport:
    parameter, value = evidence.model.parameters[k], float(evidence.p[k])
    estimated, interval = evidence.uncertainty, intervals.of.get(parameter.name)
    std = float(estimated.std[k]) if estimated.determined[k] else None
    share = None
    if interval is not None and np.isfinite(parameter.width):
        share = float((interval.high - interval.low) / parameter.width)
    pose, slope = evidence.model.pose, evidence.slopes[:, :, k]
    return ParameterReport(
        name=parameter.name,
        value=value,
        unit=parameter.unit,
        std=std,
        degrees_of_freedom=float(estimated.degrees_of_freedom[k]),
        interval=interval,
        share=share,
        correlated_with=correlated,
        sigma=None if std is None else Change.of(pose, slope * std),
        percent=Change.of(pose, slope * 0.01 * abs(value)),
        verdict=verdict,
    )


def _outputs(evidence: Evidence) -> dict[str, Output]:
    """Return the uncertainty of each coordinate by noise and by the parameters, over the workspace."""
    slopes, pose = evidence.slopes, evidence.model.pose
    variance = np.einsum("spi,ij,spj->sp", slopes, evidence.uncertainty.covariance, slopes)
    left = Change.of(pose, np.sqrt(np.maximum(variance, 0.0)))
    floor = noise_floor(evidence.point)
    return {c: Output(float(floor[c]), left.rms[c], left.worst[c]) for c in pose}


def _offsets(evidence: Evidence) -> Offsets:
    point, summary, offsets = evidence.point, evidence.cost.summary, evidence.model.offsets
    names, units = tuple(z.name for z in offsets), tuple(z.unit for z in offsets)
    if not names:
        return Offsets((), (), summary.runs, np.zeros((0, 0)), np.zeros((0, 0)))
    gain = evidence.model.zero_scale(evidence.p, summary.first_state)
    variance = np.diagonal(point.zero_covariance(evidence.uncertainty.covariance), axis1=1, axis2=2)
    std = np.sqrt(np.maximum(variance, 0.0)) * np.abs(gain)
    return Offsets(names, units, summary.runs, point.offsets * gain, std)  # (31): delta = d phi(0)
