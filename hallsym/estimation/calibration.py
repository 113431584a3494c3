"""A calibration: values with uncertainties, identifiable combinations, errors; saved as readable JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from scipy.special import ndtri, stdtrit

from hallsym.errors import InputError, nearest, quoted
from hallsym.estimation.decoding import Errors, logged_columns
from hallsym.estimation.goodness_of_fit import GoodnessOfFit
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Cost
from hallsym.families import added_effects, build, known_effect
from hallsym.families.recording import Correction, Assignment, as_corrections, read_correction, assignment_of
from hallsym.files import read_json
from hallsym.log import Foreign, Log, Meta, Noise, Sigma
from hallsym.log.batches import Weigh
from hallsym.model import Family, Model
from hallsym.model.effect import read_text
from hallsym.records import plain, schema_of, structured
from hallsym.shown import Shown, decoding

FORMAT = "hallsym calibration 1"
INTERVAL = 0.95
"""Probability that an interval holds the true value."""
MANY = 200.0
"""Degrees of freedom from which on Student's interval is a normal one, to 1 %."""


# -- the file: the one statement of its format, validated and published as JSON Schema --------------------

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class _Record(msgspec.Struct, forbid_unknown_fields=True):
    """A record in which every key is known."""


class ParameterRecord(_Record):
    """One parameter in SI; `std` is null where the data do not determine it, a bound where there is none."""

    value: float
    unit: str
    std: NotNegative | None
    determined: bool
    held: bool
    at_bound: bool
    nominal: float
    lower: float | None
    upper: float | None
    degrees_of_freedom: Positive | None = None


class CombinationRecord(_Record):
    """A combination that the data determine; `factors` by parameter, of a linear one."""

    expression: str
    value: float
    std: float
    unit: str
    factors: dict[str, float] | None = None
    degrees_of_freedom: Positive | None = None


class CovarianceRecord(_Record):
    """Covariance of the parameters in the order `parameters`, in SI."""

    parameters: list[str]
    method: str
    reason: str
    matrix: list[list[float]]


@dataclass(frozen=True)
class LowerBound:
    """Cost of the unconstrained linear fit, at the weights that residuals have at the optimum.

    `ratio`: cost at the optimum over `cost`, 1 or more. `expected`: the ratio that follows from the number of
    `coefficients` alone, where the formulas of the model hold and no bound is in the way. `near`: whether the
    optimum costs no more, beyond the expected, than what is worth reporting.
    """

    cost: float
    ratio: float
    expected: float
    coefficients: Count
    near: bool


class SolverRecord(_Record):
    """How the optimum was found."""

    name: str
    loss: str
    cost: float
    cost_per_degree_of_freedom: float
    evaluations: Count
    starts: Count
    share_at_optimum: float
    seed: Count
    lower_bound: LowerBound | None = None


class LogRecord(_Record):
    """The log that was fitted; `span`: least and greatest value by column."""

    rows: Count = 0
    runs: Count = 0
    holdout: list[int] = []
    path: str | None = None
    sha256: str | None = None
    span: dict[str, tuple[float, float]] = {}


class OwnRecord(_Record):
    """A parameter that one log has of its own; `std` is null where the log does not determine it."""

    value: float
    std: NotNegative | None
    unit: str


class FittedLogRecord(_Record):
    """One of several logs that were fitted together; `runs`: from its own run to that of the calibration."""

    name: str
    held_out: bool
    log: LogRecord
    runs: dict[int, int]
    errors: dict[str, dict[str, dict[str, float | None]] | None]
    noise: dict[str, Sigma]
    parameters: dict[str, OwnRecord]
    residual_over_noise: float | None = None


@dataclass(frozen=True)
class Claim:
    """What is wrong with a recording, or with what a fit made of it, in a sentence.

    `name`: what `--accept` takes. `columns`, `runs`: where, all runs where empty. `correction`: what undoes
    it (`--correct`), None where nothing does. `explains`: the share of the excess over the floor that goes
    with it. `rivals`: other corrections that explain as much.
    """

    name: str
    text: str
    columns: tuple[str, ...] = ()
    runs: tuple[int, ...] = ()
    correction: str | None = None
    explains: float | None = None
    rivals: tuple[str, ...] = ()


class CalibrationRecord(_Record):
    """A calibration file; everything is in SI."""

    format: Literal["hallsym calibration 1"]
    model: str
    added: list[str]
    parameters: dict[str, ParameterRecord]
    combinations: list[CombinationRecord]
    errors: dict[str, dict[str, dict[str, float | None]] | None]
    noise: dict[str, Sigma]
    noise_floor: dict[str, float | None]
    status: str
    message: str
    seconds: float
    notes: list[str]
    undetermined_by_log: list[str]
    structural: list[str]
    solver: SolverRecord
    covariance: CovarianceRecord
    zero_bounds: dict[str, tuple[float | None, float | None]]
    zero_deviations: dict[int, dict[str, float]]
    layout: list[dict[str, Any]]
    log: LogRecord
    versions: dict[str, str]
    columns: dict[str, Foreign] = {}
    read_with: dict[str, str] = {}
    corrections: list[str] = []
    claims: tuple[Claim, ...] = ()
    wiring: list[tuple[str, int]] | None = None
    effects: list[str] = []
    own_effects: list[str] = []
    goodness_of_fit: GoodnessOfFit | None = None
    logs: list[FittedLogRecord] = []


# -- what a fit returns ------------------------------------------------------------------------------------


def coverage_factor(degrees_of_freedom: float | np.ndarray, level: float = INTERVAL) -> np.ndarray:
    """Return half of an interval over the standard uncertainty: Student's t, normal for infinite ones."""
    half = 0.5 + 0.5 * level
    dof = np.asarray(degrees_of_freedom, dtype=float)
    finite = np.isfinite(dof)
    return np.where(finite, stdtrit(np.where(finite, dof, 1.0), half), ndtri(half))


@dataclass(frozen=True)
class CombinationEstimate:
    """A combination that the data determine although its parameters are not: value and 1 sigma in `unit`.

    `degrees_of_freedom`: of `std`; infinite where the noise is as stated.
    """

    expression: str
    value: float
    std: float
    unit: str
    factors: Mapping[str, float] | None = None
    """Of a linear combination: factor by parameter."""
    degrees_of_freedom: float = np.inf

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval."""
        return float(coverage_factor(self.degrees_of_freedom)) * self.std

    def to_dict(self) -> dict[str, Any]:
        """Return the record; infinite degrees of freedom are None."""
        return {**vars(self), "degrees_of_freedom": _number(self.degrees_of_freedom)}


@dataclass(frozen=True)
class FittedParameter:
    """One parameter of a fit in SI; `std` and `interval` (95 %) are None where the data do not determine it.

    `factor`: half of the interval over `std`, by Student's t where the uncertainty itself was estimated.
    """

    value: float
    std: float | None
    interval: tuple[float, float] | None
    factor: float
    unit: str


@dataclass(frozen=True, eq=False)
class Joint:
    """Parameters of several logs: one that a log has of its own is named `gain[log]`.

    `values`, `std`: (n,) in SI, `covariance`: (n, n), in the order of `names`. `own`: what each of the `logs`
    has for itself.
    """

    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    covariance: np.ndarray
    own: tuple[str, ...]
    logs: tuple[str, ...]

    def change(self, name: str, since: str, to: str) -> tuple[float, float]:
        """Return how much a log's own parameter changed from log `since` to log `to`, and 1 sigma of that."""
        gradient = np.zeros(len(self.names))
        for log, sign in ((since, -1.0), (to, 1.0)):
            if (own := f"{name}[{log}]") not in self.names:
                raise InputError(f"No log {log!r} has a parameter {name} of its own; those are {self.names}.")
            gradient[self.names.index(own)] += sign
        return float(gradient @ self.values), float(np.sqrt(max(gradient @ self.covariance @ gradient, 0.0)))


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Shown):
    """What `fit` returns and `calib.json` holds.

    `values`, `std`, `determined`: (n,) in the order of `model.parameters`; `std` is nan where the data do
    not determine the parameter. `covariance`: (n, n), zero rows for fixed parameters. `degrees_of_freedom`:
    (n,) of `std`, for Student's t; infinite where the noise is as stated. `fixed` stayed at nominal,
    `at_bound` ended at a bound. `offsets`: run -> zero deviations delta [m] in reading space. `noise_floor`:
    RMSE that the stated noise alone would leave, by pose coordinate.
    """

    model: Model
    values: np.ndarray
    std: np.ndarray
    determined: np.ndarray
    covariance: np.ndarray
    covariance_method: str
    covariance_reason: str
    degrees_of_freedom: np.ndarray
    fixed: tuple[str, ...]
    structural: tuple[str, ...]
    at_bound: tuple[str, ...]
    combinations: tuple[CombinationEstimate, ...]
    offsets: Mapping[int, np.ndarray]
    noise: Noise
    noise_floor: Mapping[str, float]
    status: str
    message: str
    solver: Mapping[str, Any]
    """How the optimum was found: the entries of `SolverRecord`."""
    log: Mapping[str, Any]
    """The log that was fitted: the entries of `LogRecord`."""
    seconds: float
    goodness: GoodnessOfFit | None = None
    """None only for a calibration that an earlier version saved."""
    notes: tuple[str, ...] = ()
    errors: Errors | None = None
    keep: Weigh | None = None
    """Weights that took outliers out of the fit; not saved."""
    source: Log | None = None
    """The log itself; not saved, its hash is."""
    likelihood: Cost | None = None
    """The cost of the fitted runs: what profiles and refits need; not saved."""
    determination: Determination | None = None
    """What those runs determine; not saved."""
    undetermined_by_log: tuple[str, ...] = ()
    corrections: tuple[Correction, ...] = ()
    """Mistakes of the recording that were undone, the sign of a sensor mounted the other way round last."""
    reversed: bool = False
    """Whether that sign is all that was undone: a side to mount; not saved."""
    claims: tuple[Claim, ...] = ()
    """What is wrong with the recording, or with the result, and was not accepted."""
    columns: Mapping[str, Foreign] = field(default_factory=dict)
    """How the columns of the log were mapped, so that the next log of the machine is read alike."""
    read_with: Mapping[str, str] = field(default_factory=dict)
    """Options that the log was read with (`decimal`, `sheet`, ...), for what the next one leaves open."""
    versions: Mapping[str, str] = field(default_factory=dict)
    error_rows: Mapping[str, Any] = field(default_factory=dict)
    joint: Joint | None = None
    """Where several logs were fitted together: the parameters of all of them; not saved."""
    by_log: tuple[Fit, ...] = ()
    """The fit log by log, held-out logs last; not saved, `logs` is."""
    logs: tuple[Mapping[str, Any], ...] = ()
    """What is saved of each log: name, errors, noise, the parameters that it has of its own."""

    @property
    def assignment(self) -> Assignment | None:
        """For each channel the column that carries it and its sign; None where they are as named."""
        return assignment_of(self.corrections, self.model.channels)

    @property
    def half_width(self) -> np.ndarray:
        """Half of the 95 % interval of every parameter, (n,); nan where the data do not determine it."""
        return coverage_factor(self.degrees_of_freedom) * self.std

    @property
    def params(self) -> dict[str, FittedParameter]:
        """The parameters by name: value, standard uncertainty, 95 % interval and unit."""
        intervals, factors = self.conf_int(), coverage_factor(self.degrees_of_freedom)
        return {
            p.name: FittedParameter(
                float(self.values[k]), _number(self.std[k]), intervals[p.name], float(factors[k]), p.unit
            )
            for k, p in enumerate(self.model.parameters)
        }

    def conf_int(self, level: float = INTERVAL) -> dict[str, tuple[float, float] | None]:
        """Return the interval of each parameter that holds the true value with probability `level`, in SI.

        None where the data do not determine it. Value +- a factor x `std`: that of Student's t with
        `degrees_of_freedom`, 1.96 for 95 % where the noise is as stated. Raises `InputError` for a level that
        is no probability.
        """
        if not 0 < level < 1:
            raise InputError(f"The level of an interval must be between 0 and 1; instead received {level!r}.")
        half = coverage_factor(self.degrees_of_freedom, level) * self.std
        return {
            name: (float(value - h), float(value + h)) if np.isfinite(h) else None
            for name, value, h in zip(self.model.names, self.values, half, strict=True)
        }

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of every two parameters, (n, n); nan where the data do not determine one of them."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.covariance / np.outer(self.std, self.std)

    def predict(self, frame: Any) -> dict[str, np.ndarray]:
        """Return the pose that is decoded from readings: `{"run": (n,), "x_m": (n,), ...}`, in SI.

        `frame`: a log as `hallsym.fit` takes it; it needs no reference. On the log of the fit each run has
        its zero deviations; on any other one none, as a controller that was just zeroed decodes. Raises
        `InputError` for a frame that lacks a column of the model.
        """
        found: dict[str, np.ndarray] = decoding().predicted(self, frame)
        return found

    def residuals(self, frame: Any) -> dict[str, np.ndarray]:
        """Return decoded pose minus reference by sample: `{"run": (n,), "x_m": (n,), ...}`, in SI.

        `frame`: a log with the reference, as `hallsym.fit` takes it. The zero deviations of each run are
        estimated from that run. Raises `InputError` as `hallsym.evaluate` does.
        """
        found: dict[str, np.ndarray] = decoding().residuals_on(self, frame)
        return found

    def value(self, name: str) -> float:
        """Return one parameter's value in SI."""
        if name not in self.model.names:
            raise InputError(f"Model {self.model.name} has no parameter {name!r}.")
        return float(self.values[self.model.names.index(name)])

    def to_dict(self) -> dict[str, Any]:
        """Return the readable record that `save` writes and `hallsym fit --json` prints."""
        model = self.model
        lower, upper = model.bounds
        parameters = {
            name: {
                "value": float(self.values[k]),
                "unit": model.parameters[k].unit,
                "std": _number(self.std[k]),
                "degrees_of_freedom": _number(self.degrees_of_freedom[k]),
                "determined": bool(self.determined[k]),
                "held": name in self.fixed,
                "at_bound": name in self.at_bound,
                "nominal": model.parameters[k].nominal,
                "lower": _number(lower[k]),
                "upper": _number(upper[k]),
            }
            for k, name in enumerate(model.names)
        }
        mapped = {ours: foreign.to_dict() for ours, foreign in self.columns.items()}
        return {
            "format": FORMAT,
            "goodness_of_fit": None if self.goodness is None else self.goodness.to_dict(),
            "model": model.name,
            "effects": list(model.effects),
            "added": list(added_effects(model)),
            "own_effects": [e for e in added_effects(model) if not known_effect(e, model.family)],
            "parameters": parameters,
            "combinations": [c.to_dict() for c in self.combinations],
            "errors": dict(self.error_rows),
            "noise": {c: {"value": s.value, "source": s.source} for c, s in self.noise.sigmas.items()},
            "noise_floor": dict(self.noise_floor),
            "status": self.status,
            "message": self.message,
            "seconds": self.seconds,
            "notes": list(self.notes),
            "undetermined_by_log": list(self.undetermined_by_log),
            "structural": list(self.structural),
            "solver": dict(self.solver),
            "covariance": {
                "parameters": list(model.names),
                "method": self.covariance_method,
                "reason": self.covariance_reason,
                "matrix": self.covariance.tolist(),
            },
            "zero_bounds": {z.name: [_number(z.lower), _number(z.upper)] for z in model.offsets},
            "zero_deviations": {
                str(run): dict(zip((z.name for z in model.offsets), np.asarray(d).tolist(), strict=True))
                for run, d in self.offsets.items()
            },
            "corrections": [one.text for one in self.corrections],
            "claims": plain(self.claims),
            "layout": [dict(part.entry) for part in model.layout],
            "log": {**self.log, "sha256": self.source.sha256 if self.source else self.log["sha256"]},
            **({"columns": mapped} if mapped else {}),
            **({"read_with": dict(self.read_with)} if self.read_with else {}),
            **({"logs": [dict(one) for one in self.logs]} if self.logs else {}),
            "versions": dict(self.versions),
        }


def load_fit(
    path: str | Path,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    families: Sequence[Family] = (),
) -> Fit:
    """Read a calibration that `Fit.save` wrote. Raises `InputError` for a missing or foreign file.

    `own`: the user's effects by name, if it was fitted with any; `families`: the user's families.
    """
    raw = read_json(path, "Calibration", "fit the log again", f"make one with 'hallsym fit LOG -o {path}'")
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        found = raw.get("format") if isinstance(raw, dict) else None
        raise InputError(
            f"File {quoted(path)} must be a calibration of format {FORMAT!r}; instead it says {found!r}."
        )
    record, own, where = read_record(raw, path), own or {}, f"calibration {quoted(path)}"
    unknown = [name for name in record.own_effects if read_text(name)[0] not in own]
    if unknown:
        raise InputError(
            f"The calibration was fitted with {', '.join(unknown)}, an effect of your own; "
            "give the file that defines it: --effects my_effects.py."
        )
    model = _model(record, own, families, where)
    for name in record.effects:
        if name not in model.effects:
            raise InputError(
                f"'effects' of {where} lists {name!r}, which its model and what was added to it do not have"
                f"{nearest(name, list(model.effects))}; fit the log again."
            )
    entries, names = record.parameters, model.names
    _same(names, entries, f"parameters of {where}")
    _same(names, record.covariance.parameters, f"covariance of {where}")
    offsets = [zero.name for zero in model.offsets]
    for run, deviations in record.zero_deviations.items():
        _same(offsets, deviations, f"zero deviations of run {run} in {where}")
    matrix = record.covariance.matrix
    if len(matrix) != len(names) or any(len(row) != len(names) for row in matrix):
        raise InputError(
            f"The covariance of {where} must have {len(names)} rows and columns, one per parameter; fit the "
            "log again."
        )
    lacking = [c for c in logged_columns(model) if c not in record.noise and c != "t_s"]
    if lacking:
        raise InputError(f"The noise of {lacking[0]} is missing in {where}; fit the log again.")
    _same(model.pose, record.noise_floor or model.pose, f"noise floor of {where}")
    tables = (record.errors, *(one.errors for one in record.logs))
    for rows in filter(None, (rows for table in tables for rows in table.values())):
        for what in ("rmse", "peak"):
            _same(model.pose, rows.get(what, ()), f"errors ({what}) of {where}")
    for channel, sign in record.wiring or ():
        if channel not in model.channels or sign not in (1, -1):
            raise InputError(
                f"'wiring' of {where} must pair {', '.join(model.channels)} with 1 or -1; it has "
                f"{[channel, sign]!r}: fit the log again."
            )
    column = {k: np.array([_or(getattr(entries[n], k), np.nan) for n in names]) for k in ("value", "std")}
    return Fit(
        model=model,
        values=column["value"],
        std=column["std"],
        determined=np.array([entries[n].determined for n in names]),
        covariance=np.array(matrix, dtype=float).reshape(len(names), len(names)),
        covariance_method=record.covariance.method,
        covariance_reason=record.covariance.reason,
        degrees_of_freedom=np.array([_or(entries[n].degrees_of_freedom, np.inf) for n in names]),
        fixed=tuple(n for n in names if entries[n].held),
        structural=tuple(record.structural),
        at_bound=tuple(n for n in names if entries[n].at_bound),
        combinations=tuple(
            CombinationEstimate(
                c.expression, c.value, c.std, c.unit, c.factors, _or(c.degrees_of_freedom, np.inf)
            )
            for c in record.combinations
        ),
        offsets={run: np.array([d[zero] for zero in offsets]) for run, d in record.zero_deviations.items()},
        noise=Noise(record.noise),
        noise_floor={c: _or(v, np.nan) for c, v in record.noise_floor.items()},
        status=record.status,
        message=record.message,
        goodness=record.goodness_of_fit,
        solver=plain(record.solver),
        log=plain(record.log),
        seconds=record.seconds,
        notes=tuple(record.notes),
        undetermined_by_log=tuple(record.undetermined_by_log),
        corrections=(
            *map(read_correction, record.corrections),
            *as_corrections(tuple(record.wiring or ()), model.channels[: len(record.wiring or ())]),
        ),
        claims=record.claims,
        columns=record.columns,
        read_with=record.read_with,
        logs=tuple(plain(one) for one in record.logs),
        versions=record.versions,
        error_rows=record.errors,
    )


def read_record(raw: Any, path: str | Path) -> CalibrationRecord:
    """Return the JSON data of a calibration file as a record. Raises `InputError` that names the place."""
    return structured(raw, CalibrationRecord, f"calibration {quoted(path)}", "fit the log again")


def calibration_schema() -> dict[str, Any]:
    """Return the JSON Schema of a calibration file, from the types that `load_fit` checks it against."""
    return schema_of(CalibrationRecord, "hallsym calibration")


def _model(
    record: CalibrationRecord,
    own: Mapping[str, Callable[[Model], Model]],
    families: Sequence[Family],
    where: str,
) -> Model:
    """Return the model that was fitted, with the nominal values and bounds it had."""
    bounds = {n: (e.lower, e.upper) for n, e in record.parameters.items()} | record.zero_bounds
    changes: dict[str, dict[str, float]] = {}
    for name, (low, high) in bounds.items():
        changes[name] = {"lower": _or(low, -np.inf), "upper": _or(high, np.inf)}
        if not changes[name]["lower"] <= changes[name]["upper"]:
            raise InputError(f"Bounds of {name} in {where} are inverted; fit the log again.")
    for name, entry in record.parameters.items():
        changes[name]["nominal"] = entry.nominal
    meta = Meta(probes=[dict(entry) for entry in record.layout])
    model = build(record.model, meta=meta, added=tuple(record.added), own=own, families=families)
    return model.with_parameters(changes)


def _same(wanted: Sequence[str], found: Iterable[str], where: str) -> None:
    """Refuse names that are missing or too much."""
    found = list(found)
    odd = [n for n in wanted if n not in found] or [n for n in found if n not in wanted]
    if odd or len(found) != len(wanted):
        raise InputError(
            f"Names in the {where} must be those of the model; {', '.join(odd[:3]) or 'one'} is "
            f"{'missing' if odd and odd[0] in wanted else 'too much'}: fit the log again."
        )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _or(value: float | None, default: float) -> float:
    return default if value is None else float(value)
