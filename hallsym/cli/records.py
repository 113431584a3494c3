"""What `--json` of each command prints: the types from which its JSON Schema is made.

Numbers are in SI; None is a number that is not known or not finite. A command that answers several questions
has a record for each. A calibration or a fleet inside a record has the schema of its own.
"""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict

from hallsym.codegen.table import Error
from hallsym.diagnosis import diagnosis_schema
from hallsym.estimation import calibration_schema
from hallsym.estimation.calibration import Calibration
from hallsym.estimation.goodness_of_fit import GoodnessOfFit
from hallsym.experiment.study import Worst
from hallsym.families.suggest import Guess
from hallsym.inference.belonging import BelongingTest, ParameterChange
from hallsym.inference.identifiability import CombinationReport, FurtherReport, NullSpace, Output
from hallsym.log.meta import Sigma
from hallsym.power import DetectionPower
from hallsym.records import DIALECT, schemas_of
from hallsym.report.data.periodic import PeriodicError

Record = dict[str, Any]
Numbers = dict[str, float]
Errors = dict[str, Numbers]
"""`rmse` and `peak`, by output."""


class Capture(TypedDict):
    """`bad`: lines that hold other numbers; `lost`: lines that the counter misses."""

    log: str
    columns: list[str]
    good: int
    bad: int
    lost: int
    seconds: float
    fault: str


class Demo(TypedDict):
    """The steps of the paper with its errors and those here."""

    steps: list[Record]
    calibration: Calibration
    pictures: list[str]


class Listing(TypedDict):
    """Of `info` alone: names and meanings."""

    models: dict[str, str]
    effects: dict[str, str]
    solvers: list[str]
    losses: list[str]


class Corrections(TypedDict):
    """Of `info corrections`."""

    corrections: list[str]


class LogInfo(TypedDict):
    """Of `info LOG`: extent and noise of each column, and what is wrong with it."""

    log: str
    rows: int
    runs: list[int]
    holdout: list[int]
    base_model: str | None
    columns: dict[str, dict[str, float | str | None]]
    notes: list[str]
    recognised: NotRequired[str]


class Guesses(TypedDict):
    """Of `info LOG --write`: the guess for each column; `open`: of unknown unit, `rest`: of no use."""

    model: str
    columns: dict[str, Guess]
    open: list[str]
    rest: list[str]


class CampaignInfo(TypedDict):
    """Of `info CAMPAIGN.toml`."""

    runs: int
    samples: int
    clock_s: float
    seconds: float
    noise: Numbers


class ModelInfo(TypedDict):
    """Of `info MODEL`: its chain, columns, parameters, and the effects that it can take."""

    model: str
    family: str
    chain: list[Record]
    effects: list[str]
    pose: list[Record]
    state: list[str]
    channels: list[str]
    parameters: list[Record]
    combinations: list[Record]
    offsets: list[Record]
    can_take: list[str]


class EffectInfo(TypedDict):
    """Of `info EFFECT`, by family."""

    effect: str
    families: dict[str, Record]


class FaultInfo(TypedDict):
    """Of `info FAULT`: a fault of samples, which no model describes."""

    fault: str
    link: str
    meaning: str
    remedy: str


class SelfCalibration(TypedDict):
    """Of `fit --reference`: each wave with its source, and the error on the holdout turn."""

    sentence: str
    reference: str
    pole_pairs: int
    turns: list[float]
    waves: list[Record]
    table_waves: list[int]
    separated_by: list[str]
    left_rad: dict[str, Numbers]
    one_field: Record | None
    speeds_ratio: float | None
    calibration: Calibration


class Belongs(TypedDict):
    """Whether a log belongs to its calibration; `reason` alone where that cannot be said."""

    reason: NotRequired[str]
    false_alarm: NotRequired[float]
    refitted: NotRequired[float]
    floor: NotRequired[float]
    tests: NotRequired[list[BelongingTest]]
    changes: NotRequired[list[ParameterChange]]
    not_identified: NotRequired[dict[str, str]]
    notes: NotRequired[list[str]]
    belongs: NotRequired[bool]
    sentence: NotRequired[str]


class Evaluated(TypedDict):
    """One log; `reason` alone where it cannot be decoded."""

    log: str
    reason: NotRequired[str]
    goodness_of_fit: NotRequired[GoodnessOfFit]
    model: NotRequired[str]
    errors: NotRequired[Errors]
    noise_floor: NotRequired[Numbers]
    by_run: NotRequired[dict[str, Errors | None]]
    noise: NotRequired[dict[str, Sigma]]
    notes: NotRequired[list[str]]
    periodic_error: NotRequired[PeriodicError | None]
    belonging: NotRequired[Belongs]


class Evaluation(TypedDict):
    """`changed`: logs that do not belong to the calibration."""

    calibration: str
    model: str
    false_alarm: float
    changed: list[str]
    logs: list[Evaluated]


class Sensitivity(TypedDict):
    """By parameter its uncertainty, effect and verdict; directions that no, or this, recording determines."""

    model: str
    recorded: str
    planned: bool
    parameters: dict[str, Record]
    combinations: list[CombinationReport]
    structural: NullSpace
    gauges: list[str]
    practical: NullSpace
    further: list[FurtherReport]
    outputs: dict[str, Output]
    nuisance: Record
    uncertainty: dict[str, str]
    profiles: list[Record]
    notes: list[str]
    partial: list[str]
    seconds: float


class Page(TypedDict):
    """The page that was written."""

    report: str
    bytes: int
    calibration: str
    log: str
    model: str


class Plan(TypedDict):
    """The runs that are chosen, and 1 sigma of parameters and of the worst position with them."""

    model: str
    criterion: str
    runs: int
    minutes: float
    candidates: int
    chosen: list[Record]
    value: float
    recorded_runs: int
    worst_before: Worst | None
    worst: Worst
    std: Numbers
    position_std: Numbers
    reference: Numbers
    values: Numbers
    noise: Numbers
    seed: int
    seconds: float
    notes: list[str]


class Turns(TypedDict):
    """Of `plan --reference`: waves that the Halls leave open, and the error of a table by turns."""

    pole_pairs: int
    places_rad: list[float]
    open_waves: list[int]
    seen: list[float]
    accuracy_rad: float | None
    turns: int | None
    least_rad: float | None
    error_rad: Numbers
    two_speeds: Numbers


class Simulation(TypedDict):
    """The log that was written, and the truth in it."""

    log: str
    rows: int
    runs: int
    model: str
    values: Numbers
    noise: Numbers
    seed: int


class Budget(TypedDict):
    """Of a position, by coordinate of the pose; at the place `at`, where it was recorded, and as a map."""

    calibration: str
    log: str | None
    model: str
    covariance: str
    at: Numbers
    budgets: dict[str, Record]
    monte_carlo: dict[str, Record] | None
    recorded: Record | None
    map: Record | None
    notes: list[str]


class OwnBudget(TypedDict):
    """Of a budget file."""

    budget: Record
    curve: NotRequired[Record]
    monte_carlo: NotRequired[Record]


class Tolerances(TypedDict):
    """Errors of the machines that were drawn, and what each tolerance is worth."""

    model: str
    seed: int
    samples: int
    points: int
    tolerances: dict[str, Record]
    errors: dict[str, Numbers]
    ranking: list[str]
    worth: dict[str, dict[str, Numbers]]
    indices: dict[str, dict[str, Numbers]]
    sharp: bool
    notes: list[str]


class Along(TypedDict):
    """Of `tolerances --along`: the error at each place by cause, all together last."""

    model: str
    decoder: str
    over: str
    at: Numbers
    places: list[float]
    causes: list[Record]
    expected_waves: dict[str, list[str]]


class Curve(TypedDict):
    """A curve, its length and extent; of one that is made also the methods that were tried."""

    method: str
    control_points: int
    max_error_m: float | None
    error_kind: str | None
    length_m: float
    extent: dict[str, list[float]]
    written: NotRequired[list[str]]
    points: NotRequired[int]
    numbers: NotRequired[int]
    at_least_m: NotRequired[float | None]
    max_error_rad: NotRequired[float | None]
    reason: NotRequired[str]
    tolerance_m: NotRequired[float | None]
    methods: NotRequired[list[Record]]
    notes: NotRequired[list[str]]


class Code(TypedDict):
    """The folder of C: its table, the box in which status is 0, and its errors against double."""

    name: str
    model: str
    identifiers: dict[str, str]
    type: str
    layout: str
    table_bytes: int
    calibration_sha256: str | None
    box: dict[str, list[float]]
    crc32: NotRequired[str]
    least_gain: NotRequired[Numbers]
    error_bound: Numbers
    error_met: Numbers
    files: list[str]
    notes: list[str]


class Export(TypedDict):
    """The table that was written; errors of the angle [rad] without it, with it and with the old one."""

    output: str
    name: str
    entries: int
    before: Error
    after: Error
    old: Error | None
    calibrated: float | None
    notes: list[str]
    undetermined: list[str]


class Sorted(TypedDict):
    """Each sensor with its gain and bin; `matching`: sets for an array."""

    source: str
    unit: str
    offset_unit: str
    nominal: float
    bin_width: float
    repeatability: float
    degrees_of_freedom: float | None
    drift_span: float | None
    sensors: list[Record]
    bins: list[Numbers]
    expected_wrong: Numbers
    repeats: Record | None
    unsorted: list[str]
    notes: list[str]
    matching: NotRequired[Record]


class Fleet(TypedDict):
    """One row a device, and how parameters spread between devices."""

    model: str | None
    devices: int
    seconds: float
    verdicts: dict[str, int]
    spread: dict[str, Record]
    outlying: dict[str, str]
    groups: dict[str, list[str]]
    rows: list[Record]


class Rings(TypedDict):
    """Of `fleet --reference`: heads and drive of the jig; `fleet` is a record of its own."""

    sentence: str
    heads: list[int]
    places_rad: list[float]
    heights: list[list[float]]
    ripple: list[Numbers]
    fleet: Fleet


COMMANDS: dict[str, tuple[type, ...]] = {
    "budget": (Budget, OwnBudget),
    "capture": (Capture,),
    "codegen": (Code,),
    "demo": (Demo,),
    "diagnose": (DetectionPower,),
    "evaluate": (Evaluation,),
    "export": (Export,),
    "fit": (SelfCalibration,),
    "fleet": (Fleet, Rings),
    "info": (Listing, Corrections, LogInfo, Guesses, CampaignInfo, ModelInfo, EffectInfo, FaultInfo, Curve),
    "plan": (Plan, Turns),
    "report": (Page,),
    "sensitivity": (Sensitivity,),
    "simulate": (Simulation,),
    "sort": (Sorted,),
    "tolerances": (Tolerances, Along),
    "trajectory": (Curve,),
}
FILES = {"fit": calibration_schema, "info": calibration_schema, "diagnose": diagnosis_schema}
"""Schemas of files that a command prints too."""


def schema(command: str) -> dict[str, Any]:
    """Return the JSON Schema of what `--json` of a command prints."""
    records, defined = schemas_of(COMMANDS[command])
    for record in records:
        own = defined[record["$ref"].rpartition("/")[2]]
        own["properties"] = {"format": {"const": f"hallsym {command} 1"}} | own["properties"]
        own["required"] = ["format", *own["required"]]
    if command in FILES:
        file = FILES[command]()
        records, defined = [*records, {"$ref": file["$ref"]}], defined | file["$defs"]
    return {"$schema": DIALECT, "title": f"hallsym {command} --json", "anyOf": records, "$defs": defined}
