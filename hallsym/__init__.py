"""From a log of Hall readings to a position sensor that is calibrated, explained and running.

>>> import hallsym
>>> log = hallsym.bundled_campaign()
>>> result = hallsym.fit(log, "stage31", solver="direct")
>>> round(result.value("eta_A"), 3)
0.867
"""

from typing import TYPE_CHECKING, Any

from hallsym.budget import Budget, Source, position_budget, read_budget, uncertainty_map
from hallsym.calibration import Fit, load_fit
from hallsym.campaign import Campaign, paper_campaign, read_campaign, write_campaign
from hallsym.codegen import Generated, decouple, generate
from hallsym.decoding import ErrorTable
from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.diagnosis.selftest import SelfTest, selftest
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.fitting import fit, refit
from hallsym.log import Log, LogWriter, Meta, Noise, read_log, write_log
from hallsym.model import Model, Parameter
from hallsym.paper import bundled_campaign
from hallsym.passes import judge
from hallsym.planning import Plan, Ranges, paper_ranges, plan, read_ranges
from hallsym.sensitivity import Identifiability, identify
from hallsym.tolerancing import Tolerances, read_tolerances, tolerances
from hallsym.twin import NoiseModel, simulate, simulate_blocks, table8_noise

if TYPE_CHECKING:
    from hallsym.trajectory import Curve, choose_curve, read_curve

__all__ = [
    "Budget",
    "Campaign",
    "Curve",
    "Diagnosis",
    "ErrorTable",
    "Fit",
    "Generated",
    "Identifiability",
    "InputError",
    "Log",
    "LogWriter",
    "Meta",
    "Model",
    "Noise",
    "NoiseModel",
    "Parameter",
    "Plan",
    "Ranges",
    "SelfTest",
    "Source",
    "Tolerances",
    "build",
    "bundled_campaign",
    "choose_curve",
    "decouple",
    "diagnose",
    "fit",
    "generate",
    "identify",
    "judge",
    "load_fit",
    "paper_campaign",
    "paper_ranges",
    "plan",
    "position_budget",
    "read_budget",
    "read_campaign",
    "read_curve",
    "read_log",
    "read_ranges",
    "read_tolerances",
    "refit",
    "selftest",
    "simulate",
    "simulate_blocks",
    "table8_noise",
    "tolerances",
    "uncertainty_map",
    "write_campaign",
    "write_log",
]


def __getattr__(name: str) -> Any:
    """Import what belongs to curves only when it is asked for."""
    if name in ("Curve", "choose_curve", "read_curve"):
        from hallsym import trajectory

        return getattr(trajectory, name)
    raise AttributeError(f"module 'hallsym' has no attribute {name!r}")
