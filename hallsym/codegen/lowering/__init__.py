"""From a model to its decoupler, by kind of decoder.

A lowering is a function `(model, p, weight, box, **options) -> Decoupler`. It takes the model's own
expressions, folds the parameters `p` into few table entries, and gives steps of +, -, *, /, comparisons and
`if_else` over inputs and entries; C, table, bounds, self-test, proofs and report follow from that record.
"""

from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import Any

import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.decoupler import Box, Decoupler
from hallsym.codegen.lowering import angle, linear, wave
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.estimation.prediction import reading_variance
from hallsym.model import Model

Lowering = Callable[..., Decoupler]

KINDS: Mapping[str, Lowering] = {
    "linear": linear.decoupler, "angle": angle.decoupler, "wave": wave.decoupler,
}  # fmt: skip
"""Lowerings by kind of decoder: gain * displacement + offset; one corrected angle; a decaying wave."""


def lowering_of(model: Model) -> Lowering:
    """Return the lowering of the family (`Family.decoder`): one of `KINDS`, or a function of its own."""
    decoder = model.family.decoder
    return KINDS[decoder] if isinstance(decoder, str) else decoder


def options_of(lowering: Lowering) -> tuple[str, ...]:
    """Return the names of what a lowering takes by keyword."""
    return tuple(n for n, p in signature(lowering).parameters.items() if p.kind is Parameter.KEYWORD_ONLY)


def lower(fit: Fit, box: Box, **options: Any) -> Decoupler:
    """Return the decoupler of a calibration over a box."""
    sigma = np.sqrt(reading_variance(fit))
    known = {} if fit.goodness is None else fit.goodness.by_channel
    residual_over_noise = [max(1.0, known.get(c, 1.0)) for c in fit.model.channels]
    found = lowered(fit.model, fit.values, 1.0 / sigma**2, box, **options)
    return residual.judged(found, sigma * residual_over_noise)


def lowered(model: Model, p: np.ndarray, weight: np.ndarray, box: Box, **options: Any) -> Decoupler:
    """Return the decoupler of a model at parameters `p`; `weight`: 1 / variance of each reading.

    `options` of its lowering by keyword; None stands for the default. Raises `InputError` for others.
    """
    lowering = lowering_of(model)
    given = {name: value for name, value in options.items() if value is not None}
    for name in given.keys() - set(options_of(lowering)):
        raise InputError(
            f"--{name} belongs to families that correct an angle; {model.name} of the family {model.family} "
            "has nothing to choose there: leave it out."
        )
    return lowering(model, p, weight, box, **given)


def check_columns(model: Model) -> None:
    """Refuse a model whose columns a controller does not have, or that nothing can be decoded from."""
    for column in model.computed:
        raise InputError(
            f"Model {model.name} with {', '.join(model.effects)} needs {column.name}, which is computed from "
            "a whole log and its history; a controller does not have it: generate from a calibration without "
            "that effect."
        )
    if len(model.channels) < len(model.pose):
        raise InputError(
            f"Model {model.name} has fewer readings than pose coordinates; nothing can be decoded."
        )
