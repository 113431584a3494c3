"""Where the gap between model and machine lies, which effect makes it, and how far it shrinks.

>>> import hallsym
>>> from hallsym.diagnosis import diagnose
>>> diagnose(hallsym.bundled_campaign(), "stage31").verdict
'no gap'
"""

from hallsym.diagnosis.engine import diagnose
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import Diagnosis, FoundEffect, Separation, Statement
from hallsym.families.user import load_effects
from hallsym.model import Effect, Facts, Variant

__all__ = [
    "POLICY",
    "Diagnosis",
    "Effect",
    "Facts",
    "FoundEffect",
    "Policy",
    "Separation",
    "Statement",
    "Variant",
    "diagnose",
    "load_effects",
]
