"""The results of a diagnosis: typed, frozen records, and their JSON as documented in docs/diagnose.md."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from hallsym.diagnosis.policy import Policy
from hallsym.estimation.calibration import LogRecord
from hallsym.estimation.goodness_of_fit import ResidualNoise
from hallsym.records import plain, schema_of, structured
from hallsym.shown import Shown

LARGER: Final = "noise larger than stated"
"""The verdict of a log whose excess over the stated noise is noise."""


@dataclass(frozen=True)
class Estimate:
    """A parameter: value and standard uncertainty in SI; None where there is none to give.

    `interval`: 95 %, by Student's t where the noise is estimated from few samples or runs.
    """

    value: float
    std: float | None
    unit: str
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Band:
    """A curve with its 95 % band, one number per place of the grid; `low == high`: no samples there."""

    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class CurveShape:
    """How the residual of each reading follows a coordinate.

    `column`, `unit`: of the `grid`. `line`: whether that is a place on a line; else `grid` counts features,
    which `labels` names. `kind`: "offset" (in `value_unit`, the unit of the reading) or "gain" (relative
    change of the gain).
    """

    coordinate: str
    line: bool
    column: str
    unit: str
    kind: str
    value_unit: str
    grid: tuple[float, ...]
    labels: tuple[str, ...] | None
    readings: dict[str, Band]


@dataclass(frozen=True)
class Unexplained:
    """The unexplained rest: `share` of the gap above the noise floor (squares).

    `curve`: over the coordinate that explains most of it, None where there is none.
    """

    share: float
    curve: CurveShape | None


@dataclass(frozen=True)
class NotExcluded:
    """A model that the log does not exclude.

    `effects`: as `--effect` takes them. `values`: of its parameters, by name [SI]. `weight`: its probability
    among these models, by BIC.
    """

    effects: tuple[str, ...]
    values: dict[str, float]
    weight: float


@dataclass(frozen=True)
class ModelLeft:
    """Contribution of the model error to the uncertainty of a position, for `hallsym budget --diagnosis`.

    `rest`: standard uncertainty by output of the residual above the noise, without its shape where
    `shape_counts`: `unexplained.curve` holds that then. `candidates`: the named model first, then the others
    that the log does not exclude; none where there is no other.
    """

    rest: dict[str, float] = field(default_factory=dict)
    shape_counts: bool = False
    candidates: tuple[NotExcluded, ...] = ()


@dataclass(frozen=True)
class Gap:
    """Errors of the decoded pose on the holdout runs: `rmse` and `peak` by output, SI.

    `interval`: of the rmse, 95 %, from the scatter of the holdout runs; empty where they are too few.
    """

    rmse: dict[str, float]
    peak: dict[str, float]
    interval: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def sizes(self) -> dict[str, dict[str, float]]:
        """Rmse and peak, `{"rmse": {x_m: ..}, "peak": {..}}`."""
        return {"rmse": self.rmse, "peak": self.peak}


@dataclass(frozen=True)
class Metric:
    """The gap as one number over all outputs [m, or rad where the pose is an angle].

    `before`: of the model; `after`: with the effects that were found; `floor`: of noise alone.
    """

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class NoiseFloor:
    """RMSE that noise alone leaves, by output. `source`: "stated", "estimated" or "stated and estimated"."""

    outputs: dict[str, float]
    source: str


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap shrinks with everything that was found.

    `value`: 1 - gap after / gap before, on `judges` runs that took part in neither fit nor choice: the
    holdout runs, and every fitted run with the search repeated without it. `interval`: 95 % of recordings of
    as many runs lie within; None below `fewest` judges. `share_closed`: part of the excess above the noise
    floor that is closed on the holdout runs (squares); `parameters_added`: to the model.
    """

    value: float
    interval: tuple[float, float] | None
    share_closed: float
    parameters_added: int
    judges: int = 0
    fewest: int = Policy.fewest


@dataclass(frozen=True)
class Significance:
    """Whether any effect of the catalogue is there at all.

    `p_value`: by sign flips of `units` scores, each of a "run" or of a "stretch" of one (`unit`), corrected
    for all tests. `least`: the smallest p-value that so many units can give.
    """

    p_value: float
    least: float
    units: int
    unit: str


@dataclass(frozen=True)
class SmallerFinding:
    """An effect that is significant and lowers the gap by less than the threshold."""

    name: str
    shrinkage: float
    p_value: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that lowers the gap, with all other effects of the list in place.

    `shrinkage`: 1 - gap with it / gap without it, on runs that took part in neither fit nor choice;
    `interval`: as of `Shrinkage`, None too for a fault of the recording. `share`: part of the excess above
    the noise floor that it closes. `p_value`: of its absence, corrected for all tests. `cost`: what it adds
    to the model and, where `diagnose` is given a `price`, to C. `text`: the argument of `--effect`, empty for
    a fault of the recording. `at_bound`: parameters that ended at a bound, without uncertainty. `note`: that,
    and the remedy of a fault.
    """

    name: str
    link: str
    variant: str
    parameters: dict[str, Estimate]
    p_value: float
    shrinkage: float
    interval: tuple[float, float] | None
    share: float
    cost: str
    text: str = ""
    at_bound: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Statement:
    """Where the gap lies: `share` of the excess above the noise floor that goes with `by` (at `at`).

    `share`: 0 to 1, on fitted runs; coordinates are counted on the residual of those before them, so their
    shares add up to at most 1. `held_out`: the same on the holdout runs, with the curve fitted to the others;
    None where it does not apply. `text`: the statement in words.
    """

    by: str
    at: str
    share: float
    p_value: float
    text: str
    held_out: float | None = None


@dataclass(frozen=True)
class Separation:
    """The recording that would separate the members of a group, as the catalogue has it.

    `sigma_now`: standard deviations between the closest of them on this log; 5 separate them.
    """

    group: tuple[str, ...]
    recording: str
    sigma_now: float


@dataclass(frozen=True)
class Waves:
    """Amplitude of the harmonic of the error that repeats `per_turn` times per period of a coordinate. SI.

    `designed`: of the nominal sensor with fitted offsets, None where nominal parameters do not decode the
    readings; `model`: of the diagnosed model; `after`: with the effects found, None without any. `causes`:
    effects of the catalogue that make it. `coordinate`: the periodic one of a pose of several.
    """

    per_turn: int
    designed: float | None
    model: float
    after: float | None
    causes: tuple[str, ...]
    coordinate: str = ""

    @property
    def absorbed(self) -> bool:
        """Whether the model's own parameters absorb most of it, so that effects are confusable with them."""
        return self.designed is not None and self.model < 0.5 * self.designed


@dataclass(frozen=True)
class Size:
    """Size of the gap of one output or sensor, SI.

    `noise`: its floor; `above`: root of the difference of the squares of `rms` and `noise`. `share`: of the
    excess of all outputs, as the gap metric weighs them, or of all sensors; None where the total excess is
    not significant. `p_value`: of no excess; noise larger than stated is an excess too.
    """

    rms: float
    noise: float
    above: float
    share: float | None
    p_value: float


@dataclass(frozen=True)
class Sizes:
    """Size of the gap by output and by sensor, of the sides "fitted" and "held_out" where there are samples.

    Outputs are errors of the decoded pose, sensors are residuals of the readings.
    """

    outputs: dict[str, dict[str, Size]] = field(default_factory=dict)
    sensors: dict[str, dict[str, Size]] = field(default_factory=dict)

    @property
    def rows(self) -> dict[str, dict[str, Size]]:
        """Outputs, then sensors, by column; a decoded angle is both and counts once."""
        return self.outputs | {c: s for c, s in self.sensors.items() if c not in self.outputs}


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """The answer of `diagnose`: verdict, where, which effect, how far the gap shrinks. SI units throughout.

    `verdict`: "no gap", "explained", "unexplained", or "noise larger than stated". `ranked`: names with
    evidence, best first. `groups`: confusable names. `where`: where the gap lies; `remaining`: where the
    unexplained rest lies, `unexplained`: share and shape of that rest, only if the verdict is "unexplained".
    `model_error`: its contribution to the budget of a position. `size`: the gap per
    output and sensor, on fitted and on holdout runs. `waves`: the harmonics of the error over each periodic
    coordinate. `next_step`: the arguments of `hallsym fit LOG` that fit the model with the effects found.
    `noise`: of the residual, None if the log is too short. `held_out`: the unit of the holdout: a run, or a
    piece of a recording with too few.
    """

    verdict: str
    sentence: str
    noise_floor: NoiseFloor
    gap_before: Gap
    gap_after: Gap
    metric: Metric
    shrinkage: Shrinkage
    ranked: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    effects: tuple[FoundEffect, ...]
    where: tuple[Statement, ...]
    remaining: tuple[Statement, ...]
    separate_by: tuple[Separation, ...]
    validation_runs: tuple[int, ...]
    not_testable: dict[str, str]
    smaller_findings: tuple[SmallerFinding, ...]
    threshold: float
    model: str
    log: LogRecord
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    versions: dict[str, str] = field(default_factory=dict)
    unexplained: Unexplained | None = None
    model_error: ModelLeft = field(default_factory=ModelLeft)
    size: Sizes = field(default_factory=Sizes)
    next_step: tuple[str, ...] = ()
    waves: tuple[Waves, ...] = ()
    noise: ResidualNoise | None = None
    significance: Significance | None = None
    held_out: str = "holdout run"

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as plain JSON data."""
        data: dict[str, Any] = plain(self)  # of a record that was read it lacks what is at its default
        data["noise_floor"] = {**data["noise_floor"]["outputs"], "source": self.noise_floor.source}
        data["unexplained"] = data["unexplained"] or {}
        for wave in data["waves"]:
            if not wave.get("coordinate"):
                wave.pop("coordinate", None)
        if self.shrinkage.fewest == Policy.fewest:
            data["shrinkage"].pop("fewest", None)
        if self.held_out == "holdout run":
            data.pop("held_out", None)
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str = "the diagnosis") -> "Diagnosis":
        """Return the diagnosis from the JSON data of `to_dict`; `where`: its name in an error.

        Raises `InputError` that names the key which is missing or holds something else.
        """
        made = dict(data) | {"unexplained": data.get("unexplained") or None}
        floor = data.get("noise_floor")
        if isinstance(floor, Mapping):
            outputs = {name: value for name, value in floor.items() if name != "source"}
            made["noise_floor"] = {"outputs": outputs, "source": floor.get("source")}
        return structured(made, cls, where, "diagnose the log again")


def diagnosis_schema() -> dict[str, Any]:
    """Return the JSON Schema of a diagnosis as `Diagnosis.to_dict` writes it and `from_dict` reads it."""
    schema = schema_of(Diagnosis, "hallsym diagnosis")
    defined = schema["$defs"]
    defined["NoiseFloor"] = {
        "description": defined["NoiseFloor"]["description"],
        "type": "object",
        "properties": {"source": {"type": "string"}},
        "required": ["source"],
        "additionalProperties": {"type": "number"},
    }
    defined["Diagnosis"]["properties"]["unexplained"]["anyOf"].append({"type": "object", "maxProperties": 0})
    return schema
