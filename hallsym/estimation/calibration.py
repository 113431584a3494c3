"""A calibration: values with uncertainties, identifiable combinations, errors; saved as readable JSON."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
from msgspec import structs
from scipy.special import ndtri, stdtrit

from hallsym.errors import InputError, nearest, quoted
from hallsym.estimation.decoding import Errors, ErrorTable, logged_columns
from hallsym.estimation.goodness_of_fit import GoodnessOfFit
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Cost
from hallsym.families import added_effects, build, known_effect
from hallsym.families.recording import Assignment, Correction, as_corrections, assignment_of, read_correction
from hallsym.files import read_json
from hallsym.log import Foreign, Log, Meta, Noise, Sigma
from hallsym.log.batches import Weigh
from hallsym.model import Family, Model
from hallsym.model.effect import read_text
from hallsym.records import builtins, schema_of, structured
from hallsym.shown import Shown, decoding

FORMAT: Final = "hallsym calibration 1"
ErrorRows = Mapping[str, Mapping[str, Mapping[str, float]] | None]
"""RMSE and peak by pose coordinate, of rows such as "fitted"; None of one without a run."""
INTERVAL = 0.95
"""Probability that an interval holds the true value."""
MANY = 200.0
"""Degrees of freedom from which on Student's interval is a normal one, to 1 %."""


# -- the file: one definition of its format, its JSON Schema and the object -------------------------------

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


def coverage_factor(degrees_of_freedom: float | np.ndarray, level: float = INTERVAL) -> np.ndarray:
    """Return half of an interval over the standard uncertainty: Student's t, normal for infinite ones."""
    half = 0.5 + 0.5 * level
    dof = np.asarray(degrees_of_freedom, dtype=float)
    finite = np.isfinite(dof)
    return np.where(finite, stdtrit(np.where(finite, dof, 1.0), half), ndtri(half))


FEWEST = 4
"""Runs from which on their scatter tells how well an rmse is known."""


def rmse_interval(table: ErrorTable, runs: Collection[int] | None = None) -> dict[str, tuple[float, float]]:
    """Return the 95 % interval of the rmse of each output over some runs; empty for fewer than `FEWEST`.

    From the scatter of whole runs, since errors within a run are correlated: jackknife of the logarithm of
    the mean square, and Student's t. Holds 92 to 95 % where runs differ by up to 30 % in size, 87 to 90 %
    where they differ by 60 % or each has one error throughout.
    """
    pick = [k for k, run in enumerate(table.runs) if (runs is None or run in runs) and table.count[k]]
    if len(pick) < FEWEST:
        return {}
    squares, count, n = table.squares[pick], table.count[pick, None], len(pick)
    with np.errstate(divide="ignore", invalid="ignore"):  # no error at all has no interval
        without = np.log((squares.sum(axis=0) - squares) / (count.sum() - count))
        half = 0.5 * coverage_factor(n - 1.0) * np.sqrt((n - 1) * without.var(axis=0))
    size = np.sqrt(squares.sum(axis=0) / count.sum())
    ends = zip(table.pose, size * np.exp(-half), size * np.exp(half), strict=True)
    return {c: (float(a), float(b)) for c, a, b in ends if np.isfinite(b)}


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A record in which every key is known."""


class Estimate(_Record, frozen=True):
    """A value in SI with its standard uncertainty, None where the data do not determine it."""

    value: float
    std: NotNegative | None
    unit: str


class _Interval:
    """What has a value and its standard uncertainty; `degrees_of_freedom`: of `std`, None if infinite."""

    value: float
    std: float | None
    degrees_of_freedom: float | None

    @property
    def dof(self) -> float:
        """Degrees of freedom of `std`; infinite where the noise is as stated."""
        return _or(self.degrees_of_freedom, np.inf)

    @property
    def factor(self) -> float:
        """Half of the 95 % interval over `std`, by Student's t where the uncertainty itself was estimated."""
        return float(coverage_factor(self.dof))

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval; None where the data do not determine the value."""
        half = self.factor * (self.std or 0.0)
        return None if self.std is None else (self.value - half, self.value + half)


class FittedParameter(_Interval, _Record, frozen=True):
    """One parameter in SI; `std` is None where the data do not determine it, a bound where there is none."""

    value: float
    unit: str
    std: NotNegative | None
    determined: bool
    fixed: bool
    at_bound: bool
    nominal: float
    lower: float | None
    upper: float | None
    degrees_of_freedom: Positive | None = None


class CombinationEstimate(_Interval, _Record, frozen=True):
    """A combination that the data determine although its parameters are not; `factors` of a linear one."""

    expression: str
    value: float
    std: NotNegative
    unit: str
    factors: dict[str, float] | None = None
    degrees_of_freedom: Positive | None = None


class GaugeRecord(_Record, frozen=True):
    """A factor that no recording shows: `text` says which, and what would determine it.

    The mean of `parameters` is nominal, so that one of them, `dependent`, follows from the others.
    """

    text: str
    parameters: tuple[str, ...]
    dependent: str


class CovarianceRecord(_Record, frozen=True):
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


class SolverRecord(_Record, frozen=True):
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


class LogRecord(_Record, frozen=True):
    """A log; `span`: least and greatest value by column of reference and state."""

    path: str | None = None
    sha256: str | None = None
    rows: Count = 0
    runs: Count = 0
    holdout: tuple[int, ...] = ()
    span: Mapping[str, tuple[float, float]] = {}


class FittedLogRecord(_Record, frozen=True):
    """One of several logs that were fitted together; `runs`: from its own run to that of the calibration.

    `parameters`: those that the log has of its own.
    """

    name: str
    held_out: bool
    log: LogRecord
    runs: dict[int, int]
    errors: ErrorRows
    noise: dict[str, Sigma]
    parameters: dict[str, Estimate]
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


_KEYS = {"error_rows": "errors", "goodness": "goodness_of_fit", "covariance_record": "covariance"}
"""Keys of the file whose field has another name."""


class Fitted(msgspec.Struct, kw_only=True, frozen=True, eq=False, forbid_unknown_fields=True, rename=_KEYS):
    """What both a calibration file and the result of a fit hold; everything is in SI.

    `covariance`: zero rows for fixed parameters. `zero_deviations`: run -> zero deviations delta [m] in
    reading space. `noise_floor`: RMSE that the stated noise alone would leave, by pose coordinate. `claims`:
    what is wrong with the recording, or with the result, and was not accepted. `columns`: how the columns of
    the log were mapped, `read_with`: options that it was read with, so that the next log of the machine is
    read alike. `goodness_of_fit`: null only in a file of an earlier version.
    """

    goodness: GoodnessOfFit | None = None
    parameters: dict[str, FittedParameter]
    combinations: tuple[CombinationEstimate, ...]
    error_rows: ErrorRows
    noise: dict[str, Sigma]
    noise_floor: Mapping[str, float | None]
    status: str
    message: str
    seconds: float
    notes: tuple[str, ...]
    undetermined_by_log: tuple[str, ...]
    structural: tuple[str, ...]
    solver: SolverRecord
    covariance_record: CovarianceRecord
    zero_deviations: dict[int, dict[str, float]]
    log: LogRecord
    versions: dict[str, str]
    columns: dict[str, Foreign] = {}
    read_with: dict[str, str] = {}
    claims: tuple[Claim, ...] = ()
    logs: tuple[FittedLogRecord, ...] = ()
    gauges: tuple[GaugeRecord, ...] = ()


class Calibration(Fitted, kw_only=True, frozen=True, eq=False):
    """A calibration file: a fit and, in words, its model and the corrections of its log.

    `added`: effects that the model was given. `corrections`: mistakes of the recording that were undone, the
    sign of a sensor mounted the other way round last; an earlier version had them as `wiring`.
    """

    format: Literal["hallsym calibration 1"]
    model: str
    added: tuple[str, ...]
    layout: tuple[dict[str, Any], ...]
    zero_bounds: dict[str, tuple[float | None, float | None]]
    effects: tuple[str, ...] = ()
    own_effects: tuple[str, ...] = ()
    corrections: tuple[str, ...] = ()
    wiring: tuple[tuple[str, int], ...] | None = None


_IF_ANY = ("columns", "read_with", "logs", "gauges")
"""Keys that a file has where there is something to say."""


# -- what a fit returns ------------------------------------------------------------------------------------


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


class Fit(Shown, Fitted, kw_only=True, frozen=True, eq=False, dict=True, weakref=True,
          rename=lambda name: f"live {name}"):  # fmt: skip
    """What `fit` returns: the calibration of `calib.json`, and what a fit just made has beside it.

    `corrections`: mistakes of the recording that were undone. Not saved: `errors`, `keep` (weights that took
    outliers out), `source` (the log), `likelihood` (the cost of the fitted runs, for profiles and refits),
    `determination` (what those runs determine), `reversed` (whether signs of sensors are all that was undone:
    a side to mount), `joint` (of several logs fitted together, the parameters of all), `by_log` (the fit log
    by log, holdout logs last).
    """

    noise: Noise
    noise_floor: Mapping[str, float]
    model: Model
    corrections: tuple[Correction, ...] = ()
    errors: Errors | None = None
    keep: Weigh | None = None
    source: Log | None = None
    likelihood: Cost | None = None
    determination: Determination | None = None
    reversed: bool = False
    joint: Joint | None = None
    by_log: tuple[Fit, ...] = ()

    def changed(self, **fields: Any) -> Fit:
        """Return the fit with other values of some fields."""
        return structs.replace(self, **fields)

    def _column(self, key: str, default: float) -> np.ndarray:
        return np.array([_or(getattr(self.parameters[n], key), default) for n in self.model.names])

    @cached_property
    def values(self) -> np.ndarray:
        """Values in SI, (n,) in the order of `model.parameters`."""
        return self._column("value", np.nan)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard uncertainties, (n,); nan where the data do not determine the parameter."""
        return self._column("std", np.nan)

    @cached_property
    def degrees_of_freedom(self) -> np.ndarray:
        """Degrees of freedom of `std`, (n,), for Student's t; infinite where the noise is as stated."""
        return self._column("degrees_of_freedom", np.inf)

    @cached_property
    def determined(self) -> np.ndarray:
        """Whether the data determine each parameter, (n,)."""
        return self._column("determined", False).astype(bool)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, (n, n), in the order of `model.parameters`."""
        order = [self.covariance_record.parameters.index(n) for n in self.model.names]
        matrix = np.array(self.covariance_record.matrix, dtype=float).reshape(len(order), len(order))
        return matrix[np.ix_(order, order)]

    @cached_property
    def offsets(self) -> dict[int, np.ndarray]:
        """Run -> zero deviations in the order of `model.offsets`."""
        return {
            run: np.array([found[zero.name] for zero in self.model.offsets])
            for run, found in self.zero_deviations.items()
        }

    @property
    def fixed(self) -> tuple[str, ...]:
        """Names of the parameters that stayed at their nominal values."""
        return tuple(n for n in self.model.names if self.parameters[n].fixed)

    @property
    def not_free(self) -> tuple[str, ...]:
        """Names of the parameters that are fixed, or follow from others by a gauge."""
        return (*self.fixed, *(gauge.dependent for gauge in self.gauges))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of the parameters that ended at a bound."""
        return tuple(n for n in self.model.names if self.parameters[n].at_bound)

    @property
    def sha256(self) -> str | None:
        """Hash of the log that was fitted; None where several were."""
        return self.source.sha256 if self.source else self.log.sha256

    @property
    def assignment(self) -> Assignment | None:
        """For each channel the column that carries it and its sign; None where they are as named."""
        return assignment_of(self.corrections, self.model.channels)

    @property
    def params(self) -> dict[str, FittedParameter]:
        """The parameters by name: value, standard uncertainty, 95 % interval and unit."""
        return self.parameters

    def conf_int(self, level: float = INTERVAL) -> dict[str, tuple[float, float] | None]:
        """Return the interval of each parameter that holds the true value with probability `level`, in SI.

        None where the data do not determine it. Value +- a factor x `std`: that of Student's t with
        `degrees_of_freedom`, 1.96 for 95 % where the noise is as stated. Raises `InputError` for a level that
        is no probability.
        """
        if not (isinstance(level, Real) and 0 < level < 1):
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
            return np.asarray(self.covariance / np.outer(self.std, self.std))

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
        model, added = self.model, added_effects(self.model)
        names = zip(Fitted.__struct_fields__, Fitted.__struct_encode_fields__, strict=True)
        same = {key: found for name, key in names if (found := getattr(self, name)) or key not in _IF_ANY}
        said = {
            "format": FORMAT,
            "goodness_of_fit": self.goodness and self.goodness.to_dict(),
            "model": model.name,
            "effects": model.effects,
            "added": added,
            "own_effects": [e for e in added if not known_effect(e, model.family)],
            "corrections": [one.text for one in self.corrections],
            "layout": [dict(part.entry) for part in model.layout],
            "zero_bounds": {z.name: (_number(z.lower), _number(z.upper)) for z in model.offsets},
            "log": structs.replace(self.log, sha256=self.sha256),
            "errors": dict(self.error_rows),
        }
        return builtins({**said, **same, **said})


def calibrated(
    model: Model,
    values: np.ndarray,
    std: np.ndarray,
    covariance: np.ndarray,
    *,
    method: str,
    reason: str,
    determined: Iterable[bool],
    degrees_of_freedom: Iterable[float],
    fixed: Sequence[str],
    at_bound: Sequence[str] = (),
    offsets: Mapping[int, np.ndarray],
    corrections: tuple[Correction, ...] = (),
    **fields: Any,
) -> Fit:
    """Return a fit from arrays in the order of `model.parameters`; `fields`: others, as `Fit` names them.

    `values`, `std`: (n,), nan where there is no uncertainty; `covariance`: (n, n), by `method` for `reason`;
    `degrees_of_freedom` of `std`: infinite where the noise is as stated. `offsets`: run -> zero deviations.
    """
    columns = (model.parameters, values, std, determined, degrees_of_freedom)
    parameters = {
        p.name: FittedParameter(
            float(value), p.unit, _number(sigma), bool(known), p.name in fixed, p.name in at_bound,
            p.nominal, _number(p.lower), _number(p.upper), _number(dof),
        )
        for p, value, sigma, known, dof in zip(*columns, strict=True)
    }  # fmt: skip
    names = [zero.name for zero in model.offsets]
    return Fit(
        model=model, parameters=parameters, corrections=corrections,
        covariance_record=CovarianceRecord(list(model.names), method, reason, covariance.tolist()),
        zero_deviations={
            run: dict(zip(names, np.asarray(d).tolist(), strict=True)) for run, d in offsets.items()
        },
        **fields,
    )  # fmt: skip


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
    entries = raw.get("parameters")
    for entry in entries.values() if isinstance(entries, dict) else ():
        if isinstance(entry, dict) and "held" in entry:  # the name that an earlier version gave it
            entry["fixed"] = entry.pop("held")
    own, where = own or {}, f"calibration {quoted(path)}"
    record = structured(raw, Calibration, where, "fit the log again")
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
    _same(names, record.covariance_record.parameters, f"covariance of {where}")
    offsets = [zero.name for zero in model.offsets]
    for run, deviations in record.zero_deviations.items():
        _same(offsets, deviations, f"zero deviations of run {run} in {where}")
    matrix = record.covariance_record.matrix
    if len(matrix) != len(names) or any(len(row) != len(names) for row in matrix):
        raise InputError(
            f"The covariance of {where} must have {len(names)} rows and columns, one per parameter; fit the "
            "log again."
        )
    lacking = [c for c in logged_columns(model) if c not in record.noise and c != "t_s"]
    if lacking:
        raise InputError(f"The noise of {lacking[0]} is missing in {where}; fit the log again.")
    _same(model.pose, record.noise_floor or model.pose, f"noise floor of {where}")
    tables = (record.error_rows, *(one.errors for one in record.logs))
    for rows in filter(None, (rows for table in tables for rows in table.values())):
        for what in ("rmse", "peak"):
            _same(model.pose, rows.get(what, ()), f"errors ({what}) of {where}")
    for channel, sign in record.wiring or ():
        if channel not in model.channels or sign not in (1, -1):
            raise InputError(
                f"'wiring' of {where} must pair {', '.join(model.channels)} with 1 or -1; it has "
                f"{[channel, sign]!r}: fit the log again."
            )
    fields = {name: getattr(record, name) for name in Fitted.__struct_fields__} | {
        "noise": Noise(record.noise),
        "noise_floor": {c: _or(v, np.nan) for c, v in record.noise_floor.items()},
    }
    wired = record.wiring or ()
    corrections = (
        *map(read_correction, record.corrections), *as_corrections(wired, model.channels[: len(wired)]),
    )  # fmt: skip
    return Fit(model=model, corrections=corrections, **fields)


def calibration_schema() -> dict[str, Any]:
    """Return the JSON Schema of a calibration file, from the types that `load_fit` checks it against."""
    return schema_of(Calibration, "hallsym calibration")


def _model(
    record: Calibration,
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
    meta = Meta(probes=[*map(dict, record.layout)])
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
    return float(value) if isfinite(value) else None


def _or(value: float | None, default: float) -> float:
    return default if value is None else float(value)
