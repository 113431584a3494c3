"""C for the controller: the decoupler of a calibration, printed from the model's own expressions."""

from hallsym.codegen.generate import Generated, decouple, generate

__all__ = ["Generated", "decouple", "generate"]
