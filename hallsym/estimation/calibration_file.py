"""What a calibration file holds, as types: the one statement of its format.

`hallsym.records.structured` validates a file against them, and their JSON Schema (`msgspec.json.schema`) is
what other programs need to do the same.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=0, le=2**53)]


class _Record(Struct, forbid_unknown_fields=True):
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


class NoiseRecord(_Record):
    """One standard deviation of a column, in its SI unit."""

    value: NotNegative
    source: Literal["given", "estimated"]


class CovarianceRecord(_Record):
    """Covariance of the parameters in the order `parameters`, in SI."""

    parameters: list[str]
    method: str
    reason: str
    matrix: list[list[float]]


class GoodnessRecord(_Record):
    """What the fit leaves, in multiples of the noise; `by_run`, `by_channel`: rms residual over noise."""

    cost_per_degree_of_freedom: float
    degrees_of_freedom: float
    by_run: dict[int, float]
    by_channel: dict[str, float]
    worst_run: int
    worst_channel: str
    worst: float
    worst_least: float
    limit: float
    limit_anywhere: float
    noise_estimated: bool
    next_command: str
    what: str
    statement: str | None
    material: bool
    significant: bool
    residual_over_noise: float
    scatter: float


class LowerBoundRecord(_Record):
    """The cost that no parameters can undercut."""

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
    lower_bound: LowerBoundRecord | None = None


class LogRecord(_Record):
    """The log that was fitted; `span`: least and greatest value by column."""

    rows: Count = 0
    runs: Count = 0
    holdout: list[int] = []
    path: str | None = None
    sha256: str | None = None
    span: dict[str, tuple[float, float]] = {}


class ColumnRecord(_Record):
    """A column of the log under the name it has in its file."""

    name: str
    scale: float = 1.0
    counts_per_turn: Annotated[float, Meta(ge=2, le=1e100)] | None = None


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
    noise: dict[str, NoiseRecord]
    parameters: dict[str, OwnRecord]
    residual_over_noise: float | None = None


class CalibrationRecord(_Record):
    """A calibration file; everything is in SI."""

    format: Literal["hallsym calibration 1"]
    model: str
    added: list[str]
    parameters: dict[str, ParameterRecord]
    combinations: list[CombinationRecord]
    errors: dict[str, dict[str, dict[str, float | None]] | None]
    noise: dict[str, NoiseRecord]
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
    wiring: list[tuple[str, int]] | None
    layout: list[dict[str, Any]]
    log: LogRecord
    versions: dict[str, str]
    columns: dict[str, ColumnRecord] = {}
    read_with: dict[str, str] = {}
    effects: list[str] = []
    own_effects: list[str] = []
    goodness_of_fit: GoodnessRecord | None = None
    logs: list[FittedLogRecord] = []
