"""From a log of Hall readings to a position sensor that is calibrated, explained and running.

>>> import hallsym
>>> log = hallsym.bundled_campaign()
>>> result = hallsym.fit(log, "stage31", solver="direct")
>>> round(result.value("eta_A"), 3)
0.867
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hallsym.shown import decoded_by, shown_by

if TYPE_CHECKING:
    from hallsym.codegen import Exported as Exported
    from hallsym.codegen import Generated as Generated
    from hallsym.codegen import decouple as decouple
    from hallsym.codegen import export_table as export_table
    from hallsym.codegen import generate as generate
    from hallsym.diagnosis import Diagnosis as Diagnosis
    from hallsym.diagnosis import diagnose as diagnose
    from hallsym.diagnosis import diagnosis_schema as diagnosis_schema
    from hallsym.errors import InputError as InputError
    from hallsym.estimation import Evaluation as Evaluation
    from hallsym.estimation import Fit as Fit
    from hallsym.estimation import SelfFit as SelfFit
    from hallsym.estimation import calibration_schema as calibration_schema
    from hallsym.estimation import evaluate as evaluate
    from hallsym.estimation import fit as fit
    from hallsym.estimation import fit_without_reference as fit_without_reference
    from hallsym.estimation import load_fit as load_fit
    from hallsym.estimation.decoding import ErrorTable as ErrorTable
    from hallsym.estimation.optimum import refit as refit
    from hallsym.experiment import Plan as Plan
    from hallsym.experiment import Ranges as Ranges
    from hallsym.experiment import paper_ranges as paper_ranges
    from hallsym.experiment import plan as plan
    from hallsym.experiment import read_ranges as read_ranges
    from hallsym.families import build as build
    from hallsym.families import published as published
    from hallsym.fleets import Fleet as Fleet
    from hallsym.fleets import RingFleet as RingFleet
    from hallsym.fleets import fleet as fleet
    from hallsym.fleets import load_fleet as load_fleet
    from hallsym.fleets import ring_fleet as ring_fleet
    from hallsym.inference import Belonging as Belonging
    from hallsym.inference import Identifiability as Identifiability
    from hallsym.inference import belonging as belonging
    from hallsym.inference import identify as identify
    from hallsym.log import Log as Log
    from hallsym.log import LogWriter as LogWriter
    from hallsym.log import Meta as Meta
    from hallsym.log import Noise as Noise
    from hallsym.log import meta_schema as meta_schema
    from hallsym.log import read_log as read_log
    from hallsym.log import write_log as write_log
    from hallsym.model import Model as Model
    from hallsym.model import Parameter as Parameter
    from hallsym.power import DetectionPower as DetectionPower
    from hallsym.power import detection_power as detection_power
    from hallsym.simulation import Campaign as Campaign
    from hallsym.simulation import NoiseModel as NoiseModel
    from hallsym.simulation import bundled_campaign as bundled_campaign
    from hallsym.simulation import paper_campaign as paper_campaign
    from hallsym.simulation import read_campaign as read_campaign
    from hallsym.simulation import simulate as simulate
    from hallsym.simulation import simulate_blocks as simulate_blocks
    from hallsym.simulation import table8_noise as table8_noise
    from hallsym.simulation import write_campaign as write_campaign
    from hallsym.sorting import Matching as Matching
    from hallsym.sorting import Sorting as Sorting
    from hallsym.sorting import change_probability as change_probability
    from hallsym.sorting import match_sensors as match_sensors
    from hallsym.sorting import read_readings as read_readings
    from hallsym.sorting import sort_sensors as sort_sensors
    from hallsym.trajectory import Curve as Curve
    from hallsym.trajectory import choose_curve as choose_curve
    from hallsym.trajectory import read_curve as read_curve
    from hallsym.uncertainty import Budget as Budget
    from hallsym.uncertainty import ErrorModel as ErrorModel
    from hallsym.uncertainty import Source as Source
    from hallsym.uncertainty import error_model as error_model
    from hallsym.uncertainty import position_budget as position_budget
    from hallsym.uncertainty import read_budget as read_budget
    from hallsym.uncertainty import uncertainty_map as uncertainty_map
    from hallsym.uncertainty.ranges import read_tolerances as read_tolerances
    from hallsym.uncertainty.tolerances import Tolerances as Tolerances
    from hallsym.uncertainty.tolerances import tolerances as tolerances

_PUBLIC = {
    "hallsym.codegen": ("Exported", "Generated", "decouple", "export_table", "generate"),
    "hallsym.diagnosis": ("Diagnosis", "diagnose", "diagnosis_schema"),
    "hallsym.errors": ("InputError",),
    "hallsym.estimation": (
        "ErrorTable", "Evaluation", "Fit", "SelfFit", "calibration_schema", "evaluate", "fit",
        "fit_without_reference", "load_fit", "refit",
    ),
    "hallsym.experiment": ("Plan", "Ranges", "paper_ranges", "plan", "read_ranges"),
    "hallsym.families": ("build", "published"),
    "hallsym.fleets": ("Fleet", "RingFleet", "fleet", "load_fleet", "ring_fleet"),
    "hallsym.inference": ("Belonging", "Identifiability", "belonging", "identify"),
    "hallsym.log": ("Log", "LogWriter", "Meta", "Noise", "meta_schema", "read_log", "write_log"),
    "hallsym.model": ("Model", "Parameter"),
    "hallsym.power": ("DetectionPower", "detection_power"),
    "hallsym.simulation": (
        "Campaign", "NoiseModel", "bundled_campaign", "paper_campaign", "read_campaign", "simulate",
        "simulate_blocks", "table8_noise", "write_campaign",
    ),
    "hallsym.sorting": (
        "Matching", "Sorting", "change_probability", "match_sensors", "read_readings", "sort_sensors",
    ),
    "hallsym.trajectory": ("Curve", "choose_curve", "read_curve"),
    "hallsym.uncertainty": (
        "Budget", "ErrorModel", "Source", "error_model", "position_budget", "read_budget", "uncertainty_map",
    ),
    "hallsym.uncertainty.ranges": ("read_tolerances",),
    "hallsym.uncertainty.tolerances": ("Tolerances", "tolerances"),
}  # fmt: skip
"""Where each public name stands; it is imported when it is first used, so that `import hallsym` is quick."""
shown_by(lambda: import_module("hallsym.report.views"))
decoded_by(lambda: import_module("hallsym.estimation.prediction"))
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = sorted([*_HOME, "__version__", "report"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("hallsym")
    if name == "report":  # a package that can be called
        return import_module("hallsym.report")
    if name not in _HOME:
        raise AttributeError(f"module 'hallsym' has no attribute {name!r}")
    module = import_module(_HOME[name])
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
