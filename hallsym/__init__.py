"""From a log of Hall readings to a position sensor that is calibrated, explained and running.

>>> import hallsym
>>> log = hallsym.bundled_campaign()
>>> result = hallsym.fit(log, "stage31", solver="direct")
>>> round(result.value("eta_A"), 3)
0.867
"""

from hallsym.calibration import Fit, load_fit
from hallsym.campaign import Campaign, paper_campaign, read_campaign
from hallsym.decoding import ErrorTable, judge
from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.fitting import fit, refit
from hallsym.log import Log, LogWriter, Meta, Noise, read_log, write_log
from hallsym.model import Model, Parameter
from hallsym.paper import bundled_campaign
from hallsym.twin import NoiseModel, simulate, simulate_blocks, table8_noise

__all__ = [
    "Campaign",
    "Diagnosis",
    "ErrorTable",
    "Fit",
    "InputError",
    "Log",
    "LogWriter",
    "Meta",
    "Model",
    "Noise",
    "NoiseModel",
    "Parameter",
    "build",
    "bundled_campaign",
    "diagnose",
    "fit",
    "judge",
    "load_fit",
    "paper_campaign",
    "read_campaign",
    "read_log",
    "refit",
    "simulate",
    "simulate_blocks",
    "table8_noise",
    "write_log",
]
