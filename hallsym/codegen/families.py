"""Which file makes the decoupler of which family: the one place where families differ.

A maker is a function `(model, p, weight, box) -> Decoupler`. It takes the model's own expressions, folds the
parameters `p` into few table entries, and gives steps of +, -, *, /, comparisons and `if_else` over inputs
and entries; source, table, bounds, self-test, proofs and reports follow from that record.
"""

from collections.abc import Callable, Mapping

import numpy as np

from hallsym.calibration import Fit
from hallsym.codegen import chain, rotary
from hallsym.codegen.box import Box
from hallsym.codegen.parts import Decoupler
from hallsym.model import Model

Maker = Callable[[Model, np.ndarray, np.ndarray, Box], Decoupler]

MAKERS: Mapping[str, Maker] = {"rotary": rotary.decoupler}
"""Maker by family. Families that are not here have readings gain * displacement + offset, as the stage."""


def decoupler(fit: Fit, box: Box) -> Decoupler:
    """Return the decoupler of a calibration over a box, made by its family."""
    sigma = np.array([fit.noise.sigmas[c].value for c in fit.model.channels])
    return made(fit.model, fit.values, 1.0 / sigma**2, box)


def made(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Decoupler:
    """Return the decoupler of a model at parameters `p`; `weight`: 1 / variance of each reading."""
    return MAKERS.get(model.family, chain.decoupler)(model, p, weight, box)
