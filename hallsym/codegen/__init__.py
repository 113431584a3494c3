"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.generate import Generated, decouple, generate
from hallsym.codegen.generate_q31 import Integers, generate_q31

__all__ = ["Generated", "Integers", "decouple", "generate", "generate_q31"]
