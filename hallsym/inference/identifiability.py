"""`identify`: what the data determine, parameter by parameter, and what they do not."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import Fit, noise_floor
from hallsym.inference.evidence import Evidence, from_fit, from_plan
from hallsym.inference.further import FurtherReport, further_reports
from hallsym.inference.intervals import Interval, Intervals, intervals_of, profile_record
from hallsym.inference.null_directions import NullSpace, practical, structural
from hallsym.inference.verdict import Verdict, strongest, verdicts
from hallsym.inference.workspace import Change, Slopes, slopes_over
from hallsym.log import Log, as_log
from hallsym.model import Model
from hallsym.shown import Shown
from hallsym.simulation import Campaign, table8_noise

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

    `correlation`: (n, n) of the estimates, nan where a parameter is not estimated. `spectrum`: singular
    values of the scaled Jacobian, largest first: 1 means known to one bound width. `outputs`: by pose
    coordinate. `further`: what other recordings would determine beside this one. `partial`: what could not be
    computed, and why.
    """

    evidence: Evidence
    parameters: tuple[ParameterReport, ...]
    combinations: tuple[CombinationReport, ...]
    structural: NullSpace
    practical: NullSpace
    correlation: np.ndarray
    spectrum: np.ndarray
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
            "further": [report.to_dict() for report in self.further],
            "outputs": {c: vars(entry) for c, entry in self.outputs.items()},
            "nuisance": self.offsets.to_dict(),
            "uncertainty": {"method": self.intervals.method, "reason": self.intervals.reason},
            "profiles": [profile_record(p) for p in self.intervals.profiles],
            "spectrum": self.spectrum.tolist(),
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
    bootstrap: int | None = None,
    seed: int = 0,
    name: str = "the plan",
    on_progress: Callable[[str], None] | None = None,
) -> Identifiability:
    """Return what the data determine of each parameter.

    `known`: a fit, with `on` its log (not needed for a fit just made), another log (as `fit` takes it) or a
    campaign that is not recorded yet; or a model with a campaign. For a campaign: `values` are the machine's
    (default: the fit's, or nominal), `noise` the standard deviation by column (default: the fit's, the
    campaign's, or Table 8's), `name` what to call it.
    `profiles`: "auto" where the normal interval is not good enough, "all", or "none".
    `bootstrap`: resample runs so many times; None when white noise does not explain the scatter, 0 never.

    Raises `InputError` when model and log do not belong together or no covariance can be formed.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    if on is not None and not isinstance(on, Campaign):
        on = as_log(on, known.columns, known.read_with) if isinstance(known, Fit) else as_log(on)
    evidence = _evidence(known, on, values, noise, name)
    intervals = intervals_of(evidence, profiles=profiles, bootstrap=bootstrap, seed=seed, say=say)
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
        spectrum=_spectrum(evidence),
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


def _spectrum(evidence: Evidence) -> np.ndarray:
    """Singular values of the Jacobian with parameters in bound widths and readings in standard deviations."""
    scale = evidence.found.scale
    open_ = np.array([p.width > 0 for p in evidence.model.parameters])
    information = evidence.information * np.outer(scale, scale)
    values = np.linalg.eigvalsh(information[np.ix_(open_, open_)])[::-1]
    return np.sqrt(np.maximum(values, 0.0))


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
        "null": [{**vars(d), "parameters": list(d.parameters), "also": list(d.also)} for d in space.null],
    }
