"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.cost import cost_of, price
from hallsym.codegen.decoupler import Box, Decoupler, Entry, Margin, Step, limits
from hallsym.codegen.generation import Generated, decouple, generate
from hallsym.codegen.observer import Observer, followed, observer_of
from hallsym.codegen.table import Exported, export_table

__all__ = [
    "Box", "Decoupler", "Entry", "Exported", "Generated", "Margin", "Observer", "Step", "cost_of", "decouple",
    "export_table", "followed", "generate", "limits", "observer_of", "price",
]  # fmt: skip
