"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.cost import cost_of
from hallsym.codegen.decoupler import (
    Array,
    Bits,
    Box,
    Decoupler,
    Entry,
    Flag,
    Lookup,
    Margin,
    Step,
    Whole,
    limits,
)
from hallsym.codegen.generation import Generated, decouple, generate

__all__ = [
    "Array", "Bits", "Box", "Decoupler", "Entry", "Flag", "Generated", "Lookup", "Margin", "Step", "Whole",
    "cost_of", "decouple", "generate", "limits",
]  # fmt: skip
