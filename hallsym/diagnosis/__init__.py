"""Where the gap between model and machine lies, which effect causes it, and how far it shrinks.

>>> import hallsym
>>> from hallsym.diagnosis import diagnose
>>> diagnose(hallsym.bundled_campaign(), "stage31").verdict
'no gap'
"""

from hallsym.diagnosis.choose import model_on
from hallsym.diagnosis.decoded_errors import errors_of
from hallsym.diagnosis.engine import Examined, diagnose, examine, prepare
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import (
    Band,
    CurveShape,
    Diagnosis,
    Estimate,
    FoundEffect,
    Separation,
    Significance,
    Statement,
    Unexplained,
    diagnosis_schema,
)
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.validation import QUIET
from hallsym.diagnosis.words import gap_text, gap_unit, noise_text, place_unit
from hallsym.families import load_effects

__all__ = [
    "POLICY", "QUIET", "Band", "Base", "CurveShape", "Diagnosis", "Estimate", "Examined", "FoundEffect",
    "Separation", "Significance", "Statement", "Unexplained", "diagnose", "diagnosis_schema", "errors_of",
    "examine", "gap_text", "gap_unit", "load_effects", "model_on", "noise_text", "place_unit", "prepare",
]  # fmt: skip
