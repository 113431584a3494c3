"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.arithmetic import mix
from hallsym.codegen.backend import Backend
from hallsym.codegen.bounds import Bounds, pose_bounds
from hallsym.codegen.box import Box, box_of, limits
from hallsym.codegen.checks import notes_of
from hallsym.codegen.cost import Cost, cost_of, firmware_cost
from hallsym.codegen.decoupler import Array, Bits, Decoupler, Flag, Lookup, Margin, Step, Whole
from hallsym.codegen.entries import Entry
from hallsym.codegen.execution import on_arrays
from hallsym.codegen.fixed_point import Line, Program
from hallsym.codegen.float_backend import FloatBackend
from hallsym.codegen.float_c import DOUBLE, FLOAT
from hallsym.codegen.generation import Generated, decouple, generate
from hallsym.codegen.integer_backend import IntegerBackend
from hallsym.codegen.integer_c import integer_program
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
    "on_arrays",
    "pose_bounds",
]
