"""Parameters of a fit as text, page and pictures show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.estimation import Fit
from hallsym.units import parameter_unit


@dataclass(frozen=True)
class ParameterRow:
    """One fitted parameter; every number is in `unit`.

    `std`: standard uncertainty, nan where the data do not determine the parameter. `remark`: what is to be
    said of it, empty where it is determined inside its bounds or fixed.
    """

    name: str
    meaning: str
    unit: str
    value: float
    std: float
    nominal: float
    lower: float
    upper: float
    determined: bool
    remark: str

    @property
    def fixed(self) -> bool:
        """Whether the bounds leave no room."""
        return self.lower == self.upper


def parameter_rows(fit: Fit) -> list[ParameterRow]:
    """Return one row per parameter of the model, in its order."""
    rows = []
    for k, p in enumerate(fit.model.parameters):
        factor, unit = parameter_unit(p.unit)
        known = bool(fit.determined[k])
        value, std = factor * float(fit.values[k]), factor * float(fit.std[k]) if known else np.nan
        limits = (factor * p.nominal, factor * p.lower, factor * p.upper)
        remark = "at its bound" if p.name in fit.at_bound else ""
        if not (remark or known):
            which = "any recording" if p.name in fit.structural else "this log"
            done = "fixed at nominal" if p.name in fit.held else "see below"
            remark = f"not identifiable from {which}; {done}"
        remark = remark if p.width else ""
        rows.append(ParameterRow(p.name, p.meaning, unit, value, std, *limits, known, remark))
    return rows
