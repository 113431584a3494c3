"""Which file makes the decoupler of which family: the one place where families differ.

A maker is a function `(model, p, weight, box) -> Decoupler`. It takes the model's own expressions, folds the
parameters `p` into few table entries, and gives steps of +, -, *, /, comparisons and `if_else` over inputs
and entries; source, table, bounds, self-test, proofs and reports follow from that record.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hallsym.codegen import chain, rotary
from hallsym.codegen.box import Box
from hallsym.codegen.parts import Decoupler
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.model import Model

Maker = Callable[..., Decoupler]

MAKERS: Mapping[str, Maker] = {"linear": chain.decoupler, "angle": rotary.decoupler}
"""Maker by kind of decoder (`Family.decoder`): readings gain * displacement + offset, or an arctangent."""
OPTIONS: Mapping[str, tuple[str, ...]] = {"angle": ("accuracy", "correction")}
"""What a maker takes beyond that, by keyword."""


def decoupler(fit: Fit, box: Box, options: Mapping[str, Any] | None = None) -> Decoupler:
    """Return the decoupler of a calibration over a box, made by its family, which takes the `options`."""
    sigma = np.array([fit.noise.sigmas[c].value for c in fit.model.channels])
    return made(fit.model, fit.values, 1.0 / sigma**2, box, options)


def made(
    model: Model, p: np.ndarray, weight: np.ndarray, box: Box, options: Mapping[str, Any] | None = None
) -> Decoupler:
    """Return the decoupler of a model at parameters `p`; `weight`: 1 / variance of each reading.

    `options`: those of its family that are given, by name (`OPTIONS`); raises `InputError` for others.
    """
    decoder = model.family.decoder
    for name in options or {}:
        if callable(decoder) or name not in OPTIONS.get(decoder, ()):
            raise InputError(
                f"--{name} belongs to families that correct an angle; {model.name} of the family "
                f"{model.family} is decoded as exactly as float32 can: leave it out."
            )
    maker = decoder if callable(decoder) else MAKERS[decoder]
    return maker(model, p, weight, box, **(options or {}))
