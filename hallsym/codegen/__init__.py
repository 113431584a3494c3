"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.cost import Cost, cost_of
from hallsym.codegen.generate import Generated, decouple, generate
from hallsym.codegen.generate_q31 import Integers, generate_q31

__all__ = ["Cost", "Generated", "Integers", "cost_of", "decouple", "generate", "generate_q31"]
