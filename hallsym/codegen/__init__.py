"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.cost import cost_of
from hallsym.codegen.decoupler import Box, Decoupler, Entry, Margin, Step, limits
from hallsym.codegen.generation import Generated, decouple, generate

__all__ = [
    "Box", "Decoupler", "Entry", "Generated", "Margin", "Step", "cost_of", "decouple", "generate", "limits",
]  # fmt: skip
