"""Where the gap between model and machine lies, which effect makes it, and how far it shrinks.

>>> import hallsym
>>> from hallsym.diagnosis import diagnose
>>> diagnose(hallsym.bundled_campaign(), "stage31").verdict
'no gap'
"""

from hallsym.diagnosis.change_points import ChangePoint, change_points
from hallsym.diagnosis.choose import model_on
from hallsym.diagnosis.compare import Comparison, EffectChange, PlaceChange, compare
from hallsym.diagnosis.confusable import confusable, recorded, separation, smaller_findings
from hallsym.diagnosis.coordinates import Coordinate, coordinates, hats, knots
from hallsym.diagnosis.cordic import cordic
from hallsym.diagnosis.curve_words import shape, waves_per_period
from hallsym.diagnosis.curves import FineMap, Smooth, run_gains
from hallsym.diagnosis.decoded_errors import DecodedErrors, decoded_errors, errors_of
from hallsym.diagnosis.engine import Examined, diagnose, examine, prepare
from hallsym.diagnosis.facts import facts_of, instants, rails_of, switched_runs
from hallsym.diagnosis.faults import faults, of_samples, wiring_p, wirings
from hallsym.diagnosis.injection import Injection, generator, injections, sized
from hallsym.diagnosis.lack_of_fit import Key, LackOfFit, Shape, lack_of_fit
from hallsym.diagnosis.localisation import Located, located
from hallsym.diagnosis.measurement_error import shared_noise
from hallsym.diagnosis.noise import noise_of_rest, noise_text
from hallsym.diagnosis.normal_equations import Accumulator, normal_equations
from hallsym.diagnosis.p_values import as_many, as_often, beyond, exceeds, student
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.power import (
    NO_EFFECT,
    RATIOS,
    REPEATS,
    ROWS,
    Bench,
    CurvePoint,
    DetectionPower,
    Findable,
    Trial,
    clopper_pearson,
    detection_power,
)
from hallsym.diagnosis.record import (
    Band,
    CurveShape,
    Diagnosis,
    FoundEffect,
    Gap,
    LogRecord,
    Metric,
    ModelLeft,
    NoiseFloor,
    NotExcluded,
    Separation,
    Share,
    Shrinkage,
    Significance,
    SmallerFinding,
    Statement,
    Unexplained,
    diagnosis_schema,
)
from hallsym.diagnosis.recordings import Range, range_of, recordings, with_readings
from hallsym.diagnosis.refit import Refitted, inside_bounds, refit, with_model
from hallsym.diagnosis.regression import others
from hallsym.diagnosis.report import firmware_cost, operations, unexplained
from hallsym.diagnosis.residual_table import FrequencyBand, ResidualTable, Spectrum, both, residual_table
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, Screen, candidates
from hallsym.diagnosis.selection import Exact, Screened, cancels, ordered, select
from hallsym.diagnosis.setup import Floor, base_of, decimated, knot_group, split
from hallsym.diagnosis.shares import sizes
from hallsym.diagnosis.shrinkage import Judged, Nested, foreseen
from hallsym.diagnosis.sign_flips import Joint, SignFlips, clusters, memory, of_products, searched, stretch
from hallsym.diagnosis.simulated_machine import (
    SimulatedMachine,
    machine_of,
    readings_of,
    simulated_noise,
)
from hallsym.diagnosis.survey import Survey, memory_of_recording, survey
from hallsym.diagnosis.validation import QUIET, decide, remains, validate
from hallsym.diagnosis.words import gap_text, gap_unit, place_unit, shown
from hallsym.families.user import load_effects
from hallsym.inference import Estimate, ParameterChange
from hallsym.model import Effect, Facts, Variant

__all__ = [
    "NO_EFFECT",
    "POLICY",
    "QUIET",
    "RATIOS",
    "REPEATS",
    "ROWS",
    "Accumulator",
    "Band",
    "Base",
    "Bench",
    "ChangePoint",
    "Comparison",
    "Coordinate",
    "CurvePoint",
    "CurveShape",
    "DecodedErrors",
    "DetectionPower",
    "Diagnosis",
    "Effect",
    "EffectChange",
    "Estimate",
    "Exact",
    "Examined",
    "Facts",
    "Findable",
    "FineMap",
    "Floor",
    "FoundEffect",
    "FrequencyBand",
    "Gap",
    "Injection",
    "Joint",
    "Judged",
    "Key",
    "LackOfFit",
    "Located",
    "LogRecord",
    "Metric",
    "ModelLeft",
    "Nested",
    "NoiseFloor",
    "NotExcluded",
    "ParameterChange",
    "PlaceChange",
    "Policy",
    "Range",
    "Refitted",
    "ResidualTable",
    "Score",
    "Screen",
    "Screened",
    "Separation",
    "Shape",
    "Share",
    "Shrinkage",
    "SignFlips",
    "Significance",
    "SimulatedMachine",
    "SmallerFinding",
    "Smooth",
    "Spectrum",
    "Statement",
    "Survey",
    "Trial",
    "Unexplained",
    "Variant",
    "as_many",
    "as_often",
    "base_of",
    "beyond",
    "both",
    "cancels",
    "candidates",
    "change_points",
    "clopper_pearson",
    "clusters",
    "compare",
    "confusable",
    "coordinates",
    "cordic",
    "decide",
    "decimated",
    "decoded_errors",
    "detection_power",
    "diagnose",
    "diagnosis_schema",
    "errors_of",
    "examine",
    "exceeds",
    "facts_of",
    "faults",
    "firmware_cost",
    "foreseen",
    "gap_text",
    "gap_unit",
    "generator",
    "hats",
    "injections",
    "inside_bounds",
    "instants",
    "knot_group",
    "knots",
    "lack_of_fit",
    "load_effects",
    "located",
    "machine_of",
    "memory",
    "memory_of_recording",
    "model_on",
    "noise_of_rest",
    "noise_text",
    "normal_equations",
    "of_products",
    "of_samples",
    "operations",
    "ordered",
    "others",
    "place_unit",
    "prepare",
    "rails_of",
    "range_of",
    "readings_of",
    "recorded",
    "recordings",
    "refit",
    "remains",
    "residual_table",
    "run_gains",
    "searched",
    "select",
    "separation",
    "shape",
    "shared_noise",
    "shown",
    "simulated_noise",
    "sized",
    "sizes",
    "smaller_findings",
    "split",
    "stretch",
    "student",
    "survey",
    "switched_runs",
    "unexplained",
    "validate",
    "waves_per_period",
    "wiring_p",
    "wirings",
    "with_model",
    "with_readings",
]  # fmt: skip
