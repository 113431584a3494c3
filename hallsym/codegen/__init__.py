"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.backend import Backend, mix
from hallsym.codegen.bounds import Bounds, pose_bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.cost import Cost, cost_of, firmware_cost
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
    steps_on_arrays,
)
from hallsym.codegen.float_backend import FloatBackend
from hallsym.codegen.float_c import DOUBLE, FLOAT
from hallsym.codegen.generation import Generated, decouple, generate, notes_of
from hallsym.codegen.integer_backend import IntegerBackend
from hallsym.codegen.integer_c import Line, Program, integer_program
from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.codegen.lowering import lower

__all__ = [
    "DOUBLE",
    "FLOAT",
    "Array",
    "Backend",
    "Bits",
    "Bounds",
    "Box",
    "Cost",
    "Decoupler",
    "Enclosure",
    "Entry",
    "Flag",
    "FloatBackend",
    "Generated",
    "IntegerBackend",
    "Line",
    "Lookup",
    "Margin",
    "Program",
    "Step",
    "Whole",
    "box_of",
    "cost_of",
    "decouple",
    "enclose",
    "firmware_cost",
    "generate",
    "integer_program",
    "limits",
    "lower",
    "mix",
    "notes_of",
    "pose_bounds",
    "steps_on_arrays",
]
