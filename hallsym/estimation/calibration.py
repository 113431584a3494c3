"""A calibration: values with uncertainties, identifiable combinations, errors; saved as readable JSON."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from scipy.special import ndtri, stdtrit

from hallsym.errors import InputError
from hallsym.estimation.decoding import ErrorTable
from hallsym.estimation.goodness_of_fit import GoodnessOfFit
from hallsym.estimation.identifiable import Determination
from hallsym.estimation.likelihood import Cost
from hallsym.families import build, known_effect, plain
from hallsym.files import atomic_write
from hallsym.log import Log, Meta, Noise, Sigma
from hallsym.log.batches import Weigh
from hallsym.model import Family, Model
from hallsym.model.effect import read_text

FORMAT = "hallsym calibration 1"
INTERVAL = 0.95
"""Probability that an interval holds the true value."""
MANY = 200.0
"""Degrees of freedom from which on Student's interval is a normal one, to 1 %."""


def coverage_factor(degrees_of_freedom: float | np.ndarray) -> np.ndarray:
    """Return half of a 95 % interval over the standard uncertainty: Student's t, 1.96 for infinite ones."""
    half = 0.5 + 0.5 * INTERVAL
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


class SolverRecord(TypedDict):
    """How the optimum was found; `share_at_optimum`: of the starts that were refined.

    `lower_bound`: the record of `lower_bound.LowerBound`, None for a model that has no exact run statistics.
    """

    name: str
    loss: str
    cost: float
    cost_per_degree_of_freedom: float
    evaluations: int
    starts: int
    share_at_optimum: float
    seed: int
    lower_bound: dict[str, Any] | None


class LogRecord(TypedDict):
    """The log that was fitted; `span`: least and greatest value by column of reference and state."""

    path: str | None
    sha256: str | None
    rows: int
    runs: int
    holdout: list[int]
    span: dict[str, list[float]]


@dataclass(frozen=True, eq=False)
class Errors:
    """Error tables of the decoded pose: nominal parameters without zero deviations, and the fit."""

    designed: ErrorTable
    fitted: ErrorTable
    holdout: tuple[int, ...]

    def rows(self) -> dict[str, dict[str, dict[str, float]] | None]:
        """Return rmse and peak: `designed` over all runs, `fitted` and `holdout` over theirs."""
        used = [run for run in self.fitted.runs if run not in self.holdout]
        return {
            "designed": self.designed.over(),
            "fitted": self.fitted.over(used),
            "holdout": self.fitted.over(self.holdout),
        }


@dataclass(frozen=True, eq=False)
class Fit:
    """What `fit` returns and `calib.json` holds.

    `values`, `std`, `determined`: (n,) in the order of `model.parameters`; `std` is nan where the data do
    not determine the parameter. `covariance`: (n, n), zero rows for held parameters. `degrees_of_freedom`:
    (n,) of `std`, for Student's t; infinite where the noise is as stated. `held` stayed at nominal,
    `at_bound` ended at a bound. `zeros`: run -> zero deviations delta [m] in reading space. `noise_floor`:
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
    held: tuple[str, ...]
    structural: tuple[str, ...]
    at_bound: tuple[str, ...]
    combinations: tuple[CombinationEstimate, ...]
    zeros: Mapping[int, np.ndarray]
    noise: Noise
    noise_floor: Mapping[str, float]
    status: str
    message: str
    solver: SolverRecord
    log: LogRecord
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
    wiring: tuple[tuple[str, int], ...] | None = None
    turned: bool = False
    """Whether `wiring` is what an inspection of the log found before the fit: a side to mount; not saved."""
    versions: Mapping[str, str] = field(default_factory=dict)
    error_rows: Mapping[str, Any] = field(default_factory=dict)

    @property
    def half_width(self) -> np.ndarray:
        """Half of the 95 % interval of every parameter, (n,); nan where the data do not determine it."""
        return coverage_factor(self.degrees_of_freedom) * self.std

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
                "held": name in self.held,
                "at_bound": name in self.at_bound,
                "nominal": model.parameters[k].nominal,
                "lower": _number(lower[k]),
                "upper": _number(upper[k]),
            }
            for k, name in enumerate(model.names)
        }
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
            "zero_bounds": {z.name: [_number(z.lower), _number(z.upper)] for z in model.zeros},
            "zero_deviations": {
                str(run): dict(zip((z.name for z in model.zeros), np.asarray(d).tolist(), strict=True))
                for run, d in self.zeros.items()
            },
            "wiring": None if self.wiring is None else [list(pair) for pair in self.wiring],
            "layout": [dict(p.entry) for p in model.layout],
            "log": {**self.log, "sha256": self.source.sha256 if self.source else self.log["sha256"]},
            "versions": dict(self.versions),
        }

    def save(self, path: str | Path) -> None:
        """Write the calibration as JSON; a file that was there is replaced only by a complete new one."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        atomic_write(Path(path), (text + "\n").encode())


def load_fit(
    path: str | Path,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    families: Sequence[Family] = (),
) -> Fit:
    """Read a calibration that `Fit.save` wrote. Raises `InputError` for a missing or foreign file.

    `own`: the user's effects by name, if it was fitted with any; `families`: the user's families.
    """
    path = Path(path)
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(
            f"Calibration {path} does not exist; make one with 'hallsym fit LOG -o {path}'."
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"Calibration {path} cannot be read as JSON: {' '.join(str(error).split())}."
        ) from None
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        found = raw.get("format") if isinstance(raw, dict) else None
        raise InputError(
            f"File {path} must be a calibration of format {FORMAT!r}; instead it says {found!r}."
        )
    try:
        return _from_dict(raw, own or {}, families)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"Calibration {path} is incomplete ({error!r}); fit the log again.") from None


def _from_dict(
    raw: Mapping[str, Any], own: Mapping[str, Callable[[Model], Model]], families: Sequence[Family]
) -> Fit:
    entries = raw["parameters"]
    changes = {
        n: {"nominal": e["nominal"], "lower": _bound(e["lower"], -1), "upper": _bound(e["upper"], 1)}
        for n, e in entries.items()
    }
    changes |= {
        n: {"lower": _bound(low, -1), "upper": _bound(high, 1)}
        for n, (low, high) in raw["zero_bounds"].items()
    }
    probes = [dict(entry) for entry in raw["layout"]]
    unknown = [name for name in raw.get("own_effects", ()) if read_text(name)[0] not in own]
    if unknown:
        raise InputError(
            f"The calibration was fitted with {', '.join(unknown)}, an effect of your own; "
            "give the file that defines it: --effects my_effects.py."
        )
    added = tuple(raw["added"])
    model = build(raw["model"], meta=Meta(probes=probes), added=added, own=own, families=families)
    model = model.with_parameters(changes)
    names = model.names
    column = {k: np.array([_float(entries[n][k]) for n in names]) for k in ("value", "std")}
    return Fit(
        model=model,
        values=column["value"],
        std=column["std"],
        determined=np.array([entries[n]["determined"] for n in names]),
        covariance=np.array(raw["covariance"]["matrix"], dtype=float),
        covariance_method=raw["covariance"]["method"],
        covariance_reason=raw["covariance"]["reason"],
        degrees_of_freedom=np.array([_unlimited(entries[n].get("degrees_of_freedom")) for n in names]),
        held=tuple(n for n in names if entries[n]["held"]),
        structural=tuple(raw["structural"]),
        at_bound=tuple(n for n in names if entries[n]["at_bound"]),
        combinations=tuple(_combination(c) for c in raw["combinations"]),
        zeros={
            int(run): np.array([d[z.name] for z in model.zeros]) for run, d in raw["zero_deviations"].items()
        },
        noise=Noise({c: Sigma(s["value"], s["source"]) for c, s in raw["noise"].items()}),
        noise_floor=raw["noise_floor"],
        status=raw["status"],
        message=raw["message"],
        goodness=GoodnessOfFit.from_dict(raw["goodness_of_fit"]) if raw.get("goodness_of_fit") else None,
        solver=raw["solver"],
        log=raw["log"],
        seconds=raw["seconds"],
        notes=tuple(raw["notes"]),
        undetermined_by_log=tuple(raw["undetermined_by_log"]),
        wiring=None if raw["wiring"] is None else tuple((c, s) for c, s in raw["wiring"]),
        versions=raw["versions"],
        error_rows=raw["errors"],
    )


def added_effects(model: Model) -> Sequence[str]:
    """Return the effects that `model` has beyond those its name stands for, with their numbers."""
    new = [model.texts.get(effect, effect) for effect in model.effects[len(plain(model).effects) :]]
    return list(dict.fromkeys(new))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _bound(value: float | None, sign: int) -> float:
    return sign * float("inf") if value is None else float(value)


def _unlimited(value: float | None) -> float:
    return float("inf") if value is None else float(value)


def _combination(raw: Mapping[str, Any]) -> CombinationEstimate:
    return CombinationEstimate(**{**raw, "degrees_of_freedom": _unlimited(raw.get("degrees_of_freedom"))})


def _float(value: float | None) -> float:
    return float("nan") if value is None else float(value)
