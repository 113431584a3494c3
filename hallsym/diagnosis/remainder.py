"""Records of what a diagnosis leaves: the shape of the unexplained rest, and what a budget takes of it."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Band:
    """A curve with its 95 % band, one number per place of the grid; `low == high`: no samples there."""

    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class CurveShape:
    """How the residual of each reading follows a coordinate.

    `column`, `unit`: of the `grid`. `line`: whether that is a place on a line; several coordinates together,
    a direction of motion and an acceleration are none, `grid` then counts features, which `labels` names.
    `kind`: "offset" (in `value_unit`, the unit of the reading) or "gain" (relative change of the gain).
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
    """What no effect explains: `share` of the gap above the noise floor that is left (squares).

    `by`, `at`: of the first statement on it, None where it goes with nothing; `of_it`: the share of the rest
    that goes with that. `curve`: over the coordinate that most of it goes with, None where there is none.
    """

    share: float
    by: str | None
    at: str | None
    of_it: float | None
    text: str
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
    """What the error of the model adds to the uncertainty of a position, for `hallsym budget --diagnosis`.

    `rest`: standard uncertainty by output of what is left above the noise, without its shape where
    `shape_counts`: then `unexplained.curve` holds that as a function of the pose or the state. `candidates`:
    the named model first, then the others that the log does not exclude; none where there is no other.
    """

    rest: dict[str, float] = field(default_factory=dict)
    shape_counts: bool = False
    candidates: tuple[NotExcluded, ...] = ()
