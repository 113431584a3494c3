"""Which file makes the decoupler of which family: the one place where families differ.

A maker is a function `(fit, box) -> Decoupler`. It takes the model's own expressions, folds the fitted
parameters into few table entries, and gives steps of +, -, *, /, comparisons and `if_else` over inputs and
entries; everything else follows from that record.
"""

from collections.abc import Callable, Mapping

from hallsym.calibration import Fit
from hallsym.codegen import chain
from hallsym.codegen.box import Box
from hallsym.codegen.parts import Decoupler

MAKERS: Mapping[str, Callable[[Fit, Box], Decoupler]] = {}
"""Maker by family. Families that are not here have readings gain * displacement + offset, as the stage."""


def decoupler(fit: Fit, box: Box) -> Decoupler:
    """Return the decoupler of a calibration over a box, made by its family."""
    return MAKERS.get(fit.model.family, chain.decoupler)(fit, box)
